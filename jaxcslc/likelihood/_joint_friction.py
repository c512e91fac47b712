"""Friction of single joints, averaged over the two intervals of an equation of motion.

The second difference of positions is the acceleration averaged with a triangle over the two
intervals that meet at a sample. Friction in the same equation is averaged alike: without that, an
equation next to a reversal is wrong by up to twice the dry friction. Velocity is linear in each
interval. Its sign is that of `direction` from the turn on and the other one before, so that the
average is smooth in all motion. Which sign holds is decided elsewhere (`Signs`).
"""

import dataclasses
from collections.abc import Sequence
from functools import lru_cache
from typing import NamedTuple

import numpy as np
from jaxtyping import Float, Int

from ..codegen import Expressions, Motion, Value, array_outputs, derivatives, named
from ..network import CSLC, ExpressionFunctions, JointTerm


# Gauss-Legendre nodes on (0, 1): exact for a triangle times a parabola.
_NODES = (np.polynomial.legendre.leggauss(2)[0] + 1) / 2
# Speed that stands in for one of the wrong sign, next to a reversal [rad/s or m/s].
_SLOWEST = 1e-9

Rows = Float[np.ndarray, "joints equations"]
Both = Float[np.ndarray, "2 equations"]
Coefficients = Float[np.ndarray, " coefficients"]
Laws = Float[np.ndarray, " laws"]


class JointMotion(NamedTuple):
    """Motion of joints in equations, (joints, equations) each.

    **Attributes**

    - `q`, `velocity`, `acceleration`: at the sample between both intervals.
    - `turn`: when the joint turns, -1 at the previous sample to 1 at the next one; -1 for joints
      that move one way. `direction`: 1 or -1, the sign of velocity after `turn`.
    - `h`: (2, equations) intervals before and after the sample [s].
    """

    q: Rows
    velocity: Rows
    acceleration: Rows
    turn: Rows
    direction: Rows
    h: Both

    @classmethod
    def of(
        cls,
        positions: Float[np.ndarray, "joints samples"],
        intervals: Float[np.ndarray, " intervals"],
        turn: Rows,
        direction: Rows,
    ) -> "JointMotion":
        """Return the motion of a parabola through three samples about each but the ends."""
        before, after = intervals[:-1], intervals[1:]
        slope = np.diff(positions) / intervals
        velocity = (after * slope[:, :-1] + before * slope[:, 1:]) / (before + after)
        acceleration = 2.0 * np.diff(slope) / (before + after)
        h = np.stack([before, after])
        return cls(positions[:, 1:-1], velocity, acceleration, turn, direction, h)

    @property
    def stencil(self) -> Float[np.ndarray, "3 3 equations"]:
        """Derivatives of the three by the positions at three samples."""
        (before, after), zero = self.h, np.zeros(self.h.shape[1])
        first, last = 1.0 / (before * (before + after)), 1.0 / (after * (before + after))
        return np.array(
            [
                [zero, zero + 1.0, zero],
                [-after * first, after * first - before * last, before * last],
                [2.0 * first, -2.0 * (first + last), 2.0 * last],
            ]
        )

    def of_joints(self, joints: Int[np.ndarray, " some"]) -> "JointMotion":
        """Return that of some joints."""
        q, velocity, acceleration, turn, direction = (x[joints] for x in self[:-1])
        return JointMotion(q, velocity, acceleration, turn, direction, self.h)

    def in_equations(self, equations: Int[np.ndarray, " some"]) -> "JointMotion":
        """Return that in some equations."""
        return JointMotion(*(x[:, equations] for x in self))


class MeanFriction(NamedTuple):
    """Mean friction of joints with the same laws, and its derivatives.

    - `torque`: (joints, equations).
    - `by_motion`: (3, joints, equations) by position, velocity and acceleration at the sample.
    - `by_turn`: by the moment of the turn; `by_slope`: by the logarithms of slopes, of joints that
      have one.
    - `by_coefficient`: (laws joints, equations).
    """

    torque: Rows
    by_motion: Float[np.ndarray, "3 joints equations"]
    by_turn: Rows
    by_slope: Float[np.ndarray, "slopes equations"]
    by_coefficient: Float[np.ndarray, "coefficients equations"]


@dataclasses.dataclass(frozen=True, eq=False)
class JointFriction:
    """Friction of joints that have the same laws, as a graph of expressions.

    **Attributes**

    - `joints`: from 0; `indices`: (laws, joints) of their coefficients.
    - `entries`: joint and column of what `mean` has derivatives by: coefficients, then slopes.
    - `graph`: of inputs `q[0]`, `qd[0]`, `slope` and `k[i]` of each law.
    - `outputs`: torque, its derivatives by position, velocity and slope, and what each coefficient
      is multiplied by.
    """

    joints: Int[np.ndarray, " joints"]
    indices: Int[np.ndarray, "laws joints"]
    entries: tuple[tuple[int, int], ...]
    graph: Expressions
    outputs: tuple[Value, ...]

    @classmethod
    @lru_cache(maxsize=16)
    def of(cls, network: CSLC, size: int) -> "tuple[JointFriction, ...]":
        """Return those of a network of `size` coefficients, one for each set of laws."""
        terms = [term for term in network.terms if isinstance(term, JointTerm)]
        sets: dict[tuple[JointTerm, ...], list[int]] = {}
        for joint in range(network.joint_count):
            of_joint = tuple(term for term in terms if joint in term.joints)
            sets.setdefault(of_joint, []).append(joint)
        return tuple(
            cls._of_set(network, of_joints, joints, size)
            for of_joints, joints in sets.items()
            if of_joints
        )

    @classmethod
    def _of_set(
        cls, network: CSLC, terms: Sequence[JointTerm], joints: Sequence[int], size: int
    ) -> "JointFriction":
        motion, values, indices = Motion(1), list[Value](), list[np.ndarray]()
        graph, slope = motion.graph, motion.graph.input("slope")
        functions, by = ExpressionFunctions(motion), (motion.q[0], motion.qd[0], slope)
        for term in terms:
            inputs = motion.values(term.law.properties.formula(functions, *by))
            columns = network.layout.indices(term.kind).reshape(len(inputs), -1)
            values += inputs
            indices += [*columns[:, [term.joints.index(joint) for joint in joints]]]
        torque = graph.constant(0.0)
        for factor, value in zip(graph.inputs("k", len(values)), values, strict=True):
            torque = torque + factor * value
        entries = [(joint, int(i)) for row in indices for joint, i in zip(joints, row, strict=True)]
        if any(term.law.slopes is not None for term in terms):
            entries += [(joint, size + joint) for joint in joints]
        outputs = (torque, *(derivatives([torque], x)[0] for x in by), *values)
        return cls(np.array(joints), np.array(indices), tuple(entries), graph, outputs)

    def torque(self, k: Coefficients, laws: Laws, motion: JointMotion) -> Rows:
        """Return the mean torque; `laws` begin with (n,) logarithms of slopes."""
        return self._sums(k, laws, motion, derivatives=False)[0]

    def mean(self, k: Coefficients, laws: Laws, motion: JointMotion) -> MeanFriction:
        """Return the mean torque with derivatives."""
        sums = self._sums(k, laws, motion, derivatives=True)
        by_coefficient = sums[6:].reshape(-1, motion.h.shape[1])
        by_slope = sums[5] * np.exp(laws[self.joints])[:, None]
        by_slope = by_slope[: len(self.entries) - len(by_coefficient)]
        return MeanFriction(sums[0], sums[2:5], sums[1], by_slope, by_coefficient)

    def _sums(
        self, k: Coefficients, laws: Laws, motion: JointMotion, *, derivatives: bool
    ) -> Float[np.ndarray, "sums joints equations"]:
        """Return torque; its derivatives by turn, position, velocity, acceleration and slope; and
        what coefficients are multiplied by."""
        whole = motion.of_joints(self.joints)
        result = np.zeros((6 + len(self.indices) if derivatives else 1, *whole.q.shape))
        inputs = named("k", k[self.indices][:, :, None])
        inputs["slope"] = np.exp(laws[self.joints])[:, None]
        # One way all along: parts of an equation are the same in all of them.
        one_way = whole._replace(turn=np.full((1, 1), -1.0))
        for part in (1, 2):
            self._add(inputs, one_way, part, result)
        turning = np.flatnonzero(np.any(whole.turn > -1.0, axis=0))
        if len(turning):
            of_turning = np.zeros((*result.shape[:2], len(turning)))
            for part in range(3):
                self._add(inputs, whole.in_equations(turning), part, of_turning)
            result[:, :, turning] = of_turning
        return result

    def _add(
        self,
        inputs: dict[str, np.ndarray],
        motion: JointMotion,
        part: int,
        sums: Float[np.ndarray, "sums joints equations"],
    ) -> None:
        """Add a part of both intervals: between their ends, the sample and the turn."""
        (before, after), turn, late = motion.h, motion.turn, motion.turn > 0.0
        edges = (-1.0, np.minimum(turn, 0.0), np.maximum(turn, 0.0), 1.0)
        moves_of_edges = (0.0, 1.0 - late, 1.0 * late, 0.0)  # where the turn does
        start, length = edges[part], edges[part + 1] - edges[part]
        start_moves = moves_of_edges[part]
        grows = moves_of_edges[part + 1] - start_moves
        between = np.where(late, -1.0, 1.0)  # sign of what is between sample and turn
        sign = (-1.0, between, 1.0)[part] * motion.direction
        side = (-1.0, -between, 1.0)[part]
        h = np.where(side < 0.0, before, after)
        share, change = h / (before + after), motion.acceleration * h
        for node in _NODES:
            x, moves = start + length * node, start_moves + grows * node
            height = 1.0 - side * x
            mass = share * length * height
            speed = sign * (motion.velocity + x * change)
            inputs |= {"q[0]": motion.q, "qd[0]": sign * np.maximum(speed, _SLOWEST)}
            if len(sums) == 1:
                [torque] = array_outputs(self.graph, self.outputs[:1], inputs)
                sums[0] += mass * torque
                continue
            torque, by_q, by_qd, *others = array_outputs(self.graph, self.outputs, inputs)
            by_qd = mass * np.where(speed <= _SLOWEST, 0.0, by_qd)
            of_turn = share * (grows * height - length * side * moves)
            sums[1] += of_turn * torque + by_qd * change * moves
            sums[3] += by_qd
            sums[4] += by_qd * x * h
            sums[0] += mass * torque
            sums[2] += mass * by_q
            for total, value in zip(sums[5:], others, strict=True):
                total += mass * value
