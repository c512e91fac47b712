"""Settings that hold for every test, those in docstrings included.

Fixtures are in `tests/conftest.py`.
"""

import ctypes
import dataclasses
import functools
import gc
import importlib
import inspect
import os
import sys
import threading
from collections.abc import Callable
from importlib.metadata import version
from pathlib import Path
from types import CodeType, FunctionType
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
os.environ["XDG_CACHE_HOME"] = str(Path(__file__).parent / ".cache")
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


# Byte code is kept even where the environment says that it isn't: otherwise every worker and every
# program that a test starts compiles the package again, and pytest rewrites the tests' assertions.
os.environ.pop("PYTHONDONTWRITEBYTECODE", None)
sys.dont_write_bytecode = False


# Every program is lowered in a context of MLIR of its own, and one with its dialects takes 5 ms to
# make. A thread uses one for many programs; not for all, since it keeps what they consist of. A
# program that is compiled while another is lowered needs its own: a copy of its module would become
# a part of the other's.
_PROGRAMS_OF_A_CONTEXT = 200


def _reuse_contexts(module: Any) -> None:
    make = module.make_ir_context
    kept = threading.local()

    def context() -> Any:
        if module.ir.Context.current is not None:
            return make()
        uses, one = getattr(kept, "context", (0, None))
        if uses % _PROGRAMS_OF_A_CONTEXT == 0:
            one = make()
        kept.context = uses + 1, one
        return one

    module.make_ir_context = context


if version("jax").startswith("0.10."):
    _reuse_contexts(importlib.import_module("jax._src.interpreters.mlir"))


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
# function around it ran: two thirds of the time of a recording. In each file of tests, every
# function's first calls are checked; then, among the first of each test, those with arguments of
# types and shapes that are new in the file; of many, some. Checking first calls anew in each test
# took a fifth of the suite's time.
_ALL_CHECKED = 3
_OTHERS_CHECKED = 20  # first calls of a test
_CHECKED_LATER = 100  # one in so many

_check_annotations: Any = jaxtyping.jaxtyped


class _Calls:
    """Calls of a function, or of all functions with its code if it is local to another."""

    __slots__ = ("checks", "count", "first", "kinds")

    def __init__(self) -> None:
        self.count = 0  # in this test
        self.first = 0  # checked in this file of tests, up to `_ALL_CHECKED`
        self.kinds: set[Any] = set()  # checked in this file of tests
        # How a local function is checked: for each set of annotations, a function that calls the
        # one on top of `_running`.
        self.checks: list[tuple[dict[str, Any], Callable[..., Any]]] = []


_called: set[_Calls] = set()  # in this file of tests
_local: dict[CodeType, _Calls] = {}
_running = threading.local()


def _checked_at_first(function: Any = None, *, typechecker: Any) -> Any:
    """In place of `jaxtyping.jaxtyped`, which the import hook puts on functions and classes."""
    if function is None:
        return functools.partial(_checked_at_first, typechecker=typechecker)
    if inspect.isclass(function):
        made = function.__init__
        if (
            dataclasses.is_dataclass(function)
            and getattr(made, "__globals__", None) is not globals()
        ):
            function.__init__ = _checked_at_first(made, typechecker=typechecker)
        return function
    if not inspect.isfunction(function):
        return _check_annotations(function, typechecker=typechecker)
    local = "<locals>" in function.__qualname__
    calls = _local.setdefault(function.__code__, _Calls()) if local else _Calls()
    checked: Callable[..., Any] | None = None

    @functools.wraps(function)
    def call(*args: Any, **kwargs: Any) -> Any:
        nonlocal checked
        calls.count = count = calls.count + 1
        if count > _OTHERS_CHECKED and count % _CHECKED_LATER:
            return function(*args, **kwargs)
        if count == 1:
            _called.add(calls)
        kinds = None
        if count <= _OTHERS_CHECKED:
            kinds = (*map(_kind, args), *kwargs, *map(_kind, kwargs.values()))
            if calls.first == _ALL_CHECKED and kinds in calls.kinds:
                return function(*args, **kwargs)
        calls.first = min(calls.first + 1, _ALL_CHECKED)
        if checked is None:
            prepare = _checked_local if local else _check_annotations
            checked = prepare(function, typechecker=typechecker)
            assert checked is not None
        result = checked(*args, **kwargs)
        calls.kinds.add(kinds)  # not where the check failed
        return result

    return call


def _kind(argument: Any) -> Any:
    """Its type, and what there is to know of an array before its values."""
    shape = getattr(argument, "shape", None)
    if type(shape) is not tuple:
        return type(argument)
    return type(argument), shape, getattr(argument, "dtype", None)


def _checked_local(function: Any, *, typechecker: Any) -> Callable[..., Any]:
    """The function with its checks, which are those of an earlier one with its code."""
    checks = _local[function.__code__].checks
    known = [check for annotations, check in checks if annotations == function.__annotations__]
    check: Any = known[0] if known else None
    if check is None:
        check = _check_annotations(_stand_in(function), typechecker=typechecker)
        checks.append((function.__annotations__, check))

    def call(*args: Any, **kwargs: Any) -> Any:
        functions = _running.__dict__.setdefault("functions", [])
        before = len(functions)
        functions.append(function)
        try:
            return check(*args, **kwargs)
        finally:
            del functions[before:]

    return call


def _stand_in(function: Any) -> Any:
    """A function with another's signature that calls the one on top of `_running`."""
    running = _running

    def run(*args: Any, **kwargs: Any) -> Any:
        return running.functions.pop()(*args, **kwargs)

    # Strings among the annotations are looked up in the globals of the function.
    one: Any = FunctionType(run.__code__, function.__globals__, closure=run.__closure__)
    for name in ("__name__", "__qualname__", "__module__", "__annotations__"):
        setattr(one, name, getattr(function, name))
    one.__signature__ = inspect.signature(function)
    return one


jaxtyping.jaxtyped = _checked_at_first


def pytest_runtest_setup() -> None:
    """Calls are counted in each test."""
    for calls in _called:
        calls.count = 0


# A compiled program takes 1.3 MB and some memory maps, of which Linux allows a process 65,530: with
# every program of the suite, a worker would take 10 GB, or end when it loads one too many.
_MOST_MAPS = 40_000
_MOST_MEMORY = 2_000_000  # kB


def pytest_runtest_teardown(item: pytest.Item, nextitem: pytest.Item | None) -> None:
    """Between files, annotations are checked anew, and many compiled programs forgotten."""
    if nextitem is not None and nextitem.path == item.path:
        return
    for calls in _called:
        calls.count = calls.first = 0
        calls.kinds.clear()
    _called.clear()
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
