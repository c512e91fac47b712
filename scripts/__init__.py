"""Programs over both packages: studies, benchmarks, examples with real robots, tools."""

import sys
from types import TracebackType


def _end_quietly(
    kind: type[BaseException], error: BaseException, trace: TracebackType | None
) -> None:
    """Ctrl-C while a program still imports what it needs ends it in one line, as it does later.

    The interpreter then exits with code 130. Extensions that are being initialised make an
    `ImportError` of the interruption.
    """
    origin: BaseException | None = error
    while origin is not None and not isinstance(origin, KeyboardInterrupt):
        origin = origin.__cause__ or origin.__context__ if kind is ImportError else None
    if origin is None:
        sys.__excepthook__(kind, error, trace)
        return
    print("\ninterrupted", file=sys.stderr)
    sys.exit(130)


sys.excepthook = _end_quietly
