"""Settings that hold for every test, those in docstrings included.

Fixtures are in `tests/conftest.py`.
"""

import gc
import os
from pathlib import Path


# Read once, when the libraries below are loaded, and inherited by the workers of `pytest -n`. One
# thread each: workers that share cores with each other's threads took twice as long over products
# and factorisations. Pictures are drawn to files, on machines with and without a screen.
os.environ["OPENBLAS_NUM_THREADS"] = "1"
os.environ["MPLBACKEND"] = "Agg"

import hypothesis
import jax
import pytest


# Identification is float64 work, and an axis that JAX adds silently is a mistake. MJX broadcasts
# so inside: call it under `jax.numpy_rank_promotion("allow")`.
jax.config.update("jax_enable_x64", True)
jax.config.update("jax_numpy_rank_promotion", "raise")

# Compiling is most of the suite's time: optimise less (a third less time with an empty cache), and
# keep what took long, for the other worker and later runs.
jax.config.update("jax_disable_most_optimizations", True)
jax.config.update("jax_compilation_cache_dir", str(Path(__file__).parent / ".cache" / "jax"))
jax.config.update("jax_persistent_cache_min_compile_time_secs", 0.2)

# The same examples in every run, however slow the machine.
hypothesis.settings.register_profile("repeatable", derandomize=True, deadline=None, database=None)
hypothesis.settings.load_profile("repeatable")

# Every compiled program takes some memory maps of a process, and Linux allows 65,530 of them: some
# thousand tests in one worker reach it, and the next program that is loaded ends the worker.
_MOST_MAPS = 30_000


def pytest_runtest_teardown(item: pytest.Item, nextitem: pytest.Item | None) -> None:
    """Between modules, forgets compiled programs if there are many."""
    if nextitem is not None and nextitem.path == item.path:
        return
    maps = Path("/proc/self/maps")
    if maps.exists() and maps.read_bytes().count(b"\n") > _MOST_MAPS:
        jax.clear_caches()
        gc.collect()
