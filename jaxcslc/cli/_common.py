"""Parts of all commands: a command, its call, result and progress, and one-line errors."""

import contextlib
import dataclasses
import functools
import inspect
import json
import re
import shlex
import sys
import time
from collections.abc import Callable, Generator, Iterable, Mapping, Sequence
from pathlib import Path
from threading import Event, Thread
from types import TracebackType
from typing import Annotated, Any, get_type_hints

from .._scratch import check_output_folder, check_replaceable
from .._text_table import printable
from ._help import ALL, help_text, page_address
from ._options import Parameter, UsageError, Values, assign, option, parameters_of, parse
from ._project import FILE, Project, remedies_in_project


# The page that explains errors of a package, or of one of its modules.
PAGES: Mapping[str, str] = {
    "bodies": "uncertainty",
    "checks": "checks",
    "derivation": "robots",
    "excitation": "excitation",
    "export": "export",
    "friction": "friction",
    "identification": "choose",
    "identification._torque_constants": "recordings",
    "least_squares": "settings",
    "likelihood": "likelihood",
    "manipulator": "robots",
    "manipulator._friction": "friction",
    "network": "robots",
    "payload": "payload",
    "recordings": "recordings",
    "report": "report",
    "selection": "settings",
    "systems": "systems",
    "uncertainty": "uncertainty",
}

# What Equinox writes before and after the words of an error inside a compiled program.
_OF_EQUINOX = re.compile(r"^.*EquinoxRuntimeError: | -{9,}.*$")


@contextlib.contextmanager
def one_line_errors(name: str = "", page: str = "command") -> Generator[list[int]]:
    """Print errors that a user can correct as one line on standard error, for exit code 2.

    The line ends with the page that explains it: of the package that found the error, or `page`. A
    wrong option names the command's help as well.

    **Returns** a list that holds the exit code of such an error.
    """
    status: list[int] = []
    try:
        yield status
    except BrokenPipeError:  # `head` closes the pipe early
        raise
    except (ImportError, ValueError, RuntimeError, OSError) as error:
        # By its name: to import the class would import JAX, which `jaxcslc --help` does without.
        if isinstance(error, ImportError) and type(error).__name__ != "MissingExtraError":
            raise
        message = " ".join(str(error).split()) or type(error).__name__
        message = _OF_EQUINOX.sub("", message)
        if isinstance(error, UsageError):  # the help, and the page that has all options
            where = " ".join(
                ["jaxcslc", *([name] if name else []), f"--help; {page_address('command')}"]
            )
        else:
            own = getattr(error, "page", None)  # of an `ExplainedError`
            where = page_address(own or _page_of(error.__traceback__) or page)
        with contextlib.suppress(OSError):  # nobody reads it
            print(printable(f"jaxcslc: {message} ({where})"), file=sys.stderr, flush=True)
        status.append(2)


def show(text: str) -> None:
    """Print a text on standard output, at once.

    **Raises** `OSError`, which names it, if it cannot be written: a full disk.
    """
    try:
        print(printable(text), flush=True)
    except BrokenPipeError:  # `head` closes the pipe early
        raise
    except OSError as error:
        raise OSError(error.errno, error.strerror, "standard output") from None


def _page_of(trace: TracebackType | None) -> str | None:
    """Return the page of the module that raised an error; None of errors of a command itself."""
    module = ""
    while trace is not None:
        top, _, below = trace.tb_frame.f_globals.get("__name__", "").partition(".")
        if top == "jaxcslc" and "." in below:  # not of a helper of all packages
            module = below
        trace = trace.tb_next
    return PAGES.get(module, PAGES.get(module.partition(".")[0]))


# What commands on systems that are not robots take.
_SYSTEM_PARAMETERS = {"robot", "train", "validate", "output", "settings", "json", "quiet"}

# Seconds before the first line, and between lines while a step goes on.
FIRST, BETWEEN = 30.0, 30.0

# Of steps of a long identification, the part of the time that has passed when they begin, as
# measured on 600,000 samples of 7 joints with settings chosen: for an estimate of what is left.
PASSED = {
    "choosing settings": 0.08,
    "preparing patterns": 0.40,
    "fitting coefficients": 0.50,
    "computing systematic errors": 0.66,
    "fitting physically consistent parameters": 0.74,
    "computing errors": 0.76,
    "writing": 0.87,
}


@dataclasses.dataclass(frozen=True)
class OutputOptions:
    """Options of output, which every command has."""

    json: Annotated[
        bool, option(group="output", help="Print the result as JSON on standard output.")
    ] = False
    quiet: Annotated[bool, option("-q", "--quiet", group="output", help="Print errors alone.")] = (
        False
    )


OverwriteOption = Annotated[
    bool,
    option(
        group="output",
        help="Replace files that jaxcslc did not write, or that were changed since. Never what is"
        " read.",
    ),
]


@dataclasses.dataclass(frozen=True)
class Output:
    """Result of a command.

    - `text`: for people.
    - `data`: for programs, computed if it is asked for.
    - `files`: that were written.
    - `status`: of the process.
    """

    text: str
    data: Callable[[], Mapping[str, Any]] = dict
    files: Sequence[Path] = ()
    status: int = 0

    def print(self, options: OutputOptions) -> None:
        """Print the result as the options say."""
        if options.json:
            from .._plain_data import plain

            document = {"files": [str(path) for path in self.files], **self.data()}
            show(json.dumps(plain(document), indent=2, ensure_ascii=False))
        elif not options.quiet:
            parts = [self.text, *([wrote(self.files)] if self.files else [])]
            show("\n\n".join(parts))


@dataclasses.dataclass(frozen=True)
class Context:
    """Call of a command.

    - `name`: of the command.
    - `parameters`: that it has; `values`: of all of them.
    - `typed`: names of those on the command line.
    - `stated`: and of those that `jaxcslc.toml` states.
    - `project`: whether that file states anything for it.
    """

    name: str
    parameters: Sequence[Parameter]
    values: Mapping[str, Any]
    typed: frozenset[str]
    stated: frozenset[str]
    project: bool

    @property
    def output(self) -> OutputOptions:
        """Options of what is printed."""
        return OutputOptions(self.values["json"], self.values["quiet"])

    def text(self) -> str:
        """Return the command line that does the same without `jaxcslc.toml`, defaults omitted."""
        words = ["jaxcslc", self.name]
        for parameter in sorted(self.parameters, key=lambda some: not some.option.positional):
            if parameter.name not in self.typed | self.stated:
                continue
            value = self.values[parameter.name]
            if isinstance(value, bool):
                words.append(parameter.shown_name.replace("--", "--" if value else "--no-", 1))
                continue
            for text in value if parameter.many else [value]:
                words += [*([] if parameter.option.positional else parameter.names[:1]), str(text)]
        return shlex.join(words)

    @contextlib.contextmanager
    def progress(self, first: str, *, estimated: bool = True) -> Generator[Callable[[str], None]]:
        """Show the current step on standard error, unless `--quiet` is given.

        On a terminal it changes. Elsewhere a line is written now and then, from half a minute on.

        - `estimated`: whether such a line says what is left, as far as it is known.
        """
        from rich.console import Console
        from rich.text import Text

        console = Console(stderr=True)
        if self.output.quiet:
            yield lambda text: None
        elif console.is_terminal:
            with console.status(Text(printable(first))) as status:
                yield lambda text: status.update(Text(printable(text)))
        else:
            with progress_lines(first, _write, passed=PASSED if estimated else {}) as step:
                yield step

    def check_no_robot_options(self, name: str) -> None:
        """**Raises** `ValueError` for an option of robots in a command on a system."""
        for parameter in self.parameters:
            if parameter.name in self.typed - _SYSTEM_PARAMETERS:
                value = self.values[parameter.name]
                shown = parameter.typed if isinstance(value, bool) else parameter.shown_name
                raise ValueError(f"{shown} is for robots; {name} describes another system")

    def check_output(
        self, written: Sequence[Path], *, folder: Path | None = None, read: Iterable[Path] = ()
    ) -> None:
        """Check that results can be written, and replace neither what is read nor others' files.

        - `written`: the files that the command writes, all in one folder.
        - `folder`: if it is for them alone.
        - `read`: files, besides those that the command line names.

        **Raises**

        - `ValueError`: if they cannot go there, or would replace what is read.
        - `FileExistsError`: if they would replace what jaxcslc did not write.
        """
        where = written[0].parent if folder is None else folder
        check_output_folder(where)
        replaced = {path.resolve() for path in written}
        for name, value in [*self.values.items(), ("read", [*read])]:
            entries = value if isinstance(value, list | tuple) else [value]
            files = [Path(x) for x in entries if isinstance(x, Path) or name == "robot"]
            for path in files if name != "output" else ():
                # A folder stands for what identify wrote into it.
                file = path / "identification.json" if path.is_dir() else path
                if file.resolve() in replaced:
                    raise ValueError(
                        f"{file}: is read, and the results would replace it; expected another"
                        " --output"
                    )
        names, overwrite = [path.name for path in written], self.values["overwrite"]
        check_replaceable(where, names, whole=folder is not None, overwrite=overwrite)


@dataclasses.dataclass(frozen=True)
class Command:
    """Command of `jaxcslc`: a function, whose parameters and docstring are its options and help.

    Its first parameter is the `Context`. Others have options, or are dataclasses whose fields do.

    - `function`: returns an `Output`.
    - `page`: of the documentation, without its suffix.
    - `examples`: command lines.
    """

    function: Callable[..., Output]
    page: str
    examples: tuple[str, ...]

    @property
    def name(self) -> str:
        """The name, as it is typed."""
        return self.function.__name__.removesuffix("_command").replace("_", "-")

    @property
    def about(self) -> str:
        """Return the function's docstring: what the command does."""
        return self.function.__doc__ or ""

    @functools.cached_property
    def parameters(self) -> tuple[Parameter, ...]:
        """Options and arguments."""
        return (*parameters_of(self.function), *parameters_of(OutputOptions))

    def help(self, group: str = "") -> str:
        """Return its help: common options, those of a group, or `ALL`.

        **Raises** `UsageError` for an unknown group.
        """
        return help_text(self.name, self.about, self.parameters, self.examples, self.page, group)

    def run(self, words: Sequence[str]) -> int:
        """Run the command, print what comes of it, and return the status of the process."""
        with one_line_errors(self.name, self.page) as status:
            if (group := asked_group(words)) is not None:
                show(self.help(group))
                return 0
            context = self.context(words)
            output = self.function(context, **self._arguments(context.values))
            if str(context.values.get("columns")) == f"{FILE}#columns":
                output = dataclasses.replace(output, text=remedies_in_project(output.text))
            if context.project and not (context.output.json or context.output.quiet):
                show(f"With {FILE}, this is: {context.text()}\n")
            output.print(context.output)
            return output.status
        return status[0]

    def context(self, words: Sequence[str]) -> Context:
        """Return the call that words of the command line make.

        Values are typed, or else stated by `jaxcslc.toml` in this folder, or else defaults.

        **Raises** `UsageError` for words that it cannot be called with.
        """
        parameters = self.parameters
        typed, others = parse(self.name, parameters, words)
        count = len(others)
        names = {parameter.name for parameter in parameters}
        stated: Values = {}
        if "robot" in names:
            stated, others = Project.here().applied(others)
        project = len(others) > count or bool(stated)
        typed |= assign(parameters, others)
        stated = {name: stated[name] for name in stated.keys() & names - typed.keys()}
        values = {some.name: some.default for some in parameters} | stated | typed
        for parameter in parameters:
            if parameter.required and parameter.name not in stated | typed:
                raise UsageError(f"missing {parameter.shown_name} {parameter.metavar}")
        names = frozenset(typed), frozenset(stated)
        return Context(self.name, parameters, values, *names, project)

    def _arguments(self, values: Mapping[str, Any]) -> Values:
        """Return the function's arguments, with dataclasses made of their fields."""
        hints, arguments = get_type_hints(self.function), {}
        for name in inspect.signature(self.function).parameters:
            if name in values:
                arguments[name] = values[name]
            elif (kind := hints[name]) is not Context:
                fields = [field.name for field in dataclasses.fields(kind)]
                arguments[name] = kind(**{field: values[field] for field in fields})
        return arguments


def command(page: str, *examples: str) -> Callable[[Callable[..., Output]], Command]:
    """Return a decorator that makes a `Command` of a function.

    - `page`: of the documentation that explains it.
    - `examples`: command lines for its help, without `jaxcslc`.
    """
    return lambda function: Command(function, page, examples)


def asked_group(words: Sequence[str]) -> str | None:
    """Return the group whose help is asked for: empty for common options; None if none is."""
    if "--help-all" in words:
        return ALL
    for asked in ("--help", "-h"):
        if asked in words:
            following = words[words.index(asked) + 1 :]
            return following[0] if following and not following[0].startswith("-") else ""
    return None


@contextlib.contextmanager
def progress_lines(
    first: str,
    write: Callable[[str], None],
    *,
    passed: Mapping[str, float] = PASSED,
    clock: Callable[[], float] = time.monotonic,
) -> Generator[Callable[[str], None]]:
    """Write a line when a step begins, and now and then while it goes on.

    Nothing at all if everything takes less than `FIRST` seconds. A line says how long it has taken
    and, where the step is known, about how long it still takes.

    **Arguments**

    - `first`: the step that it begins with.
    - `write`: is called with each line, from another thread too.
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
        wait = FIRST
        while not done.wait(wait):
            write(line())
            wait = BETWEEN

    def step(text: str) -> None:
        current[0] = text, clock() - start
        if clock() - start > FIRST:
            write(line())

    thread = Thread(target=watch, daemon=True)
    thread.start()
    try:
        yield step
    finally:
        done.set()
        thread.join()


def _write(line: str) -> None:
    with contextlib.suppress(OSError):  # nobody reads it: no reason to stop
        print(printable(line), file=sys.stderr, flush=True)


def names_in(text: str) -> list[str]:
    """Return the names of a list that is separated by commas."""
    return [name.strip() for name in text.split(",") if name.strip()]


def wrote(paths: Iterable[Path]) -> str:
    """Return the line that names the files that a command wrote."""
    return "wrote " + ", ".join(map(str, paths))
