from collections.abc import Callable, Mapping, Sequence
from pathlib import Path
from typing import TYPE_CHECKING, Any, get_args

import typer

from .._processes import processes_beside
from ..identification import (
    EstimatorChoice,
    MaximumLikelihood,
    Report,
    Settings,
    identify,
    load_prior,
)
from ..identification.possible import Choice
from ..identification.report import (
    SavedReport,
    check_output_folder,
    load_report,
    load_settings,
    replaced_files,
)
from ..manipulator import Manipulator
from ..network import CSLC
from ._cluster import identified_on_cluster
from ._common import (
    BaseOption,
    ColumnsOption,
    CommandContext,
    CoupledOption,
    FixOption,
    FrictionOption,
    LengthsOption,
    MimicOption,
    OutputOption,
    RobotOrSystemArgument,
    SettingsOption,
    TipOption,
    check_inputs_are_kept,
    check_no_robot_options,
    choice_of,
    command_text,
    is_system,
    names_in,
    network_of,
    one_line_errors,
    progress,
    recordings_of,
    robot_named,
    typed_options,
    without_none,
)
from ._identify_options import (
    ChecksOption,
    DaskOption,
    EstimatorOption,
    FleetOption,
    FoldsOption,
    HorizonOption,
    LikelihoodEveryOption,
    LossOption,
    MemoryOption,
    OffsetsOption,
    PossibleOption,
    PreviousOption,
    PriorOption,
    ReidentifyOption,
    SystematicOption,
    TorqueLagOption,
    TrainingArgument,
    ValidationOption,
)
from ._recording_options import (
    BetweenOption,
    DespikeOption,
    DropStaleOption,
    EveryOption,
    MeasuredOption,
    PeriodOption,
    RecordingOptions,
)


if TYPE_CHECKING:
    from ..systems import SystemReport


def identify_command(
    context: CommandContext,
    robot: RobotOrSystemArgument,
    train: TrainingArgument,
    validate: ValidationOption = None,
    output: OutputOption = Path("identified"),
    lengths: LengthsOption = "auto",
    base: BaseOption = None,
    tip: TipOption = None,
    fix: FixOption = None,
    mimic: MimicOption = None,
    friction: FrictionOption = None,
    coupled: CoupledOption = None,
    settings: SettingsOption = None,
    columns: ColumnsOption = None,
    estimator: EstimatorOption = "least-squares",
    likelihood_every: LikelihoodEveryOption = None,
    offsets: OffsetsOption = False,
    between: BetweenOption = None,
    every: EveryOption = None,
    period: PeriodOption = None,
    drop_stale: DropStaleOption = False,
    despike: DespikeOption = False,
    measured: MeasuredOption = None,
    torque_lag: TorqueLagOption = None,
    loss: LossOption = None,
    folds: FoldsOption = None,
    check: ChecksOption = True,
    reidentify: ReidentifyOption = None,
    previous: PreviousOption = None,
    systematic: SystematicOption = True,
    possible: PossibleOption = "auto",
    prior: PriorOption = None,
    memory: MemoryOption = 2.0,
    horizon: HorizonOption = False,
    dask: DaskOption = None,
    fleet: FleetOption = False,
) -> None:
    """Identify a robot's coefficients from recordings of positions and torques.

    Or those of another system, from a recording with a column for each of its variables.
    """
    known = estimator == "least-squares"  # the time that it takes
    with one_line_errors(), progress("reading", estimated=known) as step, processes_beside():
        _check_output(context, output)
        if dask is not None or fleet:
            return typer.echo(identified_on_cluster(context, step))
        if is_system(robot):
            check_no_robot_options(context, robot)
            report = _identified_system(robot, train, validate, settings, step)
        else:
            arm = robot_named(robot, base, tip, fix, mimic)
            saved = _previous_report(context, arm, previous)
            options = {
                **_refitted(saved, reidentify),
                **_choices(context.params),
                "options": without_none(torque_lag=torque_lag, loss=loss),
            }
            preparation = _settings(settings, saved)
            report = _identified(context, arm, saved, (train, validate), preparation, options, step)
        text = _written(report, output, context, step)
    typer.echo(text)


def _check_output(context: CommandContext, output: Path) -> None:
    """**Raises** `ValueError` for a folder that results cannot go to, or that they must not."""
    check_output_folder(output)
    check_inputs_are_kept(context, replaced_files(output))


def _identified(
    context: CommandContext,
    robot: Manipulator,
    saved: SavedReport | None,
    files: tuple[Sequence[Path], Path | None],
    settings: Settings | None,
    options: Mapping[str, Any],
    step: Callable[[str], None],
) -> Report:
    """The report of a robot.

    - `files`: recordings to fit, and one to judge the fit on or none.
    - `options`: further arguments of `identify`.
    """
    train, validate = files
    reading = RecordingOptions.of(context.params)
    recordings = recordings_of(train, lambda path: reading.read(path, robot))
    return identify(
        _network(context, robot, saved),
        recordings,
        None if validate is None else reading.read(validate, robot),
        settings,
        **_as_they_are(context.params),
        **options,
        progress=step,
    )


def _network(context: CommandContext, robot: Manipulator, saved: SavedReport | None) -> CSLC:
    """That of a previous report, or with the friction of the options or of the robot's file."""
    if saved is not None:
        return saved.network
    lengths, friction = context.params["lengths"], context.params["friction"]
    pairs: list[str] = list(context.params["coupled"] or ())
    coupled = pairs or None
    return network_of(robot, lengths, None if friction == "auto" else friction, coupled)


def _previous_report(
    context: CommandContext, robot: Manipulator, path: Path | None
) -> SavedReport | None:
    """The identification that `--previous` names, of which a part is to be fitted again."""
    if (context.params["reidentify"] is None) != (path is None):
        raise ValueError("--reidentify and --previous: expected both or neither")
    if path is None:
        return None
    if typed_options(context) & {"lengths", "friction", "coupled"}:
        raise ValueError("--lengths, --friction and --coupled: not with --previous, which has them")
    return load_report(path, robot)


def _refitted(saved: SavedReport | None, groups: str | None) -> dict[str, Any]:
    """What is fitted again, as arguments of `identify`."""
    return {
        "previous": None if saved is None else saved.fit,
        "groups": None if groups is None else names_in(groups),
    }


def _as_they_are(options: Mapping[str, Any]) -> dict[str, Any]:
    """Options that are arguments of `identify`, by its names."""
    names = {name: name for name in ("offsets", "folds", "systematic", "memory", "horizon")}
    friction = "auto" if options["friction"] == "auto" else None
    as_typed = {name: options[option] for name, option in {**names, "checks": "check"}.items()}
    return {**as_typed, "friction": friction}


def _choices(options: Mapping[str, Any]) -> dict[str, Any]:
    """The estimator, and what is asked and known of bodies, as arguments of `identify`."""
    prior = None if options["prior"] is None else load_prior(options["prior"])
    every = options["likelihood_every"]
    return {
        "estimator": choice_of("--estimator", options["estimator"], get_args(EstimatorChoice)),
        "possible": choice_of("--possible", options["possible"], get_args(Choice)),
        "prior": prior,
        "likelihood": None if every is None else MaximumLikelihood(every=every),
    }


def _written(
    report: "Report | SystemReport",
    output: Path,
    context: CommandContext,
    step: Callable[[str], None],
) -> str:
    """Writes a report. **Returns** what is printed of it."""
    step("writing")
    paths = report.save(output, command=command_text(context))
    return f"{report}\n\n{report.verdict}\n\nwrote " + ", ".join(str(path) for path in paths)


def _settings(path: Path | None, saved: SavedReport | None) -> Settings | None:
    """Those of a file, or of a previous report, or none."""
    if path is not None:
        return load_settings(path)
    return None if saved is None else saved.settings


def _identified_system(
    name: str,
    train: Sequence[Path],
    validate: Path | None,
    settings: Path | None,
    step: Callable[[str], None],
) -> "SystemReport":
    """The report of another system."""
    from ..systems import (  # robots need not wait for it
        identify_system,
        load_system,
        load_system_recording,
    )

    if len(train) > 1:
        raise ValueError(f"several recordings are of robots; {name} is another system")
    system = load_system(name)
    return identify_system(
        system,
        load_system_recording(train[0], system),
        None if validate is None else load_system_recording(validate, system),
        None if settings is None else load_settings(settings),
        progress=step,
    )
