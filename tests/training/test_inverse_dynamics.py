"""The CSLC as an adaptive network: term by term, its counts, and other robots."""

from collections.abc import Callable
from typing import Any

import jax
import jax.numpy as jnp
import numpy as np
import pytest
from numpy.testing import assert_allclose

import jaxcslc as jc
from jaxcslc import CSLC
from jaxcslc.manipulator import LinkParameters, Manipulator
from jaxcslc.network import input_rows
from jaxcslc.training import (
    AdaptiveNetwork,
    inverse_dynamics,
    network_order,
    order_per_output,
)


TERMS = ("viscous", "dry", "offset")
TILTED = (1.5, -3.0, -9.0)
ROBOTS: dict[str, Callable[[], Manipulator]] = {
    "elbow with offsets": lambda: Manipulator.from_modified_dh(
        [(0.0, 0.0, 0.3, 0.0), ("pi/2", 0.1, 0.0, 0.2), (0.0, 0.4, -0.1, 0.0)], friction=TERMS
    ),
    "prismatic": lambda: Manipulator.from_modified_dh(
        [(0.4, 0.1, 0.2, 0.5), (-1.1, 0.3, -0.2, 1.0), (2.0, -0.2, 0.3, -0.7)],
        kinds="PRP",
        gravity=TILTED,
        friction=("viscous", "offset"),
    ),
    "flat, no friction": lambda: Manipulator.from_modified_dh(
        [(0.0, 0.0, 0.0, 0.0), (0.0, 0.5, 0.0, 0.0)], friction=()
    ),
    "slides": lambda: Manipulator.from_modified_dh(
        [(0.0, 0.0, 0.0, 0.0), ("pi/2", 0.0, 0.0, 0.0)], kinds="PP"
    ),
}


def motion(rng: np.random.Generator, *shape: int) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
    q, qd, qdd = rng.uniform(-3, 3, (3, *shape))
    return q, qd, qdd


def part_of(network: AdaptiveNetwork, name: str) -> tuple[AdaptiveNetwork, int]:
    """One subnetwork alone, and its place among the signals."""
    at = [part.name for part in network.subnetworks].index(name)
    part = network.subnetworks[at]
    return AdaptiveNetwork((part,), network.preprocess, network.activation, network.names), at


def alone(network: AdaptiveNetwork, name: str, k: Any, patterns: Any) -> np.ndarray:
    part, at = part_of(network, name)
    signals = network.signals(patterns)
    one = type(signals)((signals.inputs[at],), (signals.contexts[at],))
    return np.asarray(part.forward(jnp.asarray(k), one).total).T


def test_torque_and_each_term(puma: CSLC, rng: np.random.Generator) -> None:
    network = inverse_dynamics(puma)
    k = rng.normal(size=puma.size)
    q, qd, qdd = patterns = motion(rng, 9, 6)
    close: Any = {"rtol": 1e-11, "atol": 1e-10}
    assert_allclose(network.outputs(jnp.asarray(k), patterns), puma.torque(k, *patterns), **close)
    mass = np.einsum("sij,sj->si", puma.mass_matrix(k, q), qdd)
    assert_allclose(alone(network, "mass", k, patterns), mass, **close)
    velocity = puma.velocity_term(k, q, qd)
    assert_allclose(alone(network, "velocity", k, patterns), velocity, **close)
    assert_allclose(alone(network, "gravity", k, patterns), puma.gravity_term(k, q), **close)
    friction = alone(network, "viscous", k, patterns) + alone(network, "dry", k, patterns)
    assert_allclose(friction, puma.friction_term(k, qd), **close)
    assert_allclose(
        alone(network, "viscous", k, patterns),
        k[puma.layout.term_slice("viscous")] * qd,
        rtol=1e-14,
    )
    assert_allclose(
        alone(network, "dry", k, patterns),
        k[puma.layout.term_slice("dry")] * np.sign(qd),
        rtol=1e-14,
    )


def test_hidden_nodes_are_the_quantities_that_the_thesis_names(
    puma: CSLC, rng: np.random.Generator
) -> None:
    """5.2.3: elements of M(q), and of the velocity matrix C with C qd = V."""
    network = inverse_dynamics(puma)
    k = rng.normal(size=puma.size)
    patterns = motion(rng, 4, 6)
    passage = network.forward(jnp.asarray(k), network.signals(patterns))
    matrix = np.asarray(puma.mass_matrix(k, patterns[0]))
    table = puma.algebra.mass
    columns = [table.columns[c] for c in sorted({link.column for link in table.links})]
    for node, (i, j) in enumerate(columns):
        assert_allclose(passage.values[0][0][node], matrix[:, i, j], rtol=1e-10, atol=1e-10)


def test_counts_of_appendix_b(puma: CSLC, appendix_b: dict[str, Any]) -> None:
    network = inverse_dynamics(puma)
    layers = dict(network.adaptive_layers)
    printed = appendix_b["network"]
    inputs = {name: layer.inputs for name, layer in layers.items()}
    assert inputs == {"mass": 59, "velocity": 86, "gravity": 9, "viscous": 6, "dry": 6}
    # Appendix B's links are pairs; 23 of the velocity subnetwork's weigh two coefficients.
    pairs = {
        name: len(set(zip(layer.links.source, layer.links.node, strict=True)))
        for name, layer in layers.items()
    }
    assert (pairs["mass"], pairs["velocity"]) == (printed["mass_links"], printed["velocity_links"])
    assert pairs["gravity"] == len(appendix_b["gravity_links"])
    both = sum(len(link["weight"]) for link in appendix_b["velocity_links"])
    assert layers["velocity"].links.count == both == 431
    weights = {name: len(set(layer.links.weight.tolist())) for name, layer in layers.items()}
    assert weights == {
        "mass": printed["mass_coefficients"],
        "velocity": printed["velocity_coefficients_used"],
        "gravity": printed["gravity_coefficients"],
        "viscous": printed["viscous"],
        "dry": printed["dry"],
    }
    assert layers["velocity"].links.nodes == 84  # of 105, those that are not zero
    assert network.size == printed["weights"] and network.names == puma.names
    assert network_order(network) == printed["order"]


def test_context_links_are_fixed_by_the_number_of_joints(puma: CSLC) -> None:
    """5.1.1: M_ij feeds torques i and j; 5.1.2: c_ijk feeds C_ij and C_ik, C_ij feeds V_i."""
    mass, velocity = inverse_dynamics(puma).subnetworks[:2]
    table = puma.algebra.mass
    columns = [table.columns[c] for c in sorted({link.column for link in table.links})]
    expected = {(node, i, j) for node, (i, j) in enumerate(columns)}
    expected |= {(node, j, i) for node, (i, j) in enumerate(columns)}
    (layer,) = mass.contexts
    result = list(zip(layer.source, layer.node, layer.context, strict=True))
    assert len(result) == len(expected) and set(result) == expected
    inner, outer = velocity.contexts
    table = puma.algebra.velocity
    columns = [table.columns[c] for c in sorted({link.column for link in table.links})]
    assert inner.fan_out.tolist() == [1 if j == k else 2 for _, j, k in columns]
    assert outer.fan_out.tolist() == [1] * outer.inputs


@pytest.mark.parametrize(
    ("name", "lengths"),
    [*((name, "numeric") for name in ROBOTS), ("elbow with offsets", "symbolic")],
)
def test_other_robots(
    name: str,
    lengths: Any,
    rng: np.random.Generator,
    random_links: Callable[..., tuple[LinkParameters, ...]],
) -> None:
    cslc = jc.derive(ROBOTS[name](), lengths=lengths)
    network = inverse_dynamics(cslc)
    n = cslc.joint_count
    patterns = motion(rng, 5, n)
    k = rng.normal(size=cslc.size)
    expected = cslc.torque(k, *patterns)
    assert_allclose(network.outputs(jnp.asarray(k), patterns), expected, rtol=1e-10, atol=1e-10)
    assert order_per_output(network) == cslc.order_per_joint
    assert network.names == cslc.names


def test_subnetworks_without_links_are_left_out() -> None:
    flat = inverse_dynamics(jc.derive(ROBOTS["flat, no friction"](), lengths="numeric"))
    assert flat.groups == ("mass", "velocity")
    slides = inverse_dynamics(jc.derive(ROBOTS["slides"](), lengths="numeric"))
    assert "velocity" not in slides.groups and "mass" in slides.groups


def test_a_recursive_evaluator_has_the_same_network(rng: np.random.Generator) -> None:
    cslc = jc.derive(ROBOTS["prismatic"](), lengths="numeric", evaluator="recursive")
    k, patterns = rng.normal(size=cslc.size), motion(rng, 5, 3)
    result = inverse_dynamics(cslc).outputs(jnp.asarray(k), patterns)
    assert_allclose(result, cslc.torque(k, *patterns), rtol=1e-9, atol=1e-9)


def test_patterns_by_name_in_any_batch_and_under_transforms(
    puma: CSLC, puma_k: jax.Array, rng: np.random.Generator
) -> None:
    network = inverse_dynamics(puma)
    q, qd, qdd = (jnp.asarray(x) for x in motion(rng, 2, 3, 6))

    class Named:
        pass

    named = Named()
    named.q, named.qd, named.qdd = q, qd, qdd  # pyright: ignore[reportAttributeAccessIssue]
    expected = puma.torque(puma_k, q, qd, qdd)
    close: Any = {"rtol": 1e-11, "atol": 1e-12}
    assert_allclose(network.outputs(puma_k, named), expected, **close)
    assert_allclose(
        network.outputs(puma_k, (q[0, 0], qd[0, 0], qdd[0, 0])), expected[0, 0], **close
    )
    side_by_side = jax.jit(jax.vmap(lambda *x: network.outputs(puma_k, x)))(q, qd, qdd)
    assert_allclose(side_by_side, expected, **close)


def test_integers_are_taken_as_numbers() -> None:
    cslc = jc.derive(ROBOTS["prismatic"](), lengths="numeric")
    network, k = inverse_dynamics(cslc), jnp.ones(cslc.size)
    whole = np.asarray([[1, 2, 3]])
    real = whole.astype(float)
    assert_allclose(network.outputs(k, (whole,) * 3), network.outputs(k, (real,) * 3))


@pytest.mark.parametrize(
    "shapes", [((4, 6), (4, 6), (4, 5)), ((4, 7), (4, 6), (4, 6)), ((4, 6), (4, 6), (1, 6))]
)
def test_motion_of_wrong_shapes(puma: CSLC, shapes: Any) -> None:
    network = inverse_dynamics(puma)
    with pytest.raises(ValueError) as failure:
        network.outputs(jnp.ones(43), tuple(np.ones(shape) for shape in shapes))
    assert str(failure.value) == (
        f"motion: expected q, qd and qdd of one shape (..., 6), got {', '.join(map(str, shapes))}"
    )


def test_a_panda_s_inputs_are_products_of_sines_and_cosines(rng: np.random.Generator) -> None:
    """By powers in NumPy: thousands of products, formed degree by degree."""
    algebra = jc.derive(jc.panda()).algebra
    q = rng.uniform(-3.0, 3.0, (7, 5))
    monomials = algebra.velocity.inputs
    assert len(monomials) > 5000
    angles = [
        sum(sign * q[joint] for joint, sign in angle.terms) for angle in algebra.ring.chain.angles
    ]
    variables = np.array([f(angle) for angle in angles for f in (np.cos, np.sin)])
    expected = np.prod(variables ** np.array(monomials)[:, :, None], axis=1)
    assert_allclose(input_rows(algebra.ring, monomials, list(jnp.asarray(q))), expected, atol=1e-14)
