import ctypes
import shutil
import subprocess
from collections.abc import Callable
from pathlib import Path

import numpy as np
import pytest
from jaxtyping import Float

import jaxcslc as jc


Compiled = Callable[..., Float[np.ndarray, " values"]]
_STRICT = ("-std=c99", "-Wall", "-Wextra", "-Werror", "-pedantic", "-Wmissing-prototypes")


def _compile(code: jc.CCode, folder: Path) -> ctypes.CDLL:
    (folder / f"{code.name}.h").write_text(code.header, encoding="ascii")
    (folder / f"{code.name}.c").write_text(code.source, encoding="ascii")
    library = folder / f"{code.name}.so"
    command = ["cc", *_STRICT, "-shared", "-fPIC", "-o", library, folder / f"{code.name}.c", "-lm"]
    done = subprocess.run([str(part) for part in command], capture_output=True, text=True)
    assert done.returncode == 0, done.stderr
    return ctypes.CDLL(str(library))


@pytest.fixture
def compiled(tmp_path: Path) -> Callable[[jc.CCode], Callable[..., Float[np.ndarray, "..."]]]:
    """Compiles C code strictly; gives a function `(name, *inputs, size)` that calls it."""
    if shutil.which("cc") is None:
        pytest.skip("no C compiler (cc) on this machine")

    def build(code: jc.CCode) -> Compiled:
        library = _compile(code, tmp_path)

        def call(name: str, *inputs: np.ndarray, size: int) -> Float[np.ndarray, " values"]:
            result = np.full(size, np.nan)
            arrays = [*(np.ascontiguousarray(x, dtype=float) for x in inputs), result]
            pointers = [x.ctypes.data_as(ctypes.POINTER(ctypes.c_double)) for x in arrays]
            getattr(library, f"{code.name}_{name}")(*pointers)
            return result

        return call

    return build
