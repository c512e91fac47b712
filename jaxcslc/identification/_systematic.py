import dataclasses
from collections.abc import Mapping, Sequence
from types import MappingProxyType

import numpy as np
import scipy
from jaxtyping import Bool, Float

from ..motion import CubicSpline, Patterns, Preparation, Recording
from ..network import CSLC
from ._missing_terms import (
    Columns,
    filtered_inputs,
    missing_terms,
    part_of,
    with_columns,
)
from ._settings import Settings
from .solver import (
    Fixed,
    Identification,
    WeightedEquations,
    changes_of,
    fold_coefficients,
    torque_of,
)


# Stretches of the recording that are left out in turn, for the noise of a shift.
_STRETCHES = 8


@dataclasses.dataclass(frozen=True)
class SystematicError:
    """Errors of a fit that are the same in every recording of a motion: no residual shows them.

    **Attributes**

    - `parts`: by cause, the size of each coefficient's error, (p,), 0 or more; see
      `systematic_error`.

    >>> import numpy as np
    >>> from jaxcslc.identification import SystematicError
    >>> error = SystematicError({"smoothing": np.array([3.0]), "torque offset": np.array([4.0])})
    >>> error.total.tolist(), error.main_cause(0)
    ([5.0], 'torque offset')
    """

    parts: Mapping[str, Float[np.ndarray, " coefficients"]]

    @property
    def total(self) -> Float[np.ndarray, " coefficients"]:
        """The root of the sum of the squares of all parts, (p,)."""
        return np.sqrt(np.sum([part**2 for part in self.parts.values()], axis=0))

    def without(self, indices: Sequence[int]) -> "SystematicError":
        """The same without the errors of some coefficients, such as fixed ones."""
        free = np.ones(len(self.total), bool)
        free[list(indices)] = False
        return SystematicError({cause: part * free for cause, part in self.parts.items()})

    def main_cause(self, index: int) -> str:
        """The cause of the largest part of a coefficient's error."""
        return max(self.parts, key=lambda cause: float(self.parts[cause][index]))


def standard_uncertainty(
    fit: Identification, systematic: SystematicError | None
) -> Float[np.ndarray, " coefficients"]:
    """Standard error and systematic error of each coefficient together, (p,), in its unit.

    The root of the sum of their squares, as the Guide to the Expression of Uncertainty in
    Measurement (JCGM 100:2008, 5.1) combines uncertainties of independent causes.

    **Arguments**

    - `fit`: p coefficients.
    - `systematic`: of the fit; the standard error alone if None.

    >>> import numpy as np, jaxcslc as jc
    >>> from jaxcslc.identification import SystematicError, standard_uncertainty
    >>> pendulum = jc.Manipulator.from_modified_dh([(0, 0, 0, 0)], gravity=(0, 0, -9.81))
    >>> network = jc.derive(pendulum.with_friction(), lengths="numeric")
    >>> t = np.linspace(0, 5, 500)[:, None]
    >>> motion, pairs = (np.sin(t), np.cos(t), -np.sin(t)), np.ones(t.shape, bool)
    >>> torque = -0.5 * np.sin(t) + 0.01 * np.random.default_rng(0).normal(size=t.shape)
    >>> fit = jc.LeastSquares().fit(network, jc.Patterns(t[:, 0], *motion, torque, pairs, pairs))
    >>> systematic = SystematicError({"smoothing": np.array([0.003])})
    >>> np.round(standard_uncertainty(fit, systematic), 4).tolist()
    [0.0031]
    """
    error = np.asarray(fit.standard_error)
    return error if systematic is None else np.sqrt(error**2 + systematic.total**2)


def uncertainty_interval(
    fit: Identification, systematic: SystematicError | None = None, level: float = 0.95
) -> Float[np.ndarray, "coefficients 2"]:
    """Lower and upper end of each coefficient's interval, systematic error included, (p, 2).

    Without a systematic error the intervals of `Identification.confidence_interval`; with one,
    wider by the factor by which `standard_uncertainty` exceeds the standard error.

    **Arguments**

    - `fit`: p coefficients.
    - `systematic`: of the fit.
    - `level`: as of `Identification.confidence_interval`.

    **Raises**

    - `ValueError`: a level that is not between 0 and 1.

    >>> import numpy as np, jaxcslc as jc
    >>> from jaxcslc.identification import SystematicError, uncertainty_interval
    >>> arm = jc.Manipulator.from_modified_dh([(0, 0, 0, 0)], gravity=(0, 0, -9.81))
    >>> network = jc.derive(arm, lengths="numeric")
    >>> t = np.linspace(0, 5, 500)[:, None]
    >>> motion, pairs = (np.sin(t), np.cos(t), -np.sin(t)), np.ones(t.shape, bool)
    >>> torque = np.asarray(network.torque(np.array([0.5, 2.0, 1.0]), *motion))
    >>> fit = jc.LeastSquares().fit(network, jc.Patterns(t[:, 0], *motion, torque, pairs, pairs))
    >>> shifted = SystematicError({"smoothing": np.array([0.01, 0.0, 0.0])})
    >>> bool(np.diff(uncertainty_interval(fit, shifted)[0])[0] > 0.02)
    True
    """
    interval = fit.confidence_interval(level)
    if systematic is None:
        return interval
    quantile = float(scipy.special.stdtrit(float(fit.degrees_of_freedom), 0.5 + 0.5 * level))
    half = quantile * standard_uncertainty(fit, systematic)
    k = np.asarray(fit.k)
    return np.stack([k - half, k + half], axis=-1)


def systematic_error(
    network: CSLC,
    recording: Recording,
    settings: Settings,
    fit: Identification,
    *,
    groups: Sequence[str] | None = None,
) -> SystematicError:
    """What smoothing, timing and missing terms may do to the coefficients of a fit.

    Standard errors allow for noise, which averages out. Three kinds of errors do not:

    - **Smoothing.** What smoothing and filter take out of the motion is the same in every
      recording. The smoothed positions are taken for true ones, the network computes the
      torque of their motion with the fit's coefficients, and both go through smoothing, masks
      and filter once more. The part is the difference of the coefficients that are then fitted
      from those that made the torque. (Motion that the first smoothing has removed altogether,
      it does not see.)
    - **Torque timing.** The torque of a sample may be half a sample late or early: alignments are
      half a sample apart, and other terms make up for a wrong one (a late inertia torque is
      viscous friction). The part is what the coefficients change by if the torque of the smoothed
      motion comes half a sample late, divided by √3: any delay up to that is as likely (JCGM
      100:2008, 4.3.7).
    - **Missing terms.** Each of `"torque offset"`, `"static friction"` and `"motor saturation"`
      that joints of the network lack is added to the fit, for all these joints together. What it
      changes the coefficients by is their bias if the machine has such a term (of which Section
      7.2 of the thesis warns). Leaving out each eighth of the recording in turn shows the noise
      of the term's coefficients (the jackknife), and so of this change, whose variance is taken
      off its square: a term that the recording does not show makes no part.

    **Arguments**

    - `network`: n joints, p coefficients, with the slopes of static friction that were fitted.
    - `recording`: that was fitted.
    - `settings`: of the fit. Robust losses keep the weights of its equations.
    - `fit`: of all coefficients or of `groups`.
    - `groups`: groups or names of the coefficients that were fitted; all if None. The others have
      no systematic error: it is part of the identification that they are from.

    **Returns** a `SystematicError`; 0 for coefficients that are not determined.

    **Raises**

    - `ValueError`: a recording that the settings cannot be used for, or groups that are not the
      network's.

    >>> import numpy as np, jaxcslc as jc
    >>> from jaxcslc.identification import systematic_error
    >>> arm = jc.Manipulator.from_modified_dh([(0, 0, 0, 0)], gravity=(0, 0, -9.81))
    >>> network = jc.derive(arm, lengths="numeric")
    >>> t = np.arange(1000)[:, None] * 0.01
    >>> q, qd, qdd = np.sin(3 * t), 3 * np.cos(3 * t), -9 * np.sin(3 * t)
    >>> torque = np.asarray(network.torque(np.array([0.5, 2.0, 1.0]), q, qd, qdd))
    >>> recording = jc.Recording(t[:, 0], q, torque + 0.3)  # an offset that the network lacks
    >>> settings = jc.Settings(jc.Preparation(jc.Butterworth(2.0)))
    >>> fit = settings.fit(network, settings.patterns(recording))
    >>> tuple(systematic_error(network, recording, settings, fit).parts)
    ('smoothing', 'torque timing', 'torque offset', 'static friction', 'motor saturation')
    """
    k, determined = np.asarray(fit.k), np.asarray(fit.determined)
    return systematic_error_of(network, recording, settings, k, determined, groups)


def systematic_error_of(
    network: CSLC,
    recording: Recording,
    settings: Settings,
    k: Float[np.ndarray, " coefficients"],
    determined: Bool[np.ndarray, " coefficients"],
    groups: Sequence[str] | None,
) -> SystematicError:
    """That of `systematic_error`, of a fit's coefficients and which of them are determined."""
    preparation, solver = settings.preparation, settings.solver
    free = tuple(range(network.size))
    if groups is not None:
        free = Fixed.except_for(network, k, groups).free
    patterns, smoothed = _twice_smoothed(network, recording, preparation, k)
    equations, again = (
        part_of(solver.equations(network, some), free, k) for some in (patterns, smoothed)
    )
    problem = WeightedEquations.of(equations, k[list(free)], solver)
    shifts = {"smoothing": problem.solution(again).k - k[list(free)]}
    torque = np.asarray(smoothed.torque)
    half_a_sample = 0.5 * np.diff(torque, axis=0, prepend=torque[:1])  # of `"mean"` alignment
    late = dataclasses.replace(patterns, torque=half_a_sample)
    delayed = part_of(solver.equations(network, late), free, np.zeros_like(k))
    shifts["torque timing"] = problem.solution(delayed).k / np.sqrt(3.0)
    qd, mask = np.asarray(patterns.qd), np.asarray(patterns.mask)
    thresholds = preparation.speed_thresholds(qd)
    terms = missing_terms(network, qd, np.asarray(smoothed.torque), mask, thresholds)
    for cause, inputs in filtered_inputs(terms, patterns, solver.cutoff).items():
        shifts[cause] = _shift(problem, inputs, len(patterns.q))
    parts: dict[str, np.ndarray] = {}
    for cause, shift in shifts.items():
        whole = np.zeros(network.size)
        whole[list(free)] = np.abs(shift)
        parts[cause] = np.where(determined, whole, 0.0)
    return SystematicError(MappingProxyType(parts))


def _twice_smoothed(
    network: CSLC,
    recording: Recording,
    preparation: Preparation,
    k: Float[np.ndarray, " coefficients"],
) -> tuple[Patterns, Patterns]:
    """The patterns of a recording, and those of their own motion with the torque that the network
    computes for it."""
    q, qd, qdd = derivatives = preparation.derivatives(recording)
    patterns = preparation.patterns(recording, derivatives)
    everything = np.ones(q.shape, bool)
    qd, qdd = _exact_derivatives(recording.time, q, qd, preparation.velocity == "recorded")
    whole = Patterns(recording.time, q, qd, qdd, recording.torque, everything, everything)
    torque = torque_of(network, whole, k)
    motion = Recording(recording.time, q, torque, velocity=qd)
    again = preparation.derivatives(motion)
    if preparation.smooth_torque:
        torque = preparation.smoothing.low_pass(recording.time, torque)
    trim = preparation.trimmed(recording)
    inside = slice(trim, recording.samples - trim)
    q, qd, qdd, torque = (values[inside] for values in (*again, torque))
    return patterns, dataclasses.replace(patterns, q=q, qd=qd, qdd=qdd, torque=torque)


def _exact_derivatives(
    time: Float[np.ndarray, " samples"],
    q: Float[np.ndarray, "samples joints"],
    qd: Float[np.ndarray, "samples joints"],
    keep_velocity: bool,
) -> tuple[Float[np.ndarray, "samples joints"], Float[np.ndarray, "samples joints"]]:
    """Velocities and accelerations of the cubic splines through smoothed positions.

    Those of a smoothing are not always the derivatives of its positions: a Savitzky-Golay filter
    that leaves a sinusoid's positions alone takes some of its acceleration.

    - `keep_velocity`: the velocities themselves were measured; accelerations are theirs.
    """
    spline = CubicSpline(time, qd if keep_velocity else q)
    moves = np.any(qd != 0.0, axis=0)  # elsewhere rounding, whose sign would be a direction
    if keep_velocity:
        return qd, np.where(moves, spline(time, 1), 0.0)
    return np.where(moves, spline(time, 1), 0.0), np.where(moves, spline(time, 2), 0.0)


def _shift(
    problem: WeightedEquations, inputs: Columns, samples: int
) -> Float[np.ndarray, " unknowns"]:
    """What further unknowns change the others by, beyond the noise of this change.

    Each change is linear in the further unknowns, whose values without each stretch of the
    recording in turn differ by noise alone if the machine has such a term. (The changes
    themselves would differ because the stretches show the term in different ways, too.)

    - `inputs`: of the further unknowns, for each joint's equations.
    - `samples`: of the recording.
    """
    size = problem.equations.unknowns.size
    stretch = np.arange(samples) * min(_STRETCHES, samples) // samples
    wider = with_columns(problem.equations, inputs)
    # One factorisation of each stretch: the others' triangles are joined.
    stretches = problem.factors_of_folds(wider, stretch)
    solution = problem.minimum(wider.unknowns, stretches.joined_folds())
    determined = np.asarray(solution.determined)[size:]
    if not np.all(determined):  # such as an offset where a joint moves one way only
        ends = np.cumsum([columns.shape[1] for columns in inputs])[:-1]
        parts = np.split(determined, ends)
        inputs = [columns[:, kept] for columns, kept in zip(inputs, parts, strict=True)]
        wider = with_columns(problem.equations, inputs)
        stretches = problem.factors_of_folds(wider, stretch)
    whole = stretches.joined_folds()
    k = problem.minimum(wider.unknowns, whole).k[size:]
    without = fold_coefficients(
        wider.unknowns, stretches, tuple(problem.weights.tolist()), problem.rcond
    )[:, size:]
    change = changes_of(np.asarray(whole.stacked(wider.unknowns, problem.weights)), size)
    number = len(without)
    spread = np.sum(((without - np.mean(without, axis=0)) @ change.T) ** 2, axis=0)
    return np.sqrt(np.maximum((change @ k) ** 2 - (number - 1) / number * spread, 0.0))
