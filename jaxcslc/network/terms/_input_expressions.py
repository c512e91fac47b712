"""Inputs of terms as expressions of generated code, instead of arrays."""

from collections.abc import Iterator, Sequence
from typing import Any

from jaxcslc.codegen import Expressions, Motion, Value

from ._input_term import AbstractFunctions, AbstractInputTerm
from ._joint_projection import ProjectedTerm


class ExpressionFunctions(AbstractFunctions):
    """The functions of terms' inputs as operations of straight-line code."""

    def __init__(self, motion: Motion) -> None:
        self.motion = motion
        self.graph: Expressions = motion.graph

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

    def rigid_torque(
        self, rigid: Any, k: Any, q: Sequence[Value], qd: Sequence[Value], qdd: Sequence[Value]
    ) -> list[Value]:
        """**Raises** `ValueError` for joints that follow others, which have no expressions."""
        del qd, qdd
        if isinstance(rigid, ProjectedTerm):
            raise ValueError("friction 'load': has no expressions where joints follow others")
        total = [self.graph.constant(0.0)] * len(q)
        for joint, index, value in rigid.entries(self.motion):
            total[joint] = total[joint] + value * float(k[index])
        return total


def term_entries(term: AbstractInputTerm, motion: Motion) -> Iterator[tuple[int, int, Value]]:
    """Joint, coefficient of the term, and what it is multiplied by."""
    values = term.inputs(ExpressionFunctions(motion), motion.q, motion.qd, motion.qdd)
    yield from zip(term.input_joints, term.input_indices, values, strict=True)
