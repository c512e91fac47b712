"""`System`: equations, variables and constants, and their stages (thesis 8.2.5, C.2)."""

import dataclasses
from collections.abc import Mapping, Sequence
from functools import cached_property
from types import MappingProxyType
from typing import TYPE_CHECKING, Any

import numpy as np
from jaxtyping import Float

from .algebra import Separation, separate
from .description import (
    Constant,
    DescriptionError,
    MotionSymbols,
    Variable,
    check_unit,
    lagrange_equations,
    mechanics_equations,
    named,
)


if TYPE_CHECKING:
    from ._network import SystemNetwork


@dataclasses.dataclass(frozen=True, eq=False)
class System:
    """System whose equations are known and whose constants are not (thesis 8.2.5, C.2).

    The five stages of C.2 are its properties and what is done with them: the symbolic form
    (`equations`), numbers in place of what is known (`numeric`), unknown constants apart from
    known variables (`separation`), the network (`network`), and training (`identify_system`,
    `LeastSquares`, or any rule of `jaxcslc.training` on `jaxcslc.training.linear_combiner`).

    **Attributes**

    - `name`: for reports.
    - `equations`: by name of the output. `sympy.Eq(left, right)`, or an expression that is zero,
      in the variables, their time derivatives and the constants.
    - `variables`: what is measured, or derived from measurements.
    - `constants`: unknown, known, or searched.
    - `output_units`: by name of the output, for reports.

    **Raises** `DescriptionError` for names described twice or not at all, and for derivatives
    beyond the second.

    >>> import sympy
    >>> from sympy.physics.mechanics import dynamicsymbols
    >>> from jaxcslc.systems import Constant, System, Variable
    >>> x, force = dynamicsymbols("x force")
    >>> mass, damping = sympy.symbols("mass damping")
    >>> cart = System(
    ...     "cart",
    ...     {"rail": sympy.Eq(force, mass * x.diff().diff() + damping * x.diff())},
    ...     (Variable(x, "m"), Variable(force, "N")),
    ...     (Constant(mass, "kg", sign="positive"), Constant(damping, "N s/m")),
    ... )
    >>> cart.network
    SystemNetwork(cart: 1 equation, 2 variables, 2 coefficients)
    """

    name: str
    equations: Mapping[str, Any]
    variables: tuple[Variable, ...]
    constants: tuple[Constant, ...]
    output_units: Mapping[str, str] = dataclasses.field(default_factory=dict)

    def __post_init__(self) -> None:
        for field in ("variables", "constants"):
            object.__setattr__(self, field, tuple(getattr(self, field)))
        for field in ("equations", "output_units"):
            object.__setattr__(self, field, MappingProxyType(dict(getattr(self, field))))
        if not self.equations:
            raise DescriptionError(f"system {self.name!r}: no equations; expected one or more")
        if both := named(self.variables, "variable").keys() & named(self.constants, "constant"):
            raise DescriptionError(f"{min(both)!r} is a variable and a constant; expected one")
        for output, unit in self.output_units.items():
            if output not in self.equations:
                raise DescriptionError(
                    f"units: no equation {output!r}; expected some of {', '.join(self.equations)}"
                )
            check_unit(unit, f"units of {output!r}")
        self._check_use()

    @classmethod
    def from_lagrangian(
        cls,
        name: str,
        lagrangian: Any,
        coordinates: Sequence[Any],
        *,
        variables: Sequence[Variable],
        constants: Sequence[Constant],
        forces: Mapping[Any, Any] | None = None,
        dissipation: Any = 0,
        output_units: Mapping[str, str] | None = None,
    ) -> "System":
        """A mechanical system from its energies: Lagrange's equations are derived.

        - `lagrangian`, `coordinates`, `forces`, `dissipation`: as of `lagrange_equations`.
        - the others: as the attributes. Equations are named after the coordinates.

        **Raises** `DescriptionError` as `System` and `lagrange_equations`.

        >>> import sympy
        >>> from sympy.physics.mechanics import dynamicsymbols
        >>> from jaxcslc.systems import Constant, System, Variable
        >>> x, force = dynamicsymbols("x force")
        >>> mass, stiffness = sympy.symbols("mass stiffness")
        >>> spring = System.from_lagrangian(
        ...     "spring", (mass * x.diff() ** 2 - stiffness * x**2) / 2, [x], forces={x: force},
        ...     variables=[Variable(x, "m"), Variable(force, "N")],
        ...     constants=[Constant(mass, "kg"), Constant(stiffness, "N/m")],
        ... )
        >>> spring.network.names
        ('mass', 'stiffness')
        """
        equations = lagrange_equations(lagrangian, coordinates, forces, dissipation)
        return cls(name, equations, tuple(variables), tuple(constants), dict(output_units or {}))

    @classmethod
    def from_mechanics(
        cls,
        name: str,
        method: Any,
        *,
        variables: Sequence[Variable],
        constants: Sequence[Constant],
        output_units: Mapping[str, str] | None = None,
    ) -> "System":
        """A mechanical system from a `LagrangesMethod` or `KanesMethod` of SymPy.

        - `method`: as of `mechanics_equations`.
        - the others: as the attributes. Equations are named after the coordinates.

        **Raises** `DescriptionError` as `System` and `mechanics_equations`.
        """
        equations = mechanics_equations(method)
        return cls(name, equations, tuple(variables), tuple(constants), dict(output_units or {}))

    @property
    def outputs(self) -> tuple[str, ...]:
        """Names of the equations."""
        return tuple(self.equations)

    @property
    def unknown(self) -> tuple[Constant, ...]:
        """The constants that coefficients are made of."""
        return tuple(c for c in self.constants if c.value is None and c.bounds is None)

    @property
    def known(self) -> tuple[Constant, ...]:
        """The constants that have values."""
        return tuple(c for c in self.constants if c.value is not None)

    @property
    def nonlinear(self) -> tuple[Constant, ...]:
        """The constants that are searched within bounds."""
        return tuple(c for c in self.constants if c.bounds is not None)

    @cached_property
    def symbols(self) -> MotionSymbols:
        """The symbols of stages two and three."""
        return MotionSymbols.of(self.variables, self.constants)

    @cached_property
    def symbolic(self) -> Mapping[str, tuple[Any, Any]]:
        """The first stage: both sides of each equation in plain symbols, as they were described.

        `dot(x)` and `ddot(x)` stand for derivatives.
        """
        return MappingProxyType({name: self._sides(name) for name in self.equations})

    @cached_property
    def numeric(self) -> Mapping[str, tuple[Any, Any]]:
        """The second stage: both sides of each equation with the values of known constants put in.

        An equation whose left side alone has unknown constants is turned round.
        """
        from sympy import Rational

        unknown = {self.symbols.constants[constant.name] for constant in self.unknown}
        values = {
            self.symbols.constants[c.name]: Rational(repr(float(c.value)))
            for c in self.known
            if c.value is not None
        }
        sides = {
            name: (left.xreplace(values), right.xreplace(values))
            for name, (left, right) in self.symbolic.items()
        }
        return MappingProxyType(
            {
                name: (right, left)
                if left.free_symbols & unknown and not right.free_symbols & unknown
                else (left, right)
                for name, (left, right) in sides.items()
            }
        )

    @cached_property
    def separation(self) -> Separation:
        """The third stage: unknown constants apart from known variables.

        **Raises** `DescriptionError` for constants that enter nonlinearly.
        """
        return separate(self)

    @cached_property
    def network(self) -> "SystemNetwork":
        """The fourth stage: the network whose weights are the coefficients.

        **Raises** as `separation`.
        """
        from ._network import SystemNetwork

        return SystemNetwork.of(self)

    @cached_property
    def states(self) -> tuple[int, ...]:
        """Indices of the variables that are smoothed and differentiated."""
        return tuple(i for i, v in enumerate(self.variables) if self._is_state(i, v))

    @cached_property
    def inputs(self) -> tuple[int, ...]:
        """Indices of the variables that are taken as recorded."""
        return tuple(i for i in range(len(self.variables)) if i not in self.states)

    @cached_property
    def signs(self) -> tuple[tuple[Any, ...], ...]:
        """Arguments of the signs in each equation."""
        from sympy import Heaviside, sign

        atoms = ((left - right).atoms(sign, Heaviside) for left, right in self.numeric.values())
        return tuple(
            tuple(sorted({x.args[0] for x in of_equation}, key=str)) for of_equation in atoms
        )

    @property
    def column_names(self) -> tuple[str, ...]:
        """The columns that a recording of the system has beside time."""
        names = (
            name
            for variable in self.variables
            for name in (variable.column_name, variable.rate, variable.second_rate)
        )
        return tuple(dict.fromkeys(name for name in names if name not in (None, "time")))

    def evaluate(
        self,
        expressions: Sequence[Any],
        q: Float[np.ndarray, "samples variables"],
        qd: Float[np.ndarray, "samples variables"],
        qdd: Float[np.ndarray, "samples variables"],
    ) -> Float[np.ndarray, "samples expressions"]:
        """The values of expressions in plain symbols, in NumPy.

        Searched constants are taken at the middle of their bounds.
        """
        from sympy import lambdify

        middles = {
            self.symbols.constants[c.name]: 0.5 * sum(c.bounds)
            for c in self.nonlinear
            if c.bounds is not None
        }
        symbols = list(self.symbols.motion.values())
        function = lambdify(symbols, [x.subs(middles) for x in expressions], modules="numpy")
        motion = (q, qd, qdd)
        arguments = [motion[order][:, index] for index, order in self.symbols.motion]
        with np.errstate(all="ignore"):
            values = function(*arguments)
        return np.stack([np.broadcast_to(np.asarray(x, float), len(q)) for x in values], axis=1)

    def with_values(self, values: Mapping[str, float]) -> "System":
        """The system with values of some constants.

        **Raises** `DescriptionError` for names of no constant.

        >>> from jaxcslc.systems import Constant, System, Variable
        >>> import sympy
        >>> x, y, a, n = sympy.symbols("x y a n")
        >>> power = System(
        ...     "power law", {"y": sympy.Eq(y, a * x**n)}, (Variable(x), Variable(y)),
        ...     (Constant(a), Constant(n, bounds=(0.2, 1.0))),
        ... )
        >>> [constant.name for constant in power.with_values({"n": 0.5}).nonlinear]
        []
        """
        names = [constant.name for constant in self.constants]
        if unknown := [name for name in values if name not in names]:
            raise DescriptionError(
                f"values: no constant {unknown[0]!r}; expected some of {', '.join(names)}"
            )
        constants = tuple(
            dataclasses.replace(c, value=float(values[c.name]), bounds=None)
            if c.name in values
            else c
            for c in self.constants
        )
        return dataclasses.replace(self, constants=constants)

    def __str__(self) -> str:
        lines = [f"system {self.name!r}"]
        for name, (left, right) in self.symbolic.items():
            lines.append(f"{name}: {left} = {right}")
        if self.known:
            values = (f"{c.name} = {c.value:g} {c.unit}".rstrip() for c in self.known)
            lines.append("known: " + ", ".join(values))
        if self.nonlinear:
            searched = (f"{c.name} in {list(c.bounds or ())}" for c in self.nonlinear)
            lines.append("searched: " + ", ".join(searched))
        return "\n".join([*lines, str(self.separation)])

    def _is_state(self, index: int, variable: Variable) -> bool:
        if variable.kind is not None:
            return variable.kind == "state"
        used = {x for sides in self.numeric.values() for side in sides for x in side.free_symbols}
        derivatives = {self.symbols.motion[index, 1], self.symbols.motion[index, 2]}
        return variable.rate is not None or bool(used & derivatives)

    def _sides(self, name: str) -> tuple[Any, Any]:
        """Return the two sides of an equation in plain symbols."""
        from sympy import Eq, Integer

        equation = self.equations[name]
        if isinstance(equation, bool) or getattr(equation, "is_Boolean", False):
            raise DescriptionError(
                f"equation {name!r} is always {str(equation).lower()}; expected variables and"
                " constants on its sides"
            )
        sides: Sequence[Any] = equation.args if isinstance(equation, Eq) else (equation, Integer(0))
        left, right = (self.symbols.plain(side, f"equation {name!r}") for side in sides)
        return left, right

    def _check_use(self) -> None:
        """**Raises** `DescriptionError` for a constant or variable that is in no equation."""
        used = {x for sides in self.symbolic.values() for side in sides for x in side.free_symbols}
        symbols = {
            f"constant {constant.name!r}": {self.symbols.constants[constant.name]}
            for constant in self.constants
        } | {
            f"variable {variable.name!r}": {self.symbols.motion[i, order] for order in range(3)}
            for i, variable in enumerate(self.variables)
        }
        for name, alternatives in symbols.items():
            if not alternatives & used:
                raise DescriptionError(
                    f"{name} is in no equation; expected it in one, or not at all"
                )
