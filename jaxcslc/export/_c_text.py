from collections.abc import Sequence

from ..codegen import Expressions, Operation, Value


_PRECEDENCE = {"add": 1, "subtract": 1, "negate": 2, "multiply": 3}
_ATOM = 4
_LONGEST = 90  # of an expression that is written where it is used [characters]
_FUNCTIONS = {
    "sign": "sign_of",
    "positive": "positive_part",
    "negative": "negative_part",
}
# What is not a number stays none, as in Python: a friction of 0 would hide a velocity that is lost.
_DEFINITIONS = {
    "sign": "static double sign_of(double x)\n{\n"
    "    return x > 0.0 ? 1.0 : x < 0.0 ? -1.0 : x;\n}\n",
    "positive": "static double positive_part(double x)\n{\n    return x < 0.0 ? 0.0 : x;\n}\n",
    "negative": "static double negative_part(double x)\n{\n    return x > 0.0 ? 0.0 : x;\n}\n",
}


def definitions(graph: Expressions) -> list[str]:
    """Functions that C's library does not have and the expressions use."""
    used = {operation.name for operation in graph.operations}
    return [text for name, text in _DEFINITIONS.items() if name in used]


def statements(graph: Expressions, outputs: Sequence[tuple[str, Value]]) -> list[str]:
    """C statements that assign values: `outputs` are left-hand sides and what they become.

    A value that is used once is written where it is used; others become constants.
    """
    order = graph.needed(value for _, value in outputs)
    uses = dict.fromkeys(order, 0)
    for index in order:
        for argument in graph.operations[index].arguments:
            uses[argument] += 1
    for _, value in outputs:
        uses[value.index] += 1
    written: dict[int, tuple[str, int]] = {}  # text and precedence
    lines: list[str] = []
    count = 0
    for index in order:
        operation = graph.operations[index]
        text, precedence = _expression(operation, written)
        cheap = operation.name in ("input", "constant", "negate")
        if not cheap and (uses[index] > 1 or len(text) > _LONGEST):
            lines.append(f"    const double x{count} = {text};")
            text, precedence = f"x{count}", _ATOM
            count += 1
        written[index] = text, precedence
    lines += [f"    {target} = {written[value.index][0]};" for target, value in outputs]
    return lines


def _expression(operation: Operation, written: dict[int, tuple[str, int]]) -> tuple[str, int]:
    name = operation.name
    if name == "input":
        return operation.text, _ATOM
    if name == "constant":
        return repr(operation.number), _ATOM
    precedence = _PRECEDENCE.get(name, _ATOM)

    parts = [written[index] for index in operation.arguments]
    match name:
        case "add":
            return f"{_part(parts[0], 1)} + {_part(parts[1], 2)}", precedence
        case "subtract":
            return f"{_part(parts[0], 1)} - {_part(parts[1], 3)}", precedence
        case "negate":
            return f"-{_part(parts[0], 3)}", precedence
        case "multiply":
            return f"{_part(parts[0], 3)} * {_part(parts[1], 3)}", precedence
        case _:
            return f"{_FUNCTIONS.get(name, name)}({parts[0][0]})", _ATOM


def _part(written: tuple[str, int], least: int) -> str:
    """An operand, in brackets if what it is binds less than it must."""
    text, precedence = written
    return text if precedence >= least else f"({text})"
