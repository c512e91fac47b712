"""Errors that a user can correct: one line each, with the page that explains it."""

import contextlib
import re
import sys
from collections.abc import Generator, Mapping
from types import TracebackType

from .._text_table import printable
from ._help import page_address
from ._options import UsageError


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

    The line ends with the page that explains it: of the package that found the error, or `page`.

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
        if isinstance(error, UsageError):
            where = " ".join(["jaxcslc", *([name] if name else []), "--help"])
        else:
            where = page_address(_page_of(error.__traceback__) or page)
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
