"""Torque errors on held-out data, and comparisons of errors beyond chance."""

import dataclasses
from collections.abc import Sequence
from typing import Any, Literal

import numpy as np
import scipy
from jaxtyping import Bool, Float, Int

from .._environment import require
from .._text_table import counted
from ..least_squares import (
    Identification,
    Settings,
    check_joints,
    columns_of,
    effective_counts,
    torque_by,
    torque_of,
)
from ..network import AbstractLinearNetwork
from ..recordings import Patterns, Recording


# One joint in a hundred is warned of for nothing, and one comparison of recordings.
CHANCE = 0.01
# Stretches of equal length that a recording is cut into, each predicted by a fit to the others. By
# their spread, Student's t of 8 is 15 % above a normal quantile at 5 %; of 4, 43 %.
FOLDS = 8
# Below so much less error, coefficients that need more than others are no better.
_LEAST_GAIN = 0.01
# Held-out errors are no matter up to so many times the training errors, whatever noise explains.
_NOTICED = 1.1


Source = Literal["validation", "cross-validation", "held-out recording", "held-out stretch"]
"""Of errors on motion that was not fitted."""


@dataclasses.dataclass(frozen=True)
class HeldOut:
    """Torque errors of a fit on its training data and on data that it was not fitted to.

    **Attributes**

    - `training`: (n,) RMS error over the training data [N m or N].
    - `held_out`: (n,) RMS error over data that was not fitted [N m or N]; NaN for a joint without
      any.
    - `limit`: (n,) largest ratio of held-out to training error that noise explains, if the network
      models all else.
    - `source`: of the held-out data, `"validation"`, `"cross-validation"`, `"held-out stretch"`
      (the last part of each recording, predicted by a fit of what is before it) or, of several
      recordings, each held out of the fit in turn, `"held-out recording"`.
    - `units`: of each joint's torque; N m if omitted.
    - `names`: of the joints or equations; `"joint 1"` and so on if omitted.

    >>> import numpy as np
    >>> from jaxcslc.uncertainty import HeldOut
    >>> held_out = HeldOut(np.array([1.0, 0.5]), np.array([1.1, 0.9]), np.array([1.2, 1.2]))
    >>> held_out.beyond_chance
    (2,)
    >>> print(held_out.warnings[0])
    joint 2: validation RMS 0.9 N m, training RMS 0.5 N m (ratio 1.8, limit 1.2): the model may \
lack a term
    """

    training: Float[np.ndarray, " joints"]
    held_out: Float[np.ndarray, " joints"]
    limit: Float[np.ndarray, " joints"]
    source: Source = "validation"
    units: tuple[str, ...] | None = None
    names: tuple[str, ...] | None = None

    @property
    def ratio(self) -> Float[np.ndarray, " joints"]:
        """Held-out error over training error, (n,); NaN where there is none of either."""
        some = self.training > 0.0
        return np.where(some, self.held_out / np.where(some, self.training, 1.0), np.nan)

    @property
    def beyond_chance(self) -> tuple[int, ...]:
        """Joints, counted from 1, whose held-out error is larger than noise explains.

        Either the model lacks a term whose effect the held-out motion shows more of, or the fit
        follows the noise of its training data: use fewer coefficients or more motion.
        """
        limit = np.maximum(self.limit, _NOTICED)
        return tuple(int(joint) + 1 for joint in np.flatnonzero(self.ratio > limit))

    @property
    def warnings(self) -> tuple[str, ...]:
        """A sentence for each joint of `beyond_chance`."""
        units = self.units or ("N m",) * len(self.training)
        names = self.names or tuple(f"joint {i + 1}" for i in range(len(self.training)))
        units = tuple(f" {unit}" if unit else "" for unit in units)
        return tuple(
            f"{names[i]}: {self.source} RMS {self.held_out[i]:.3g}{units[i]}, training RMS"
            f" {self.training[i]:.3g}{units[i]} (ratio {self.ratio[i]:.3g}, limit"
            f" {self.limit[i]:.3g}): the model may lack a term"
            for i in (joint - 1 for joint in self.beyond_chance)
        )

    def to_pandas(self) -> Any:
        """Return a `pandas.DataFrame`, one row per joint, counted from 1."""
        pandas = require("pandas", "tables")

        return pandas.DataFrame(
            {
                "training": self.training,
                "held_out": self.held_out,
                "ratio": self.ratio,
                "limit": self.limit,
            },
            index=pandas.RangeIndex(1, len(self.training) + 1, name="joint"),
        )


def held_out_error(
    network: AbstractLinearNetwork, fit: Identification, training: Patterns, validation: Patterns
) -> HeldOut:
    """Compute a fit's error on a recording that it was not made from, and its training error.

    The limit is that of Fisher's F at 1 %, with as many degrees of freedom as the errors are
    worth (see `Identification.effective_equations`), times the mean (1 + h) / (1 - h) that a fit
    of p coefficients to N such errors gains on its own data and loses on others, h = p / N.

    **Arguments**

    - `network`: n joints.
    - `fit`: made from `training`.
    - `training`, `validation`: their pairs in `mask` are judged.

    **Returns** a `HeldOut`.

    **Raises**

    - `ValueError`: patterns of another number of joints.

    >>> import jaxcslc as jc
    >>> from jaxcslc.uncertainty import held_out_error
    >>> network = jc.derive(jc.examples.turntable())
    >>> patterns = jc.examples.swing(network, [0.5, 2.0, 1.0])
    >>> early, late = patterns.between(0.0, 5.0), patterns.between(5.0, 10.0)
    >>> fit = jc.LeastSquares().fit(network, early)
    >>> bool(held_out_error(network, fit, early, late).held_out[0] < 1e-9)
    True
    """
    errors: list[np.ndarray] = []
    for patterns in (training, validation):
        check_joints(network, patterns)
        errors.append(np.asarray(patterns.torque) - torque_of(network, patterns, fit.k))
    masks = np.asarray(training.mask), np.asarray(validation.mask)
    return judged_errors(errors[0], masks[0], errors[1], masks[1], int(fit.rank), network=network)


def cross_validated_error(
    network: AbstractLinearNetwork,
    patterns: Patterns,
    settings: Settings | None = None,
    *,
    folds: int = FOLDS,
    fit: Identification | None = None,
) -> HeldOut:
    """Compute the error of fits to all but one stretch of a recording on that stretch.

    Each stretch is held out in turn.

    For when there is no other recording. The limit is that of `held_out_error`.

    **Arguments**

    - `network`: n joints.
    - `patterns`: of one recording, in order of time.
    - `settings`: of the fit; those that `patterns` were made under.
    - `folds`: how many stretches of equal length.
    - `fit`: under these settings to all of `patterns`, where there is one already.

    **Returns** a `HeldOut`; its training error is that of the fit to everything.

    **Raises**

    - `ValueError`: fewer than two folds, or more than there are samples.

    >>> import jaxcslc as jc
    >>> from jaxcslc.uncertainty import cross_validated_error
    >>> network = jc.derive(jc.examples.turntable())
    >>> patterns = jc.examples.swing(network, [0.5, 2.0, 1.0])
    >>> bool(cross_validated_error(network, patterns, folds=4).held_out[0] < 1e-9)
    True
    """
    solver = (Settings() if settings is None else settings).solver
    samples = patterns.q.shape[0]
    if samples < 2:
        raise ValueError(f"cross-validation of {counted(samples, 'sample')}; expected at least 2")
    if not 2 <= folds <= samples:
        raise ValueError(f"{folds} folds of {samples} samples; expected 2 to {samples} folds")
    columns = columns_of(network, patterns)
    torque, mask = np.asarray(patterns.torque), np.asarray(patterns.mask)
    fold = fold_numbers(samples, folds)
    held_out = solver.held_out_errors(network, patterns, fold, columns)
    if fit is None:
        fit = dataclasses.replace(solver, errors="independent").fit(network, patterns)
    training = torque - torque_by(network.support, columns, np.asarray(fit.k))
    return judged_errors(
        *(training, mask, held_out, mask, int(fit.rank)),
        network=network,
        source="cross-validation",
    )


def fold_numbers(samples: int, folds: int = FOLDS) -> Int[np.ndarray, " samples"]:
    """Return the number of each sample's stretch, from 0."""
    return np.arange(samples) * folds // samples


def unlike_halves(
    patterns: Patterns, moving: Bool[np.ndarray, "samples joints"]
) -> tuple[Int[np.ndarray, " samples"], Int[np.ndarray, " samples"]]:
    """Return two divisions into halves: slow and fast motion, positions near the middle and far.

    Fits to one half show what they say of motion unlike their own. Speeds and distances are those
    of all joints together, in parts of each joint's RMS.

    - `moving`: pairs of which the halves are alike in number.
    """
    divided: list[np.ndarray] = []
    for values in (np.asarray(patterns.qd), np.asarray(patterns.q)):
        about = values - (np.mean(values, axis=0) if divided else 0.0)
        size = np.sqrt(np.mean(about**2, axis=0))
        squares = np.sum((about / np.where(size > 0.0, size, 1.0)) ** 2, axis=1)
        some = np.any(moving, axis=1)
        divided.append((squares > np.median(squares[some] if some.any() else squares)).astype(int))
    return divided[0], divided[1]


def judged_errors(
    training: np.ndarray,
    training_mask: np.ndarray,
    held_out: np.ndarray,
    held_out_mask: np.ndarray,
    rank: int,
    *,
    network: AbstractLinearNetwork | None = None,
    source: Source = "validation",
) -> HeldOut:
    """Return the RMS of errors (samples, n) of both kinds over the pairs of their masks, and its
    limit.

    - `rank`: of the fit.
    - `network`: names and units of joints are its; `source`: of the held-out errors.
    """
    training_error, training_worth = _root_mean_square(training, training_mask)
    held_out_rms, held_out_worth = _root_mean_square(held_out, held_out_mask)
    share = min(rank / max(float(training_worth.sum()), 1.0), 0.9)
    degrees_of_freedom = np.maximum(training_worth * (1.0 - share), 1.0)
    chance = scipy.special.fdtri(np.maximum(held_out_worth, 1.0), degrees_of_freedom, 1.0 - CHANCE)
    limit = np.sqrt(chance * (1.0 + share) / (1.0 - share))
    units = None if network is None else network.output_units
    names = None if network is None else network.output_names
    return HeldOut(training_error, held_out_rms, limit, source, units, names)


@dataclasses.dataclass(frozen=True)
class RelativeError:
    """RMS errors of one set of coefficients over those of another, on the same parts of motion.

    **Attributes**

    - `change`: mean over parts and joints of the logarithm of the ratio; -0.1 is an error that is
      a tenth smaller.
    - `change_error`: its standard error, from its spread over the parts; infinite for one part.
    - `parts`: how many.

    >>> import numpy as np
    >>> parts = [np.ones((50, 2)), 1.1 * np.ones((50, 2)), 0.9 * np.ones((50, 2))]
    >>> masks = [np.ones((50, 2), bool)] * 3
    >>> smaller = RelativeError.of([0.8 * errors for errors in parts], parts, masks)
    >>> round(smaller.change, 3), smaller.beyond_chance()
    (-0.223, True)
    """

    change: float
    change_error: float
    parts: int

    @classmethod
    def of(
        cls,
        errors: Sequence[np.ndarray],
        reference: Sequence[np.ndarray],
        masks: Sequence[np.ndarray],
    ) -> "RelativeError":
        """Compare errors with reference errors, by parts; arrays are (samples, n) per part."""
        logarithms: list[float] = []
        for error, other, mask in zip(errors, reference, masks, strict=True):
            squares = (
                np.sum(np.where(mask, values, 0.0) ** 2, axis=0) for values in (error, other)
            )
            ours, theirs = squares
            both = (ours > 0.0) & (theirs > 0.0)  # a joint that was nowhere judged has neither
            if both.any():
                logarithms.append(float(np.mean(0.5 * np.log(ours[both] / theirs[both]))))
        if len(logarithms) < 2:
            return cls(0.0, np.inf, len(errors))
        spread = float(np.std(logarithms, ddof=1) / np.sqrt(len(logarithms)))
        return cls(float(np.mean(logarithms)), spread, len(errors))

    @classmethod
    def of_joint(
        cls,
        errors: Float[np.ndarray, "samples joints"],
        reference: Float[np.ndarray, "samples joints"],
        mask: Bool[np.ndarray, "samples joints"],
        fold: Int[np.ndarray, " samples"],
        joint: int,
    ) -> "RelativeError":
        """Compare the errors of one joint, with the folds as parts.

        - `errors`, `reference`: those compared, and what counts: `mask`; (samples, n).
        - `fold`: the fold of each sample, numbered from 0.
        - `joint`: counted from 1.
        """
        column = slice(joint - 1, joint)
        return cls.of(
            *(
                [values[fold == number, column] for number in range(int(np.max(fold)) + 1)]
                for values in (errors, reference, mask)
            )
        )

    def beyond_chance(self, chance: float = 0.05) -> bool:
        """Return whether errors are smaller by at least 1 %, and by more than chance explains.

        - `chance`: the part of such gains that is chance (Student's t, one-sided).
        """
        if self.parts < 2:
            return False
        limit = self.change + scipy.special.stdtrit(self.parts - 1, 1 - chance) * self.change_error
        return bool(limit < 0.0 and self.change < np.log1p(-_LEAST_GAIN))

    def __str__(self) -> str:
        return f"{100 * np.expm1(self.change):+.2g} % ± {100 * self.change_error:.2g} %"


def _root_mean_square(
    error: np.ndarray, mask: np.ndarray
) -> tuple[Float[np.ndarray, " joints"], Float[np.ndarray, " joints"]]:
    """Return the RMS of each joint's errors that count, NaN of none.

    The second result is how many independent errors they are worth.
    """
    counts = mask.astype(float)
    kept = np.where(mask, error, 0.0)
    number = counts.sum(axis=0)
    square = (kept**2).sum(axis=0) / np.where(number > 0, number, np.nan)
    return np.sqrt(square), np.asarray(effective_counts(kept, counts))


# Without a validation recording, this part of each recording, its last, is held out.
_HELD_OUT = 0.25
# A recording of fewer samples is not divided.
FEWEST_SAMPLES = 400


def held_out_from(recording: Recording) -> float:
    """Return the instant at which the part of a recording that is held out begins [s]."""
    start, end = float(recording.time[0]), float(recording.time[-1])
    return end - _HELD_OUT * (end - start)
