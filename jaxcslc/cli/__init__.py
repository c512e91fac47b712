import os
import sys


def main() -> None:
    """The command `jaxcslc`: wrong input ends it with one line and exit code 2, Ctrl-C with 130."""
    # Matrices are small: more threads of BLAS only wait for each other. On two cores they took 1.8
    # of the 9.9 s of processor time of an identification of 3,300 samples.
    os.environ.setdefault("OPENBLAS_NUM_THREADS", "1")
    try:
        # Imported here: Ctrl-C during an import then ends the command as quietly as later on.
        from ._app import run

        run()
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
