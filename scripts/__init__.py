"""Programs over both packages: studies, benchmarks, examples with real robots, tools."""

import sys
from types import TracebackType


def _end_quietly(
    kind: type[BaseException], error: BaseException, trace: TracebackType | None
) -> None:
    """Ctrl-C while a program still imports what it needs ends it in one line, as it does later.

    The interpreter then exits with code 130.
    """
    if issubclass(kind, KeyboardInterrupt):
        print("\ninterrupted", file=sys.stderr)
    else:
        sys.__excepthook__(kind, error, trace)


sys.excepthook = _end_quietly
