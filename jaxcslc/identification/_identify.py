"""The pipeline of `identify`: friction, problem, estimator, judgement, report.

`ESTIMATORS` lists the estimators by name.
"""

import contextlib
import dataclasses
from collections.abc import Callable, Generator, Mapping, Sequence
from concurrent.futures import ThreadPoolExecutor
from functools import partial
from types import MappingProxyType
from typing import Any, Literal

import numpy as np

from .._display import Progress, steps
from .._processes import can_fork, computed_beside
from ..bodies import Choice, Prior
from ..checks import AGREEMENT_KINDS, DataCheck, check
from ..friction import PreSlidingFit, along_motion, fit_pre_sliding, fit_slopes
from ..instruments import HorizonError, file_coefficients, prediction_error
from ..least_squares import LeastSquares, Previous, Settings, computed_on_host
from ..likelihood import MaximumLikelihood
from ..network import CSLC, DIRECTIONAL_LOAD, LOAD
from ..recordings import Patterns, Recording, without_repetition
from ..report import Report, compare, degree_of_excitation, fit_warnings
from ..selection import (
    FRICTION_CANDIDATES,
    OFFSET,
    PRE_SLIDING,
    SAMPLES_OF_THREADS,
    FrictionChoice,
    choose_friction,
    motion_part,
    with_all_offsets,
)
from ..uncertainty import SeveralFit
from ._estimator import AbstractEstimator, Judged
from ._exclusions import LOAD_FRICTION, Request, check_request, excluded
from ._least_squares import Regression, SimulatedMotion
from ._likelihood import Likelihood, within_memory
from ._problem import (
    TRAINING,
    VALIDATION,
    ChosenSettings,
    basic_settings,
    has_bodies,
    judged_part,
    prepare,
    select_settings,
    with_file_bodies,
    with_file_prior,
    with_friction,
    without_lag,
)


ESTIMATORS: Mapping[str, AbstractEstimator] = MappingProxyType(
    {
        "least-squares": Regression(),
        "maximum-likelihood": Likelihood(),
        "instrumental-variables": SimulatedMotion(),
        "auto": Likelihood(always=False),
    }
)
"""Estimators of `identify` and of the command, by name."""


# Joints of which pre-sliding is kept for nothing. Not divided by the number of kinds that are
# tried, as for terms: of 96 joints without it (simulated, encoders or Gaussian noise), none kept it
# at either level, since almost no length fits better there; five of a Panda's seven would lose it.
_CHANCE = 0.05
_TOO_LONG = "the recording is too long to be fitted in one piece"


@dataclasses.dataclass(frozen=True)
class ChosenFriction:
    """Friction that is chosen by the data.

    - `request`: with the terms in its network and, with maximum likelihood, pre-sliding distances
      and static friction of joints without.
    - `settings`: that terms were judged by; None if the request has its own.
    - `terms`: joint by joint, and what each was worth.
    - `tried`: pre-sliding as it was tried before all fits; None if it was not.
    - `not_tried`: why it was not, in words, empty if it was not asked for; None if it is to be
      tried beside the fit.
    """

    request: Request
    settings: ChosenSettings | None
    terms: FrictionChoice
    tried: PreSlidingFit | None = None
    not_tried: str | None = None


def with_prior_offsets(request: Request) -> Request:
    """Return the request with a torque offset of every joint, if the robot's file is a prior.

    The prior tells offsets from gravity where the motion does not, and `FilePrior` says how large
    they are. So nothing has to be tried.
    """
    if request.friction is None or request.offsets or not has_bodies(request):
        return request
    return dataclasses.replace(request, network=with_all_offsets(request.network))


def with_chosen_settings(
    asked: Request, request: Request, step: Callable[[str], None]
) -> ChosenFriction:
    """Select settings for the network that was asked for, and fit one that has more offsets."""
    chosen = select_settings(asked, step) if asked.settings is None else None
    note = "each joint has a torque offset: the masses in the robot's file separate it from gravity"
    terms = FrictionChoice(request.network, (), note)
    return ChosenFriction(request, chosen, terms, not_tried="")


def with_offsets(request: Request, step: Callable[[str], None]) -> ChosenFriction:
    """Add a constant torque to joints whose motion is predicted better with it.

    It is judged like the terms of `choose_friction_terms`. Where it cannot be, none is added.
    """
    chosen = select_settings(request, step) if request.settings is None else None
    settings, part = basic_settings(request, chosen), judged_part(request)
    terms = FrictionChoice(request.network, ())
    motion = None
    if chosen is not None and motion_part(settings.preparation) == motion_part(
        chosen.selection.settings.preparation
    ):
        motion = chosen.motion
    step("trying torque offsets")
    # Of a recording that is too short, or cannot be prepared, the fit says so.
    with contextlib.suppress(ValueError, RuntimeError):
        terms = choose_friction(
            request.network,
            part,
            settings,
            candidates=[OFFSET],
            others=[x for name, x in request.training.items() if name != request.longest],
            motion=motion,
        )
    request = dataclasses.replace(request, network=terms.network)
    terms = dataclasses.replace(terms, brief=True)
    return ChosenFriction(request, chosen, terms, not_tried="")


def choose_friction_terms(
    asked: Request, request: Request, step: Callable[[str], None]
) -> ChosenFriction:
    """Choose friction joint by joint, on the longest recording.

    Settings are selected for the network that was asked for, before it got torque offsets.

    Where maximum likelihood is fitted, pre-sliding distances are chosen now: its fits use them.
    """
    longest = request.training[request.longest]
    unfit = excluded(request, LOAD_FRICTION)
    candidates = [
        kind for kind in FRICTION_CANDIDATES if not unfit or kind not in (LOAD, DIRECTIONAL_LOAD)
    ]
    chosen = select_settings(asked, step) if asked.settings is None else None
    tried, not_tried = None, excluded(request, PRE_SLIDING)
    fits = within_memory(request.network, request.training, request.memory)
    distance = None
    if not_tried is None and fits:  # terms beside states make up for none
        first, _ = _tried_before(request, chosen, step)
        distance = None if first is None else first.presliding_distance
    terms = choose_friction(
        request.network,
        longest,
        basic_settings(request, chosen),
        candidates=candidates,
        others=[x for name, x in request.training.items() if name != request.longest],
        presliding_distance=distance,
        informed=partial(with_file_bodies, request) if has_bodies(request) else None,
        progress=step,
    )
    request = dataclasses.replace(request, network=terms.network)
    if request.estimator in ("maximum-likelihood", "auto") and not_tried is None:
        tried, not_tried = _tried_before(request, chosen, step) if fits else (None, _TOO_LONG)
    if tried is not None:
        terms = terms.with_pre_sliding(tried)
        if tried.joint_names:
            options = dataclasses.replace(
                request.likelihood_options,
                presliding_distance=tuple(tried.presliding_distance.tolist()),
            )
            request = dataclasses.replace(request, likelihood=options)
    if request.estimator == "maximum-likelihood":
        terms = terms.with_static_friction()
        request = dataclasses.replace(request, network=terms.network)
    if chosen is not None:
        chosen = chosen._replace(motion=None)
    return ChosenFriction(request, chosen, terms, tried, not_tried)


def _tried_before(
    request: Request, chosen: ChosenSettings | None, step: Callable[[str], None]
) -> tuple[PreSlidingFit | None, str | None]:
    """Pre-sliding of the longest recording before any fit, or why it could not be tried."""
    settings = basic_settings(request, chosen).for_network(request.network)
    network, patterns = request.network, settings.patterns(request.training[request.longest])
    if network.load_terms:
        network = network.without_load()
    if "static" in network.robot.friction_terms:
        network = fit_slopes(network, patterns, solver=settings.solver).network
    return _tried(request, network, patterns, settings.solver, step)


def friction_results(
    judged: Judged, chosen: ChosenFriction | None
) -> tuple[FrictionChoice | None, PreSlidingFit | None, tuple[str, ...]]:
    """Return the terms that were tried, dry friction with states, and notes, for the report.

    With least squares alone, pre-sliding is tried now: beside the terms that were fitted, with
    their patterns, masks and settings.

    - `chosen`: None if friction was not chosen.
    """
    problem, states, notes = judged.problem, None, ()
    terms = None if chosen is None else chosen.terms
    tried = None if chosen is None else chosen.tried
    fit = judged.yielding or judged.fit
    if fit.presliding_distance.any():
        states = PreSlidingFit(
            fit.network, fit.identification, fit.presliding_distance, {}, fit.presliding_distance
        )
        if tried is not None:
            states = dataclasses.replace(
                states, relative=tried.relative, tried_distance=tried.tried_distance
            )
    if chosen is not None and tried is None:
        not_tried = chosen.not_tried
        if not_tried is None and problem.part is not None:
            not_tried = _TOO_LONG
        if not_tried is None:
            patterns = problem.patterns["training"]
            tried, not_tried = _tried(
                problem.request, judged.fit.network, patterns, problem.solver, problem.step
            )
        if tried is None:
            notes = (f"{PRE_SLIDING} was not tried: {not_tried}",) if not_tried else ()
        else:
            terms = chosen.terms.with_pre_sliding(tried)
            if tried.joint_names:
                states = dataclasses.replace(tried, fit=problem.informed(tried.fit))
    if states is not None:
        notes = (*notes, _note_of(states, fitted=bool(judged.fit.presliding_distance.any())))
    return terms, states, notes


def _tried(
    request: Request,
    network: CSLC,
    patterns: Patterns,
    solver: LeastSquares,
    step: Callable[[str], None],
) -> tuple[PreSlidingFit | None, str | None]:
    """Pre-sliding, or why it could not be tried.

    It is judged over all samples: masks exclude the slow ones, which say most about it.
    """
    step(f"trying friction: {PRE_SLIDING}")
    everything = np.ones(np.shape(patterns.mask), bool)
    try:
        informed = with_file_bodies(request, network, solver.fit(network, patterns))
        return fit_pre_sliding(
            *(network, patterns),
            solver=solver,
            judged=everything,
            chance=_CHANCE,
            informed=informed,
        ), None
    except (ValueError, RuntimeError) as error:  # too little motion is left in some stretch
        return None, str(error)


def _note_of(states: PreSlidingFit, *, fitted: bool) -> str:
    """Describe where dry friction has states, and where it is a step."""
    joints = ", ".join(states.joint_names)
    if fitted:
        return (
            f"{PRE_SLIDING} of {joints}: a state along the motion, in the coefficients and errors"
            " of this report, simulated motion and C code; robot files have dry friction as a step"
        )
    return (
        f"{PRE_SLIDING} of {joints}: a state along the motion, in report.pre_sliding,"
        " identification.json, simulated motion and C code; all else, robot files included, has"
        " dry friction as a step"
    )


def identify(
    network: CSLC,
    training: Recording | Sequence[Recording] | Mapping[str, Recording],
    validation: Recording | None = None,
    settings: Settings | None = None,
    *,
    estimator: str | AbstractEstimator = "least-squares",
    likelihood: MaximumLikelihood | None = None,
    offsets: bool = False,
    previous: Previous | None = None,
    groups: Sequence[str] | None = None,
    friction: Literal["auto", "offset"] | None = None,
    options: Mapping[str, Any] | None = None,
    folds: int | None = None,
    checks: bool = True,
    systematic: bool = True,
    possible: Choice = "auto",
    prior: Prior | None = None,
    file_prior: bool = True,
    memory: float = 2.0,
    simulate: bool = False,
    progress: Progress = None,
) -> Report:
    """Identifies a robot's coefficients from a recording, and judges the result.

    Selects settings, prepares the recordings, fits the coefficients, and evaluates excitation and
    torque errors. Held-out data are the validation recording or, without one, segments of the
    training recording (cross-validation). `jaxcslc identify` prints and saves the report that this
    function returns.

    **Arguments**

    - `network`: n joints, p coefficients.
    - `training`: the recording to fit; or several, in a list or by name. Each is then prepared
      according to its own sampling and weighted by its own noise. Settings are selected on the
      longest. The report tests whether they agree (`report.several.agreement`).
    - `validation`: a recording to judge the fit on; no coefficient depends on it.
    - `settings`: of preparation and fit; by default those that `choose_settings` finds for the
      training recording. A validation recording that was sampled in another way (a coarser
      encoder, another rate, irregular time stamps) then gets a smoothing of its own; with
      settings set here it gets a warning.
    - `estimator`: a name, or an `AbstractEstimator`.
        - `"least-squares"`: fits smoothed motion.
        - `"maximum-likelihood"`: estimates positions too and needs no smoothing
          (`MaximumLikelihood`).
        - `"auto"`: both. The latter is used if it predicts the last quarter of each training
          recording better, by more than chance, when fitted to what is before it.
          `report.estimators` compares them.
        - `"instrumental-variables"`: one recording, without physically consistent parameters and
          systematic errors (`InstrumentalVariables`). A note says whether least squares is biased.
    - `likelihood`: options of maximum likelihood; its torque sampling and settings are those of the
      report.
    - `offsets`: with several recordings, also fit one torque offset per joint and recording.
    - `previous`: an identification of the same network, or its (p,) coefficients. Only the
      coefficients of `groups` are then fitted; all others keep these values (thesis 5.2.4).
    - `groups`: coefficients to re-identify, by group (`"viscous"`, `"dry"`, ...) or name.
    - `friction`: `"auto"` adds, joint by joint, the friction terms that improve prediction of
      held-out data (`choose_friction`), then tries pre-sliding friction (`fit_pre_sliding`).
      `report.friction` has the gain of each, `report.pre_sliding` the fit with states, where a
      joint gains by them. `"offset"` tries a constant torque of each joint alone, as the command
      does by default. None leaves the network's terms. Maximum likelihood is fitted with their
      distances, and compared with least squares with states. Settings are selected once, for the
      network as it is passed.
    - `options`: of `Preparation` and `LeastSquares`, set whatever the settings are, such as
      `{"torque_lag": 0.02, "loss": "huber"}`.
    - `folds`: as of `choose_settings`; by default 8, or fewer where the recording is short.
    - `checks`: look for wrong units, signs, times and samples first; see `check`.
    - `systematic`: include errors that residuals do not show in intervals and verdicts; see
      `systematic_error`. It costs about one more fit.
    - `possible`: physically consistent parameters (`physical_parameters`, `PossibleFit`).
      `"auto"` uses their coefficients if they predict held-out data better than the unconstrained
      fit by more than noise, `"always"` in any case; `"never"` does not compute them.
    - `prior`: what is known of coefficients and links: fixed, bounded, or a value with its error,
      by name. Knowledge of links makes the report use physically consistent parameters: no others
      can follow it.
    - `file_prior`: whether the inertial parameters of the robot's file are a prior, as exact as
      files usually are (`FilePrior`). They decide what the motion leaves open, and
      `report.file_prior` says how much of each coefficient is the file's.
    - `memory`: to use [GB], about. Coefficients are fitted to all samples of one training
      recording, however long. Where its regressor does not fit, settings are selected and fits
      judged on a part of it (`report.judged_part` says which). Of several recordings that do not
      fit together, parts are used throughout, as `report.notes` say.
    - `simulate`: also simulate the identified arm without feedback from states of the validation
      recording, or of the longest training recording. `report.horizon` has the position errors
      after 0.1 to 5 s, also of the robot's file and of the fit with pre-sliding states.
    - `progress`: a function that is called with a few words at the start of each step; or True to
      show the steps in a line, False to show none. By default they are shown in notebooks, at
      Python's prompt and on terminals. `TQDM_DISABLE=1` turns them off everywhere.

    **Returns** a `Report`.

    **Raises**

    - `ValueError`: an unknown estimator, or one that cannot do what else is asked for; only one of
      `previous` and `groups`; groups or a previous identification that are not the network's; a
      recording that cannot be used, named as training or validation recording.
    - `RuntimeError`: a fit that fails, as of `LeastSquares.fit`; with `possible="always"` also as
      of `physical_parameters`.
    - `ImportError`: with `possible="always"`, where the conic solver is needed and not installed.

    >>> import jaxcslc as jc
    >>> network = jc.derive(jc.examples.pendulum())
    >>> recording = jc.examples.swing_recording(network, [0.5, 0.3, -0.1, 0.2, 0.05])
    >>> report = jc.identify(network, recording, settings=jc.Settings())
    >>> report.k.round(3).tolist()
    [0.5, 0.3, -0.1, 0.2, 0.05]
    """
    if isinstance(estimator, str) and estimator not in ESTIMATORS:
        raise ValueError(f"estimator: expected {', '.join(ESTIMATORS)}, got {estimator!r}")
    chosen = ESTIMATORS[estimator] if isinstance(estimator, str) else estimator
    request = Request(
        network,
        _by_name(training),
        validation,
        settings,
        estimator=estimator if isinstance(estimator, str) else type(estimator).__name__,
        supports=chosen.supports,
        likelihood=likelihood,
        offsets=offsets,
        previous=previous,
        groups=None if groups is None else tuple(groups),
        friction=friction,
        options=options or {},
        folds=folds,
        checks=checks,
        systematic=systematic,
        possible=possible,
        prior=prior,
        file_prior=file_prior,
        memory=memory,
        simulate=simulate,
    )
    check_request(request)
    with steps(progress, f"identify {network.name}") as step:
        return _identified(request, chosen, step)


def _identified(
    request: Request, estimator: AbstractEstimator, step: Callable[[str], None]
) -> Report:
    """The report of a request that has been checked."""
    friction: ChosenFriction | None = None
    asked, request = request, with_prior_offsets(request)
    with _checked_in_process(request) as early:
        checked = request.network
        if request.friction == "auto":
            friction = choose_friction_terms(asked, request, step)
        elif request.network is not asked.network:
            friction = with_chosen_settings(asked, request, step)
        elif request.friction == "offset":
            friction = with_offsets(request, step)
        request = request if friction is None else friction.request
        same = request.network is checked
        with (
            estimator.beside(request) as begin,
            _checked_beside(request, step, early if same else None) as data_check,
        ):
            problem = prepare(request, None if friction is None else friction.settings, step)
            if begin is not None:
                problem = dataclasses.replace(problem, begun=begin(problem.settings))
            step("preparing patterns")
            # What is wrong with recordings is said now.
            _ = problem.patterns, problem.judged_patterns
            judged = estimator.judged(with_file_prior(with_friction(problem)))
            found = data_check()
    return _report(judged, friction, found)


def _report(judged: Judged, chosen: ChosenFriction | None, data_check: DataCheck | None) -> Report:
    """The report of a fit, with errors of all recordings."""
    terms, states, friction_notes = friction_results(judged, chosen)
    problem, fit, several = judged.problem, judged.fit, judged.results.get("several")
    request, network = problem.request, judged.fit.network
    errors = {
        name: compare(
            along_motion(network, patterns, fit.presliding_distance),
            patterns,
            {"fit": fit.k, **judged.vectors},
        )
        for name, patterns in problem.patterns.items()
    }
    excitation = None
    if request.previous is None:
        # Slopes of an estimator of its own change the columns of static friction alone.
        same = network.names == problem.network.names
        excited = problem.network if same and not network.load_terms else network
        excitation = degree_of_excitation(excited, problem.patterns["training"])
    if several is not None and data_check is not None:
        data_check, several = _one_message_each(data_check, several)
    held_out = judged.held_out
    consequences = [
        *judged.consequences,
        *(() if held_out is None else held_out.warnings),
        *fit_warnings(network, _recording_of(judged), fit.identification, errors["training"]),
    ]
    warnings = (
        *judged.warnings,
        *(() if several is None else several.agreement.warnings),
        *(consequences if data_check is None else data_check.unexplained(consequences)),
    )
    bodies = judged.results.get("possible")
    results = {
        **judged.results,
        "several": several,
        "bodies": None if bodies is None else bodies.parameters,
        "errors": MappingProxyType(errors),
        "excitation": excitation,
        "held_out": held_out,
        "groups": request.groups,
        "prior": request.prior,
        "warnings": warnings,
        "notes": (*problem.notes, *fit.notes, *friction_notes),
        "selection": problem.selection,
        "judged_part": None if problem.section is None else problem.section.description,
        "data_check": data_check,
        "horizon": _horizon(judged, states) if request.simulate else None,
        "friction": terms,
        "pre_sliding": states,
    }
    return Report(network, problem.settings, fit.identification, problem.patterns, results)


def _recording_of(judged: Judged) -> Recording:
    """Return what was fitted as one recording: several, as they were smoothed, in sequence."""
    if len(judged.problem.recordings) == 1:
        return judged.problem.main.recording
    together = judged.problem.patterns["training"]
    return Recording(together.time, together.q, together.torque)


def _horizon(judged: Judged, states: PreSlidingFit | None) -> HorizonError:
    """Errors of simulated motion: of the coefficients, of those with a state of dry friction, and
    of those of the robot's file."""
    problem, fit = judged.problem, judged.fit
    problem.step("simulating")
    coefficients: dict[str, Any] = {"fit": fit.k}
    presliding_distance: dict[str, np.ndarray] = {}
    if fit.presliding_distance.any():
        presliding_distance["fit"] = fit.presliding_distance
    elif states is not None:
        coefficients[PRE_SLIDING] = states.fit.k
        presliding_distance[PRE_SLIDING] = states.presliding_distance
    coefficients |= file_coefficients(fit.network)
    request = problem.request
    recording = request.validation or request.training[request.longest]
    return prediction_error(
        fit.network,
        coefficients,
        recording,
        problem.settings,
        presliding_distance=presliding_distance,
    )


@contextlib.contextmanager
def _checked_in_process(request: Request) -> Generator[Callable[[], DataCheck] | None]:
    """Begin the check of all recordings in a process of its own; None where there is none.

    Once XLA runs, no process can be forked. So the check begins before friction is chosen, and its
    result is of the network without what is chosen. `friction="auto"` nearly always chooses.
    """
    motion = request.training[request.longest].position
    if (
        request.checks
        and request.friction != "auto"
        and can_fork()
        and computed_on_host(request.network, motion)
    ):
        with computed_beside(lambda: _checked(request)) as result:
            yield result
    else:
        yield None


@contextlib.contextmanager
def _checked_beside(
    request: Request, step: Callable[[str], None], early: Callable[[], DataCheck] | None
) -> Generator[Callable[[], DataCheck | None]]:
    """A function that returns the check of all recordings: computed at once, or beside other work
    in a process or a thread.

    - `early`: waits for the check of this request, where it has begun already.
    """
    longest = request.training[request.longest]
    if not request.checks:
        yield lambda: None
    elif early is not None:
        yield early
    elif longest.samples >= SAMPLES_OF_THREADS:
        with ThreadPoolExecutor(1) as pool:
            yield pool.submit(_checked, request).result
    else:
        value = _checked(request, step)
        yield lambda: value


def _checked(request: Request, step: Callable[[str], None] = lambda words: None) -> DataCheck:
    """The check of all recordings, torques without the lag that is said of them."""
    settings = request.settings
    lag = 0.0 if settings is None else settings.preparation.torque_lag
    lag = request.options.get("torque_lag", lag)
    listed = dict(request.training)
    if request.validation is not None:
        listed[VALIDATION] = request.validation
    on_time = [without_lag(recording, lag) for recording in listed.values()]
    page = check(request.network, on_time, list(listed), progress=step)
    # Nothing is fitted to the validation recording: it need not move much.
    judged = [f for f in page.findings if f.kind != "tame motion" or f.recording != VALIDATION]
    return dataclasses.replace(page, findings=tuple(judged))


def _one_message_each(data_check: DataCheck, several: SeveralFit) -> tuple[DataCheck, SeveralFit]:
    """Merge the messages of each disagreement: the test says which recordings, the check the cause.

    The check compares each recording with the first, so that a first one that differs from all
    others has their cause.
    """
    agreement, training = several.agreement, list(several.patterns)
    findings = {
        finding.recording: finding
        for finding in data_check.findings
        if finding.kind in AGREEMENT_KINDS and finding.recording in training
    }
    if not findings or not any(agreement.differing.values()):
        return data_check, several
    findings.setdefault(training[0], next(iter(findings.values())))
    causes = {
        name: f"likely cause: {finding.cause}; remedy: {finding.remedy}"
        for name, finding in findings.items()
    }
    others = [some for some in data_check.findings if some is not findings.get(some.recording)]
    agreement = dataclasses.replace(agreement, causes=MappingProxyType(causes))
    return (
        dataclasses.replace(data_check, findings=tuple(others)),
        dataclasses.replace(several, agreement=agreement),
    )


def _by_name(
    training: Recording | Sequence[Recording] | Mapping[str, Recording],
) -> Mapping[str, Recording]:
    """Recordings by name, or by number from 1, without rows that repeat earlier ones."""
    if isinstance(training, Recording):
        training = {TRAINING: training}
    if not isinstance(training, Mapping):
        training = {f"recording {i}": recording for i, recording in enumerate(training, start=1)}
    return {name: without_repetition(recording) for name, recording in training.items()}
