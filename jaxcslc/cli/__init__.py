"""The command `jaxcslc`: options, one call of the library, and printed results.

- `_app`: the command line; `_process`: settings of its process.
- `_check`, `_compare`, `_derive`, `_excite`, `_export`, `_identify`, `_payload`: the commands.
- `_common`, `_inputs`: what commands share; how they read robots and recordings.
"""

import sys


_INTERRUPTED = 130  # 128 and the number of SIGINT, as shells have it


def main() -> None:
    """The command `jaxcslc`: wrong input ends it with one line and exit code 2, Ctrl-C with 130."""
    try:
        from ._process import end_process, prepare_process

        prepare_process()
        # Imported here: Ctrl-C during an import then ends the command as quietly as later on.
        from ._app import run

        try:
            run()
        except SystemExit as end:
            if end.code == _INTERRUPTED:  # typer ends so, without a word
                _say_interrupted()
            end_process(end)
    except (KeyboardInterrupt, ImportError) as error:
        if not _is_interruption(error):
            raise
        _say_interrupted()
        raise SystemExit(_INTERRUPTED) from None


def _say_interrupted() -> None:
    print("jaxcslc: interrupted", file=sys.stderr)


def _is_interruption(error: BaseException | None) -> bool:
    """Return whether an error is Ctrl-C.

    Extensions that are being initialised make an ImportError of it.
    """
    while error is not None and not isinstance(error, KeyboardInterrupt):
        error = error.__cause__ or error.__context__
    return error is not None
