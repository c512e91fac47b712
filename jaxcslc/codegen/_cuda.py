"""Functions for NVIDIA GPUs, compiled by NVIDIA's run-time compiler and called by JAX."""

import ctypes
import importlib.util
from collections.abc import Sequence
from dataclasses import dataclass
from functools import lru_cache
from pathlib import Path
from typing import Any

import jax
import jax.numpy as jnp
import numpy as np
from jaxtyping import Array


# Of an H100, where the device does not say how many it has.
_MULTIPROCESSORS = 132
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
    library = _library()
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
def _library() -> Any:
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
