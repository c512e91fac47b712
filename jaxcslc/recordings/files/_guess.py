"""Guess of a mapping for logs of unknown formats, by words of their column names."""

import re
from collections.abc import Sequence
from typing import Any


# Words of column names, by quantity: the first quantity with a word of a name is meant.
_WORDS = {
    "velocity": {"velocity", "vel", "speed", "qd", "dq", "qdot", "omega"},
    "acceleration": {"acceleration", "acc", "accel", "qdd", "ddq"},
    "torque": {"torque", "trq", "tau", "effort", "moment"},
    "current": {"current", "cur", "curr", "amps", "amp"},
    "position": {"position", "pos", "q", "angle", "theta", "encoder", "enc"},
}
_JOINT = {"joint", "axis", "j", "deg", "rad", "actual", "act", "measured"}  # alone: positions
_TIME = {"time", "timestamp", "stamp", "t", "clock", "sec", "seconds"}
_COMMANDED = {"command", "commanded", "cmd", "desired", "des", "target", "ref", "reference", "set"}
_UNITS = {
    "time": {"ms": "ms", "us": "us", "ns": "ns", "msec": "ms"},
    "position": {"deg": "deg", "degree": "deg", "degrees": "deg", "mrad": "mrad"},
    "velocity": {"deg": "deg/s", "degs": "deg/s", "rpm": "rpm"},
    "torque": {"mnm": "mN m", "knm": "kN m"},
    "current": {"ma": "mA"},
}


def guessed_mapping(names: Sequence[str], joints: Sequence[str]) -> dict[str, Any] | None:
    """Guess which columns are time, positions, velocities and torques, by words of their names.

    **Arguments**

    - `names`: of the columns.
    - `joints`: of the robot.

    **Returns** a mapping as in `docs/recordings.md`; None if there are no positions or no torques.

    >>> from jaxcslc.recordings import guessed_mapping
    >>> names = ["stamp_ms", "A1_deg_pos", "A2_deg_pos", "A1_tau", "A2_tau"]
    >>> mapping = guessed_mapping(names, ("shoulder", "elbow"))
    >>> mapping["time"]
    {'columns': 'stamp_ms', 'unit': 'ms'}
    >>> mapping["position"]
    {'columns': ['A1_deg_pos', 'A2_deg_pos'], 'unit': 'deg'}
    """
    groups: dict[str, list[str]] = {}
    mapping: dict[str, Any] = {}
    for template, columns in _groups(names, joints).items():
        words = _words(template)
        kind = next((kind for kind, known in _WORDS.items() if words & known), None)
        if kind is None and words and words <= _JOINT:
            kind = "position"
        if kind is None or words & _COMMANDED or len(columns) <= len(groups.get(kind, [])):
            continue
        groups[kind] = [columns[key] for key in sorted(columns)]
        if kind == "position" and "{joint}" in template:
            mapping["joints"] = [joints[key] for key in sorted(columns)]
    torque = "torque" if "torque" in groups else "current"
    times = [name for name in names if _words(name) & _TIME]
    if not times or "position" not in groups or torque not in groups:
        return None
    mapping["time"] = _table(times[0], "time")
    for kind in {"position", "velocity", torque} & groups.keys():
        mapping["torque" if kind == torque else kind] = _table(groups[kind], kind)
    if torque == "current":
        mapping["torque"] = {"unit": "A", **mapping["torque"], "constant": 1.0}
    return mapping


def _groups(names: Sequence[str], joints: Sequence[str]) -> dict[str, dict[int, str]]:
    """Return names that differ by a joint or a number, by what they have in common."""
    found: dict[str, dict[int, str]] = {}
    for name in names:
        for position, joint in enumerate(joints):
            if joint in name:
                found.setdefault(name.replace(joint, "{joint}", 1), {})[position] = name
        for number in re.finditer(r"\d+", name):
            template = f"{name[: number.start()]}{{number}}{name[number.end() :]}"
            found.setdefault(template, {})[int(number[0])] = name
    return found


def _words(name: str) -> set[str]:
    """Return the words of a name, in small letters: those of `actualPos[0]` are actual, pos."""
    plain = re.sub(r"\{\w+\}", " ", name)
    return {word.lower() for word in re.findall(r"[A-Z]?[a-z]+|[A-Z]+(?![a-z])", plain)}


def _table(columns: str | list[str], kind: str) -> dict[str, Any]:
    words = _words(columns if isinstance(columns, str) else columns[0])
    unit = next((unit for word, unit in _UNITS.get(kind, {}).items() if word in words), None)
    return {"columns": columns} | ({} if unit is None else {"unit": unit})
