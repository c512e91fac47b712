"""Joints that stick and slip: complementarity by enumeration, closed forms, and motion by two other
ways: from event to event with steps by their error, and MuJoCo's constraint solver."""

import itertools
from collections.abc import Callable
from typing import Any

import jax
import mujoco
import numpy as np
import pytest
from jaxtyping import Array, Float
from numpy.testing import assert_allclose
from scipy.integrate import solve_ivp

import jaxcslc as jc
from jaxcslc.instruments import simulate
from jaxcslc.instruments._simulation import Friction
from tests import arms
from tests.yielding_motion import yielding_motion


def enumerated(
    mass: Float[np.ndarray, "n n"],
    drive: Float[np.ndarray, " n"],
    bounds: tuple[Float[np.ndarray, " n"], Float[np.ndarray, " n"]],
    v: Float[np.ndarray, " n"],
) -> Float[np.ndarray, " n"]:
    """Directions that contradict accelerations least, of all that there are."""
    least, best = np.inf, np.zeros(len(v))
    for mode in itertools.product(*([np.sign(x)] if x else [0.0, 1.0, -1.0] for x in v)):
        mode = np.array(mode)
        free, low, high = mode != 0.0, *bounds
        net, qdd = drive - np.where(mode > 0.0, high, low), np.zeros(len(v))
        qdd[free] = np.linalg.solve(mass[np.ix_(free, free)], net[free])
        needed = drive - mass @ qdd
        wrong = np.where(free, -qdd * mode, np.maximum(needed - high, low - needed))
        worst = np.max(np.where(v == 0.0, wrong, -np.inf))
        least, best = (worst, mode) if worst < least else (least, best)
    return best


class TestBalance:
    def test_directions_are_those_of_all_that_fit_best(self, rng: np.random.Generator) -> None:
        """300 arms of four joints: most rest, bounds are of either sign or one-sided."""
        root = rng.normal(size=(300, 4, 4))
        mass = root @ root.transpose(0, 2, 1) + 0.05 * np.eye(4)
        drive = 3.0 * rng.normal(size=(300, 4))
        backwards = rng.normal(size=(300, 4))
        forwards = backwards + rng.exponential(2.0, size=(300, 4))
        v = np.where(rng.random((300, 4)) < 0.8, 0.0, rng.normal(size=(300, 4)))
        friction = Friction(jax.numpy.asarray(forwards), jax.numpy.asarray(backwards))
        known = np.where(v > 0.0, forwards, np.where(v < 0.0, backwards, 0.0))
        result = jax.jit(Friction.directions)(friction, mass, drive - known, v == 0.0)
        rows = zip(mass, drive, backwards, forwards, v, strict=True)
        expected = [enumerated(m, tau, (low, high), x) for m, tau, low, high, x in rows]
        assert_allclose(result, np.where(v == 0.0, expected, 0.0), atol=0.0)
        assert {*np.unique(np.asarray(result)[v == 0.0])} == {-1.0, 0.0, 1.0}


def chain(joints: int, gravity: float) -> jc.CSLC:
    """Planar, links of half a metre."""
    rows = [(0, 0.5 * (joint > 0), 0, 0) for joint in range(joints)]
    robot = jc.Manipulator.from_modified_dh(rows, gravity=(0, -gravity, 0))
    return jc.derive(robot.with_friction("viscous", "dry"), lengths="numeric")


def coefficients(
    network: jc.CSLC, viscous: list[float], dry: list[float]
) -> Float[np.ndarray, " coefficients"]:
    link = jc.LinkParameters(1.0, np.array([0.2, 0.0, 0.0]), 0.02 * np.eye(3))
    links = [link] * network.joint_count
    return np.array(network.coefficients_from(links, viscous=viscous, dry=dry))


VISCOUS, DRY = [0.3, 0.3], [0.8, 0.4]


def double_pendulum(
    q: Float[np.ndarray, " 2"], v: Float[np.ndarray, " 2"], gravity: float
) -> tuple[Float[np.ndarray, "2 2"], Float[np.ndarray, " 2"]]:
    """Mass matrix, and torque without friction, of `chain(2)`, by hand."""
    middle, coupling = 0.02 + 0.2**2, 0.5 * 0.2 * np.cos(q[1])
    mass = np.array(
        [[2 * middle + 0.25 + 2 * coupling, middle + coupling], [middle + coupling, middle]]
    )
    bend = 0.5 * 0.2 * np.sin(q[1])
    outer = 0.2 * gravity * np.cos(q[0] + q[1])
    weight = np.array([0.7 * gravity * np.cos(q[0]) + outer, outer])
    return mass, weight + bend * np.array([-v[1] * (2 * v[0] + v[1]), v[0] ** 2])


def from_event_to_event(
    start: tuple[Float[np.ndarray, " 2"], Float[np.ndarray, " 2"]],
    torque: Float[np.ndarray, "intervals 2"],
    interval: float,
    gravity: float,
) -> tuple[Float[np.ndarray, "instants 2"], int]:
    """Positions of the double pendulum, and how many times a joint stopped or broke away."""
    (q, v), path, events = start, [start[0]], 0
    for tau in torque:
        t = 0.0
        while t < interval:
            t, q, v, ended = to_event(q, v, tau, (t, interval), gravity)
            events += ended
        path.append(q)
    return np.array(path), events


def to_event(
    q: Float[np.ndarray, " 2"],
    v: Float[np.ndarray, " 2"],
    tau: Float[np.ndarray, " 2"],
    span: tuple[float, float],
    gravity: float,
) -> tuple[float, Float[np.ndarray, " 2"], Float[np.ndarray, " 2"], int]:
    """Time, positions, velocities and the number of events where the first ends the motion."""
    dry = np.array(DRY)

    def drive(y: Float[np.ndarray, " 4"]) -> tuple[Any, Any]:
        mass, bias = double_pendulum(y[:2], y[2:], gravity)
        return mass, tau - bias - VISCOUS * y[2:]

    mode = enumerated(*drive(np.concatenate([q, v])), (-dry, dry), v)

    def qdd(y: Float[np.ndarray, " 4"]) -> Float[np.ndarray, " 2"]:
        mass, net = drive(y)
        free, result = mode != 0.0, np.zeros(2)
        result[free] = np.linalg.solve(mass[np.ix_(free, free)], (net - dry * mode)[free])
        return result

    def event(joint: int) -> Callable[[float, Any], float]:
        def left(_: float, y: Any) -> float:
            if mode[joint]:
                return mode[joint] * y[2 + joint] + 1e-11
            mass, net = drive(y)
            return dry[joint] - abs((net - mass @ qdd(y))[joint]) + 1e-9

        left.terminal, left.direction = True, -1.0  # type: ignore[attr-defined]
        return left

    solution = solve_ivp(
        lambda _, y: np.concatenate([y[2:], qdd(y)]),
        span,
        np.concatenate([q, v]),
        method="DOP853",
        rtol=1e-9,
        atol=1e-11,
        events=[event(0), event(1)],
    )
    stopped = [len(times) > 0 for times in solution.t_events]
    end = np.where((mode == 0.0) | stopped, 0.0, solution.y[2:, -1])
    return solution.t[-1], solution.y[:2, -1], end, sum(stopped)


class TestMotion:
    def test_sliding_to_rest_and_back(self) -> None:
        """Constant torque against the motion: two parabolas, or one and rest, exactly."""
        network = arms.turntable("dry")
        inertia, dry, speed = 2.0, 4.0, 1.3
        push = np.array([0.0, -3.9, -4.1, -20.0])[:, None]
        still, t = np.zeros((4, 1)), 0.01 * np.arange(201)[:, None]
        k, torque = np.array([inertia, dry]), np.tile(push, (200, 1, 1))
        path = simulate(network, k, still, still + speed, torque, 0.01)
        slows, returns = (dry - push[:, 0]) / inertia, np.minimum(push[:, 0] + dry, 0.0) / inertia
        there = np.minimum(t, speed / slows)
        exact = speed * there - 0.5 * slows * there**2 + 0.5 * returns * (t - there) ** 2
        assert_allclose(path[:, :, 0], exact, atol=1e-12)

    @pytest.mark.parametrize("excess", [-1e-3, 1e-3])
    def test_a_joint_is_dragged_by_another(self, excess: float) -> None:
        """Break-away of joint 1, which nothing drives, is exceeded by what joint 2's acceleration
        needs of it, or not; so it is with joint 2 held by its friction and joint 1 pushed."""
        network = chain(2, 0.0)
        mass, _ = double_pendulum(np.zeros(2), np.zeros(2), 0.0)
        for still, pushed in ((0, 1), (1, 0)):
            push, dry = np.zeros((5, 1, 2)), np.zeros(2)
            push[..., pushed], dry[pushed] = 3.0, 0.5
            needed = mass[still, pushed] / mass[pushed, pushed] * 2.5
            dry[still] = needed * (1.0 - excess)
            k = coefficients(network, [0.0, 0.0], dry.tolist())
            path = simulate(network, k, np.zeros((1, 2)), np.zeros((1, 2)), push, 0.002)
            assert path[-1, 0, pushed] > 1e-4
            if excess < 0.0:
                assert np.all(np.asarray(path[:, 0, still]) == 0.0)
            else:
                assert path[-1, 0, still] < -1e-8  # backwards, against the pushed joint

    def test_a_joint_is_held_by_the_acceleration_of_another(self) -> None:
        """Its own torque exceeds break-away, and would move it if the other stood still."""
        network, still = chain(2, 0.0), np.zeros((1, 2))
        k = coefficients(network, [0.0, 0.0], [10.0, 0.5])
        push = np.array([[[10.5, 3.0]], [[10.5, 0.0]]])
        path = np.asarray(simulate(network, k, still, still, push, 0.002))[:, 0]
        assert np.all(path[:2, 0] == 0.0) and path[1, 1] > 5e-5
        # By joint 2's friction, which slows it down, joint 1 is pushed beyond break-away.
        assert path[2, 0] > 1e-6

    def test_from_event_to_event(self) -> None:
        """Many stops and reversals, joints held and dragged; errors are those of steps of 2 ms."""
        gravity, network = 9.81, chain(2, 9.81)
        k, t = coefficients(network, VISCOUS, DRY), 0.01 * np.arange(200)[:, None]
        q = np.array([[-1.2, 0.3], [-1.5, 1.0], [-2.0, -0.4]])
        qd = np.array([[0.0, 0.0], [1.5, 0.0], [0.0, -2.0]])
        swing = np.array([[2.5, 1.0], [1.6, 0.7], [1.2, 0.9]]) * np.sin(
            np.array([[6.0, 9.0], [8.0, 3.0], [4.0, 7.0]]) * t[:, None]
        )
        torque = swing + np.asarray(network.gravity_term(k, q))
        path = simulate(network, k, q, qd, torque, 0.01)
        total = 0
        for start in range(3):
            exact, events = from_event_to_event(
                (q[start], qd[start]), torque[:, start], 0.01, gravity
            )
            assert_allclose(path[:, start], exact, atol=2e-4)
            total += events
        assert total > 20
        # What dry friction becomes when it yields over less and less of the path.
        short, _, _ = yielding_motion(
            *(network, k, 2e-5 * np.ones(2), (q[0], qd[0], 0 * q[0]), torque[:, 0], 0.01)
        )
        assert_allclose(path[:, 0], short, atol=3e-3)

    def test_mujoco_sticks_and_slips_the_same_way(self) -> None:
        """Three joints, a second and a half; friction loss as hard as its solver lets it be."""
        step, network = 2e-5, chain(3, 9.81)
        dry, viscous = [1.5, 0.7, 0.3], [0.2, 0.1, 0.05]
        bodies = "".join(
            f'<body pos="{0.5 * (joint > 0)} 0 0"><joint axis="0 0 1" frictionloss="{dry[joint]}"'
            f' damping="{viscous[joint]}" solimpfriction="0.9999 0.9999 0.001 0.5 2"'
            f' solreffriction="{2 * step} 1"/><inertial pos="0.2 0 0" mass="1"'
            ' diaginertia="0.02 0.02 0.02"/>'
            for joint in range(3)
        )
        model = mujoco.MjModel.from_xml_string(
            f'<mujoco><option gravity="0 -9.81 0" timestep="{step}" tolerance="1e-14"'
            f' integrator="implicitfast"/><worldbody>{bodies}{"</body>" * 3}</worldbody></mujoco>'
        )
        k, q = coefficients(network, viscous, dry), np.array([[-1.3, 0.4, 0.5]])
        t = 0.01 * np.arange(150)[:, None, None]
        swing = np.array([3.5, 1.2, 0.7]) * np.sin(np.array([5.0, 8.0, 11.0]) * t)
        torque = swing + np.asarray(network.gravity_term(k, q))
        path = np.asarray(simulate(network, k, q, 0.0 * q, torque, 0.01))[:, 0]
        data = mujoco.MjData(model)
        data.qpos = q[0]
        rows = [q[0]]
        for tau in torque[:, 0]:
            data.qfrc_applied = tau
            mujoco.mj_step(model, data, nstep=round(0.01 / step))
            rows.append(data.qpos.copy())
        assert np.all(np.ptp(rows, axis=0) > 0.1)
        # Twice the error of MuJoCo's steps, which are of first order, and that of steps of 2 ms.
        assert_allclose(path, rows, atol=3e-4)


class TestTransformations:
    """Through a stop, a rest and a reversal of each joint."""

    @staticmethod
    def motion() -> tuple[Callable[[Any], Array], Float[np.ndarray, " coefficients"]]:
        network = chain(2, 9.81)
        q, t = np.array([[-1.2, 0.3]]), 0.01 * np.arange(60)[:, None, None]
        swing = np.array([2.5, 1.0]) * np.sin(np.array([9.0, 12.0]) * t)
        k = coefficients(network, VISCOUS, DRY)
        torque = swing + np.asarray(network.gravity_term(k, q))
        return lambda k: simulate(network, k, q, 0.0 * q, torque, 0.01)[-1, 0], k

    def test_many_arms_at_once(self) -> None:
        end, k = self.motion()
        several = np.array([k, 1.1 * k, 0.9 * k])
        assert_allclose(jax.vmap(end)(several), [end(x) for x in several], atol=1e-12)

    def test_derivatives_are_those_of_differences(self) -> None:
        end, k = self.motion()
        derivative = jax.jit(jax.jacrev(end))(k)
        step = 1e-6
        moved = np.concatenate([k + step * np.eye(len(k)), k - step * np.eye(len(k))])
        ends = np.asarray(jax.vmap(end)(moved))
        differences = (ends[: len(k)] - ends[len(k) :]).T / (2.0 * step)
        assert_allclose(derivative, differences, rtol=1e-3, atol=1e-5)
