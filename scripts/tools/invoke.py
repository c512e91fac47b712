"""Run the command `jaxcslc` in this process and keep what it prints, for tests and tools."""

import contextlib
import io
from dataclasses import dataclass
from pathlib import Path

from jaxcslc.cli._app import run


@dataclass(frozen=True)
class Result:
    """End of a command: its status, what it printed, and an error that it did not catch."""

    exit_code: int
    stdout: str
    stderr: str
    exception: BaseException | None = None

    @property
    def output(self) -> str:
        """All that was printed."""
        return self.stdout + self.stderr


def invoke(*words: str | Path) -> Result:
    """Run the command with these words; settings of the process stay as they are."""
    out, error = io.StringIO(), io.StringIO()
    caught: BaseException | None = None
    with contextlib.redirect_stdout(out), contextlib.redirect_stderr(error):
        try:
            status = run([str(word) for word in words], configure=False)
        except SystemExit as end:
            status = end.code if isinstance(end.code, int) else 1
        except KeyboardInterrupt:
            raise
        except BaseException as raised:  # a library in Rust panics by one that is no Exception
            status, caught = 1, raised
    return Result(status, out.getvalue(), error.getvalue(), caught)
