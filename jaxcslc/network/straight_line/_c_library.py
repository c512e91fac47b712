import ctypes
import hashlib
import os
import platform
import shlex
import shutil
import subprocess
import tempfile
from functools import lru_cache
from pathlib import Path
from threading import Thread
from typing import Any

import jax

from ..._processes import allows_processes


# Loops of arithmetic become instructions on several numbers, products and sums one instruction.
_OPTIONS = ("-O3", "-fno-math-errno", "-fno-trapping-math", "-shared", "-fPIC")
# What makes a compiler use all that this processor has, by the compiler.
_OF_PROCESSOR = (("-march=native",), ("-mcpu=native",), ())
# A generated program of a thousand lines takes one or two seconds.
_LONGEST_SECONDS = 120.0


@lru_cache(maxsize=32)
def c_library(source: str, options: tuple[str, ...] = ()) -> ctypes.CDLL | None:
    """C code compiled for this processor and loaded; None where there is no compiler.

    The compiler is the environment's `CC`, or `cc`; an empty `CC` asks for none. A program that
    does not compile is as good as no compiler: what calls it has another way, which is slower.
    Where JAX keeps compiled programs on disk, this does; otherwise nothing stays there.

    - `options`: of the compiler, after the usual ones: `-O1` for code that optimising hardly helps.

    >>> library = c_library("double twice(double x) { return 2.0 * x; }")
    >>> if library is not None:
    ...     library.twice.argtypes, library.twice.restype = [ctypes.c_double], ctypes.c_double
    ...     assert library.twice(3.0) == 6.0
    """
    command, kept = _kept(source, options)
    if not command:
        return None
    try:
        if kept is None:
            with tempfile.TemporaryDirectory(prefix="jaxcslc-") as folder:
                library = Path(folder) / "loops.so"
                return _loaded(library) if _compile(source, command, library) else None
        if kept.exists() and (library := _loaded(kept)) is not None:
            return library
        kept.parent.mkdir(parents=True, exist_ok=True)
        with tempfile.TemporaryDirectory(prefix="jaxcslc-", dir=kept.parent) as folder:
            fresh = Path(folder) / "loops.so"
            if not _compile(source, command, fresh):
                return None
            os.replace(fresh, kept)  # whole or not at all, whoever else does the same
        return _loaded(kept)
    except (OSError, subprocess.TimeoutExpired):
        return None


@lru_cache(maxsize=32)
def kept_c_library(source: str, options: tuple[str, ...] = ()) -> ctypes.CDLL | None:
    """The library of `c_library` if it is on disk already, where JAX keeps compiled programs.

    Otherwise None, and a thread begins to compile it for a later process, which the end of this one
    waits for: only in programs that allow processes beside them.
    """
    command, kept = _kept(source, options)
    if not command or kept is None:
        return None
    if kept.exists():
        return _loaded(kept)
    if allows_processes():
        Thread(target=c_library, args=(source, options)).start()
    return None


def _kept(source: str, options: tuple[str, ...]) -> tuple[list[str], Path | None]:
    """The compiler's command, empty without one; and where the library is kept, if anywhere."""
    command = shlex.split(os.environ.get("CC", "cc"))
    compiler = shutil.which(command[0]) if command else None
    if compiler is None:
        return [], None
    command += [*_OPTIONS, *options]
    config: Any = jax.config
    cache = config.jax_compilation_cache_dir
    if not cache:
        return command, None
    # A program for one processor may not run on another that shares the folder.
    what = (source, *command, os.stat(compiler).st_mtime_ns, _processor())
    name = hashlib.sha256(repr(what).encode()).hexdigest()
    return command, Path(cache) / f"jaxcslc-{name}.so"


def _loaded(library: Path) -> ctypes.CDLL | None:
    """None for a file that is not a library, as when a disk was full."""
    try:
        return ctypes.CDLL(str(library))
    except OSError:
        return None


def _compile(source: str, command: list[str], library: Path) -> bool:
    text = library.with_suffix(".c")
    text.write_text(source)
    for of_processor in _OF_PROCESSOR:
        arguments = [*command, *of_processor, text, "-o", library, "-lm"]
        done = subprocess.run(arguments, capture_output=True, check=False, timeout=_LONGEST_SECONDS)
        if done.returncode == 0:
            return True
    return False


def _processor() -> str:
    """What this machine's processor is and can do."""
    try:
        lines = Path("/proc/cpuinfo").read_text().splitlines()
    except OSError:  # not Linux: one machine's folder
        return f"{platform.node()} {platform.processor()}"
    of_interest = ("model name", "flags", "CPU part", "Features", "isa")
    return "\n".join(sorted({line for line in lines if line.startswith(of_interest)}))
