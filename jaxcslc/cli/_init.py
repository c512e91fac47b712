"""The command `jaxcslc init`: a project file, decided by looking at a robot file and a log."""

import dataclasses
import json
import re
import tomllib
from collections.abc import Mapping, Sequence
from pathlib import Path
from typing import Annotated, Any

from .._plain_data import toml_document
from .._scratch import unfinished
from ..checks import DataCheck, check
from ..manipulator import Manipulator, RobotError
from ..network import derive
from ..recordings import (
    ColumnMapping,
    RecordingError,
    column_names_of,
    guessed_mapping,
    load_recording,
    mapping_by_values,
)
from ._common import Context, Output, command
from ._inputs import ColumnsOption, RecordingOptions, RobotPart, recording_of
from ._options import argument, option
from ._project import FILE


Entries = dict[str, Any]

# A correction of the mapping as a finding of the check states it.
_CORRECTION = re.compile(r'\[(\w+)\] (\w+) = ("[^"]*"|\[[\d., -]*\])')
_SHOWN = 20  # names of columns in a message
_OPTION = re.compile(r"--(decimate|period|torque-lag) ([\d.e-]+)")


@dataclasses.dataclass
class Decisions:
    """Entries of the project file so far, and what was decided, a line each."""

    entries: Entries
    lines: list[str]

    def decide(self, title: str, text: str, **entries: Any) -> None:
        """Add what was decided, and the entries that say so."""
        self.lines.append(f"{title + ':':<11} {text}")
        self.entries |= entries


@command("command", "init arm.urdf log.csv", "init arm.urdf log.csv --columns columns.toml")
def init_command(
    context: Context,
    file: Annotated[str, argument("ROBOT", "Robot file (.toml, .urdf, .xml).")],
    log: Annotated[Path, argument("LOG", "Recording of the robot.")],
    part: RobotPart,
    columns: ColumnsOption = None,
    overwrite: Annotated[bool, option(help=f"Replace a {FILE} that is there.")] = False,
) -> Output:
    """Write jaxcslc.toml, which says once what every command needs about a robot and its logs.

    Looks at the files, decides on joints, columns and units, and prints what it decided. Commands
    in this folder then need no ROBOT and none of these options. Edit the file to change a decision.
    """
    path = Path(FILE)
    if path.exists() and not overwrite:
        raise ValueError(f"{FILE}: exists already; expected none, or --overwrite")
    found = Decisions({"robot": file}, [])
    with context.progress("reading") as step:
        robot, part = _robot(file, part, found)
        mapping = _mapping(log, columns, robot, found)
        robot = _with_joints_of_log(file, log, robot, part, mapping, found)
        step("checking")
        page = _corrected(log, robot, mapping, found)
    found.decide(
        "friction", ", ".join(robot.friction_terms) + "; identify adds torque offsets that help"
    )
    with unfinished(path) as scratch:
        scratch.write_text(
            _text(found.entries, file, log), encoding="utf-8", errors="backslashreplace"
        )
    findings = [f"still wrong: {one}" for one in page.findings]
    closing = [
        f"To change a decision, edit the entry in {FILE} (docs/command.md). Next:",
        f"  jaxcslc check {log}",
        f"  jaxcslc identify {log}",
    ]
    return Output("\n".join([*found.lines, *findings, "", *closing]), lambda: found.entries, [path])


def _robot(file: str, part: RobotPart, found: Decisions) -> tuple[Manipulator, RobotPart]:
    """Return the robot, with joints that mimic others fixed where nothing is said of them."""
    stated = {
        name: value for name, value in dataclasses.asdict(part).items() if value not in (None, [])
    }
    found.entries |= stated
    try:
        return part.read(file), part
    except RobotError as error:
        if "mimic" not in str(error) or part.mimic is not None:
            raise
    part = dataclasses.replace(part, mimic="fix")
    robot = part.read(file)
    found.decide("mimic", "joints that mimic others are fixed (mimic)", mimic="fix")
    return robot, part


def _mapping(log: Path, stated: Path | None, robot: Manipulator, found: Decisions) -> Entries:
    """Return the mapping of the log's columns: empty where its format says everything."""
    if stated is not None:
        mapping = toml_document(stated, "file of column names", RecordingError)
        ColumnMapping.of(mapping, str(stated))
        found.decide("columns", f"as {stated} says (columns)")
        return mapping
    try:
        load_recording(log)
    except RecordingError:
        names = column_names_of(log)
        mapping = guessed_mapping(names, _names(robot)) or _by_values(log, names, robot, found)
        for quantity in ("time", "position", "velocity", "torque"):
            if (table := mapping.get(quantity)) is not None:
                columns, unit = table["columns"], table.get("unit", "SI units")
                unit = unit if isinstance(unit, str) else ", ".join(unit)
                shown = columns if isinstance(columns, str) else ", ".join(columns)
                found.decide("columns", f"{quantity} is {shown} in {unit} (columns.{quantity})")
        if "constant" in mapping["torque"]:
            text = "torques are motor currents: set constant and gear (columns.torque)"
            found.decide("columns", text)
        return mapping
    found.decide("columns", "recognised by their names")
    return {}


def _by_values(
    log: Path, names: Sequence[str], robot: Manipulator, found: Decisions
) -> dict[str, Any]:
    """Return the mapping that the columns' values suggest, and say what was assumed."""
    joints = robot.independent_joints
    limits = [(robot.joint_limits[joint].low, robot.joint_limits[joint].high) for joint in joints]
    try:
        kinds = [robot.kinds[joint] for joint in joints]
        slides = [i for i, kind in enumerate(kinds) if kind == "P"]
        mapping, assumed = mapping_by_values(log, _names(robot), limits, slides)
    except RecordingError as error:
        more = ", ..." if len(names) > _SHOWN else ""
        reason = str(error).removeprefix(f"{log}: ")
        raise RecordingError(
            f"{log}: its columns are {', '.join(names[:_SHOWN])}{more}. Neither their names nor"
            f" their values tell positions and torques: {reason}. Write them into a file for"
            f" --columns: {_SYNTAX}"
        ) from None
    found.decide("columns", f"assumed by their values: {assumed} (columns)")
    text = "if the torques are motor currents, set unit, constant and gear (columns.torque)"
    found.decide("columns", text)
    return mapping


_SYNTAX = (
    'time.columns = "t", position.columns = ["q1", "q2"], torque.columns = ["tau1", "tau2"], a line'
    " each (docs/recordings.md)"
)


def _names(robot: Manipulator) -> list[str]:
    return [robot.joint_names[joint] for joint in robot.independent_joints]


def _with_joints_of_log(
    file: str, log: Path, robot: Manipulator, part: RobotPart, mapping: Entries, found: Decisions
) -> Manipulator:
    """Return the robot with joints fixed that the log does not have."""
    names = _names(robot)
    columns = _columns(mapping)
    joints = None
    if columns is not None and columns.patterns:
        joints = columns.joints_in(column_names_of(log), names)
    recording = load_recording(log, joints, columns)
    count = recording.joints
    have = recording.joint_names or tuple(names[:count])
    if recording.joint_names is None and count > len(names):
        raise ValueError(
            f"{log}: has {count} joints, {file} has {len(names)}: {', '.join(names)}; expected a"
            " part with as many, by --base, --tip or --fix"
        )
    if missing := [name for name in names if name not in have]:
        if len(missing) == len(names):
            raise ValueError(
                f"{log}: has joints {', '.join(have)}, {file} has {', '.join(names)}; expected the"
                " same names, or joints = [...] in a file of --columns"
            )
        fixed = [*(part.fix or ()), *missing]
        robot = dataclasses.replace(part, fix=fixed).read(file)
        found.decide("fixed", f"{', '.join(missing)}: not in the log (fix)", fix=fixed)
    found.decide("joints", ", ".join(_names(robot)))
    return robot


def _columns(mapping: Mapping[str, Any]) -> ColumnMapping | None:
    return ColumnMapping.of(mapping) if mapping else None


def _corrected(log: Path, robot: Manipulator, mapping: Entries, found: Decisions) -> DataCheck:
    """Correct the mapping and the treatment of recordings by what the check finds.

    **Returns** the check of what comes out.
    """
    network = derive(robot, lengths="numeric" if robot.has_all_lengths else "symbolic")
    treatment: Entries = {}
    recording = recording_of(log, robot, _columns(mapping))
    for one in check(network, recording, [str(log)]).findings:
        for table, key, text in _CORRECTION.findall(one.remedy) if "..." not in one.remedy else ():
            value = tomllib.loads(f"value = {text}")["value"]
            entries = mapping.setdefault(table, {})
            if key == "sign" and key in entries:  # of another joint
                value = [
                    a * b for a, b in zip(value, _listed(entries[key], len(value)), strict=True)
                ]
            entries[key] = value
            found.decide("columns", f"{one.cause} (columns.{table}.{key})")
        for name, text in _OPTION.findall(one.remedy):
            key = name.replace("-", "_")
            treatment[key] = int(text) if key == "decimate" else float(text)
            found.decide("log", f"{one.cause} ({key})")
        if "--drop-stale" in one.remedy:
            treatment["drop_stale"] = True
            found.decide("log", f"{one.cause} (drop_stale)")
    found.entries |= treatment | ({"columns": mapping} if mapping else {})
    lag = treatment.pop("torque_lag", None)  # of the fit, not of the recording
    recording = RecordingOptions(**treatment).treated(
        recording_of(log, robot, _columns(mapping)), log
    )
    spent = float(recording.time[-1] - recording.time[0])
    rate = (recording.samples - 1) / spent
    found.decide("samples", f"{recording.samples} in {spent:.4g} s, {rate:.4g} Hz")
    page = check(network, recording, [str(log)])
    left = [one for one in page.findings if lag is None or one.kind != "torque lag"]
    return dataclasses.replace(page, findings=tuple(left))


def _listed(value: Any, count: int) -> list[Any]:
    return value if isinstance(value, list) else [value] * count


def _text(entries: Mapping[str, Any], file: str, log: Path) -> str:
    """Return the project file's text: plain entries first, then tables."""
    lines = [
        f"# Written by jaxcslc init from {file} and {log}.",
        "# Every command about this robot reads it from this folder. Options on the command line",
        "# win. All entries: docs/command.md",
        "",
    ]
    plain = {name: value for name, value in entries.items() if not isinstance(value, dict)}
    lines += [f"{name} = {_toml(value)}" for name, value in plain.items()]
    for name, mapping in entries.items():
        for table, values in mapping.items() if isinstance(mapping, dict) else ():
            if isinstance(values, dict):
                lines += ["", f"[{name}.{table}]"]
                lines += [f"{key} = {_toml(value)}" for key, value in values.items()]
            else:
                lines += ["", f"[{name}]", f"{table} = {_toml(values)}"]
    lines += [
        "",
        "# What excite keeps away from (docs/excitation.md), for example:",
        "# [limits.surroundings]",
        "# floor = 0.0",
    ]
    return "\n".join([*lines, ""])


def _toml(value: Any) -> str:
    return json.dumps(value, ensure_ascii=False)
