import numpy as np
from jaxtyping import Float

from ..network import CSLC, AbstractFunctions
from ..network.straight_line import Expressions, Motion, Value


class CFunctions(AbstractFunctions):
    """The functions of terms' inputs as operations of C code."""

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


def input_entries(network: CSLC, motion: Motion) -> list[tuple[int, int, Value]]:
    """The regressor's entries beside the rigid body's: friction, offsets, springs, coupled joints.

    **Returns**

    - Joint, coefficient and value of each.
    """
    functions = CFunctions(motion.graph)
    entries: list[tuple[int, int, Value]] = []
    for term in network.input_terms:
        indices = network.layout.indices(term.kind)[list(term.input_indices)].tolist()
        values = term.inputs(functions, motion.q, motion.qd, motion.qdd)
        entries += zip(term.input_joints, indices, values, strict=True)
    return entries


def input_inertias(
    network: CSLC, k: Float[np.ndarray, " coefficients"]
) -> list[tuple[int, int, float]]:
    """What terms beside the rigid body add to the mass matrix above its diagonal.

    **Returns**

    - Row, column and value of each.
    """
    entries: list[tuple[int, int, float]] = []
    for term in network.input_terms:
        total = np.tensordot(k[network.layout.of(term)], term.inertia_matrices, 1)
        entries += [
            (int(i), int(j), float(total[i, j]))
            for i, j in zip(*np.triu_indices(len(total)), strict=True)
            if total[i, j]
        ]
    return entries
