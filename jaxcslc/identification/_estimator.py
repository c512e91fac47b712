"""Estimators: objects that turn a problem into coefficients and declare their limits.

A new estimator is a file beside this one with a subclass of `AbstractEstimator`, and its line in
`ESTIMATORS` (`__init__.py`). `fit` is enough: by default its fit is judged on the last part of each
recording, predicted by a fit to what is before it, or on the validation recording. Its systematic
error includes faults that stay possible (`with_possible_faults`).
"""

import abc
import contextlib
import dataclasses
from collections.abc import Callable, Generator, Mapping, Sequence
from typing import Any

import numpy as np
from jaxtyping import Array, Float

from ..bodies import ChosenPrior, FilePrior
from ..friction import along_motion
from ..least_squares import Fixed, Identification, Settings, torque_of
from ..likelihood import LikelihoodFit, Misfit
from ..network import CSLC
from ..recordings import Patterns, Recording
from ..uncertainty import (
    Estimate,
    HeldOut,
    SeveralFit,
    Source,
    SystematicError,
    held_out_from,
    judged_errors,
    possible_faults,
)
from ._exclusions import Request
from ._problem import PreparedRecording, Problem, joined


@dataclasses.dataclass(frozen=True, eq=False)
class Fit:
    """Coefficients of an estimator.

    - `network`: that they are of, with slopes of static friction.
    - `identification`: their values and covariance, without what is known beforehand.
    - `presliding_distance`: (n,) [rad or m]; 0 where dry friction follows the sign of velocity.
    - `source`: what the estimator says beyond that, as its own kind of result.
    - `warnings`, `notes`: one sentence each.
    """

    network: CSLC
    identification: Identification
    presliding_distance: Float[np.ndarray, " joints"]
    source: SeveralFit | LikelihoodFit | None = None
    warnings: tuple[str, ...] = ()
    notes: tuple[str, ...] = ()

    @property
    def k(self) -> Float[Array, " coefficients"]:
        """The coefficients, (p,)."""
        return self.identification.k


@dataclasses.dataclass(frozen=True, eq=False)
class Judged:
    """A fit, and how it predicts motion that was not fitted.

    - `problem`: whose patterns and settings the errors are of.
    - `fit`: with the coefficients to report: prior knowledge and physical consistency included.
    - `held_out`: errors on motion that was not fitted; None where nothing was judged.
    - `results`: further results of the report, by the names that its sections give them.
    - `vectors`: other coefficients whose errors are reported, by name.
    - `yielding`: the same fit by contacts that yield before they slide, beside `fit`; None without.
    - `warnings`: about what was fitted; `consequences`: about errors and bodies.
    """

    problem: Problem
    fit: Fit
    held_out: HeldOut | None
    results: Mapping[str, Any] = dataclasses.field(default_factory=dict[str, Any])
    vectors: Mapping[str, Float[Array | np.ndarray, " coefficients"]] = dataclasses.field(
        default_factory=dict
    )
    yielding: Fit | None = None
    warnings: tuple[str, ...] = ()
    consequences: tuple[str, ...] = ()


Begin = Callable[[Settings], Callable[[], Any]]
"""Begins with fits in another process, by settings of the longest recording; what it returns waits
for them."""


class AbstractEstimator(abc.ABC):
    """Estimator: it turns a problem into coefficients.

    >>> import numpy as np, jaxcslc as jc
    >>> from jaxcslc.identification import ESTIMATORS
    >>> sorted(ESTIMATORS["instrumental-variables"].supports)
    []
    """

    @property
    @abc.abstractmethod
    def supports(self) -> frozenset[str]:
        """Features (`FEATURES`) that it can be combined with; without those of all estimators."""

    @abc.abstractmethod
    def fit(self, problem: Problem) -> Fit:
        """Fit coefficients to the training recordings of a problem.

        **Raises** `ValueError`, `RuntimeError`: recordings that it cannot be fitted to.
        """

    def misfit(self, problem: Problem, fit: Fit, recordings: Sequence[Recording]) -> Misfit:
        """Return how well a fit agrees with recordings, which it may not have seen.

        Torque errors of smoothed motion, over the RMS residuals of the fit.

        - `recordings`: with torques as recorded.
        """
        patterns = joined([problem.settings.patterns(recording) for recording in recordings])
        torque = residual(fit, patterns)
        level = np.asarray(fit.identification.torque_error)
        return Misfit(torque / level, torque, np.asarray(patterns.mask))

    def judged(self, problem: Problem) -> Judged:
        """Fit a problem, and judge the fit on motion that it has not seen.

        That is the validation recording or, without one, the last part of each training recording.
        """
        fit = self.fit(problem)
        informed = problem.informed(fit.identification)
        informed = dataclasses.replace(fit, identification=informed)
        if problem.validation is None:
            problem.step("judging the fit")
            held_out = self._held_out(problem, informed)
        else:
            held_out = held_out_of(problem, informed)
        problem.step("computing errors")
        return Judged(
            problem,
            informed,
            held_out,
            warnings=problem.warnings,
            consequences=fit.warnings,
        )

    def _held_out(self, problem: Problem, fit: Fit) -> HeldOut:
        """Errors on the last part of each training recording, of a fit to what is before it."""
        earlier, late = split_recordings(problem)
        known = problem.informed(self.fit(earlier).identification)
        unseen = residual(dataclasses.replace(fit, identification=known), late)
        return held_out_of(problem, fit, "held-out stretch", unseen, np.asarray(late.mask))

    @contextlib.contextmanager
    def beside(self, request: Request) -> Generator[Begin | None]:
        """Give fits that need nothing but settings to another process; None where none do.

        Entered before other work of this process begins.
        """
        del request
        yield None


def split_recordings(problem: Problem) -> tuple[Problem, Patterns]:
    """Return a problem of what is before the last part of each recording, and those last parts."""
    earlier: dict[str, PreparedRecording] = {}
    late: list[Patterns] = []
    for name, prepared in problem.recordings.items():
        recording, split = prepared.recording, held_out_from(prepared.recording)
        before = recording.between(0.0, split - float(recording.time[0]))
        earlier[name] = dataclasses.replace(prepared, recording=before, motion=None)
        late.append(prepared.patterns.between(split, float(recording.time[-1])))
    problem = dataclasses.replace(problem, recordings=earlier, part=None, slopes=None, load=None)
    return problem, joined(late)


def residual(
    fit: Fit, patterns: Patterns, start: Float[np.ndarray, " joints"] | None = None
) -> Float[np.ndarray, "samples joints"]:
    """Return what a fit leaves of the torque of patterns [N m or N].

    - `start`: (n,) states of dry friction at the first sample; zeros if None.
    """
    network = along_motion(fit.network, patterns, fit.presliding_distance, start)
    return np.asarray(patterns.torque) - torque_of(network, patterns, fit.k)


def held_out_of(
    problem: Problem,
    fit: Fit,
    source: Source = "validation",
    error: Float[np.ndarray, "samples joints"] | None = None,
    mask: np.ndarray | None = None,
) -> HeldOut:
    """Return torque errors of motion that was not fitted, beside those of the training recordings.

    - `error`, `mask`: of that motion and what counts; of the validation recording if None.
    """
    training = problem.patterns["training"]
    if error is None or mask is None:
        validation = problem.patterns["validation"]
        error, mask = residual(fit, validation), np.asarray(validation.mask)
    return judged_errors(
        *(residual(fit, training), np.asarray(training.mask), error, mask),
        int(fit.identification.rank),
        network=fit.network,
        source=source,
    )


# Singular values of scaled covariances that count: coefficients of one body may be proportional.
_ROUNDING = 1e-10


def with_possible_faults(
    problem: Problem,
    network: CSLC,
    fit: Identification,
    systematic: SystematicError | None,
    unconstrained: Identification,
    file: ChosenPrior | None,
) -> SystematicError | None:
    """Add the errors by faults within tolerances to a fit's systematic error, if there is one.

    - `network`, `fit`: that the report has.
    - `unconstrained`: without the prior of the robot's `file`.
    """
    if systematic is None:
        return None
    k, groups = np.asarray(fit.k), problem.request.groups
    free = np.asarray(fit.determined).copy()
    free[[i for i, entry in problem.known.items() if entry.fixed]] = False
    if groups is not None:
        fitted = np.zeros(network.size, bool)
        fitted[list(Fixed.except_for(network, k, groups).free)] = True
        free &= fitted
    scale, follow = Estimate(), None
    if file is not None:
        scale = torque_scale(file.prior, unconstrained)
        follow = file.prior.data_share(unconstrained)
    faults = possible_faults(
        network, problem.patterns["training"], k, free, scale=scale, follow=follow
    )
    parts = {cause: np.where(free, part, 0.0) for cause, part in faults.parts.items()}
    return SystematicError({**systematic.parts, **parts}, faults.within)


def torque_scale(prior: FilePrior, fit: Identification) -> Estimate:
    """Return what a robot's file says of the factor of all torques, less 1.

    A fit's inertial coefficients are the file's times the factor, within the errors of both
    (generalised least squares).

    - `fit`: without the prior.
    """
    known = np.flatnonzero(prior.inertial & np.asarray(fit.determined))
    covariance = (np.asarray(fit.covariance) + prior.covariance)[np.ix_(known, known)]
    sizes = np.sqrt(np.maximum(np.diag(covariance), np.finfo(float).tiny))
    inverse = np.linalg.pinv(covariance / np.outer(sizes, sizes), _ROUNDING, hermitian=True)
    file, fitted = prior.mean[known] / sizes, np.asarray(fit.k)[known] / sizes
    information = float(file @ inverse @ file)
    if not information > 0.0:
        return Estimate()
    return Estimate(float(file @ inverse @ fitted) / information - 1.0, information**-0.5)
