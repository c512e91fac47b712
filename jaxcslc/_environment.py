"""Libraries, devices and precision of the process: optional extras, NumPy or JAX, cores, float64.

`require` imports what an extra installs, and names the extra if it is missing. The other
functions say which array library, platform and precision a computation has.
"""

import importlib
import os
from types import ModuleType
from typing import Any

import jax
import jax.numpy as jnp
import numpy as np
from jax.core import Tracer


class MissingExtraError(ImportError):
    """A library that an extra of the package installs is needed and is not installed."""


class ExplainedError(ValueError):
    """A wrong value that a page of the documentation explains, other than its module's page.

    - `page`: its name.
    """

    def __init__(self, text: str, page: str) -> None:
        super().__init__(text)
        self.page = page


def require(module: str, extra: str) -> ModuleType:
    """Import a library that the base installation does not have.

    Call it where the library is used: it loads then, and `import jaxcslc` stays quick.

    **Arguments**

    - `module`: name of the module, such as `"clarabel"` or `"matplotlib.figure"`.
    - `extra`: the extra of `jaxcslc` that installs it, as in `pyproject.toml`.

    **Returns** the module.

    **Raises** `MissingExtraError`, with the command that installs it.

    >>> require("math", "sim").sqrt(4.0)
    2.0
    >>> require("missing_library", "sim")
    Traceback (most recent call last):
    ...
    jaxcslc._environment.MissingExtraError: missing_library is not installed: pip install ...
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


def array_namespace(*arrays: Any) -> ModuleType:
    """Return NumPy if all arguments are its arrays or numbers, and JAX's NumPy otherwise.

    One formula, written with the functions of this namespace, computes small sets on the host,
    where nothing is compiled, and large ones in a program that JAX compiles.

    >>> import jax.numpy as jnp, numpy as np
    >>> array_namespace(np.ones(2), 0.5).__name__, array_namespace(np.ones(2), jnp.ones(2)).__name__
    ('numpy', 'jax.numpy')
    """
    return np if all(isinstance(x, np.ndarray | np.generic | float | int) for x in arrays) else jnp


def core_count() -> int:
    """Return the number of cores that this process may use."""
    affinity = getattr(os, "sched_getaffinity", None)  # not on macOS and Windows
    return len(affinity(0)) if affinity else os.cpu_count() or 1


def as_jax(x: Any) -> Any:
    """Convert an array, a number or a tree of them to JAX arrays.

    Converting NumPy arrays compiles nothing, whereas `jnp.asarray` does.

    - `x`: an array, a number, or a tree of them.
    """
    leaves, structure = jax.tree.flatten(x)
    on_host = [i for i, leaf in enumerate(leaves) if not isinstance(leaf, jax.Array)]
    put = jax.device_put([np.asarray(leaves[i]) for i in on_host])
    for i, leaf in zip(on_host, put, strict=True):
        leaves[i] = leaf
    return jax.tree.unflatten(structure, leaves)


def platform_of(*arrays: Any) -> str:
    """Return the platform on which JAX computes with these arrays, such as `"cpu"` or `"gpu"`.

    The default device if they are NumPy's, or traced.

    >>> import jax
    >>> platform_of(jax.device_put(1.0, jax.devices("cpu")[0]))
    'cpu'
    """
    for x in arrays:
        if isinstance(x, jax.Array) and not isinstance(x, Tracer):
            return next(iter(x.devices())).platform
    config: Any = jax.config
    default = config.jax_default_device  # a device, or a platform
    return getattr(default, "platform", default) or jax.default_backend()


def enable_x64() -> None:
    """Let JAX compute in float64, as identification and training need.

    Call it in a program's first lines, before arrays are made. It sets `jax_enable_x64` for the
    whole process. Nothing else in the library changes JAX's configuration.

    >>> import jax.numpy as jnp, jaxcslc as jc
    >>> jc.enable_x64()
    >>> jnp.zeros(()).dtype
    dtype('float64')
    """
    jax.config.update("jax_enable_x64", True)


def require_float64(*arrays: jax.Array | np.ndarray) -> None:
    """Check that JAX computes in float64, as identification needs.

    **Arguments**

    - `arrays`: what is computed with, of any shapes.

    **Raises** `ValueError` unless float64 is switched on and the arrays are in it.
    """
    if not jax.config.read("jax_enable_x64") or any(x.dtype != np.float64 for x in arrays):
        raise ValueError(
            "identification needs float64: call jaxcslc.enable_x64() in the program's first lines"
        )
