"""Data sets of LeRobot: episodes of actions and measured states, in Parquet files."""

import json
import math
import os
from collections.abc import Iterator, Mapping, Sequence
from pathlib import Path
from typing import Any, Literal

import numpy as np
from jaxtyping import Float

from ..recordings import MINIMUM_SAMPLES, RecordingError, load_columns


LEROBOT_INFO = Path("meta") / "info.json"
"""File that makes a folder a data set of LeRobot."""

_ACTION, _STATE = "action", "observation.state"
_RESOLUTION = 4096  # ticks per turn of Feetech STS and Dynamixel X servos
_RANGE = 100.0  # normalised values are -100 to 100
_PERCENT = 100.0  # a gripper's are 0 to 100
# Robots of LeRobot with Dynamixel servos, by parts of their type. These servos apply the drive mode
# themselves; LeRobot applies it to positions of Feetech servos.
_DYNAMIXEL = ("koch", "omx", "viperx", "widowx", "aloha")


def lerobot_episodes(
    folder: Path,
    units: Literal["radians", "degrees", "normalised"] | None,
    calibration: str | os.PathLike[str] | None,
    *,
    raw: bool,
) -> Iterator[tuple[str, dict[str, np.ndarray], list[str]]]:
    """Yield name, columns and notes of each episode of a data set, version 2 or 3.

    A row holds the state that was read, and the action that was sent next: the command of the
    row.

    **Arguments**

    - `folder`: with `meta/info.json` and `data/`.
    - `units`: of positions; None to tell radians and degrees by the values.
    - `calibration`: LeRobot's calibration file, for normalised units and for grippers.
    - `raw`: leave values as they are, for a mapping that states their unit.

    **Raises** `RecordingError`: files that are missing or wrong, and units that values do not show.
    """
    info = _document(folder / LEROBOT_INFO)
    features = info.get("features")
    if not isinstance(features, Mapping):
        raise RecordingError(f"{folder / LEROBOT_INFO}: no features; expected {_ACTION}, {_STATE}")
    motors, notes = _motors(folder, features)
    tables = list(_tables(folder, list(motors.values())))
    columns = {name: np.concatenate([table[name] for table in tables]) for name in tables[0]}
    actions = np.stack([columns[f"{_ACTION}[{i}]"] for i, _ in motors.values()], axis=1)
    states = np.stack([columns[f"{_STATE}[{i}]"] for _, i in motors.values()], axis=1)
    names = list(motors)
    if not raw:
        kind = str(info.get("robot_type"))
        reverses = not any(part in kind for part in _DYNAMIXEL)
        scale, zero, kept, more = _scale(
            folder, names, [actions, states], units, calibration, reverses
        )
        names, notes = [names[i] for i in kept], [*notes, *more]
        actions, states = ((v[:, kept] - zero) * scale for v in (actions, states))
    episodes = columns["episode_index"]
    total = info.get("total_episodes")
    present = np.unique(episodes)
    if isinstance(total, int) and total != present.size:
        notes.append(f"{present.size} of {total} episodes are in the folder")
    found = False
    for number in present:
        rows = episodes == number
        if rows.sum() < MINIMUM_SAMPLES:
            continue
        found = True
        arrays = {"time": columns["timestamp"][rows]}
        for quantity, values in (("position", states), ("command", actions)):
            arrays |= {f"{quantity}_{n}": v[rows] for n, v in zip(names, values.T, strict=True)}
        yield f"episode {int(number)}", arrays, notes
    if not found:
        raise RecordingError(f"{folder}: no episode of at least {MINIMUM_SAMPLES} frames")


def _document(path: Path) -> Mapping[str, Any]:
    try:
        document = json.loads(path.read_text(encoding="utf-8"))
    except (OSError, ValueError) as error:
        raise RecordingError(f"{path}: is no readable JSON file: {error}") from error
    if not isinstance(document, Mapping):
        raise RecordingError(
            f"{path}: expected an object with keys, got a {type(document).__name__}"
        )
    return document


def _motors(
    folder: Path, features: Mapping[str, Any]
) -> tuple[dict[str, tuple[int, int]], list[str]]:
    """Return by motor its places in actions and in states, and notes on what is not read."""
    places: list[dict[str, int]] = []
    unread: dict[str, None] = {}
    for key in (_ACTION, _STATE):
        feature = features.get(key)
        if not isinstance(feature, Mapping):
            raise RecordingError(
                f"{folder / LEROBOT_INFO}: no feature {key!r}; the data set has"
                f" {', '.join(map(str, features))}"
            )
        names = feature.get("names")
        if isinstance(names, Mapping):  # of version 2: {"motors": [...]}
            names = next(iter(names.values()), None)
        if not isinstance(names, Sequence) or isinstance(names, str):
            shape = feature.get("shape")
            if not (isinstance(shape, list) and shape and isinstance(shape[0], int)):
                raise RecordingError(
                    f"{folder / LEROBOT_INFO}: {key} has shape {shape!r}; expected a list with the"
                    " number of motors"
                )
            names = [str(i + 1) for i in range(shape[0])]
        names = [str(name) for name in names]
        suffixed = any(name.endswith(".pos") for name in names)
        kept = {
            name.removesuffix(".pos").removeprefix("main_"): index
            for index, name in enumerate(names)
            if not suffixed or name.endswith(".pos")
        }
        unread |= dict.fromkeys(n for n in names if suffixed and not n.endswith(".pos"))
        places.append(kept)
    action, state = places
    both = {name: (action[name], state[name]) for name in action if name in state}
    unread |= dict.fromkeys(name for name in (*action, *state) if name not in both)
    if not both:
        raise RecordingError(
            f"{folder / LEROBOT_INFO}: {_ACTION} has {', '.join(action) or 'no names'},"
            f" {_STATE} has {', '.join(state) or 'no names'}; expected positions of the same motors"
        )
    notes = [f"values of the data set that are not read: {', '.join(unread)}"] if unread else []
    return both, notes


def _tables(
    folder: Path, places: Sequence[tuple[int, int]]
) -> Iterator[dict[str, Float[np.ndarray, " rows"]]]:
    """Yield the frames of each file: one per episode in version 2, of many in version 3."""
    files = sorted((folder / "data").rglob("*.parquet"))
    if not files:
        raise RecordingError(f"{folder}: no Parquet file in data; expected the frames of episodes")
    names = ["timestamp", "episode_index"]
    names += [f"{_ACTION}[{i}]" for i, _ in places] + [f"{_STATE}[{i}]" for _, i in places]
    for file in files:
        yield load_columns(file, names, time="index", least=1)


def _scale(
    folder: Path,
    names: Sequence[str],
    values: Sequence[Float[np.ndarray, "rows motors"]],
    units: str | None,
    calibration: str | os.PathLike[str] | None,
    reverses: bool,
) -> tuple[np.ndarray, np.ndarray, list[int], list[str]]:
    """Return radians per unit, the value that stands for 0, which motors are kept, and notes.

    Radians are (value - zero) times scale. LeRobot has grippers in percent of their range, and the
    other joints in degrees from the middle of their range, or in -100 to 100 of it. `reverses` says
    whether the drive mode of the calibration changes signs of percent and of -100 to 100.
    """
    grippers = [name == "gripper" or name.endswith("_gripper") for name in names]
    joints = [i for i, gripper in enumerate(grippers) if not gripper] or list(range(len(names)))
    largest = max(float(np.max(np.abs(array[:, joints]))) for array in values)
    if units is None and largest <= 2.0 * math.pi:
        units = "radians"
    elif units is None and largest > _RANGE * (1.0 + 1e-3):
        units = "degrees"
    elif units is None:
        raise RecordingError(
            f"{folder}: positions reach {largest:.4g}: degrees, or -100 to 100 of the range;"
            " expected --units degrees, or --units normalised with --calibration FILE"
        )
    everything = list(range(len(names)))
    if units == "radians":
        return np.ones(len(names)), np.zeros(len(names)), everything, []
    document = None if calibration is None else _document(Path(calibration))
    if units == "normalised" and document is None:
        raise RecordingError(
            f"{folder}: normalised positions need the range of each motor; expected"
            " --calibration FILE, as lerobot-calibrate wrote it"
        )
    scale, zero, kept, notes = [], [], [], []
    for i, (name, gripper) in enumerate(zip(names, grippers, strict=True)):
        if gripper and document is None:
            notes.append(f"{name} is in percent of its range: not read without --calibration")
            continue
        kept.append(i)
        if units == "degrees" and not gripper:
            scale.append(math.pi / 180.0)
            zero.append(0.0)
            continue
        assert document is not None
        low, high, sign = _range(Path(str(calibration)), document, name)
        sign = sign if reverses else 1.0
        span = sign * (high - low) * 2.0 * math.pi / _RESOLUTION
        scale.append(span / _PERCENT if gripper else span / (2.0 * _RANGE))
        # Of a gripper whose direction is reversed, 100 is the lower end.
        zero.append((0.0 if sign > 0 else _PERCENT) if gripper else 0.0)
    notes.append(
        f"positions were in {units}: zero is the middle of each joint's calibrated range"
        + (", of a gripper its lower end" if document is not None and any(grippers) else "")
    )
    return np.array(scale), np.array(zero), kept, notes


def _range(path: Path, document: Mapping[str, Any], name: str) -> tuple[float, float, float]:
    """Return the range of a motor [ticks], and the sign of its normalised values."""
    for key in (name, f"main_{name}"):
        motor = document.get(key)
        if isinstance(motor, Mapping):
            try:
                low, high = float(motor["range_min"]), float(motor["range_max"])
                sign = -1.0 if motor["drive_mode"] else 1.0
            except (KeyError, TypeError, ValueError) as error:
                raise RecordingError(
                    f"{path}: {key}: {error}; expected numbers drive_mode, homing_offset,"
                    " range_min, range_max"
                ) from error
            if not high > low:
                raise RecordingError(f"{path}: {key}: range_max {high:g} is not above {low:g}")
            return low, high, sign
    raise RecordingError(f"{path}: no motor {name!r}; the file has {', '.join(map(str, document))}")
