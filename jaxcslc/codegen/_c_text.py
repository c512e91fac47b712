"""Text of C and CUDA C: statements that compute values of a graph, sines of rows of numbers."""

from collections.abc import Callable, Container, Iterable, Mapping

from ._expressions import Expressions, Operation, Value


_SYMBOLS = {"add": "+", "subtract": "-", "multiply": "*"}
# Of C's mathematics, and CUDA's, under other names than the graph's, for any x.
_FUNCTIONS = {
    "reciprocal": "((real)1 / {0})",
    "inverse": "({0} != 0 ? (real)1 / {0} : (real)0)",
    "nonzero": "(real)({0} != 0)",
    "sign": "(real)(({0} > 0) - ({0} < 0))",
    "positive": "({0} > 0 ? {0} : (real)0)",
    "negative": "({0} < 0 ? {0} : (real)0)",
    "equal": "(real)({0} == {1})",
    "choose": "({0} != 0 ? {2} : {1})",
}


class KernelText:
    """Statements of C, or CUDA C, that compute values of a graph, a constant of type `real` each.

    - `inputs`: what an input or a function's value is in the kernel; None for what statements
      compute.
    - `functions`: what is called in place of the usual functions, by their names in the graph.
    """

    def __init__(
        self,
        graph: Expressions,
        inputs: Callable[[Operation], str | None],
        functions: Mapping[str, str] | None = None,
    ) -> None:
        self._graph, self._inputs = graph, inputs
        self._functions = _FUNCTIONS | dict(functions or {})

    def statements(self, outputs: Iterable[tuple[Value, str]]) -> list[str]:
        """Lines that compute values and, as soon as each is there, store it.

        - `outputs`: values, and a statement with `{0}` in place of the value.
        """
        stores: dict[int, list[str]] = {}
        for value, store in outputs:
            stores.setdefault(value.index, []).append(store)
        lines: list[str] = []
        names: dict[int, str] = {}
        for index in self.needed([Value(self._graph, index) for index in stores]):
            lines += self._line(index, names)
            lines += [store.format(names[index]) for store in stores.get(index, [])]
        return lines

    def statements_in_turn(self, outputs: Iterable[tuple[Value, str]]) -> list[str]:
        """The same in the order of the outputs: what one needs, its store, what the next needs."""
        lines: list[str] = []
        names: dict[int, str] = {}
        for value, store in outputs:
            for index in self.needed([value], names):
                lines += self._line(index, names)
            lines.append(store.format(names[value.index]))
        return lines

    def needed(self, outputs: Iterable[Value], known: Container[int] = ()) -> list[int]:
        """Everything to compute for the outputs, in order; not what only an input needs, nor what
        is known already."""
        needed: set[int] = set()
        todo = [output.index for output in outputs]
        while todo:
            index = todo.pop()
            if index not in needed and index not in known:
                needed.add(index)
                operation = self._graph.operations[index]
                if self._inputs(operation) is None:
                    todo += operation.arguments
        return sorted(needed)

    def _line(self, index: int, names: dict[int, str]) -> list[str]:
        """The statement of an operation, none for a constant; its name is added to the names."""
        operation = self._graph.operations[index]
        text = self._inputs(operation) or self._text(operation, names)
        if operation.name == "constant":
            names[index] = text
            return []
        names[index] = f"x{index}"
        return [f"const real x{index} = {text};"]

    def _text(self, operation: Operation, names: dict[int, str]) -> str:
        arguments = [names[index] for index in operation.arguments]
        if operation.name == "constant":
            return f"(real){operation.number!r}"
        if operation.name in _SYMBOLS:
            return f" {_SYMBOLS[operation.name]} ".join(arguments)
        if operation.name == "negate":
            return f"-{arguments[0]}"
        return self._functions.get(operation.name, operation.name + "({0})").format(*arguments)


#: C of sines and cosines of rows of numbers, of which compilers make instructions on several at
#: once; the C library's take one at a time. It needs `LANES`, the type `lanes` of so many numbers,
#: and rows whose lengths are multiples of it.
#:
#: x = n pi/2 + r with n to 20 bits: pi/2 in parts of 33, 33 and 53 bits, so that the first two
#: products are exact and r is a sum of two numbers. The polynomials are those of FreeBSD's
#: `__kernel_sin` and `__kernel_cos` (S. Moshier, Sun Microsystems), within 0.6 units of the last
#: digit for |r| <= pi/4. Larger numbers, and those that are not finite, go to the C library.
SINES_TEXT = """
typedef long long integers __attribute__((vector_size(8 * LANES), aligned(8)));

static void sines_and_cosines(const double* x, double* sines, double* cosines, int length)
{
    int large = 0;
    for (int i = 0; i < length; ++i)
        large |= !(fabs(x[i]) <= 1e6);
    if (large) {
        for (int i = 0; i < length; ++i) {
            const double angle = x[i];
            sines[i] = sin(angle);
            cosines[i] = cos(angle);
        }
        return;
    }
    for (int i = 0; i < length; i += LANES) {
        const lanes angle = *(const lanes*)(x + i);
        /* Adding 3 * 2^51 leaves a whole number of quarter turns in the last digits. */
        const lanes shifted = angle * 0x1.45f306dc9c883p-1 + 0x1.8p52;
        const lanes turns = shifted - 0x1.8p52;
        const integers quadrant = (integers)shifted;
        const lanes first = angle - turns * 0x1.921fb544p+0;
        const lanes second = turns * 0x1.0b4611a6p-34;
        const lanes high = first - second, change = high - first;
        const lanes low = ((first - (high - change)) - (second + change))
            - turns * 0x1.3198a2e037073p-69;
        const lanes r = high + low, tail = (high - r) + low;
        const lanes z = r * r, zr = z * r, zz = z * z;
        const lanes s = 8.33333333332248946124e-03
            + z * (-1.98412698298579493134e-04 + z * 2.75573137070700676789e-06)
            + z * zz * (-2.50507602534068634195e-08 + z * 1.58969099521155010221e-10);
        const lanes sine = r - ((z * (0.5 * tail - zr * s) - tail)
            - zr * -1.66666666666666324348e-01);
        const lanes c = z * (4.16666666666666019037e-02
            + z * (-1.38888888888741095749e-03 + z * 2.48015872894767294178e-05))
            + zz * zz * (-2.75573143513906633035e-07
            + z * (2.08757232129817482790e-09 + z * -1.13596475577881948265e-11));
        const lanes half = 0.5 * z, one = 1.0 - half;
        const lanes cosine = one + (((1.0 - one) - half) + (z * c - r * tail));
        const integers odd = -(quadrant & 1);
        const integers sine_bits = (integers)sine, cosine_bits = (integers)cosine;
        const integers of_sine = (odd & cosine_bits) | (~odd & sine_bits);
        const integers of_cosine = (odd & sine_bits) | (~odd & cosine_bits);
        *(lanes*)(sines + i) = (lanes)(of_sine ^ ((quadrant & 2) << 62));
        *(lanes*)(cosines + i) = (lanes)(of_cosine ^ (((quadrant + 1) & 2) << 62));
    }
}
"""
