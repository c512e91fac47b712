"""Estimators by least squares: on smoothed motion, and with instruments of simulated motion."""

import dataclasses
from collections.abc import Mapping
from functools import partial
from typing import Any

import numpy as np
from jaxtyping import Float

from ..bodies import InformedFit, JudgedPart, held_out_of_parts, judged_bodies, with_knowledge
from ..friction import along_motion, checked_distance, linearised
from ..instruments import DirectDynamics, InstrumentalVariables
from ..least_squares import Identification
from ..selection import PRE_SLIDING
from ..uncertainty import (
    HeldOut,
    SeveralFit,
    SystematicError,
    cross_validated_error,
    fit_recordings,
    fold_numbers,
)
from ._estimator import AbstractEstimator, Fit, Judged, held_out_of, with_possible_faults
from ._exclusions import BODIES, LOAD_FRICTION, OFFSETS, PREVIOUS, SEVERAL
from ._problem import Problem


@dataclasses.dataclass(frozen=True)
class Regression(AbstractEstimator):
    """Least squares on smoothed motion; of several recordings, each weighted by its noise."""

    @property
    def supports(self) -> frozenset[str]:
        return frozenset({PREVIOUS, OFFSETS, SEVERAL, BODIES, LOAD_FRICTION, PRE_SLIDING})

    def fit(self, problem: Problem) -> Fit:
        request, network, solver = problem.request, problem.network, problem.solver
        several: SeveralFit | None = None
        if len(problem.recordings) > 1:
            patterns = {name: x.patterns for name, x in problem.recordings.items()}
            several = fit_recordings(network, patterns, solver, offsets=request.offsets)
            fit = several.fit
        elif request.previous is not None and request.groups is not None:
            fit = problem.settings.reidentify(
                network, problem.patterns["training"], request.previous, request.groups
            )
        elif (fitted := problem.load or problem.slopes) is not None and problem.part is None:
            fit = fitted.fit
        elif problem.load is not None:
            k = problem.load.fit.k
            fit = solver.fit(*linearised(network, k, problem.patterns["training"]))
        elif problem.alone is not None and problem.part is None:
            fit = problem.alone
        else:
            fit = solver.fit(network, problem.patterns["training"])
        return Fit(network, fit, np.zeros(network.joint_count), several)

    def judged(self, problem: Problem) -> Judged:
        request, network = problem.request, problem.network
        previous = request.previous
        problem.step("fitting coefficients")
        fit = self.fit(problem)
        several = fit.source if isinstance(fit.source, SeveralFit) else None
        if several is not None:
            problem = _less_offsets(problem, several)
        identification = problem.informed(fit.identification)
        systematic: SystematicError | None = None
        if request.systematic:
            problem.step("computing systematic errors")
            several, systematic = _with_systematic(problem, fit, identification, several)
        bodies, held_out, sentences = None, None, ()
        if previous is None:
            bodies, held_out, sentences = judged_bodies(
                network,
                InformedFit(
                    identification,
                    with_knowledge(fit.identification, problem.known),
                    problem.file_prior,
                ),
                problem.judged_patterns,
                partial(_parts, problem, identification, several),
                choice=request.possible,
                prior=request.prior,
                source="cross-validation" if several is None else "held-out recording",
                systematic=systematic,
                step=problem.step,
            )
        vectors: Mapping[str, Any] = {}
        if previous is not None:
            vectors = {"before": previous.k if isinstance(previous, Identification) else previous}
        if bodies is not None:
            identification, vectors = bodies.fit, bodies.other_coefficients
        if network.load_terms and previous is None:
            network = network.with_load(np.asarray(identification.k))
        file = None if problem.file is None else problem.file.of_fit(fit.identification)
        systematic = with_possible_faults(
            problem, network, identification, systematic, fit.identification, file
        )
        fit = dataclasses.replace(fit, network=network, identification=identification)
        problem.step("computing errors")
        if problem.validation is not None:
            held_out = held_out_of(problem, fit)
        elif previous is None and held_out is None:
            held_out = _cross_validated(problem, fit, several)
        fitted = [x for x in (problem.slopes, problem.load) if x is not None]
        return Judged(
            problem,
            fit,
            held_out,
            {
                "possible": bodies,
                "systematic": systematic,
                "file_prior": None if problem.file is None else problem.file.weight,
                "slopes": problem.slopes,
                "several": several,
            },
            vectors,
            warnings=(*problem.warnings, *(line for x in fitted for line in x.warnings)),
            consequences=tuple(sentences),
        )


def with_states(judged: Judged, presliding_distance: tuple[float, ...]) -> Judged:
    """Add a fit of least squares whose dry friction yields over known distances, if there are any.

    **Raises** `ValueError` for distances that are not n or of joints without dry friction.
    """
    if not any(presliding_distance):
        return judged
    problem, network = judged.problem, judged.fit.network
    values = checked_distance(network, presliding_distance)
    patterns = problem.patterns["training"]
    fit = problem.informed(problem.solver.fit(along_motion(network, patterns, values), patterns))
    return dataclasses.replace(judged, yielding=Fit(network, fit, values))


def _less_offsets(problem: Problem, several: SeveralFit) -> Problem:
    """The problem with the constant torques taken off that were fitted along."""
    if not problem.request.offsets:
        return problem
    recordings = {
        name: dataclasses.replace(x, offsets=several.offsets[name])
        for name, x in problem.recordings.items()
    }
    return dataclasses.replace(problem, recordings=recordings)


def _parts(
    problem: Problem, fit: Identification, several: SeveralFit | None
) -> tuple[JudgedPart, ...]:
    """Parts of the motion, and fits without each: recordings, or stretches of one."""
    network, patterns = problem.network, problem.judged_patterns
    if several is not None:
        parts = [
            JudgedPart.of(network, values, several.without[name])
            for name, values in several.patterns.items()
        ]
    else:
        whole, fold = JudgedPart.of(network, patterns, fit), fold_numbers(patterns.samples)
        fits = problem.solver.fits_without_folds(network, patterns, fold, whole.columns)
        parts = whole.stretches(tuple(fits))
    return tuple(problem.informed_part(part) for part in parts)


def _cross_validated(problem: Problem, fit: Fit, several: SeveralFit | None) -> HeldOut:
    if several is not None:
        parts = _parts(problem, fit.identification, several)
        k = fit.identification.k
        return held_out_of_parts(fit.network, fit.identification, k, parts, "held-out recording")
    return cross_validated_error(
        fit.network, problem.judged_patterns, problem.settings, fit=fit.identification
    )


def _with_systematic(
    problem: Problem, fit: Fit, identification: Identification, several: SeveralFit | None
) -> tuple[SeveralFit | None, SystematicError]:
    """Return the systematic error of a fit, and a fit of several recordings that allows for theirs.

    - `identification`: the fit with what is known beforehand; what is fixed has no error.
    """
    share = None if problem.file is None else problem.file.prior.data_share(fit.identification)
    errors = _systematic_errors(problem, identification, several, share)
    if several is None:
        (error,) = errors.values()
    else:
        several, error = several.allowing_for(errors, share)
    fixed = [i for i, entry in problem.known.items() if entry.fixed]
    return several, error.without(fixed)


def _systematic_errors(
    problem: Problem,
    identification: Identification,
    several: SeveralFit | None,
    share: Float[np.ndarray, "coefficients coefficients"] | None,
) -> Mapping[str, SystematicError]:
    """The systematic errors of each recording's own fit.

    - `share`: what coefficients change by with those of a fit without prior knowledge.
    """
    (first, *_) = problem.recordings
    fits = {first: identification} if several is None else several.alone
    return {
        name: systematic.error(
            np.asarray(fits[name].k),
            np.asarray(fits[name].determined),
            problem.request.groups,
            share,
        )
        for name, systematic in problem.systematic_problems().items()
    }


@dataclasses.dataclass(frozen=True)
class SimulatedMotion(AbstractEstimator):
    """Instruments from simulated motion, or torques alone with `DirectDynamics`.

    Of one recording, without consistent bodies and systematic errors. `method` has the settings of
    the problem.
    """

    method: InstrumentalVariables | DirectDynamics = dataclasses.field(
        default_factory=InstrumentalVariables
    )

    @property
    def supports(self) -> frozenset[str]:
        return frozenset()

    def fit(self, problem: Problem) -> Fit:
        instruments = isinstance(self.method, InstrumentalVariables)
        words = "instrumental variables" if instruments else "direct dynamics"
        problem.step(words)
        settings = problem.settings.with_options(torque_lag=0.0)
        method = dataclasses.replace(self.method, settings=settings)
        (recording,) = problem.on_time.values()
        result = method.fit(problem.network, recording, problem.start)
        warnings = [f"{words}: not converged after {result.steps} simulations"]
        tested = result.exogeneity
        return Fit(
            problem.network,
            result.fit,
            np.zeros(problem.network.joint_count),
            warnings=() if result.converged else tuple(warnings),
            notes=() if tested is None else (f"{words}: {tested}",),
        )

    def judged(self, problem: Problem) -> Judged:
        start = problem.informed(Regression().fit(problem).identification)
        return super().judged(dataclasses.replace(problem, start=start))
