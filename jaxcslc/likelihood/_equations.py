"""Equations of motion: what every kind of them does, and those of rigid links."""

import abc
import dataclasses
from collections.abc import Callable
from functools import cached_property
from typing import NamedTuple

import numpy as np
from jaxtyping import Float, Int

from .._chunks import over_chunks
from ..network import CSLC
from ._columns import JointColumns
from ._joint_friction import JointFriction, JointMotion
from ._smooth_torque import SmoothTorque
from ._torque_record import triangle_mean


Samples = Float[np.ndarray, "samples series"]
Rows = Float[np.ndarray, "equations series"]
Turns = Float[np.ndarray, "equations joints"]
Joints = Float[np.ndarray, " joints"]
Coefficients = Float[np.ndarray, " coefficients"]
Laws = Float[np.ndarray, " laws"]
# Equations that a thread computes, so that their numbers stay in a core's cache.
_CHUNK = 4096
# Below so many samples there are no differences of differences.
_FEWEST = 5
# Means are inverted in so many rounds: at even intervals, one leaves errors of fourth order.
_ROUNDS = 3


class Linearisation(NamedTuple):
    """The torque of every equation, and its derivatives.

    **Attributes**

    - `torque`: (equations, series): joints, and what else moves.
    - `by_position`: (equations, series, 3 series), by the positions at three samples.
    - `by_coefficient`: p + n columns: by `k`, then by the logarithms of slopes.
    - `by_turn`: (equations, n), by the moment at which the joint turns.
    """

    torque: Float[np.ndarray, "equations series"]
    by_position: Float[np.ndarray, "equations series positions"]
    by_coefficient: JointColumns
    by_turn: Float[np.ndarray, "equations joints"]


class AbstractEquations(abc.ABC):
    """The equation of motion at every sample but the ends, as a function of positions.

    Velocity is the derivative of the parabola through three positions, acceleration its second
    difference: the average of the acceleration over the two intervals with a triangle. Friction is
    averaged alike.

    **Attributes**

    - `network`: n joints, p coefficients.
    - `intervals`: (samples - 1,) between samples [s].
    """

    network: CSLC
    intervals: Float[np.ndarray, " intervals"]

    @abc.abstractmethod
    def torque(
        self, k: Coefficients, laws: Laws, q: Samples, turn: Turns, direction: Turns
    ) -> Rows:
        """Return torque of every equation, (equations, series).

        **Arguments**

        - `k`: (p,); `laws`: (n,) logarithms of slopes of static friction, and what else equations
          have.
        - `q`: (samples, series) positions; joints come first.
        - `turn`: (equations, n) when a joint turns, in intervals about the sample; -1 for one
          that moves one way. `direction`: 1 or -1, the sign of velocity after `turn`.
        """

    @abc.abstractmethod
    def linearised(
        self, k: Coefficients, laws: Laws, q: Samples, turn: Turns, direction: Turns
    ) -> Linearisation:
        """`torque` with derivatives."""

    def about(
        self,
        q: Samples,
        time: Float[np.ndarray, " samples"],
        part: Int[np.ndarray, " samples"],
    ) -> "AbstractEquations":
        """Return the equations for a step from positions; `part`: number of the recording of
        each."""
        del q, time, part
        return self

    def truncation(
        self,
        k: Coefficients,
        laws: Laws,
        q: Samples,
        time: Float[np.ndarray, " samples"],
        part: Int[np.ndarray, " samples"],
        turn: Turns,
        direction: Turns,
    ) -> Rows:
        """Return truncation errors of sampled torques at present positions, (equations, series)."""
        del k, laws, time, part, turn, direction
        return np.zeros((len(q) - 2, q.shape[1]))

    @property
    def presliding_distance(self) -> Joints:
        """(n,) of pre-sliding [rad or m]; 0 where dry friction follows the sign of velocity."""
        return np.zeros(self.network.joint_count)

    def noise(self, torque_noise: Float[np.ndarray, "recordings joints"]) -> np.ndarray:
        """Return (recordings, series) of all equations, from that of the motors' torque [N m or
        N]."""
        return torque_noise

    def states(self, k: Coefficients) -> tuple[Joints, Rows | float]:
        """Return (n,) friction that has a state, 0 of joints without one [N m or N]; and
        (equations, n) which part of it nothing tells."""
        del k
        return np.zeros(self.network.joint_count), 0.0


@dataclasses.dataclass(frozen=True)
class MotionEquations(AbstractEquations):
    """Equations of motion of rigid links.

    Friction of single joints is averaged over both intervals of an equation (`JointFriction`), and
    torque of all else is of the sample between them (`SmoothTorque`).

    **Attributes**

    - `network`: n joints, p coefficients.
    - `intervals`: (samples - 1,) between samples [s].
    """

    network: CSLC
    intervals: Float[np.ndarray, " intervals"]

    def torque(
        self, k: Coefficients, laws: Laws, q: Samples, turn: Turns, direction: Turns
    ) -> Rows:
        """Return what `AbstractEquations` declares."""
        result, smooth, friction = np.empty(turn.shape), self._smooth, self._friction

        def compute(first: int, last: int) -> None:
            motion = self._motion(q, turn, direction, slice(first, last))
            torque = smooth.torque(k, motion[:3])
            for of_joints in friction:
                torque[of_joints.joints] += of_joints.torque(k, laws, motion)
            result[first:last] = torque.T

        over_chunks(compute, len(result), _CHUNK)
        return result

    def linearised(
        self, k: Coefficients, laws: Laws, q: Samples, turn: Turns, direction: Turns
    ) -> Linearisation:
        """Return what `AbstractEquations` declares."""
        (count, n), smooth, friction = turn.shape, self._smooth, self._friction
        entries = np.array([*smooth.entries, *(e for part in friction for e in part.entries)], int)
        order = np.lexsort(entries.reshape(-1, 2).T[::-1])
        torque, by_turn = np.zeros((2, count, n))
        by_position, by_entry = np.zeros((count, n, 3 * n)), np.empty((count, len(entries)))

        def compute(first: int, last: int) -> None:
            rows = slice(first, last)
            motion = self._motion(q, turn, direction, rows)
            of_friction, by_motion = np.zeros((n, last - first)), np.zeros((3, n, last - first))
            by_friction: list[np.ndarray] = []
            for of_joints in friction:
                mean, joints = of_joints.mean(k, laws, motion), of_joints.joints
                of_friction[joints], by_motion[:, joints] = mean.torque, mean.by_motion
                by_turn[rows, joints] = mean.by_turn.T
                by_friction += [mean.by_coefficient, mean.by_slope]
            total, columns = smooth.linearised(k, motion, by_motion, by_position[rows])
            torque[rows] = (total + of_friction).T
            by_entry[rows] = np.concatenate([columns, *by_friction])[order].T

        over_chunks(compute, count, _CHUNK)
        joints, columns = entries.reshape(-1, 2)[order].T
        of_entries = JointColumns(by_entry, joints, columns, (n, self.network.size + n))
        return Linearisation(torque, by_position, of_entries, by_turn)

    def truncation(
        self,
        k: Coefficients,
        laws: Laws,
        q: Samples,
        time: Float[np.ndarray, " samples"],
        part: Int[np.ndarray, " samples"],
        turn: Turns,
        direction: Turns,
    ) -> Rows:
        """Return what `AbstractEquations` declares; see `triangle_truncation`."""

        def smooth(*motion: Rows) -> Rows:
            return self._smooth.torque(k, [x.T for x in motion]).T

        result, shift = triangle_truncation(smooth, q, time, part)
        motion = self._motion(q, turn, direction, slice(0, len(turn)))
        shifted = motion._replace(velocity=motion.velocity + shift.T)
        for friction in self._friction:
            change = friction.torque(k, laws, shifted) - friction.torque(k, laws, motion)
            result[:, friction.joints] += change.T
        return result

    def _motion(self, q: Samples, turn: Turns, direction: Turns, rows: slice) -> JointMotion:
        """Return the motion of some equations."""
        positions = np.ascontiguousarray(q[rows.start : rows.stop + 2].T)
        intervals = self.intervals[rows.start : rows.stop + 1]
        return JointMotion.of(positions, intervals, turn[rows].T, direction[rows].T)

    @cached_property
    def _smooth(self) -> SmoothTorque:
        return SmoothTorque.of(*_key(self.network))

    @cached_property
    def _friction(self) -> tuple[JointFriction, ...]:
        return JointFriction.of(*_key(self.network))


def _key(network: CSLC) -> tuple[CSLC, int]:
    """Return the network without slopes of its own, which are arguments, and its size.

    A layout is kept once it was asked for, and networks with and without it are not equal.
    """
    if network.static_slopes is not None:
        network = network.with_static_slopes(np.ones(network.joint_count))
    return network, network.layout.size


def triangle_truncation(
    smooth: Callable[[Rows, Rows, Rows], Rows],
    q: Samples,
    time: Float[np.ndarray, " samples"],
    part: Int[np.ndarray, " samples"],
) -> tuple[Rows, Rows]:
    """Return the triangle's mean of smooth torque less what equations have for it, (equations, n),
    and what is missing in the mean velocity of friction.

    Torque of an equation is of one instant, but for the mean of acceleration: what means of
    products leave out is of second order in the interval. Here all is of fourth order: velocity and
    acceleration at the instant, from differences of differences, and the mean of the torques of
    three instants as it is taken of recorded ones. It is as large as noise where torque is nearly
    exact and samples are few, and unlike noise it moves coefficients the same way all along.

    For positions as they are: a search takes it from one step to the next (deferred correction,
    Pereyra 1968), which leaves the band as narrow as it is. Not for held torques, whose steps make
    accelerations jump, and whose mean acceleration is exact.

    **Arguments**

    - `smooth`: torque of all terms but friction of position, velocity and acceleration.
    - `q`: (samples, n); `time`: of the samples [s]; `part`: number of the recording of each.
    """
    result, shift = np.zeros((2, len(q) - 2, q.shape[1]))
    for number in range(int(part[-1]) + 1):
        samples = np.flatnonzero(part == number)
        if len(samples) < _FEWEST:
            continue
        rows = slice(int(samples[0]), int(samples[-1]) - 1)
        result[rows], shift[rows] = _of_recording(smooth, q[samples], time[samples])
    return result, shift


def _of_recording(
    smooth: Callable[[Rows, Rows, Rows], Rows],
    q: Samples,
    time: Float[np.ndarray, " samples"],
) -> tuple[Rows, Rows]:
    """Return `triangle_truncation` of one recording."""
    h = np.diff(time)[:, None]
    before, after = h[:-1], h[1:]
    middle = time[1:-1]

    def mean(values: np.ndarray) -> np.ndarray:
        """Average with a triangle about each instant; the ends change as their neighbours."""
        change = triangle_mean(middle, values) - values[1:-1]
        return values + np.concatenate([change[:1], change, change[-1:]])

    slope = np.diff(q, axis=0) / h
    parabola = (after * slope[:-1] + before * slope[1:]) / (before + after)
    mean_acceleration = 2.0 * np.diff(slope, axis=0) / (before + after)
    acceleration = mean_acceleration
    for _ in range(_ROUNDS):
        acceleration = acceleration + mean_acceleration - mean(acceleration)
    # A parabola's derivative errs by the third derivative times a sixth of both intervals.
    velocity = parabola - before * after / 6.0 * np.gradient(acceleration, middle, axis=0)
    torque = mean(smooth(q[1:-1], velocity, acceleration))
    result = torque - smooth(q[1:-1], parabola, mean_acceleration)
    # Friction is averaged over velocities on a line through the parabola's.
    line = parabola + (after - before) / 3.0 * mean_acceleration
    return result, mean(velocity) - line
