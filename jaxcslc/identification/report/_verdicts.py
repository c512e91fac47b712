import dataclasses
from typing import Literal

import numpy as np

from ...network import CSLC
from ..solver import Identification
from ._excitation import Excitation


Word = Literal[
    "well determined",
    "poorly determined",
    "indistinguishable from zero",
    "wrong sign",
    "not determined",
]

# A standard error of a tenth of the value, the field's rule of thumb (Khalil and Dombre 2002,
# 12.5).
_WELL = 0.1
# From here on, most of a coefficient's variance is that others could stand in for it (Belsley, Kuh
# and Welsch 1980).
_ENTANGLED = 10.0


@dataclasses.dataclass(frozen=True)
class Verdict:
    """How far a recording tells a coefficient.

    **Attributes**

    - `name`: of the coefficient.
    - `word`: `"well determined"`: its standard error is at most a tenth of it; `"poorly
      determined"`: it is more; `"indistinguishable from zero"`: its interval holds zero;
      `"wrong sign"`: positive for every possible body, and its whole interval is negative;
      `"not determined"`: the patterns do not tell it.
    - `reason`: why, in a few words.
    """

    name: str
    word: Word
    reason: str

    def __str__(self) -> str:
        return f"{self.name}: {self.word}, {self.reason}"


def verdicts(
    network: CSLC,
    fit: Identification,
    excitation: Excitation | None = None,
    *,
    level: float = 0.95,
) -> tuple[Verdict, ...]:
    """What a fit's standard errors mean, coefficient by coefficient, in words.

    **Arguments**

    - `network`: p coefficients.
    - `fit`: to this network.
    - `excitation`: of the patterns that it was made from; reasons then name entanglement with
      other coefficients, where that is what makes one poorly determined.
    - `level`: of the intervals.

    **Returns** p verdicts, in the order of the coefficients.

    **Raises**

    - `ValueError`: a fit of another network.

    >>> import numpy as np, jaxcslc as jc
    >>> from jaxcslc.assessment import verdicts
    >>> arm = jc.Manipulator.from_modified_dh([(0, 0, 0, 0)], gravity=(0, 0, -9.81))
    >>> network = jc.derive(arm, lengths="numeric")
    >>> t = np.linspace(0, 5, 500)[:, None]
    >>> q, qd, qdd = np.sin(t), np.cos(t), -np.sin(t)
    >>> noise = np.random.default_rng(0).normal(size=t.shape)
    >>> torque = np.asarray(network.torque(np.array([0.5, 2.0, 0.001]), q, qd, qdd)) + 0.1 * noise
    >>> everything = np.ones(t.shape, bool)
    >>> patterns = jc.Patterns(t[:, 0], q, qd, qdd, torque, everything, everything)
    >>> for verdict in verdicts(network, jc.LeastSquares().fit(network, patterns)):
    ...     print(verdict.name, verdict.word)
    kB1 well determined
    kv1 well determined
    kd1 indistinguishable from zero
    """
    if fit.names != network.names:
        raise ValueError(
            f"the fit has {len(fit.names)} coefficients from {fit.names[0]!r}, the network has"
            f" {network.size} from {network.names[0]!r}; expected a fit of this network"
        )
    interval = fit.confidence_interval(level)
    inflation = None if excitation is None else np.asarray(excitation.variance_inflation)
    determined = np.asarray(fit.determined)
    known = _known(fit)
    found: list[Verdict] = []
    for i, coefficient in enumerate(network.coefficients):
        name, (low, high) = coefficient.name, interval[i]
        value, error = float(fit.k[i]), float(fit.standard_error[i])
        if not determined[i]:
            found.append(Verdict(name, "not determined", known[name]))
            continue
        part = abs(error / value) if value else np.inf
        reason = f"standard error {_percent(part)} of it"
        if inflation is not None and part > _WELL and inflation[i] > _ENTANGLED:
            times = f"{np.sqrt(inflation[i]):.2g} times as large"
            reason += f"; entangled with others, which alone makes it {times}"
        if coefficient.positive and high < 0.0:
            found.append(Verdict(name, "wrong sign", "positive for every possible body"))
        elif low <= 0.0 <= high:
            found.append(Verdict(name, "indistinguishable from zero", reason))
        else:
            word = "well determined" if part <= _WELL else "poorly determined"
            found.append(Verdict(name, word, reason))
    return tuple(found)


def _percent(part: float) -> str:
    return f"{100 * part:.2g} %" if part < 1.0 else f"{min(part, 1e9):.2g} times"


def _known(fit: Identification) -> dict[str, str]:
    """For each coefficient that is not determined, what is: the sentence of its group."""
    sentences: dict[str, str] = {}
    for sentence in fit.unidentifiable:
        group, _, text = sentence.partition(": ")
        for name in group.split(", "):
            sentences[name] = text
    return {name: sentences.get(name, "the patterns do not tell it") for name in fit.names}
