"""Verdicts on coefficients: determined, poorly determined, not determined."""

import dataclasses
from typing import Literal

import numpy as np

from ..least_squares import Identification
from ..network import AbstractLinearNetwork
from ..uncertainty import SystematicError, uncertainty_interval
from ._excitation import Excitation
from ._model_description import ModelDescription


VerdictKind = Literal[
    "well determined",
    "poorly determined",
    "systematic error",
    "indistinguishable from zero",
    "wrong sign",
    "not determined",
]

# A standard error of a tenth of the value, the field's rule of thumb (Khalil and Dombre 2002,
# 12.5).
_WELL = 0.1
# A systematic error of half of that: no further recording of the motion makes it smaller.
_WELL_SYSTEMATIC = 0.05
# Variance inflation above this: most of a coefficient's variance comes from its correlation with
# others (Belsley, Kuh and Welsch 1980).
_CORRELATED = 10.0
# Errors of more times the value are printed beside it.
_FAR = 100.0


@dataclasses.dataclass(frozen=True)
class Verdict:
    """Verdict on how well a recording determines a coefficient.

    **Attributes**

    - `name`: of the coefficient.
    - `kind`:
        - `"well determined"`: standard and systematic error together are at most a tenth of the
          value, the systematic error alone at most a twentieth;
        - `"poorly determined"`: the standard error is more than a tenth, or the condition number
          of the fit makes every value meaningless;
        - `"systematic error"`: the standard error is small enough, the systematic error is not:
          what is needed is another model or smoothing, not more data;
        - `"indistinguishable from zero"`: the interval, systematic error included, contains zero;
        - `"wrong sign"`: the coefficient is positive for every possible body and the whole
          interval is negative;
        - `"not determined"`: the patterns do not determine it.
    - `reason`: of the verdict.
    """

    name: str
    kind: VerdictKind
    reason: str

    def __str__(self) -> str:
        return f"{self.name}: {self.kind}, {self.reason}"


def verdicts(
    network: AbstractLinearNetwork | ModelDescription,
    fit: Identification,
    excitation: Excitation | None = None,
    *,
    systematic: SystematicError | None = None,
    level: float = 0.95,
) -> tuple[Verdict, ...]:
    """Judges each coefficient of a fit by its standard and systematic errors.

    **Arguments**

    - `network`: p coefficients.
    - `fit`: to this network.
    - `excitation`: of the patterns that were fitted; reasons then name correlation with other
      coefficients where it makes one poorly determined.
    - `systematic`: of the fit, as `systematic_error` computes it; none if omitted.
    - `level`: of the intervals.

    **Returns** p verdicts, in the order of the coefficients.

    **Raises**

    - `ValueError`: a fit of another network.

    >>> import numpy as np, jaxcslc as jc
    >>> from jaxcslc.report import verdicts
    >>> arm = jc.Manipulator.from_modified_dh([(0, 0, 0, 0)], gravity=(0, 0, -9.81))
    >>> network = jc.derive(arm, lengths="numeric")
    >>> t = np.linspace(0, 5, 500)[:, None]
    >>> q, qd, qdd = np.sin(t), np.cos(t), -np.sin(t)
    >>> noise = np.random.default_rng(0).normal(size=t.shape)
    >>> torque = np.asarray(network.torque(np.array([0.5, 2.0, 0.001]), q, qd, qdd)) + 0.1 * noise
    >>> everything = np.ones(t.shape, bool)
    >>> patterns = jc.Patterns(t[:, 0], q, qd, qdd, torque, everything, everything)
    >>> for verdict in verdicts(network, jc.LeastSquares().fit(network, patterns)):
    ...     print(verdict.name, verdict.kind)
    kB1 well determined
    kv1 well determined
    kd1 indistinguishable from zero
    """
    if fit.names != network.names:
        raise ValueError(
            f"the fit has {len(fit.names)} coefficients from {fit.names[0]!r}, the network has"
            f" {network.size} from {network.names[0]!r}; expected a fit of this network"
        )
    interval = uncertainty_interval(fit, systematic, level)
    shift = np.zeros(network.size) if systematic is None else systematic.total
    inflation = None if excitation is None else np.asarray(excitation.variance_inflation)
    determined, combinations = np.asarray(fit.determined), _determined_combinations(fit)
    meaningless = not bool(fit.meaningful)
    values, errors = np.asarray(fit.k).tolist(), np.asarray(fit.standard_error).tolist()
    result: list[Verdict] = []
    for i, coefficient in enumerate(network.coefficients):
        name, (low, high) = coefficient.name, interval[i]
        value, error = values[i], errors[i]
        relative = abs(error / value) if value else np.inf
        reason = f"standard error {_compared(error, value)}"
        if inflation is not None and relative > _WELL and inflation[i] > _CORRELATED:
            times = f"{np.sqrt(inflation[i]):.2g} times as large"
            reason += f", which correlation with other coefficients makes {times}"
        kind: VerdictKind = "well determined" if relative <= _WELL else "poorly determined"
        small = np.hypot(error, shift[i]) <= _WELL * abs(value)
        if relative <= _WELL and not (small and shift[i] <= _WELL_SYSTEMATIC * abs(value)):
            kind = "systematic error"
        if systematic is not None and (shift[i] > error or kind == "systematic error"):
            reason += f"; systematic error {_compared(shift[i], value)}"
            reason += f", mostly from {systematic.main_cause(i)}"
        if not determined[i]:
            kind, reason = "not determined", combinations[name]
        elif meaningless:
            kind, reason = "poorly determined", f"condition number {float(fit.condition):.2g}"
        elif coefficient.positive and high < 0.0:
            kind, reason = "wrong sign", "positive for every possible body"
        elif low <= 0.0 <= high:
            kind = "indistinguishable from zero"
        result.append(Verdict(name, kind, reason))
    return tuple(result)


def _compared(error: float, value: float) -> str:
    """An error beside its value: '12 % of the value', '1.4 times the value'."""
    part = error / abs(value) if value else np.inf
    if part > _FAR:
        return f"{error:.2g} for a value of {value:.2g}"
    return f"{100 * part:.2g} % of the value" if part < 0.995 else f"{part:.2g} times the value"


def _determined_combinations(fit: Identification) -> dict[str, str]:
    """Return, for each undetermined coefficient, the determined combinations as a sentence."""
    sentences: dict[str, str] = {}
    for sentence in fit.unidentifiable:
        group, _, text = sentence.partition(": ")
        for name in group.split(", "):
            sentences[name] = text
    return {name: sentences.get(name, "the patterns do not determine it") for name in fit.names}
