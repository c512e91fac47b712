"""Exported C code in a shared library."""

import ctypes
import subprocess
import tempfile
from pathlib import Path

import jaxcslc as jc


def shared_library(code: jc.CCode, source: str) -> ctypes.CDLL:
    """Compiles C source with the header of exported code, and loads it.

    **Arguments**

    - `source`: the exported code and functions that call it.

    **Raises** `subprocess.CalledProcessError` if the compiler fails.
    """
    with tempfile.TemporaryDirectory() as name:
        folder = Path(name)
        (folder / f"{code.name}.h").write_text(code.header)
        (folder / "timed.c").write_text(source)
        library = folder / "timed.so"
        command = ["cc", "-std=c99", "-O2", "-march=native", "-shared", "-fPIC"]
        subprocess.run([*command, "-o", library, folder / "timed.c", "-lm"], check=True)
        return ctypes.CDLL(str(library))
