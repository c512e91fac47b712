import contextlib
import dataclasses
from collections.abc import Callable, Generator, Mapping, Sequence
from types import MappingProxyType
from typing import Any, get_args

import jax.numpy as jnp
import numpy as np

from ..motion import Patterns, Preparation, Recording, Sampling
from ..network import CSLC
from ._held_out import cross_validated_error, held_out_error
from ._identify_several import identify_several
from ._settings import Settings
from ._slopes import SlopeFit, fit_slopes
from ._systematic import systematic_error
from .checks import DataCheck, check
from .possible import Choice, Part, judged_bodies
from .prior import Prior, with_knowledge
from .report import Report, compare, degree_of_excitation, fit_warnings
from .selection import Candidates, Selection, choose_settings, section_of
from .solver import Identification, LeastSquares, Previous


# Stretches that settings are chosen by, and how many samples each has at least.
_FOLDS, _FEWEST_OF_FOLD = 8, 80


def identify(
    network: CSLC,
    training: Recording | Sequence[Recording] | Mapping[str, Recording],
    validation: Recording | None = None,
    settings: Settings | None = None,
    *,
    offsets: bool = False,
    previous: Previous | None = None,
    groups: Sequence[str] | None = None,
    options: Mapping[str, Any] | None = None,
    folds: int | None = None,
    checks: bool = True,
    systematic: bool = True,
    possible: Choice = "auto",
    prior: Prior | None = None,
    memory: float = 2.0,
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
    - `offsets`: of several recordings, fit a constant torque of each joint in each of them along.
    - `previous`: an identification of the same network, or its (p,) coefficients. Only the
      coefficients of `groups` are then fitted; all others are fixed at these (thesis 5.2.4).
    - `groups`: coefficients to re-identify, by group (`"viscous"`, `"dry"`, ...) or name.
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
      on a part of it (`report.judged_part` says which).
    - `progress`: is called with a few words at the start of each step.

    **Returns** a `Report`.

    **Raises**

    - `ValueError`: only one of `previous` and `groups`; groups or a previous identification that
      are not the network's; a recording that cannot be used, named as training or validation
      recording.
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
    _check_arguments(network, previous, groups, possible, prior)
    step = progress or without_progress
    by_name = (
        {"training recording": training} if isinstance(training, Recording) else _by_name(training)
    )
    data_check = None
    if checks:
        lag = 0.0 if settings is None else settings.preparation.torque_lag
        lag = (options or {}).get("torque_lag", lag)
        data_check = _checked(network, by_name, validation, lag, step)
    if len(by_name) > 1:
        if previous is not None:
            raise ValueError("identify: previous is for one recording, got several")
        if options or folds is not None:
            raise ValueError("identify: options and folds are for one recording, got several")
        return identify_several(
            network,
            by_name,
            validation,
            settings,
            offsets=offsets,
            systematic=systematic,
            possible=possible,
            prior=prior,
            adapted=_for_validation,
            data_check=data_check,
            step=step,
        )
    (training,) = by_name.values()
    if offsets:
        raise ValueError(
            "identify: offsets are of several recordings; for one use the friction term 'offset'"
        )
    section = section_of(network, training, memory)
    part = training if section is None else section.recording
    automatic_masks = settings is None or settings.preparation.threshold_fraction is None
    step("choosing settings")
    recordings = {"training": training}
    by_recording: dict[str, Settings] = {}
    with recording_named("training"):
        if settings is None:
            selection = _selected(network, part, options or {}, folds)
            base_settings = selection.settings
        else:
            selection, base_settings = None, settings
        base_settings = base_settings.with_options(**(options or {}))
        by_recording["training"] = base_settings.for_network(network)
    warnings = [*network.robot.notes]
    warnings += [f"training recording: {sentence}" for sentence in training.notes]
    warnings += [f"training recording: {sentence}" for sentence in base_settings.check(training)]
    if validation is not None:
        warnings += [f"validation recording: {sentence}" for sentence in validation.notes]
        recordings["validation"] = validation
        by_recording["validation"], sentences = _for_validation(
            network,
            by_recording["training"],
            part,
            validation,
            choose=settings is None,
            memory=memory,
        )
        warnings += sentences
    settings = by_recording["training"]
    step("preparing patterns")
    patterns = _patterns(by_recording, recordings)
    part_patterns = patterns["training"]
    if section is not None:
        part_patterns = settings.patterns(part)
    slopes = None
    if previous is None and "static" in network.robot.friction_terms:
        step("fitting slopes of static friction")
        slopes = fit_slopes(network, part_patterns, solver=settings.solver)
        network = slopes.network
        if slopes.dropped and automatic_masks:
            # Slow pairs of these joints have no term that explains them any more.
            by_recording = _without_static_friction(by_recording, slopes.dropped)
            settings = by_recording["training"]
            patterns = _patterns(by_recording, recordings)
            part_patterns = patterns["training"] if section is None else settings.patterns(part)
            slopes = _fitted_again(slopes, part_patterns, settings.solver)
            network = slopes.network
    step("fitting coefficients")
    vectors = {}
    if slopes is not None and section is None:
        fit = slopes.fit
    elif previous is None or groups is None:
        fit = settings.fit(network, patterns["training"])
    else:
        fit = settings.reidentify(network, patterns["training"], previous, groups)
        vectors = {"before": previous.k if isinstance(previous, Identification) else previous}
    known = {} if prior is None else prior.coefficient_values(network)
    fit = with_knowledge(fit, known)
    shifts = None
    if systematic:
        step("computing systematic errors")
        shifts = systematic_error(network, part, settings, fit, groups=groups)
        shifts = shifts.without([i for i, entry in known.items() if entry.fixed])
    bodies, held_out = None, None
    if previous is None:
        bodies, held_out, sentences = judged_bodies(
            network,
            fit,
            part_patterns,
            lambda: Part.stretches(network, part_patterns, settings.solver, _FOLDS),
            choice=possible,
            prior=prior,
            systematic=shifts,
            step=step,
        )
        warnings += sentences
    if bodies is not None:
        fit, vectors = bodies.fit, bodies.other_coefficients
    step("computing errors")
    errors = {
        name: compare(network, values, {"fit": fit.k, **vectors})
        for name, values in patterns.items()
    }
    excitation = degree_of_excitation(network, patterns["training"]) if previous is None else None
    if validation is not None:
        held_out = held_out_error(network, fit, patterns["training"], patterns["validation"])
    elif previous is None and held_out is None:
        held_out = cross_validated_error(network, part_patterns, settings, fit=fit)
    warnings += () if slopes is None else slopes.warnings
    warnings += () if held_out is None else held_out.warnings
    warnings += fit_warnings(network, training, fit, errors["training"])
    return Report(
        network,
        settings,
        fit,
        patterns,
        MappingProxyType(errors),
        excitation,
        held_out,
        slopes,
        shifts,
        None if groups is None else tuple(groups),
        tuple(warnings),
        selection,
        bodies=None if bodies is None else bodies.parameters,
        possible=bodies,
        prior=prior,
        data_check=data_check,
        judged_part=None if section is None else section.description,
    )


def _check_arguments(
    network: CSLC,
    previous: Previous | None,
    groups: Sequence[str] | None,
    possible: Choice,
    prior: Prior | None,
) -> None:
    """**Raises** `ValueError` for arguments that exclude each other or are not the network's."""
    if (previous is None) != (groups is None):
        raise ValueError("identify: got one of previous and groups; expected both or neither")
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


def _checked(
    network: CSLC,
    training: Mapping[str, Recording],
    validation: Recording | None,
    lag: float,
    step: Callable[[str], None],
) -> DataCheck:
    """The check of all recordings, torques so much earlier [s]."""
    listed = training if validation is None else {**training, "validation recording": validation}
    on_time = [_without_lag(recording, lag) for recording in listed.values()]
    return check(network, on_time, list(listed), progress=step)


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


def _without_lag(recording: Recording, lag: float) -> Recording:
    """The recording, its torques so much earlier [s]."""
    torque = Preparation(torque_lag=lag).aligned(recording.time, recording.torque)
    return dataclasses.replace(recording, torque=torque)


def _selected(
    network: CSLC, recording: Recording, options: Mapping[str, Any], folds: int | None
) -> Selection:
    """The settings that cross-validation selects, some options set in advance."""
    candidates = Candidates.suited_to(recording, network)
    if "torque_lag" in options:
        candidates = dataclasses.replace(candidates, torque_lags=(options["torque_lag"],))
    if folds is None:
        folds = max(2, min(_FOLDS, recording.samples // _FEWEST_OF_FOLD))
    return choose_settings(network, recording, candidates, folds=folds)


def _without_static_friction(
    by_recording: Mapping[str, Settings], joints: Sequence[int]
) -> dict[str, Settings]:
    """The settings when joints, counted from 1, have lost their term of static friction."""
    return {
        name: dataclasses.replace(
            settings, preparation=settings.preparation.without_static_friction(joints)
        )
        for name, settings in by_recording.items()
    }


def _fitted_again(slopes: SlopeFit, patterns: Patterns, solver: LeastSquares) -> SlopeFit:
    """The fit of slopes to other patterns, without the joints that have lost the term."""
    network = slopes.network
    if "static" not in network.robot.friction_terms:
        return dataclasses.replace(slopes, fit=solver.fit(network, patterns))
    again = fit_slopes(network, patterns, solver=solver, start=slopes.slopes)
    lost = np.isin(np.arange(1, network.joint_count + 1), slopes.dropped)
    return dataclasses.replace(
        again,
        slope_error=jnp.where(lost, jnp.inf, again.slope_error),
        dropped=tuple(sorted({*slopes.dropped, *again.dropped})),
        warnings=(*slopes.warnings, *again.warnings),
    )


def _for_validation(
    network: CSLC,
    settings: Settings,
    training: Recording,
    validation: Recording,
    name: str = "validation recording",
    *,
    choose: bool,
    memory: float = np.inf,
) -> tuple[Settings, list[str]]:
    """The settings to prepare another recording with, and warnings about them.

    - `name`: what warnings call it.
    - `memory`: as of `identify`.
    """
    chosen_on = settings.chosen_on or Sampling.of(training)
    differences = settings.preparation.check(validation, chosen_on)
    if not differences:
        return settings, []
    warning = f"{name}: {'; '.join(differences)}"
    if not choose:
        return settings, [warning]
    section = None if memory == np.inf else section_of(network, validation, memory)
    validation = validation if section is None else section.recording
    candidates = Candidates.suited_to(validation, network).keeping(settings)
    try:
        adapted = choose_settings(network, validation, candidates).settings
    except ValueError as error:  # too short, or too little motion to choose by
        return settings, [f"{warning}; no smoothing of its own: {error}"]
    return adapted, [f"{warning}; prepared by settings of its own: {adapted.preparation}"]


def _patterns(
    settings: Mapping[str, Settings], recordings: Mapping[str, Recording]
) -> Mapping[str, Patterns]:
    patterns: dict[str, Patterns] = {}
    for name, recording in recordings.items():
        with recording_named(name):
            patterns[name] = settings[name].patterns(recording)
    return MappingProxyType(patterns)


@contextlib.contextmanager
def recording_named(recording: str) -> Generator[None]:
    """Adds to an error's message which recording it is about."""
    try:
        yield
    except ValueError as error:
        raise ValueError(f"{recording} recording: {error}") from None


def without_progress(step: str) -> None:
    del step
