"""Edits of URDF, MJCF and TOML files that change parameters and nothing else.

Motor inertias of a URDF are kept in a TOML file next to it.
"""

import re
from collections.abc import Collection, Mapping, Sequence
from dataclasses import dataclass, field
from pathlib import Path
from typing import Any, cast

import numpy as np
from jaxtyping import Float

from .._plain_data import toml_document
from .._scratch import unfinished
from ..bodies import PhysicalParameters, body_of, link_of, pseudo_inertia
from ..manipulator import (
    START_TAG,
    TENSOR_ENTRIES,
    Element,
    LinkParameters,
    Manipulator,
    RobotError,
    Source,
    parse_xml,
    seen_from,
)


_HEADER = """\
# Motor inertias of {name}, for which URDF has no element: what the motor adds to the inertia of its
# joint, seen at the joint [kg m², of a prismatic joint kg]. MJCF calls it armature, Pinocchio
# model.armature. The bodies of {name} are those beside them.
robot = "{name}"

[motor_inertia]
"""


def motor_file(robot: str | Path) -> Path:
    """Return the file of a URDF's motor inertias, next to it, with the suffix `.motors.toml`.

    >>> from jaxcslc.export import motor_file
    >>> motor_file("build/arm_identified.urdf").name
    'arm_identified.motors.toml'
    """
    path = Path(robot)
    return path.with_name(f"{path.stem}.motors.toml")


def write_motor_inertias(robot: str | Path, inertias: Mapping[str, float]) -> Path:
    """Write the motor inertias of a URDF's joints next to it, as TOML.

    **Arguments**

    - `robot`: the URDF.
    - `inertias`: by joint [kg m², of prismatic joints kg].

    **Returns** the file: `motor_file(robot)`.

    **Raises**

    - `OSError`: it cannot be written.

    >>> import tempfile
    >>> from jaxcslc.export import read_motor_inertias, write_motor_inertias
    >>> with tempfile.TemporaryDirectory() as folder:
    ...     path = write_motor_inertias(Path(folder) / "arm.urdf", {"elbow": 0.25})
    ...     read_motor_inertias(path)
    {'elbow': 0.25}
    """
    path, name = motor_file(robot), _quoted(Path(robot).name)
    lines = [f'"{_quoted(joint)}" = {float(value)!r}' for joint, value in inertias.items()]
    with unfinished(path) as file:
        file.write_text(
            _HEADER.format(name=name) + "\n".join(lines) + "\n",
            encoding="utf-8",
            errors="backslashreplace",
        )
    return path


def read_motor_inertias(path: str | Path) -> dict[str, float]:
    """Read what `write_motor_inertias` wrote, by joint [kg m², of prismatic joints kg].

    **Arguments**

    - `path`: of the file.

    **Returns** the inertias.

    **Raises**

    - `ValueError`: the file is no such file; the message names file and entry.
    - `OSError`: it cannot be read.

    >>> import tempfile
    >>> from jaxcslc.export import read_motor_inertias
    >>> with tempfile.TemporaryDirectory() as folder:
    ...     path = Path(folder) / "arm.motors.toml"
    ...     _ = path.write_text("[motor_inertia]\\nelbow = 0.25\\n")
    ...     read_motor_inertias(path)
    {'elbow': 0.25}
    """
    document = toml_document(path, "file of motor inertias", ValueError)
    table = document.get("motor_inertia")
    if not isinstance(table, dict):
        raise ValueError(f"{path}: expected a table [motor_inertia] of numbers by joint")
    for joint, value in table.items():
        if isinstance(value, bool) or not isinstance(value, int | float) or not value >= 0:
            raise ValueError(f"{path}, motor_inertia, {joint}: expected 0 or more, got {value!r}")
    return {joint: float(value) for joint, value in table.items()}


def _quoted(text: str) -> str:
    """Return a text as TOML has it between quotes."""
    import tomlkit

    return tomlkit.string(text).as_string()[1:-1]


_ATTRIBUTE = re.compile(rb"""(\s+)([^\s=/>"']+)\s*=\s*("[^"]*"|'[^']*')""")


@dataclass(eq=False)
class _Change:
    element: Element
    attributes: dict[str, str] = field(default_factory=dict[str, str])
    removed: set[str] = field(default_factory=set[str])
    children: list[bytes] = field(default_factory=list[bytes])


class XmlEdits:
    """Changes of an XML text that leave all other bytes as they are.

    Attributes are set, taken away or added in their element's tag; new elements go before an
    element's first child. Comments, whitespace, quotes and the order of attributes stay.

    >>> from jaxcslc.manipulator import parse_xml
    >>> text = b'<a>  <!-- as it was --> <b x = "1"/></a>'
    >>> edits = XmlEdits(text)
    >>> edits.set(parse_xml(text, "example").children[0], {"x": "2", "y": "3"})
    >>> edits.text()
    b'<a>  <!-- as it was --> <b x = "2" y="3"/></a>'
    """

    def __init__(self, text: bytes) -> None:
        self._text = text
        self._changes: dict[int, _Change] = {}

    def set(
        self, element: Element, attributes: Mapping[str, str], *, without: tuple[str, ...] = ()
    ) -> None:
        """Give an element attributes, and take others away."""
        change = self._changes.setdefault(element.start, _Change(element))
        change.attributes |= attributes
        change.removed |= set(without)

    def insert(self, element: Element, child: str) -> None:
        """Insert a first child, on a separate line if the others are, indented as they are."""
        change = self._changes.setdefault(element.start, _Change(element))
        change.children.append(child.encode())

    def text(self) -> bytes:
        """Return the text with all changes made."""
        text = self._text
        for start in sorted(self._changes, reverse=True):
            change = self._changes[start]
            tag = START_TAG.match(text, start)
            assert tag is not None
            new = _with_attributes(tag[0], change)
            if change.children:
                new = self._with_children(new, change)
            text = text[:start] + new + text[tag.end() :]
        return text

    def _with_children(self, tag: bytes, change: _Change) -> bytes:
        outer = _indentation(self._text, change.element.start)
        inner = outer + b"  "
        if change.element.children:
            inner = _indentation(self._text, change.element.children[0].start)
        lines = b"".join(inner + child.replace(b"\n", inner) for child in change.children)
        if tag.endswith(b"/>"):
            name = change.element.tag.encode()
            return tag[:-2].rstrip() + b">" + lines + outer + b"</" + name + b">"
        return tag + lines


def _with_attributes(tag: bytes, change: _Change) -> bytes:
    new = {name.encode(): value.encode() for name, value in change.attributes.items()}
    removed = {name.encode() for name in change.removed}

    def changed(match: re.Match[bytes]) -> bytes:
        name, quoted = match[2], match[3]
        if name in removed:
            return b""
        if name not in new:
            return match[0]
        return match[0][: -len(quoted)] + quoted[:1] + new.pop(name) + quoted[:1]

    tag = _ATTRIBUTE.sub(changed, tag)
    end = b"/>" if tag.endswith(b"/>") else b">"
    body = tag[: -len(end)]
    bare = body.rstrip()
    added = b"".join(b' %s="%s"' % pair for pair in new.items())
    return bare + added + body[len(bare) :] + end


def _indentation(text: bytes, start: int) -> bytes:
    """Return line break and spaces before an element; nothing if it does not begin a line."""
    before = text[:start]
    space = before[len(before.rstrip()) :]
    return space[space.rfind(b"\n") :] if b"\n" in space else b""


_FULL = ("ixx", "iyy", "izz", "ixy", "ixz", "iyz")
_ORIENTATIONS = ("quat", "axisangle", "xyaxes", "zaxis", "euler", "diaginertia")
# What each format stores of all that torque depends on, beside the bodies.
STORED = {
    "toml": ("viscous", "dry", "motor_inertia"),
    "urdf": ("viscous", "dry"),
    "mjcf": ("viscous", "dry", "motor_inertia"),
}


def with_parameters(
    robot: Manipulator,
    parameters: PhysicalParameters,
    text: bytes,
    *,
    stored: Collection[str],
    slopes: Mapping[int, float],
) -> bytes:
    """Return a robot's file with other link parameters and friction, and nothing else changed.

    **Arguments**

    - `robot`: as read from the file; `robot.source` maps its links to the file's bodies.
    - `parameters`: those to write; bodies that the file has fixed to a link are subtracted first.
    - `text`: contents of the file: TOML, URDF or MJCF.
    - `stored`: kinds of friction whose numbers are written to a TOML file; others stay as they are.
    - `slopes`: of static friction, by the joint, from 0; for TOML.

    In URDF and MJCF, masses, centres and tensors go into the bodies' inertial elements, damping
    and friction loss to their joints, motor inertia to MJCF's armature. Bodies fixed to a link
    keep their numbers. In TOML what is listed as zero stays zero.

    **Returns** the new contents of the file.

    **Raises**

    - `RobotError`: if the robot was read from no file, or a body or joint is not in this one, as
      when it comes from an include; for several joints on one body.
    """
    source = robot.source
    if source is None or source.format == "toml":
        return _toml(robot, parameters, text, stored, slopes)
    if len(set(source.links)) < len(source.links):
        twice = next(name for name in source.links if source.links.count(name) > 1)
        raise RobotError(
            f"{source.path}: body {twice!r} has several joints, and the links between them no"
            " bodies to write parameters to"
        )
    bodies = [
        seen_from(_remainder(source, i, link), np.linalg.inv(source.placements[i]))
        for i, link in enumerate(parameters.links)
    ]
    root = parse_xml(text, source.path)
    write = _urdf if source.format == "urdf" else _mjcf
    edits = XmlEdits(text)
    write(root, source, bodies, parameters, edits)
    return edits.text()


def _remainder(source: Source, i: int, link: LinkParameters) -> LinkParameters:
    """Return a link without the bodies that the file has fixed to it."""
    carried = source.carried[i]
    if carried is None:
        return link
    body = body_of(link) - body_of(carried)
    if np.linalg.eigvalsh(pseudo_inertia(body))[0] <= 0:
        raise RobotError(
            f"{source.path}: link {source.links[i]!r} without the bodies that the file has fixed to"
            " it is not physically consistent; use physical_parameters with"
            " fixed=robot.source.carried"
        )
    return link_of(body, float(link.motor_inertia))


def _urdf(
    root: Element,
    source: Source,
    bodies: Sequence[LinkParameters],
    parameters: PhysicalParameters,
    edits: XmlEdits,
) -> None:
    from scipy.spatial.transform import Rotation

    links = {element.attributes.get("name", ""): element for element in root.all("link")}
    joints = {element.attributes.get("name", ""): element for element in root.all("joint")}
    for i, (joint, name, body) in enumerate(zip(source.joints, source.links, bodies, strict=True)):
        link = _element(links, name, "link", source)
        inertial = link.first("inertial")
        if inertial is None:
            origin, mass, tensor = _urdf_numbers(body, np.eye(3))
            edits.insert(
                link,
                f"<inertial>\n  <origin {_text(origin)}/>\n  <mass {_text(mass)}/>\n"
                f"  <inertia {_text(tensor)}/>\n</inertial>",
            )
        else:
            origin = inertial.first("origin")
            angles = (origin.attributes.get("rpy", "") if origin else "").split() or ["0"] * 3
            # Roll, pitch and yaw are about fixed axes x, y, z.
            axes = Rotation.from_euler("xyz", [float(x) for x in angles]).as_matrix()
            position, mass, tensor = _urdf_numbers(body, axes)
            for tag, attributes in (("inertia", tensor), ("mass", mass), ("origin", position)):
                element = inertial.first(tag)
                if element is None:
                    edits.insert(inertial, f"<{tag} {_text(attributes)}/>")
                else:
                    edits.set(element, attributes)
        drive = _drive(parameters, i, {"viscous": "damping", "dry": "friction"})
        element = _element(joints, joint, "joint", source)
        dynamics = element.first("dynamics")
        if dynamics is not None:
            edits.set(dynamics, drive)
        elif drive:
            edits.insert(element, f"<dynamics {_text(drive)}/>")


def _urdf_numbers(
    body: LinkParameters, axes: Float[np.ndarray, "3 3"]
) -> tuple[dict[str, str], dict[str, str], dict[str, str]]:
    """Return attributes of origin, mass and inertia, the tensor in the inertial element's axes."""
    tensor = axes.T @ np.asarray(body.inertia) @ axes
    return (
        {"xyz": _numbers(body.centre_of_gravity)},
        {"value": _number(body.mass)},
        dict(
            zip(_FULL, _numbers([tensor[index] for index in TENSOR_ENTRIES]).split(), strict=True)
        ),
    )


def _mjcf(
    root: Element,
    source: Source,
    bodies: Sequence[LinkParameters],
    parameters: PhysicalParameters,
    edits: XmlEdits,
) -> None:
    elements: dict[str, Element] = {}
    todo = root.all("worldbody")
    while todo:
        element = todo.pop()
        todo += [child for child in element.children if child.tag in ("body", "frame")]
        if element.tag == "body":
            elements[element.attributes.get("name", "")] = element
    for i, (joint, name, body) in enumerate(zip(source.joints, source.links, bodies, strict=True)):
        element = _element(elements, name, "body", source)
        tensor = np.asarray(body.inertia)
        attributes = {
            "pos": _numbers(body.centre_of_gravity),
            "mass": _number(body.mass),
            "fullinertia": _numbers([tensor[index] for index in TENSOR_ENTRIES]),
        }
        joints = element.all("joint")
        named = {child.attributes.get("name", ""): child for child in joints}
        hinge = joints[0] if len(joints) == 1 else _element(named, joint, "joint", source)
        drive = _drive(parameters, i, {"viscous": "damping", "dry": "frictionloss"})
        edits.set(hinge, drive | {"armature": _number(parameters.links[i].motor_inertia)})
        inertial = element.first("inertial")
        if inertial is None:
            edits.insert(element, f"<inertial {_text(attributes)}/>")
        else:
            edits.set(inertial, attributes, without=_ORIENTATIONS)


def _toml(
    robot: Manipulator,
    parameters: PhysicalParameters,
    text: bytes,
    stored: Collection[str],
    slopes: Mapping[int, float],
) -> bytes:
    import tomlkit

    document = tomlkit.parse(text.decode("utf-8"))
    entries = cast(list[Any], document["joint"])
    for i, (entry, inertia, link) in enumerate(
        zip(entries, robot.inertia, parameters.links, strict=True)
    ):
        if "link" not in entry:
            entry["link"] = tomlkit.table()
        table = entry["link"]
        tensor = np.asarray(link.inertia, float)
        zero = set(inertia.zero)
        if inertia.form == "principal":
            for axis in range(3):
                if f"I{'xyz'[axis] * 2}" in zero:
                    tensor[axis, axis] = 0.0
        for first, second in inertia.equal:
            a, b = ("xyz".index(moment[1]) for moment in (first, second))
            if inertia.form == "principal":
                tensor[b, b] = tensor[a, a]
        table["mass"] = 0.0 if "m" in zero else float(rounded(link.mass))
        table["centre_of_gravity"] = rounded(link.centre_of_gravity).tolist()
        principal = not np.any(tensor - np.diag(np.diag(tensor)))
        table["inertia_tensor"] = rounded(np.diag(tensor) if principal else tensor).tolist()
        if inertia.motor:
            table["motor_inertia"] = float(rounded(link.motor_inertia))
        for term in ("viscous", "dry"):
            if term in stored and term in parameters.friction:
                entry[term] = float(rounded(parameters.friction[term][i]))
        if i in slopes:
            entry["static_slope"] = slopes[i]
    return tomlkit.dumps(document).encode("utf-8")


def _element(elements: Mapping[str, Element], name: str, what: str, source: Source) -> Element:
    if name not in elements:
        raise RobotError(
            f"{source.path}: {what} {name!r} is not an element of this file (included or"
            " unnamed ones cannot be written)"
        )
    return elements[name]


def _drive(parameters: PhysicalParameters, joint: int, names: Mapping[str, str]) -> dict[str, str]:
    """Return the attributes of a joint's friction, named by kinds."""
    friction = parameters.friction
    return {
        name: _number(friction[kind][joint]) for kind, name in names.items() if kind in friction
    }


def _text(attributes: Mapping[str, str]) -> str:
    return " ".join(f'{name}="{value}"' for name, value in attributes.items())


# Digits of the largest of a body's numbers: what rotations and sums leave is smaller, and zero.
_DIGITS = 12
_TINY = 1e-200  # no mass, length or moment


def rounded(values: Any) -> Float[np.ndarray, "*shape"]:
    """Return numbers that belong together, without what is rounding next to the largest.

    >>> rounded([0.25, -1.5e-27, 1 / 3]).tolist()
    [0.25, 0.0, 0.333333333333]
    """
    values = np.asarray(values, float)
    largest = float(np.max(np.abs(values), initial=0.0))
    if not _TINY < largest < np.inf:
        return np.where(np.isfinite(values), 0.0, values)
    return np.asarray(np.round(values, _DIGITS - 1 - int(np.floor(np.log10(largest)))) + 0.0)


def _number(value: Any) -> str:
    return f"{float(rounded(value)):.{_DIGITS}g}"


def _numbers(values: Any) -> str:
    return " ".join(f"{value:.{_DIGITS}g}" for value in rounded(values).tolist())
