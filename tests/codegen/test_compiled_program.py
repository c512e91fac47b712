"""Programs in C, against NumPy's operations."""

import shutil
import threading
from collections.abc import Iterator
from pathlib import Path

import numpy as np
import pytest

import jaxcslc as jc
from jaxcslc._processes import processes_beside
from jaxcslc.codegen import CompiledProgram, Motion, _c_function


needs_compiler = pytest.mark.skipif(shutil.which("cc") is None, reason="no C compiler")


@pytest.fixture
def cache(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> Iterator[Path]:
    """A folder of compiled programs, which are none yet."""
    monkeypatch.setenv("XDG_CACHE_HOME", str(tmp_path))
    _c_function._kept_library.cache_clear()
    yield tmp_path / "jaxcslc"
    _c_function._kept_library.cache_clear()
    _c_function._library.cache_clear()


def of_arm(joints: int = 3) -> tuple[Motion, CompiledProgram]:
    """The columns of an arm with all kinds of operations."""
    motion = Motion(joints)
    graph = motion.graph
    values = [motion.q[0], graph.constant(2.5), motion.qd[1]]
    for q, qd, qdd in zip(motion.q, motion.qd, motion.qdd, strict=True):
        sine, cosine = graph.apply("sin", q), graph.apply("cos", q + motion.q[0])
        values += [sine * qdd - cosine * qd * qd, -(sine * cosine) * 0.3, graph.apply("sign", qd)]
        values += [graph.apply("fabs", qd), graph.apply("positive", qdd * qd)]
    values.append(values[3])
    return motion, CompiledProgram(motion, tuple(values))


def wait_for_compiler() -> None:
    """Until no thread compiles; libraries are then looked for anew."""
    for thread in threading.enumerate():
        if thread.name.endswith("(_library)"):
            thread.join(60.0)
    _c_function._kept_library.cache_clear()


def compiled(
    function: CompiledProgram, q: np.ndarray, qd: np.ndarray, qdd: np.ndarray
) -> np.ndarray:
    """What it computes once its code is compiled."""
    with processes_beside():
        function(q, qd, qdd)
    wait_for_compiler()
    return function(q, qd, qdd)


@needs_compiler
@pytest.mark.parametrize("samples", [1, 256, 700])
def test_c_and_numpy_agree_to_the_last_digit(
    cache: Path, rng: np.random.Generator, samples: int
) -> None:
    motion, program = of_arm()
    q, qd, qdd = rng.normal(size=(3, len(motion.q), samples))
    result = compiled(program, q, qd, qdd)
    assert len(list(cache.glob("*.so"))) == 1
    np.testing.assert_array_equal(result, program.program(q, qd, qdd))


@needs_compiler
def test_columns_that_are_not_contiguous(cache: Path, rng: np.random.Generator) -> None:
    motion, program = of_arm()
    q, qd, qdd = (x.T for x in rng.normal(size=(3, 300, len(motion.q))))
    np.testing.assert_array_equal(compiled(program, q, qd, qdd), program.program(q, qd, qdd))
    assert list(cache.glob("*.so"))


@needs_compiler
def test_columns_of_a_robot_are_those_of_numpy(cache: Path, rng: np.random.Generator) -> None:
    network = jc.derive(jc.puma560(), lengths="symbolic")
    motion = rng.normal(size=(3, network.joint_count, 40))
    before = network.columns(*motion)
    with processes_beside():
        _c_function._kept_library.cache_clear()
        network.columns(*motion)
    wait_for_compiler()
    assert list(cache.glob("*.so"))
    for one, other in zip(before, network.columns(*motion), strict=True):
        np.testing.assert_array_equal(one, other)


def test_nothing_is_compiled_unless_it_is_allowed(cache: Path, rng: np.random.Generator) -> None:
    motion, program = of_arm()
    program(*rng.normal(size=(3, len(motion.q), 5)))
    assert not list(cache.glob("*"))


def test_single_precision_is_numpys(cache: Path, rng: np.random.Generator) -> None:
    motion, program = of_arm()
    single = rng.normal(size=(3, len(motion.q), 5)).astype(np.float32)
    with processes_beside():
        assert program(*single).dtype == np.float32
    assert not list(cache.glob("*"))
