import dataclasses
from collections.abc import Mapping

import numpy as np
from jaxtyping import Float

from ..identification import Identification
from ..motion import Patterns
from ._network import SystemNetwork


_SHOWN = 6  # minima


@dataclasses.dataclass(frozen=True)
class Minimum:
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
    minima: tuple[Minimum, ...]
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
        """What searching costs: that the error has more than one minimum, or may have."""
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
