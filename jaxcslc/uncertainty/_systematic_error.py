"""Systematic errors of coefficients, and intervals that include them (thesis 7.2).

They are estimated by smoothing and fitting the smoothed motion once more, by a late torque, and by
terms that the network lacks.
"""

import dataclasses
from collections.abc import Collection, Mapping, Sequence
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
from ..recordings import Derivatives, Patterns, Recording, spline_derivatives
from ._held_out import FOLDS, fold_numbers


# Parts of a joint's greatest torque from which a motor may give less than is demanded.
_BENDS = (0.5, 0.75)
# Static friction decays over the threshold of the masks, or at least over this part of top speed.
_LEAST_DECAY = 0.01
# Friction terms that make a missing term part of the network.
_OFFSET_TERMS = ("offset", "asymmetric_dry")

Columns = list[Float[np.ndarray, "_ _"]]


def missing_terms(
    network: CSLC,
    qd: Float[np.ndarray, "samples joints"],
    torque: Float[np.ndarray, "samples joints"],
    mask: Bool[np.ndarray, "samples joints"],
    thresholds: Float[np.ndarray, " joints"],
) -> dict[str, Columns]:
    """Terms that manipulators often have and a network may lack (thesis, Section 7.2).

    - `"torque offset"`: a constant torque, as of friction that depends on the direction or of
      tilted base axes.
    - `"static friction"`: sgn(qd) exp(-|qd| / threshold), what remains of it beyond the masks.
    - `"motor saturation"`: torque beyond a half and beyond three quarters of a joint's greatest,
      as of motors that then give less than is demanded (7.2.3).

    `torque` is predicted by the network: measured noise would be on both sides of the equations.

    **Returns** by name, the inputs of the term at each joint: (samples, number of inputs); none of
    joints that have a term of the kind.
    """
    top = np.max(np.abs(np.where(mask, qd, 0.0)), axis=0)
    decay = np.maximum(thresholds, _LEAST_DECAY * top)
    decay = np.where(decay > 0.0, decay, 1.0)  # of joints that do not move
    greatest = np.max(np.abs(np.where(mask, torque, 0.0)), axis=0)
    none = np.zeros((len(qd), 0))
    terms: dict[str, Columns] = {"torque offset": [], "static friction": [], "motor saturation": []}
    for joint, friction in enumerate(network.friction_per_joint):
        v, tau = qd[:, joint], torque[:, joint]
        has_offset = any(kind in friction for kind in _OFFSET_TERMS)
        terms["torque offset"].append(none if has_offset else np.ones((len(qd), 1)))
        remaining = np.sign(v) * np.exp(-np.abs(v) / decay[joint])
        terms["static friction"].append(none if "static" in friction else remaining[:, None])
        beyond = [np.maximum(np.abs(tau) - part * greatest[joint], 0.0) for part in _BENDS]
        terms["motor saturation"].append(np.sign(tau)[:, None] * np.stack(beyond, axis=1))
    return terms


def part_of(
    equations: Equations, free: Sequence[int], k: Float[np.ndarray, " coefficients"]
) -> Equations:
    """The equations of some unknowns, the torque of the others at `k` taken off.

    **Arguments**

    - `free`: indices of the unknowns that remain, ascending.
    """
    if len(free) == equations.unknowns.size:
        unknowns = dataclasses.replace(equations.unknowns, rounding=None)
        return dataclasses.replace(equations, unknowns=unknowns)
    names = tuple(equations.unknowns.names[index] for index in free)
    position = {index: number for number, index in enumerate(free)}
    support: list[tuple[int, ...]] = []
    rows: list[np.ndarray] = []
    for old, joint_rows in zip(equations.unknowns.support, equations.rows, strict=True):
        kept = np.array([index in position for index in old], bool)
        fixed = np.array([index for index in old if index not in position], int)
        target = joint_rows[:, -1] - joint_rows[:, :-1][:, ~kept] @ k[fixed]
        rows.append(np.column_stack([joint_rows[:, :-1][:, kept], target]))
        support.append(tuple(position[index] for index in old if index in position))
    return Equations(Unknowns(names, tuple(support)), tuple(rows), equations.sample)


@dataclasses.dataclass(frozen=True)
class SystematicError:
    """Errors of a fit that are the same in every recording of a motion: no residual shows them.

    **Attributes**

    - `parts`: by cause, the size of each coefficient's error, (p,), 0 or more; see
      `systematic_error` and `possible_faults`.
    - `within`: by cause, how large the fault is at most by 95 %, as text, for faults that stay
      possible within tolerances.

    >>> import numpy as np
    >>> from jaxcslc.uncertainty import SystematicError
    >>> error = SystematicError({"smoothing": np.array([3.0]), "torque offset": np.array([4.0])})
    >>> error.total.tolist(), error.main_cause(0)
    ([5.0], 'torque offset')
    """

    parts: Mapping[str, Float[np.ndarray, " coefficients"]]
    within: Mapping[str, str] = dataclasses.field(default_factory=dict[str, str])

    @property
    def total(self) -> Float[np.ndarray, " coefficients"]:
        """The root of the sum of the squares of all parts, (p,)."""
        return np.sqrt(np.sum([part**2 for part in self.parts.values()], axis=0))

    def without(self, indices: Sequence[int]) -> "SystematicError":
        """Remove the errors of some coefficients, such as fixed ones."""
        free = np.ones(len(self.total), bool)
        free[list(indices)] = False
        parts = {cause: part * free for cause, part in self.parts.items()}
        return SystematicError(parts, self.within)

    def without_causes(self, causes: Collection[str]) -> "SystematicError":
        """Remove causes, such as those that two recordings share."""
        kept = {cause: part for cause, part in self.parts.items() if cause not in causes}
        return SystematicError(kept)

    @property
    def description(self) -> str:
        """The causes, those within tolerances with their sizes."""
        return ", ".join(f"{cause} {self.within.get(cause, '')}".strip() for cause in self.parts)

    def main_cause(self, index: int) -> str:
        """Return the cause of the largest part of a coefficient's error."""
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
    >>> from jaxcslc.uncertainty import SystematicError, standard_uncertainty
    >>> network = jc.derive(jc.examples.turntable("viscous"))
    >>> fit = jc.LeastSquares().fit(network, jc.examples.swing(network, [0.5, 0.2]))  # exact
    >>> systematic = SystematicError({"smoothing": np.array([0.003, 0.0])})
    >>> standard_uncertainty(fit, systematic).round(4).tolist()
    [0.003, 0.0]
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
    >>> from jaxcslc.uncertainty import SystematicError, uncertainty_interval
    >>> network = jc.derive(jc.examples.turntable("viscous"))
    >>> fit = jc.LeastSquares().fit(network, jc.examples.swing(network, [0.5, 0.2]))  # exact
    >>> systematic = SystematicError({"smoothing": np.array([0.01, 0.0])})
    >>> uncertainty_interval(fit, systematic).round(2).tolist()
    [[0.48, 0.52], [0.2, 0.2]]
    """
    if systematic is None:
        return fit.confidence_interval(level)
    return fit.interval_of(fit.k, standard_uncertainty(fit, systematic), level)


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
      half a sample apart, and other terms absorb a wrong one (a late inertia torque is
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

    >>> import jaxcslc as jc
    >>> from jaxcslc.uncertainty import systematic_error
    >>> network = jc.derive(jc.examples.turntable())
    >>> recording = jc.examples.swing_recording(network, [0.5, 2.0, 1.0])
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
        follow: Float[np.ndarray, "coefficients coefficients"] | None = None,
    ) -> SystematicError:
        """Return the systematic errors of a fit.

        - `k`: its coefficients; `determined`: which of them are.
        - `groups`: as of `systematic_error`.
        - `follow`: changes of the coefficients by those of a fit without prior knowledge; equal to
          them if None.
        """
        network, patterns = self.network, self.patterns
        preparation, solver = self.settings.preparation, self.settings.solver
        free = tuple(range(network.size))
        if groups is not None:
            free = Fixed.except_for(network, k, groups).free
        torque = self._torque(k)
        problem = WeightedEquations.of(part_of(self.equations, free, k), k[list(free)], solver)
        again = part_of(self.smoothed_again(k), free, k)
        shifts = {"smoothing": problem.solution(again).k - k[list(free)]}
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
            every[list(free)] = shift
            every = every if follow is None else follow @ every
            parts[cause] = np.where(determined, np.abs(every), 0.0)
        return SystematicError(MappingProxyType(parts))

    def smoothed_again(self, k: Float[np.ndarray, " coefficients"]) -> Equations:
        """Return the equations of the smoothed motion, smoothed once more, and of its torque."""
        return self.again.with_torque(self._torque(k), self.patterns, self.settings.solver.cutoff)

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


def smoothing_bias(
    problems: Sequence[SystematicProblem], k: Float[np.ndarray, " coefficients"]
) -> Float[np.ndarray, " coefficients"]:
    """Return the change of a fit to all recordings by smoothing their motion once more.

    It is signed; `systematic_error` has the size, where the fit determines it.

    - `problems`: one per recording; `k`: of the fit.
    """
    free = tuple(range(len(k)))
    before = _together([part_of(some.equations, free, k) for some in problems])
    again = _together([part_of(some.smoothed_again(k), free, k) for some in problems])
    return WeightedEquations.of(before, k, problems[0].settings.solver).solution(again).k - k


def _together(parts: Sequence[Equations]) -> Equations:
    """Return the equations of several recordings as those of one, samples of all numbered."""
    if len(parts) == 1:
        return parts[0]
    rows = (np.concatenate(some) for some in zip(*(part.rows for part in parts), strict=True))
    samples = zip(*(part.sample for part in parts), strict=True)
    return Equations(parts[0].unknowns, tuple(rows), tuple(map(np.concatenate, samples)))


def _exact_derivatives(
    time: Float[np.ndarray, " samples"],
    q: Float[np.ndarray, "samples joints"],
    qd: Float[np.ndarray, "samples joints"],
    keep_velocity: bool,
) -> tuple[Float[np.ndarray, "samples joints"], Float[np.ndarray, "samples joints"]]:
    """Velocities and accelerations of the cubic splines through smoothed positions.

    Those of a smoothing are not always the derivatives of its positions. With `keep_velocity`,
    velocities were measured, and accelerations are theirs.
    """
    first, second = spline_derivatives(time, qd if keep_velocity else q)
    moves = np.any(qd != 0.0, axis=0)  # elsewhere rounding, whose sign would be a direction
    if keep_velocity:
        return qd, np.where(moves, first, 0.0)
    return np.where(moves, first, 0.0), np.where(moves, second, 0.0)


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
    stretch = fold_numbers(samples, min(FOLDS, samples))
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
