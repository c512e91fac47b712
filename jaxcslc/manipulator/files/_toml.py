"""Reader of robots in TOML, the package's own format (`docs/robots.md`), and the bundled robots."""

import dataclasses
import tomllib
from collections.abc import Mapping, Sequence
from importlib.resources import files
from pathlib import Path
from typing import Any

import numpy as np

from jaxcslc._plain_data import toml_document

from .._friction import STATIC_SLOPE, Coupling, couplings
from .._joint import (
    LARGEST,
    Joint,
    Numbering,
    RobotError,
    Subnumbering,
    finite_number,
    length_table,
    parsed_joint,
    unused_lengths,
)
from .._link_parameters import LinkInertia, LinkParameters, motor_inertia
from .._manipulator import Manipulator, Source


_ROUNDING = 1e-12  # by which a link's values may miss what it lists as zero or equal [SI units]
_ROBOT_KEYS = {
    *("name", "about", "gravity", "friction", "coupled", "lengths", "links", "joint", "numbering"),
    "drive",
}
_DEFAULT_KEYS = {"inertia", "motor_inertia"}
_JOINT_KEYS = {
    *("kind", "alpha", "a", "d", "theta", "gamma", "b", "parent", "link", "viscous", "dry"),
    *("name", "friction", "static_slope"),
}
_GEARED_KEYS = ("rotor_inertia", "gear_ratio")
_KNOWN_KEYS = ("mass", "centre_of_gravity")
_LINK_KEYS = {
    *("inertia", "motor", "zero", "equal", "known"),
    *("mass", "centre_of_gravity", "inertia_tensor", "motor_inertia", *_GEARED_KEYS),
}


def read_toml(path: Path) -> Manipulator:
    """A robot from its TOML description; the format is documented in `docs/robots.md`.

    **Raises** `RobotError`: one line that names the file, the joint and the key that is missing,
    unknown or contradictory, and what was expected.
    """
    document = toml_document(path, "robot file", RobotError)
    robot = _robot(document, str(path))
    n = robot.joint_count
    names = _joint_names(document["joint"], str(path))
    links = tuple(f"link {i}" for i in range(1, n + 1))
    source = Source(str(path), "toml", names, links, (np.eye(4),) * n, (None,) * n)
    return dataclasses.replace(robot, source=source)


def puma560() -> Manipulator:
    """Return the PUMA 560 of the thesis (Fig. 2.6-4), with Appendix B's numbering.

    Geometry and link parameters are Armstrong, Khatib and Burdick's (1986), friction is Leahy
    and Saridis's (1989). The thesis evaluates its 'Armstrong et al.' columns with
    g = 9.814 m/s²: use `puma560().with_gravity((0, 0, -9.814))` to reproduce them.

    >>> puma560().joint_count
    6
    """
    return _bundled("puma560.toml")


def panda() -> Manipulator:
    """Return the Franka Emika Panda: 7 revolute joints, full inertia tensors, link-side torque
    sensors.

    Kinematics as its maker publishes them; no link parameters.

    >>> panda().kinds
    'RRRRRRR'
    """
    return _bundled("panda.toml")


def tx40() -> Manipulator:
    """Return the Stäubli TX40: 6 revolute joints, full inertia tensors, the wrist's motors coupled.

    Kinematics of the URDF in figaroh-examples; no link parameters. Static friction, and the
    shaft that joints 5 and 6 share, are part of its friction model.

    >>> tx40().coupled
    (Coupling(first=5, second=6, ratio=1.0),)
    """
    return _bundled("tx40.toml")


def _bundled(name: str) -> Manipulator:
    source = files("jaxcslc.manipulator") / "robots" / name
    return _robot(tomllib.loads(source.read_text(encoding="utf-8")), name)


def _robot(document: Mapping[str, Any], where: str) -> Manipulator:
    _table(document, where, _ROBOT_KEYS)
    named = _table(document.get("lengths", {}), f"{where}, [lengths]")
    lengths = length_table(named, f"{where}, [lengths]")
    defaults = _table(document.get("links", {}), f"{where}, [links]", _DEFAULT_KEYS)
    entries = document.get("joint")
    if not isinstance(entries, list) or not entries:
        raise RobotError(f"{where}: expected at least one [[joint]]")

    joints: list[Joint] = []
    inertia: list[LinkInertia] = []
    links: list[LinkParameters | None] = []
    for i, entry in enumerate(entries, start=1):
        at = f"{where}, joint {i}"
        table = _table(entry, at, _JOINT_KEYS)
        joints.append(parsed_joint(table, lengths, at))
        link = _table(table.get("link", {}), f"{at}, link", _LINK_KEYS)
        inertia.append(_inertia(link, defaults, f"{at}, link"))
        links.append(_parameters(link, inertia[-1], f"{at}, link"))
    unused_lengths(lengths, joints, f"{where}, [lengths]")

    present_links = [link for link in links if link is not None]
    if present_links and len(present_links) != len(links):
        missing = links.index(None) + 1
        raise RobotError(
            f"{where}, joint {missing}, link: has no mass while other links have;"
            " give every link its parameters or none"
        )
    friction = _strings(document.get("friction", ["viscous", "dry"]), f"{where}, friction")
    gravity = document.get("gravity", [0.0, 0.0, -9.81])
    if not isinstance(gravity, list):
        raise RobotError(f"{where}, gravity: expected three numbers in m/s², got {gravity!r}")
    try:
        robot = Manipulator(
            name=str(document.get("name", Path(where).stem)),
            joints=tuple(joints),
            inertia=tuple(inertia),
            gravity=(0.0, 0.0, 0.0),
            friction=tuple(friction),
            joint_friction=_joint_friction(entries, where),
            coupled=_coupled(document.get("coupled", []), joints, where),
            links=tuple(present_links) if present_links else None,
        ).with_gravity(gravity)
    except RobotError as error:
        raise error if str(error).startswith(where) else RobotError(f"{where}: {error}") from None
    return dataclasses.replace(
        robot,
        viscous=_friction(entries, "viscous", robot.friction_terms, where),
        dry=_friction(entries, "dry", robot.friction_terms, where),
        static_slopes=_static_slopes(entries, robot, where),
        numbering=_numbering(document["numbering"], where) if "numbering" in document else None,
        drive=_drive(document["drive"], len(joints), where) if "drive" in document else None,
    )


def _drive(value: Any, joints: int, where: str) -> dict[str, float | tuple[float, ...]]:
    """Return known parameters of servos: one number each, or one per joint."""
    at = f"{where}, [drive]"
    found: dict[str, float | tuple[float, ...]] = {}
    for name, entry in _table(value, at).items():
        if isinstance(entry, list):
            found[name] = tuple(map(float, _array(entry, (joints,), f"{at}, {name}")))
        else:
            found[name] = _number(entry, f"{at}, {name}")
    return found


def _inertia(link: Mapping[str, Any], defaults: Mapping[str, Any], at: str) -> LinkInertia:
    form = link.get("inertia", defaults.get("inertia", "full"))
    if form not in ("full", "principal"):
        raise RobotError(f"{at}: inertia form must be 'full' or 'principal', got {form!r}")
    motor = link.get("motor", defaults.get("motor_inertia", True))
    if not isinstance(motor, bool):
        raise RobotError(f"{at}, motor: expected true or false, got {motor!r}")
    equal = link.get("equal", [])
    if not isinstance(equal, list) or not all(isinstance(pair, list) for pair in equal):
        raise RobotError(f"{at}, equal: expected a list of pairs, got {equal!r}")
    known = _strings(link.get("known", []), f"{at}, known")
    for name in known:
        if name not in _KNOWN_KEYS:
            raise RobotError(f"{at}, known: expected {' or '.join(_KNOWN_KEYS)}, got {name!r}")
        if name not in link:
            raise RobotError(f"{at}: {name} is listed as known and has no value")
    mass, centre = (link[name] if name in known else None for name in _KNOWN_KEYS)
    if centre is not None:
        centre = tuple(_array(centre, (3,), f"{at}, centre_of_gravity").tolist())
    try:
        return LinkInertia(
            form=form,
            mass=None if mass is None else _number(mass, f"{at}, mass"),
            centre=centre,
            zero=tuple(_strings(link.get("zero", []), f"{at}, zero")),
            equal=tuple(tuple(pair) for pair in equal),  # type: ignore[misc]
            motor=motor,
        )
    except RobotError as error:
        raise RobotError(f"{at}: {error}") from None


def _parameters(link: Mapping[str, Any], inertia: LinkInertia, at: str) -> LinkParameters | None:
    keys = {"mass", "centre_of_gravity", "inertia_tensor"}
    present = sorted((keys | {"motor_inertia", *_GEARED_KEYS}) & set(link))
    if set(present) <= set(link.get("known", [])):
        return None  # numbers of the algebra alone
    if missing := sorted(keys - set(link), reverse=True):
        raise RobotError(f"{at}: has {', '.join(present)} but no {missing[0]}")
    mass = _number(link["mass"], f"{at}, mass")
    if mass < 0:
        raise RobotError(f"{at}, mass: expected a mass of zero or more in kg, got {mass}")
    centre = _array(link["centre_of_gravity"], (3,), f"{at}, centre_of_gravity")
    entry = link["inertia_tensor"]
    if isinstance(entry, list) and len(entry) == 3 and not isinstance(entry[0], list):
        tensor = np.diag(_array(entry, (3,), f"{at}, inertia_tensor"))
    else:
        tensor = _array(entry, (3, 3), f"{at}, inertia_tensor")
    if not np.array_equal(tensor, tensor.T):
        raise RobotError(f"{at}, inertia_tensor: expected a symmetric tensor, got {entry!r}")
    if np.any(np.linalg.eigvalsh(tensor) < -_ROUNDING):
        raise RobotError(
            f"{at}, inertia_tensor: expected moments of zero or more in kg m², got {entry!r}"
        )
    motor = _motor_inertia(link, at)
    if motor < 0 or (motor and not inertia.motor):
        raise RobotError(
            f"{at}, motor_inertia: expected {'0 or more' if inertia.motor else 'none'}, got {motor}"
            + ("" if inertia.motor else ", because motor is false")
        )
    parameters = LinkParameters(mass, centre, tensor, motor)
    _agrees(parameters, inertia, at)
    return parameters


def _motor_inertia(link: Mapping[str, Any], at: str) -> float:
    if not (geared := [key for key in _GEARED_KEYS if key in link]):
        return _number(link.get("motor_inertia", 0.0), f"{at}, motor_inertia")
    if len(geared) == 1 or "motor_inertia" in link:
        raise RobotError(f"{at}: expected motor_inertia, or rotor_inertia and gear_ratio")
    rotor, ratio = (_number(link[key], f"{at}, {key}") for key in geared)
    try:
        return motor_inertia(rotor, ratio)
    except RobotError as error:
        raise RobotError(f"{at}, {error}") from None


def _agrees(link: LinkParameters, inertia: LinkInertia, at: str) -> None:
    """Check that a link's values have the zeros and equal moments that it lists.

    **Raises** `RobotError` where values contradict `zero` and `equal`.
    """
    principal = inertia.form == "principal"
    tensor = np.asarray(link.inertia if principal else link.inertia_at_frame)
    values = {"m": float(link.mass)}
    values |= {f"r{a}": float(r) for a, r in zip("xyz", link.centre_of_gravity, strict=True)}
    values |= {f"I{'xyz'[i]}{'xyz'[j]}": float(tensor[i, j]) for i in range(3) for j in range(i, 3)}
    for name in inertia.zero:
        if abs(values[name]) > _ROUNDING:
            raise RobotError(f"{at}: {name} is {values[name]}, and listed as zero")
    for first, second in inertia.equal:
        if abs(values[first] - values[second]) > _ROUNDING:
            raise RobotError(
                f"{at}: {first} is {values[first]} and {second} is {values[second]}, and they are"
                " listed as equal"
            )


def _numbers(entries: list[Any], key: str, where: str) -> dict[int, float]:
    """Return the numbers that joints have under a key, by the joint's number from 1."""
    return {
        i: _number(entry[key], f"{where}, joint {i}, {key}")
        for i, entry in enumerate(entries, start=1)
        if key in entry
    }


def _friction(
    entries: list[Any], term: str, friction: Sequence[str], where: str
) -> tuple[float, ...] | None:
    values = _numbers(entries, term, where)
    for i, value in values.items():
        if value < 0:
            raise RobotError(f"{where}, joint {i}, {term}: expected zero or more, got {value}")
    if not values:
        return None
    if len(values) != len(entries):
        raise RobotError(f"{where}: {term} is given for {len(values)} of {len(entries)} joints")
    if term not in friction:
        raise RobotError(
            f"{where}: joints have {term} friction, which is not among the terms of friction:"
            f" {', '.join(friction) or 'none'}"
        )
    return tuple(values.values())


def _static_slopes(entries: list[Any], robot: Manipulator, where: str) -> tuple[float, ...] | None:
    slopes = _numbers(entries, "static_slope", where)
    for i, slope in slopes.items():
        at = f"{where}, joint {i}, static_slope"
        if slope <= 0:
            raise RobotError(f"{at}: expected a number above 0, got {slope}")
        if "static" not in robot.friction_per_joint[i - 1]:
            raise RobotError(f"{at}: the joint has no static friction among its terms")
    numbers = range(1, len(entries) + 1)
    return tuple(slopes.get(i, STATIC_SLOPE) for i in numbers) if slopes else None


def _joint_names(entries: list[Any], where: str) -> tuple[str, ...]:
    names: list[str] = []
    for i, entry in enumerate(entries, start=1):
        name = entry.get("name", f"joint {i}")
        if not isinstance(name, str) or not name.strip() or name != name.strip():
            raise RobotError(f"{where}, joint {i}, name: expected a text, got {name!r}")
        if name in names:
            raise RobotError(
                f"{where}, joint {i}, name: joint {names.index(name) + 1} is {name!r} too"
            )
        names.append(name)
    return tuple(names)


def _joint_friction(entries: list[Any], where: str) -> tuple[tuple[str, ...] | None, ...] | None:
    per_joint = tuple(
        tuple(_strings(entry["friction"], f"{where}, joint {i}, friction"))
        if "friction" in entry
        else None
        for i, entry in enumerate(entries, start=1)
    )
    return per_joint if any(terms is not None for terms in per_joint) else None


def _coupled(value: Any, joints: list[Joint], where: str) -> tuple[Coupling, ...]:
    if not isinstance(value, list) or not all(isinstance(pair, list) for pair in value):
        raise RobotError(f"{where}, coupled: expected a list of pairs of joints, got {value!r}")
    return couplings(value, "".join(joint.kind for joint in joints), where)


def _numbering(table: Any, where: str) -> Numbering:
    at = f"{where}, [numbering]"
    table = _table(table, at, {"source", "mass", "velocity", "gravity"})

    def part(name: str) -> Subnumbering:
        sub = _table(table.get(name, {}), f"{at}, {name}", {"inputs", "coefficients"})
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
            tuple(_strings(sub.get("inputs", []), f"{at}, {name}, inputs")), coefficients
        )

    return Numbering(str(table.get("source", "")), part("mass"), part("velocity"), part("gravity"))


def _table(value: Any, at: str, keys: set[str] | None = None) -> dict[str, Any]:
    """Return a table, which has none but these keys."""
    if not isinstance(value, dict):
        raise RobotError(f"{at}: expected a table, got {value!r}")
    table: dict[str, Any] = value  # pyright: ignore[reportUnknownVariableType]
    if keys is not None and (unknown := sorted(set(table) - keys)):
        raise RobotError(
            f"{at}: unknown key {unknown[0]!r}; expected some of {', '.join(sorted(keys))}"
        )
    return table


def _number(value: Any, at: str) -> float:
    number = finite_number(value)
    if number is None:
        raise RobotError(f"{at}: expected a finite number, got {value!r}")
    return number


def _strings(value: Any, at: str) -> list[str]:
    if not isinstance(value, list) or not all(isinstance(entry, str) for entry in value):
        raise RobotError(f"{at}: expected a list of strings, got {value!r}")
    return value  # pyright: ignore[reportUnknownVariableType]


def _array(value: Any, shape: tuple[int, ...], at: str) -> np.ndarray:
    try:
        array = np.asarray(value, dtype=float)
    except (TypeError, ValueError):
        array = np.empty(0)
    if array.shape != shape or not np.all(np.abs(array) <= LARGEST):
        size = " by ".join(str(length) for length in shape)
        raise RobotError(f"{at}: expected {size} finite numbers, got {value!r}")
    return array
