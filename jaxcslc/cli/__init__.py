import sys


def main() -> None:
    """The command `jaxcslc`: wrong input ends it with one line and exit code 2, Ctrl-C with 130."""
    try:
        # Imported here: Ctrl-C during an import then ends the command as quietly as later on.
        from ._app import run

        run()
    except KeyboardInterrupt:
        print("jaxcslc: interrupted", file=sys.stderr)
        raise SystemExit(130) from None
