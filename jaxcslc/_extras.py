import importlib
from types import ModuleType


class MissingExtraError(ImportError):
    """A library that an extra of the package installs is needed and is not installed.

    >>> raise MissingExtraError("cvxpy is not installed: pip install 'jaxcslc[inertia]'")
    Traceback (most recent call last):
    ...
    jaxcslc._extras.MissingExtraError: cvxpy is not installed: pip install 'jaxcslc[inertia]'
    """


def require(module: str, extra: str) -> ModuleType:
    """Import a library that the base installation does not have.

    Call it where the library is used: it loads then, and `import jaxcslc` stays quick.

    **Arguments**

    - `module`: name of the module, such as `"cvxpy"` or `"matplotlib.figure"`.
    - `extra`: the extra of `jaxcslc` that installs it, as in `pyproject.toml`.

    **Returns** the module.

    **Raises** `MissingExtraError`, with the command that installs it.

    >>> require("math", "sim").sqrt(4.0)
    2.0
    >>> require("no_such_library", "sim")
    Traceback (most recent call last):
    ...
    jaxcslc._extras.MissingExtraError: no_such_library is not installed: pip install 'jaxcslc[sim]'
    """
    try:
        return importlib.import_module(module)
    except ModuleNotFoundError as error:
        # Something else that is missing inside an installed library is not ours to explain.
        if error.name is None or error.name.split(".")[0] != module.split(".")[0]:
            raise
        raise MissingExtraError(
            f"{module} is not installed: pip install 'jaxcslc[{extra}]'", name=error.name
        ) from None
