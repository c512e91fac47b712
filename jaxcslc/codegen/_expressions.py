"""Expressions of a motion: a graph of values that are computed once each, and their derivatives."""

from collections.abc import Callable, Iterable, Sequence
from dataclasses import dataclass
from typing import NamedTuple, TypeAlias, no_type_check


class Operation(NamedTuple):
    """Operation on earlier values; its result is one value.

    `name` says what is done, `arguments` to which values before it.

    `number` is a constant's value; `text` what an input is called.
    """

    name: str
    arguments: tuple[int, ...] = ()
    number: float = 0.0
    text: str = ""


# Called hundreds of thousands of times for one robot: checks of arguments in the tests would take
# ten times as long as the work.
@no_type_check
class Expressions:
    """Values that are computed once each: a directed graph, built by doing arithmetic on `Value`s.

    Equal expressions are one value (value numbering): products and sums whatever the order of
    their terms, differences and products whatever their sign. Constants are folded; what is
    multiplied by zero vanishes, with everything that only it needs. So the general equations of
    motion give code without operations that right angles and zero lengths make trivial.

    >>> graph = Expressions()
    >>> x, y = graph.input("x"), graph.input("y")
    >>> (x * y - y * x).is_zero, (2 * (x - y)).index == (-(y - x) * 2).index
    (True, True)
    """

    def __init__(self) -> None:
        self.operations: list[Operation] = []
        self._indices: dict[Operation, int] = {}

    def input(self, text: str) -> "Value":
        """Return an input, by its name in generated code."""
        return self._value(Operation("input", text=text))

    def inputs(self, name: str, count: int) -> list["Value"]:
        """Return so many inputs: `name[0]`, `name[1]` and so on."""
        return [self.input(f"{name}[{i}]") for i in range(count)]

    def constant(self, number: float) -> "Value":
        """Return a number; negative ones are the negatives of positive ones."""
        if number < 0:
            return -self.constant(-number)
        return self._value(Operation("constant", number=float(number) + 0.0))

    def apply(self, name: str, x: "Value") -> "Value":
        """Return a function of one value: sin, cos, exp, sqrt, fabs, sign, positive, negative."""
        return self._value(Operation(name, (x.index,)))

    def equal(self, x: "Value", y: "Value") -> "Value":
        """Return a value that is 1 where two values are equal, and 0 elsewhere."""
        return self._binary("equal", x, y)

    def choice(self, condition: "Value", otherwise: "Value", then: "Value") -> "Value":
        """Return one of two values: `then` where the condition is not zero."""
        return self._value(Operation("choose", (condition.index, otherwise.index, then.index)))

    def _value(self, operation: Operation) -> "Value":
        if operation not in self._indices:
            self._indices[operation] = len(self.operations)
            self.operations.append(operation)
        return Value(self, self._indices[operation])

    def _binary(self, name: str, x: "Value", y: "Value") -> "Value":
        return self._value(Operation(name, (x.index, y.index)))

    def lift(self, x: "Number") -> "Value":
        return x if isinstance(x, Value) else self.constant(float(x))

    def needed(self, outputs: Iterable["Value"]) -> list[int]:
        """List the indices of all values that outputs depend on, each after its arguments."""
        needed: set[int] = set()
        todo = [output.index for output in outputs]
        while todo:
            index = todo.pop()
            if index not in needed:
                needed.add(index)
                todo += self.operations[index].arguments
        return sorted(needed)  # operations are numbered as they are made

    def cost(self, outputs: Iterable["Value"]) -> int:
        """Additions, multiplications and functions; changes of sign are free."""
        free = ("input", "constant", "negate")
        return sum(self.operations[i].name not in free for i in self.needed(outputs))


@no_type_check
class Value:
    """A value of an `Expressions`: sums, differences and products with others and with numbers,
    whole powers, and quotients by numbers."""

    __slots__ = ("graph", "index")

    def __init__(self, graph: Expressions, index: int) -> None:
        self.graph, self.index = graph, index

    @property
    def operation(self) -> Operation:
        return self.graph.operations[self.index]

    @property
    def is_zero(self) -> bool:
        return self.operation == Operation("constant")

    @property
    def number(self) -> float | None:
        """Number of a constant that is not negative; None for other values."""
        return self.operation.number if self.operation.name == "constant" else None

    def signed(self) -> tuple[bool, "Value"]:
        """Return whether the value is the negative of another, and that other value."""
        if self.operation.name == "negate":
            return True, Value(self.graph, self.operation.arguments[0])
        return False, self

    def __neg__(self) -> "Value":
        negative, size = self.signed()
        if negative or size.is_zero:
            return size
        return self.graph._value(Operation("negate", (self.index,)))  # pyright: ignore[reportPrivateUsage]

    def __add__(self, other: "Number") -> "Value":
        graph = self.graph
        (minus_x, x), (minus_y, y) = self.signed(), graph.lift(other).signed()
        if x.is_zero:
            return -y if minus_y else y
        if y.is_zero:
            return -x if minus_x else x
        if x.number is not None and y.number is not None:
            a = -x.number if minus_x else x.number
            return graph.constant(a + (-y.number if minus_y else y.number))
        if x.index == y.index:
            if minus_x != minus_y:
                return graph.constant(0.0)
            return (-x if minus_x else x) * 2.0
        for one, minus_one, other_one, minus_other in (
            (x, minus_x, y, minus_y),
            (y, minus_y, x, minus_x),
        ):
            left = other_one._without(one, negative=minus_one != minus_other)
            if left is not None:
                return -left if minus_other else left
        if minus_x == minus_y:
            first, second = sorted((x, y), key=lambda value: value.index)
            total = graph._binary("add", first, second)  # pyright: ignore[reportPrivateUsage]
            return -total if minus_x else total
        if minus_x:
            x, y = y, x
        if x.index < y.index:
            return graph._binary("subtract", x, y)  # pyright: ignore[reportPrivateUsage]
        return -graph._binary("subtract", y, x)  # pyright: ignore[reportPrivateUsage]

    def _without(self, term: "Value", *, negative: bool) -> "Value | None":
        """Return the value plus a term, or minus it, where that cancels one of its two terms."""
        name, arguments = self.operation.name, self.operation.arguments
        if name not in ("add", "subtract") or term.index not in arguments:
            return None
        first, second = (Value(self.graph, index) for index in arguments)
        if term.index == first.index and negative:
            return second if name == "add" else -second
        if term.index == second.index and negative == (name == "add"):
            return first
        return None

    def __mul__(self, other: "Number") -> "Value":
        graph = self.graph
        (minus_x, x), (minus_y, y) = self.signed(), graph.lift(other).signed()
        product = x._times(y)
        return -product if minus_x != minus_y else product

    def _times(self, other: "Value") -> "Value":
        graph = self.graph
        first, second = sorted((self, other), key=lambda value: value.index)
        for factor, other_factor in ((first, second), (second, first)):
            if factor.number == 0.0:
                return factor
            if factor.number == 1.0:
                return other_factor
            if factor.number is None:
                continue
            if other_factor.number is not None:
                return graph.constant(factor.number * other_factor.number)
            if other_factor.operation.name == "multiply":  # a constant times a constant times x
                for i, inner in enumerate(other_factor.operation.arguments):
                    number = Value(graph, inner).number
                    if number is not None:
                        other_one = Value(graph, other_factor.operation.arguments[1 - i])
                        return other_one._times(graph.constant(number * factor.number))
        return graph._binary("multiply", first, second)  # pyright: ignore[reportPrivateUsage]

    def __sub__(self, other: "Number") -> "Value":
        return self + -self.graph.lift(other)

    def __rsub__(self, other: "Number") -> "Value":
        return self.graph.lift(other) - self

    def __pow__(self, exponent: int) -> "Value":
        if not isinstance(exponent, int) or exponent < 0:
            raise TypeError(f"C code has whole powers from 0 on only, got {exponent!r}")
        if exponent < 2:
            return self if exponent else self.graph.constant(1.0)
        half = self ** (exponent // 2)
        return half * half * self if exponent % 2 else half * half

    def __truediv__(self, number: float) -> "Value":
        if isinstance(number, Value):
            raise TypeError("C code divides by numbers only, not by what a motion decides")
        return self * (1.0 / number)

    __radd__ = __add__
    __rmul__ = __mul__


Number: TypeAlias = Value | float | int


class Motion:
    """Positions, velocities and accelerations of a robot's joints, as inputs of straight-line code.

    **Attributes**

    - `graph`: the expressions that they are inputs of.
    - `q`, `qd`, `qdd`: one value a joint.
    """

    def __init__(self, joints: int) -> None:
        self.graph = Expressions()
        self.q, self.qd, self.qdd = (self.graph.inputs(x, joints) for x in ("q", "qd", "qdd"))

    def values(self, numbers: Sequence[Number]) -> list[Value]:
        """Values of the graph, constants where they are plain numbers."""
        return [self.graph.lift(x) for x in numbers]


@dataclass(frozen=True)
class StraightLine:
    """Values of a graph that are computed together, of inputs `k[i]`, `q[i]`, `qd[i]`, `qdd[i]`."""

    motion: Motion
    outputs: tuple[Value, ...]

    @property
    def graph(self) -> Expressions:
        return self.motion.graph

    @property
    def cost(self) -> int:
        """Additions, multiplications and calls of functions."""
        return self.graph.cost(self.outputs)


def derivatives(outputs: Sequence[Value], by: Value) -> list[Value]:
    """Derivatives of values of a graph by one of them, as expressions of the same graph.

    Forwards through the graph. What vanishes leaves nothing behind. Where a function bends, it has
    the derivative of the side of zero: of |x|, of the greater and of the lesser of x and 0.

    - `outputs`: values.
    - `by`: of the same graph, an input as a rule.

    >>> from jaxcslc.codegen import Expressions, derivatives
    >>> graph = Expressions()
    >>> x, y = graph.input("x"), graph.input("y")
    >>> [slope] = derivatives([x * x * y], x)
    >>> slope.index == (2.0 * x * y).index
    True
    """
    graph, zero = by.graph, by.graph.constant(0.0)
    slopes: dict[int, Value] = {by.index: graph.constant(1.0)}
    for index in graph.needed(outputs):
        operation = graph.operations[index]
        arguments = [Value(graph, argument) for argument in operation.arguments]
        changes = [slopes.get(argument.index, zero) for argument in arguments]
        if index == by.index or all(change.is_zero for change in changes):
            continue
        if operation.name in _OF_SUMS:
            slopes[index] = _OF_SUMS[operation.name](arguments, changes)
        else:
            slope = _OF_FUNCTIONS[operation.name](arguments[0], Value(graph, index))
            slopes[index] = slope * changes[0]
    return [slopes.get(output.index, zero) for output in outputs]


# Of arguments and their changes.
_OF_SUMS: dict[str, Callable[[list[Value], list[Value]], Value]] = {
    "add": lambda x, dx: dx[0] + dx[1],
    "subtract": lambda x, dx: dx[0] - dx[1],
    "multiply": lambda x, dx: dx[0] * x[1] + x[0] * dx[1],
    "negate": lambda x, dx: -dx[0],
}
# Of a function's argument and its value.
_OF_FUNCTIONS: dict[str, Callable[[Value, Value], Value]] = {
    "sin": lambda x, value: x.graph.apply("cos", x),
    "cos": lambda x, value: -x.graph.apply("sin", x),
    "exp": lambda x, value: value,
    "tanh": lambda x, value: 1.0 - value * value,
    "sqrt": lambda x, value: 0.5 * x.graph.apply("reciprocal", value),
    "reciprocal": lambda x, value: -value * value,
    "fabs": lambda x, value: x.graph.apply("sign", x),
    "sign": lambda x, value: x.graph.constant(0.0),
    "positive": lambda x, value: x.graph.apply("positive", x.graph.apply("sign", x)),
    "negative": lambda x, value: -x.graph.apply("negative", x.graph.apply("sign", x)),
}
