"""C code of equations of motion; `MotionCode` puts a network's statements in."""

from dataclasses import dataclass
from functools import cached_property, lru_cache
from typing import Any

import numpy as np
from jaxtyping import Float

from .._chunks import over_chunks
from ..codegen import LONG, CArray, CFunction
from ..network import CSLC
from ._columns import JointColumns
from ._friction_code import friction_code, smooth_code
from ._friction_mean import NODES, SLOWEST
from ._linearisation import ANGLE, RATE, Linearisation


SOURCE = """#include <math.h>
#include <string.h>

#define BLOCK {block}
#define N {joints}
#define ENTRIES {entry_count}
#define COLUMNS {column_count}
#define MOST_LAWS {most_laws}

typedef double real;
typedef void law(double, double, double, double* restrict, double* restrict, double* restrict,
                 double* restrict);

/* Where columns, values of laws and derivatives by slopes are among an equation's derivatives that
   are not 0; a joint without a slope has -1. */
static const int targets[] = {{ {targets} }};
static const int law_targets[] = {{ {law_targets} }};
static const int slope_targets[] = {{ {slope_targets} }};
static const double nodes[] = {{ {nodes} }};

{law_functions}

static law* const laws[] = {{ {laws} }};
static const int law_counts[] = {{ {law_counts} }};
static const int law_firsts[] = {{ {law_firsts} }};
static const int law_indices[] = {{ {law_indices} }};

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

/* Friction of a joint in one equation, and its derivatives. */
struct friction {{
    double values[MOST_LAWS];
    double torque, by_q, by_velocity, by_before, by_after, by_turn, by_slope;
}};

/* Averaged with a triangle over both intervals, with two nodes in each part between sample,
   reversal and the samples next to it. */
static void average(
    int joint, const double* k, double q, double velocity, double before, double after,
    double share, double turn, double direction, double slope, struct friction* result)
{{
    const int count = law_counts[joint];
    const int* index = law_indices + law_firsts[joint];
    const double first = turn < 0.0 ? turn : 0.0, second = turn > 0.0 ? turn : 0.0;
    const double starts[] = {{ -1.0, first, second }}, ends[] = {{ first, second, 1.0 }};
    const double moved_first = turn <= 0.0, moved_second = turn > 0.0;
    const double start_moves[] = {{ 0.0, moved_first, moved_second }};
    const double end_moves[] = {{ moved_first, moved_second, 0.0 }};
    const double signs[] = {{ -direction, turn > 0.0 ? -direction : direction, direction }};
    double values[MOST_LAWS], by_q[MOST_LAWS], by_qd[MOST_LAWS], by_slope[MOST_LAWS];
    memset(result, 0, sizeof *result);
    for (int part = turn <= -1.0; part < 3; ++part) {{
        const double length = ends[part] - starts[part];
        const double grows = end_moves[part] - start_moves[part];
        if (length == 0.0 && grows == 0.0)
            continue;
        for (int node = 0; node < 2; ++node) {{
            const double x = starts[part] + length * nodes[node];
            const double moves = start_moves[part] + grows * nodes[node];
            const int earlier = x < 0.0;
            const double change = earlier ? before : after;
            const double weight = earlier ? share : 1.0 - share;
            const double height = 1.0 - fabs(x);
            const double mass = weight * length * height;
            const double mass_grows =
                weight * (grows * height - length * (earlier ? -1.0 : 1.0) * moves);
            const double speed = signs[part] * (velocity + x * change);
            const int slow = speed <= {slowest};
            laws[joint](q, signs[part] * (slow ? {slowest} : speed), slope, values, by_q, by_qd,
                        by_slope);
            double torque = 0.0, of_q = 0.0, of_qd = 0.0, of_slope = 0.0;
            for (int l = 0; l < count; ++l) {{
                const double factor = k[index[l]];
                result->values[l] += mass * values[l];
                torque += factor * values[l];
                of_q += factor * by_q[l];
                of_qd += factor * by_qd[l];
                of_slope += factor * by_slope[l];
            }}
            if (slow)
                of_qd = 0.0;
            result->torque += mass * torque;
            result->by_q += mass * of_q;
            result->by_velocity += mass * of_qd;
            *(earlier ? &result->by_before : &result->by_after) += mass * of_qd * x;
            result->by_turn += mass_grows * torque + mass * of_qd * change * moves;
            result->by_slope += mass * of_slope;
        }}
    }}
}}

/* Motion of a block of equations, joint by joint; what is left of it is filled up. */
static void read_motion(
    const double* samples, const double* h, long count, double* q, double* qd, double* qdd)
{{
    for (int i = 0; i < BLOCK; ++i) {{
        const long row = i < count ? i : count - 1;
        const double before = h[row], after = h[row + 1], both = before + after;
        for (int j = 0; j < N; ++j) {{
            const double* x = samples + N * row + j;
            const double one = (x[N] - x[0]) / before, other = (x[2 * N] - x[N]) / after;
            q[BLOCK * j + i] = x[N];
            qd[BLOCK * j + i] = (after * one + before * other) / both;
            qdd[BLOCK * j + i] = 2 * (other - one) / both;
        }}
    }}
}}

/* Derivatives of a block's torque by positions, velocities and accelerations: 3 N times N rows. The
   last ones are exact, for torque is linear in accelerations. */
static void differentiate(
    double* q, double* qd, double* qdd, const double* called, double* others, const double* k,
    const double* torque, double* changes)
{{
    double* const motion[] = {{ q, qd, qdd }};
    const double steps[] = {{ {angle}, {rate}, 1.0 }};
    double kept[BLOCK];
    for (int kind = 0; kind < 3; ++kind)
        for (int j = 0; j < N; ++j) {{
            double* const moved = motion[kind] + BLOCK * j;
            double* const change = changes + BLOCK * N * (N * kind + j);
            memcpy(kept, moved, sizeof kept);
            for (int i = 0; i < BLOCK; ++i)
                moved[i] += steps[kind];
            if (kind == 0)
                call_functions(q, qd, qdd, others);
            compute_torque(q, qd, qdd, kind ? called : others, k, change);
            for (int i = 0; i < BLOCK * N; ++i)
                change[i] = (change[i] - torque[i]) / steps[kind];
            memcpy(moved, kept, sizeof kept);
        }}
}}

/* Torque of equations in the middle of three samples, (count, N), and of friction alone at
   velocities that are larger by a shift, where there is one. With derivatives where there is
   memory for these: by positions at three samples, (count, N, 3 N), by coefficients and the
   logarithms of slopes, (count, ENTRIES), and by moments of turns, (count, N). */
void torques(
    const double* k, const double* slopes, const double* samples, const double* h,
    const double* turn, const double* direction, const double* shift, double* torque,
    double* by_position, double* by_coefficient, double* by_turn, long count)
{{
    static _Thread_local double q[N * BLOCK], qd[N * BLOCK], qdd[N * BLOCK], smooth[N * BLOCK];
    static _Thread_local double called[{called} * BLOCK], others[{called} * BLOCK];
    static _Thread_local double columns[(COLUMNS + 1) * BLOCK], changes[3 * N * N * BLOCK];
    struct friction friction;
    for (long start = 0; start < count; start += BLOCK) {{
        const long left = count - start < BLOCK ? count - start : BLOCK;
        read_motion(samples + N * start, h + start, left, q, qd, qdd);
        if (!shift) {{
            call_functions(q, qd, qdd, called);
            compute_torque(q, qd, qdd, called, k, smooth);
        }}
        if (by_position) {{
            compute_columns(q, qd, qdd, called, columns);
            differentiate(q, qd, qdd, called, others, k, smooth, changes);
        }}
        for (long i = 0; i < left; ++i) {{
            const long row = start + i;
            const double before = h[row], after = h[row + 1], both = before + after;
            const double of_velocity[] = {{
                -after / (before * both), after / (before * both) - before / (after * both),
                before / (after * both) }};
            const double of_acceleration[] = {{
                2 / (before * both), -2 / (before * after), 2 / (after * both) }};
            for (int j = 0; j < N; ++j) {{
                const int at = BLOCK * j + i;
                average(j, k, q[at], qd[at] + (shift ? shift[N * row + j] : 0.0), qdd[at] * before,
                        qdd[at] * after, before / both, turn[N * row + j], direction[N * row + j],
                        slopes[j], &friction);
                torque[N * row + j] = friction.torque + (shift ? 0.0 : smooth[at]);
                if (!by_position)
                    continue;
                by_turn[N * row + j] = friction.by_turn;
                double* const to = by_position + 3 * N * (N * row + j);
                for (int m = 0; m < N; ++m) {{
                    double by_q = changes[BLOCK * (N * m + j) + i];
                    double by_qd = changes[BLOCK * (N * (N + m) + j) + i];
                    double by_qdd = changes[BLOCK * (N * (2 * N + m) + j) + i];
                    if (m == j) {{
                        by_q += friction.by_q;
                        by_qd += friction.by_velocity;
                        by_qdd += friction.by_before * before + friction.by_after * after;
                    }}
                    for (int part = 0; part < 3; ++part)
                        to[N * part + m] =
                            by_qd * of_velocity[part] + by_qdd * of_acceleration[part];
                    to[N + m] += by_q;
                }}
                double* const entries = by_coefficient + ENTRIES * row;
                for (int l = 0; l < law_counts[j]; ++l)
                    entries[law_targets[law_firsts[j] + l]] = friction.values[l];
                if (slope_targets[j] >= 0)
                    entries[slope_targets[j]] = friction.by_slope * slopes[j];
            }}
            if (by_position) {{
                double* const entries = by_coefficient + ENTRIES * row;
                for (int column = 0; column < COLUMNS; ++column)
                    entries[targets[column]] = columns[BLOCK * column + i];
            }}
        }}
    }}
}}

/* Torque of all terms but friction at instants, (count, N). */
void smooth(
    const double* k, const double* positions, const double* velocities,
    const double* accelerations, double* torque, long count)
{{
    static _Thread_local double q[N * BLOCK], qd[N * BLOCK], qdd[N * BLOCK], result[N * BLOCK];
    static _Thread_local double called[{called} * BLOCK];
    for (long start = 0; start < count; start += BLOCK) {{
        const long left = count - start < BLOCK ? count - start : BLOCK;
        for (int i = 0; i < BLOCK; ++i)
            for (int j = 0; j < N; ++j) {{
                const long from = N * (start + (i < left ? i : left - 1)) + j;
                q[BLOCK * j + i] = positions[from];
                qd[BLOCK * j + i] = velocities[from];
                qdd[BLOCK * j + i] = accelerations[from];
            }}
        call_functions(q, qd, qdd, called);
        compute_torque(q, qd, qdd, called, k, result);
        for (long i = 0; i < left; ++i)
            for (int j = 0; j < N; ++j)
                torque[N * (start + i) + j] = result[BLOCK * j + i];
    }}
}}
"""


# Equations at a time, whose numbers stay in a core's cache.
_BLOCK = 128
# And those that a thread computes.
_CHUNK = 4096
# A compiler takes a second for a thousand operations, and longer than in proportion; from so many
# on less of it: for a Panda with symbolic lengths (20,000) a minute and 0.4 GB.
_QUICKLY = 5000
# XLA needs more than 30 GB for that, and did not end in five minutes.
_MOST_OPERATIONS, _MOST_WITHOUT_COMPILER = 25_000, 5000

_ROWS = "equations joints"
Samples = Float[np.ndarray, "samples joints"]
Rows = Float[np.ndarray, "equations joints"]


@dataclass(frozen=True)
class MotionCode:
    """Equations of motion of one network as compiled C code: what `MotionEquations` are in JAX.

    On a core it takes a tenth of the time of what XLA makes of the same expressions, and nothing is
    traced in every process.

    **Attributes**

    - `source`: of the library.
    - `joints`, `coefficients`: n and p.
    - `entries`: joint and column of the derivatives that are not 0, see `JointColumns`.
    - `operations`: of torque.

    Methods have the arguments of `MotionEquations`, and `intervals`, (samples - 1,) [s].
    """

    source: str
    joints: int
    coefficients: int
    entries: tuple[tuple[int, int], ...]
    operations: int

    @cached_property
    def torques(self) -> CFunction:
        """The function of positions at all samples."""
        samples = CArray("samples joints"), CArray("intervals"), CArray(_ROWS), CArray(_ROWS)
        outputs = "equations joints positions", "equations entries", _ROWS
        kinds = (
            *(CArray("coefficients"), CArray("joints"), *samples, CArray(_ROWS, optional=True)),
            CArray(_ROWS, written=True),
            *(CArray(axes, written=True, optional=True) for axes in outputs),
            LONG,
        )
        return CFunction(self.source, "torques", kinds, self._options)

    @cached_property
    def smooth_torques(self) -> CFunction:
        """The function of motion at instants."""
        motion = (CArray(_ROWS),) * 3
        kinds = (CArray("coefficients"), *motion, CArray(_ROWS, written=True), LONG)
        return CFunction(self.source, "smooth", kinds, self._options)

    @property
    def _options(self) -> tuple[str, ...]:
        return ("-O1",) if self.operations > _QUICKLY else ()

    def torque(
        self,
        intervals: Float[np.ndarray, " intervals"],
        k: Float[np.ndarray, " coefficients"],
        slopes: Float[np.ndarray, " joints"],
        q: Samples,
        turn: Rows,
        direction: Rows,
    ) -> Rows:
        """(equations, n)."""
        torque = np.empty((len(q) - 2, self.joints))
        motion = q, intervals, turn, direction, None
        self._call(self.torques, (k, np.exp(slopes)), motion, (torque, None, None, None))
        return torque

    def linearised(
        self,
        intervals: Float[np.ndarray, " intervals"],
        k: Float[np.ndarray, " coefficients"],
        slopes: Float[np.ndarray, " joints"],
        q: Samples,
        turn: Rows,
        direction: Rows,
    ) -> Linearisation:
        """Compute torques with derivatives."""
        count, n = len(q) - 2, self.joints
        torque, by_turn = np.empty((2, count, n))
        by_position = np.empty((count, n, 3 * n))
        by_entry = np.empty((count, len(self.entries)))
        motion = q, intervals, turn, direction, None
        outputs = torque, by_position, by_entry, by_turn
        self._call(self.torques, (k, np.exp(slopes)), motion, outputs)
        joints, columns = np.array(self.entries, int).reshape(-1, 2).T
        shape = n, self.coefficients + n
        of_entries = JointColumns(by_entry, joints, columns, shape)
        return Linearisation(torque, by_position, of_entries, by_turn)

    def smooth(
        self, k: Float[np.ndarray, " coefficients"], q: Rows, velocity: Rows, acceleration: Rows
    ) -> Rows:
        """Torque of all terms but friction, at instants, (equations, n)."""
        torque = np.empty_like(q)
        self._call(self.smooth_torques, (k,), (q, velocity, acceleration), (torque,))
        return torque

    def friction(
        self,
        intervals: Float[np.ndarray, " intervals"],
        k: Float[np.ndarray, " coefficients"],
        slopes: Float[np.ndarray, " joints"],
        q: Samples,
        turn: Rows,
        direction: Rows,
        shift: Rows,
    ) -> Rows:
        """Torque of friction alone, for velocities that are larger by `shift`."""
        torque = np.empty_like(turn)
        motion = q, intervals, turn, direction, shift
        self._call(self.torques, (k, np.exp(slopes)), motion, (torque, None, None, None))
        return torque

    def _call(
        self,
        function: CFunction,
        constants: tuple[np.ndarray, ...],
        motion: tuple[np.ndarray | None, ...],
        outputs: tuple[np.ndarray | None, ...],
    ) -> None:
        """Calls a function of the library: the first rows of `motion` and of `outputs` are those of
        the first equation, and so on."""
        bound = function.bound(*constants)
        rows = [None if x is None else np.ascontiguousarray(x, float) for x in motion]
        rows += outputs
        assert outputs[0] is not None

        def compute(first: int, last: int) -> None:
            bound(*(None if x is None else x[first:] for x in rows), last - first)

        over_chunks(compute, len(outputs[0]), _CHUNK, align=_BLOCK)


def motion_code(network: CSLC) -> MotionCode | None:
    """The code of a network's equations of motion.

    None where there is no C compiler, and for networks that cannot be written as expressions.

    **Raises** `ValueError` for networks of so many operations that they cannot be compiled in a
    reasonable time or memory.
    """
    if network.static_slopes is not None:  # arguments of the code
        network = network.with_static_slopes(np.ones(network.joint_count))
    # Its layout is kept once it was asked for, and networks with and without it are not equal.
    code = _of_network(network, network.layout.size)
    if code is None:
        return None
    # Not compiled at all if it is too much.
    without = code.operations > _MOST_OPERATIONS or not code.torques.is_available
    if without and code.operations > _MOST_WITHOUT_COMPILER:
        raise ValueError(
            f"{network.name!r}: equations of motion of {code.operations:,} operations are too many"
            " to compile for maximum likelihood; expected numeric lengths,"
            " as of derive(robot, lengths='numeric')"
        )
    return None if without else code


@lru_cache(maxsize=16)
def _of_network(network: CSLC, p: int) -> MotionCode | None:
    if not network.has_column_entries:
        return None
    smooth = smooth_code(network, _BLOCK)
    friction = friction_code(network)
    n = network.joint_count
    laws = [(joint, index) for joint, row in enumerate(friction.indices) for index in row]
    slopes = [(joint, p + joint) for joint in friction.slopes]
    entries = sorted([*smooth.entries, *laws, *slopes])
    targets = {entry: number for number, entry in enumerate(entries)}
    assert len(targets) == len(entries)
    source = SOURCE.format(
        block=_BLOCK,
        joints=n,
        entry_count=len(entries),
        angle=ANGLE,
        rate=RATE,
        slowest=SLOWEST,
        nodes=_listed(NODES.tolist()),
        called=max(smooth.call_count, 1),
        column_count=len(smooth.entries),
        targets=_listed([targets[entry] for entry in smooth.entries] or [0]),
        law_targets=_listed([targets[entry] for entry in laws] or [0]),
        slope_targets=_listed([targets.get((joint, p + joint), -1) for joint in range(n)]),
        laws=_listed([f"law_{joint}" for joint in range(n)]),
        law_counts=_listed([len(indices) for indices in friction.indices]),
        most_laws=max(1, *(len(indices) for indices in friction.indices)),
        law_firsts=_listed(np.cumsum([0, *map(len, friction.indices)])[:-1].tolist()),
        law_indices=_listed([index for _, index in laws] or [0]),
        law_functions=friction.functions,
        calls=smooth.calls,
        torque=smooth.torque,
        columns=smooth.columns,
    )
    return MotionCode(source, n, p, tuple(entries), smooth.operations)


def _listed(numbers: list[Any]) -> str:
    return ", ".join(str(x) for x in numbers)
