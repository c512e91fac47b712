import contextlib
import dataclasses
from collections.abc import Callable, Generator, Mapping, Sequence
from functools import cached_property, partial
from types import MappingProxyType
from typing import Any

import numpy as np

from .._processes import prepared_beside
from ..motion import Derivatives, Patterns, Preparation, Recording, Sampling
from ..network import CSLC
from ._held_out import cross_validated_error, held_out_error
from ._settings import Settings
from .checks import DataCheck
from .friction import SlopeFit, fit_load, fit_slopes, linearised
from .possible import Choice, Part, judged_bodies
from .prior import Known, Prior, with_knowledge
from .report import Report, compare, degree_of_excitation, fit_warnings
from .selection import (
    Candidates,
    Section,
    Selection,
    choose_settings,
    section_of,
    selection_with_motion,
)
from .solver import Identification, LeastSquares, Previous, computed_on_host
from .systematic import SystematicError, SystematicProblem


# Stretches that settings are chosen by, and how many samples each has at least.
_FOLDS, _FEWEST_OF_FOLD = 8, 80


@dataclasses.dataclass(frozen=True)
class _Prepared:
    """Recordings with the settings that they are prepared by.

    - `recordings`: `training`, and `validation` if there is one.
    - `settings`: of each.
    - `part`: of the training recording, where memory allows no more; or all of it.
    - `section`: which part that is, if it is one.
    - `selection`: how the settings were chosen, if they were.
    - `notes`: what readers of the robot and of recordings decided.
    - `warnings`: about the recordings and their settings.
    - `motion`: derivatives of `part`, if the choice of settings has left them.
    """

    recordings: Mapping[str, Recording]
    settings: Mapping[str, Settings]
    part: Recording
    section: Section | None
    selection: Selection | None
    notes: tuple[str, ...]
    warnings: tuple[str, ...]
    motion: Derivatives | None

    @property
    def of_training(self) -> Settings:
        """The settings of the training recording."""
        return self.settings["training"]

    @cached_property
    def derivatives(self) -> Mapping[str, Derivatives]:
        """Those of all recordings, and by the name `"part"` those of the part."""
        derivatives: dict[str, Derivatives] = {}
        if self.motion is not None:
            derivatives["part" if self.section else "training"] = self.motion
        for name, recording in self.recordings.items():
            if name not in derivatives:
                with recording_named(name):
                    derivatives[name] = self.settings[name].preparation.derivatives(recording)
        if self.section is None:
            derivatives["part"] = derivatives["training"]
        elif "part" not in derivatives:
            derivatives["part"] = self.of_training.preparation.derivatives(self.part)
        return MappingProxyType(derivatives)

    def patterns(self) -> tuple[Mapping[str, Patterns], Patterns]:
        """Those of all recordings, and those of the part."""
        patterns: dict[str, Patterns] = {}
        for name, recording in self.recordings.items():
            with recording_named(name):
                patterns[name] = self.settings[name].preparation.patterns(
                    recording, self.derivatives[name]
                )
        whole = patterns["training"]
        if self.section is None:
            return MappingProxyType(patterns), whole
        part = self.of_training.preparation.patterns(self.part, self.derivatives["part"])
        return MappingProxyType(patterns), part

    def without_static_friction(self, joints: Sequence[int]) -> "_Prepared":
        """When joints, counted from 1, have lost their term of static friction."""
        return dataclasses.replace(
            self,
            settings={
                name: dataclasses.replace(
                    settings, preparation=settings.preparation.without_static_friction(joints)
                )
                for name, settings in self.settings.items()
            },
        )


def identify_one(
    network: CSLC,
    training: Recording,
    validation: Recording | None,
    settings: Settings | None,
    *,
    previous: Previous | None,
    groups: Sequence[str] | None,
    options: Mapping[str, Any],
    folds: int | None,
    systematic: bool,
    possible: Choice,
    prior: Prior | None,
    memory: float,
    data_check: Callable[[], DataCheck | None],
    step: Callable[[str], None],
    with_settings: Callable[[Settings], None] = lambda settings: None,
) -> Report:
    """What `identify` does with one recording; arguments as there.

    - `data_check`: waits for the check of all recordings, if they are checked.
    - `with_settings`: is called with settings once these are known.
    """
    automatic_masks = settings is None or settings.preparation.threshold_fraction is None
    step("choosing settings")
    prepared = _prepared(network, training, validation, settings, options, folds, memory)
    with_settings(prepared.of_training)
    step("preparing patterns")
    patterns, part_patterns = prepared.patterns()
    slopes, load = None, None
    if previous is None and network.load_terms:
        step("fitting friction that follows the load")
        load = fit_load(network, part_patterns, solver=prepared.of_training.solver)
        if load.slopes is not None and load.slopes.dropped and automatic_masks:
            prepared = prepared.without_static_friction(load.slopes.dropped)
            patterns, part_patterns = prepared.patterns()
            dropped = load.slopes
            load = fit_load(load.network, part_patterns, solver=prepared.of_training.solver)
            slopes = dropped if load.slopes is None else load.slopes.after(dropped)
        else:
            slopes = load.slopes
        network = load.network
    elif previous is None and "static" in network.robot.friction_terms:
        step("fitting slopes of static friction")
        slopes = fit_slopes(network, part_patterns, solver=prepared.of_training.solver)
        if slopes.dropped and automatic_masks:
            # Slow pairs of these joints have no term that explains them any more.
            prepared = prepared.without_static_friction(slopes.dropped)
            patterns, part_patterns = prepared.patterns()
            slopes = _fitted_again(slopes, part_patterns, prepared.of_training.solver)
        network = slopes.network
    settings = prepared.of_training
    known = {} if prior is None else prior.coefficient_values(network)
    step("fitting coefficients")
    vectors: dict[str, Any] = {}
    consequences: list[str] = []
    bodies, held_out = None, None
    # Before the fit, since JAX's threads begin with it.
    with prepared_beside(
        partial(_shifts, network, prepared, groups, known),
        allowed=systematic and computed_on_host(network, prepared.part.position),
    ) as begin_systematic:
        if load is not None:
            whole = prepared.section is None
            fit = (
                load.fit
                if whole
                else settings.fit(*linearised(network, load.fit.k, patterns["training"]))
            )
        elif slopes is not None and prepared.section is None:
            fit = slopes.fit
        elif previous is None or groups is None:
            fit = settings.fit(network, patterns["training"])
        else:
            fit = settings.reidentify(network, patterns["training"], previous, groups)
            vectors = {"before": previous.k if isinstance(previous, Identification) else previous}
        fit = with_knowledge(fit, known)
        systematic_shifts: Callable[[], SystematicError | None] = lambda: None
        if systematic:
            step("computing systematic errors")
            systematic_shifts = begin_systematic((np.asarray(fit.k), np.asarray(fit.determined)))
        if previous is None:
            bodies, held_out, sentences = judged_bodies(
                network,
                fit,
                part_patterns,
                lambda: Part.stretches(network, part_patterns, settings.solver, _FOLDS),
                choice=possible,
                prior=prior,
                systematic=systematic_shifts,
                step=step,
            )
            consequences += sentences
        shifts = systematic_shifts()
    if bodies is not None:
        fit, vectors = bodies.fit, bodies.other_coefficients
    if network.load_terms and previous is None:
        network = network.with_load(np.asarray(fit.k))
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
    consequences += () if held_out is None else held_out.warnings
    consequences += fit_warnings(network, training, fit, errors["training"])
    checked = data_check()
    warnings = [
        *prepared.warnings,
        *(() if slopes is None else slopes.warnings),
        *(() if load is None else load.warnings),
        *(consequences if checked is None else checked.unexplained(consequences)),
    ]
    return Report(
        network,
        settings,
        fit,
        patterns,
        errors=MappingProxyType(errors),
        excitation=excitation,
        held_out=held_out,
        slopes=slopes,
        systematic=shifts,
        groups=None if groups is None else tuple(groups),
        warnings=tuple(warnings),
        selection=prepared.selection,
        bodies=None if bodies is None else bodies.parameters,
        possible=bodies,
        prior=prior,
        data_check=checked,
        judged_part=None if prepared.section is None else prepared.section.description,
        notes=prepared.notes,
    )


def _shifts(
    network: CSLC,
    prepared: _Prepared,
    groups: Sequence[str] | None,
    known: Mapping[int, Known],
) -> Callable[[tuple[np.ndarray, np.ndarray]], SystematicError]:
    """A function of a fit's coefficients, and which of them are determined, that returns its
    systematic errors; none of what was fixed."""
    problem = SystematicProblem.of(
        network, prepared.part, prepared.of_training, prepared.derivatives["part"]
    )
    fixed = [i for i, entry in known.items() if entry.fixed]
    return lambda fitted: problem.error(*fitted, groups).without(fixed)


def _prepared(
    network: CSLC,
    training: Recording,
    validation: Recording | None,
    settings: Settings | None,
    options: Mapping[str, Any],
    folds: int | None,
    memory: float,
) -> _Prepared:
    """The settings of the training recording, chosen or as they are, and of the validation's."""
    section = section_of(network, training, memory)
    part = training if section is None else section.recording
    with recording_named("training"):
        selection, motion = (
            selected_settings(network, part, options, folds) if settings is None else (None, None)
        )
        base = settings if selection is None else selection.settings
        assert base is not None
        selected, base = base, base.with_options(**options)
        before, after = selected.preparation, base.preparation
        if (before.smoothing, before.velocity) != (after.smoothing, after.velocity):
            motion = None
        of_training = base.for_network(network)
    warnings = [f"training recording: {sentence}" for sentence in base.check(training)]
    recordings, by_recording = {"training": training}, {"training": of_training}
    if validation is not None:
        recordings["validation"] = validation
        by_recording["validation"], sentences = settings_for_another(
            network, of_training, part, validation, choose=selection is not None, memory=memory
        )
        warnings += sentences
    notes = [*network.robot.notes]
    for name, recording in recordings.items():
        notes += [f"{name} recording: {sentence}" for sentence in recording.notes]
    return _Prepared(
        recordings, by_recording, part, section, selection, tuple(notes), tuple(warnings), motion
    )


def selected_settings(
    network: CSLC, recording: Recording, options: Mapping[str, Any], folds: int | None
) -> tuple[Selection, Derivatives | None]:
    """The settings that cross-validation selects, some options set in advance; and as of
    `selection_with_motion`."""
    candidates = Candidates.suited_to(recording, network)
    if "torque_lag" in options:
        candidates = dataclasses.replace(candidates, torque_lags=(options["torque_lag"],))
    if folds is None:
        folds = max(2, min(_FOLDS, recording.samples // _FEWEST_OF_FOLD))
    return selection_with_motion(network, recording, candidates, folds=folds)


def _fitted_again(slopes: SlopeFit, patterns: Patterns, solver: LeastSquares) -> SlopeFit:
    """The fit of slopes to other patterns, without the joints that have lost the term."""
    network = slopes.network
    if "static" not in network.robot.friction_terms:
        return dataclasses.replace(slopes, fit=solver.fit(network, patterns))
    return fit_slopes(network, patterns, solver=solver, start=slopes.slopes).after(slopes)


def settings_for_another(
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


def without_lag(recording: Recording, lag: float) -> Recording:
    """The recording, its torques so much earlier [s]."""
    torque = Preparation(torque_lag=lag).aligned(recording.time, recording.torque)
    return dataclasses.replace(recording, torque=torque)


@contextlib.contextmanager
def recording_named(recording: str) -> Generator[None]:
    """Adds to an error's message which recording it is about."""
    try:
        yield
    except ValueError as error:
        raise ValueError(f"{recording} recording: {error}") from None


def without_progress(step: str) -> None:
    del step
