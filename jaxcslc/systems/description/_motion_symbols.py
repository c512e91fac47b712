"""Plain symbols of variables, their derivatives, and constants."""

import dataclasses
from collections.abc import Mapping, Sequence
from typing import Any

from ._entries import Constant, DescriptionError, Variable, name_of


ORDERS = ("{}", "dot({})", "ddot({})")
"""Spelling of a variable and its derivatives."""


@dataclasses.dataclass(frozen=True, eq=False)
class MotionSymbols:
    """Plain symbols: one for each variable, each of its two derivatives, and each constant.

    What a user wrote, with functions of time and derivatives of them, becomes algebra in these.

    **Attributes**

    - `variables`: of the system.
    - `motion`: (variable, order) to its symbol, real.
    - `constants`: name to symbol, with the sign that is known.
    """

    variables: tuple[Variable, ...]
    motion: Mapping[tuple[int, int], Any]
    constants: Mapping[str, Any]

    @classmethod
    def of(cls, variables: tuple[Variable, ...], constants: Sequence[Constant]) -> "MotionSymbols":
        """Create the symbols of a system."""
        from sympy import Symbol

        motion = {
            (index, order): Symbol(form.format(variable.name), real=True)
            for index, variable in enumerate(variables)
            for order, form in enumerate(ORDERS)
        }
        signs: dict[str | None, dict[str, bool]] = {
            None: {"real": True},
            "positive": {"positive": True},
            "negative": {"negative": True},
        }
        return cls(
            variables,
            motion,
            {c.name: Symbol(c.name, **signs[c.sign]) for c in constants},
        )

    def plain(self, expression: Any, where: str) -> Any:
        """An expression in these symbols alone.

        Names decide, whatever assumptions SymPy's symbols carry.

        **Raises** `DescriptionError` for names that are neither variable nor constant, and for
        third derivatives.
        """
        from sympy import Derivative, sympify
        from sympy.core.function import AppliedUndef

        expression = sympify(expression)
        if any(not isinstance(d.expr, AppliedUndef) for d in expression.atoms(Derivative)):
            expression = expression.doit()
        index_of = {variable.name: index for index, variable in enumerate(self.variables)}
        replaced: dict[Any, Any] = {}
        for derivative in sorted(expression.atoms(Derivative), key=str):
            name, order = name_of(derivative.expr), derivative.derivative_count
            if name not in index_of or derivative.variables != derivative.expr.args * order:
                raise DescriptionError(
                    f"{where}: {derivative} is no time derivative of a variable; expected one of"
                    f" {self._listed}"
                )
            if order > 2:
                raise DescriptionError(
                    f"{where}: derivative {order} of {name!r}; expected the first or the second"
                )
            replaced[derivative] = self.motion[index_of[name], order]
        expression = expression.xreplace(replaced)
        motion = set(self.motion.values())
        for atoms in (expression.atoms(AppliedUndef), None):
            # Functions of time before symbols, so that the time in them is no name of its own.
            replaced = {}
            for atom in sorted(expression.free_symbols if atoms is None else atoms, key=str):
                name = name_of(atom)
                if name in index_of and atom not in motion:
                    replaced[atom] = self.motion[index_of[name], 0]
                elif atoms is None and name in self.constants:
                    replaced[atom] = self.constants[name]
                elif atom not in motion:
                    raise DescriptionError(
                        f"{where}: unknown name {str(atom)!r}; expected a variable"
                        f" ({self._listed}) or a constant"
                        f" ({', '.join(self.constants) or 'there are none'})"
                    )
            expression = expression.xreplace(replaced)
        return exact(expression)

    @property
    def _listed(self) -> str:
        return ", ".join(variable.name for variable in self.variables) or "there are none"


def exact(expression: Any) -> Any:
    """Return the expression with its decimals as exact fractions."""
    from sympy import Float, Rational

    return expression.xreplace({x: Rational(repr(float(x))) for x in expression.atoms(Float)})
