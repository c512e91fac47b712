import dataclasses

import numpy as np
from jaxtyping import Float

from .._rank import pseudo_inverse
from ..identification import Identification
from ._system import System
from .algebra import COMPLEX_STEP


# The search for constants ends when a step changes them by less than this part.
_PRECISION = 1e-12


@dataclasses.dataclass(frozen=True)
class ConstantEstimate:
    """An unknown constant as it follows from identified coefficients.

    **Attributes**

    - `name`, `unit`: of the constant.
    - `value`: that explains the coefficients best, in its unit.
    - `standard_error`: from the coefficients' covariance, to first order.

    >>> from jaxcslc.systems import ConstantEstimate
    >>> print(ConstantEstimate("l", "m", 0.5, 0.002))
    l = 0.5 ± 0.002 m
    """

    name: str
    unit: str
    value: float
    standard_error: float

    def __str__(self) -> str:
        return f"{self.name} = {self.value:.4g} ± {self.standard_error:.2g} {self.unit}".rstrip()


def constants_from(system: System, fit: Identification) -> tuple[ConstantEstimate, ...]:
    """The constants of a system that its coefficients determine.

    The values whose coefficients are nearest to the identified ones, each difference divided by its
    standard error: where there are more coefficients than constants, all of them count. Constants
    that are determined only in combinations are left out.

    **Arguments**

    - `system`: whose coefficients were identified.
    - `fit`: of its network.

    **Returns** an estimate of each constant that follows from coefficients alone, in the order of
    `system.unknown`; none where a coefficient is not determined, or where no values of the signs
    that are known come near the coefficients.

    >>> import numpy as np, sympy
    >>> from jaxcslc.systems import Constant, System, SystemRecording, Variable
    >>> from jaxcslc.systems import constants_from, identify_system
    >>> x, y, z, m, l = sympy.symbols("x y z m l", positive=True)
    >>> lever = System(
    ...     "lever", {"force": sympy.Eq(z, m * x + m * l * y)},
    ...     (Variable(x), Variable(y), Variable(z)),
    ...     (Constant(m, "kg", sign="positive"), Constant(l, "m", sign="positive")),
    ... )
    >>> time = np.arange(400) * 0.1
    >>> columns = {"x": np.sin(time), "y": np.cos(2 * time)}
    >>> columns["z"] = 2 * columns["x"] + 0.6 * columns["y"]
    >>> report = identify_system(lever, SystemRecording(time, columns))
    >>> [(row.name, round(row.value, 6)) for row in constants_from(lever, report.fit)]
    [('m', 2.0), ('l', 0.3)]
    """
    from scipy.optimize import least_squares  # takes a while to load

    separation = system.separation
    alone = [row.constant for row in separation.identifiability if row.verdict == "alone"]
    if not alone or not np.all(np.asarray(fit.determined)):
        return ()
    names = list(separation.symbols)
    k, error = np.asarray(fit.k), np.asarray(fit.standard_error)
    # Coefficients that were met exactly count like the others, by their size.
    weight = 1.0 / np.maximum(error, 1e-9 * np.maximum(np.abs(k), np.max(np.abs(k)) * 1e-9))
    signs = np.array([-1.0 if separation.symbols[name].is_negative else 1.0 for name in names])
    known_sign = np.array(
        [bool(s.is_negative or s.is_positive) for s in separation.symbols.values()]
    )

    def residual(values: Float[np.ndarray, " constants"]) -> Float[np.ndarray, " coefficients"]:
        return weight * (np.real(separation.evaluate(values)) - k)

    def gradient(
        values: Float[np.ndarray, " constants"],
    ) -> Float[np.ndarray, "coefficients constants"]:
        steps = values[:, None] + 1j * COMPLEX_STEP * np.eye(len(values))
        return weight[:, None] * np.imag(separation.evaluate(steps)) / COMPLEX_STEP

    bounds = (
        np.where(known_sign & (signs > 0), 0.0, -np.inf),
        np.where(known_sign & (signs < 0), 0.0, np.inf),
    )
    best = None
    for size in (1.0, 0.1, 10.0):
        solution = least_squares(
            residual,
            size * signs,
            jac=gradient,
            bounds=bounds,
            x_scale="jac",
            xtol=_PRECISION,
            ftol=_PRECISION,
            gtol=_PRECISION,
        )
        if best is None or solution.cost < best.cost:
            best = solution
    assert best is not None
    # Of exact coefficients a thousandth must be met: of others, what their errors explain.
    misfit = np.abs(np.real(separation.evaluate(best.x)) - k)
    if np.any(misfit > np.maximum(10.0 * error, 1e-3 * np.abs(k))):
        return ()
    inverse = pseudo_inverse(gradient(best.x)) * weight[None, :]
    covariance = inverse @ np.asarray(fit.covariance) @ inverse.T
    units = {constant.name: constant.unit for constant in system.unknown}
    return tuple(
        ConstantEstimate(name, units[name], float(best.x[i]), float(np.sqrt(covariance[i, i])))
        for i, name in enumerate(names)
        if name in alone
    )
