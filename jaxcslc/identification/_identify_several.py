import dataclasses
from collections.abc import Callable, Mapping, Sequence
from types import MappingProxyType
from typing import Any

from ..motion import Patterns, Recording, joined_patterns
from ..network import CSLC
from ._held_out import held_out_error, left_out_error
from ._identify_one import selected_settings, settings_for_another
from ._settings import Settings
from .checks import AGREEMENT_KINDS, DataCheck
from .friction import SlopeFit, fit_slopes
from .possible import Choice, Part, judged_bodies
from .prior import Prior, with_knowledge
from .report import Report, compare, degree_of_excitation, fit_warnings
from .selection import sections_of
from .several import RecordingAgreement, fit_recordings
from .systematic import SystematicError, systematic_error


def identify_several(
    network: CSLC,
    training: Mapping[str, Recording],
    validation: Recording | None,
    settings: Settings | None,
    *,
    options: Mapping[str, Any],
    folds: int | None,
    memory: float,
    offsets: bool,
    systematic: bool,
    possible: Choice,
    prior: Prior | None,
    data_check: DataCheck | None,
    step: Callable[[str], None],
) -> Report:
    """What `identify` does with several recordings.

    Settings are chosen on the longest; recordings that were sampled in another way get a smoothing
    of their own. Slopes of static friction are those of the longest. Each has a share of the
    memory by its length; of what is longer, a section is used.

    - `data_check`: of all recordings, the one for validation included.
    """
    step("choosing settings")
    training, parts = sections_of(network, training, memory)
    main = max(training, key=lambda name: training[name].samples)
    selection = None
    if settings is None:
        selection, _ = selected_settings(network, training[main], options, folds)
        settings = selection.settings
    settings = settings.with_options(**options)
    automatic = selection is not None
    base = settings.for_network(network)
    notes = [*network.robot.notes]
    notes += [f"{name}: {note}" for name, some in training.items() for note in some.notes]
    notes += [] if validation is None else [f"validation: {note}" for note in validation.notes]
    notes += parts
    warnings = [f"{main}: {sentence}" for sentence in settings.check(training[main])]
    by_recording = {main: base}
    for name, recording in training.items():
        if name != main:
            by_recording[name], sentences = settings_for_another(
                network, base, training[main], recording, name, choose=automatic
            )
            warnings += sentences
    step("preparing patterns")
    patterns = {name: by_recording[name].patterns(training[name]) for name in training}
    slopes: SlopeFit | None = None
    if "static" in network.robot.friction_terms:
        step("fitting slopes of static friction")
        slopes = fit_slopes(network, patterns[main], solver=base.solver)
        network = slopes.network
        warnings += slopes.warnings
    step("fitting coefficients")
    several = fit_recordings(network, patterns, base.solver, offsets=offsets)
    shifts: SystematicError | None = None
    if systematic:
        step("computing systematic errors")
        several, shifts = several.allowing_for(
            {
                name: systematic_error(network, recording, by_recording[name], several.alone[name])
                for name, recording in training.items()
            }
        )
    if data_check is not None:
        data_check, agreement = _joined(data_check, several.agreement, list(training))
        several = dataclasses.replace(several, agreement=agreement)
    known = {} if prior is None else prior.coefficient_values(network)
    fit = with_knowledge(several.fit, known)
    together = joined_patterns(list(several.patterns.values()))
    if shifts is not None:
        shifts = shifts.without([i for i, entry in known.items() if entry.fixed])
    vectors = {}
    bodies, held_out, sentences = judged_bodies(
        network,
        fit,
        together,
        lambda: Part.recordings(network, several.patterns, several.without),
        choice=possible,
        prior=prior,
        source="left-out recording",
        systematic=lambda: shifts,
        step=step,
    )
    consequences = [*sentences]
    if bodies is not None:
        fit, vectors = bodies.fit, bodies.other_coefficients
    step("computing errors")
    judged: dict[str, Patterns] = {"training": together}
    if validation is None and held_out is None:
        held_out = left_out_error(network, several.patterns, fit, several.without)
    elif validation is not None:
        suited, sentences = settings_for_another(
            network,
            base,
            training[main],
            validation,
            "validation recording",
            choose=automatic,
            memory=memory,
        )
        warnings += sentences
        judged["validation"] = suited.patterns(validation)
        held_out = held_out_error(network, fit, judged["training"], judged["validation"])
    errors = {
        name: compare(network, values, {"fit": fit.k, **vectors}) for name, values in judged.items()
    }
    warnings += several.agreement.warnings
    consequences += () if held_out is None else held_out.warnings
    recording = Recording(together.time, together.q, together.torque)
    consequences += fit_warnings(network, recording, fit, errors["training"])
    warnings += consequences if data_check is None else data_check.unexplained(consequences)
    return Report(
        network,
        base,
        fit,
        MappingProxyType(judged),
        errors=MappingProxyType(errors),
        excitation=degree_of_excitation(network, judged["training"]),
        held_out=held_out,
        slopes=slopes,
        systematic=shifts,
        warnings=tuple(warnings),
        selection=selection,
        bodies=None if bodies is None else bodies.parameters,
        possible=bodies,
        prior=prior,
        several=several,
        data_check=data_check,
        notes=tuple(notes),
    )


def _joined(
    data_check: DataCheck, agreement: RecordingAgreement, training: Sequence[str]
) -> tuple[DataCheck, RecordingAgreement]:
    """One message of each disagreement: the test says which recordings, the check the cause.

    The check compares each recording with the first, so that a first one that differs from all
    others has their cause.
    """
    findings = {
        finding.recording: finding
        for finding in data_check.findings
        if finding.kind in AGREEMENT_KINDS and finding.recording in training
    }
    if not findings or not any(agreement.differing.values()):
        return data_check, agreement
    findings.setdefault(training[0], next(iter(findings.values())))
    causes = {
        name: f"likely cause: {finding.cause}; remedy: {finding.remedy}"
        for name, finding in findings.items()
    }
    others = [some for some in data_check.findings if some is not findings.get(some.recording)]
    return (
        dataclasses.replace(data_check, findings=tuple(others)),
        dataclasses.replace(agreement, causes=MappingProxyType(causes)),
    )
