"""Options of commands: declared in annotations, parsed by one parser.

A parameter of a command, or a field of a dataclass among them, is annotated with an `Option`. From
it follow the parser, the help, shell completion, `jaxcslc.toml` and the page of the command.
"""

import argparse
import dataclasses
import difflib
import functools
import inspect
import math
import re
from collections.abc import Callable, Iterator, Sequence
from pathlib import Path
from types import UnionType
from typing import Any, Literal, NoReturn, Union, get_args, get_origin, get_type_hints


Values = dict[str, Any]

_SHOWN = {Path: "FILE", int: "NUMBER", float: "NUMBER", str: "NAME"}
_NUMBERS = {int: "a whole number", float: "a number"}


class UsageError(ValueError):
    """A command line that its command cannot be called with."""


@dataclasses.dataclass(frozen=True)
class Option:
    """Description of an option or, if it is positional, of an argument.

    - `help`: what it does.
    - `names`: the first long one is shown; further ones are its names of before. By default that of
      the parameter.
    - `metavar`: its value, as help shows it.
    - `group`: of the help that shows it; empty for the options that everybody sees.
    - `least`: the smallest number that it takes; `above`: the number that it must exceed.
    - `flags`: names of before that stand for one of its values, with that value.
    - `renamed`: values of before, each with that of now.
    - `positional`: whether it is an argument.
    """

    help: str
    names: tuple[str, ...] = ()
    metavar: str = ""
    group: str = ""
    least: int | None = None
    above: float | None = None
    flags: tuple[tuple[str, str], ...] = ()
    renamed: tuple[tuple[str, str], ...] = ()
    positional: bool = False


def option(*names: str, help: str, **described: Any) -> Option:
    """Return the description of an option; see `Option`."""
    return Option(help, names, **described)


def argument(metavar: str, help: str) -> Option:
    """Return the description of an argument."""
    return Option(help, metavar=metavar, positional=True)


@dataclasses.dataclass(frozen=True)
class Parameter:
    """Parameter of a command: its name, type, default (`inspect.Parameter.empty`: none), option."""

    name: str
    kind: Any
    default: Any
    option: Option

    @functools.cached_property
    def names(self) -> tuple[str, ...]:
        """Names on the command line, the short one first, then that of now, then old ones."""
        return self.option.names or ("--" + self.name.replace("_", "-"),)

    @functools.cached_property
    def short_names(self) -> tuple[str, ...]:
        """Names of one letter."""
        return tuple(name for name in self.names if not name.startswith("--"))

    @functools.cached_property
    def shown_name(self) -> str:
        """The long name of now."""
        return next(name for name in self.names if name.startswith("--"))

    @functools.cached_property
    def typed(self) -> str:
        """The name as it is typed: that which switches off what is on by default."""
        return self.shown_name.replace("--", "--no-" if self.default is True else "--", 1)

    @functools.cached_property
    def item(self) -> Any:
        """The type of one value."""
        return get_args(self._kind)[0] if self.many else self._kind

    @functools.cached_property
    def many(self) -> bool:
        """Return whether it takes several values."""
        return get_origin(self._kind) is list

    @functools.cached_property
    def choices(self) -> tuple[str, ...]:
        """Values that it takes; empty where it takes others."""
        return get_args(self.item) if get_origin(self.item) is Literal else ()

    @functools.cached_property
    def metavar(self) -> str:
        """Return the option's value, as help shows it."""
        if self.item is bool:
            return ""
        return self.option.metavar or "|".join(self.choices) or _SHOWN[self.item]

    @property
    def required(self) -> bool:
        """Return whether it has no default."""
        return self.default is inspect.Parameter.empty

    @functools.cached_property
    def _kind(self) -> Any:
        if get_origin(self.kind) in (Union, UnionType):
            return next(kind for kind in get_args(self.kind) if kind is not type(None))
        return self.kind

    def parsed(self, text: str) -> Any:
        """Return the value of a text.

        **Raises** `UsageError` for one that it does not take.
        """
        text = dict(self.option.renamed).get(text, text)
        if self.choices and text not in self.choices:
            raise self.wrong(f"expected {', '.join(self.choices)}, got {text!r}")
        if self.item not in _NUMBERS:
            return text if self.choices else self.item(text)
        least, above = self.option.least, self.option.above
        expected = _NUMBERS[self.item] + ("" if least is None else f" from {least} on")
        expected += "" if above is None else f" above {above:g}"
        try:
            value = self.item(text)
        except ValueError:
            raise self.wrong(f"expected {expected}, got {text!r}") from None
        small = (least is not None and value < least) or (above is not None and value <= above)
        if small or not math.isfinite(value):
            raise self.wrong(f"expected {expected}, got {text!r}")
        return value

    def wrong(self, text: str) -> UsageError:
        """Return the error of a wrong value."""
        return UsageError(f"{self.metavar if self.option.positional else self.shown_name}: {text}")


def parameters_of(function: Callable[..., Any]) -> tuple[Parameter, ...]:
    """Return the parameters of a function or dataclass, with the fields of dataclasses among them.

    Those without an `Option` are not of the command line.

    >>> from typing import Annotated
    >>> @dataclasses.dataclass
    ... class Size:
    ...     width: Annotated[float, option(help="Width [m].")]
    ...     height: Annotated[float, option(help="Height [m].", least=0)] = 1.0
    >>> def area(name: Annotated[str, argument("NAME", "Its name.")], size: Size) -> float: ...
    >>> [parameter.name for parameter in parameters_of(area)]
    ['name', 'width', 'height']
    """
    hints = get_type_hints(function, include_extras=True)
    found: list[Parameter] = []
    for name, parameter in inspect.signature(function).parameters.items():
        if dataclasses.is_dataclass(hints[name]):
            found += parameters_of(hints[name])
        elif (described := described_by(hints[name])) is not None:
            found.append(Parameter(name, get_args(hints[name])[0], parameter.default, described))
    return tuple(found)


def described_by(hint: Any) -> Option | None:
    """Return the `Option` of an annotation, if it has one."""
    return next((x for x in getattr(hint, "__metadata__", ()) if isinstance(x, Option)), None)


class _Parser(argparse.ArgumentParser):
    """Parser whose errors are `UsageError`s, and whose result has what is typed alone."""

    def __init__(self, name: str) -> None:
        super().__init__(
            f"jaxcslc {name}",
            add_help=False,
            allow_abbrev=False,
            argument_default=argparse.SUPPRESS,
        )
        # Lists that begin with a negative number are values, too.
        self._negative_number_matcher = re.compile(r"-[\d.]|-inf|-nan")

    def error(self, message: str) -> NoReturn:
        """**Raises** `UsageError` with argparse's words, under the option's name of now."""
        names, _, text = message.removeprefix("argument ").partition(": ")
        name = next((name for name in names.split("/") if name.startswith("--")), names)
        raise UsageError(f"{name}: {text}" if text else message)


def add_options(
    parser: argparse.ArgumentParser, parameters: Sequence[Parameter], *, old: bool = True
) -> Iterator[tuple[Parameter, argparse.Action]]:
    """Add the options among the parameters to a parser, one by one.

    - `old`: whether to add their names of before, too.
    """
    for parameter in parameters:
        text = parameter.option.help.replace("%", "%%")
        settings: Values = {"dest": parameter.name, "help": text}
        if parameter.option.positional:
            continue
        names = parameter.names if old else (*parameter.short_names, parameter.shown_name)
        if parameter.item is bool:
            kind = argparse.BooleanOptionalAction
            yield parameter, parser.add_argument(*names, action=kind, **settings)
            continue
        settings |= {"action": "append", "metavar": parameter.metavar}
        yield parameter, parser.add_argument(*names, **settings)
        for flag, value in parameter.option.flags if old else ():
            hidden: Values = {"dest": parameter.name, "help": argparse.SUPPRESS, "const": value}
            parser.add_argument(flag, action="store_const", **hidden)


def parse(
    name: str, parameters: Sequence[Parameter], words: Sequence[str]
) -> tuple[Values, list[str]]:
    """Return the values of options that stand among the words of a command, and the other words.

    **Raises** `UsageError`: an option that there is not, or a value that it does not take.
    """
    parser = _Parser(name)
    for _ in add_options(parser, parameters):
        pass
    typed, others = parser.parse_known_args(list(words))
    end = others.index("--") if "--" in others else len(others)
    for word in others[:end]:
        if word.startswith("-") and len(word) > 1:
            known = [
                name for some in parameters if not some.option.positional for name in some.names
            ]
            raise UsageError(f"no such option: {word}{did_you_mean(word.partition('=')[0], known)}")
    values = vars(typed)
    for parameter in parameters:
        if parameter.name in values and parameter.item is not bool:
            texts = values[parameter.name]
            parsed = [parameter.parsed(x) for x in ([texts] if isinstance(texts, str) else texts)]
            if len(parsed) > 1 and not parameter.many:
                raise parameter.wrong(f"given {len(parsed)} times, expected once")
            values[parameter.name] = parsed if parameter.many else parsed[0]
    return values, others[:end] + others[end + 1 :]


def did_you_mean(word: str, known: Sequence[str]) -> str:
    """Return a question with the known word that is like another, if there is one."""
    near = difflib.get_close_matches(word, known, 1)
    return f"; did you mean {near[0]}?" if near else ""


def assign(parameters: Sequence[Parameter], words: Sequence[str]) -> Values:
    """Return the values of arguments from the words of a command that are no options.

    **Raises** `UsageError`: too few words, or too many.
    """
    arguments = [some for some in parameters if some.option.positional]
    usage = " ".join(map(usage_of, arguments))
    values: Values = {}
    left = list(words)
    for parameter in arguments:
        taken, left = (left, []) if parameter.many else (left[:1], left[1:])
        if taken:
            parsed = [parameter.parsed(word) for word in taken]
            values[parameter.name] = parsed if parameter.many else parsed[0]
        elif parameter.required:
            raise UsageError(f"missing {parameter.metavar}; expected {usage}")
    if left:
        raise UsageError(f"unexpected {left[0]!r}; expected {usage or 'options alone'}")
    return values


def usage_of(parameter: Parameter) -> str:
    """Return an argument as a line of usage shows it."""
    return parameter.metavar if parameter.required else f"[{parameter.metavar}]"
