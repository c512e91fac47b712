"""Text of C and CUDA C: statements that compute values of a graph, sines of rows of numbers, names
and comments made of texts of users."""

import re
from collections import Counter
from collections.abc import Callable, Container, Iterable, Mapping, Sequence
from typing import NamedTuple

from ._expressions import Expressions, Operation, Value


# Operations between two values, by what their operands must bind as strongly as; 3 is a product's.
_BINARY = {"add": ("+", 1, 2), "subtract": ("-", 1, 3), "multiply": ("*", 3, 3)}
_PRECEDENCE = {"add": 1, "subtract": 1, "negate": 2, "multiply": 3}
_ATOM = 4  # a name or a call binds more strongly than any operation
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

CALLED = ("sin", "cos", "exp", "tanh")
"""Functions that compilers call number by number: apart from arithmetic, that they do on several
numbers at once."""


class KernelText:
    """Statements of C, or CUDA C, that compute values of a graph.

    - `inputs`: what an input or a function's value is in the kernel; None for what statements
      compute.
    - `functions`: what is called instead of the usual functions, by their names in the graph.
    - `constant`: how a number is written.
    """

    def __init__(
        self,
        graph: Expressions,
        inputs: Callable[[Operation], str | None],
        functions: Mapping[str, str] | None = None,
        constant: str = "(real){0!r}",
    ) -> None:
        self._graph, self._inputs, self._constant = graph, inputs, constant
        self._functions = _FUNCTIONS | dict(functions or {})

    def statements(self, outputs: Iterable[tuple[Value, str]]) -> list[str]:
        """Lines that compute values, a constant of type `real` each, and store them at once.

        - `outputs`: values, and a statement with `{0}` instead of the value.
        """
        stores: dict[int, list[str]] = {}
        for value, store in outputs:
            stores.setdefault(value.index, []).append(store)
        lines: list[str] = []
        names: dict[int, _Written] = {}
        for index in self.needed([Value(self._graph, index) for index in stores]):
            lines += self._line(index, names)
            lines += [store.format(names[index].text) for store in stores.get(index, [])]
        return lines

    def statements_in_turn(self, outputs: Iterable[tuple[Value, str]]) -> list[str]:
        """Return statements in the order of the outputs: what one needs, then its store."""
        lines: list[str] = []
        names: dict[int, _Written] = {}
        for value, store in outputs:
            for index in self.needed([value], names):
                lines += self._line(index, names)
            lines.append(store.format(names[value.index].text))
        return lines

    def nested_statements(self, outputs: Sequence[tuple[Value, str]], longest: int) -> list[str]:
        """Lines as a person writes them: what is used once stands where it is used.

        - `outputs`: as of `statements`, stored behind all lines.
        - `longest`: longer expressions become constants of type `double`, too [characters].
        """
        order = self.needed(value for value, _ in outputs)
        uses = Counter(i for index in order for i in self._graph.operations[index].arguments)
        uses.update(value.index for value, _ in outputs)
        written: dict[int, _Written] = {}
        lines: list[str] = []
        for index in order:
            operation = self._graph.operations[index]
            expression = self._written(operation, written)
            cheap = operation.name in ("input", "constant", "negate")
            if not cheap and (uses[index] > 1 or len(expression.text) > longest):
                name = f"x{len(lines)}"
                lines.append(f"const double {name} = {expression.text};")
                expression = _Written(name)
            written[index] = expression
        return lines + [store.format(written[value.index].text) for value, store in outputs]

    def needed(self, outputs: Iterable[Value], known: Container[int] = ()) -> list[int]:
        """List the operations to compute for the outputs, in order.

        Except those that only an input needs, or that are known already.
        """
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

    def _line(self, index: int, names: dict[int, "_Written"]) -> list[str]:
        """The statement of an operation, none for a constant; its name is added to the names."""
        operation = self._graph.operations[index]
        written = self._written(operation, names)
        if operation.name == "constant":
            names[index] = written
            return []
        names[index] = _Written(f"x{index}")
        return [f"const real x{index} = {written.text};"]

    def _written(self, operation: Operation, written: dict[int, "_Written"]) -> "_Written":
        """An operation on arguments that are written already."""
        if (text := self._inputs(operation)) is not None:
            return _Written(text)
        name, arguments = operation.name, [written[index] for index in operation.arguments]
        if name == "constant":
            return _Written(self._constant.format(operation.number))
        if name in _BINARY:
            symbol, left, right = _BINARY[name]
            text = f"{arguments[0].within(left)} {symbol} {arguments[1].within(right)}"
        elif name == "negate":
            text = f"-{arguments[0].within(3)}"
        else:
            function = self._functions.get(name, name + "({0})")
            text = function.format(*(argument.text for argument in arguments))
        return _Written(text, _PRECEDENCE.get(name, _ATOM))


class _Written(NamedTuple):
    """The text of an expression, and how strongly its last operation binds."""

    text: str
    precedence: int = _ATOM

    def within(self, least: int) -> str:
        """Return the text as an operand, in brackets if it binds less than it must."""
        return self.text if self.precedence >= least else f"({self.text})"


def called_functions(graph: Expressions, outputs: Iterable[Value]) -> list[int]:
    """Return the values among what outputs need that are of functions in `CALLED`."""
    return [index for index in graph.needed(outputs) if graph.operations[index].name in CALLED]


def block_text(
    graph: Expressions,
    block: int,
    rows: Mapping[str, tuple[str, int]],
    functions: Sequence[int] = (),
    apart: tuple[str, int] = ("", 0),
) -> KernelText:
    """Return the text of statements for sample `i` of a block, whose values lie row by row.

    - `block`: samples of a row.
    - `rows`: for `name` of inputs `name[0]`, `name[1]`, ..., in which array they are, and from
      which row on. Other inputs are called as they are in the graph.
    - `functions`: values that are not computed but read; `apart`: in which array, and from where
      on.

    >>> graph = Expressions()
    >>> q = graph.inputs("q", 2)
    >>> text = block_text(graph, 256, {"q": ("inputs", 3)})
    >>> text.statements([(q[1], "outputs[i] = {0};")])
    ['const real x1 = inputs[1024 + i];', 'outputs[i] = x1;']
    """
    array, first = apart
    read = {
        graph.operations[i]: block_row(array, block, first + n) for n, i in enumerate(functions)
    }

    def reading(operation: Operation) -> str | None:
        if operation.name != "input":
            return read.get(operation)
        name, _, index = operation.text.rstrip("]").partition("[")
        if name not in rows:
            return operation.text
        array, first = rows[name]
        return block_row(array, block, first + int(index))

    return KernelText(graph, reading)


def block_row(array: str, block: int, row: int) -> str:
    """Return how sample `i` of a row is called."""
    return f"{array}[{block * row} + i]"


LANES_TEXT = """/* So many numbers as the widest registers hold: of more, GCC makes single ones, and
   takes up to ten times as long. */
#if defined(__AVX512F__)
#define LANES 8
#elif defined(__AVX__)
#define LANES 4
#else
#define LANES 2
#endif
typedef double lanes __attribute__((vector_size(8 * LANES), aligned(8)));
"""
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


_RESERVED = {
    *("auto", "break", "case", "char", "const", "continue", "default", "do"),
    *("double", "else", "enum", "extern", "float", "for", "goto", "if"),
    *("inline", "int", "long", "register", "restrict", "return", "short", "signed"),
    *("sizeof", "static", "struct", "switch", "typedef", "union", "unsigned", "void"),
    *("volatile", "while"),
    "math",  # its header would stand before <math.h> where its folder is searched
}


def is_identifier(name: str) -> bool:
    """Return whether a name is a C identifier that generated code can use."""
    return bool(re.fullmatch(r"[A-Za-z][A-Za-z0-9_]*", name)) and name not in _RESERVED


def identifier(text: str) -> str:
    """Return a C identifier that reads like a name: `puma_560` of `PUMA 560`."""
    name = re.sub(r"[^a-z0-9]+", "_", text.lower()).strip("_")
    return name if is_identifier(name) else f"robot_{name}".rstrip("_")


def comment_text(text: str) -> str:
    """Return a text of a user for a comment that it can neither end nor continue.

    One line of printable ASCII; no `*/` and `/*`, no backslash, which joins lines, and no two
    question marks, which begin trigraphs.
    """
    text = text.replace("²", "^2").replace("³", "^3").replace("\\", "/")
    text = re.sub(r"[^ -~]", lambda found: " " if found[0].isspace() else "?", text)
    return re.sub(r"\?(?=\?)", "? ", text.replace("*/", "* /").replace("/*", "/ *"))
