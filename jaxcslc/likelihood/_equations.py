"""Equations of motion: what every kind of them does, and those of rigid links.

`SmoothTorque` is torque of all terms but friction of single joints: columns of the network times
coefficients. C code computes it where there is a compiler and the network can be written as
expressions. Otherwise NumPy does. `_joint_friction` has friction.
"""

import abc
import dataclasses
from collections.abc import Callable, Sequence
from functools import cached_property, lru_cache
from typing import NamedTuple

import numpy as np
from jaxtyping import Float, Int

from .._processes import over_chunks
from ..codegen import (
    LONG,
    CArray,
    CFunction,
    Motion,
    Value,
    block_row,
    block_text,
    called_functions,
)
from ..network import CSLC, AbstractManipulatorTerm, JointTerm
from ._equation_sums import JointColumns
from ._joint_friction import JointFriction, JointMotion
from ._readings import triangle_mean


Samples = Float[np.ndarray, "samples joints"]
Rows = Float[np.ndarray, "equations joints"]
Turns = Float[np.ndarray, "equations joints"]
Joints = Float[np.ndarray, " joints"]
Coefficients = Float[np.ndarray, " coefficients"]
Laws = Float[np.ndarray, " laws"]
# Equations that a thread computes, so that their numbers stay in a core's cache.
_CHUNK = 4096
# Below so many samples there are no differences of differences.
_FEWEST = 5


class Linearisation(NamedTuple):
    """The torque of every equation, and its derivatives.

    **Attributes**

    - `torque`: (equations, n).
    - `by_position`: (equations, n, 3 n), by the positions at three samples.
    - `by_coefficient`: p + n columns: by `k`, then by the logarithms of slopes.
    - `by_turn`: (equations, n), by the moment at which the joint turns.
    """

    torque: Float[np.ndarray, "equations joints"]
    by_position: Float[np.ndarray, "equations joints positions"]
    by_coefficient: JointColumns
    by_turn: Float[np.ndarray, "equations joints"]


class EquationPoint(NamedTuple):
    """Unknowns that equations of motion have, and the signs of a motion.

    **Attributes**

    - `k`: (p,); `laws`: (n,) logarithms of slopes of static friction, and what else equations have.
    - `q`: (samples, n) positions.
    - `turn`: (equations, n) when a joint turns, in intervals about the sample; -1 for one that
      moves one way. `direction`: 1 or -1, the sign of velocity after `turn`.
    """

    k: Coefficients
    laws: Laws
    q: Samples
    turn: Turns
    direction: Turns


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
    def torque(self, at: EquationPoint) -> Rows:
        """Return torque of every equation, (equations, n)."""

    @abc.abstractmethod
    def linearised(self, at: EquationPoint) -> Linearisation:
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
        at: EquationPoint,
        time: Float[np.ndarray, " samples"],
        part: Int[np.ndarray, " samples"],
    ) -> Rows:
        """Return truncation errors of sampled torques at present positions, (equations, n)."""
        del time, part
        return np.zeros((len(at.q) - 2, at.q.shape[1]))

    @property
    def presliding_distance(self) -> Joints:
        """(n,) of pre-sliding [rad or m]; 0 where dry friction follows the sign of velocity."""
        return np.zeros(self.network.joint_count)

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

    def torque(self, at: EquationPoint) -> Rows:
        """Return what `AbstractEquations` declares."""
        result, smooth, friction = np.empty(at.turn.shape), self._smooth, self._friction

        def compute(first: int, last: int) -> None:
            motion = self._motion(at, slice(first, last))
            torque = smooth.torque(at.k, motion[:3])
            for of_joints in friction:
                torque[of_joints.joints] += of_joints.torque(at.k, at.laws, motion)
            result[first:last] = torque.T

        over_chunks(compute, len(result), _CHUNK)
        return result

    def linearised(self, at: EquationPoint) -> Linearisation:
        """Return what `AbstractEquations` declares."""
        (count, n), smooth, friction = at.turn.shape, self._smooth, self._friction
        entries = np.array([*smooth.entries, *(e for part in friction for e in part.entries)], int)
        order = np.lexsort(entries.reshape(-1, 2).T[::-1])
        torque, by_turn = np.zeros((2, count, n))
        by_position, by_entry = np.zeros((count, n, 3 * n)), np.empty((count, len(entries)))

        def compute(first: int, last: int) -> None:
            rows = slice(first, last)
            motion = self._motion(at, rows)
            of_friction, by_motion = np.zeros((n, last - first)), np.zeros((3, n, last - first))
            by_friction: list[np.ndarray] = []
            for of_joints in friction:
                mean, joints = of_joints.mean(at.k, at.laws, motion), of_joints.joints
                of_friction[joints], by_motion[:, joints] = mean.torque, mean.by_motion
                by_turn[rows, joints] = mean.by_turn.T
                by_friction += [mean.by_coefficient, mean.by_slope]
            total, columns = smooth.linearised(at.k, motion, by_motion, by_position[rows])
            torque[rows] = (total + of_friction).T
            by_entry[rows] = np.concatenate([columns, *by_friction])[order].T

        over_chunks(compute, count, _CHUNK)
        joints, columns = entries.reshape(-1, 2)[order].T
        of_entries = JointColumns(by_entry, joints, columns, (n, self.network.size + n))
        return Linearisation(torque, by_position, of_entries, by_turn)

    def truncation(
        self,
        at: EquationPoint,
        time: Float[np.ndarray, " samples"],
        part: Int[np.ndarray, " samples"],
    ) -> Rows:
        """Return what `AbstractEquations` declares; see `triangle_truncation`."""

        def smooth(*motion: Rows) -> Rows:
            return self._smooth.torque(at.k, [x.T for x in motion]).T

        result, shift = triangle_truncation(smooth, at.q, time, part)
        motion = self._motion(at, slice(0, len(at.turn)))
        shifted = motion._replace(velocity=motion.velocity + shift.T)
        for friction in self._friction:
            with_shift, without = (friction.torque(at.k, at.laws, x) for x in (shifted, motion))
            result[:, friction.joints] += (with_shift - without).T
        return result

    def _motion(self, at: EquationPoint, rows: slice) -> JointMotion:
        """Return the motion of some equations."""
        positions = np.ascontiguousarray(at.q[rows.start : rows.stop + 2].T)
        intervals = self.intervals[rows.start : rows.stop + 1]
        return JointMotion.of(positions, intervals, at.turn[rows].T, at.direction[rows].T)

    @cached_property
    def _smooth(self) -> "SmoothTorque":
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

    Torque of an equation is of one instant, except for the mean of acceleration: what means of
    products leave out is of second order in the interval. Here all is of fourth order: velocity and
    acceleration at the instant, from differences of differences, and the mean of the torques of
    three instants as it is taken of recorded ones. It is as large as noise where torque is nearly
    exact and samples are few, and unlike noise it moves coefficients the same way all along.

    For positions as they are: a search takes it from one step to the next (deferred correction,
    Pereyra 1968), which leaves the band as narrow as it is. Not for held torques, whose steps make
    accelerations jump, and whose mean acceleration is exact.

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
    # Means are inverted in so many rounds: at even intervals, one leaves errors of fourth order.
    for _ in range(3):
        acceleration = acceleration + mean_acceleration - mean(acceleration)
    # A parabola's derivative errs by the third derivative times a sixth of both intervals.
    velocity = parabola - before * after / 6.0 * np.gradient(acceleration, middle, axis=0)
    torque = mean(smooth(q[1:-1], velocity, acceleration))
    result = torque - smooth(q[1:-1], parabola, mean_acceleration)
    # Friction is averaged over velocities on a line through the parabola's.
    line = parabola + (after - before) / 3.0 * mean_acceleration
    return result, mean(velocity) - line


SOURCE = """#include <math.h>
#include <string.h>

#define BLOCK {block}
#define N {joints}
#define ENTRIES {entries}

typedef double real;

/* Functions of a block's motion, which are called number by number. */
static void call_functions(
    const double* restrict q, const double* restrict qd, const double* restrict qdd,
    double* restrict called)
{{
    for (int i = 0; i < BLOCK; ++i) {{
{calls}
    }}
}}

static void compute_torque(
    const double* restrict q, const double* restrict qd, const double* restrict qdd,
    const double* restrict called, const double* restrict k, double* restrict torque)
{{
    for (int i = 0; i < BLOCK; ++i) {{
{torque}
    }}
}}

static void compute_columns(
    const double* restrict q, const double* restrict qd, const double* restrict qdd,
    const double* restrict called, double* restrict columns)
{{
    for (int i = 0; i < BLOCK; ++i) {{
{columns}
    }}
}}

static void write(const double* block, int rows, double* all, long samples, long start, long left)
{{
    for (int row = 0; row < rows; ++row)
        memcpy(all + samples * row + start, block + BLOCK * row, left * sizeof(double));
}}

/* Torque, (N, samples). With memory for them, columns, (ENTRIES, samples), and derivatives by three
   positions, (samples, N, 3 N): by the motion of all joints in forward differences, to which
   `by_motion` of each joint's own is added, (3, N, samples), times `stencil`, (3, 3, samples). */
void torques(
    const double* k, const double* positions, const double* velocities,
    const double* accelerations, const double* by_motion, const double* stencil, double* torque,
    double* columns, double* by_position, long samples)
{{
    static _Thread_local double motion[3][N * BLOCK], called[{called} * BLOCK];
    static _Thread_local double total[N * BLOCK], changed[N * BLOCK], others[{called} * BLOCK];
    static _Thread_local double entries[(ENTRIES + 1) * BLOCK];
    const double* const rows[] = {{ positions, velocities, accelerations }};
    const double steps[] = {{ {steps} }};
    double kept[BLOCK];
    double *const q = motion[0], *const qd = motion[1], *const qdd = motion[2];
    for (long start = 0; start < samples; start += BLOCK) {{
        const long left = samples - start < BLOCK ? samples - start : BLOCK;
        for (int kind = 0; kind < 3; ++kind)
            for (int j = 0; j < N; ++j) /* what is left of a block are earlier numbers */
                memcpy(motion[kind] + BLOCK * j, rows[kind] + samples * j + start,
                       left * sizeof(double));
        call_functions(q, qd, qdd, called);
        compute_torque(q, qd, qdd, called, k, total);
        write(total, N, torque, samples, start, left);
        if (!by_position)
            continue;
        compute_columns(q, qd, qdd, called, entries);
        write(entries, ENTRIES, columns, samples, start, left);
        for (int kind = 0; kind < 3; ++kind)
            for (int m = 0; m < N; ++m) {{
                double* const moved = motion[kind] + BLOCK * m;
                memcpy(kept, moved, sizeof kept);
                for (int i = 0; i < BLOCK; ++i)
                    moved[i] += steps[kind];
                if (kind == 0)
                    call_functions(q, qd, qdd, others);
                compute_torque(q, qd, qdd, kind ? called : others, k, changed);
                memcpy(moved, kept, sizeof kept);
                for (int j = 0; j < N; ++j)
                    for (int i = 0; i < left; ++i) {{
                        const int at = BLOCK * j + i;
                        double change = (changed[at] - total[at]) / steps[kind];
                        if (m == j)
                            change += by_motion[samples * (N * kind + j) + start + i];
                        double* const to = by_position + 3 * N * (N * (start + i) + j) + m;
                        const double* const weight = stencil + 3 * samples * kind + start + i;
                        for (int part = 0; part < 3; ++part)
                            to[N * part] += change * weight[samples * part];
                    }}
            }}
    }}
}}
"""

# Samples at a time, whose numbers stay in a core's cache.
_BLOCK = 128
# Steps of positions [rad or m], of velocities [rad/s or m/s] and of accelerations in forward
# differences. Their error is this part of a second derivative; that of velocities counts by half an
# interval beside accelerations, in which torque is linear.
_STEPS = (1e-7, 1e-5, 1.0)
# A compiler takes a second for a thousand operations, and longer than in proportion; from so many
# on less of it: for a Panda with symbolic lengths (20,000) a minute and 0.4 GB. NumPy computes more
# than that.
_QUICKLY, _MOST_COMPILED = 5000, 25_000

JointRows = Float[np.ndarray, "joints samples"]
ByPosition = Float[np.ndarray, "samples joints changed"]
Columns = Float[np.ndarray, "entries samples"]


@dataclasses.dataclass(frozen=True, eq=False)
class SmoothTorque:
    """Torque of a network's terms without friction of single joints.

    **Attributes**

    - `network`: n joints, p coefficients.
    - `entries`: joint and coefficient of each column, joint by joint.
    - `code`: computes it; None where NumPy does.
    """

    network: CSLC
    entries: tuple[tuple[int, int], ...]
    code: CFunction | None = None

    @classmethod
    @lru_cache(maxsize=16)
    def of(cls, network: CSLC, size: int) -> "SmoothTorque":
        """Return that of a network of `size` coefficients."""
        del size
        compiled = cls._compiled(network) if network.has_column_entries else None
        if compiled is not None:
            return compiled
        entries = (
            (joint, int(network.layout.indices(term.kind)[index]))
            for joint in range(network.joint_count)
            for term in _terms(network)
            for index in term.support[joint]
        )
        return cls(network, tuple(entries))

    @classmethod
    def _compiled(cls, network: CSLC) -> "SmoothTorque | None":
        """Return it with C code; None where there is no compiler, or too much to compile."""
        n, motion = network.joint_count, Motion(network.motion_count)
        graph, zero = motion.graph, motion.graph.constant(0.0)
        smooth = {i for term in _terms(network) for i in network.layout.indices(term.kind).tolist()}
        sums: dict[tuple[int, int], Value] = {}
        for joint, index, value in network.column_entries(motion):
            if index in smooth:
                sums[joint, index] = sums.get((joint, index), zero) + value
        torque = [zero] * n
        for (joint, index), value in sums.items():
            torque[joint] = torque[joint] + value * graph.input(f"k[{index}]")
        operations = graph.cost(torque)
        if operations > _MOST_COMPILED:
            return None
        columns = list(sums.values())
        called = called_functions(graph, [*columns, *torque])
        rows = {name: (name, 0) for name in ("q", "qd", "qdd")}
        calling = block_text(graph, _BLOCK, rows)
        reading = block_text(graph, _BLOCK, rows, called, ("called", 0))
        statements: dict[str, str] = {}
        for name, text, outputs in (
            ("calls", calling, [Value(graph, index) for index in called]),
            ("torque", reading, torque),
            ("columns", reading, columns),
        ):
            array = "called" if name == "calls" else name
            stores = (f"{block_row(array, _BLOCK, row)} = {{0}};" for row in range(len(outputs)))
            statements[name] = "\n".join(text.statements(zip(outputs, stores, strict=True)))
        source = SOURCE.format(
            block=_BLOCK,
            joints=n,
            entries=len(sums),
            called=max(len(called), 1),
            steps=", ".join(map(str, _STEPS)),
            **statements,
        )
        kinds = (
            *(CArray("coefficients"), *[CArray("joints samples")] * 3),
            CArray("kinds joints samples", optional=True),
            CArray("kinds positions samples", optional=True),
            CArray("joints samples", written=True),
            CArray("entries samples", written=True, optional=True),
            CArray("samples joints changed", written=True, optional=True),
            LONG,
        )
        options = ("-O1",) if operations > _QUICKLY else ()
        code = CFunction(source, "torques", kinds, options)
        return cls(network, tuple(sums), code) if code.is_available else None

    def torque(self, k: Coefficients, motion: Sequence[JointRows]) -> JointRows:
        """Return torque; `motion`: position, velocity and acceleration of samples."""
        if self.code is None:
            return self._summed(k, self._columns(*motion))
        motion = [np.ascontiguousarray(x) for x in motion]
        result = np.empty((self.network.joint_count, motion[0].shape[1]))
        self.code(k, *motion, None, None, result, None, None, result.shape[1])
        return result

    def linearised(
        self,
        k: Coefficients,
        motion: JointMotion,
        by_motion: Float[np.ndarray, "3 joints samples"],
        by_position: ByPosition,
    ) -> tuple[JointRows, Columns]:
        """Return torque and columns, and add derivatives by positions at three samples.

        - `by_motion`: of what else joints have, by their own position, velocity and acceleration.
        - `by_position`: (samples, n, 3 n) zeros that derivatives are added to.
        """
        n, samples, stencil = self.network.joint_count, motion.h.shape[1], motion.stencil
        if self.code is not None:
            torque, columns = np.empty((n, samples)), np.empty((len(self.entries), samples))
            instants = [np.ascontiguousarray(x) for x in motion[:3]]
            outputs = torque, columns, by_position
            self.code(k, *instants, by_motion, stencil, *outputs, samples)
            return torque, columns
        columns = self._columns(*motion[:3])
        torque = self._summed(k, columns)
        changes = np.empty((3, n, n, samples))
        for kind, step in enumerate(_STEPS):
            for joint in range(n):
                moved = list(motion[:3])
                moved[kind] = motion[kind].copy()
                moved[kind][joint] += step
                changes[kind, joint] = (self._summed(k, self._columns(*moved)) - torque) / step
        changes[:, np.arange(n), np.arange(n)] += by_motion
        by_position += np.einsum("amjs,aps->sjpm", changes, stencil).reshape(by_position.shape)
        return torque, columns

    def _columns(self, *motion: JointRows) -> Columns:
        """Return columns of entries, by NumPy."""
        rows = [np.zeros((0, motion[0].shape[1]))]
        parts = [term.columns(*map(np.ascontiguousarray, motion)) for term in _terms(self.network)]
        rows += [np.asarray(x) for of_joint in zip(*parts, strict=True) for x in of_joint]
        return np.concatenate(rows)

    def _summed(self, k: Coefficients, columns: Columns) -> JointRows:
        """Return columns times coefficients."""
        result = np.zeros((self.network.joint_count, columns.shape[1]))
        for (joint, index), column in zip(self.entries, columns, strict=True):
            result[joint] += k[index] * column
        return result


def _terms(network: CSLC) -> list[AbstractManipulatorTerm]:
    return [term for term in network.terms if not isinstance(term, JointTerm)]
