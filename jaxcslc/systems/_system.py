"""`System`: equations, variables and constants, and their stages (thesis 8.2.5, C.2).

Equations of mechanical systems come from Lagrange or from SymPy's mechanics.
"""

import dataclasses
from collections.abc import Callable, Mapping, Sequence
from functools import cached_property
from types import MappingProxyType
from typing import TYPE_CHECKING, Any

import numpy as np
from jaxtyping import Array, Float
from sympy import Eq, Heaviside, Integer, Rational, lambdify, sign, solve, sympify

from .._environment import array_namespace
from ._description import (
    Constant,
    DescriptionError,
    MotionSymbols,
    Variable,
    parse_unit,
    symbol_name,
)
from ._separation import Separation, separate


if TYPE_CHECKING:
    from ._network import SystemNetwork


def lagrange_equations(
    lagrangian: Any,
    coordinates: Sequence[Any],
    forces: Mapping[Any, Any] | None = None,
    dissipation: Any = 0,
) -> dict[str, Any]:
    """Lagrange's equations of the second kind, one for each coordinate and with its name.

        Q = d/dt dL/dq' - dL/dq + dD/dq'

    **Arguments**

    - `lagrangian`: L, kinetic less potential energy.
    - `coordinates`: functions of time.
    - `forces`: the generalised force Q of a coordinate; zero if omitted.
    - `dissipation`: Rayleigh's D, half the power that viscous friction takes.

    **Returns** equations by name, for `System`.

    **Raises** `DescriptionError` for a force of no coordinate.

    >>> from sympy import Symbol
    >>> from sympy.physics.mechanics import dynamicsymbols
    >>> from jaxcslc.systems import lagrange_equations
    >>> x, m = dynamicsymbols("x"), Symbol("m")
    >>> lagrange_equations(m * x.diff()**2 / 2, [x], {x: dynamicsymbols("F")})
    {'x': Eq(F(t), m*Derivative(x(t), (t, 2)))}
    """
    forces = dict(forces or {})
    lagrangian, dissipation = sympify(lagrangian), sympify(dissipation)
    if others := [force for force in forces if force not in coordinates]:
        listed = ", ".join(map(symbol_name, coordinates))
        raise DescriptionError(f"forces: {others[0]} is no coordinate; expected some of {listed}")
    equations: dict[str, Any] = {}
    for q in coordinates:
        (time,) = q.args
        rate = q.diff(time)
        inertia = lagrangian.diff(rate).diff(time) - lagrangian.diff(q) + dissipation.diff(rate)
        equations[symbol_name(q)] = Eq(sympify(forces.get(q, 0)), inertia, evaluate=False)
    return equations


def mechanics_equations(method: Any) -> dict[str, Any]:
    """Return the equations of a `LagrangesMethod` or `KanesMethod` of `sympy.physics.mechanics`.

    They are those that the method forms, 0 = M u' - f, with generalised speeds expressed by the
    derivatives of the coordinates.

    **Arguments**

    - `method`: without constraints, after its equations were formed
      (`form_lagranges_equations` or `kanes_equations`).

    **Returns** equations by name of the coordinate, for `System`.

    **Raises** `DescriptionError` for a method with constraints, or without equations.

    >>> from sympy import Symbol
    >>> from sympy.physics.mechanics import LagrangesMethod, dynamicsymbols
    >>> from jaxcslc.systems import mechanics_equations
    >>> x, m, k = dynamicsymbols("x"), Symbol("m"), Symbol("k")
    >>> method = LagrangesMethod(m * x.diff()**2 / 2 - k * x**2 / 2, [x])
    >>> _ = method.form_lagranges_equations()
    >>> mechanics_equations(method)
    {'x': Eq(0, k*x(t) + m*Derivative(x(t), (t, 2)))}
    """
    try:
        coordinates, speeds = list(method.q), list(method.u)
        mass, forcing = method.mass_matrix, method.forcing
    except (AttributeError, ValueError) as error:
        raise DescriptionError(
            f"{type(method).__name__}: {error}; expected a LagrangesMethod or KanesMethod whose"
            " equations were formed"
        ) from None
    if mass.shape != (len(coordinates), len(coordinates)) or len(speeds) != len(coordinates):
        raise DescriptionError(
            f"{type(method).__name__}: {len(coordinates)} coordinates, {len(speeds)} speeds and"
            f" {mass.shape[0]} equations; expected as many of each, without constraints"
        )
    rates = [q.diff() for q in coordinates]
    replaced: dict[Any, Any] = {}
    if speeds != rates:
        kinematic = method.kindiffdict()
        differences = [rate - kinematic[rate] for rate in rates]
        solution = solve(differences, speeds, dict=True)
        if len(solution) != 1:
            raise DescriptionError(
                f"{type(method).__name__}: speeds do not follow from the coordinates' derivatives"
            )
        replaced = solution[0]
    accelerations = [replaced.get(u, u).diff().doit() for u in speeds]
    equations: dict[str, Any] = {}
    for row, q in enumerate(coordinates):
        inertia = sum(mass[row, j].subs(replaced) * accelerations[j] for j in range(len(speeds)))
        equations[symbol_name(q)] = Eq(0, inertia - forcing[row].subs(replaced), evaluate=False)
    return equations


@dataclasses.dataclass(frozen=True, eq=False)
class Formulas:
    """SymPy expressions of motion and searched constants as one function, of NumPy or JAX.

    **Attributes**

    - `symbols`: (variable, order) of each motion symbol that occurs.
    - `expressions`: to be evaluated.
    - `arguments`: the symbols themselves, then those of searched constants.
    """

    symbols: tuple[tuple[int, int], ...]
    expressions: tuple[Any, ...]
    arguments: tuple[Any, ...]

    @classmethod
    def of(cls, system: "System", expressions: Sequence[Any]) -> "Formulas":
        """Return the formulas of expressions in the symbols of a system."""
        used = {symbol for expression in expressions for symbol in expression.free_symbols}
        symbols = {key: x for key, x in system.symbols.motion.items() if x in used}
        searched = (system.symbols.constants[constant.name] for constant in system.nonlinear)
        return cls(tuple(symbols), tuple(expressions), (*symbols.values(), *searched))

    @cached_property
    def _jax(self) -> Callable[..., Any]:
        return lambdify(self.arguments, list(self.expressions), modules="jax", cse=True)

    @cached_property
    def _numpy(self) -> Callable[..., Any]:
        return lambdify(self.arguments, list(self.expressions), modules="numpy", cse=True)

    def __call__(
        self,
        motion: Sequence[Float[Array | np.ndarray, "*batch variables"]],
        nonlinear: Sequence[Any] | Float[Array | np.ndarray, " nonlinear"],
    ) -> list[Float[Array | np.ndarray, "*batch"]]:
        """Evaluate the expressions: one array each.

        - `motion`: values, first and second derivatives of the variables.
        """
        xp = array_namespace(*motion)
        function = self._numpy if xp is np else self._jax
        arguments = [motion[order][..., variable] for variable, order in self.symbols]
        dtype, shape = motion[0].dtype, motion[0].shape[:-1]
        values = function(*arguments, *(xp.asarray(x, dtype) for x in nonlinear))
        return [xp.broadcast_to(xp.asarray(value, dtype), shape) for value in values]


@dataclasses.dataclass(frozen=True, eq=False)
class System:
    """System whose equations are known and whose constants are not (thesis 8.2.5, C.2).

    The five stages of C.2 are its properties and what is done with them: the symbolic form
    (`equations`), numbers instead of what is known (`numeric`), unknown constants apart from
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
        described: dict[str, str] = {}
        for what in ("variable", "constant"):
            for name in (entry.name for entry in getattr(self, f"{what}s")):
                if described.get(name) == what:
                    raise DescriptionError(f"{what} {name!r} is described twice; expected once")
                if name in described:
                    raise DescriptionError(f"{name!r} is a variable and a constant; expected one")
                described[name] = what
        for output, unit in self.output_units.items():
            if output not in self.equations:
                raise DescriptionError(
                    f"units: no equation {output!r}; expected some of {', '.join(self.equations)}"
                )
            parse_unit(unit, f"units of {output!r}")
        self._check_use()

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

    @property
    def middles(self) -> tuple[float, ...]:
        """The middle of the bounds of each of `nonlinear`."""
        return tuple(0.5 * sum(c.bounds) for c in self.nonlinear if c.bounds is not None)

    @cached_property
    def symbols(self) -> MotionSymbols:
        """The symbols of stages two and three."""
        return MotionSymbols(self.variables, self.constants)

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
        atoms = ((left - right).atoms(sign, Heaviside) for left, right in self.numeric.values())
        return tuple(
            tuple(sorted({x.args[0] for x in of_equation}, key=str)) for of_equation in atoms
        )

    @property
    def column_names(self) -> tuple[str, ...]:
        """The columns that a recording of the system has next to time."""
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
        """Return the values of expressions in plain symbols, in NumPy.

        Searched constants are taken at the middle of their bounds.
        """
        with np.errstate(all="ignore"):
            values = Formulas.of(self, expressions)((q, qd, qdd), self.middles)
        return np.stack(values, axis=1)

    def with_values(self, values: Mapping[str, float]) -> "System":
        """Return the system with values of some constants.

        **Raises** `DescriptionError` for names of no constant.

        >>> import jaxcslc as jc
        >>> jc.examples.tank()[0].with_values({"area": 3.0}).network.names
        ('outlet',)
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
