"""Numeric or symbolic, length by length (thesis 8.2.1): the same torque from fewer coefficients."""

import jax.numpy as jnp
import numpy as np
import pytest
from numpy.testing import assert_allclose

import jaxcslc as jc


@pytest.fixture(scope="module")
def symbolic() -> jc.CSLC:
    return jc.derive(jc.puma560().with_friction())


@pytest.mark.parametrize(
    ("kept", "mass", "gravity"),
    [
        ((), 22, 5),
        (("a2",), 24, 5),
        (("a2", "d4"), 25, 5),
        (("a2", "a3", "d3", "d4"), 26, 5),
    ],
)
def test_as_many_coefficients_as_are_independent(
    kept: tuple[str, ...], mass: int, gravity: int
) -> None:
    """Of all numbers, a2 (m4 + m5 + m6) and its like are multiples of one coefficient."""
    network = jc.derive(jc.puma560().with_friction(), lengths=kept)
    groups = [coefficient.group for coefficient in network.coefficients]
    assert (groups.count("mass"), groups.count("gravity")) == (mass, gravity)
    expressions = [coefficient.expression for coefficient in network.coefficients]
    assert ("m4 + m5 + m6" in expressions) == (len(kept) < 4)
    assert {name for c in network.coefficients for a in c.addends for name, _ in a.constants} == {
        *kept,
        "g",
    }


@pytest.mark.parametrize("kept", [(), ("a2", "d4")])
def test_the_torque_is_the_same(
    rng: np.random.Generator, symbolic: jc.CSLC, kept: tuple[str, ...]
) -> None:
    links = jc.puma560().links
    assert links is not None
    network = jc.derive(jc.puma560().with_friction(), lengths=kept)
    state = jnp.asarray(rng.normal(size=(3, 5, 6)))
    torque = network.torque(network.coefficients_from(links), *state)
    assert_allclose(torque, symbolic.torque(symbolic.coefficients_from(links), *state), atol=1e-12)


def test_every_symbol_kept_is_the_symbolic_form_without_its_numbering() -> None:
    robot = jc.puma560().with_friction()
    every = jc.derive(robot, lengths=list(robot.named_lengths()))
    assert every.size == jc.derive(robot).size


def test_refused() -> None:
    with pytest.raises(
        jc.RobotError, match="has no length 'a9'; expected symbolic, numeric, or some of d2, "
    ):
        jc.derive(jc.puma560(), lengths=["a9"])
    with pytest.raises(
        ValueError, match="'symbolic', 'numeric', 'auto' or a list of names, got 'some'"
    ):
        jc.derive(jc.puma560(), lengths="some")  # type: ignore[arg-type]
    unknown = jc.Manipulator.from_modified_dh([(0, 0, 0, 0), (0, "a1", 0, 0)])
    with pytest.raises(jc.RobotError, match="length 'a1' has no value; give one, or keep it"):
        jc.derive(unknown, lengths=())
