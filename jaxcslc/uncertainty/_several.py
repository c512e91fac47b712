"""Joint fit of several recordings of one robot, and a test of whether they agree.

Torque offsets of each recording may be eliminated (Frisch and Waugh 1933).
"""

import dataclasses
from collections.abc import Mapping, Sequence
from functools import partial, reduce
from types import MappingProxyType
from typing import Any

import numpy as np
import scipy
from jaxtyping import Float

from .._text_table import first_of
from ..least_squares import (
    Equations,
    Identification,
    LeastSquares,
    Unknowns,
    columns_of,
    hidden_noise,
    unknowns_of,
)
from ..network import AbstractLinearNetwork
from ..recordings import Patterns
from ._drift import Drift, drift_of
from ._held_out import CHANCE
from ._systematic_error import SystematicError, standard_uncertainty


@dataclasses.dataclass(frozen=True, eq=False)
class RecordingEquations:
    """Equations of one recording, its offsets eliminated.

    - `equations`: in the network's coefficients.
    - `offset_rows`: for each joint the column of its offset, and the equations before it was
      eliminated; None without offsets.
    """

    equations: Equations
    offset_rows: tuple[tuple[np.ndarray, np.ndarray], ...] | None

    @classmethod
    def of(
        cls,
        network: AbstractLinearNetwork,
        patterns: Patterns,
        solver: LeastSquares,
        *,
        offsets: bool,
    ) -> "RecordingEquations":
        """Return the equations of patterns; if there are offsets, constant torques are eliminated.

        Least squares with a further column c for each joint has the coefficients of least squares
        of what is orthogonal to c (Frisch and Waugh 1933): no unknown has to be added.
        """
        if not offsets:
            return cls(solver.equations(network, patterns), None)
        columns = columns_of(network, patterns)
        plain = unknowns_of(network, patterns, columns)
        with_constant = Unknowns(
            (*plain.names, "offset"), tuple((*support, plain.size) for support in plain.support)
        )
        constant = np.ones((1, patterns.samples))
        whole = Equations.from_columns(
            with_constant,
            tuple(np.concatenate([of_joint, constant]) for of_joint in columns),
            np.asarray(patterns.torque),
            np.asarray(patterns.mask),
            time=np.asarray(patterns.time),
            cutoff=solver.cutoff,
        )
        pairs = tuple((rows[:, -2], np.delete(rows, -2, axis=1)) for rows in whole.rows)
        rows = tuple(
            kept - np.outer(column, column @ kept) / _square(column) for column, kept in pairs
        )
        return cls(Equations(plain, rows, whole.sample), pairs)

    def weighted(self, weights: Float[np.ndarray, " joints"]) -> Equations:
        """The equations of each joint times a weight."""
        pairs = zip(self.equations.rows, weights.tolist(), strict=True)
        rows = tuple(rows * weight for rows, weight in pairs)
        return Equations(self.equations.unknowns, rows, self.equations.sample)

    def rms(self, fit: Identification) -> Float[np.ndarray, " joints"]:
        """RMS residual of each joint under a fit; zero of joints without equations."""
        residuals = self.equations.errors(np.asarray(fit.k))
        squares = [float(np.mean(error**2)) if error.size else 0.0 for error in residuals]
        return np.sqrt(np.array(squares))

    def offsets(self, fit: Identification) -> Float[np.ndarray, " joints"]:
        """The constant torques that a fit leaves; zeros if none were eliminated."""
        k = np.asarray(fit.k)
        if self.offset_rows is None:
            return np.zeros(len(self.equations.rows))
        pairs = zip(self.offset_rows, self.equations.unknowns.support, strict=True)
        means = (
            column @ (rows[:, -1] - rows[:, :-1] @ k[list(support)]) / _square(column)
            for (column, rows), support in pairs
        )
        return np.array(list(means))


def _square(column: Float[np.ndarray, " rows"]) -> float:
    """The square of a column's norm, of nothing 1: what is divided by it is zero then."""
    return float(column @ column) or 1.0


# What a sentence ends with where no cause of a disagreement is known.
_NO_CAUSE = "check temperature, payload and robot, or fit it by itself"


@dataclasses.dataclass(frozen=True)
class RecordingAgreement:
    """Agreement of recordings about the coefficients: each one against all others together.

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
    >>> from jaxcslc.uncertainty import RecordingAgreement
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
        """Coefficients that differ beyond chance, by recording, the clearest first."""
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
            sentences.append(
                f"{recording} disagrees with the others in {first_of(names, 6)}:"
                f" RMS torque error of {label} {others[joint]:.3g} under the others' coefficients,"
                f" {alone[joint]:.3g} under its own; {self.causes.get(recording, _NO_CAUSE)}"
            )
        return tuple(sentences)

    def __str__(self) -> str:
        return agreement_text(self.differing)


def agreement_text(differing: Mapping[str, Sequence[str]]) -> str:
    """Return whether recordings agree, in words, from the coefficients that differ by recording."""
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
    """Compare the fit of each recording with the fit of all others.

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
        limit[name] = float(scipy.special.stdtrit(degrees, 1.0 - 0.5 * CHANCE / tests))
    return RecordingAgreement(
        network.names,
        MappingProxyType(difference),
        MappingProxyType(error),
        MappingProxyType(limit),
        MappingProxyType({name: equations[name].rms(fit) for name, fit in alone.items()}),
        MappingProxyType({name: equations[name].rms(fit) for name, fit in others.items()}),
        network.output_names,
    )


def combined_systematic(
    fits: Mapping[str, Identification], errors: Mapping[str, SystematicError]
) -> SystematicError:
    """The systematic error of a fit of several recordings, from those of fits of each by itself.

    The common fit is about the mean of the others, weighted by their precision. Causes are taken to
    act alike in all recordings, so that their errors add, and do not average out.
    """
    weights = {name: _precision(fits[name]) for name in errors}
    total = np.sum(list(weights.values()), axis=0)
    total = np.where(total > 0.0, total, 1.0)
    causes = dict.fromkeys(cause for error in errors.values() for cause in error.parts)
    parts = {
        cause: np.sum(
            [
                weights[name] / total * error.parts[cause]
                for name, error in errors.items()
                if cause in error.parts
            ],
            axis=0,
        )
        for cause in causes
    }
    return SystematicError(MappingProxyType(parts))


def _precision(fit: Identification) -> np.ndarray:
    """Return the reciprocal variance of each coefficient; 0 if it is not determined."""
    error = np.asarray(fit.standard_error)
    usable = np.asarray(fit.determined) & np.isfinite(error) & (error > 0.0)
    return np.where(usable, 1.0 / np.where(usable, error, 1.0) ** 2, 0.0)


DRIFT = "drift between recordings"
"""Name of the part of a systematic error that makes intervals hold for other recordings."""


def _drift(
    network: AbstractLinearNetwork,
    fit: Identification,
    alone: Mapping[str, Identification],
    error: SystematicError | None = None,
    errors: Mapping[str, SystematicError] | None = None,
) -> Drift:
    """Return how far recordings differ beyond the errors of their fits, systematic ones too.

    - `error`: of the common fit; `errors`: by recording, of its own fit.
    """
    own = [
        np.where(
            np.asarray(some.determined),
            standard_uncertainty(some, None if errors is None else errors[name]),
            np.inf,
        )
        for name, some in alone.items()
    ]
    return drift_of(
        network,
        np.asarray(fit.k),
        standard_uncertainty(fit, error),
        np.array([np.asarray(some.k) for some in alone.values()]),
        np.array(own),
        min(float(some.degrees_of_freedom) for some in alone.values()),
    )


@dataclasses.dataclass(frozen=True, eq=False)
class SeveralFit:
    """Joint fit of several recordings.

    **Attributes**

    - `network`: n joints, p coefficients.
    - `fit`: of all of them.
    - `patterns`: by recording, less its torque offsets.
    - `offsets`: by recording, (n,) constant torques that were fitted along; zero if not asked for.
    - `noise`: by recording, (n,) RMS residual under the common fit.
    - `alone`: by recording, the fit of it by itself.
    - `without`: by recording, the fit of the others.
    - `agreement`: of the recordings.
    - `drift`: how much coefficients differ from recording to recording.
    """

    network: AbstractLinearNetwork
    fit: Identification
    patterns: Mapping[str, Patterns]
    offsets: Mapping[str, Float[np.ndarray, " joints"]]
    noise: Mapping[str, Float[np.ndarray, " joints"]]
    alone: Mapping[str, Identification]
    without: Mapping[str, Identification]
    agreement: RecordingAgreement
    drift: Drift

    def allowing_for(
        self,
        errors: Mapping[str, SystematicError],
        share: Float[np.ndarray, "coefficients coefficients"] | None = None,
    ) -> tuple["SeveralFit", SystematicError]:
        """Return the fit with an agreement that allows for systematic errors, and the fit's own.

        The latter has the drift between recordings as one of its parts.

        - `errors`: by recording, of its fit in `alone`.
        - `share`: what coefficients change by with those of a fit without prior knowledge.
        """
        difference: dict[str, np.ndarray] = {}
        for name in self.alone:
            others = {n: fit for n, fit in self.alone.items() if n != name}
            other = combined_systematic(others, {n: errors[n] for n in others})
            difference[name] = np.hypot(errors[name].total, other.total)
        agreement = dataclasses.replace(
            self.agreement,
            standard_error=MappingProxyType(
                {
                    name: np.hypot(error, difference[name])
                    for name, error in self.agreement.standard_error.items()
                }
            ),
        )
        own = combined_systematic(self.alone, errors)
        drift = _drift(self.network, self.fit, self.alone, own, errors)
        changed = dataclasses.replace(self, agreement=agreement, drift=drift)
        part = drift.allowance if share is None else drift.allowance * np.abs(np.diag(share))
        return changed, SystematicError(MappingProxyType({**own.parts, DRIFT: part}))

    def document(self) -> dict[str, Any]:
        """Return the entries of a report about each recording, as plain data."""
        differing = self.agreement.differing
        return {
            name: {
                "samples": patterns.samples,
                "noise": self.noise[name].tolist(),
                "offsets": self.offsets[name].tolist(),
                "differing": list(differing[name]),
            }
            for name, patterns in self.patterns.items()
        }

    def __str__(self) -> str:
        return several_text(self.document())


def several_text(document: Mapping[str, Mapping[str, Any]]) -> str:
    """Return what a report says of several recordings, from `SeveralFit.document`."""
    lines = [agreement_text({name: entry["differing"] for name, entry in document.items()})]
    for name, entry in document.items():
        noise = ", ".join(f"{size:.3g}" for size in entry["noise"])
        lines.append(f"{name}: {entry['samples']} samples, RMS residual of each joint {noise}")
        if any(entry["offsets"]):
            listed = ", ".join(f"{offset:.3g}" for offset in entry["offsets"])
            lines.append(f"    torque offsets {listed}")
    return "\n".join(lines)


def fit_recordings(
    network: AbstractLinearNetwork,
    patterns: Mapping[str, Patterns],
    solver: LeastSquares | None = None,
    *,
    offsets: bool = False,
) -> SeveralFit:
    """Fits several recordings of one robot together, and tests whether they agree.

    Equations of each joint of each recording are weighted by its noise: the RMS residual of the fit
    of that recording by itself. What a recording leaves beyond that in the common fit is
    disagreement, not noise. Recordings need not be of the same length or rate.

    **Arguments**

    - `network`: n joints, p coefficients.
    - `patterns`: of two recordings or more, by name.
    - `solver`: options of the fit; the defaults of `LeastSquares` if None. Joint weights are those
      of all recordings together.
    - `offsets`: fit a constant torque of each joint in each recording along, as for sensors whose
      zero drifts. It takes the place of a friction term `"offset"`.

    **Returns** a `SeveralFit`.

    **Raises**

    - `ValueError`: fewer than two recordings, or as `LeastSquares.fit`.
    - `RuntimeError`: as `LeastSquares.fit`.

    >>> import numpy as np, jaxcslc as jc
    >>> from jaxcslc.uncertainty import fit_recordings
    >>> network, rng = jc.derive(jc.examples.turntable()), np.random.default_rng(0)
    >>> def patterns(friction):
    ...     exact = jc.examples.swing(network, [0.5, friction, 1.0])
    ...     noise = 0.01 * rng.standard_normal(exact.torque.shape)
    ...     return dataclasses.replace(exact, torque=exact.torque + noise)
    >>> both = {"cold": patterns(2.0), "warm": patterns(1.5)}
    >>> fit_recordings(network, both).agreement.differing["warm"]
    ('kv1',)
    """
    if len(patterns) < 2:
        raise ValueError(f"fit_recordings: got {len(patterns)} recordings; expected two or more")
    solver = solver or LeastSquares()
    equations = {
        name: RecordingEquations.of(network, values, solver, offsets=offsets)
        for name, values in patterns.items()
    }
    samples = {name: len(values.time) for name, values in patterns.items()}
    names = list(patterns)
    fitted = partial(_fitted, solver, equations, samples)
    alone = {name: fitted({name: np.ones(network.joint_count)}, [name]) for name in names}
    weights = _weights(equations, alone)
    fit = fitted(weights, names)
    noise = {name: equations[name].rms(fit) for name in names}
    others: dict[str, Identification] = {}
    for name in names:
        remaining = [other for other in names if other != name]
        single = len(remaining) == 1
        others[name] = alone[remaining[0]] if single else fitted(weights, remaining)
    offset_torques = {name: equations[name].offsets(fit) for name in names}
    return SeveralFit(
        network,
        fit,
        MappingProxyType(
            {
                name: dataclasses.replace(
                    values, torque=np.asarray(values.torque) - offset_torques[name]
                )
                for name, values in patterns.items()
            }
        ),
        MappingProxyType(offset_torques),
        MappingProxyType(noise),
        MappingProxyType(alone),
        MappingProxyType(others),
        agreement_of(network, equations, alone, others),
        _drift(network, fit, alone),
    )


def _fitted(
    solver: LeastSquares,
    equations: Mapping[str, RecordingEquations],
    samples: Mapping[str, int],
    weights: Mapping[str, Float[np.ndarray, " joints"]],
    names: Sequence[str],
) -> Identification:
    """The fit of some recordings, one after the other."""

    def followed(first: tuple[Equations, int], name: str) -> tuple[Equations, int]:
        joined, length = first
        more = equations[name].weighted(weights[name])
        return joined.followed_by(more, length), length + samples[name]

    start = equations[names[0]].weighted(weights[names[0]]), samples[names[0]]
    return solver.fit_equations(*reduce(followed, names[1:], start))


def _weights(
    equations: Mapping[str, RecordingEquations], alone: Mapping[str, Identification]
) -> dict[str, Float[np.ndarray, " joints"]]:
    """Return weights per joint and recording: RMS of the noise of all over that of its own.

    A recording's own noise is its RMS residual under its own fit. A recording at a wrong rate
    leaves much there; under a fit of all, it would draw the fit to itself, and those that are right
    would seem noisy. The noise is no less than what a fit can hide of what is usual of that joint
    in all recordings (`hidden_noise`). So a joint that barely moves in one recording, where few
    equations follow any torque, has no more weight there than elsewhere.
    """
    noise = {name: some.rms(alone[name]) for name, some in equations.items()}
    pooled = np.sqrt(np.mean([size**2 for size in noise.values()], axis=0))
    floors = hidden_noise(
        np.array(list(noise.values())).T,
        np.array([some.equations.counts() for some in equations.values()]).T,
        next(iter(equations.values())).equations.unknowns.joint_sizes[:, None],
        pooled[:, None],
    ).T
    weights: dict[str, np.ndarray] = {}
    for (name, size), floor in zip(noise.items(), floors, strict=True):
        own = np.maximum(size, floor)
        weights[name] = np.where(own > 0.0, pooled / np.where(own > 0.0, own, 1.0), 1.0)
    return weights
