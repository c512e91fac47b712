import dataclasses
import tomllib
from collections.abc import Mapping
from importlib.resources import files
from pathlib import Path
from typing import Any

import numpy as np

from ._errors import RobotError
from ._inertia import LinkInertia
from ._joint import Joint, parse_angle, parse_length
from ._link_parameters import LinkParameters
from ._manipulator import Manipulator
from ._numbering import Numbering, Subnumbering


_ROBOT_KEYS = {"name", "about", "gravity", "friction", "lengths", "links", "joint", "numbering"}
_DEFAULT_KEYS = {"inertia", "motor_inertia"}
_JOINT_KEYS = {"kind", "alpha", "a", "d", "theta", "link", "viscous", "dry"}
_LINK_KEYS = {
    *("inertia", "motor", "zero", "equal"),
    *("mass", "centre_of_gravity", "inertia_tensor", "motor_inertia"),
}


def load_robot(path: str | Path) -> Manipulator:
    """A robot from its TOML description; the format is documented in `docs/robots.md`.

    **Arguments**

    - `path`: a `.toml` file.

    **Raises**

    - `RobotError`: one line that names the file, the joint and the key that is missing, unknown
      or contradictory, and what was expected.

    >>> from importlib.resources import files
    >>> load_robot(str(files("jaxcslc.manipulator") / "robots" / "panda.toml")).joint_count
    7
    """
    path = Path(path)
    if path.suffix.lower() != ".toml":
        raise RobotError(f"{path}: expected a robot file ending in .toml")
    try:
        document = tomllib.loads(path.read_text(encoding="utf-8"))
    except FileNotFoundError:
        raise RobotError(f"{path}: no such robot file") from None
    except (OSError, UnicodeDecodeError) as error:
        raise RobotError(f"{path}: cannot be read: {error}") from None
    except tomllib.TOMLDecodeError as error:
        raise RobotError(f"{path}: not valid TOML: {error}") from None
    return _robot(document, str(path))


def puma560() -> Manipulator:
    """The PUMA 560 of the thesis (Fig. 2.6-4), with Appendix B's numbering.

    Geometry and link parameters are Armstrong, Khatib and Burdick's (1986), friction is Leahy
    and Saridis's (1989). The thesis evaluates its 'Armstrong et al.' columns with
    g = 9.814 m/s²: use `puma560().with_gravity((0, 0, -9.814))` to reproduce them.

    >>> puma560().joint_count
    6
    """
    return _bundled("puma560.toml")


def panda() -> Manipulator:
    """The Franka Emika Panda: 7 revolute joints, full inertia tensors, link-side torque sensors.

    Kinematics as its maker publishes them; no link parameters.

    >>> panda().kinds
    'RRRRRRR'
    """
    return _bundled("panda.toml")


def _bundled(name: str) -> Manipulator:
    source = files("jaxcslc.manipulator") / "robots" / name
    return _robot(tomllib.loads(source.read_text(encoding="utf-8")), name)


def _robot(document: Mapping[str, Any], where: str) -> Manipulator:
    _known(document, _ROBOT_KEYS, where)
    lengths = _table(document.get("lengths", {}), f"{where}, [lengths]")
    for symbol, value in lengths.items():
        parse_length(symbol, {}, f"{where}, [lengths]")
        _number(value, f"{where}, length {symbol}")
    defaults = _table(document.get("links", {}), f"{where}, [links]")
    _known(defaults, _DEFAULT_KEYS, f"{where}, [links]")
    entries = document.get("joint")
    if not isinstance(entries, list) or not entries:
        raise RobotError(f"{where}: expected at least one [[joint]]")

    joints: list[Joint] = []
    inertia: list[LinkInertia] = []
    links: list[LinkParameters | None] = []
    for i, entry in enumerate(entries, start=1):
        at = f"{where}, joint {i}"
        table = _table(entry, at)
        _known(table, _JOINT_KEYS, at)
        joints.append(_joint(table, lengths, at))
        link = _table(table.get("link", {}), f"{at}, link")
        _known(link, _LINK_KEYS, f"{at}, link")
        inertia.append(_inertia(link, defaults, f"{at}, link"))
        links.append(_parameters(link, f"{at}, link"))
    used = {length.symbol for joint in joints for length in (joint.a, joint.d)}
    if unused := sorted(set(lengths) - used):
        raise RobotError(f"{where}, [lengths]: {unused[0]!r} is not used by any joint")

    given = [link for link in links if link is not None]
    if given and len(given) != len(links):
        missing = links.index(None) + 1
        raise RobotError(
            f"{where}, joint {missing}, link: has no mass while other links have;"
            " give every link its parameters or none"
        )
    robot = Manipulator(
        name=str(document.get("name", Path(where).stem)),
        joints=tuple(joints),
        inertia=tuple(inertia),
        gravity=(0.0, 0.0, -9.81),
        friction=tuple(_words(document.get("friction", ["viscous", "dry"]), f"{where}, friction")),
        links=tuple(given) if given else None,
        viscous=_friction(entries, "viscous", where),
        dry=_friction(entries, "dry", where),
        numbering=_numbering(document["numbering"], where) if "numbering" in document else None,
    )
    gravity = document.get("gravity", [0.0, 0.0, -9.81])
    if not isinstance(gravity, list):
        raise RobotError(f"{where}, gravity: expected three numbers in m/s², got {gravity!r}")
    return dataclasses.replace(robot.with_gravity(gravity))


def _joint(table: Mapping[str, Any], lengths: Mapping[str, Any], at: str) -> Joint:
    kind = table.get("kind", "R")
    if kind not in ("R", "P"):
        raise RobotError(f"{at}, kind: expected 'R' (revolute) or 'P' (prismatic), got {kind!r}")
    values = {symbol: float(value) for symbol, value in lengths.items()}
    joint = Joint(
        kind,
        parse_angle(table.get("alpha", 0), f"{at}, alpha"),
        parse_length(table.get("a", 0), values, f"{at}, a"),
        parse_length(table.get("d", 0), values, f"{at}, d"),
        parse_angle(table.get("theta", 0), f"{at}, theta"),
    )
    for letter, length in (("a", joint.a), ("d", joint.d)):
        if length.symbol is not None and length.value == 0.0:
            raise RobotError(
                f"{at}, {letter}: length {length.symbol!r} is zero; write 0 instead of a name"
            )
    return joint


def _inertia(link: Mapping[str, Any], defaults: Mapping[str, Any], at: str) -> LinkInertia:
    form = link.get("inertia", defaults.get("inertia", "full"))
    motor = link.get("motor", defaults.get("motor_inertia", True))
    if not isinstance(motor, bool):
        raise RobotError(f"{at}, motor: expected true or false, got {motor!r}")
    equal = link.get("equal", [])
    if not isinstance(equal, list) or not all(isinstance(pair, list) for pair in equal):
        raise RobotError(f"{at}, equal: expected a list of pairs, got {equal!r}")
    try:
        return LinkInertia(
            form=form,
            zero=tuple(_words(link.get("zero", []), f"{at}, zero")),
            equal=tuple(tuple(pair) for pair in equal),  # type: ignore[misc]
            motor=motor,
        )
    except RobotError as error:
        raise RobotError(f"{at}: {error}") from None


def _parameters(link: Mapping[str, Any], at: str) -> LinkParameters | None:
    keys = {"mass", "centre_of_gravity", "inertia_tensor"}
    if not keys & set(link):
        return None
    if missing := sorted(keys - set(link)):
        raise RobotError(f"{at}: has {', '.join(sorted(keys & set(link)))} but no {missing[0]}")
    mass = _number(link["mass"], f"{at}, mass")
    if mass < 0:
        raise RobotError(f"{at}, mass: expected a mass of zero or more in kg, got {mass}")
    centre = _array(link["centre_of_gravity"], (3,), f"{at}, centre_of_gravity")
    tensor = link["inertia_tensor"]
    if isinstance(tensor, list) and len(tensor) == 3 and not isinstance(tensor[0], list):
        inertia = np.diag(_array(tensor, (3,), f"{at}, inertia_tensor"))
    else:
        inertia = _array(tensor, (3, 3), f"{at}, inertia_tensor")
    if not np.array_equal(inertia, inertia.T):
        raise RobotError(f"{at}, inertia_tensor: expected a symmetric tensor, got {tensor!r}")
    return LinkParameters(
        mass, centre, inertia, _number(link.get("motor_inertia", 0.0), f"{at}, motor_inertia")
    )


def _friction(entries: list[Any], term: str, where: str) -> tuple[float, ...] | None:
    given = [
        _number(entry[term], f"{where}, joint {i}, {term}")
        for i, entry in enumerate(entries, start=1)
        if term in entry
    ]
    if not given:
        return None
    if len(given) != len(entries):
        raise RobotError(f"{where}: {term} is given for {len(given)} of {len(entries)} joints")
    return tuple(given)


def _numbering(table: Any, where: str) -> Numbering:
    at = f"{where}, [numbering]"
    table = _table(table, at)
    _known(table, {"source", "mass", "velocity", "gravity"}, at)

    def part(name: str) -> Subnumbering:
        sub = _table(table.get(name, {}), f"{at}, {name}")
        _known(sub, {"inputs", "coefficients"}, f"{at}, {name}")
        try:
            coefficients = tuple(
                (str(entry), tuple(int(index) for index in column), float(multiple))
                for entry, column, multiple in sub.get("coefficients", [])
            )
        except (TypeError, ValueError):
            raise RobotError(
                f"{at}, {name}, coefficients: expected entries [input, [row, column], multiple]"
            ) from None
        return Subnumbering(
            tuple(_words(sub.get("inputs", []), f"{at}, {name}, inputs")), coefficients
        )

    return Numbering(str(table.get("source", "")), part("mass"), part("velocity"), part("gravity"))


def _table(value: Any, at: str) -> dict[str, Any]:
    if not isinstance(value, dict):
        raise RobotError(f"{at}: expected a table, got {value!r}")
    return value  # pyright: ignore[reportUnknownVariableType]


def _known(table: Mapping[str, Any], allowed: set[str], at: str) -> None:
    if unknown := sorted(set(table) - allowed):
        raise RobotError(
            f"{at}: unknown key {unknown[0]!r}; expected some of {', '.join(sorted(allowed))}"
        )


def _number(value: Any, at: str) -> float:
    if isinstance(value, bool) or not isinstance(value, int | float) or not np.isfinite(value):
        raise RobotError(f"{at}: expected a finite number, got {value!r}")
    return float(value)


def _words(value: Any, at: str) -> list[str]:
    if not isinstance(value, list) or not all(isinstance(word, str) for word in value):
        raise RobotError(f"{at}: expected a list of words, got {value!r}")
    return value  # pyright: ignore[reportUnknownVariableType]


def _array(value: Any, shape: tuple[int, ...], at: str) -> np.ndarray:
    try:
        array = np.asarray(value, dtype=float)
    except (TypeError, ValueError):
        array = np.empty(0)
    if array.shape != shape or not np.all(np.isfinite(array)):
        size = " by ".join(str(length) for length in shape)
        raise RobotError(f"{at}: expected {size} finite numbers, got {value!r}")
    return array
