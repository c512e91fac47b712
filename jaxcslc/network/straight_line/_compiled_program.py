from collections.abc import Sequence
from dataclasses import dataclass
from functools import cached_property

import numpy as np
from jaxtyping import Float

from ...codegen import LONG, CArray, CFunction, CRows
from ._expressions import Motion, Operation, Value
from ._kernel_text import KernelText
from ._program import Program


# What NumPy computes: its functions are as exact as the C library's and take less time.
_OF_NUMPY = ("sin", "cos", "exp", "tanh")
# Samples at a time: a Panda's columns take 0.4 MB, a core's cache.
_BLOCK = 256
# Each operation rounds as NumPy's does: results are the same to the last digit.
_OPTIONS = ("-ffp-contract=off",)


@dataclass(frozen=True, eq=False)
class CompiledProgram:
    """A `Program` whose sums and products C code computes, as soon as that is compiled.

    NumPy's operations go through memory one by one; those of C stay in registers. Until there is a
    compiled library (`CFunction.is_kept`), NumPy computes everything, with the same results.

    **Attributes**

    - `motion`, `outputs`: the values, one a row of the result.

    >>> import numpy as np
    >>> from jaxcslc.network.straight_line import CompiledProgram, Motion
    >>> motion = Motion(1)
    >>> program = CompiledProgram(motion, (motion.q[0] * motion.qd[0], -motion.qdd[0]))
    >>> q, qd, qdd = np.array([[2.0]]), np.array([[3.0]]), np.array([[4.0]])
    >>> program(q, qd, qdd).tolist()
    [[6.0], [-4.0]]
    """

    motion: Motion
    outputs: tuple[Value, ...]

    def __call__(
        self,
        q: Float[np.ndarray, "joints samples"],
        qd: Float[np.ndarray, "joints samples"],
        qdd: Float[np.ndarray, "joints samples"],
    ) -> Float[np.ndarray, "outputs samples"]:
        """The values at all samples, in the precision of the motion."""
        result = np.empty((len(self.outputs), q.shape[1]), q.dtype)
        self.write(list(result), q, qd, qdd)
        return result

    def write(
        self,
        rows: Sequence[Float[np.ndarray, " samples"]],
        q: Float[np.ndarray, "joints samples"],
        qd: Float[np.ndarray, "joints samples"],
        qdd: Float[np.ndarray, "joints samples"],
    ) -> None:
        """Writes the values at all samples into rows, each of numbers one behind the other."""
        if q.dtype != np.float64 or not self.columns.is_kept:
            for row, values in zip(rows, self.program(q, qd, qdd), strict=True):
                row[...] = values
            return
        inputs = [row for x in (q, qd, qdd, self.functions(q, qd, qdd)) for row in x]
        memory = np.zeros((len(inputs) + len(rows), _BLOCK))
        self.columns(inputs, rows, memory, q.shape[1])

    @cached_property
    def columns(self) -> CFunction:
        """All of it but sines and cosines by C code, for rows of inputs and rows of outputs."""
        rows = CRows("samples"), CRows("samples", written=True)
        kinds = (*rows, CArray("rows block", written=True), LONG)
        return CFunction(self.source, "columns", kinds, _OPTIONS)

    @cached_property
    def program(self) -> Program:
        """All of it by NumPy."""
        return Program.of(self.motion, self.outputs)

    @cached_property
    def functions(self) -> Program:
        """Sines and cosines of the motion, by NumPy."""
        return Program.of(self.motion, [Value(self.motion.graph, i) for i in self._functions])

    @cached_property
    def source(self) -> str:
        """The C code of a function `columns` of addresses of inputs, of outputs, and samples."""
        graph = self.motion.graph
        first = 3 * len(self.motion.q)
        rows = {
            x.index: i for i, x in enumerate((*self.motion.q, *self.motion.qd, *self.motion.qdd))
        }
        rows |= {index: first + i for i, index in enumerate(self._functions)}
        indices = {operation: index for index, operation in enumerate(graph.operations)}

        def reading(operation: Operation) -> str | None:
            row = rows.get(indices[operation])
            return None if row is None else f"inputs[{_BLOCK * row} + i]"

        lines = KernelText(graph, reading).statements(
            (value, f"outputs[{_BLOCK * row} + i] = {{0}};")
            for row, value in enumerate(self.outputs)
        )
        return _SOURCE.format(
            block=_BLOCK,
            inputs=first + len(self._functions),
            outputs=len(self.outputs),
            statements="\n".join(lines),
        )

    @cached_property
    def _functions(self) -> tuple[int, ...]:
        operations = self.motion.graph.operations
        needed = self.motion.graph.needed(self.outputs)
        return tuple(index for index in needed if operations[index].name in _OF_NUMPY)


_SOURCE = """#include <math.h>
#include <string.h>

#define BLOCK {block}
#define INPUTS {inputs}
#define OUTPUTS {outputs}

typedef double real;

static void compute(const double* restrict inputs, double* restrict outputs)
{{
    for (int i = 0; i < BLOCK; ++i) {{
{statements}
    }}
}}

/* Rows of outputs for rows of inputs; memory has room for a block of all of them. */
void columns(const double* const* inputs, double* const* outputs, double* memory, long samples)
{{
    double* results = memory + BLOCK * INPUTS;
    for (long start = 0; start < samples; start += BLOCK) {{
        const long count = samples - start < BLOCK ? samples - start : BLOCK;
        for (int row = 0; row < INPUTS; ++row)
            memcpy(memory + BLOCK * row, inputs[row] + start, count * sizeof(double));
        compute(memory, results);
        for (int row = 0; row < OUTPUTS; ++row)
            memcpy(outputs[row] + start, results + BLOCK * row, count * sizeof(double));
    }}
}}
"""
