from collections.abc import Iterator

from ..straight_line import Expressions, Motion, Value
from ._input_term import AbstractFunctions, AbstractInputTerm


class ExpressionFunctions(AbstractFunctions):
    """The functions of terms' inputs as operations of straight-line code."""

    def __init__(self, graph: Expressions) -> None:
        self.graph = graph

    def constant(self, number: float, like: Value) -> Value:
        del like
        return self.graph.constant(float(number))

    def sign(self, x: Value) -> Value:
        return self.graph.apply("sign", x)

    def absolute(self, x: Value) -> Value:
        return self.graph.apply("fabs", x)

    def positive(self, x: Value) -> Value:
        return self.graph.apply("positive", x)

    def negative(self, x: Value) -> Value:
        return self.graph.apply("negative", x)

    def sqrt(self, x: Value) -> Value:
        return self.graph.apply("sqrt", x)

    def exp(self, x: Value) -> Value:
        return self.graph.apply("exp", x)

    def tanh(self, x: Value) -> Value:
        return self.graph.apply("tanh", x)

    def sin(self, x: Value) -> Value:
        return self.graph.apply("sin", x)

    def cos(self, x: Value) -> Value:
        return self.graph.apply("cos", x)


def term_entries(term: AbstractInputTerm, motion: Motion) -> Iterator[tuple[int, int, Value]]:
    """Joint, coefficient of the term, and what it is multiplied by."""
    values = term.inputs(ExpressionFunctions(motion.graph), motion.q, motion.qd, motion.qdd)
    yield from zip(term.input_joints, term.input_indices, values, strict=True)
