"""Equations of motion whose dry friction yields before it slides."""

import dataclasses

import numpy as np
from jaxtyping import Float, Int

from ..friction import contact_states, dry_term
from ..network import CSLC
from ._equations import (
    AbstractEquations,
    Coefficients,
    EquationPoint,
    Joints,
    Linearisation,
    MotionEquations,
)


Samples = Float[np.ndarray, "samples joints"]
Rows = Float[np.ndarray, "equations joints"]

# A first state counts as forgotten from this part of it on.
_FORGOTTEN = 0.01
# Points of the path in each interval: even, for Simpson's rule.
_POINTS = 8


@dataclasses.dataclass(frozen=True)
class PreSlidingEquations(AbstractEquations):
    """Equations of motion whose dry friction yields before it slides, about present positions.

    The state w of a contact depends on all the motion before it. It is that of the present
    positions, averaged with a triangle as `MotionEquations` averages friction: a column that is
    fixed in a step of the search and computed again for the next one, as truncation errors are
    (deferred correction). Its derivative is left out. That by the position itself,
    (1 - |w|) / length while the state grows, alone is worse than none: those by earlier positions
    cancel it for changes that are slow in time, of which nothing but the joint's reversals would
    have to follow. With it, a pendulum of 400 N m/rad took 49 steps and converged 5 times of 12;
    without, 11 steps and always, with coefficients as near. Beside that of acceleration,
    inertia / interval², it is small where samples resolve the contact's vibration.

    **Attributes**

    - `base`: the equations, in which dry friction follows the sign of velocity.
    - `distances`: (n,) of pre-sliding [rad or m]; 0 where it does.
    - `state`: (equations, n) mean state.
    - `unknown`: (equations, n) the part of the state that is that of the first sample, which
      nothing tells.
    """

    base: MotionEquations
    distances: Joints
    state: Rows
    unknown: Rows

    @classmethod
    def of(
        cls,
        base: MotionEquations,
        presliding_distance: Joints,
        q: Samples,
        time: Float[np.ndarray, " samples"],
        part: Int[np.ndarray, " samples"],
    ) -> "PreSlidingEquations":
        """Compute states at present positions.

        - `presliding_distance`: (n,) [rad or m]; 0 where friction follows the sign of velocity.
        - `q`: (samples, n) [rad or m]; `time`: of the samples [s].
        - `part`: number of the recording of each; contacts start without strain in every one.
        """
        state, unknown = np.zeros((2, len(q) - 2, q.shape[1]))
        for number in range(int(part[-1]) + 1):
            samples = np.flatnonzero(part == number)
            rows = slice(int(samples[0]), int(samples[-1]) - 1)
            means = mean_states(q[samples], time[samples], presliding_distance)
            state[rows], unknown[rows] = means
        return cls(base, presliding_distance, state, unknown)

    @property
    def network(self) -> CSLC:  # pyright: ignore[reportIncompatibleVariableOverride]
        """Network of n joints and p coefficients."""
        return self.base.network

    @property
    def intervals(self) -> Float[np.ndarray, " intervals"]:  # pyright: ignore[reportIncompatibleVariableOverride]
        """(samples - 1,) between samples [s]."""
        return self.base.intervals

    @property
    def presliding_distance(self) -> Joints:
        """`distances`."""
        return self.distances

    def states(self, k: Coefficients) -> tuple[Joints, Rows]:
        """Return what `AbstractEquations` declares."""
        return np.abs(self._sizes(k)), self.unknown

    def torque(self, at: EquationPoint) -> Rows:
        """Return what `AbstractEquations` declares."""
        torque = self.base.torque(self._others(at))
        return torque + self._sizes(at.k) * self.state

    def linearised(self, at: EquationPoint) -> Linearisation:
        """Return what `AbstractEquations` declares."""
        others = self.base.linearised(self._others(at))
        columns = others.by_coefficient
        values = columns.values.copy()
        for joint, index in self._dry:
            # There is one: the mean of a sign is not zero in all equations.
            entry = (columns.joints == joint) & (columns.columns == index)
            values[:, entry] = self.state[:, joint, None]
        return others._replace(
            torque=others.torque + self._sizes(at.k) * self.state,
            by_coefficient=dataclasses.replace(columns, values=values),
        )

    def about(
        self, q: Samples, time: Float[np.ndarray, " samples"], part: Int[np.ndarray, " samples"]
    ) -> "PreSlidingEquations":
        """Return them with the states of the given positions."""
        return self.of(self.base, self.distances, q, time, part)

    def truncation(
        self,
        at: EquationPoint,
        time: Float[np.ndarray, " samples"],
        part: Int[np.ndarray, " samples"],
    ) -> Rows:
        """Return the truncation error of friction without a state."""
        return self.base.truncation(self._others(at), time, part)

    def _sizes(self, k: Coefficients) -> Joints:
        """Return (n,) what states are multiplied by [N m or N]; 0 of joints without one."""
        sizes = np.zeros(len(self.distances))
        for joint, index in self._dry:
            sizes[joint] = k[index]
        return sizes

    @property
    def _dry(self) -> list[tuple[int, int]]:
        """Joints whose dry friction has a state, and the indices of its coefficients."""
        joints = dry_term(self.network).joints
        indices = self.network.layout.indices("dry").tolist()
        return [pair for pair in zip(joints, indices, strict=True) if self.distances[pair[0]] > 0.0]

    def _others(self, at: EquationPoint) -> EquationPoint:
        """Return a point without friction that has a state."""
        others = at.k.copy()
        others[[index for _, index in self._dry]] = 0.0
        return at._replace(k=others)


def mean_states(
    q: Samples, time: Float[np.ndarray, " samples"], presliding_distance: Joints
) -> Float[np.ndarray, "2 equations joints"]:
    """Return states of contacts averaged with a triangle about each sample but the ends, and the
    part of them that is the first state's.

    Between samples the path is the cubic with the velocities of parabolas through three samples:
    where a joint turns is known to a part of an interval.

    - `q`: (samples, n) [rad or m]; `time`: [s].
    - `presliding_distance`: (n,) [rad or m]; where they are 0, the mean is 0, too.
    """
    h = np.diff(time)[:, None]
    slope = np.diff(q, axis=0) / h
    velocity = (h[1:] * slope[:-1] + h[:-1] * slope[1:]) / (h[:-1] + h[1:])
    velocity = np.concatenate([slope[:1], velocity, slope[-1:]])
    x = (np.arange(_POINTS) / _POINTS)[None, :, None]
    start, end = (values[:, None] for values in (q[:-1], q[1:]))
    first, second = (h[:, None] * values[:, None] for values in (velocity[:-1], velocity[1:]))
    cubic = start + x**2 * (3.0 - 2.0 * x) * (end - start)
    cubic = cubic + x * (1.0 - x) ** 2 * first - x**2 * (1.0 - x) * second
    path = np.concatenate([cubic.reshape(-1, q.shape[1]), q[-1:]])
    length = np.where(presliding_distance > 0.0, presliding_distance, np.inf)
    state = np.asarray(contact_states(path, length, np.zeros(len(presliding_distance))))
    moved = np.cumsum(np.abs(np.diff(path, axis=0, prepend=path[:1])), axis=0)
    first = np.where(presliding_distance > 0.0, np.exp(-moved / length), 0.0)
    return np.stack([_mean(state, h), _mean(np.where(first < _FORGOTTEN, 0.0, first), h)])


def _mean(values: Float[np.ndarray, "points joints"], h: Float[np.ndarray, "intervals 1"]) -> Rows:
    """Average with a triangle about each sample, by Simpson's rule on either side."""
    simpson = np.full(_POINTS + 1, 2.0)
    simpson[1::2], simpson[[0, -1]] = 4.0, 1.0
    x = np.arange(_POINTS + 1) / _POINTS
    weights = 2.0 / (3.0 * _POINTS) * simpson * np.stack([x, 1.0 - x])  # either sum is 1
    last = len(values) - _POINTS
    points = np.stack([values[point : last + point : _POINTS] for point in range(_POINTS + 1)])
    rising, falling = np.tensordot(weights, points, 1)
    share = h[:-1] / (h[:-1] + h[1:])
    return share * rising[:-1] + (1.0 - share) * falling[1:]
