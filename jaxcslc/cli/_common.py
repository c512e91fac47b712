"""Parts of all commands: options from dataclasses, one-line errors, progress, and their words."""

import contextlib
import dataclasses
import functools
import inspect
import shlex
import sys
import time
from collections.abc import Callable, Generator, Iterable, Mapping
from pathlib import Path
from threading import Event, Thread
from typing import TYPE_CHECKING, Any, get_type_hints

import typer
from rich.console import Console

from .._environment import MissingExtraError
from .._scratch import check_output_folder


if TYPE_CHECKING:
    CommandContext = typer.Context
else:
    # What commands get is of the class below it, which a checker of annotations insists on.
    CommandContext = typer.Context.__mro__[1]

# What commands on systems that are not robots take.
_SYSTEM_PARAMETERS = {"robot", "train", "validate", "output", "settings"}

# Seconds before the first line, and between lines while a step goes on.
FIRST, BETWEEN = 30.0, 30.0

# Of steps of a long identification, the part of the time that has passed when they begin, as
# measured on 600,000 samples of 7 joints with settings chosen: for an estimate of what is left.
PASSED = {
    "choosing settings": 0.08,
    "preparing patterns": 0.40,
    "fitting coefficients": 0.50,
    "computing systematic errors": 0.66,
    "fitting possible bodies": 0.74,
    "computing errors": 0.76,
    "writing": 0.87,
}


def command(function: Callable[..., None]) -> Callable[..., None]:
    """Return a command with an option for each field of the dataclasses among its parameters.

    Fields are annotated as parameters of a command are. The function is called with the
    dataclasses; errors that a user can correct become one line.

    >>> @dataclasses.dataclass
    ... class Size:
    ...     width: float
    ...     height: float = 1.0
    >>> @command
    ... def area(name: str, size: Size) -> None:
    ...     print(name, size.width * size.height)
    >>> list(inspect.signature(area).parameters)
    ['name', 'width', 'height']
    >>> area(name="table", width=2.0, height=3.0)
    table 6.0
    """
    hints = get_type_hints(function, include_extras=True)
    records: dict[str, Any] = {
        name: kind for name, kind in hints.items() if dataclasses.is_dataclass(kind)
    }
    parameters: list[inspect.Parameter] = []
    for name, parameter in inspect.signature(function).parameters.items():
        record = records.get(name)
        own = [parameter] if record is None else inspect.signature(record).parameters.values()
        kinds = hints if record is None else get_type_hints(record, include_extras=True)
        parameters += [
            some.replace(annotation=kinds[some.name], kind=inspect.Parameter.KEYWORD_ONLY)
            for some in own
        ]

    @functools.wraps(function)
    def called(**values: Any) -> None:
        for name, record in records.items():
            fields = [field.name for field in dataclasses.fields(record)]
            values[name] = record(**{field: values.pop(field) for field in fields})
        with one_line_errors():
            function(**values)

    called.__annotations__ = {parameter.name: parameter.annotation for parameter in parameters}
    vars(called)["__signature__"] = inspect.Signature(parameters)
    return called


@contextlib.contextmanager
def one_line_errors() -> Generator[None]:
    """Print errors that a user can correct as one line on standard error, with exit code 2."""
    try:
        yield
    except (BrokenPipeError, typer.Exit):  # `head` closes the pipe early; typer exits quietly
        raise
    except (MissingExtraError, ValueError, RuntimeError, OSError) as error:
        message = " ".join(str(error).split()) or type(error).__name__
        print(f"jaxcslc: {message}", file=sys.stderr)
        raise typer.Exit(2) from None


@contextlib.contextmanager
def progress(first: str, *, estimated: bool = True) -> Generator[Callable[[str], None]]:
    """Show the current step on standard error.

    On a terminal it changes. Elsewhere a line is written now and then, from half a minute on.

    - `estimated`: whether such a line says what is left, as far as it is known.
    """
    console = Console(stderr=True)
    if console.is_terminal:
        with console.status(first) as status:
            yield lambda text: status.update(text)
        return
    write: Callable[[str], None] = lambda line: print(line, file=sys.stderr, flush=True)
    with progress_lines(first, write, passed=PASSED if estimated else {}) as step:
        yield step


@contextlib.contextmanager
def progress_lines(
    first: str,
    write: Callable[[str], None],
    *,
    after: float = FIRST,
    every: float = BETWEEN,
    passed: Mapping[str, float] = PASSED,
    clock: Callable[[], float] = time.monotonic,
) -> Generator[Callable[[str], None]]:
    """Write a line when a step begins, and now and then while it goes on.

    Nothing at all if everything takes less than `after` seconds. A line says how long it has taken
    and, where the step is known, about how long it still takes.

    **Arguments**

    - `first`: the step that it begins with.
    - `write`: is called with each line, from another thread too.
    - `after`, `every`: seconds before the first line, and between lines of one step.
    - `passed`: the part of the time that has passed when a step begins; without it, no line says
      what is left.
    - `clock`: the time [s].

    **Returns** a function to be called with the step that begins.
    """
    start, done = clock(), Event()
    current = [(first, 0.0)]  # the step, and when it began

    def line() -> str:
        (name, begun), seconds = current[0], clock() - start
        text = f"jaxcslc: {name}, {seconds:.0f} s so far"
        if name not in passed or not begun > 0.0:
            return text
        # As fast as before, until the next step should have begun.
        following = min((other for other in passed.values() if other > passed[name]), default=0.99)
        share = min(passed[name] * seconds / begun, following)
        left = seconds * (1.0 - share) / share
        digits = 1 if left < 10 else 2
        return f"{text}, about {float(f'{left:.{digits}g}'):.0f} s left"

    def watch() -> None:
        wait = after
        while not done.wait(wait):
            write(line())
            wait = every

    def step(text: str) -> None:
        current[0] = text, clock() - start
        if clock() - start > after:
            write(line())

    thread = Thread(target=watch, daemon=True)
    thread.start()
    try:
        yield step
    finally:
        done.set()
        thread.join()


def names_in(text: str) -> list[str]:
    """Return the names of a list that is separated by commas."""
    return [name.strip() for name in text.split(",") if name.strip()]


def command_text(context: CommandContext) -> str:
    """Return the command line that a command was called by, defaults left out."""
    words, typed = ["jaxcslc", context.info_name or ""], typed_options(context)
    parameters = [some for some in context.command.params if some.name in typed]
    for parameter in sorted(parameters, key=lambda some: some.param_type_name != "argument"):
        value = context.params[parameter.name or ""]
        option = parameter.opts[:1] if parameter.param_type_name == "option" else []
        if isinstance(value, bool):
            words.append((parameter.opts if value else parameter.secondary_opts)[0])
            continue
        for text in value if isinstance(value, list | tuple) else [value]:
            words += [*option, str(text)]
    return shlex.join(words)


def choice_of(option: str, value: str, choices: tuple[Any, ...]) -> Any:
    """Return the value, one of the choices.

    **Raises** `ValueError` for another.
    """
    if value not in choices:
        raise ValueError(f"{option}: expected {', '.join(choices)}, got {value!r}")
    return value


def wrote(paths: Iterable[Path]) -> str:
    """Return the line that names the files that a command wrote."""
    return "wrote " + ", ".join(map(str, paths))


def typed_options(context: CommandContext) -> set[str]:
    """Names of the parameters that stand on the command line, defaults left out."""
    sources = {name: context.get_parameter_source(name) for name in context.params}
    return {name for name, source in sources.items() if source and source.name == "COMMANDLINE"}


def check_no_robot_options(context: CommandContext, name: str) -> None:
    """**Raises** `ValueError` for an option of robots in a command on a system."""
    typed = typed_options(context) - _SYSTEM_PARAMETERS
    for parameter in context.command.params:
        if parameter.name in typed:
            value = context.params[parameter.name]
            options = parameter.secondary_opts if value is False else parameter.opts
            raise ValueError(f"{options[0]} is for robots; {name} describes another system")


def check_output(context: CommandContext, folder: Path, written: Iterable[Path]) -> None:
    """**Raises** `ValueError` if results cannot go into a folder, or would replace what is read.

    - `written`: the files that the command writes.
    """
    check_output_folder(folder)
    replaced = {path.resolve() for path in written}
    for name, value in context.params.items():
        entries = value if isinstance(value, list | tuple) else [value]
        read = [Path(x) for x in entries if isinstance(x, Path) or name == "robot"]
        for path in read if name != "output" else ():
            # A folder stands for what identify wrote into it.
            file = path / "identification.json" if path.is_dir() else path
            if file.resolve() in replaced:
                raise ValueError(
                    f"{file}: is read, and the results would replace it; expected another --output"
                )
