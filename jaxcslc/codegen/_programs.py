"""Values of a motion for NumPy's arrays: by NumPy's operations, or by C once it is compiled."""

from collections.abc import Callable, Sequence
from dataclasses import dataclass
from functools import cached_property
from typing import Any, NamedTuple

import numpy as np
from jaxtyping import Float

from ._c_function import LONG, CArray, CFunction, CRows
from ._c_text import block_row, block_text, called_functions
from ._expressions import Motion, Value


# What NumPy has under other names.
_FUNCTIONS: dict[str, Callable[..., Any]] = {
    "negate": np.negative,
    "positive": lambda x, result: np.maximum(x, 0.0, out=result),
    "negative": lambda x, result: np.minimum(x, 0.0, out=result),
}
# Samples at a time. A call of NumPy's takes half a microsecond beside its work; but a program's
# registers are to stay in a processor's second cache. (A Panda's columns: 2.8 µs a sample in blocks
# of 512, 1.3 in blocks of 4,096 and 8,192.)
_BLOCK = 4096
# Samples at a time: a Panda's columns take 0.4 MB, a core's cache.
_C_BLOCK = 256
# Each operation rounds as NumPy's does: results are the same to the last digit.
_OPTIONS = ("-ffp-contract=off",)


class _Step(NamedTuple):
    """An operation of NumPy's: the registers of its arguments and of its result."""

    function: Callable[..., Any]
    arguments: tuple[int, ...]
    result: int


@dataclass(frozen=True)
class Program:
    """Values of a motion as a sequence of NumPy's operations on blocks of samples.

    Every operation writes into a row of the result, or into a register that no later operation
    reads any more: between operations nothing is allocated, which would take as long as the
    arithmetic. The first registers are the rows of the result, the next ones the inputs and
    constants.

    **Attributes**

    - `outputs`: how many rows the result has.
    - `inputs`: which rows of positions, velocities and accelerations are read.
    - `constants`: numbers.
    - `registers`: how many there are.
    - `steps`: the operations.
    - `copies`: rows of the result that are inputs, constants or other rows: from and to.

    >>> import numpy as np
    >>> from jaxcslc.codegen import Motion, Program
    >>> motion = Motion(1)
    >>> program = Program.of(motion, [motion.q[0] * motion.qd[0], -motion.qdd[0]])
    >>> q, qd, qdd = np.array([[2.0]]), np.array([[3.0]]), np.array([[4.0]])
    >>> program(q, qd, qdd).tolist()
    [[6.0], [-4.0]]
    """

    outputs: int
    inputs: tuple[int, ...]
    constants: tuple[float, ...]
    registers: int
    steps: tuple[_Step, ...]
    copies: tuple[tuple[int, int], ...]

    @classmethod
    def of(cls, motion: Motion, outputs: Sequence[Value]) -> "Program":
        """Return the program of values, each one a row of its result."""
        operations, needed = motion.graph.operations, motion.graph.needed(outputs)
        motions = {x.index: i for i, x in enumerate((*motion.q, *motion.qd, *motion.qdd))}
        inputs = [index for index in needed if index in motions]
        constants = [index for index in needed if operations[index].name == "constant"]
        register = {index: len(outputs) + i for i, index in enumerate((*inputs, *constants))}
        computed = [index for index in needed if index not in register]
        last = {argument: index for index in computed for argument in operations[index].arguments}
        rows: dict[int, int] = {}
        for row, value in enumerate(outputs):
            if value.index not in register:
                rows.setdefault(value.index, row)
        first_free = registers = len(outputs) + len(register)
        unused: list[int] = []
        steps: list[_Step] = []
        for index in computed:
            name, arguments = operations[index].name, operations[index].arguments
            read = tuple(register[argument] for argument in arguments)
            # An operation may write over what it is the last to read.
            unused += [
                register[argument]
                for argument in dict.fromkeys(arguments)
                if last[argument] == index and register[argument] >= first_free
            ]
            if index in rows:
                register[index] = rows[index]
            elif unused:
                register[index] = unused.pop()
            else:
                register[index], registers = registers, registers + 1
            function = _FUNCTIONS.get(name) or getattr(np, name)
            steps.append(_Step(function, read, register[index]))
        return cls(
            outputs=len(outputs),
            inputs=tuple(motions[index] for index in inputs),
            constants=tuple(operations[index].number for index in constants),
            registers=registers,
            steps=tuple(steps),
            copies=tuple(
                (register[value.index], row)
                for row, value in enumerate(outputs)
                if register[value.index] != row
            ),
        )

    def __call__(
        self,
        q: Float[np.ndarray, "joints samples"],
        qd: Float[np.ndarray, "joints samples"],
        qdd: Float[np.ndarray, "joints samples"],
    ) -> Float[np.ndarray, "outputs samples"]:
        """The values at all samples, in the precision of the motion."""
        samples, dtype = q.shape[1], q.dtype
        motion = (*q, *qd, *qdd)
        constants = [np.array(number, dtype) for number in self.constants]
        between = self.registers - self.outputs - len(self.inputs) - len(constants)
        memory = np.empty((between, min(samples, _BLOCK)), dtype)
        result = np.empty((self.outputs, samples), dtype)
        for start in range(0, samples, _BLOCK):
            block = slice(start, start + _BLOCK)
            registers = [
                *result[:, block],
                *(motion[index][block] for index in self.inputs),
                *constants,
                *memory[:, : min(samples - start, _BLOCK)],
            ]
            for function, arguments, output in self.steps:
                function(*[registers[index] for index in arguments], registers[output])
            for source, row in self.copies:
                registers[row][...] = registers[source]
        return result


@dataclass(frozen=True, eq=False)
class CompiledProgram:
    """A `Program` whose sums and products C code computes, as soon as that is compiled.

    NumPy's operations go through memory one by one; those of C stay in registers. Until there is a
    compiled library (`CFunction.is_kept`), NumPy computes everything, with the same results.

    **Attributes**

    - `motion`, `outputs`: the values, one a row of the result.

    >>> import numpy as np
    >>> from jaxcslc.codegen import CompiledProgram, Motion
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
        memory = np.zeros((len(inputs) + len(rows), _C_BLOCK))
        self.columns(inputs, rows, memory, q.shape[1])

    @cached_property
    def columns(self) -> CFunction:
        """Return the C function of everything except sines and cosines, over rows of numbers."""
        rows = CRows("samples"), CRows("samples", written=True)
        kinds = (*rows, CArray("rows block", written=True), LONG)
        return CFunction(self.source, "columns", kinds, _OPTIONS)

    @cached_property
    def program(self) -> Program:
        """Program that computes everything by NumPy."""
        return Program.of(self.motion, self.outputs)

    @cached_property
    def functions(self) -> Program:
        """Sines and cosines, by NumPy: as exact as the C library's, in less time."""
        return Program.of(self.motion, [Value(self.motion.graph, i) for i in self._functions])

    @cached_property
    def source(self) -> str:
        """The C code of a function `columns` of addresses of inputs, of outputs, and samples."""
        n = len(self.motion.q)
        rows = {name: ("inputs", i * n) for i, name in enumerate(("q", "qd", "qdd"))}
        apart = "inputs", 3 * n
        text = block_text(self.motion.graph, _C_BLOCK, rows, self._functions, apart)
        lines = text.statements(
            (value, f"{block_row('outputs', _C_BLOCK, row)} = {{0}};")
            for row, value in enumerate(self.outputs)
        )
        return _SOURCE.format(
            block=_C_BLOCK,
            inputs=3 * n + len(self._functions),
            outputs=len(self.outputs),
            statements="\n".join(lines),
        )

    @cached_property
    def _functions(self) -> tuple[int, ...]:
        return tuple(called_functions(self.motion.graph, self.outputs))


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
