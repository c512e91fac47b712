"""Problem of an estimator: recordings of one robot, with settings, patterns and friction.

`prepare` chooses settings, one recording being several of one; `with_friction` then fits what the
network is not linear in (slopes of static friction, loads). `_identify` names the estimators.
"""

import contextlib
import dataclasses
from collections.abc import Callable, Generator, Mapping, Sequence
from functools import cached_property, partial
from types import MappingProxyType
from typing import Any, NamedTuple

import numpy as np

from ..bodies import (
    ChosenPrior,
    FilePrior,
    JudgedPart,
    Known,
    chosen_prior,
    with_knowledge,
)
from ..friction import LoadFit, SlopeFit, fit_load, fit_slopes
from ..least_squares import (
    RESULTS,
    Identification,
    LeastSquares,
    Settings,
    static_friction_joints,
)
from ..network import CSLC
from ..recordings import (
    Derivatives,
    Patterns,
    Preparation,
    Recording,
    Sampling,
    joined_patterns,
    static_fractions,
)
from ..selection import (
    Candidates,
    Segment,
    Selection,
    choose_settings,
    motion_part,
    section_of,
    sections_of,
    selection_with_motion,
)
from ..uncertainty import FOLDS, SystematicProblem, smoothing_bias
from ._exclusions import Request


# With the robot's file as prior: directions that change the torque less than this part of the most
# visible one are the file's. Their error by noise of a thousandth would be a hundred times a
# coefficient, and their values would cost the others their digits.
_RCOND = 1e-5
# Samples that a stretch has at least, where settings are chosen.
_FEWEST_OF_FOLD = 80
# What a single recording that is fitted is called, and the one that judges.
TRAINING, VALIDATION = "training recording", "validation recording"


class ChosenSettings(NamedTuple):
    """Settings that cross-validation selects.

    - `selection`: with every trial.
    - `network`: that they were selected for.
    - `motion`: the recording's derivatives under them, if they are known.
    """

    selection: Selection
    network: CSLC
    motion: Derivatives | None = None


@dataclasses.dataclass(frozen=True, eq=False)
class PreparedRecording:
    """A recording with the settings that it is prepared by.

    - `name`: what errors call it.
    - `motion`: its derivatives, where they are known.
    - `offsets`: (n,) constant torques that are taken off.
    """

    name: str
    recording: Recording
    settings: Settings
    motion: Derivatives | None = None
    offsets: np.ndarray | None = None

    @cached_property
    def derivatives(self) -> Derivatives:
        """Positions, velocities and accelerations."""
        if self.motion is not None:
            return self.motion
        with recording_named(self.name):
            return self.settings.preparation.derivatives(self.recording)

    @cached_property
    def patterns(self) -> Patterns:
        """Patterns of the recording, as a fit sees them."""
        with recording_named(self.name):
            patterns = self.settings.preparation.patterns(self.recording, self.derivatives)
        if self.offsets is None:
            return patterns
        return dataclasses.replace(patterns, torque=np.asarray(patterns.torque) - self.offsets)

    def without_static_friction(self, joints: Sequence[int]) -> "PreparedRecording":
        """Return the recording after joints, counted from 1, lost their term of static friction."""
        preparation = self.settings.preparation.without_static_friction(joints)
        settings = dataclasses.replace(self.settings, preparation=preparation)
        return dataclasses.replace(self, settings=settings, motion=self.derivatives)


@dataclasses.dataclass(frozen=True, eq=False)
class Problem:
    """Recordings of one robot, of which coefficients are wanted.

    **Attributes**

    - `request`: what is asked for. Its network is the one before slopes are fitted.
    - `network`: that least squares fit, with slopes of static friction.
    - `recordings`: by name, those that are fitted.
    - `validation`: the recording that only judges; None without one.
    - `settings`: of the longest recording and of the report.
    - `part`: of a long recording, what fits are judged on; None for all of it.
    - `section`: that part in words.
    - `selection`: how settings were chosen; None if they were given.
    - `slopes`, `load`: fits of static friction and of friction that follows the load.
    - `file`: the robot's file as prior; None without inertia in it, or where it is not asked for.
    - `alone`: the fit of `judged_patterns` that the file was weighed with; None without.
    - `systematic`: by recording, its systematic errors' problem, if the file was weighed with it.
    - `start`: coefficients that a search starts from.
    - `begun`: waits for fits that another process has begun with (`AbstractEstimator.beside`).
    - `warnings`: about recordings and settings; `notes`: what readers decided.
    - `step`: is called with a few words at the start of each step.
    """

    request: Request
    network: CSLC
    recordings: Mapping[str, PreparedRecording]
    validation: PreparedRecording | None
    settings: Settings
    part: PreparedRecording | None = None
    section: Segment | None = None
    selection: Selection | None = None
    slopes: SlopeFit | None = None
    load: LoadFit | None = None
    file: ChosenPrior | None = None
    alone: Identification | None = None
    systematic: Mapping[str, SystematicProblem] | None = None
    start: Identification | None = None
    begun: Callable[[], Any] | None = None
    warnings: tuple[str, ...] = ()
    notes: tuple[str, ...] = ()
    step: Callable[[str], None] = lambda words: None

    @property
    def solver(self) -> LeastSquares:
        """Options of least squares."""
        return self.settings.solver

    @property
    def main(self) -> PreparedRecording:
        """The longest recording."""
        return max(self.recordings.values(), key=lambda prepared: prepared.recording.samples)

    @property
    def judged(self) -> PreparedRecording:
        """The longest recording, or the part of it that fits are judged on."""
        return self.main if self.part is None else self.part

    @cached_property
    def patterns(self) -> Mapping[str, Patterns]:
        """Patterns of all fitted recordings, one after the other, as `"training"`; and of
        the one that judges as `"validation"`, if there is one."""
        patterns = {"training": joined([x.patterns for x in self.recordings.values()])}
        if self.validation is not None:
            patterns["validation"] = self.validation.patterns
        return MappingProxyType(patterns)

    @property
    def judged_patterns(self) -> Patterns:
        """Patterns of training recordings that fits are judged on."""
        return self.patterns["training"] if self.part is None else self.part.patterns

    @cached_property
    def known(self) -> Mapping[int, Known]:
        """Coefficients of `network` that are known beforehand, by index."""
        return self.known_of(self.network)

    def known_of(self, network: CSLC) -> Mapping[int, Known]:
        """Return the coefficients of a network of the same robot that are known beforehand."""
        prior = self.request.prior
        return {} if prior is None else prior.coefficient_values(network)

    @cached_property
    def on_time(self) -> Mapping[str, Recording]:
        """Training recordings by name, torques without the lag that settings say."""
        return {name: without_lag(x.recording, self.lag) for name, x in self.recordings.items()}

    def systematic_problems(self) -> Mapping[str, SystematicProblem]:
        """Return problems of the systematic errors of recordings, or of the part that is judged."""
        if self.systematic is not None:
            return self.systematic
        (first, *_) = self.recordings
        listed = self.recordings if self.part is None else {first: self.part}
        return {
            name: SystematicProblem.of(self.network, x.recording, x.settings, x.derivatives)
            for name, x in listed.items()
        }

    def informed(
        self,
        fit: Identification,
        known: Mapping[int, Known] | None = None,
        *,
        smoothed: bool = True,
    ) -> Identification:
        """Return a fit with what is known beforehand, by the robot's file and by the request.

        - `known`: coefficients that are known; those of `network` if None.
        - `smoothed`: whether the fit is of smoothed motion.
        """
        known = self.known if known is None else known
        if self.file is None:
            return with_knowledge(fit, known)
        file = self.file.of_fit(fit, smoothed=smoothed)
        return with_knowledge(fit, known, file.prior.rows)

    def informed_part(self, part: JudgedPart) -> JudgedPart:
        """Return a part of the motion whose fit knows what is known beforehand."""
        base = with_knowledge(part.fit, self.known)
        if self.file is None:
            return part._replace(fit=base)
        fit = with_knowledge(part.fit, self.known, self.file.prior.rows)
        return part._replace(fit=fit, base=base)

    @property
    def file_prior(self) -> FilePrior | None:
        """The robot's file as prior; None if it is not used."""
        return None if self.file is None else self.file.prior

    @property
    def lag(self) -> float:
        """Delay of torques behind positions [s]."""
        return self.settings.preparation.torque_lag

    def with_recordings(
        self, change: Callable[[PreparedRecording], PreparedRecording]
    ) -> "Problem":
        """The problem with all of its recordings changed."""
        validation, part = self.validation, self.part
        return dataclasses.replace(
            self,
            recordings={name: change(prepared) for name, prepared in self.recordings.items()},
            validation=None if validation is None else change(validation),
            part=None if part is None else change(part),
        )

    def without_static_friction(self, joints: Sequence[int]) -> "Problem":
        """The problem when joints, counted from 1, mask their slow pairs again."""
        changed = self.with_recordings(lambda x: x.without_static_friction(joints))
        return dataclasses.replace(changed, settings=changed.main.settings)


def prepare(
    request: Request, chosen: ChosenSettings | None, step: Callable[[str], None]
) -> Problem:
    """Prepare recordings by settings that are given or chosen on the longest one.

    Training recordings that were sampled in another way get a smoothing of their own; so does the
    validation recording. Where regressors do not fit into memory, one recording is judged on a part
    of it, and several are cut.

    - `chosen`: settings, where they are chosen already.

    **Returns** the problem, whose network is that of the request.

    **Raises** `ValueError`: a recording that cannot be used, by name.
    """
    network = request.network
    training, section, cut = _within_memory(request)
    main = max(training, key=lambda name: training[name].samples)
    part = training[main] if section is None else section.recording
    called = {name: name if len(training) > 1 else TRAINING for name in training}
    with recording_named(called[main]):
        if request.settings is None and chosen is None:
            chosen = select_settings(request, step)
        selection = None if chosen is None else chosen.selection
        motion = None if chosen is None else chosen.motion
        settings = basic_settings(request, chosen)
        if selection is not None and motion_part(settings.preparation) != motion_part(
            selection.settings.preparation
        ):
            motion = None
        warnings = [f"{called[main]}: {sentence}" for sentence in settings.check(training[main])]
        settings = settings.for_network(network)
    choose = selection is not None

    def prepared(name: str, recording: Recording, memory: float = np.inf) -> PreparedRecording:
        """Another recording, by settings that suit it."""
        suited, sentences = settings_for_another(
            network, settings, part, recording, name, choose=choose, memory=memory
        )
        warnings.extend(sentences)
        return PreparedRecording(name, recording, suited)

    recordings = {
        name: PreparedRecording(called[name], recording, settings, None if section else motion)
        if name == main
        else prepared(name, recording)
        for name, recording in training.items()
    }
    listed = {called[name]: recording for name, recording in training.items()}
    validation = None
    if request.validation is not None:
        listed[VALIDATION] = request.validation
        validation = prepared(VALIDATION, request.validation, request.memory)
    notes = [f"{name}: {note}" for name, recording in listed.items() for note in recording.notes]
    return Problem(
        request,
        network,
        recordings,
        validation,
        settings,
        part=None if section is None else PreparedRecording(called[main], part, settings, motion),
        section=section,
        selection=selection,
        warnings=tuple(warnings),
        notes=(*network.robot.notes, *notes, *cut),
        step=step,
    )


def with_friction(problem: Problem) -> Problem:
    """Fit what the network is not linear in: slopes of static friction, or the friction's load.

    **Returns** the problem with a network that is linear. Joints that lose their term of static
    friction mask their slow pairs again, unless masks were set.
    """
    request, network, solver = problem.request, problem.network, problem.solver
    if request.previous is not None:
        return problem
    load, slopes = None, None
    if network.load_terms:
        problem.step("fitting friction that follows the load")
        load = fit_load(network, problem.judged.patterns, solver=solver)
        slopes = load.slopes
    elif "static" in network.robot.friction_terms:
        problem.step("fitting slopes of static friction")
        slopes = fit_slopes(network, problem.judged.patterns, solver=solver)
    given = request.settings
    automatic = given is None or given.preparation.threshold_fraction is None
    if slopes is not None and slopes.dropped and automatic:
        # Slow pairs of these joints have no term that explains them any more.
        problem = problem.without_static_friction(slopes.dropped)
        patterns = problem.judged.patterns
        if load is not None:
            load = fit_load(load.network, patterns, solver=solver)
            slopes = slopes if load.slopes is None else load.slopes.after(slopes)
        elif "static" in slopes.network.robot.friction_terms:
            again = fit_slopes(slopes.network, patterns, solver=solver, start=slopes.slopes)
            slopes = again.after(slopes)
        else:
            slopes = dataclasses.replace(slopes, fit=solver.fit(slopes.network, patterns))
    fitted = load or slopes
    network = network if fitted is None else fitted.network
    return dataclasses.replace(problem, network=network, slopes=slopes, load=load)


def with_file_prior(problem: Problem) -> Problem:
    """Make the robot's file a prior of all fits, if it has inertial parameters."""
    request = problem.request
    if not request.has_file_prior:
        return problem
    problem.step("weighing the robot's file")
    patterns = problem.judged_patterns
    fit = problem.solver.fit(problem.network, patterns, throw=False)
    if not np.all(np.isfinite(np.asarray(fit.k))):
        return problem
    systematic = problem.systematic_problems()
    bias = smoothing_bias(list(systematic.values()), np.asarray(fit.k))
    if not np.all(np.isfinite(bias)):
        bias = None
    file = chosen_prior(problem.network, patterns, problem.solver, fit, bias)
    warnings = () if file is None else file.weight.warnings
    # Of too few equations, the estimator's own fit raises.
    alone = None if bool(fit.result == RESULTS.no_equations) else fit
    return dataclasses.replace(
        problem,
        file=file,
        alone=alone,
        systematic=systematic,
        warnings=(*problem.warnings, *warnings),
    )


def has_bodies(request: Request) -> bool:
    """Return whether the robot's file is a prior: whether it has masses."""
    return request.has_file_prior and FilePrior.of(request.network) is not None


def with_file_bodies(
    request: Request, network: CSLC, fit: Identification
) -> Callable[[Any], Any] | None:
    """Return what adds the bodies of the robot's file to fits of the same coefficients, of all
    samples or of some (`FoldFit`); None without such bodies.

    - `network`: of the fits.
    - `fit`: of all samples: it shows how correlated errors are.
    """
    prior = FilePrior.of(request.network) if request.has_file_prior else None
    if prior is None:
        return None
    return partial(with_knowledge, known={}, rows=prior.of_fit(network, fit).rows)


def select_settings(request: Request, step: Callable[[str], None]) -> ChosenSettings:
    """Select settings by cross-validation within the longest recording, some set in advance."""
    step("choosing settings")
    recording = judged_part(request)
    candidates = Candidates.suited_to(recording, request.network)
    if "torque_lag" in request.options:
        candidates = dataclasses.replace(candidates, torque_lags=(request.options["torque_lag"],))
    folds = request.folds
    if folds is None:
        folds = max(2, min(FOLDS, recording.samples // _FEWEST_OF_FOLD))
    selection, motion = selection_with_motion(request.network, recording, candidates, folds=folds)
    return ChosenSettings(selection, request.network, motion)


def judged_part(request: Request) -> Recording:
    """Return the longest recording, or the part of it that fits are judged on."""
    training, section, _ = _within_memory(request)
    if section is not None:
        return section.recording
    return max(training.values(), key=lambda some: some.samples)


def basic_settings(request: Request, chosen: ChosenSettings | None) -> Settings:
    """Return settings that are given or chosen, with the options of the request.

    Slow pairs determine a term of static friction: where joints got one after settings were chosen,
    their thresholds become those that `Candidates.suited_to` tries for such joints.
    """
    settings = request.settings
    if chosen is not None:
        settings = chosen.selection.settings
        fraction = settings.preparation.threshold_fraction
        before, after = map(static_friction_joints, (chosen.network, request.network))
        new = [has and not had for had, has in zip(before, after, strict=True)]
        if fraction is not None and any(new):
            usual = np.broadcast_to(fraction, len(new)).tolist()
            fractions = (
                float(np.max(static_fractions(value, [joint])))
                for value, joint in zip(usual, new, strict=True)
            )
            settings = settings.with_options(threshold_fraction=tuple(fractions))
        if request.has_file_prior:
            # Knowledge is weighed against the noise of each joint.
            settings = settings.with_options(joint_weights="residual", rcond=_RCOND)
    assert settings is not None
    return settings.with_options(**request.options)


def _within_memory(
    request: Request,
) -> tuple[Mapping[str, Recording], Segment | None, list[str]]:
    """Training recordings that are fitted, the part of a single one that fits are judged on (None
    for all of it), and sentences about several that were cut."""
    training, memory = request.training, request.memory
    if len(training) == 1:
        return training, section_of(request.network, training[request.longest], memory), []
    cut, sentences = sections_of(request.network, training, memory)
    return cut, None, sentences


def settings_for_another(
    network: CSLC,
    settings: Settings,
    training: Recording,
    recording: Recording,
    name: str,
    *,
    choose: bool,
    memory: float,
) -> tuple[Settings, list[str]]:
    """Return the settings to prepare another recording with, and warnings about them.

    - `training`: that settings are of.
    - `name`: what warnings call the other recording.
    - `choose`: whether it may get settings of its own; `memory`: as of `identify`.
    """
    chosen_on = settings.chosen_on or Sampling.of(training)
    differences = settings.preparation.check(recording, chosen_on)
    if not differences:
        return settings, []
    warning = f"{name}: {'; '.join(differences)}"
    if not choose:
        return settings, [warning]
    section = None if memory == np.inf else section_of(network, recording, memory)
    recording = recording if section is None else section.recording
    candidates = Candidates.suited_to(recording, network).keeping(settings)
    try:
        adapted = choose_settings(network, recording, candidates).settings
    except ValueError as error:  # too short, or too little motion to choose by
        return settings, [f"{warning}; no smoothing of its own: {error}"]
    return adapted, [f"{warning}; prepared by settings of its own: {adapted.preparation}"]


def joined(patterns: Sequence[Patterns]) -> Patterns:
    """Return patterns one after the other; of a single one itself."""
    return patterns[0] if len(patterns) == 1 else joined_patterns(list(patterns))


def without_lag(recording: Recording, lag: float) -> Recording:
    """Return the recording, its torques so much earlier [s]."""
    torque = Preparation(torque_lag=lag).aligned(recording.time, recording.torque)
    return dataclasses.replace(recording, torque=torque)


@contextlib.contextmanager
def recording_named(name: str) -> Generator[None]:
    """Put in front of an error's message which recording it is about."""
    try:
        yield
    except ValueError as error:
        raise ValueError(f"{name}: {error}") from None
