"""Guesses of which columns of an unknown format are what: by their names, or by their values.

What comes out is a mapping as in `_column_mapping`.
"""

import itertools
import os
import re
from collections.abc import Collection, Mapping, Sequence
from typing import Any

import numpy as np
from jaxtyping import Float

from .._recording import RecordingError
from .._sampling import noise_level
from ._recording_files import column_names_of, load_columns


# Words of column names, by quantity: the first quantity with a word of a name is meant.
_WORDS = {
    "velocity": {"velocity", "vel", "speed", "qd", "dq", "qdot", "omega"},
    "acceleration": {"acceleration", "acc", "accel", "qdd", "ddq"},
    "torque": {"torque", "trq", "tau", "effort", "eff", "moment"},
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
        if kind is None and words <= _JOINT and (words or template == "{joint}"):
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


def _units(name: str, kind: str) -> list[str]:
    """Return the units of a quantity that a name says."""
    return [unit for word, unit in _UNITS.get(kind, {}).items() if word in _words(name)]


def _table(columns: str | list[str], kind: str) -> dict[str, Any]:
    unit = next(iter(_units(columns if isinstance(columns, str) else columns[0], kind)), None)
    return {"columns": columns} | ({} if unit is None else {"unit": unit})


# Columns are alike with this correlation and, as a part, this error of scale: velocities and slopes
# of positions, commanded and measured positions.
_ALIKE, _SCALE_ERROR = 0.9, 0.1
_SMOOTHED = 9  # samples over which both are averaged, since encoder steps hide the slope
_TIMES = (1.0, 1e3, 1e6, 1e9)  # units of time in a second
# Torques have more noise than positions, and their steps between samples are larger, as parts of
# their deviations: by this factor.
_ROUGHER = 2.0
_NOISELESS = 1e-6  # part of the deviation: what formats round to
# Positions are beyond the file's limits by no more than this [rad or m, as a part of the limit].
_BEYOND = 0.1

_LISTED = 4  # runs of columns in a message
_UNNAMED = "column {number}"  # what columns of files without a header line are called

_Family = Float[np.ndarray, "samples joints"]


def mapping_by_values(
    path: str | os.PathLike[str],
    joints: Sequence[str],
    limits: Sequence[tuple[float, float]],
    prismatic: Collection[int] = (),
) -> tuple[dict[str, Any], str]:
    """Guess which columns are time, positions, velocities and torques, by their values.

    Columns of one quantity are as many as the joints, and have one name with running numbers; those
    of a file without a header line follow each other. Time increases from row to row. Positions lie
    within the joints' limits, and are smoother than torques; velocities are their slopes.

    **Arguments**

    - `path`: of the file.
    - `joints`: of the robot.
    - `limits`: low and high of each [rad or m]; infinite where the robot's file has none.
    - `prismatic`: the joints, from 0, that are.

    **Returns** a mapping as in `docs/recordings.md`, and what was assumed, in a few words.

    **Raises** `RecordingError`: values that do not tell, and why.

    >>> import pathlib, tempfile
    >>> import numpy as np
    >>> from jaxcslc.recordings import mapping_by_values
    >>> t = 0.01 * np.arange(500.0)
    >>> with tempfile.TemporaryDirectory() as folder:
    ...     path = pathlib.Path(folder) / "arm.csv"
    ...     rows = np.stack([t, np.sin(t), 9.0 * np.sin(t) + np.sign(np.cos(t))], axis=1)
    ...     np.savetxt(path, rows, delimiter=",", header="s,a1,b1", comments="")
    ...     mapping, _ = mapping_by_values(path, ["elbow"], [(-3.0, 3.0)])
    >>> mapping["position"], mapping["torque"]
    ({'columns': ['a1']}, {'columns': ['b1']})
    """
    names = column_names_of(path)
    families, others = _families(names, len(joints))
    if len(families) < 2:
        found = [f"; {name} are {len(run)}" for name, run in others.items()]
        raise RecordingError(
            f"no positions and torques are found among them: expected {len(joints)} columns of each"
            f" with running numbers, or in a row, for the joints {', '.join(joints)}"
            + "".join(found[:_LISTED])
        )
    time, columns = _timed(path, names, families)
    stamps = columns["time"]
    interval = float(stamps[-1] - stamps[0]) / (len(stamps) - 1)
    values = {
        name: np.stack([columns[column] for column in members], axis=1)
        for name, members in families.items()
    }
    values = {name: x for name, x in values.items() if np.ptp(x, axis=0).any()}
    units = {
        name: _units_within(x, np.array(limits, float).reshape(-1, 2), prismatic)
        for name, x in values.items()
    }
    kinds, assumed = _kinds(values, interval, units)
    mapping: dict[str, Any] = {"time": _table(time, "time")}
    for name, (kind, of_kind) in kinds.items():
        mapping[kind] = {"columns": families[name]}
        if any(unit not in _SI for unit in of_kind):
            same = len(set(of_kind)) == 1
            mapping[kind]["unit"] = of_kind[0] if same else list(of_kind)
    return mapping, assumed


def _families(
    names: Sequence[str], count: int
) -> tuple[dict[str, list[str]], dict[str, list[str]]]:
    """Return runs of as many columns as joints, by what their names have in common.

    **Returns** the runs, and those of other numbers of columns, more than the joints.
    """
    found: dict[str, list[str]] = {}
    others: dict[str, list[str]] = {}
    used: set[str] = set()
    for template, columns in _groups(names, ()).items():
        if _words(template) & _COMMANDED:
            continue
        numbers = sorted(number for number in columns if columns[number] not in used)
        if len(numbers) < count or numbers != list(range(numbers[0], numbers[0] + len(numbers))):
            continue
        run = [columns[number] for number in numbers]
        # Of a file without names, a first column that is left over counts time, or rows.
        over = 1 if template == _UNNAMED and (count == 1 or len(run) % count == 1) else 0
        if (len(run) - over) % count:
            others[f"{run[0]} to {run[-1]}"] = run
            continue
        for start in range(over, len(run), count):
            members = run[start : start + count]
            used.update(members)
            found[f"{members[0]} to {members[-1]}" if count > 1 else members[0]] = members
    return found, others


def _timed(
    path: str | os.PathLike[str], names: Sequence[str], families: Mapping[str, list[str]]
) -> tuple[str, dict[str, Float[np.ndarray, " samples"]]]:
    """Return the column that increases from row to row, and the values of all families."""
    members = list(itertools.chain.from_iterable(families.values()))
    others = [name for name in names if name not in members]
    others.sort(key=lambda name: not _words(name) & _TIME)
    for name in others:
        try:
            return name, load_columns(path, members, time=name)
        except RecordingError:
            continue
    listed = f": {', '.join(others[:8])}" if others else ", since there is none beside"
    raise RecordingError(
        f"no column increases from row to row, as times do, among those left{listed}"
    )


def _kinds(
    values: Mapping[str, _Family], interval: float, units: Mapping[str, tuple[str, ...] | None]
) -> tuple[dict[str, tuple[str, tuple[str, ...]]], str]:
    """Return the quantity and the units of families, and what was assumed.

    - `units`: in which each lies within the joints' limits, as `_units_within` returns them.

    **Raises** `RecordingError` where the values do not tell.
    """
    slopes = {
        (of, name)
        for of, name in itertools.permutations(values, 2)
        if _is_slope(values[of], values[name], interval)
    }
    derived = {name for _, name in slopes}
    candidates = [name for name in values if name not in derived]
    for first, second in itertools.combinations(candidates, 2):
        correlation, scale = _correlation(values[first], values[second])
        if correlation > _ALIKE and abs(scale - 1.0) < _SCALE_ERROR:
            raise RecordingError(
                f"{first} and {second} are alike, as commanded and measured positions are"
            )
    if len(candidates) < 2:
        raise RecordingError("one quantity and its slopes are found, and no torques")
    possible = [name for name in candidates if units[name] is not None]
    if not possible:
        raise RecordingError("no columns lie within the joints' limits, in radians or degrees")
    position = next((x for x in possible if _is_smoothest(x, candidates, values)), None)
    if position is None:
        others = [name for name in candidates if name not in possible]
        within = " and ".join(possible)
        raise RecordingError(
            f"{within} lie within the joints' limits, and {' and '.join(others)} are as smooth"
            if others
            else f"{within} may both be positions"
        )
    torques = [name for name in candidates if name != position]
    if len(torques) > 1:
        raise RecordingError(f"{' and '.join(torques)} may both be torques")
    own = units[position] or ()
    kinds = {position: ("position", own)}
    within = " and ".join(dict.fromkeys(own))
    reasons = [f"{position} lie within the joints' limits in {within} and are smoothest"]
    for name in (name for of, name in slopes if of == position):
        kinds[name] = ("velocity", tuple(f"{unit}/s" for unit in own))
        reasons.append(f"{name} are their slopes")
    kinds[torques[0]] = ("torque", ())
    reasons.append(f"{torques[0]} are what is left, taken as torques")
    return kinds, "; ".join(reasons)


_ANGLES = (("rad", 1.0), ("deg", np.pi / 180.0))
_LENGTHS = (("m", 1.0), ("mm", 1e-3))
_SI = ("rad", "m", "rad/s", "m/s")


def _units_within(
    x: _Family, limits: Float[np.ndarray, "joints 2"], prismatic: Collection[int]
) -> tuple[str, ...] | None:
    """Return the unit of each joint in which values lie within limits; None if there are none.

    Revolute joints have one unit together, and prismatic ones.
    """
    slides = np.isin(np.arange(x.shape[1]), list(prismatic))
    angle = _unit_within(x[:, ~slides], limits[~slides], _ANGLES)
    length = _unit_within(x[:, slides], limits[slides], _LENGTHS)
    if angle is None or length is None:
        return None
    return tuple(length if slide else angle for slide in slides)


def _unit_within(
    x: _Family, limits: Float[np.ndarray, "joints 2"], units: Sequence[tuple[str, float]]
) -> str | None:
    """Return the first unit in which values lie within limits; None if there is none."""
    low, high = limits.T
    # One more turn where the file states no limits, as of joints that turn on and on.
    high, low = (
        np.where(np.isfinite(x), x, 2.0 * np.pi * sign) for x, sign in ((high, 1), (low, -1))
    )
    margin = _BEYOND * np.maximum(high - low, 1.0)
    for unit, factor in units:
        scaled = x * factor
        if np.all((scaled.min(axis=0) > low - margin) & (scaled.max(axis=0) < high + margin)):
            return unit
    return None


def _is_slope(x: _Family, y: _Family, interval: float) -> bool:
    """Return whether y is the derivative of x by time, in whatever unit of time."""
    kernel = np.full(_SMOOTHED, 1.0 / _SMOOTHED)
    smooth = [
        np.stack([np.convolve(column, kernel, "valid") for column in values.T], axis=1)
        for values in (np.gradient(x, interval, axis=0), y)
    ]
    correlation, slope = _correlation(*smooth)
    near = any(abs(slope / per_second - 1.0) < _SCALE_ERROR for per_second in _TIMES)
    return correlation > _ALIKE and near


def _correlation(x: _Family, y: _Family) -> tuple[float, float]:
    """Return the median correlation of the columns that move, and the slope of y over x."""
    x, y = x - x.mean(axis=0), y - y.mean(axis=0)
    moving = (x.std(axis=0) > 0.0) & (y.std(axis=0) > 0.0)
    if not moving.any():
        return 0.0, 0.0
    x, y = x[:, moving], y[:, moving]
    both, own = np.sum(x * y, axis=0), np.sum(x**2, axis=0)
    return float(np.median(both / np.sqrt(own * np.sum(y**2, axis=0)))), float(
        np.median(both / own)
    )


def _is_smoothest(name: str, names: Sequence[str], values: Mapping[str, _Family]) -> bool:
    """Return whether one of some families is smoother than all others, as positions are."""
    noise, steps = _roughness(values[name])
    for other in names:
        if other == name:
            continue
        more_noise, larger_steps = _roughness(values[other])
        noisy = max(noise, more_noise) > _NOISELESS
        if noisy and more_noise > _ROUGHER * noise:
            continue
        if (noisy and noise > _ROUGHER * more_noise) or larger_steps < _ROUGHER * steps:
            return False
    return True


def _roughness(x: _Family) -> tuple[float, float]:
    """Return the noise and the root mean square of steps between samples, over the deviations.

    The medians of the columns that move.
    """
    x = x[:, x.std(axis=0) > 0.0]
    steps = np.sqrt(np.mean(np.diff(x, axis=0) ** 2, axis=0))
    deviation = x.std(axis=0)
    return float(np.median(noise_level(x) / deviation)), float(np.median(steps / deviation))
