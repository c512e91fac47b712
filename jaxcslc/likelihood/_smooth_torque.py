"""Torque of all terms but friction of single joints, with derivatives.

`SmoothTorque` is columns of the network times coefficients. C code computes it where there is a
compiler and the network can be written as expressions. Without, NumPy does.
"""

import dataclasses
from collections.abc import Sequence
from functools import lru_cache

import numpy as np
from jaxtyping import Float

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
from ._joint_friction import JointMotion


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

Rows = Float[np.ndarray, "joints samples"]
Coefficients = Float[np.ndarray, " coefficients"]
ByPosition = Float[np.ndarray, "samples joints positions"]
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
        rows_of_joints, last = CArray("joints samples"), "samples joints changed"
        kinds = (
            *(CArray("coefficients"), *[rows_of_joints] * 3),
            *(CArray("kinds joints samples", optional=True),),
            *(CArray("kinds positions samples", optional=True),),
            CArray("joints samples", written=True),
            CArray("entries samples", written=True, optional=True),
            CArray(last, written=True, optional=True),
            LONG,
        )
        options = ("-O1",) if operations > _QUICKLY else ()
        code = CFunction(source, "torques", kinds, options)
        return cls(network, tuple(sums), code) if code.is_available else None

    def torque(self, k: Coefficients, motion: Sequence[Rows]) -> Rows:
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
    ) -> tuple[Rows, Columns]:
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

    def _columns(self, *motion: Rows) -> Columns:
        """Return columns of entries, by NumPy."""
        rows = [np.zeros((0, motion[0].shape[1]))]
        parts = [term.columns(*map(np.ascontiguousarray, motion)) for term in _terms(self.network)]
        rows += [np.asarray(x) for of_joint in zip(*parts, strict=True) for x in of_joint]
        return np.concatenate(rows)

    def _summed(self, k: Coefficients, columns: Columns) -> Rows:
        """Return columns times coefficients."""
        result = np.zeros((self.network.joint_count, columns.shape[1]))
        for (joint, index), column in zip(self.entries, columns, strict=True):
            result[joint] += k[index] * column
        return result


def _terms(network: CSLC) -> list[AbstractManipulatorTerm]:
    return [term for term in network.terms if not isinstance(term, JointTerm)]
