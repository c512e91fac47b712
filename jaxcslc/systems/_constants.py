"""Constants of a system as they follow from coefficients, and results of searches."""

import dataclasses
from collections.abc import Mapping

import numpy as np
from jaxtyping import Float

from .._rank import pseudo_inverse
from ..least_squares import Identification
from ..recordings import Patterns
from ._network import SystemNetwork
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


_SHOWN = 6  # minima


@dataclasses.dataclass(frozen=True)
class ConstantMinimum:
    """A minimum of the error over the constants that enter nonlinearly.

    **Attributes**

    - `values`: (s,) of the constants.
    - `error`: (n,) root mean square error of each output there, with the best coefficients.
    - `ratio`: error over that of the best minimum, of all outputs as they are weighted.
    - `starts`: how many of the evenly spread starts ended in it.
    """

    values: Float[np.ndarray, " constants"]
    error: Float[np.ndarray, " outputs"]
    ratio: float
    starts: int


@dataclasses.dataclass(frozen=True)
class ConstantSearch:
    """Constants that enter nonlinearly, with the coefficients that belong to them.

    **Attributes**

    - `names`: of the s constants.
    - `fit`: coefficients and constants together, in this order, with standard errors that allow
      for each other; its last s names are those of the constants, without those `at_bound`.
    - `network`: the system's, with the constants at their values.
    - `minima`: all different ones, the best first.
    - `starts`: how many starts were spread evenly within the bounds.
    - `at_bound`: names of constants that ended at one of their bounds.
    """

    names: tuple[str, ...]
    fit: Identification
    network: SystemNetwork
    minima: tuple[ConstantMinimum, ...]
    starts: int
    at_bound: tuple[str, ...]

    @property
    def coefficients(self) -> Identification:
        """The coefficients alone; their errors allow for those of the constants."""
        p, fit = self.network.size, self.fit
        rows = {name: getattr(fit, name)[:p] for name in ("k", "standard_error", "determined")}
        squares = ("covariance", "independent_covariance", "undetermined")
        return dataclasses.replace(
            fit,
            names=self.network.names,
            **rows,
            **{name: getattr(fit, name)[:p, :p] for name in squares},
        )

    @property
    def values(self) -> Mapping[str, float]:
        """The constants by name."""
        return dict(zip(self.names, np.asarray(self.network.nonlinear).tolist(), strict=True))

    def with_known_sides(self, patterns: Patterns) -> Patterns:
        """Patterns whose known sides belong to the values of the constants.

        **Arguments**

        - `patterns`: of the system, as by `system_patterns`.
        """
        motion = tuple(np.asarray(x) for x in (patterns.q, patterns.qd, patterns.qdd))
        before = self.network.system.network.known(*motion)
        torque = np.asarray(patterns.torque + self.network.known(*motion) - before)
        return dataclasses.replace(patterns, torque=torque)

    @property
    def share(self) -> float:
        """The part of evenly spread starts that ended in the best minimum."""
        return self.minima[0].starts / self.starts

    @property
    def unexplored(self) -> float:
        """The part of the bounds, expected, from which starts would end in further minima.

        w (w + 1) / (N (N - 1)) for N starts that ended in w different minima (Boender and Rinnooy
        Kan, 'Bayesian stopping rules for multistart global optimization methods', Mathematical
        Programming 37, 1987).
        """
        different = sum(minimum.starts > 0 for minimum in self.minima)
        return min(1.0, different * (different + 1) / (self.starts * max(self.starts - 1, 1)))

    def __str__(self) -> str:
        error = dict(zip(self.fit.names, np.asarray(self.fit.standard_error), strict=True))
        width = max(map(len, self.names))
        lines = [
            f"{name:<{width}}  {value:>11.5g}"
            + (f" ± {error[name]:.2g}" if name in error else "  at its bound")
            for name, value in self.values.items()
        ]
        return "\n".join([*lines, self.statement])

    @property
    def statement(self) -> str:
        """Sentences about the search: the error has more than one minimum, or may have."""
        first, *others = self.minima
        text = (
            f"The equations are not linear in {', '.join(self.names)}: a single minimum is no"
            f" longer certain. {first.starts} of {self.starts} starts ended in the best minimum"
        )
        if not others:
            return f"{text}; no other was seen."
        listed = "; ".join(
            ", ".join(
                f"{name} = {value:.4g}"
                for name, value in zip(self.names, minimum.values, strict=True)
            )
            + f" (error {minimum.ratio:.4g} times as large)"
            for minimum in others[:_SHOWN]
        )
        more = f"; and {len(others) - _SHOWN} more" if len(others) > _SHOWN else ""
        return (
            f"{text}, {100 * self.unexplored:.2g} % of the bounds may lead to minima not seen."
            f" Others: {listed}{more}."
        )
