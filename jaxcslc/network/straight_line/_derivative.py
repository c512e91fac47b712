from collections.abc import Callable, Sequence

from ._expressions import Value


def derivatives(outputs: Sequence[Value], by: Value) -> list[Value]:
    """Derivatives of values of a graph by one of them, as expressions of the same graph.

    Forwards through the graph. What vanishes leaves nothing behind. Where a function bends, it has
    the derivative of the side of zero: of |x|, of the greater and of the lesser of x and 0.

    **Arguments**

    - `outputs`: values.
    - `by`: of the same graph, an input as a rule.

    >>> from jaxcslc.network.straight_line import Expressions, derivatives
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
        if operation.name == "add":
            slope = changes[0] + changes[1]
        elif operation.name == "subtract":
            slope = changes[0] - changes[1]
        elif operation.name == "multiply":
            slope = changes[0] * arguments[1] + arguments[0] * changes[1]
        elif operation.name == "negate":
            slope = -changes[0]
        else:
            slope = _OF_FUNCTIONS[operation.name](arguments[0], Value(graph, index)) * changes[0]
        slopes[index] = slope
    return [slopes.get(output.index, zero) for output in outputs]


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
