"""Friction by word: every term is what its formula says, wherever the network computes it."""

import math
from typing import Any

import equinox as eqx
import jax
import jax.numpy as jnp
import numpy as np
import pytest
from numpy.testing import assert_allclose, assert_array_equal

import jaxcslc as jc
from jaxcslc.training import inverse_dynamics


WORDS = (
    ("viscous", "dry", "static", "root", "quadratic", "offset", "spring"),
    ("asymmetric_viscous", "asymmetric_dry", "static"),
)
SLOPES = (3.0, 8.0, 20.0)
ROWS = [(0.0, 0.0, 0.3, 0.0), ("pi/2", 0.1, 0.0, 0.2), (0.0, 0.4, -0.1, 0.0)]


def arm(*words: str) -> jc.Manipulator:
    """Three joints; joints 2 and 3 share a shaft; joint 1 has a model of its own."""
    robot = jc.Manipulator.from_modified_dh(ROWS, friction=words)
    return (
        robot.with_friction("viscous", "asymmetric_dry", joint=1)
        .with_coupling((2, 3, -0.5))
        .with_static_slopes(SLOPES)
    )


def literal(word: str, side: str, slope: float, q: float, v: float) -> float:
    """What a term's coefficient is multiplied by, in plain Python."""
    sign = int(v > 0) - int(v < 0)
    return {
        "viscous": v,
        "asymmetric_viscous": v if (v > 0) == (side == "p") else 0.0,
        "dry": float(sign),
        "asymmetric_dry": float(sign) if (sign > 0) == (side == "p") else 0.0,
        "static": sign * math.exp(-slope * abs(v)),
        "root": sign * math.sqrt(abs(v)),
        "quadratic": v * abs(v),
        "offset": 1.0,
        "spring": q,
    }[word]


LETTERS = {
    **{
        "kv": "viscous",
        "kd": "dry",
        "ks": "static",
        "kr": "root",
        "kq": "quadratic",
        "ko": "offset",
        "ke": "spring",
    },
    **{"kvp": "asymmetric_viscous", "kvn": "asymmetric_viscous"},
    **{"kdp": "asymmetric_dry", "kdn": "asymmetric_dry"},
}


def expected(
    names: tuple[str, ...], k: np.ndarray, q: np.ndarray, qd: np.ndarray, qdd: np.ndarray
) -> np.ndarray:
    """The torque of every coefficient after the inertial ones, by its name."""
    torque = np.zeros(3)
    for name, value in zip(names, k, strict=True):
        letters = name.rstrip("0123456789_")
        numbers = [int(part) - 1 for part in name.removeprefix(letters).split("_")]
        if letters in LETTERS:
            (j,) = numbers
            torque[j] += value * literal(LETTERS[letters], letters[-1], SLOPES[j], q[j], qd[j])
        elif letters in ("kcm", "kcv", "kcd"):
            i, j, ratio = *numbers, -0.5
            if letters == "kcd":
                sign = np.sign(qd[i] + ratio * qd[j])
                torque += value * sign * np.array([0.0, 1.0, ratio])
            else:
                x = qdd if letters == "kcm" else qd
                torque[i] += value * ratio * x[j]
                torque[j] += value * ratio * x[i]
    return torque


@pytest.fixture(scope="module", params=WORDS, ids=["one way", "either way"])
def network(request: pytest.FixtureRequest) -> jc.CSLC:
    return jc.derive(arm(*request.param), lengths="numeric")


@pytest.fixture
def state(rng: np.random.Generator) -> tuple[np.ndarray, ...]:
    q, qd, qdd = rng.uniform(-1, 1, (3, 16, 3))
    qd[0] = 0.0  # at rest: no sign
    qd[1, 1] = 0.5 * qd[1, 2]  # the shared shaft stands still
    return q, qd, qdd


@pytest.fixture
def k(network: jc.CSLC, rng: np.random.Generator) -> np.ndarray:
    return rng.uniform(0.2, 2.0, network.size)


def test_torque_is_the_formulas(
    network: jc.CSLC, k: np.ndarray, state: tuple[np.ndarray, ...]
) -> None:
    start = network.layout.inertial.stop
    alone = np.where(np.arange(k.size) < start, 0.0, k)
    torque = network.torque(alone, *state)
    by_formula = [expected(network.names[start:], k[start:], *x) for x in zip(*state, strict=True)]
    assert_allclose(torque, by_formula, rtol=1e-12, atol=1e-13)


def test_regressor_columns_and_terms_agree_with_torque(
    network: jc.CSLC, k: np.ndarray, state: tuple[np.ndarray, ...]
) -> None:
    q, qd, qdd = state
    torque = np.asarray(network.torque(k, *state))
    assert_allclose(network.regressor(*state) @ k, torque, rtol=1e-11, atol=1e-11)
    columns = network.columns(*(jnp.asarray(x.T) for x in state))
    by_joint = [k[list(s)] @ rows for s, rows in zip(network.support, columns, strict=True)]
    assert_allclose(np.stack(by_joint, axis=1), torque, rtol=1e-11, atol=1e-11)
    parts = (
        np.einsum("tij,tj->ti", network.mass_matrix(k, q), qdd),
        network.velocity_term(k, q, qd),
        network.gravity_term(k, q),
        network.friction_term(k, qd),
        network.spring_term(k, q),
    )
    assert_allclose(np.sum(parts, axis=0), torque, rtol=1e-11, atol=1e-11)
    assert network.order_per_joint == tuple(len(support) for support in network.support)


def test_forward_dynamics_inverts_torque(
    network: jc.CSLC, k: np.ndarray, state: tuple[np.ndarray, ...]
) -> None:
    """With the shared inertia and the springs; inertias large enough for M to have an inverse."""
    q, qd, qdd = state
    links = [jc.LinkParameters(2.0, np.array([0.2, 0.1, 0.05]), np.diag([0.3, 0.4, 0.5]), 0.6)] * 3
    start = network.layout.inertial.stop
    k = np.concatenate([np.asarray(network.coefficients_from(links))[:start], k[start:]])
    k[network.names.index("kcm2_3")] = 0.05
    torque = network.torque(k, q, qd, qdd)
    assert_allclose(network.forward_dynamics(k, q, qd, torque), qdd, rtol=1e-8, atol=1e-9)
    mass = np.asarray(network.mass_matrix(k, q))
    assert_array_equal(mass, np.swapaxes(mass, 1, 2))


def test_the_adaptive_network_has_every_term(
    network: jc.CSLC, k: np.ndarray, state: tuple[np.ndarray, ...]
) -> None:
    adaptive = inverse_dynamics(network)
    assert_allclose(
        adaptive.outputs(jnp.asarray(k), state), network.torque(k, *state), rtol=1e-10, atol=1e-10
    )


def test_coefficients_from_values(network: jc.CSLC) -> None:
    """Values by word land at their names; joints without a term have none."""
    links = [jc.LinkParameters(0.0, np.zeros(3), np.zeros((3, 3)))] * 3
    values: dict[str, Any] = {"coupled": [[1.0, 2.0, 3.0]], "static": [0.0, 5.0, 6.0]}
    if "root" in network.robot.friction:
        values |= {"viscous": [1.0, 2.0, 3.0], "spring": [0.0, 7.0, 8.0]}
        wanted = {"kv1": 1.0, "kv3": 3.0, "ke2": 7.0}
    else:
        values |= {"asymmetric_viscous": [[0.0, 0.0], [1.0, 2.0], [3.0, 4.0]]}
        wanted = {"kvp2": 1.0, "kvn2": 2.0, "kvn3": 4.0, "kv1": 0.0}
    wanted |= {"kcm2_3": 1.0, "kcv2_3": 2.0, "kcd2_3": 3.0, "ks2": 5.0, "ks3": 6.0}
    k = network.coefficients_from(links, **values)
    assert {name: float(k[network.names.index(name)]) for name in wanted} == wanted
    assert "ks1" not in network.names


def test_slopes_in_transformations(
    network: jc.CSLC, k: np.ndarray, state: tuple[np.ndarray, ...]
) -> None:
    """One compiled function for all slopes; vmap over them; the derivative is the formula's."""
    traced = 0

    @jax.jit
    def friction(slopes: jax.Array) -> jax.Array:
        nonlocal traced
        traced += 1
        return network.with_static_slopes(slopes).friction_term(k, state[1])

    tried = jnp.array([SLOPES, (1.0, 2.0, 3.0), (50.0, 9.0, 4.0)])
    by_slopes = [friction(slopes) for slopes in tried]
    assert traced == 1
    constant = network.with_static_slopes(np.array(tried[1]))
    assert_allclose(by_slopes[1], constant.friction_term(k, state[1]), rtol=1e-12)
    assert_allclose(jax.vmap(friction)(tried), np.stack(by_slopes), rtol=1e-12)
    slope = jax.jacfwd(friction)(tried[0])
    v, ks = state[1][:, 1], k[network.names.index("ks2")]
    wanted = -ks * np.abs(v) * np.sign(v) * np.exp(-SLOPES[1] * np.abs(v))
    assert_allclose(slope[:, 1, 1], wanted, rtol=1e-11, atol=1e-15)
    # As an argument, a network that holds an array is compiled once too.
    by_network = eqx.filter_jit(lambda net: net.friction_term(k, state[1]))
    assert_allclose(by_network(network.with_static_slopes(tried[1])), by_slopes[1], rtol=1e-12)
    assert_allclose(jax.jit(constant.friction_term)(k, state[1]), by_slopes[1], rtol=1e-12)


def test_gradients_are_finite_at_rest(network: jc.CSLC, k: np.ndarray) -> None:
    """The root of a speed has no derivative at zero; the network's is zero, and no NaN."""
    zero = jnp.zeros(3)
    friction = lambda qd: network.friction_term(k, qd)
    for jacobian in (jax.jacfwd(friction), jax.jacrev(friction)):
        assert np.all(np.isfinite(jax.jit(jacobian)(zero)))


def test_single_precision(network: jc.CSLC, k: np.ndarray, state: tuple[np.ndarray, ...]) -> None:
    small = [x.astype(np.float32) for x in state]
    for slopes in (SLOPES, jnp.asarray(SLOPES)):
        torque = network.with_static_slopes(slopes).torque(k.astype(np.float32), *small)
        assert torque.dtype == np.float32
        assert_allclose(torque, network.torque(k, *state), rtol=1e-4, atol=1e-4)


def test_names_and_counts() -> None:
    robot = jc.Manipulator.from_modified_dh(ROWS, kinds="RRP", friction=WORDS[1])
    network = jc.derive(robot, lengths="numeric")
    names = [f"{letters}{i}" for letters in ("kvp", "kvn", "kdp", "kdn", "ks") for i in (1, 2, 3)]
    friction_coefficients = network.coefficients[-15:]
    assert [coefficient.name for coefficient in friction_coefficients] == names
    assert [c.unit for c in friction_coefficients[:3]] == ["N m s/rad", "N m s/rad", "N s/m"]
    assert friction_coefficients[0].expression == "viscous friction of joint 1, forwards"
    assert network.counts["asymmetric_dry"] == {
        "inputs": 6, "links": 6, "nodes": 3, "coefficients": 6,
    }  # fmt: skip
    assert "3 static" in repr(network)


def test_refused() -> None:
    robot = jc.Manipulator.from_modified_dh(ROWS, kinds="RRP", name="arm")
    network = jc.derive(robot.with_friction("static", joint=2))
    with pytest.raises(ValueError, match=r"static slopes: expected numbers above 0, got \[0.0,"):
        network.with_static_slopes([0.0, 1.0, 1.0])
    with pytest.raises(ValueError, match=r"static slopes: expected 3, one a joint, got \(2,\)"):
        network.with_static_slopes(jnp.ones(2))
    links = [jc.LinkParameters(0.0, np.zeros(3), np.zeros((3, 3)))] * 3
    with pytest.raises(ValueError, match="static: joint 1 has no such friction term"):
        network.coefficients_from(links, static=[1.0, 1.0, 0.0])
    with pytest.raises(ValueError, match="coupled: the network has no such friction term"):
        network.coefficients_from(links, coupled=[[1.0, 1.0, 1.0]])
    pairs = jc.derive(robot.with_coupling((1, 2)))
    with pytest.raises(ValueError, match="coupled: expected 1 by 3 values, inertia, viscous and"):
        pairs.coefficients_from(links, coupled=[[1.0]])
