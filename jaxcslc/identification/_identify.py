import contextlib
import dataclasses
from collections.abc import Callable, Generator, Mapping, Sequence
from concurrent.futures import ThreadPoolExecutor
from typing import Any, Literal, get_args

from .._processes import can_fork, computed_beside
from ..motion import Recording
from ..network import CSLC
from ._identify_friction import ChosenFriction, choose_friction_terms
from ._identify_one import identify_one, without_lag, without_progress
from ._identify_several import identify_several
from ._settings import Settings
from .checks import DataCheck, check
from .estimators import (
    EstimatorChoice,
    check_estimator,
    fits_beside,
    with_instruments,
    with_likelihood,
    within_memory,
)
from .likelihood import MaximumLikelihood
from .possible import Choice
from .prediction import file_coefficients, prediction_error
from .prior import Prior
from .report import Report
from .selection import PRE_SLIDING
from .solver import Previous, computed_on_host


# From here on recordings are checked beside what follows: of shorter ones NumPy's operations take
# so little that threads wait for the interpreter.
_SAMPLES_OF_THREADS = 8192


def identify(
    network: CSLC,
    training: Recording | Sequence[Recording] | Mapping[str, Recording],
    validation: Recording | None = None,
    settings: Settings | None = None,
    *,
    estimator: EstimatorChoice = "least-squares",
    likelihood: MaximumLikelihood | None = None,
    offsets: bool = False,
    previous: Previous | None = None,
    groups: Sequence[str] | None = None,
    friction: Literal["auto"] | None = None,
    options: Mapping[str, Any] | None = None,
    folds: int | None = None,
    checks: bool = True,
    systematic: bool = True,
    possible: Choice = "auto",
    prior: Prior | None = None,
    memory: float = 2.0,
    horizon: bool = False,
    progress: Callable[[str], None] | None = None,
) -> Report:
    """Identifies a robot's coefficients from a recording, and judges the result.

    Chooses settings, prepares patterns, fits the slopes of static friction where the network has
    it, fits the coefficients, and evaluates excitation and torque errors: on the validation
    recording or, without one, by cross-validation within the training recording.
    `jaxcslc identify` prints and saves the report that this function returns.

    **Arguments**

    - `network`: n joints, p coefficients.
    - `training`: the recording to fit; or several, in a list or by name. Each is then prepared
      according to its own sampling and weighted by its own noise, settings are chosen on the
      longest, and the report tests whether they agree (`report.several.agreement`).
    - `validation`: a recording to judge the fit on; no coefficient depends on it.
    - `settings`: of preparation and fit; by default those that `choose_settings` finds for the
      training recording. A validation recording that was sampled in another way (a coarser
      encoder, another rate, irregular time stamps) then gets a smoothing of its own; with
      settings set here it gets a warning.
    - `estimator`: `"least-squares"` on smoothed motion; `"maximum-likelihood"`, which needs no
      smoothing (`MaximumLikelihood`); `"auto"` fits both, and uses the latter where it predicts
      motion that was not fitted better by more than chance: the validation recording or, without
      one, the last quarter of each training recording. `report.estimators` compares them.
      `"instrumental-variables"` is of one recording, without possible bodies and systematic errors
      (`InstrumentalVariables`); a note says whether least squares is biased.
    - `likelihood`: how maximum likelihood is fitted; its torque sampling and settings are those of
      the report.
    - `offsets`: of several recordings, fit a constant torque of each joint in each of them along.
    - `previous`: an identification of the same network, or its (p,) coefficients. Only the
      coefficients of `groups` are then fitted; all others are fixed at these (thesis 5.2.4).
    - `groups`: coefficients to re-identify, by group (`"viscous"`, `"dry"`, ...) or name.
    - `friction`: `"auto"` adds friction terms where they predict motion that was left out better,
      joint by joint (`choose_friction`), and then tries a pre-sliding state of dry friction
      (`fit_pre_sliding`); `report.friction` says what each was worth, and `report.pre_sliding` is
      the fit with states, where a joint gains by them. Maximum likelihood is fitted with their
      lengths, and compared with least squares with states. Not with `previous`.
    - `options`: of `Preparation` and `LeastSquares`, set whatever the settings are, such as
      `{"torque_lag": 0.02, "loss": "huber"}`.
    - `folds`: as of `choose_settings`; by default 8, or fewer where the recording is short.
    - `checks`: look for wrong units, signs, times and samples first; see `check`.
    - `systematic`: widen intervals by errors that residuals do not show, and let verdicts know
      them; see `systematic_error`. It costs about one more fit.
    - `possible`: `"auto"` also fits possible bodies (`physical_parameters`) and uses their
      coefficients where they predict motion that was not fitted better than the free fit does, by
      more than noise; `"always"` uses them in any case, `"never"` does not compute them. See
      `PossibleFit`. Not with `previous`.
    - `prior`: what is known of coefficients and links: fixed, bounded, or a value with its error,
      by name. What is known of links makes the coefficients of possible bodies be used, which alone
      can follow it. Not with `previous`.
    - `memory`: that may be used [GB], about. Coefficients are fitted to all samples of one training
      recording, however long; where its regressor does not fit, settings are chosen and fits judged
      on a part of it (`report.judged_part` says which). Of several recordings that do not fit
      together, parts are used throughout, as `report.notes` say.
    - `horizon`: also simulate the identified arm open loop from states of the validation recording
      (or of the longest training recording), beside the one of the robot's file and that with a
      pre-sliding state, where one is used, and report how far its positions are off after 0.1 to
      5 s (`report.horizon`).
    - `progress`: is called with a few words at the start of each step.

    **Returns** a `Report`.

    **Raises**

    - `ValueError`: an unknown estimator, or one that cannot do what else is asked for; only one of
      `previous` and `groups`; groups or a previous identification that are not the network's; a
      recording that cannot be used, named as training or validation recording.
    - `RuntimeError`: a fit that fails, as of `LeastSquares.fit`; with `possible="always"` also as
      of `physical_parameters`.
    - `ImportError`: with `possible="always"`, where the conic solver is needed and not installed.

    >>> import numpy as np, jaxcslc as jc
    >>> pendulum = jc.Manipulator.from_modified_dh([(0, 0, 0, 0)], gravity=(0, -9.81, 0))
    >>> network = jc.derive(pendulum, lengths="numeric")
    >>> t = np.arange(1000)[:, None] * 0.01
    >>> q, qd, qdd = np.sin(t), np.cos(t), -np.sin(t)
    >>> torque = np.asarray(network.torque(np.array([0.5, 0.3, -0.1, 0.2, 0.05]), q, qd, qdd))
    >>> report = jc.identify(network, jc.Recording(t[:, 0], q, torque), settings=jc.Settings())
    >>> np.round(report.k, 3).tolist()
    [0.5, 0.3, -0.1, 0.2, 0.05]
    """
    _check_arguments(network, previous, groups, possible, prior, friction)
    step = progress or without_progress
    by_name = (
        {"training recording": training} if isinstance(training, Recording) else _by_name(training)
    )
    check_estimator(
        estimator,
        previous=previous is not None,
        offsets=offsets,
        recordings=len(by_name),
        possible=possible,
        likelihood=likelihood,
    )
    if estimator == "instrumental-variables":
        possible, systematic = "never", False
    choice: ChosenFriction | None = None
    if friction == "auto":
        choice = choose_friction_terms(
            network,
            by_name,
            settings,
            estimator=estimator,
            likelihood=likelihood,
            prior=prior,
            options=options or {},
            memory=memory,
            horizon=horizon,
            step=step,
        )
        network, likelihood = choice.terms.network, choice.likelihood
    _check_load(network, estimator, len(by_name), horizon)
    lag = 0.0 if settings is None else settings.preparation.torque_lag
    lag = (options or {}).get("torque_lag", lag)
    together = len(by_name) > 1
    longest = max(by_name.values(), key=lambda recording: recording.samples)
    beside = checks and not together
    threads = beside and longest.samples >= _SAMPLES_OF_THREADS
    forked = beside and can_fork() and computed_on_host(network, longest.position)
    progress_of_checks = without_progress if threads or forked else step
    with fits_beside(
        network,
        by_name,
        likelihood or MaximumLikelihood(),
        held_out=validation is None,
        allowed=(
            not together
            and estimator in ("maximum-likelihood", "auto")
            and not _with_bodies(possible, prior, likelihood)
            and within_memory(network, by_name, memory)
        ),
    ) as fits:
        with _computed(
            lambda: (
                _checked(network, by_name, validation, lag, progress_of_checks) if checks else None
            ),
            forked=forked,
            threads=threads,
        ) as data_check:
            if together:
                if previous is not None:
                    raise ValueError("identify: previous is for one recording, got several")
                report = identify_several(
                    network,
                    by_name,
                    validation,
                    settings,
                    options=options or {},
                    folds=folds,
                    memory=memory,
                    offsets=offsets,
                    systematic=systematic,
                    possible=possible,
                    prior=prior,
                    data_check=data_check(),
                    step=step,
                )
            else:
                if offsets:
                    raise ValueError(
                        "identify: offsets are of several recordings; for one use the friction term"
                        " 'offset'"
                    )
                report = identify_one(
                    network,
                    next(iter(by_name.values())),
                    validation,
                    settings,
                    previous=previous,
                    groups=groups,
                    options=options or {},
                    folds=folds,
                    systematic=systematic,
                    possible=possible,
                    prior=prior,
                    memory=memory,
                    data_check=data_check,
                    step=step,
                    with_settings=(lambda settings: None) if fits is None else fits.begin,
                )
        if estimator == "instrumental-variables":
            recording = next(iter(by_name.values()))
            report = with_instruments(report, recording, prior=prior, step=step)
        elif estimator != "least-squares":
            report = with_likelihood(
                report,
                network,
                by_name,
                validation,
                estimator=estimator,
                likelihood=likelihood,
                possible=possible,
                prior=prior,
                memory=memory,
                step=step,
                beside=fits,
            )
    if choice is not None:
        report = choice.of_report(report, step)
    if report.pre_sliding is not None:
        report = dataclasses.replace(report, notes=(*report.notes, _note_of_states(report)))
    if horizon:
        step("simulating")
        report = _with_horizon(report, validation or longest)
    return report


def _note_of_states(report: Report) -> str:
    """What has states of dry friction, and what has it as a step."""
    assert report.pre_sliding is not None
    joints = ", ".join(report.pre_sliding.joint_names)
    if report.lengths.any():
        return (
            f"{PRE_SLIDING} of {joints}: a state along the motion, in the coefficients and errors"
            " of this report, simulated motion and C code; robot files have dry friction as a step"
        )
    return (
        f"{PRE_SLIDING} of {joints}: a state along the motion, in report.pre_sliding,"
        " identification.json, simulated motion and C code; all else, robot files included, has"
        " dry friction as a step"
    )


def _with_horizon(report: Report, recording: Recording) -> Report:
    """The report with errors of simulated motion: of its coefficients, of those with a state of dry
    friction, and of those of the robot's file."""
    coefficients, lengths = {"fit": report.k}, {}
    if report.lengths.any():
        lengths["fit"] = report.lengths
    elif report.pre_sliding is not None:
        coefficients[PRE_SLIDING] = report.pre_sliding.fit.k
        lengths[PRE_SLIDING] = report.pre_sliding.lengths
    coefficients |= file_coefficients(report.network)
    error = prediction_error(
        report.network, coefficients, recording, report.settings, lengths=lengths
    )
    return dataclasses.replace(report, horizon=error)


def _with_bodies(
    possible: Choice, prior: Prior | None, likelihood: MaximumLikelihood | None
) -> bool:
    """Whether the search of maximum likelihood may be one of possible bodies."""
    priors = (prior, None if likelihood is None else likelihood.prior)
    return possible == "always" or any(prior is not None and prior.links for prior in priors)


def _check_arguments(
    network: CSLC,
    previous: Previous | None,
    groups: Sequence[str] | None,
    possible: Choice,
    prior: Prior | None,
    friction: Literal["auto"] | None,
) -> None:
    """**Raises** `ValueError` for arguments that exclude each other or are not the network's."""
    if any(inertia.has_known for inertia in network.robot.inertia):
        raise ValueError(
            f"identify: {network.name!r} has known masses or centres of gravity in its algebra,"
            " which LeastSquares.fit takes; here say them as links of the prior"
        )
    if (previous is None) != (groups is None):
        raise ValueError("identify: got one of previous and groups; expected both or neither")
    if friction not in ("auto", None):
        raise ValueError(
            f"friction: expected 'auto' or None, got {friction!r}; terms are those of the network"
        )
    if friction is not None and previous is not None:
        raise ValueError("friction: is of a fit of all coefficients, not with previous")
    if possible not in get_args(Choice):
        raise ValueError(f"possible: expected {', '.join(get_args(Choice))}, got {possible!r}")
    if possible == "always" and previous is not None:
        raise ValueError("possible: bodies are of a fit of all coefficients, not with previous")
    if prior is not None:
        if previous is not None:
            raise ValueError("prior: is of a fit of all coefficients, not with previous")
        if prior.links and possible == "never":
            raise ValueError("prior, links: possible bodies alone can follow it; got 'never'")
        prior.coefficient_values(network)
        prior.link_values(network.robot)


def _check_load(network: CSLC, estimator: str, recordings: int, horizon: bool) -> None:
    """**Raises** `ValueError` for what knows no friction that follows the load."""
    if not network.load_terms:
        return
    others = (
        (estimator != "least-squares", f"the estimator {estimator!r}"),
        (recordings > 1, "several recordings in one fit"),
        (horizon, "prediction over a horizon"),
    )
    for wanted, what in others:
        if wanted:
            kinds = " and ".join(repr(term.kind) for term in network.load_terms)
            raise ValueError(f"identify: friction of kind {kinds} is not for {what}")


def _checked(
    network: CSLC,
    training: Mapping[str, Recording],
    validation: Recording | None,
    lag: float,
    step: Callable[[str], None],
) -> DataCheck:
    """The check of all recordings, torques so much earlier [s]."""
    name = "validation recording"
    listed = training if validation is None else {**training, name: validation}
    on_time = [without_lag(recording, lag) for recording in listed.values()]
    page = check(network, on_time, list(listed), progress=step)
    # Nothing is fitted to the validation recording: it need not move much.
    judged = [f for f in page.findings if f.kind != "tame motion" or f.recording != name]
    return dataclasses.replace(page, findings=tuple(judged))


@contextlib.contextmanager
def _computed(
    compute: Callable[[], DataCheck | None], *, forked: bool, threads: bool
) -> Generator[Callable[[], DataCheck | None]]:
    """A function that returns what `compute` does: at once, or beside other work."""
    if forked:
        with computed_beside(compute) as result:
            yield result
    elif threads:
        with ThreadPoolExecutor(1) as pool:
            yield pool.submit(compute).result
    else:
        value = compute()
        yield lambda: value


def _by_name(training: Sequence[Recording] | Mapping[str, Recording]) -> dict[str, Recording]:
    """Recordings by name, or by number from 1."""
    named = (
        dict(training)
        if isinstance(training, Mapping)
        else {f"recording {i}": recording for i, recording in enumerate(training, start=1)}
    )
    if not named:
        raise ValueError("identify: got no recording; expected one or more")
    return named
