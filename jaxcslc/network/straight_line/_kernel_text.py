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
