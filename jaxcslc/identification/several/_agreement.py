import dataclasses
from collections.abc import Mapping, Sequence
from types import MappingProxyType

import numpy as np
import scipy
from jaxtyping import Float

from ...network import AbstractLinearNetwork
from ..solver import Identification
from ._recording_equations import RecordingEquations


# Recordings of the same robot are said to disagree once in so many times.
_CHANCE = 0.01
# What a sentence ends with where no cause of a disagreement is known.
_NO_CAUSE = "check temperature, payload and robot, or fit it by itself"


@dataclasses.dataclass(frozen=True)
class RecordingAgreement:
    """Whether recordings show the same coefficients: each one against all others together.

    A recording at another temperature, with a payload, or of another robot differs in some.

    **Attributes**

    - `names`: of the p coefficients.
    - `difference`: by recording, its coefficients less those of the others; NaN where one of the
      two does not determine a coefficient.
    - `standard_error`: of the differences.
    - `limit`: by recording, how many standard errors the largest difference of recordings that
      agree exceeds once in a hundred times, all coefficients and recordings together (Student's t,
      Bonferroni).
    - `alone`, `others`: by recording, RMS torque error of each joint under the recording's own
      coefficients, and under those of the others.
    - `joint_names`: for sentences; numbers if None.
    - `causes`: by recording, the likely cause of its disagreement, where one is known.

    >>> import numpy as np
    >>> from jaxcslc.identification import RecordingAgreement
    >>> one, rms = np.array([0.1, 3.0]), np.ones(1)
    >>> agreement = RecordingAgreement(
    ...     ("kB1", "kv1"), {"b.csv": one}, {"b.csv": np.array([0.1, 0.5])}, {"b.csv": 3.5},
    ...     {"b.csv": rms}, {"b.csv": 2 * rms}
    ... )
    >>> agreement.differing["b.csv"]
    ('kv1',)
    """

    names: tuple[str, ...]
    difference: Mapping[str, Float[np.ndarray, " coefficients"]]
    standard_error: Mapping[str, Float[np.ndarray, " coefficients"]]
    limit: Mapping[str, float]
    alone: Mapping[str, Float[np.ndarray, " joints"]]
    others: Mapping[str, Float[np.ndarray, " joints"]]
    joint_names: tuple[str, ...] | None = None
    causes: Mapping[str, str] = dataclasses.field(default_factory=dict)

    @property
    def differing(self) -> dict[str, tuple[str, ...]]:
        """By recording, the coefficients that differ beyond chance, the clearest first."""
        listed: dict[str, tuple[str, ...]] = {}
        for recording, difference in self.difference.items():
            with np.errstate(invalid="ignore", divide="ignore"):
                score = np.abs(difference) / self.standard_error[recording]
            score = np.where(np.isfinite(score), score, 0.0)
            order = np.argsort(-score)
            listed[recording] = tuple(
                self.names[i] for i in order if score[i] > self.limit[recording]
            )
        return listed

    @property
    def warnings(self) -> tuple[str, ...]:
        """A sentence for each recording that disagrees with the others."""
        sentences: list[str] = []
        differing = self.differing
        if len(self.difference) == 2:  # either differs from the other, by as much
            differing = dict(list(differing.items())[1:])
        for recording, names in differing.items():
            if not names:
                continue
            alone, others = self.alone[recording], self.others[recording]
            joint = int(np.argmax(others / np.where(alone > 0.0, alone, 1.0)))
            label = f"joint {joint + 1}" if self.joint_names is None else self.joint_names[joint]
            more = f" and {len(names) - 6} more" if names[6:] else ""
            sentences.append(
                f"{recording} disagrees with the others in {', '.join(names[:6])}{more}:"
                f" RMS torque error of {label} {others[joint]:.3g} under the others' coefficients,"
                f" {alone[joint]:.3g} under its own; {self.causes.get(recording, _NO_CAUSE)}"
            )
        return tuple(sentences)

    def __str__(self) -> str:
        return agreement_text(self.differing)


def agreement_text(differing: Mapping[str, Sequence[str]]) -> str:
    """Return whether recordings agree, in words.

    **Arguments**

    - `differing`: by recording, the coefficients in which it differs beyond chance.
    """
    if not any(differing.values()):
        return f"the {len(differing)} recordings agree in all coefficients"
    return "\n".join(
        f"{recording}: {', '.join(names) or 'no coefficient'} beyond chance"
        for recording, names in differing.items()
    )


def agreement_of(
    network: AbstractLinearNetwork,
    equations: Mapping[str, RecordingEquations],
    alone: Mapping[str, Identification],
    others: Mapping[str, Identification],
) -> RecordingAgreement:
    """Of recordings' own fits with the fits of all others.

    - `equations`: by recording, in the order of the fits.
    """
    difference: dict[str, np.ndarray] = {}
    error: dict[str, np.ndarray] = {}
    limit: dict[str, float] = {}
    comparisons = 1 if len(alone) == 2 else len(alone)
    for name, fit in alone.items():
        other = others[name]
        both = np.asarray(fit.determined) & np.asarray(other.determined)
        difference[name] = np.where(both, np.asarray(fit.k) - np.asarray(other.k), np.nan)
        errors = [np.asarray(some.standard_error) for some in (fit, other)]
        error[name] = np.where(both, np.hypot(*errors), np.nan)
        degrees = min(float(some.degrees_of_freedom) for some in (fit, other))
        tests = max(int(np.count_nonzero(both)), 1) * comparisons
        limit[name] = float(scipy.special.stdtrit(degrees, 1.0 - 0.5 * _CHANCE / tests))
    return RecordingAgreement(
        network.names,
        MappingProxyType(difference),
        MappingProxyType(error),
        MappingProxyType(limit),
        MappingProxyType({name: equations[name].rms(fit) for name, fit in alone.items()}),
        MappingProxyType({name: equations[name].rms(fit) for name, fit in others.items()}),
        network.output_names,
    )
