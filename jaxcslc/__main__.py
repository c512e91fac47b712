"""The command `jaxcslc`, as `python -m jaxcslc`."""

from .cli import main


if __name__ == "__main__":
    main()
