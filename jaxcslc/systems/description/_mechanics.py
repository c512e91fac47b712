"""Equations of motion by Lagrange, or of SymPy's mechanics."""

from collections.abc import Mapping, Sequence
from typing import Any

from ._entries import DescriptionError, name_of


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
    from sympy import Eq, sympify

    forces = dict(forces or {})
    lagrangian, dissipation = sympify(lagrangian), sympify(dissipation)
    if others := [force for force in forces if force not in coordinates]:
        listed = ", ".join(map(name_of, coordinates))
        raise DescriptionError(f"forces: {others[0]} is no coordinate; expected some of {listed}")
    equations: dict[str, Any] = {}
    for q in coordinates:
        (time,) = q.args
        rate = q.diff(time)
        inertia = lagrangian.diff(rate).diff(time) - lagrangian.diff(q) + dissipation.diff(rate)
        equations[name_of(q)] = Eq(sympify(forces.get(q, 0)), inertia, evaluate=False)
    return equations


def mechanics_equations(method: Any) -> dict[str, Any]:
    """The equations of a `LagrangesMethod` or `KanesMethod` of `sympy.physics.mechanics`.

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
    from sympy import Eq, solve

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
        equations[name_of(q)] = Eq(0, inertia - forcing[row].subs(replaced), evaluate=False)
    return equations
