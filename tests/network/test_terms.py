"""Every kind of term by itself and in a network: its interface, transformations, indices."""

from collections.abc import Callable
from typing import Any

import jax
import jax.numpy as jnp
import numpy as np
import pytest
from numpy.testing import assert_allclose, assert_array_equal

import jaxcslc as jc
from jaxcslc.manipulator import FRICTION_TERMS
from jaxcslc.network import AbstractManipulatorTerm


ROWS = [(0.0, 0.0, 0.3, 0.0), ("pi/2", 0.1, 0.0, 0.2)]
COUPLED = ("coupled_inertia", "coupled_viscous", "coupled_dry")
KINDS = ("rigid_body", "recursion", *FRICTION_TERMS, *COUPLED, "payload")
# Compiled code may contract a product and a sum into one rounding.
ROUNDING = 1e-12


def network_with(kind: str) -> jc.CSLC:
    """Two joints; a friction kind is that of joint 2."""
    robot = jc.Manipulator.from_modified_dh(ROWS, friction=())
    if kind in FRICTION_TERMS:
        robot = robot.with_friction(kind, joint=2)
    if kind in COUPLED:
        robot = robot.with_coupling((1, 2, -0.5))
    evaluator: Any = "recursive" if kind == "recursion" else "tables"
    network = jc.derive(robot, lengths="numeric", evaluator=evaluator)
    if kind in ("load", "directional_load"):
        network = network.with_load(np.linspace(0.5, 1.0, network.size))
    return network.with_payload(1) if kind == "payload" else network


def term_of(network: jc.CSLC, kind: str) -> AbstractManipulatorTerm:
    name = "rigid_body" if kind == "recursion" else kind
    (term,) = (term for term in network.terms if term.kind == name)
    assert isinstance(term, AbstractManipulatorTerm)
    return term


@pytest.fixture(params=KINDS)
def kind(request: pytest.FixtureRequest) -> str:
    return request.param


@pytest.fixture
def network(kind: str) -> jc.CSLC:
    return network_with(kind)


@pytest.fixture
def state(rng: np.random.Generator) -> tuple[jax.Array, ...]:
    return tuple(jnp.asarray(x) for x in rng.uniform(-1, 1, (3, 16, 2)))


def test_a_term_agrees_with_itself(
    kind: str, network: jc.CSLC, state: tuple[jax.Array, ...], rng: np.random.Generator
) -> None:
    """Torque is regressor times coefficients, in every form, and the sum of its parts."""
    term = term_of(network, kind)
    k = jnp.asarray(rng.uniform(0.5, 1.0, term.size))
    torque = np.asarray(term.torque(k, *state))
    assert_allclose(term.regressor(*state) @ k, torque, atol=ROUNDING)
    columns = term.columns(*(x.T for x in state))
    rows = [k[np.array(s, int)] @ x for s, x in zip(term.support, columns, strict=True)]
    assert_allclose(np.stack(rows, axis=1), torque, atol=ROUNDING)
    q, qd, qdd = state
    still = jnp.zeros_like(q)
    shares = {
        "mass": jnp.einsum("tij,tj->ti", term.part("mass_matrix", k, q), qdd),
        "velocity": term.part("velocity", k, q, qd),
        "gravity": term.part("gravity", k, q),
        "friction": term.torque(k, still, qd, still),
        "spring": term.torque(k, q, still, still),
        "load": term.torque(k, *state),
    }
    present = [shares[part] for part in term.parts]
    assert_allclose(np.sum(present, axis=0), torque, atol=ROUNDING)
    for part in ("mass", "velocity", "gravity"):
        assert part in term.parts or not np.any(shares[part])


def test_a_network_is_the_sum_of_its_terms(
    network: jc.CSLC, state: tuple[jax.Array, ...], rng: np.random.Generator
) -> None:
    k = jnp.asarray(rng.uniform(0.5, 1.0, network.size))
    shares = zip(network.terms, network.layout.split(k), strict=True)
    total = np.sum([term.torque(jnp.asarray(term_k), *state) for term, term_k in shares], axis=0)
    assert_allclose(network.torque(k, *state), total, atol=ROUNDING)


def test_jit_vmap_and_grad(
    network: jc.CSLC, state: tuple[jax.Array, ...], rng: np.random.Generator
) -> None:
    """Of a network's methods, whatever its terms hold; compiled once for equal networks."""
    k = jnp.asarray(rng.uniform(0.5, 1.0, network.size))
    torque = np.asarray(network.torque(k, *state))
    assert_allclose(jax.jit(network.torque)(k, *state), torque, atol=ROUNDING)
    vmapped = jax.vmap(network.torque, (None, 0, 0, 0))
    assert_allclose(vmapped(k, *state), torque, atol=ROUNDING)
    gradient = jax.jit(jax.grad(lambda k: jnp.sum(network.torque(k, *state))))(k)
    assert_allclose(gradient, jnp.sum(network.regressor(*state), axis=(0, 1)), atol=1e-11)
    traced = 0

    @jax.jit
    def by_network(network: jc.CSLC, k: jax.Array) -> jax.Array:
        nonlocal traced
        traced += 1
        return network.torque(k, *state)

    for one in (network, jax.tree.map(jnp.asarray, network), jax.tree.map(np.array, network)):
        assert_allclose(by_network(one, k), torque, atol=ROUNDING)
    assert traced == 1


def test_methods_have_a_hash(network: jc.CSLC) -> None:
    """By which `jax.jit` finds what it has compiled."""
    again = jax.tree.map(np.array, network)
    assert hash(network.torque) == hash(again.torque)
    assert network.torque == again.torque


def test_other_slopes_are_another_function(state: tuple[jax.Array, ...]) -> None:
    network = network_with("static")
    k = jnp.ones(network.size)
    one, other = (jax.jit(network.with_static_slopes([s] * 2).torque) for s in (1.0, 5.0))
    assert np.max(np.abs(np.asarray(one(k, *state)) - other(k, *state))) > 0.1
    # In one compiled function, and over an axis of slopes.
    several = jnp.array([[1.0] * 2, [5.0] * 2])
    mapped = jax.vmap(lambda s: network.with_static_slopes(s).torque(k, *state))(several)
    assert_allclose(mapped, [one(k, *state), other(k, *state)], atol=ROUNDING)
    slope = jax.grad(lambda network: jnp.sum(network.torque(k, *state)), allow_int=True)(network)
    assert np.asarray(slope.static_slopes)[1] != 0


@pytest.fixture
def loaded() -> jc.CSLC:
    robot = jc.Manipulator.from_modified_dh(ROWS, friction=("viscous", "dry", "spring"))
    return jc.derive(robot.with_coupling((1, 2)), lengths="numeric").with_payload()


class TestLayout:
    def test_terms_cover_k_in_order(self, loaded: jc.CSLC) -> None:
        layout = loaded.layout
        covered = np.concatenate([np.arange(loaded.size)[part] for part in layout.slices])
        assert_array_equal(covered, np.arange(loaded.size))
        assert layout.kinds == ("rigid_body", "viscous", "dry", "spring", *COUPLED, "payload")
        for term, part in zip(loaded.terms, layout.slices, strict=True):
            assert layout.term_slice(term) == layout.term_slice(term.kind) == part
            assert layout.names[part] == term.names

    def test_parts(self, loaded: jc.CSLC) -> None:
        layout = loaded.layout
        numbers = np.arange(loaded.size)
        groups = np.array([coefficient.group for coefficient in loaded.coefficients])
        assert set(groups[layout.inertial]) == {"base"}
        assert set(groups[layout.payload]) == {"payload"} and len(numbers[layout.payload]) == 10
        assert_array_equal(numbers[layout.unloaded], numbers[:-10])
        friction = np.isin(groups, ("viscous", "dry", "coupled_viscous", "coupled_dry"))
        assert_array_equal(layout.friction, np.flatnonzero(friction))

    def test_without_payload_its_part_is_empty(self) -> None:
        layout = network_with("dry").layout
        assert np.zeros(layout.size)[layout.payload].size == 0
        assert np.zeros(layout.size)[layout.unloaded].size == layout.size

    def test_indices_by_name_group_and_kind(self, loaded: jc.CSLC) -> None:
        layout = loaded.layout
        names = [layout.names[i] for i in layout.indices("dry", "kv2", "kcm1_2", "dry")]
        assert names == ["kv2", "kd1", "kd2", "kcm1_2"]
        assert_array_equal(layout.indices("rigid_body"), layout.indices("base"))
        assert layout.indices().size == 0

    @pytest.mark.parametrize(
        ("ask", "message"),
        [
            (
                lambda layout: layout.indices("kv9"),
                "'kv9' is neither a coefficient nor a group; expec",
            ),
            (
                lambda layout: layout.term_slice("static"),
                "the network has no term 'static'; it has rig",
            ),
        ],
    )
    def test_unknown_words(
        self, loaded: jc.CSLC, ask: Callable[[jc.network.Layout], Any], message: str
    ) -> None:
        with pytest.raises(ValueError, match=message):
            ask(loaded.layout)
