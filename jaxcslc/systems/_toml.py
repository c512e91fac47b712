"""Systems as text: the reader of equations, and of TOML files."""

import ast
import keyword
import math
import operator
import os
from collections.abc import Callable, Collection, Mapping
from pathlib import Path
from typing import Any, NamedTuple

import sympy
from sympy import Eq, Integer, Rational, Symbol
from sympy.core.relational import Relational
from sympy.logic.boolalg import BooleanAtom
from sympy.physics.mechanics import dynamicsymbols

from .._plain_data import toml_document
from ._description import Constant, DescriptionError, Variable
from ._system import System


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
# Bounds of one side of an equation: characters; terms of its sums, multiplied out; digits of a
# number. They are far above those of any system of the literature. What lies beyond takes minutes.
_MOST_CHARACTERS, _MOST_TERMS, _MOST_DIGITS = 10_000, 10_000, 5_000
_LARGEST_POWER = 64  # of what is not a number
RESERVED = ("pi", "min", "max", "where", *_RATES, *_FUNCTIONS)
"""Names that formulas give a meaning."""
_OPERATORS: dict[type, Callable[[Any, Any], Any]] = {
    ast.Add: operator.add,
    ast.Sub: operator.sub,
    ast.Mult: operator.mul,
    ast.Div: operator.truediv,
    ast.Pow: operator.pow,
}
_COMPARISONS: dict[type, Callable[[Any, Any], Any]] = {
    ast.Lt: operator.lt,
    ast.LtE: operator.le,
    ast.Gt: operator.gt,
    ast.GtE: operator.ge,
}


def parse_equation(text: str, variables: Collection[str], constants: Collection[str]) -> Any:
    """Return an equation `left = right` as SymPy's, or an expression that is zero.

    Names, numbers, `+ - * / ** ^`, `dot(x)` and `ddot(x)` for time derivatives, `sin cos tan asin
    acos atan sinh cosh tanh exp log sqrt sign abs`, `min max` of several, and `where(x > 0, A, B)`.
    Nothing is executed.

    **Raises** `DescriptionError` for anything else, naming it.

    >>> parse_equation("F = m*ddot(x) + k*x", ["x", "F"], ["m", "k"])
    Eq(F(t), k*x(t) + m*Derivative(x(t), (t, 2)))
    """
    sides = [side.strip() for side in _split(text)]
    if len(sides) > 2 or not all(sides):
        raise DescriptionError(f"got {text!r}; expected left = right")
    parsed = [parse_formula(side, variables, constants) for side in sides]
    return Eq(*parsed, evaluate=False) if len(parsed) == 2 else parsed[0]


def parse_formula(text: str, variables: Collection[str], constants: Collection[str]) -> Any:
    """Parse one side of an equation; see `parse_equation`."""
    if len(text) > _MOST_CHARACTERS:
        raise DescriptionError(
            f"{_short(text)} has {len(text)} characters; expected {_MOST_CHARACTERS} at most"
        )
    try:
        tree = ast.parse(text.replace("^", "**"), mode="eval")
        size = _size(tree.body)
    except (SyntaxError, ValueError, RecursionError, MemoryError) as error:
        reason = error.msg if isinstance(error, SyntaxError) else str(error) or "nested too deeply"
        raise DescriptionError(f"cannot read {_short(text)}: {reason}") from None
    if size.terms > _MOST_TERMS or size.digits > _MOST_DIGITS:
        raise DescriptionError(
            f"{_short(text)} is too large when it is multiplied out; expected {_MOST_TERMS} terms"
            f" and numbers of {_MOST_DIGITS} digits at most"
        )
    return _Reader(text, set(variables), set(constants)).read(tree.body)


class _Size(NamedTuple):
    """Upper bounds of what a formula becomes when it is multiplied out.

    - `terms`: of its sum.
    - `digits`: of the largest number in it.
    - `number`: its value, if it is made of numbers alone.
    """

    terms: float
    digits: float
    number: float | None = None


def _size(node: ast.AST) -> _Size:
    match node:
        case ast.Constant(value=int() | float() as value):
            return _Size(1, len(str(value)), float(value))
        case ast.UnaryOp(operand=operand):
            size = _size(operand)
            return size._replace(number=None if size.number is None else -size.number)
        case ast.BinOp(left=left, op=sign, right=right):
            return _size_of_two(_size(left), sign, _size(right))
        case _:
            # Of a function, of one term: its largest argument.
            sizes = [_size(child) for child in ast.iter_child_nodes(node)]
            terms = max((size.terms for size in sizes), default=1)
            return _Size(terms, max((size.digits for size in sizes), default=0))


def _size_of_two(left: _Size, sign: ast.operator, right: _Size) -> _Size:
    number = None
    if left.number is not None and right.number is not None:
        try:
            number = float(_OPERATORS[type(sign)](left.number, right.number))
        except (ArithmeticError, KeyError, TypeError):  # overflows, or complex
            return _Size(math.inf, math.inf, math.inf)
    digits = left.digits + right.digits
    if isinstance(sign, ast.Add | ast.Sub):
        if number is None:
            return _Size(left.terms + right.terms, max(left.digits, right.digits))
        return _Size(1, digits + 1, number)
    if not isinstance(sign, ast.Pow):
        return _Size(left.terms * right.terms, digits, number)
    if right.number is None:  # is not multiplied out
        return _Size(max(left.terms, right.terms), digits)
    power = abs(right.number)
    if left.number is None and power > _LARGEST_POWER:
        return _Size(math.inf, math.inf)
    terms = (
        1.0 if left.terms <= 1 else min(left.terms, _MOST_TERMS + 1) ** min(power, _LARGEST_POWER)
    )
    return _Size(terms, left.digits * max(power, 1.0), number)


def _is_comparison(value: Any) -> bool:
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
            case ast.BinOp(left=left, op=sign, right=right) if type(sign) in _OPERATORS:
                return _OPERATORS[type(sign)](self._number(left), self._number(right))
            case ast.Compare(left=left, ops=[sign], comparators=[right]) if (
                type(sign) in _COMPARISONS
            ):
                sides = self._number(left), self._number(right)
                try:
                    return _COMPARISONS[type(sign)](*sides)
                except TypeError:  # infinite, or complex
                    raise DescriptionError(
                        f"cannot compare {ast.unparse(node)!r} in {_short(self.text)}; expected"
                        " real numbers on both sides"
                    ) from None
            case ast.Call(func=ast.Name(id=name), args=arguments, keywords=[]):
                return self._called(name, arguments)
            case _:
                raise DescriptionError(
                    f"cannot read {ast.unparse(node)!r} in {_short(self.text)}; expected numbers,"
                    " names, + - * / ** and functions"
                )

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


_KEYS = {"name", "about", "variables", "constants", "equations", "units"}
_VARIABLE_KEYS = {"unit", "column", "rate", "second_rate", "kind"}
_CONSTANT_KEYS = {"unit", "value", "sign", "bounds"}


def load_system(path: str | os.PathLike[str]) -> System:
    """Reads a system from a TOML file.

        name = "cart"
        [variables]
        x = { unit = "m" }
        force = { unit = "N" }
        [constants]
        mass = { unit = "kg", sign = "positive" }
        damping = { unit = "N s/m" }
        [equations]
        rail = "force = mass*ddot(x) + damping*dot(x)"

    Entries are those of `Variable` and `Constant`; `[units]` has units of equations. What equations
    may contain is in `docs/systems.md`.

    **Arguments**

    - `path`: of the file.

    **Returns** the system.

    **Raises** `DescriptionError`, one line: the file, where in it, and what was expected.

    >>> import pathlib, tempfile
    >>> from jaxcslc.systems import load_system
    >>> with tempfile.TemporaryDirectory() as folder:
    ...     path = pathlib.Path(folder) / "tank.toml"
    ...     _ = path.write_text('''
    ...         name = "tank"
    ...         variables = { level = { unit = "m" }, inflow = { unit = "m³/s" } }
    ...         constants = { area = { unit = "m²" } }
    ...         equations = { volume = "inflow = area*dot(level)" }
    ...     ''', encoding="utf-8")
    ...     load_system(path).network
    SystemNetwork(tank: 1 equation, 2 variables, 1 coefficient)
    """
    path = Path(path)
    document = toml_document(path, "system file", DescriptionError)
    try:
        return system_from(document, default_name=path.stem)
    except DescriptionError as error:
        raise DescriptionError(f"{path}: {error}") from None


def system_from(document: Mapping[str, Any], *, default_name: str = "system") -> System:
    """A system from a document as `load_system` reads it.

    **Raises** `DescriptionError`.
    """
    _check_keys(document, _KEYS, "the file")
    tables = {name: _table(document, name) for name in ("variables", "constants", "equations")}
    for name in ("variables", "equations"):
        if not tables[name]:
            raise DescriptionError(f"no [{name}]; expected one or more")
    variables = tuple(
        Variable(dynamicsymbols(_identifier(name)), **_entry(name, entry, _VARIABLE_KEYS))
        for name, entry in tables["variables"].items()
    )
    constants = tuple(
        Constant(Symbol(_identifier(name)), **_entry(name, entry, _CONSTANT_KEYS))
        for name, entry in tables["constants"].items()
    )
    equations: dict[str, Any] = {}
    for name, text in tables["equations"].items():
        if not isinstance(text, str):
            raise DescriptionError(
                f"equation {name!r}: got {text!r}; expected a text, left = right"
            )
        try:
            equations[name] = parse_equation(text, tables["variables"], tables["constants"])
        except DescriptionError as error:
            raise DescriptionError(f"equation {name!r}: {error}") from None
    return System(
        str(document.get("name", default_name)),
        equations,
        variables,
        constants,
        _table(document, "units"),
    )


def _entry(name: str, entry: Any, keys: Collection[str]) -> dict[str, Any]:
    if not isinstance(entry, Mapping):
        raise DescriptionError(f'{name!r} is {entry!r}; expected a table, as in {{ unit = "m" }}')
    _check_keys(entry, keys, repr(name))
    for key, value in entry.items():
        expected, is_right = _VALUES.get(key, ("a text", lambda x: isinstance(x, str)))
        if not is_right(value):
            raise DescriptionError(f"{name!r}: {key} is {value!r}; expected {expected}")
    return {key: tuple(map(float, x)) if key == "bounds" else x for key, x in entry.items()}


def _is_number(value: Any) -> bool:
    return isinstance(value, int | float) and not isinstance(value, bool)


def _is_pair(value: Any) -> bool:
    return isinstance(value, list) and len(value) == 2 and all(map(_is_number, value))


# What entries are that are not texts.
_VALUES = {"value": ("a number", _is_number), "bounds": ("[LOW, HIGH]", _is_pair)}


def _identifier(name: str) -> str:
    reserved = (*RESERVED, "__debug__")  # to which Python lets nothing be assigned
    if not name.isidentifier() or keyword.iskeyword(name) or name in reserved:
        raise DescriptionError(
            f"name {name!r}: expected letters, digits and _, and neither a word of Python nor one"
            f" of {', '.join(RESERVED)}"
        )
    return name


def _table(document: Mapping[str, Any], name: str) -> Mapping[str, Any]:
    table = document.get(name, {})
    if not isinstance(table, Mapping):
        raise DescriptionError(f"[{name}] is {table!r}; expected a table")
    return table


def _check_keys(table: Mapping[str, Any], keys: Collection[str], where: str) -> None:
    if unknown := [key for key in table if key not in keys]:
        raise DescriptionError(
            f"{where}: unknown entry {unknown[0]!r}; expected some of {', '.join(sorted(keys))}"
        )
