import math
from collections.abc import Collection, Mapping, Sequence
from typing import Any, cast

import numpy as np
from jaxtyping import Float

from ..identification import PhysicalParameters
from ..inertia import body_of, link_of, pseudo_inertia
from ..manipulator import (
    Element,
    LinkParameters,
    Manipulator,
    RobotError,
    Source,
    parse_xml,
    seen_from,
)
from ._xml_edits import XmlEdits


_FULL = ("ixx", "iyy", "izz", "ixy", "ixz", "iyz")
_INDICES = ((0, 0), (1, 1), (2, 2), (0, 1), (0, 2), (1, 2))
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
    """A robot's file with other link parameters and friction, and nothing else changed.

    **Arguments**

    - `robot`: as read from the file; `robot.source` maps its links to the file's bodies.
    - `parameters`: those to write; bodies that the file has fixed to a link are subtracted first.
    - `text`: contents of the file: TOML, URDF or MJCF.
    - `stored`: kinds of friction whose numbers are written to a TOML file; others stay as they are.
    - `slopes`: of static friction, by the joint, from 0; for TOML.

    In URDF and MJCF, masses, centres and tensors go into the bodies' inertial elements, damping
    and friction loss to their joints, motor inertia to MJCF's armature. Bodies fixed to a link
    keep their numbers. In TOML what is listed as zero stays zero.

    **Returns**

    - The new contents of the file.

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
    """A link without the bodies that the file has fixed to it."""
    carried = source.carried[i]
    if carried is None:
        return link
    body = body_of(link) - body_of(carried)
    if np.linalg.eigvalsh(pseudo_inertia(body))[0] <= 0:
        raise RobotError(
            f"{source.path}: link {source.links[i]!r} without the bodies that the file has fixed to"
            " it is no possible body; use physical_parameters with fixed=robot.source.carried"
        )
    return link_of(body, float(link.motor_inertia))


def _urdf(
    root: Element,
    source: Source,
    bodies: Sequence[LinkParameters],
    parameters: PhysicalParameters,
    edits: XmlEdits,
) -> None:
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
            position, mass, tensor = _urdf_numbers(body, _from_rpy([float(x) for x in angles]))
            for tag, attributes in (("inertia", tensor), ("mass", mass), ("origin", position)):
                element = inertial.first(tag)
                if element is None:
                    edits.insert(inertial, f"<{tag} {_text(attributes)}/>")
                else:
                    edits.set(element, attributes)
        drive = {
            attribute: _number(parameters.friction[kind][i])
            for attribute, kind in (("damping", "viscous"), ("friction", "dry"))
            if kind in parameters.friction
        }
        element = _element(joints, joint, "joint", source)
        dynamics = element.first("dynamics")
        if dynamics is not None:
            edits.set(dynamics, drive)
        elif drive:
            edits.insert(element, f"<dynamics {_text(drive)}/>")


def _urdf_numbers(
    body: LinkParameters, axes: Float[np.ndarray, "3 3"]
) -> tuple[dict[str, str], dict[str, str], dict[str, str]]:
    """Attributes of origin, mass and inertia, the tensor in the inertial element's axes."""
    tensor = axes.T @ np.asarray(body.inertia) @ axes
    return (
        {"xyz": _numbers(body.centre_of_gravity)},
        {"value": _number(body.mass)},
        {name: _number(tensor[index]) for name, index in zip(_FULL, _INDICES, strict=True)},
    )


def _from_rpy(angles: Sequence[float]) -> Float[np.ndarray, "3 3"]:
    """Roll, pitch and yaw about fixed axes x, y, z, as URDF has them."""
    (cr, cp, cy), (sr, sp, sy) = ([f(angle) for angle in angles] for f in (math.cos, math.sin))
    return np.array(
        [
            [cy * cp, cy * sp * sr - sy * cr, cy * sp * cr + sy * sr],
            [sy * cp, sy * sp * sr + cy * cr, sy * sp * cr - cy * sr],
            [-sp, cp * sr, cp * cr],
        ]
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
            "fullinertia": _numbers([tensor[index] for index in _INDICES]),
        }
        joints = element.all("joint")
        named = {child.attributes.get("name", ""): child for child in joints}
        hinge = joints[0] if len(joints) == 1 else _element(named, joint, "joint", source)
        terms = {
            "damping": parameters.friction.get("viscous"),
            "frictionloss": parameters.friction.get("dry"),
        }
        drive = {name: _number(x[i]) for name, x in terms.items() if x is not None}
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
        table["mass"] = 0.0 if "m" in zero else float(link.mass)
        table["centre_of_gravity"] = [float(x) for x in np.asarray(link.centre_of_gravity)]
        principal = not np.any(tensor - np.diag(np.diag(tensor)))
        table["inertia_tensor"] = (np.diag(tensor) if principal else tensor).tolist()
        if inertia.motor:
            table["motor_inertia"] = float(link.motor_inertia)
        for term in ("viscous", "dry"):
            if term in stored and term in parameters.friction:
                entry[term] = float(parameters.friction[term][i])
        if i in slopes:
            entry["static_slope"] = slopes[i]
    return tomlkit.dumps(document).encode("utf-8")


def _element(elements: Mapping[str, Element], name: str, what: str, source: Source) -> Element:
    if name not in elements:
        raise RobotError(
            f"{source.path}: {what} {name!r} is no element of this file (included or"
            " unnamed ones cannot be written)"
        )
    return elements[name]


def _text(attributes: Mapping[str, str]) -> str:
    return " ".join(f'{name}="{value}"' for name, value in attributes.items())


def _number(value: Any) -> str:
    return repr(float(value))


def _numbers(values: Any) -> str:
    return " ".join(_number(value) for value in np.asarray(values))
