import sys


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
            end_process(end)
    except (KeyboardInterrupt, ImportError) as error:
        if not _is_interruption(error):
            raise
        print("jaxcslc: interrupted", file=sys.stderr)
        raise SystemExit(130) from None


def _is_interruption(error: BaseException | None) -> bool:
    """Whether it is Ctrl-C, of which extensions that are being initialised make an ImportError."""
    while error is not None and not isinstance(error, KeyboardInterrupt):
        error = error.__cause__ or error.__context__
    return error is not None
