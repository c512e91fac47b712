"""Limits of joints, and surroundings that bodies keep away from, as TOML files state them."""

import contextlib
import dataclasses
import importlib.util
import math
import tomllib
from collections.abc import Mapping
from pathlib import Path
from typing import Any, Literal

import numpy as np
from jaxtyping import Float

from .._plain_data import toml_document
from ..manipulator import Manipulator


Joints = Float[np.ndarray, " joints"]

# Limits of derivatives that nobody states: this long to full speed, and to full acceleration [s].
_TO_SPEED, _TO_ACCELERATION = 0.2, 0.05
_LEAST, _MOST = 1e-6, 1e9  # of any limit, SI units; beyond, squares of motion are rounding
_NAMES = ("position", "velocity", "acceleration", "jerk", "torque", "power")
_MARGINS = ("position_margin", "torque_margin")
_ROBOTS = Path(__file__).parent / "robots"
QUANTITIES = ("position", "velocity", "acceleration", "jerk")


@dataclasses.dataclass(frozen=True)
class Surroundings:
    """Surroundings from which the robot's bodies must keep away.

    **Attributes**

    - `clearance`: the least distance of bodies from others and from obstacles [m].
    - `self_collision`: whether the robot's bodies keep away from each other.
    - `floor`: the height of a floor in the frame of the file's root, or in frame 0 [m]. `"base"`
      is the plane through the base's foot: where its shapes end, at height 0 without shapes. It is
      a ceiling if the arm hangs from it. None is no floor.
    - `workspace`: corners (low, high) of a box in the base frame that no body leaves [m].
    - `boxes`: obstacles as (centre, full size), `spheres` as (centre, radius) [m].
    - `radius`: of a capsule along each link [m]. With None, the file's shapes count, and only links
      without any have capsules, of 5.5 % of the arm's length.
    - `ignore`: pairs of bodies' names that may touch.

    >>> import jaxcslc as jc
    >>> from jaxcslc.excitation import Surroundings
    >>> Surroundings.of(jc.puma560()).floor, Surroundings.of(jc.panda(), {"floor": False}).floor
    (-0.6718, None)
    """

    clearance: float = 0.02
    self_collision: bool = True
    floor: float | Literal["base"] | None = "base"
    workspace: tuple[tuple[float, ...], tuple[float, ...]] | None = None
    boxes: tuple[tuple[tuple[float, ...], tuple[float, ...]], ...] = ()
    spheres: tuple[tuple[tuple[float, ...], float], ...] = ()
    radius: float | tuple[float, ...] | None = None
    ignore: tuple[tuple[str, str], ...] = ()

    @classmethod
    def of(cls, robot: Manipulator, stated: Mapping[str, Any] | None = None) -> "Surroundings":
        """Return what is known of a robot's surroundings: those stated, else the defaults.

        **Arguments**

        - `robot`: `puma560` has a base of known height.
        - `stated`: by name, as the attributes; `floor` is False for none.

        **Raises**

        - `ValueError`: an unknown entry, or values that are not lengths; names the entry.
        """
        table = _built_in(robot).get("surroundings", {}) | (stated or {})
        names = {field.name for field in dataclasses.fields(cls)}
        if unknown := sorted(table.keys() - names):
            raise ValueError(
                f"surroundings: unknown entry {unknown[0]!r}; expected {', '.join(sorted(names))}"
            )
        if table.get("floor") is False:
            table["floor"] = None
        for name in ("clearance", "floor", "radius"):
            value = table.get(name)
            values = np.atleast_1d(np.asarray(0.0 if value is None else value))
            if name == "floor" and value == "base":
                continue
            if not np.issubdtype(values.dtype, np.number) or not np.isfinite(values).all():
                raise ValueError(f"surroundings, {name}: expected numbers in m, got {value!r}")
        for name, lengths in (("workspace", (3, 3)), ("boxes", (3, 3)), ("spheres", (3, 1))):
            entries = table.get(name)
            if entries is None:
                continue
            if not isinstance(entries, list | tuple):
                raise ValueError(f"surroundings, {name}: expected lists, got {entries!r}")
            for entry in [entries] if name == "workspace" and entries else entries:
                sizes = tuple(np.size(part) for part in entry) if isinstance(entry, list) else ()
                if sizes != lengths or not all(map(_is_length, np.concatenate(entry, axis=None))):
                    raise ValueError(
                        f"surroundings, {name}: expected {lengths[0]} and {lengths[1]} numbers in"
                        f" m, got {entry!r}"
                    )
        watched, ignored = table.get("self_collision", True), table.get("ignore", [])
        if not isinstance(watched, bool):
            raise ValueError(
                f"surroundings, self_collision: expected true or false, got {watched!r}"
            )
        if not isinstance(ignored, list | tuple) or not all(map(_is_pair_of_names, ignored)):
            raise ValueError(
                f"surroundings, ignore: expected pairs of bodies' names, got {ignored!r}"
            )
        frozen = {name: _frozen(value) for name, value in table.items()}
        if "spheres" in frozen:  # radii as numbers or as lists of one
            frozen["spheres"] = tuple(
                (centre, float(np.ravel(radius)[0])) for centre, radius in frozen["spheres"]
            )
        return cls(**frozen)


@dataclasses.dataclass(frozen=True, eq=False)
class Limits:
    """Limits that joints must not exceed, and surroundings to keep away from.

    **Attributes**

    - `low`, `high`: positions, (n,) [rad or m].
    - `velocity`, `acceleration`, `jerk`: absolute values, (n,) [rad/s or m/s], and so on.
    - `torque`: absolute, (n,) [N m or N]; `power`: of each joint, torque times velocity, (n,) [W].
      Infinite where there is none.
    - `torque_margin`: the part of torque and power that is kept back for errors of the model.
    - `notes`: sentences about limits that nobody stated.
    - `surroundings`: bodies that must not collide; not watched if None.

    **Raises**

    - `ValueError`: a limit that is not above zero, or a range that is none; names the joint.

    >>> import jaxcslc as jc
    >>> from jaxcslc.excitation import Limits
    >>> limits = Limits.of(jc.puma560(), {"velocity": 1.0})
    >>> limits.velocity.tolist(), limits.torque[0].item()
    ([1.0, 1.0, 1.0, 1.0, 1.0, 1.0], 97.6)
    """

    low: Joints
    high: Joints
    velocity: Joints
    acceleration: Joints
    jerk: Joints
    torque: Joints
    power: Joints
    torque_margin: float = 0.1
    notes: tuple[str, ...] = ()
    surroundings: Surroundings | None = None

    def __post_init__(self) -> None:
        for name in _NAMES[1:]:
            limit = getattr(self, name)
            wrong = np.flatnonzero(~((limit >= _LEAST) & ((limit <= _MOST) | np.isinf(limit))))
            if wrong.size:
                raise ValueError(
                    f"limit of {name} of joint {wrong[0] + 1} is {limit[wrong[0]]:g}; expected"
                    f" from {_LEAST:g} to {_MOST:g}"
                )
        wrong = np.flatnonzero(~((self.low < self.high) & np.isfinite(self.high - self.low)))
        if wrong.size:
            i = wrong[0]
            raise ValueError(
                f"limits of position of joint {i + 1} are {self.low[i]:g} and {self.high[i]:g};"
                " expected the lower before the higher one, both finite"
            )
        if not 0.0 <= self.torque_margin < 1.0:
            raise ValueError(f"torque_margin is {self.torque_margin}; expected from 0 to below 1")

    @classmethod
    def of(
        cls,
        robot: Manipulator,
        stated: Mapping[str, Any] | None = None,
        surroundings: Surroundings | Literal["usual"] | None = None,
    ) -> "Limits":
        """Return the limits of a robot: those stated, else those of its file.

        Where some joints follow others, they are those of the independent joints.

        **Arguments**

        - `robot`: whose file may state ranges, speeds and efforts; `puma560` and `panda` have
          limits of their own.
        - `stated`: by name, as the attributes and `"position"`, pairs of lowest and highest; one
          number (or pair) for all joints, or one each. `"position_margin"` is kept back of ranges
          at both ends, for errors of the controller [rad or m].
        - `surroundings`: that are watched; `"usual"` for `Surroundings.of(robot)`. Without MuJoCo
          and for lengths without values, the usual ones are None, and a note says why.

        **Raises**

        - `ValueError`: a limit of position or velocity that is missing, an unknown name, a wrong
          number of values.
        """
        joints = robot.independent_joints
        names = [robot.joint_names[i] for i in joints]
        n = len(names)
        free: list[str] = []
        if built_in := _built_in(robot):
            known = built_in["joints"]
        else:
            known, free = _of_file(robot)
        if stated and "position" in stated:
            free = []
        known |= stated or {}
        expected = (*_NAMES, *_MARGINS)
        if unknown := sorted(known.keys() - set(expected)):
            raise ValueError(
                f"limits: unknown entry {unknown[0]!r}; expected {', '.join(expected)}"
            )
        margin = _numbers("position_margin", known.get("position_margin", 0.0), n)
        position = _pairs(known.get("position"), n) + margin[:, None] * [1.0, -1.0]
        values = {name: _numbers(name, known.get(name, math.inf), n) for name in _NAMES[1:]}
        missing = ~np.isfinite(values["velocity"])
        if missing.any():
            name = names[int(np.argmax(missing))]
            raise ValueError(
                f"limits: no velocity limit of {name} of {robot.name!r}; expected one in the"
                " robot's file, or velocity in [joints] of a file of limits"
            )
        notes: list[str] = []
        if free:
            notes.append(f"position: not stated of {', '.join(free)}; from -pi to pi rad")
        for name, before, time in (
            ("acceleration", "velocity", _TO_SPEED),
            ("jerk", "acceleration", _TO_ACCELERATION),
        ):
            if not np.isfinite(values[name]).all():
                values[name] = np.minimum(values[name], values[before] / time)
                notes.append(f"{name}: not stated; the limit of {before} within {time:g} s")
        if not np.isfinite(values["torque"]).all():
            notes.append("torque: some joints have no limit")
        if surroundings == "usual":
            if reason := _unwatchable(robot):
                notes.append(f"collisions: {reason}")
            surroundings = None if reason else Surroundings.of(robot)
        return cls(
            position[:, 0],
            position[:, 1],
            **values,
            torque_margin=float(_numbers("torque_margin", known.get("torque_margin", 0.1), 1)[0]),
            notes=tuple(notes),
            surroundings=surroundings,
        )

    def without_floor(self) -> "Limits":
        """Return the limits without a floor."""
        if self.surroundings is None:
            return self
        return dataclasses.replace(
            self, surroundings=dataclasses.replace(self.surroundings, floor=None)
        )

    @property
    def middle(self) -> Joints:
        """The middle of each joint's range [rad or m]."""
        return (self.low + self.high) / 2

    def symmetric(self, order: int) -> tuple[Joints, Joints]:
        """Return middle and half width of the range of a derivative of that order, (n,) each."""
        if order == 0:
            return self.middle, (self.high - self.low) / 2
        return np.zeros(len(self.low)), getattr(self, QUANTITIES[order])

    @property
    def usable_torque(self) -> Joints:
        """The limit of torque without the margin."""
        return self.torque * (1.0 - self.torque_margin)

    @property
    def usable_power(self) -> Joints:
        """The limit of power without the margin."""
        return self.power * (1.0 - self.torque_margin)


def load_limits(path: str | Path, robot: Manipulator) -> Limits:
    """Read limits from a TOML file.

    Tables `[joints]` with `position`, `velocity`, `acceleration`, `jerk`, `torque`, `power`,
    `position_margin` and `torque_margin`, which replace those of the robot's file; and
    `[surroundings]` with entries as `Surroundings.of` takes them.

    **Raises**

    - `ValueError`: in one line, naming file and entry.

    >>> import tempfile
    >>> import jaxcslc as jc
    >>> with tempfile.TemporaryDirectory() as folder:
    ...     path = Path(folder) / "limits.toml"
    ...     _ = path.write_text("[joints]\\nvelocity = 1.5\\n[surroundings]\\nfloor = -0.6\\n")
    ...     limits = load_limits(path, jc.puma560())
    >>> limits.velocity[0].item(), limits.surroundings.floor
    (1.5, -0.6)
    """
    path = Path(path)
    document = toml_document(path, "file of limits", ValueError)
    if unknown := sorted(document.keys() - {"joints", "surroundings"}):
        raise ValueError(f"{path}: unknown entry {unknown[0]!r}; expected joints or surroundings")
    for name, table in document.items():
        if not isinstance(table, dict):
            raise ValueError(f"{path}, {name}: expected a table, got {table!r}")
    try:
        table = document.get("surroundings")
        surroundings = "usual" if table is None else Surroundings.of(robot, table)
        return Limits.of(robot, document.get("joints"), surroundings)
    except ValueError as error:
        raise ValueError(f"{path}: {error}") from None


def _unwatchable(robot: Manipulator) -> str:
    """Return why collisions of a robot cannot be looked for; empty if they can."""
    if importlib.util.find_spec("mujoco") is None:
        return "MuJoCo is not installed (pip install 'jaxcslc[urdf]')"
    return "" if robot.has_all_lengths else f"lengths of {robot.name!r} have no values"


def _is_length(value: Any) -> bool:
    if not isinstance(value, int | float | np.number):
        return False
    with contextlib.suppress(OverflowError):  # an integer that no float holds
        return math.isfinite(float(value))
    return False


def _is_pair_of_names(value: Any) -> bool:
    return isinstance(value, list | tuple) and [*map(type, value)] == [str, str]


def _frozen(value: Any) -> Any:
    if isinstance(value, list):
        return tuple(_frozen(part) for part in value)
    return float(value) if isinstance(value, int) and not isinstance(value, bool) else value


def _built_in(robot: Manipulator) -> dict[str, Any]:
    """Return limits and surroundings of a built-in robot; empty for others."""
    file = _ROBOTS / f"{''.join(robot.name.lower().split())}.toml"
    from_table = robot.source is None or robot.source.format == "toml"
    return tomllib.loads(file.read_text(encoding="utf-8")) if from_table and file.exists() else {}


def _of_file(robot: Manipulator) -> tuple[dict[str, Any], list[str]]:
    """Return the limits of the robot's file, and the names of joints without a range.

    These turn, and get one turn.
    """
    limits = {robot.joint_names[i]: robot.joint_limits[i] for i in robot.independent_joints}
    free = [
        robot.joint_names[i]
        for i in robot.independent_joints
        if robot.kinds[i] == "R" and math.isinf(robot.joint_limits[i].low)
    ]
    known = {
        "position": [
            [-math.pi, math.pi] if name in free else [limit.low, limit.high]
            for name, limit in limits.items()
        ],
        "velocity": [limit.speed for limit in limits.values()],
        "torque": [limit.torque for limit in limits.values()],
    }
    return known, free


def _numbers(name: str, value: Any, joints: int) -> Joints:
    numbers = np.atleast_1d(np.asarray(value))
    if not np.issubdtype(numbers.dtype, np.number) or numbers.shape not in ((1,), (joints,)):
        raise ValueError(f"limits, {name}: expected one number or {joints}, got {value!r}")
    return np.broadcast_to(numbers.astype(float), (joints,)).copy()


def _pairs(value: Any, joints: int) -> Float[np.ndarray, "joints 2"]:
    try:
        pairs = np.asarray(value, float)
    except (TypeError, ValueError):
        pairs = np.zeros(0)
    if pairs.shape not in ((2,), (joints, 2)):
        raise ValueError(
            f"limits, position: expected one pair of lowest and highest or {joints}, got {value!r}"
        )
    return np.broadcast_to(pairs, (joints, 2)).copy()
