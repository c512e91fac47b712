"""Every function of the network under every transformation of JAX, shape and precision."""

import functools
from collections.abc import Callable
from typing import Any

import equinox as eqx
import jax
import jax.numpy as jnp
import numpy as np
import pytest

import jaxcslc
from jaxcslc.network import RigidBodyRecursion


METHODS: dict[str, tuple[str, ...]] = {
    "torque": ("k", "q", "qd", "qdd"),
    "regressor": ("q", "qd", "qdd"),
    "mass_matrix": ("k", "q"),
    "velocity_term": ("k", "q", "qd"),
    "gravity_term": ("k", "q"),
    "friction_term": ("k", "qd"),
    "forward_dynamics": ("k", "q", "qd", "qdd"),
}
# Tables of symbolic lengths, and recursion in both forms, of two joints: a prismatic and a revolute
# one, with offsets. Other robots are other numbers to the same code: `test_identities.py` has more.
NETWORKS = [f"prismatic-first-{form}" for form in ("tables", "recursive", "unrolled")]
# All leading axes but in `test_batches`: so many samples, whose programs tests share.
SAMPLES = (4,)
# Compiled code may contract a product and a sum into one rounding.
ROUNDING = 1e-12
# What float32 leaves of seven digits after some hundred operations, relative to the largest entry.
SINGLE = 2e-5


@pytest.fixture(params=NETWORKS)
def case(request: pytest.FixtureRequest, cases: Callable[[str], Any]) -> Any:
    return cases(request.param)


@pytest.fixture(params=list(METHODS))
def method(request: pytest.FixtureRequest) -> str:
    return request.param


def arguments(
    case: Any, method: str, rng: np.random.Generator, shape: tuple[int, ...] = ()
) -> tuple[Any, ...]:
    values = dict(zip(("q", "qd", "qdd"), case.states(rng, shape), strict=True)) | {"k": case.k}
    return tuple(jnp.asarray(values[name]) for name in METHODS[method])


def assert_close(actual: Any, expected: Any, rounding: float = ROUNDING) -> None:
    assert actual.shape == expected.shape
    np.testing.assert_allclose(
        actual, expected, rtol=0, atol=rounding * np.max(np.abs(np.asarray(expected)))
    )


def test_jit(case: Any, method: str, rng: np.random.Generator) -> None:
    """The same values, and nothing is compiled again for other numbers of the same shape."""
    function = getattr(case.network, method)
    traces: list[None] = []

    @jax.jit
    def compiled(*values: Any) -> Any:
        traces.append(None)
        return function(*values)

    for _ in range(3):
        values = arguments(case, method, rng, SAMPLES)
        assert_close(compiled(*values), function(*values))
    assert len(traces) == 1


def test_a_network_derived_again_is_the_same_to_the_compiler(
    case: Any, rng: np.random.Generator
) -> None:
    traces: list[None] = []

    @eqx.filter_jit
    def torque(network: jaxcslc.CSLC, *values: Any) -> Any:
        traces.append(None)
        return network.torque(*values)

    rigid_body = case.network.rigid_body
    evaluator: Any = "tables"
    if isinstance(rigid_body, RigidBodyRecursion):
        evaluator = "unrolled" if rigid_body.unrolled else "recursive"
    for _ in range(2):
        again = jaxcslc.derive(
            case.network.robot, lengths=case.network.algebra.lengths, evaluator=evaluator
        )
        torque(again, *arguments(case, "torque", rng))
    assert len(traces) == 1


def test_the_network_is_a_pytree_without_arrays(case: Any) -> None:
    assert jax.tree.leaves(case.network) == []


def test_batches(case: Any, method: str, rng: np.random.Generator) -> None:
    """Any leading axes: every sample is what it is alone, without any axis."""
    shapes = [(3, 1, 2), (1,)] if method == "torque" else [(3, 1, 2)]
    n, p = case.network.joint_count, case.network.size
    core = {"regressor": (n, p), "mass_matrix": (n, n)}.get(method, (n,))
    for shape in shapes:
        values = arguments(case, method, rng, shape)
        batch = getattr(case.network, method)(*values)
        assert batch.shape == (*shape, *core)
        for index in list(np.ndindex(*shape))[:2]:
            alone = [
                value if name == "k" else value[index]
                for name, value in zip(METHODS[method], values, strict=True)
            ]
            single = getattr(case.network, method)(*alone)
            assert single.shape == core
            np.testing.assert_allclose(batch[index], single, rtol=1e-9, atol=1e-11)


def test_no_samples(case: Any, rng: np.random.Generator) -> None:
    n, p = case.network.joint_count, case.network.size
    for shape in ((0,), (2, 0)):
        torque = jax.eval_shape(case.network.torque, *arguments(case, "torque", rng, shape))
        regressor = jax.eval_shape(
            case.network.regressor, *arguments(case, "regressor", rng, shape)
        )
        assert torque.shape == (*shape, n)
        assert regressor.shape == (*shape, n, p)


def test_vmap(case: Any, method: str, rng: np.random.Generator) -> None:
    """As it is and under `jit`."""
    values = arguments(case, method, rng, SAMPLES)
    function = getattr(case.network, method)
    mapped = jax.vmap(function, tuple(None if name == "k" else 0 for name in METHODS[method]))
    expected = function(*values)
    for of in (mapped, jax.jit(mapped)):
        assert_close(of(*values), expected)


def test_vmap_over_coefficients(case: Any, rng: np.random.Generator) -> None:
    k, q, qd, qdd = arguments(case, "torque", rng, SAMPLES)
    several = jnp.stack([k, 2 * k, 0 * k])
    torques = jax.jit(jax.vmap(case.network.torque, (0, None, None, None)))
    mapped = torques(several, q, qd, qdd)
    once = case.network.torque(k, q, qd, qdd)
    assert_close(mapped, jnp.stack([once, 2 * once, 0 * once]))


Jacobian = Callable[..., tuple[jax.Array, ...]]


@pytest.fixture(scope="module")
def compiled(cases: Callable[[str], Any]) -> Callable[..., tuple[Callable[..., Any], Jacobian]]:
    """Makes, once, a method of a network and its Jacobians by every argument, backwards."""

    @functools.cache
    def of(name: str, method: str) -> tuple[Callable[..., Any], Jacobian]:
        function = getattr(cases(name).network, method)
        arguments = tuple(range(len(METHODS[method])))
        return jax.jit(function), jax.jit(jax.jacrev(function, argnums=arguments))

    return of


@pytest.mark.parametrize("method", ["torque", "forward_dynamics"])
@pytest.mark.parametrize("name", NETWORKS)
def test_gradients(
    cases: Callable[[str], Any],
    compiled: Callable[..., Any],
    name: str,
    method: str,
    rng: np.random.Generator,
) -> None:
    """Backwards against central differences by every argument, and forwards against backwards.

    Torque is the sum of the other terms; forward dynamics is made of it and the mass matrix.
    """
    function, backwards = compiled(name, method)
    values = arguments(cases(name), method, rng)
    jacobians = backwards(*values)
    step = 1e-6
    for i, jacobian in enumerate(jacobians):
        for entry in range(values[i].size):
            off = np.zeros(values[i].shape)
            off[entry] = step
            ahead, behind = (
                function(*values[:i], np.asarray(values[i]) + sign * off, *values[i + 1 :])
                for sign in (1, -1)
            )
            difference = (np.asarray(ahead) - np.asarray(behind)) / (2 * step)
            np.testing.assert_allclose(jacobian[:, entry], difference, rtol=1e-5, atol=1e-5)
    tangents = tuple(rng.standard_normal(value.shape) for value in values)
    _, forwards = jax.jvp(function, values, tangents)
    expected = sum(np.asarray(j) @ t for j, t in zip(jacobians, tangents, strict=True))
    np.testing.assert_allclose(forwards, expected, rtol=1e-9, atol=1e-9)


def test_gradient_with_respect_to_k_is_the_regressor(case: Any, rng: np.random.Generator) -> None:
    k, q, qd, qdd = arguments(case, "torque", rng, SAMPLES)
    jacobian = jax.jit(jax.jacfwd(case.network.torque))(k, q, qd, qdd)
    assert_close(jacobian, case.network.regressor(q, qd, qdd))


@pytest.mark.parametrize("method", ["torque", "forward_dynamics"])
@pytest.mark.parametrize("name", NETWORKS)
def test_gradients_are_finite_at_singular_positions(
    cases: Callable[[str], Any], compiled: Callable[..., Any], name: str, method: str
) -> None:
    case = cases(name)
    _, slopes = compiled(name, method)
    zero = jnp.zeros(case.network.joint_count)
    for angle in (0.0, 1e-7, np.pi):
        for slope in slopes(jnp.asarray(case.k), zero + angle, zero, zero):
            assert np.all(np.isfinite(slope)), angle


def test_float32_stays_float32(case: Any, method: str, rng: np.random.Generator) -> None:
    values = arguments(case, method, rng, SAMPLES)
    single = [value.astype(jnp.float32) for value in values]
    actual = getattr(case.network, method)(*single)
    assert actual.dtype == jnp.float32
    if method != "forward_dynamics":  # its error is the condition number's
        expected = getattr(case.network, method)(*values)
        assert_close(actual, np.asarray(expected), SINGLE)


def test_numpy_in_jax_out(case: Any, method: str, rng: np.random.Generator) -> None:
    values = [np.asarray(value) for value in arguments(case, method, rng, SAMPLES)]
    actual = getattr(case.network, method)(*values)
    assert isinstance(actual, jax.Array)
    assert actual.dtype == jnp.float64


def test_batch_axes_broadcast(case: Any, rng: np.random.Generator) -> None:
    k, q, qd, qdd = arguments(case, "torque", rng, SAMPLES)
    actual = case.network.torque(k, q[0], qd, qdd[None, 1])
    expected = case.network.torque(k, jnp.tile(q[0], (4, 1)), qd, jnp.tile(qdd[1], (4, 1)))
    assert_close(actual, expected)


def test_coefficients_can_be_differentiated(cases: Callable[[str], Any]) -> None:
    """k is a function of the links: sensitivities of coefficients to masses come for free."""
    case = cases("elbow")

    def total(links: Any) -> Any:
        return jnp.sum(case.network.coefficients_from(links))

    slope = jax.jit(jax.grad(total))(jax.tree.map(jnp.asarray, case.links))
    step = 1e-6
    changed: list[Any] = list(case.links)
    changed[1] = eqx.tree_at(lambda link: link.mass, changed[1], float(changed[1].mass) + step)
    difference = (float(total(changed)) - float(total(case.links))) / step
    np.testing.assert_allclose(float(slope[1].mass), difference, rtol=1e-6)
