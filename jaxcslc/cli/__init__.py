"""The command `jaxcslc`: options, one call of the library, and printed results.

- `_app`: the program, and its completion in shells; `_process`: settings of its process.
- `_check`, `_compare`, `_derive`, `_example`, `_excite`, `_export`, `_identify`, `_init`,
  `_payload`: the commands.
- `_options`, `_help`: options from annotations, and their help.
- `_common`, `_inputs`, `_project`: what commands share; how they read robots, recordings and
  `jaxcslc.toml`.
"""

import sys
from threading import Event


INTERRUPTED = Event()
"""Whether Ctrl-C was pressed: extensions that are being initialised make another error of it."""
_STATUS = 130  # 128 and the number of SIGINT, as shells have it


def main() -> None:
    """The command `jaxcslc`: wrong input ends it with one line and exit code 2, Ctrl-C with 130."""
    try:
        from ._process import end_process, prepare_process

        prepare_process()
        # Imported here: Ctrl-C during an import then ends the command as quietly as later on.
        from ._app import run

        end_process(run())
    except (KeyboardInterrupt, ImportError) as error:
        if not (_is_interruption(error) or INTERRUPTED.is_set()):
            raise
        print("jaxcslc: interrupted", file=sys.stderr)
        raise SystemExit(_STATUS) from None


def _is_interruption(error: BaseException | None) -> bool:
    """Return whether an error is Ctrl-C.

    Extensions that are being initialised make an ImportError of it.
    """
    while error is not None and not isinstance(error, KeyboardInterrupt):
        error = error.__cause__ or error.__context__
    return error is not None
