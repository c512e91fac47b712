"""Estimate of systematic errors by smoothing, torque timing and missing terms.

The smoothed motion is smoothed and fitted once more. The result is a `SystematicError`.
"""

import dataclasses
from collections.abc import Mapping, Sequence
from types import MappingProxyType

import numpy as np
from jaxtyping import Bool, Float, Int

from ..least_squares import (
    Equations,
    Fixed,
    HostColumns,
    Identification,
    JointFactors,
    Settings,
    Unknowns,
    WeightedEquations,
    changes_of,
    columns_of,
    computed_on_host,
    fold_coefficients,
    torque_by,
    torque_of,
)
from ..network import CSLC
from ..recordings import Derivatives, Patterns, Recording
from ._systematic_error import Columns, SystematicError, missing_terms, part_of


# Stretches of the recording that are left out in turn, for the noise of a shift.
_STRETCHES = 8


def systematic_error(
    network: CSLC,
    recording: Recording,
    settings: Settings,
    fit: Identification,
    *,
    groups: Sequence[str] | None = None,
) -> SystematicError:
    """Estimate the errors of a fit's coefficients by smoothing, timing and missing terms.

    Standard errors allow for noise, which averages out. Three kinds of errors do not:

    - **Smoothing.** What smoothing and filter take out of the motion is the same in every
      recording. The smoothed positions are taken for true ones, the network computes the
      torque of their motion with the fit's coefficients, and both go through smoothing, masks
      and filter once more. What the smoothing estimates from positions, such as the noise that
      hides reversals, stays that of the recording. The part is the difference of the coefficients
      that are then fitted from those that made the torque. (Motion that the first smoothing has
      removed altogether, it does not see.)
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
    >>> from jaxcslc.uncertainty import systematic_error
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
    problem = SystematicProblem.of(network, recording, settings)
    return problem.error(np.asarray(fit.k), np.asarray(fit.determined), groups)


@dataclasses.dataclass(frozen=True)
class SystematicProblem:
    """Data that systematic errors of a fit follow from, next to its coefficients.

    **Attributes**

    - `network`, `settings`: of the fit.
    - `patterns`: of the recording; `equations`: theirs.
    - `again`: equations of the smoothed motion, smoothed once more.
    - `whole`: smoothed motion of all samples, whose torque takes the place of the recorded one;
      `columns`: of its regressor, None where that is computed with the torque.
    - `inside`: the samples of `patterns` among all.
    """

    network: CSLC
    settings: Settings
    patterns: Patterns
    equations: Equations
    again: Equations
    whole: Patterns
    columns: HostColumns | None
    inside: slice

    @classmethod
    def of(
        cls,
        network: CSLC,
        recording: Recording,
        settings: Settings,
        derivatives: Derivatives | None = None,
    ) -> "SystematicProblem":
        """Return the problem of a recording.

        - `derivatives`: of its preparation, if they are known already.

        **Raises** `ValueError` for a recording that the settings cannot be used for.
        """
        preparation, solver = settings.preparation, settings.solver
        q, qd, qdd = derivatives = derivatives or preparation.derivatives(recording)
        patterns = preparation.patterns(recording, derivatives)
        everything = np.ones(q.shape, bool)
        qd, qdd = _exact_derivatives(recording.time, q, qd, preparation.velocity == "recorded")
        whole = Patterns(recording.time, q, qd, qdd, recording.torque, everything, everything)
        motion = Recording(recording.time, q, recording.torque, velocity=qd)
        trim = preparation.trimmed(recording)
        inside = slice(trim, recording.samples - trim)
        # Estimates from the smooth motion would be others: no noise hides its slightest reversals.
        settled = preparation.smoothing.settled(recording.position)
        alike = dataclasses.replace(preparation, smoothing=settled)
        smoothed = (values[inside] for values in alike.derivatives(motion))
        q, qd, qdd = smoothed
        on_host = computed_on_host(network, recording.position)
        return cls(
            network,
            settings,
            patterns,
            solver.equations(network, patterns),
            solver.equations(network, dataclasses.replace(patterns, q=q, qd=qd, qdd=qdd)),
            whole,
            columns_of(network, whole) if on_host else None,
            inside,
        )

    def error(
        self,
        k: Float[np.ndarray, " coefficients"],
        determined: Bool[np.ndarray, " coefficients"],
        groups: Sequence[str] | None = None,
    ) -> SystematicError:
        """The systematic errors of a fit.

        - `k`: its coefficients; `determined`: which of them are.
        - `groups`: as of `systematic_error`.
        """
        network, patterns = self.network, self.patterns
        preparation, solver = self.settings.preparation, self.settings.solver
        free = tuple(range(network.size))
        if groups is not None:
            free = Fixed.except_for(network, k, groups).free
        torque = self._torque(k)
        again = self.again.with_torque(torque, patterns, solver.cutoff)
        problem = WeightedEquations.of(part_of(self.equations, free, k), k[list(free)], solver)
        shifts = {"smoothing": problem.solution(part_of(again, free, k)).k - k[list(free)]}
        # Half a sample of `"mean"` alignment.
        late = 0.5 * np.diff(torque, axis=0, prepend=torque[:1])
        late = self.equations.with_torque(late, patterns, solver.cutoff)
        delayed = part_of(late, free, np.zeros_like(k))
        shifts["torque timing"] = problem.solution(delayed).k / np.sqrt(3.0)
        qd = np.asarray(patterns.qd)
        thresholds = preparation.speed_thresholds(qd)
        terms = missing_terms(network, qd, torque, np.asarray(patterns.mask), thresholds)
        inputs = {
            cause: self.equations.inputs(columns, patterns, solver.cutoff)
            for cause, columns in terms.items()
            if any(column.size for column in columns)
        }
        shifts |= _shifts(problem, inputs, len(patterns.q))
        parts: dict[str, np.ndarray] = {}
        for cause, shift in shifts.items():
            every = np.zeros(network.size)
            every[list(free)] = np.abs(shift)
            parts[cause] = np.where(determined, every, 0.0)
        return SystematicError(MappingProxyType(parts))

    def _torque(self, k: Float[np.ndarray, " coefficients"]) -> Float[np.ndarray, "samples joints"]:
        """Return the torque that coefficients predict for the smoothed motion.

        It takes the place of the recorded torque in the patterns.
        """
        if self.columns is None:
            torque = torque_of(self.network, self.whole, k)
        else:
            torque = torque_by(self.network.support, self.columns, k)
        preparation = self.settings.preparation
        if preparation.smooth_torque:
            torque = preparation.smoothing.low_pass(np.asarray(self.whole.time), torque)
        return torque[self.inside]


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
    from scipy.interpolate import CubicSpline  # 0.09 s of processor time

    spline = CubicSpline(time, qd if keep_velocity else q)
    moves = np.any(qd != 0.0, axis=0)  # elsewhere rounding, whose sign would be a direction
    if keep_velocity:
        return qd, np.where(moves, spline(time, 1), 0.0)
    return np.where(moves, spline(time, 1), 0.0), np.where(moves, spline(time, 2), 0.0)


def _shifts(
    problem: WeightedEquations, inputs: Mapping[str, Columns], samples: int
) -> dict[str, Float[np.ndarray, " unknowns"]]:
    """Return the changes of unknowns by further ones, beyond the noise of the changes.

    Each change is linear in the further unknowns, whose values without each stretch of the
    recording in turn differ by noise alone if the machine has such a term. (The changes
    themselves would differ because the stretches show the term in different ways, too.)

    - `inputs`: by cause, of the further unknowns, for each joint's equations.
    - `samples`: of the recording.
    """
    if not inputs:
        return {}
    stretch = np.arange(samples) * min(_STRETCHES, samples) // samples
    together = [np.concatenate(parts, axis=1) for parts in zip(*inputs.values(), strict=True)]
    # One factorisation of each stretch, of the unknowns of all causes: columns of its triangle
    # stand for those of the equations, and the others' triangles are joined.
    stretches = problem.factors_of_folds(problem.equations.with_columns(together), stretch)
    first = np.zeros(len(together), int)
    shifts: dict[str, np.ndarray] = {}
    for cause, columns in inputs.items():
        counts = np.array([column.shape[1] for column in columns])
        kept = [np.arange(count) + start for count, start in zip(counts, first, strict=True)]
        shifts[cause] = _shift(problem, stretches, kept)
        first += counts
    return shifts


def _shift(
    problem: WeightedEquations, stretches: JointFactors, inputs: Sequence[Int[np.ndarray, " _"]]
) -> Float[np.ndarray, " unknowns"]:
    """The change by some of the further unknowns.

    - `stretches`: of all unknowns, further ones behind the others, with a leading axis of
      stretches.
    - `inputs`: which of them, for each joint.
    """
    size = problem.equations.unknowns.size
    unknowns, some = _with_inputs(problem, stretches, inputs)
    determined = np.asarray(problem.minimum(unknowns, some.joined_folds()).determined)[size:]
    if not np.all(determined):  # such as an offset where a joint moves one way only
        ends = np.cumsum([len(columns) for columns in inputs])[:-1]
        parts = np.split(determined, ends)
        inputs = [columns[kept] for columns, kept in zip(inputs, parts, strict=True)]
        unknowns, some = _with_inputs(problem, stretches, inputs)
    whole = some.joined_folds()
    k = problem.minimum(unknowns, whole).k[size:]
    without = fold_coefficients(unknowns, some, tuple(problem.weights.tolist()), problem.rcond)[
        :, size:
    ]
    change = changes_of(np.asarray(whole.stacked(unknowns, problem.weights)), size)
    number = len(without)
    spread = np.sum(((without - np.mean(without, axis=0)) @ change.T) ** 2, axis=0)
    return np.sqrt(np.maximum((change @ k) ** 2 - (number - 1) / number * spread, 0.0))


def _with_inputs(
    problem: WeightedEquations, stretches: JointFactors, inputs: Sequence[Int[np.ndarray, " _"]]
) -> tuple[Unknowns, JointFactors]:
    """The unknowns of a problem with some of the further ones, and their factors."""
    unknowns = problem.equations.unknowns
    triangles = tuple(
        triangle[..., [*range(len(support)), *(len(support) + columns), -1]]
        for support, triangle, columns in zip(
            unknowns.support, stretches.triangles, inputs, strict=True
        )
    )
    further = unknowns.with_further([len(columns) for columns in inputs])
    return further, JointFactors(triangles, stretches.counts)
