"""Reader of equations that are written as text."""

import ast
import math
from collections.abc import Callable, Collection
from typing import Any

from ._entries import DescriptionError


# Functions of one number that a formula may contain, by their names in SymPy.
_FUNCTIONS = {
    **{
        name: name for name in ("sin", "cos", "tan", "asin", "acos", "atan", "sinh", "cosh", "tanh")
    },
    **{name: name for name in ("exp", "log", "sqrt", "sign")},
    "abs": "Abs",
}
_RATES = {"dot": 1, "ddot": 2}
_LONGEST = 80  # of a formula in a message
RESERVED = ("pi", "min", "max", "where", *_RATES, *_FUNCTIONS)
"""Names that formulas give a meaning."""
_OPERATORS: dict[type, Callable[[Any, Any], Any]] = {
    ast.Add: lambda x, y: x + y,
    ast.Sub: lambda x, y: x - y,
    ast.Mult: lambda x, y: x * y,
    ast.Div: lambda x, y: x / y,
    ast.Pow: lambda x, y: x**y,
}
_COMPARISONS: dict[type, Callable[[Any, Any], Any]] = {
    ast.Lt: lambda x, y: x < y,
    ast.LtE: lambda x, y: x <= y,
    ast.Gt: lambda x, y: x > y,
    ast.GtE: lambda x, y: x >= y,
}


def parse_equation(text: str, variables: Collection[str], constants: Collection[str]) -> Any:
    """An equation `left = right` as SymPy's, or an expression that is zero.

    Names, numbers, `+ - * / ** ^`, `dot(x)` and `ddot(x)` for time derivatives, `sin cos tan asin
    acos atan sinh cosh tanh exp log sqrt sign abs`, `min max` of several, and `where(x > 0, A, B)`.
    Nothing is executed.

    **Raises** `DescriptionError` for anything else, naming it.

    >>> parse_equation("F = m*ddot(x) + k*x", ["x", "F"], ["m", "k"])
    Eq(F(t), k*x(t) + m*Derivative(x(t), (t, 2)))
    """
    from sympy import Eq

    sides = [side.strip() for side in _split(text)]
    if len(sides) > 2 or not all(sides):
        raise DescriptionError(f"got {text!r}; expected left = right")
    parsed = [parse_formula(side, variables, constants) for side in sides]
    return Eq(*parsed, evaluate=False) if len(parsed) == 2 else parsed[0]


def parse_formula(text: str, variables: Collection[str], constants: Collection[str]) -> Any:
    """Parse one side of an equation; see `parse_equation`."""
    try:
        tree = ast.parse(text.replace("^", "**"), mode="eval")
    except (SyntaxError, ValueError, RecursionError) as error:
        reason = error.msg if isinstance(error, SyntaxError) else str(error)
        raise DescriptionError(f"cannot read {_short(text)}: {reason}") from None
    return _Reader(text, set(variables), set(constants)).read(tree.body)


def _is_comparison(value: Any) -> bool:
    from sympy.core.relational import Relational
    from sympy.logic.boolalg import BooleanAtom

    return isinstance(value, Relational | BooleanAtom)


def _short(text: str) -> str:
    """A text in quotes, cut where it is long."""
    return repr(text if len(text) <= _LONGEST else text[: _LONGEST - 2] + " …")


def _split(text: str) -> list[str]:
    """Split text at equals signs, those of comparisons left alone."""
    for comparison in ("<=", ">="):
        text = text.replace(comparison, comparison[0] + "\0")
    return [side.replace("\0", "=") for side in text.split("=")]


class _Reader:
    """Walks the syntax tree of a formula."""

    def __init__(self, text: str, variables: set[str], constants: set[str]) -> None:
        self.text, self.variables, self.constants = text, variables, constants

    def read(self, node: ast.AST) -> Any:
        from sympy import Integer, Rational

        match node:
            case ast.Constant(value=int() as value) if not isinstance(value, bool):
                return Integer(value)
            case ast.Constant(value=float() as value) if math.isfinite(value):
                return Rational(repr(value))
            case ast.Name(id=name):
                return self._named(name)
            case ast.UnaryOp(op=ast.USub(), operand=operand):
                return -self._number(operand)
            case ast.UnaryOp(op=ast.UAdd(), operand=operand):
                return self._number(operand)
            case ast.BinOp(left=left, op=operator, right=right) if type(operator) in _OPERATORS:
                return _OPERATORS[type(operator)](self._number(left), self._number(right))
            case ast.Compare(left=left, ops=[operator], comparators=[right]) if (
                type(operator) in _COMPARISONS
            ):
                return _COMPARISONS[type(operator)](self.read(left), self.read(right))
            case ast.Call(func=ast.Name(id=name), args=arguments, keywords=[]):
                return self._called(name, arguments)
            case _:
                raise self._wrong(ast.unparse(node))

    def _number(self, node: ast.AST) -> Any:
        """Read a node that must not be a comparison."""
        value = self.read(node)
        if _is_comparison(value):
            raise DescriptionError(
                f"comparison {ast.unparse(node)!r} in {_short(self.text)}; expected it in"
                " where(...)"
            )
        return value

    def _named(self, name: str) -> Any:
        import sympy
        from sympy.physics.mechanics import dynamicsymbols

        if name in self.variables:
            return dynamicsymbols(name)
        if name in self.constants:
            return sympy.Symbol(name)
        if name == "pi":
            return sympy.pi
        raise DescriptionError(
            f"unknown name {name!r}; expected a variable ({', '.join(sorted(self.variables))}) or a"
            f" constant ({', '.join(sorted(self.constants)) or 'there are none'})"
        )

    def _called(self, name: str, arguments: list[ast.expr]) -> Any:
        import sympy

        read = self.read if name == "where" else self._number
        values = [read(argument) for argument in arguments]
        if name in _RATES and len(values) == 1:
            (argument,) = arguments
            if not (isinstance(argument, ast.Name) and argument.id in self.variables):
                raise DescriptionError(
                    f"{name} of {ast.unparse(argument)!r}; expected the name of a variable"
                )
            for _ in range(_RATES[name]):
                values = [values[0].diff()]
            return values[0]
        if name in _FUNCTIONS and len(values) == 1:
            return getattr(sympy, _FUNCTIONS[name])(*values)
        if name in ("min", "max") and len(values) > 1:
            return getattr(sympy, name.capitalize())(*values)
        if name == "where" and len(values) == 3:
            condition, then, otherwise = values
            if not _is_comparison(condition):
                raise DescriptionError(
                    "where: expected a comparison first, as in where(x > 0, A, B)"
                )
            return sympy.Piecewise((then, condition), (otherwise, True))
        expected = (*_RATES, *_FUNCTIONS, "min", "max", "where")
        if name not in expected:
            raise DescriptionError(
                f"unknown function {name!r}; expected one of {', '.join(expected)}"
            )
        raise DescriptionError(f"{name} of {len(values)} arguments in {_short(self.text)}")

    def _wrong(self, part: str) -> DescriptionError:
        return DescriptionError(
            f"cannot read {part!r} in {_short(self.text)}; expected numbers, names, + - * / ** and"
            " functions"
        )
