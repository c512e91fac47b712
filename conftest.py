"""Settings that hold for every test, those in docstrings included.

Fixtures are in `tests/conftest.py`.
"""

import ctypes
import functools
import gc
import inspect
import os
from collections import Counter
from collections.abc import Callable
from importlib.metadata import version
from pathlib import Path
from types import CodeType
from typing import Any


# Read once, when the libraries below are loaded, and inherited by the workers of `pytest -n`, by
# the kernels of notebooks and by every other program that a test starts. One thread each: workers
# that share cores with each other's threads took twice as long over products and factorisations.
# Pictures are drawn to files, on machines with and without a screen.
os.environ["OPENBLAS_NUM_THREADS"] = "1"
os.environ["MPLBACKEND"] = "Agg"

# Optimise less (a third less time with an empty cache), and keep every program, for the other
# worker, for later runs, and for this worker after it has forgotten its programs: reading one takes
# half the time of compiling the smallest.
os.environ["JAX_DISABLE_MOST_OPTIMIZATIONS"] = "true"
os.environ["JAX_COMPILATION_CACHE_DIR"] = str(Path(__file__).parent / ".cache" / "jax")
os.environ["JAX_PERSISTENT_CACHE_MIN_COMPILE_TIME_SECS"] = "0"
os.environ["JAX_PERSISTENT_CACHE_MIN_ENTRY_SIZE_BYTES"] = "-1"

# Compiling is most of the suite's time. XLA's fusion emitters lower every loop through several
# dialects of MLIR: without them, programs of this size compile in three quarters of the time.
# Splitting a program, so that several threads generate its code, costs more in all. XLA ends the
# process over a flag that it does not know, and later versions do not know the first one.
if version("jaxlib").startswith("0.10."):
    os.environ["XLA_FLAGS"] = " ".join(
        [
            os.environ.get("XLA_FLAGS", ""),
            "--xla_cpu_use_fusion_emitters=false",
            "--xla_cpu_parallel_codegen_split_count=1",
        ]
    ).strip()

import hypothesis
import jax
import jaxtyping
import pytest


# Identification is float64 work, and an axis that JAX adds silently is a mistake. MJX broadcasts
# so inside: call it under `jax.numpy_rank_promotion("allow")`. Programs that tests start switch
# float64 on themselves.
jax.config.update("jax_enable_x64", True)
jax.config.update("jax_numpy_rank_promotion", "raise")

# The same examples in every run, however slow the machine.
hypothesis.settings.register_profile("repeatable", derandomize=True, deadline=None, database=None)
hypothesis.settings.load_profile("repeatable")

# Tracing makes many objects that live long: the default, a collection every 700 objects, spent a
# twentieth of the suite's time on visiting them.
gc.set_threshold(50_000, 20, 20)

# Annotations are checked at run time by jaxtyping's import hook. A check takes 60 µs, a simulated
# sample had forty of them, and a local function was prepared for its checks (1 ms) whenever the
# function around it ran: two thirds of the time of a recording. In each test, every function's
# first calls are checked, and of the later ones some.
_ALL_CHECKED = 20
_CHECKED_LATER = 100  # one in so many

_calls: Counter[CodeType] = Counter()
_check_annotations: Any = jaxtyping.jaxtyped


def _checked_at_first(function: Any = None, *, typechecker: Any) -> Any:
    """In place of `jaxtyping.jaxtyped`, which the import hook puts on functions and classes."""
    if function is None:
        return functools.partial(_checked_at_first, typechecker=typechecker)
    if not inspect.isfunction(function):
        return _check_annotations(function, typechecker=typechecker)
    code = function.__code__
    checked: Callable[..., Any] | None = None

    @functools.wraps(function)
    def call(*args: Any, **kwargs: Any) -> Any:
        nonlocal checked
        _calls[code] = count = _calls[code] + 1
        if count > _ALL_CHECKED and count % _CHECKED_LATER:
            return function(*args, **kwargs)
        checked = checked or _check_annotations(function, typechecker=typechecker)
        assert checked is not None
        return checked(*args, **kwargs)

    return call


jaxtyping.jaxtyped = _checked_at_first


def pytest_runtest_setup() -> None:
    """Each test's first calls are checked."""
    _calls.clear()


# A compiled program takes 1.3 MB and some memory maps, of which Linux allows a process 65,530: with
# every program of the suite, a worker would take 10 GB, or end when it loads one too many.
_MOST_MAPS = 30_000
_MOST_MEMORY = 1_300_000  # kB


def pytest_runtest_teardown(item: pytest.Item, nextitem: pytest.Item | None) -> None:
    """Between modules, forgets compiled programs if there are many."""
    if nextitem is not None and nextitem.path == item.path:
        return
    status, maps = Path("/proc/self/status"), Path("/proc/self/maps")
    if not (status.exists() and maps.exists()):  # not Linux
        return
    lines = dict(line.split(":", 1) for line in status.read_text().splitlines())
    memory = int(lines["VmRSS"].split()[0])
    if memory > _MOST_MEMORY or maps.read_bytes().count(b"\n") > _MOST_MAPS:
        jax.clear_caches()
        gc.collect()
        # What is freed in small pieces stays with the process until it is asked to return it.
        if trim := getattr(ctypes.CDLL(None), "malloc_trim", None):
            trim(0)
