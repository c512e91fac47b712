"""Compiled functions: of C code, called with arrays, and of CUDA code, called by JAX.

Everything that is compiled for a processor goes through `CFunction`: it declares the arguments once
and checks every array that it hands to C. `jaxcslc._cache` says where compiled code is kept, and
what is checked of it. NVIDIA's run-time compiler compiles for GPUs.
"""

import atexit
import contextlib
import ctypes
import hashlib
import importlib.util
import os
import platform
import shlex
import shutil
import signal
import subprocess
import time
from collections.abc import Callable, Sequence
from dataclasses import dataclass
from functools import lru_cache, partial
from pathlib import Path
from threading import Lock, Thread
from typing import Any, TypeAlias

import jax
import jax.numpy as jnp
import numpy as np
from jaxtyping import Array

from .._cache import load_kept, make_kept
from .._processes import allows_processes


# Loops of arithmetic become instructions on several numbers, products and sums one instruction.
_OPTIONS = ("-O3", "-fno-math-errno", "-fno-trapping-math", "-shared", "-fPIC")
# What makes a compiler use all that this processor has, by the compiler.
_OF_PROCESSOR = (("-march=native",), ("-mcpu=native",), ())
# A generated program of a thousand lines takes one or two seconds on a processor of its own.
_LONGEST_SECONDS = 30.0
# That the end of a process waits for what is compiled for later ones, mostly while it works itself.
_AT_END_SECONDS = 1.0
_SUFFIX = ".so"

LONG = ctypes.c_long
"""The kind of a whole number."""
INTEGERS = np.dtype(LONG)
"""Whole numbers in arrays, as `LONG`."""


@dataclass(frozen=True)
class CArray:
    """The kind of an argument that is an array, of which C gets the address.

    **Attributes**

    - `axes`: their names; those of one name have one length in a call.
    - `dtype`: of the numbers; None for those that the array has.
    - `written`: whether C writes into it. What C only reads is copied if it is not contiguous, or
      has numbers of another type.
    - `optional`: whether None may stand for it, C's null pointer.
    """

    axes: str
    dtype: Any = float
    written: bool = False
    optional: bool = False

    def passed(self, x: Any, lengths: dict[str, int]) -> Any:
        """Return what C gets. The lengths of axes are added to those of the arguments before it.

        **Raises** `ValueError` for an array of another kind.
        """
        if x is None and self.optional:
            return None
        x = x if self.written else np.ascontiguousarray(x, self.dtype)
        names = self.axes.split()
        if (
            x.ndim != len(names)
            or any(lengths.setdefault(i, n) != n for i, n in zip(names, x.shape, strict=True))
            or (self.written and not (x.dtype == self.dtype and x.flags.carray))
        ):
            known = ", ".join(f"{name} {lengths[name]}" for name in names if name in lengths)
            dtype = np.dtype(self.dtype or x.dtype)
            raise ValueError(
                f"expected a contiguous {dtype} array of ({known or self.axes}),"
                f" got a {x.dtype} one of {x.shape}"
            )
        return x.ctypes.data_as(ctypes.c_void_p)  # which keeps the array


@dataclass(frozen=True)
class CRows:
    """The kind of an argument that is rows of float64, of which C gets an array of addresses.

    **Attributes**

    - `axis`: the name of their length.
    - `written`: as of `CArray`.
    """

    axis: str
    written: bool = False

    def passed(self, rows: Sequence[np.ndarray], lengths: dict[str, int]) -> Any:
        """Return the argument as `CArray.passed` does."""
        if not self.written:
            rows = [np.ascontiguousarray(row, float) for row in rows]
        alike = rows and len({(row.shape, row.dtype, row.flags.carray) for row in rows}) == 1
        # One check for all: of hundreds of rows, checks take longer than what C computes of them.
        for row in rows[:1] if alike else rows:
            CArray(self.axis, written=self.written).passed(row, lengths)
        addresses: Any = (ctypes.c_void_p * len(rows))(*(row.ctypes.data for row in rows))
        addresses.kept = rows  # as long as the addresses
        return addresses


Kind: TypeAlias = CArray | CRows | type[Any]


@dataclass(frozen=True)
class CFunction:
    """A function of C code that is compiled when it is first needed, and called with arrays.

    **Attributes**

    - `source`: C code; the function in it returns nothing.
    - `name`: of the function.
    - `arguments`: the kind of each: an `CArray`, `CRows`, or a type of `ctypes`, such as `LONG`.
    - `options`: of the compiler, after the usual ones: `-O1` for code that optimising barely helps.

    >>> import numpy as np
    >>> source = "void twice(double* x, long n) { for (long i = 0; i < n; ++i) x[i] *= 2.0; }"
    >>> twice = CFunction(source, "twice", (CArray("numbers", written=True), LONG))
    >>> x = np.array([1.0, 2.0])
    >>> if twice.is_available:
    ...     twice(x, len(x))
    ...     assert x.tolist() == [2.0, 4.0]
    """

    source: str
    name: str
    arguments: tuple[Kind, ...]
    options: tuple[str, ...] = ()

    @property
    def is_available(self) -> bool:
        """True if it can be called; compiled now if there is a compiler."""
        return _library(self.source, self.options, _compiler()) is not None

    @property
    def is_kept(self) -> bool:
        """True if it can be called without waiting for a compiler.

        If not, a thread begins to compile it for a later process: only in programs that allow
        processes beside them. The end of this one waits a second for it, and stops it then.
        """
        return _kept_library(self.source, self.options, _compiler()) is not None

    def __call__(self, *arguments: Any) -> None:
        """Call it.

        **Raises**

        - `OSError`: if there is no C compiler.
        - `TypeError`: for another number of arguments.
        - `ValueError`: for an array that is not of its argument's kind.
        """
        self.bound()(*arguments)

    def bound(self, *first: Any) -> Callable[..., None]:
        """Return the function of the arguments that follow the first ones, which are checked once.

        **Raises** as a call.
        """
        library = _library(self.source, self.options, _compiler())
        if library is None:
            raise OSError(
                "no C compiler; expected cc, or the one that the environment variable CC names"
            )
        lengths: dict[str, int] = {}
        values = self._passed(self.arguments[: len(first)], first, lengths)
        remaining = self.arguments[len(first) :]

        def call(*others: Any) -> None:
            function(*values, *self._passed(remaining, others, dict(lengths)))

        function = getattr(library, self.name)
        function.restype = None
        function.argtypes = [
            ctypes.c_void_p if isinstance(kind, CArray | CRows) else kind for kind in self.arguments
        ]
        return call

    def _passed(
        self, kinds: Sequence[Kind], arguments: Sequence[Any], lengths: dict[str, int]
    ) -> list[Any]:
        if len(kinds) != len(arguments):
            raise TypeError(f"{self.name}: expected {len(kinds)} arguments, got {len(arguments)}")
        try:
            return [
                kind.passed(x, lengths) if isinstance(kind, CArray | CRows) else x
                for kind, x in zip(kinds, arguments, strict=True)
            ]
        except ValueError as error:
            raise ValueError(f"{self.name}: {error}") from None


@lru_cache(maxsize=32)
def _library(source: str, options: tuple[str, ...], compiler: str) -> ctypes.CDLL | None:
    """Return C code compiled for this processor and loaded; None where there is no compiler.

    A program that does not compile is as good as no compiler: what calls it has another way, which
    is slower.
    """
    command, key = _command(source, options, compiler)
    if not command:
        return None
    try:
        loaded = load_kept(key, _SUFFIX, _loaded)
        if loaded is not None:
            return loaded
        return make_kept(key, _SUFFIX, partial(_compile, source, command), _loaded)
    except OSError:
        return None


@lru_cache(maxsize=32)
def _kept_library(source: str, options: tuple[str, ...], compiler: str) -> ctypes.CDLL | None:
    command, key = _command(source, options, compiler)
    loaded = load_kept(key, _SUFFIX, _loaded) if command else None
    if command and loaded is None and allows_processes():
        thread = Thread(target=_library, args=(source, options, compiler), daemon=True)
        _BESIDE.add(thread)
        thread.start()
    return loaded


def _compiler() -> str:
    """The environment's `CC`, or `cc`; an empty `CC` asks for none."""
    return os.environ.get("CC", "cc")


def _command(source: str, options: tuple[str, ...], compiler: str) -> tuple[list[str], str]:
    """The compiler's command, empty without one, and the key under which the library is kept."""
    try:
        command = shlex.split(compiler)
    except ValueError:  # a quotation that does not end
        command = []
    program = shutil.which(command[0]) if command else None
    if program is None:
        return [], ""
    command += [*_OPTIONS, *options]
    # A program for one processor may not run on another that shares the folder.
    what = (source, *command, os.stat(program).st_mtime_ns, _processor())
    return command, hashlib.sha256(repr(what).encode()).hexdigest()[:32]


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
        status = _RUNNING.run([*command, *of_processor, text, "-o", library, "-lm"])
        if status is None:
            break
        if status == 0:
            return True
    return False


class _Compilers:
    """Compilers that run, with the processes that they started, and the end of all of them."""

    def __init__(self) -> None:
        self._processes: set[subprocess.Popen[bytes]] = set()
        self._lock, self._ended = Lock(), False

    def run(self, command: Sequence[str | Path]) -> int | None:
        """Return the status of a command; None if it took too long, or was ended."""
        nothing = subprocess.DEVNULL
        with self._lock:
            if self._ended:
                return None
            process = subprocess.Popen(
                command, stdin=nothing, stdout=nothing, stderr=nothing, start_new_session=True
            )
            self._processes.add(process)
        try:
            status = process.wait(_LONGEST_SECONDS)
        except subprocess.TimeoutExpired:
            return None
        finally:
            self._processes.discard(process)
            _end(process)
        return None if self._ended else status

    def end(self) -> None:
        with self._lock:
            self._ended = True
            for process in [*self._processes]:
                _end(process)


def _end(process: "subprocess.Popen[bytes]") -> None:
    """End a process and those of its session, if it has not ended."""
    if process.poll() is None:
        with contextlib.suppress(OSError):
            os.killpg(process.pid, signal.SIGKILL)
        process.wait()


_RUNNING = _Compilers()
_BESIDE: set[Thread] = set()


@atexit.register
def _end_all() -> None:
    until = time.monotonic() + _AT_END_SECONDS
    for thread in _BESIDE:
        thread.join(max(until - time.monotonic(), 0.0))
    _RUNNING.end()
    for thread in _BESIDE:
        thread.join()  # which only removes its scratch now


@lru_cache(maxsize=1)
def _processor() -> str:
    """Return a description of this machine's processor and its abilities."""
    try:
        lines = Path("/proc/cpuinfo").read_text().splitlines()
    except OSError:  # not Linux: one machine's folder
        return f"{platform.node()} {platform.processor()}"
    of_interest = ("model name", "flags", "CPU part", "Features", "isa")
    return "\n".join(sorted({line for line in lines if line.startswith(of_interest)}))


# Of an H100, where the device does not say how many it has.
_MULTIPROCESSORS = 132
SHARED_MEMORY, BLOCK_OVERHEAD = 227 * 1024, 1024
"""Shared memory of an H100's multiprocessor, and what the system takes for a block [bytes]."""
# Those with matrix units for float64.
_LEAST_CAPABILITY = 8.0


def multiprocessors() -> int:
    """Number of multiprocessors of JAX's default device."""
    return int(getattr(jax.devices()[0], "core_count", _MULTIPROCESSORS))


@dataclass(frozen=True)
class Kernel:
    """A function for an NVIDIA GPU: CUDA C, how it is launched, and what it writes.

    **Attributes**

    - `name`: of the function in `source`, which is `extern "C"` and takes pointers: inputs, then
      outputs.
    - `threads`, `shared_bytes`: of a block.
    """

    name: str
    source: str
    threads: int
    shared_bytes: int = 0

    def __call__(
        self, blocks: int, outputs: Sequence[jax.ShapeDtypeStruct], *inputs: Array
    ) -> Sequence[Array]:
        """Launches it, as a part of what JAX traces.

        **Raises** `RuntimeError` if the source does not compile.
        """
        capability = str(getattr(jax.devices()[0], "compute_capability", "9.0"))
        call = jax.ffi.ffi_call("__gpu$xla.gpu.ptx", tuple(outputs))
        sizes = {f"{what}_{axis}": np.int32(1) for what in ("grid", "block") for axis in "xyz"}
        sizes |= {"grid_x": np.int32(blocks), "block_x": np.int32(self.threads)}
        return call(
            *inputs,
            name=self.name,
            kernel_type="ptx",
            kernel_data=assembly(self.source, capability.replace(".", "")),
            shared_mem_bytes=np.int32(self.shared_bytes),
            **sizes,
        )


@lru_cache(maxsize=64)
def assembly(source: str, architecture: str = "90") -> str:
    """PTX of CUDA C, by NVIDIA's run-time compiler.

    **Raises**

    - `OSError`: if the compiler is not installed; JAX's packages for CUDA have it.
    - `RuntimeError`: with what the compiler says, if the source does not compile.
    """
    library = _nvrtc()
    program = ctypes.c_void_p()
    _check(library, library.nvrtcCreateProgram(
        ctypes.byref(program), source.encode(), b"kernel.cu", 0, None, None
    ))  # fmt: skip
    options = [f"--gpu-architecture=compute_{architecture}".encode(), b"--std=c++17"]
    status = library.nvrtcCompileProgram(
        program, len(options), (ctypes.c_char_p * len(options))(*options)
    )
    if status:
        log = _text(library, program, "ProgramLog")
        raise RuntimeError(f"a generated kernel does not compile: {log}")
    text = _text(library, program, "PTX")
    library.nvrtcDestroyProgram(ctypes.byref(program))
    return text


def _text(library: Any, program: ctypes.c_void_p, what: str) -> str:
    size = ctypes.c_size_t()
    _check(library, getattr(library, f"nvrtcGet{what}Size")(program, ctypes.byref(size)))
    buffer = ctypes.create_string_buffer(size.value)
    _check(library, getattr(library, f"nvrtcGet{what}")(program, buffer))
    return buffer.value.decode()


def _check(library: Any, status: int) -> None:
    if status:
        library.nvrtcGetErrorString.restype = ctypes.c_char_p
        raise RuntimeError(f"NVRTC: {library.nvrtcGetErrorString(status).decode()}")


@lru_cache(maxsize=1)
def _nvrtc() -> Any:
    """NVIDIA's run-time compiler, of the packages that JAX installs or of the system."""
    spec = importlib.util.find_spec("nvidia")
    folders = [] if spec is None else list(spec.submodule_search_locations or [])
    files = [file for folder in folders for file in sorted(Path(folder).rglob("libnvrtc.so*"))]
    for name in [*map(str, files), "libnvrtc.so.13", "libnvrtc.so.12", "libnvrtc.so"]:
        for part in Path(name).parent.glob("libnvrtc-builtins.so*"):  # which it looks for by name
            ctypes.CDLL(str(part))
        try:
            return ctypes.CDLL(name)
        except OSError:
            continue
    raise OSError("NVIDIA's run-time compiler is not installed: pip install 'jax[cuda13]'")


_PROBE = """
extern "C" __global__ void probe(const double* x, double* y)
{
    y[threadIdx.x] = 2.0 * x[threadIdx.x];
}
"""


@lru_cache(maxsize=1)
def kernels_run() -> bool:
    """Return whether kernels of ours compile and run on JAX's default device: on an NVIDIA GPU.

    Of compute capability 8.0 or more, which have matrix units for float64.
    """
    device = jax.devices()[0]
    capability = getattr(device, "compute_capability", None)
    if device.platform != "gpu" or capability is None or float(capability) < _LEAST_CAPABILITY:
        return False
    try:
        with jax.ensure_compile_time_eval():
            x = jnp.arange(32.0, dtype=jnp.float64)
            like = jax.ShapeDtypeStruct(x.shape, x.dtype)
            (y,) = jax.jit(lambda x: Kernel("probe", _PROBE, 32)(1, [like], x))(x)
            return bool(jnp.all(y == 2.0 * x))
    except (OSError, RuntimeError, ValueError):  # no compiler, or an XLA without such calls
        return False
