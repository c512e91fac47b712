"""Repulsion: from the ends of joints' ranges, from the floor and from the arm itself."""

import dataclasses
from collections.abc import Callable

import jax
import jax.numpy as jnp
import numpy as np
import pytest

import sim
from jaxcslc.manipulator import Manipulator
from sim.trajectory._kinematics import Hand
from sim.trajectory._torques import HandRepulsion


def _near(repulsion: HandRepulsion, rng: np.random.Generator, rows: int = 60) -> np.ndarray:
    """Configurations with the hand near the floor, the trunk or both, inside and outside."""
    q = rng.uniform(-np.pi, np.pi, (4000, 6))
    near = np.abs(repulsion.clearance(q)).min(-1) < 0.1
    return q[near][:rows]


@pytest.fixture(scope="module")
def off_hand() -> HandRepulsion:
    """The training trajectory's."""
    controller = sim.training().controller
    assert isinstance(controller, sim.SinusoidalTorque)
    (repulsion,) = (part for part in controller.repulsion if isinstance(part, HandRepulsion))
    return repulsion


def test_repulsion_pushes_inwards_and_only_near_an_end():
    repulsion = sim.Repulsion(np.array([[-2.0, 1.0]]), np.array([40.0]))
    q = np.array([-5.0, -2.0, -1.5, -0.5, 0.5, 1.0, 5.0])[:, None]
    torque = repulsion.torque(q)[:, 0]
    np.testing.assert_allclose(torque[[1, 5]], [40.0, -40.0], rtol=1e-9)
    np.testing.assert_allclose(torque[[0, 6]], [40 * np.e, -40 * np.e])
    np.testing.assert_allclose(torque[2:5], 0.0, atol=40 * np.exp(-9.9))


def test_repulsion_turns_a_driven_joint_back(one_joint: Callable[..., sim.Machine]):
    machine = one_joint(inertia=0.5, viscous=(5.0,), position_range=((-1.0, 1.0),))
    controller = sim.SinusoidalTorque(
        np.array([5.0]),
        np.array([1e9]),
        np.array([np.pi / 2]),  # in effect 5 N m for ever
        repulsion=(sim.Repulsion(np.array(machine.position_range), np.array([50.0])),),
    )
    _, truth = sim.simulate(machine, sim.Trajectory("push", np.zeros(1), controller, 1500))
    assert truth.position.max() < 1.0  # or simulate would have refused
    # It comes to rest where repulsion equals the push: 50 exp(-x / 0.05) = 5.
    np.testing.assert_allclose(truth.position[-1], 1 - 0.05 * np.log(10), atol=1e-3)
    free = dataclasses.replace(controller, repulsion=())
    with pytest.raises(
        sim.SimulationError, match=r"push trajectory, .* s: joint 1 is at 1.*, outside"
    ):
        sim.simulate(machine, sim.Trajectory("push", np.zeros(1), free, 1500))


def test_torque_is_minus_the_gradient_of_the_potential(
    off_hand: HandRepulsion, rng: np.random.Generator
):
    q = _near(off_hand, rng)
    clearance = off_hand.clearance(q)
    assert (clearance < -off_hand.width).any(axis=0).all()  # where the force has stopped growing
    step = 1e-6
    ends = q[:, None, None] + step * np.array([1.0, -1.0])[:, None, None] * np.eye(6)
    up, down = np.moveaxis(np.asarray(off_hand.potential(ends)), 1, 0)
    torque = off_hand.torque(q)
    np.testing.assert_allclose(
        torque, (down - up) / (2 * step), rtol=0, atol=1e-7 * np.abs(torque).max()
    )
    # The same by automatic differentiation of the potential, without Jacobians.
    gradient = jax.jit(jax.vmap(jax.grad(lambda at: off_hand.potential(at))))(q)
    np.testing.assert_allclose(torque, -gradient, rtol=0, atol=1e-12 * np.abs(torque).max())


def test_it_pushes_the_hand_up_and_outwards(off_hand: HandRepulsion, rng: np.random.Generator):
    q = _near(off_hand, rng)
    point, jacobian = off_hand.hand.locate(q)
    # Torque is Jᵀ F, and with a Jacobian of full rank F is all that it can be.
    well = np.linalg.cond(jacobian) < 100
    force = np.einsum(
        "nji,ni->nj", np.linalg.pinv(jacobian[well]).swapaxes(1, 2), off_hand.torque(q)[well]
    )
    clearance = off_hand.clearance(q)[well]
    size = off_hand.strength * np.exp(np.minimum(-clearance / off_hand.width, 1.0))
    outwards = force[:, :2] * point[well, :2] / np.hypot(*point[well, :2].T)[:, None]
    assert (force[:, 2] > 0).all()
    assert (outwards.sum(-1) > -1e-9 * off_hand.strength).all()
    # No stronger than floor and trunk together, no weaker than the floor alone.
    length = np.linalg.norm(force, axis=-1)
    assert (length <= size.sum(-1) * (1 + 1e-9)).all()
    assert (force[:, 2] >= size[:, 0] * (1 - 1e-9)).all()


def test_it_is_vanishingly_small_away_from_floor_and_trunk(
    off_hand: HandRepulsion, rng: np.random.Generator
):
    q = rng.uniform(-np.pi, np.pi, (2000, 6))
    far = off_hand.clearance(q).min(-1) > 10 * off_hand.width
    assert far.any()
    # A force of e⁻¹⁰ of 100 N from either, at no more than the arm's reach.
    assert np.abs(off_hand.torque(q[far])).max() < 2 * 100 * np.exp(-10) * 1.0
    low, high = np.array(sim.puma560().position_range).T
    q = rng.uniform(low, high, (2000, 6))
    q = q[off_hand.clearance(q).min(-1) > 0]
    assert (np.abs(off_hand.torque(q)).max(-1) < 0.1).mean() > 0.75
    upright = np.array([0.0, -np.pi / 2, np.pi / 2, 0.0, 0.0, 0.0])
    assert np.abs(off_hand.torque(upright)).max() < 1e-3


def test_it_has_no_singular_point(off_hand: HandRepulsion):
    """Exactly on axis 1 the trunk's side has no direction, and deep inside no size without end."""
    stick = Manipulator.from_modified_dh([(0.0, 0.0, 0.0, 0.0), ("pi/2", 0.0, 0.0, 0.0)])
    on_axis = dataclasses.replace(off_hand, hand=Hand.of(stick, (0.0, -0.1, 0.0)))
    for q in ([0.3, 0.0], [0.3, np.pi], [0.3, 1e-9]):
        assert np.isfinite(on_axis.torque(np.array(q))).all()
        assert np.isfinite(on_axis.torque(jnp.array(q))).all()


def test_training_is_what_it_was_without_the_hands_repulsion(
    performed: dict[str, sim.SimulatedRecording], off_hand: HandRepulsion
):
    position = performed["training"].truth.position
    floor, trunk = off_hand.clearance(position).min(0)
    assert floor > 0.9
    assert trunk > 0.2
    assert np.abs(off_hand.torque(position)).max() < 0.05


def test_an_arm_lowered_to_the_floor_stops_above_it(off_hand: HandRepulsion):
    """15 N m on joint 2 of the outstretched arm, and a floor that has been raised."""
    off_floor = dataclasses.replace(off_hand, floor=-0.4)
    standard = sim.training().controller
    assert isinstance(standard, sim.SinusoidalTorque)
    pushing = dataclasses.replace(
        standard,
        amplitude=np.array([0.0, 15.0, 0.0, 0.0, 0.0, 0.0]),
        period=np.full(6, 1e9),
        phase=np.full(6, np.pi / 2),
        repulsion=(),
    )
    outstretched = np.array([0.0, 0.0, np.pi / 2, 0.0, 0.0, 0.0])
    lowest = [
        off_floor.clearance(truth.position)[:, 0].min()
        for controller in (pushing, dataclasses.replace(pushing, repulsion=(off_floor,)))
        for _, truth in [
            sim.simulate(sim.puma560(), sim.Trajectory("lower", outstretched, controller, 550))
        ]
    ]
    assert lowest[0] < 0.0 < lowest[1] < 0.1


def test_compiled_repulsion_is_numpys(off_hand: HandRepulsion, rng: np.random.Generator):
    q = _near(off_hand, rng).reshape(2, 30, 6)
    expected = off_hand.torque(q)
    np.testing.assert_allclose(
        jax.jit(off_hand.torque)(q), expected, rtol=0, atol=1e-12 * np.abs(expected).max()
    )
