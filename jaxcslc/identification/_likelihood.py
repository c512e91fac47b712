"""Maximum likelihood beside least squares, judged on motion that neither has seen.

That is the last part of each training recording. A validation recording only judges the result.
"""

import contextlib
import dataclasses
from collections.abc import Callable, Generator, Mapping, Sequence
from functools import partial
from types import MappingProxyType
from typing import Any, NamedTuple

import jax.numpy as jnp
import numpy as np
from jaxtyping import Float

from .._processes import can_fork, function_beside
from ..bodies import (
    ChosenPrior,
    InformedFit,
    JudgedPart,
    PossibleFit,
    Prior,
    fixed_bodies,
    judged_bodies,
    possible_coefficients,
    with_knowledge,
)
from ..friction import SlopeFit, along_motion, state_at
from ..least_squares import Identification, Settings, computed_on_host, masked_rms
from ..likelihood import (
    Estimator,
    EstimatorComparison,
    LeftOut,
    LikelihoodFit,
    MaximumLikelihood,
    Misfit,
)
from ..network import CSLC
from ..recordings import Patterns, Recording
from ..report import predicted_torque
from ..selection import PRE_SLIDING
from ..uncertainty import (
    FEWEST_SAMPLES,
    FOLDS,
    RelativeError,
    Source,
    SystematicError,
    held_out_from,
)
from ._estimator import AbstractEstimator, Begin, Fit, Judged, held_out_of, with_possible_faults
from ._exclusions import BODIES, LIKELIHOOD, SEVERAL, Request
from ._least_squares import Regression, with_states
from ._problem import Problem, joined, without_lag


_SOURCE: Source = "held-out stretch"
# Matrices of positions times coefficients that a fit keeps at a time.
_MATRICES = 6


@dataclasses.dataclass(frozen=True)
class Likelihood(AbstractEstimator):
    """Positions and coefficients estimated together, compared with least squares.

    - `always`: whether its coefficients are the report's anyway; or only where it predicts motion
      that was not fitted better than least squares, by more than chance and by 1 %. They are
      judged by `MaximumLikelihood.misfit`: torque errors of smoothed motion favour regression on
      such. Where the fit fails, least squares are then used.
    """

    always: bool = True

    @property
    def supports(self) -> frozenset[str]:
        return frozenset({SEVERAL, BODIES, LIKELIHOOD, PRE_SLIDING})

    def fit(self, problem: Problem) -> Fit:
        """Fit coefficients of all training recordings, positions along with them.

        **Raises** `ValueError`, `RuntimeError`: as `MaximumLikelihood.fit`; matrices that do not
        fit into memory.
        """
        request = problem.request
        needed, memory = _needed(request.network, request.training), request.memory
        if needed > memory:
            samples = sum(recording.samples for recording in request.training.values())
            raise ValueError(
                f"maximum likelihood of {samples} samples needs {needed:.2g} GB; expected at most"
                f" {memory:g} GB, about {int(memory / (needed / samples))} samples: thin the"
                " recording, or allow more memory"
            )
        options = _with_bodies(request, options_for(request.likelihood_options, problem.settings))
        # Regression with static friction starts from other slopes.
        start = None if _has_static_friction(request.network) else problem.start
        recordings = list(problem.on_time.values())
        likelihood = options.fit(request.network, recordings, start, problem.step)
        return _fit_of(problem, likelihood)

    def misfit(self, problem: Problem, fit: Fit, recordings: Sequence[Recording]) -> Misfit:
        """Return how well a fit agrees with recordings that are not smoothed.

        - `fit`: by this estimator; its noise levels, lag, gains and gears hold.
        """
        likelihood = fit.source
        assert isinstance(likelihood, LikelihoodFit)
        on_time = [without_lag(recording, problem.lag) for recording in recordings]
        return _misfit(problem, likelihood, on_time, fit.network, np.asarray(fit.k))

    def judged(self, problem: Problem) -> Judged:
        """Judge least squares and maximum likelihood on the same motion; keep one of them."""
        base = with_states(
            Regression().judged(problem), problem.request.likelihood_options.presliding_distance
        )
        try:
            return self._compared(base)
        except (ValueError, RuntimeError) as error:
            if self.always:
                raise
            warning = f"maximum likelihood failed, least squares is used: {error}"
            return dataclasses.replace(base, warnings=(*base.warnings, warning))

    def _compared(self, base: Judged) -> Judged:
        """The estimator that is asked for, or better; `base`: least squares."""
        problem = base.problem
        problem.step("maximum likelihood")
        if problem.begun is None:
            start = (base.yielding or base.fit).identification
            fit = self.fit(dataclasses.replace(problem, start=start))
            assert isinstance(fit.source, LikelihoodFit)
            fits = LikelihoodFits(fit.source, None)
        else:
            fits: LikelihoodFits = problem.begun()
        return _better(base, fits, always=self.always)

    @contextlib.contextmanager
    def beside(self, request: Request) -> Generator[Begin | None]:
        """Fit in another process, where slopes of static friction are fitted anyway.

        A fit without static friction starts from least squares, and bodies need those of them.
        """
        if not (
            _has_static_friction(request.network)
            and can_fork()
            and len(request.training) == 1
            and not _may_have_bodies(request)
            and within_memory(request.network, request.training, request.memory)
            and computed_on_host(request.network, request.training[request.longest].position)
        ):
            yield None
            return
        with function_beside(partial(_sent, request)) as begin:
            yield lambda settings: partial(_received, request.network, begin(settings))


class LikelihoodFits(NamedTuple):
    """Fits of maximum likelihood: to `whole` recordings, and to what is `before` the part of each
    that is held out; None where it is not computed yet."""

    whole: LikelihoodFit
    before: LikelihoodFit | None


def options_for(options: MaximumLikelihood, settings: Settings) -> MaximumLikelihood:
    """Return options with torques and a start as settings have them."""
    sampled = settings.preparation.torque_alignment == "sample"
    return dataclasses.replace(
        options,
        torque_sampling="sampled" if sampled else "held",
        settings=settings.with_options(torque_lag=0.0),
    )


def within_memory(network: CSLC, training: Mapping[str, Recording], memory: float) -> bool:
    """Return whether the matrices of a fit fit into memory [GB]."""
    return _needed(network, training) <= memory


def _needed(network: CSLC, training: Mapping[str, Recording]) -> float:
    """Memory of matrices of positions times coefficients [GB]."""
    samples = sum(recording.samples for recording in training.values())
    n = network.joint_count
    return 8e-9 * samples * n * (network.size + 2 * n) * _MATRICES


def _fit_of(problem: Problem, likelihood: LikelihoodFit) -> Fit:
    """A fit of maximum likelihood as the pipeline has it."""
    warnings: list[str] = []
    if not likelihood.converged:
        warnings.append(
            f"maximum likelihood: not converged after {likelihood.steps} steps; coefficients"
            " may be off by more than their intervals"
        )
    noise = likelihood.noise_excitation
    if noise is not None and noise.excessive:
        warnings.append(
            f"maximum likelihood, {noise.line}: the motion barely excites this coefficient. Likely"
            " cause: slow motion, or a single sine a joint. Remedy: faster or richer motion"
            " (jaxcslc excite), or --estimator least-squares"
        )
    notes = (
        f"{name}: recorded velocities are not used by maximum likelihood"
        for name, prepared in problem.recordings.items()
        if prepared.recording.velocity is not None
    )
    return Fit(
        likelihood.network,
        likelihood.fit,
        likelihood.presliding_distance,
        likelihood,
        tuple(warnings),
        tuple(notes),
    )


def _has_static_friction(network: CSLC) -> bool:
    return "static" in network.robot.friction_terms


def _may_have_bodies(request: Request) -> bool:
    """Return whether the search may be restricted to physically consistent bodies."""
    priors = (request.prior, request.likelihood_options.prior)
    return request.possible == "always" or any(x is not None and x.links for x in priors)


def _with_bodies(request: Request, options: MaximumLikelihood) -> MaximumLikelihood:
    """Options whose search has physically consistent bodies if they are used anyway."""
    prior = request.prior or options.prior or Prior()
    bounds = any(not entry.is_value for entry in prior.coefficients.values())
    if bounds or not (request.possible == "always" or prior.links):
        return options
    return dataclasses.replace(options, possible=True, prior=prior)


def _fit_before(
    options: MaximumLikelihood,
    network: CSLC,
    recordings: Sequence[Recording],
    whole: LikelihoodFit,
    step: Callable[[str], None],
) -> LikelihoodFit:
    """The fit to what is before the parts that are held out: near the fit to everything, whose
    noise levels it has."""
    left_out = LeftOut.of(recordings, whole.every)
    assert left_out is not None  # callers look at the number of samples
    return options.fit(network, left_out.early, whole.at(left_out.rows), step)


def _sent(request: Request, settings: Settings) -> list[Any]:
    """Return both fits of `LikelihoodFits`, as another process sends them."""
    options = options_for(request.likelihood_options, settings)
    lag = settings.preparation.torque_lag
    recordings = [without_lag(recording, lag) for recording in request.training.values()]
    whole = options.fit(request.network, recordings)
    held_out = recordings[0].samples >= FEWEST_SAMPLES
    quiet: Callable[[str], None] = lambda words: None
    before = _fit_before(options, request.network, recordings, whole, quiet) if held_out else None
    return [_without_network(whole), _without_network(before)]


def _without_network(fit: LikelihoodFit | None) -> dict[str, Any] | None:
    """Return the fields that another process can be sent.

    A network holds functions, which cannot be pickled.
    """
    if fit is None:
        return None
    return {name: value for name, value in vars(fit).items() if name != "network"}


def _received(network: CSLC, result: Callable[[], list[Any]]) -> LikelihoodFits:
    """Fits from another process, of a network with static friction.

    **Raises** what they have raised, as `MaximumLikelihood.fit`.
    """
    whole, before = (
        None
        if fields is None
        else LikelihoodFit(network=network.with_static_slopes(fields["slopes"]), **fields)
        for fields in result()
    )
    assert whole is not None
    return LikelihoodFits(whole, before)


class _Unfitted(NamedTuple):
    """Motion that was not fitted, and what estimators that have not seen it make of it.

    - `recordings`: with torques on time; `patterns`: as the report's settings prepare them.
    - `least_squares`: its coefficients, those of consistent bodies where the report has them.
    - `likelihood`: the other fit, as it is.
    - `contact`: (n,) states of dry friction that the patterns start with; None for zeros.
    """

    recordings: Sequence[Recording]
    patterns: Patterns
    least_squares: Fit
    likelihood: LikelihoodFit
    contact: np.ndarray


def _better(base: Judged, fits: LikelihoodFits, *, always: bool) -> Judged:
    """Whichever predicts unfitted motion better, or maximum likelihood in any case.

    Nothing is chosen on the validation recording: what is chosen on it, it could not judge.

    - `base`: least squares.
    """
    problem, likelihood = base.problem, fits.whole
    request = problem.request
    ours = _fit_of(problem, likelihood)
    unfitted = _unfitted(base, fits)
    along = along_motion(
        ours.network, unfitted.patterns, ours.presliding_distance, unfitted.contact
    )
    unseen = JudgedPart.of(along, unfitted.patterns, unfitted.likelihood.fit)
    known = _informed(problem, unfitted.likelihood.fit, ours.network)
    parts = [
        part._replace(base=_known(problem, unfitted.likelihood.fit, ours.network))
        for part in unseen.stretches((known,) * FOLDS)
    ]
    fit = likelihood.free
    if fit is None:
        fit = _informed(problem, likelihood.fit, ours.network)
    file = _file_prior(problem, likelihood.fit)
    bodies, _, sentences = judged_bodies(
        ours.network,
        InformedFit(
            fit,
            _known(problem, likelihood.fit, ours.network),
            None if file is None else file.prior,
        ),
        problem.patterns["training"],
        lambda: parts,
        choice=request.possible,
        prior=request.prior,
        source=_SOURCE,
        parameters=likelihood.bodies,
        step=problem.step,
    )
    problem.step("judging estimators")
    predicted = _predicted(problem, unfitted.likelihood.fit, ours.network, bodies)
    error = _error(unfitted, _with_k(ours, predicted))
    relative = _relative(problem, unfitted, ours.network, predicted)
    better = always or relative.beyond_chance()
    comparison = _comparison(unfitted, ours, error, relative, better)
    if comparison.used == "least-squares":
        fit = dataclasses.replace(base.fit, notes=(*base.fit.notes, *ours.notes))
        results = {**base.results, "estimators": comparison}
        return dataclasses.replace(base, fit=fit, results=results)
    fit = fit if bodies is None else bodies.fit if likelihood.free is None else likelihood.fit
    ours = dataclasses.replace(ours, identification=fit)
    problem.step("computing errors")
    mask = np.asarray(unfitted.patterns.mask)
    return Judged(
        problem,
        ours,
        held_out_of(problem, ours, _SOURCE, error, mask)
        if problem.validation is None
        else held_out_of(problem, ours),
        {
            "possible": bodies,
            "file_prior": None if file is None else file.weight,
            "systematic": _systematic(problem, likelihood, fit),
            "slopes": _slopes(likelihood),
            "several": base.results["several"],
            "estimators": comparison,
        },
        {} if bodies is None else bodies.other_coefficients,
        consequences=(*sentences, *ours.warnings),
    )


def _unfitted(base: Judged, fits: LikelihoodFits) -> _Unfitted:
    """Motion that was not fitted: the last part of each training recording."""
    problem, likelihood = base.problem, fits.whole
    request = problem.request
    shortest = min(recording.samples for recording in request.training.values())
    if shortest < FEWEST_SAMPLES:
        raise ValueError(
            f"{shortest} samples are too few to hold a stretch out; expected {FEWEST_SAMPLES}"
        )
    late: list[Recording] = []
    fitted: list[Patterns] = []
    unfitted: list[Patterns] = []
    contacts: list[np.ndarray] = []
    presliding_distance = _presliding_distance(base)
    settings = problem.settings.with_options(torque_lag=0.0)
    for recording in problem.on_time.values():
        start, end, split = recording.time[0], recording.time[-1], held_out_from(recording)
        late.append(recording.between(split - float(start), float(end - start)))
        patterns = settings.patterns(recording)
        fitted.append(patterns.between(float(start), split))
        unfitted.append(patterns.between(split, float(end)))
        first = int(np.searchsorted(np.asarray(patterns.time), unfitted[-1].time[0]))
        contacts.append(state_at(patterns, presliding_distance, first))
    shorter = fits.before
    if shorter is None:
        options = options_for(request.likelihood_options, problem.settings)
        recordings = list(problem.on_time.values())
        shorter = _fit_before(options, request.network, recordings, likelihood, problem.step)
    return _Unfitted(
        late,
        joined(unfitted),
        _regression(base, joined(fitted)),
        shorter,
        contacts[0],
    )


def _regression(base: Judged, patterns: Patterns) -> Fit:
    """Least squares of patterns, with the dry friction that maximum likelihood has; of possible
    bodies where the report has them."""
    problem, network, presliding_distance = (
        base.problem,
        base.fit.network,
        _presliding_distance(base),
    )
    fit = problem.solver.fit(along_motion(network, patterns, presliding_distance), patterns)
    unaided = with_knowledge(fit, problem.known)
    fit = problem.informed(fit)
    result = Fit(network, fit, presliding_distance)
    bodies: PossibleFit | None = base.results["possible"]
    if bodies is None or not bodies.used:
        return result
    weight = bodies.parameters.prior_weight
    return _with_k(result, _possible(problem, network, unaided, weight, smoothed=True))


def _presliding_distance(base: Judged) -> Float[np.ndarray, " joints"]:
    """(n,) of pre-sliding, of both estimators."""
    return (base.yielding or base.fit).presliding_distance


def _file_prior(
    problem: Problem, fit: Identification, *, smoothed: bool = False
) -> ChosenPrior | None:
    """The robot's file as it enters a fit: of maximum likelihood, or of smoothed motion."""
    return None if problem.file is None else problem.file.of_fit(fit, smoothed=smoothed)


def _informed(problem: Problem, fit: Identification, network: CSLC) -> Identification:
    """A fit of maximum likelihood with what is known, unless its search knew it."""
    if problem.request.likelihood_options.prior is not None:
        return fit
    return problem.informed(fit, problem.known_of(network), smoothed=False)


def _known(problem: Problem, fit: Identification, network: CSLC) -> Identification:
    """The same without the robot's file as prior."""
    if problem.request.likelihood_options.prior is not None:
        return fit
    return with_knowledge(fit, problem.known_of(network))


def _predicted(
    problem: Problem, fit: Identification, network: CSLC, bodies: PossibleFit | None
) -> np.ndarray:
    """The coefficients of maximum likelihood that unfitted motion is predicted by."""
    if bodies is None or not bodies.used:
        return np.asarray(_informed(problem, fit, network).k)
    base = _known(problem, fit, network)
    return _possible(problem, network, base, bodies.parameters.prior_weight)


def _possible(
    problem: Problem,
    network: CSLC,
    fit: Identification,
    weight: float,
    *,
    smoothed: bool = False,
) -> np.ndarray:
    """Coefficients of the bodies nearest to a fit, with the prior's weight of other bodies.

    - `fit`: without the robot's file as prior; `smoothed`: whether it is of smoothed motion.
    """
    robot, prior = network.robot, problem.request.prior
    knowledge = () if prior is None else prior.link_values(robot)
    file = _file_prior(problem, fit, smoothed=smoothed)
    return possible_coefficients(
        network,
        fit,
        fixed_bodies(robot),
        knowledge,
        weight,
        None if file is None else file.prior.bodies,
        None if file is None else file.prior.confidence,
    )


def _with_k(fit: Fit, k: np.ndarray) -> Fit:
    """A fit with other coefficients."""
    return dataclasses.replace(fit, identification=fit.identification.with_k(k))


def _misfit(
    problem: Problem,
    likelihood: LikelihoodFit,
    recordings: Sequence[Recording],
    network: CSLC,
    k: np.ndarray,
) -> Misfit:
    """Misfit of coefficients to recordings on time, with noise of a fit."""
    options = options_for(problem.request.likelihood_options, problem.settings)
    return options.as_of(likelihood).misfit(
        network,
        recordings,
        k,
        np.sqrt(np.mean(likelihood.torque_noise**2, axis=0)),
        np.sqrt(np.mean(likelihood.position_noise**2, axis=0)),
    )


def _relative(
    problem: Problem, unfitted: _Unfitted, network: CSLC, predicted: np.ndarray
) -> RelativeError:
    """Misfits of maximum likelihood over those of least squares."""
    likelihood, regression = unfitted.likelihood, unfitted.least_squares
    other = _with_coefficients(likelihood.network, regression.network, np.asarray(regression.k))
    ours, theirs = (
        _misfit(problem, likelihood, unfitted.recordings, *coefficients)
        for coefficients in ((likelihood.network, predicted), other)
    )
    stretches = np.array_split(np.arange(len(ours.mask)), FOLDS)
    return RelativeError.of(
        *(
            [values[rows] for rows in stretches]
            for values in (ours.error, theirs.error, ours.mask & theirs.mask)
        )
    )


def _with_coefficients(network: CSLC, other: CSLC, k: np.ndarray) -> tuple[CSLC, np.ndarray]:
    """Another network as this one, with zeros for what it lacks: no function is compiled for it."""
    if not set(other.names) <= set(network.names):
        return other, k
    index = {name: number for number, name in enumerate(network.names)}
    result = np.zeros(network.size)
    result[[index[name] for name in other.names]] = k
    slopes = other.static_slopes
    return network if slopes is None else network.with_static_slopes(slopes), result


def _comparison(
    unfitted: _Unfitted,
    ours: Fit,
    error: Float[np.ndarray, "samples joints"],
    relative: RelativeError,
    better: bool,
) -> EstimatorComparison:
    """Return the comparison of both estimators.

    `error` is that of maximum likelihood; `better`: it is used.
    """
    assert isinstance(ours.source, LikelihoodFit)
    mask = np.asarray(unfitted.patterns.mask)
    least_squares = dataclasses.replace(
        unfitted.least_squares, presliding_distance=ours.presliding_distance
    )
    errors: dict[Estimator, np.ndarray] = {
        "least-squares": _error(unfitted, least_squares),
        "maximum-likelihood": error,
    }
    everything = np.ones_like(mask)
    return EstimatorComparison(
        _SOURCE,
        MappingProxyType({name: masked_rms(values, mask) for name, values in errors.items()}),
        MappingProxyType({name: masked_rms(values, everything) for name, values in errors.items()}),
        relative,
        "maximum-likelihood" if better else "least-squares",
        ours.source,
        ours.network.output_units,
    )


def _error(unfitted: _Unfitted, fit: Fit) -> Float[np.ndarray, "samples joints"]:
    """Torque errors of unfitted motion, friction at rest as reports have it."""
    patterns = unfitted.patterns
    along = along_motion(fit.network, patterns, fit.presliding_distance, unfitted.contact)
    return np.asarray(patterns.torque) - predicted_torque(along, patterns, np.asarray(fit.k))


def _systematic(
    problem: Problem, likelihood: LikelihoodFit, fit: Identification
) -> SystematicError | None:
    """Systematic errors without those of fixed coefficients, and of what the file decides."""
    error = likelihood.systematic
    if error is None or not problem.request.systematic:
        return None
    file = _file_prior(problem, likelihood.fit)
    part = np.ones(len(fit.names)) if file is None else 1.0 - file.weight.share
    error = SystematicError({cause: part * shift for cause, shift in error.parts.items()})
    network = likelihood.network
    error = with_possible_faults(problem, network, fit, error, likelihood.fit, file)
    fixed = np.flatnonzero(np.asarray(fit.standard_error) == 0.0).tolist()
    return None if error is None else error.without(fixed)


def _slopes(likelihood: LikelihoodFit) -> SlopeFit | None:
    """Slopes of static friction as least squares reports them; None without static friction."""
    network = likelihood.network
    if network.static_slopes is None:
        return None
    return SlopeFit(
        network,
        likelihood.fit,
        jnp.asarray(likelihood.slopes),
        jnp.asarray(likelihood.slope_error),
        jnp.asarray(likelihood.steps),
        jnp.asarray(likelihood.converged),
    )
