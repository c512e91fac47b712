"""Straight-line code: the same numbers as the loop over links, with fewer operations."""

from collections.abc import Iterator
from typing import Any

import jax
import jax.numpy as jnp
import numpy as np
import pytest
from numpy.testing import assert_array_equal

import jaxcslc
from jaxcslc.codegen import StraightLine, array_outputs, by_platform, named
from jaxcslc.manipulator import Manipulator
from jaxcslc.network import RigidBodyRecursion, code
from tests import arms


ROUNDING = 1e-12
ROBOTS = {"panda": jaxcslc.panda, "puma560": jaxcslc.puma560, "tree": lambda: arms.TREE}


@pytest.fixture(params=list(ROBOTS), scope="module")
def term(request: pytest.FixtureRequest) -> RigidBodyRecursion:
    network = jaxcslc.derive(ROBOTS[request.param](), lengths="numeric", evaluator="rolled")
    assert isinstance(network.rigid_body, RigidBodyRecursion)
    return network.rigid_body


def outputs(code: StraightLine, k: np.ndarray, *motion: np.ndarray) -> np.ndarray:
    inputs = named("k", k)
    for name, values in zip(("q", "qd", "qdd"), motion, strict=False):
        inputs |= named(name, values.T)
    values = array_outputs(code.graph, code.outputs, inputs)
    return np.stack([np.broadcast_to(x, motion[0].shape[:1]) for x in values], axis=1)


def states(rng: np.random.Generator, term: RigidBodyRecursion) -> tuple[Any, ...]:
    return rng.normal(size=term.size), *rng.uniform(-3, 3, (3, 16, len(term.joints)))


def assert_equal(actual: Any, expected: Any) -> None:
    expected = np.asarray(expected)
    assert np.max(np.abs(np.asarray(actual) - expected)) <= ROUNDING * np.max(np.abs(expected))


def test_torque_columns_and_mass_matrix(term: RigidBodyRecursion, rng: np.random.Generator) -> None:
    k, q, qd, qdd = states(rng, term)
    n = len(term.joints)
    regressor = outputs(code(term, "regressor"), k, q, qd, qdd).reshape(16, n, term.size)
    rolled = np.zeros_like(regressor)
    for joint, (row, values) in enumerate(
        zip(term.support, term.columns(q.T, qd.T, qdd.T), strict=True)
    ):
        rolled[:, joint, list(row)] = np.asarray(values).T
    assert_equal(regressor, rolled)
    assert_equal(outputs(code(term, "torque"), k, q, qd, qdd), regressor @ k)
    matrix = outputs(code(term, "mass_matrix"), k, q).reshape(16, n, n)
    others = outputs(code(term, "velocity"), k, q, qd) + outputs(code(term, "gravity"), k, q)
    assert_equal(np.einsum("sij,sj->si", matrix, qdd) + others, regressor @ k)


def test_right_angles_leave_few_operations(term: RigidBodyRecursion) -> None:
    """General 3 x 3 rotations and dense inertia tensors need some 130 operations a joint twice."""
    assert code(term, "torque").cost < 130 * len(term.joints)


@pytest.fixture
def on_processor() -> Iterator[None]:
    """Keep arrays on the processor, also where there is a GPU."""
    with jax.default_device(jax.devices("cpu")[0]):
        yield


@pytest.mark.usefixtures("on_processor")
@pytest.mark.parametrize("joints", [5, 20])
def test_the_form_is_selected_by_joints_and_samples(joints: int) -> None:
    rows = [(0.0, 0.2, 0.0, 0.0)] * joints
    network = jaxcslc.derive(
        Manipulator.from_modified_dh(rows), evaluator="recursive", lengths="numeric"
    )
    term = network.rigid_body
    assert isinstance(term, RigidBodyRecursion)
    few, many = jnp.zeros((3, joints)), (1 << 20, joints)
    assert term.unrolled is None
    assert not term.is_unrolled(few, few.shape)
    assert term.is_unrolled(few, many) == (joints == 5)


@pytest.mark.usefixtures("on_processor")
def test_the_way_is_that_of_the_platform_compiled_for(monkeypatch: pytest.MonkeyPatch) -> None:
    """As on a machine with a GPU, whose processor computes all the same."""
    monkeypatch.setattr(jax, "default_backend", lambda: "gpu")

    def function(x: jax.Array) -> jax.Array:
        return by_platform(x, on_cpu=lambda x: x**2, elsewhere=lambda x: x**3)

    x = jnp.array([1.0, 2.0, 3.0])
    assert_array_equal(function(x), x**2)
    assert_array_equal(jax.jit(function)(x), x**2)
    assert_array_equal(jax.jit(jax.vmap(jax.grad(function)))(x), 2.0 * x)
