"""Section on physically consistent bodies: parameters, and how they predict held-out motion."""

from collections.abc import Callable, Iterator, Mapping, Sequence
from types import MappingProxyType
from typing import Any

import numpy as np

from jaxcslc.bodies import PhysicalParameters, PossibleFit, file_bodies, possible_text
from jaxcslc.manipulator import LinkParameters, RobotError, link_poses
from jaxcslc.uncertainty import RelativeError

from .._charts import ArmChart, Ellipsoid
from .._page import AbstractBlock, Column, Paragraph, Section, Table, without_rounding
from .._section import AbstractSection, AnyReport, open_errors


# Columns of bodies, in two narrow tables.
_MASSES: dict[str, Callable[[Mapping[str, Any]], float]] = {
    "mass [kg]": lambda link: link["mass"],
    "rx [m]": lambda link: link["centre"][0],
    "ry [m]": lambda link: link["centre"][1],
    "rz [m]": lambda link: link["centre"][2],
}
_INERTIAS: dict[str, Callable[[Mapping[str, Any]], float]] = {
    "Ixx [kg m²]": lambda link: link["inertia"][0][0],
    "Iyy [kg m²]": lambda link: link["inertia"][1][1],
    "Izz [kg m²]": lambda link: link["inertia"][2][2],
    "motor inertia [kg m²]": lambda link: link["motor_inertia"],
}
_MAYBE_IN_FILE = "motor inertia [kg m²]"  # few formats have it


class PossibleSection(AbstractSection):
    """Physically consistent bodies nearest to the unconstrained fit, compared with it."""

    name = "possible"
    results = MappingProxyType({"possible": None, "bodies": None})
    entries = MappingProxyType({"possible": dict, "bodies": dict})
    position = 21

    @classmethod
    def of(cls, report: AnyReport) -> AbstractSection | None:
        found = any(report.results.get(name) is not None for name in cls.results)
        return cls(lambda: cls.document_of(report.results.get(cls.name), report)) if found else None

    @classmethod
    def document_of(cls, result: PossibleFit | None, report: AnyReport) -> Mapping[str, Any]:
        bodies: PhysicalParameters | None = report.results.get("bodies")
        return {
            **({} if result is None else {"possible": result.document()}),
            **({} if bodies is None else {"bodies": _bodies(report, bodies)}),
        }

    def result(self, name: str, report: AnyReport) -> Any:
        if name != "bodies" or not self.entries.keys() <= self.data.keys():
            return super().result(name, report)
        judged, bodies = self.data["possible"], self.data["bodies"]
        return PhysicalParameters.of_bodies(
            report.network,
            [
                LinkParameters(
                    float(link["mass"]),
                    np.array(link["centre"], float),
                    np.array(link["inertia"], float),
                    float(link["motor_inertia"]),
                )
                for link in bodies["links"]
            ],
            np.array(judged["k"], float),
            prior_weight=float(judged["prior_weight"]),
            distance=float(judged["distance"]),
            torque_distance=np.array(bodies["torque_distance"], float),
        )

    def text(self, report: AnyReport) -> Iterator[Sequence[str]]:
        if "possible" in self.data:
            yield [possible_text(open_errors(self.data["possible"]))]

    def blocks(self, report: AnyReport, charts: bool) -> Iterator[Section]:
        if "bodies" not in self.data:
            return
        bodies = self.data["bodies"]
        masses = _body_table(bodies, _MASSES, "Masses and centres of gravity (r)", "bodies")
        caption = "Moments of inertia (I), of motors too"
        inertias = _body_table(bodies, _INERTIAS, caption, "inertias")
        blocks: list[AbstractBlock] = [
            Paragraph(
                f"The coefficients of these bodies are {bodies['distance']:.3g} standard errors"
                " (root mean square) from the unconstrained fit."
            ),
            masses,
            inertias,
        ]
        if "possible" in self.data:
            blocks += _judged(report, open_errors(self.data["possible"]))
        if charts and bodies["arm"] is not None:
            blocks.append(_arm_chart(bodies["arm"]))
        elif charts:
            blocks.append(Paragraph(f"Not drawn: {bodies['no_arm']}"))
        yield Section(
            "Physically consistent parameters",
            "The physically consistent masses, centres of gravity and inertia tensors nearest to"
            " the fit, with the robot file's values where it has them. The motion determines only"
            " combinations of them; the rest follows the file or a prior. Frames are those of the"
            " file, without what it fixes to a body; inertia is about the centre of gravity."
            " jaxcslc export writes these values.",
            blocks,
        )


def _body_table(
    bodies: Mapping[str, Any],
    figures: Mapping[str, Callable[[Mapping[str, Any]], float]],
    caption: str,
    name: str,
) -> Table:
    """Return a table of bodies, each quantity next to that of the robot's file, if it has any."""
    columns = [(Column("body", numeric=False), bodies["names"])]
    for title, value in figures.items():
        identified = [value(link) for link in bodies["links"]]
        file = [value(link) for link in bodies.get("file") or ()]
        largest = max(map(abs, [*identified, *file]))
        columns.append((Column(title, digits=3), without_rounding(identified, largest)))
        if file and (title != _MAYBE_IN_FILE or any(file)):
            of_file = Column(title.replace(" [", ", file ["), digits=3)
            columns.append((of_file, without_rounding(file, largest)))
    return Table.from_columns(columns, caption, name)


def _judged(report: AnyReport, judged: Mapping[str, Any]) -> list[AbstractBlock]:
    """Return how bodies and the unconstrained fit predict held-out data."""
    text = (
        "On held-out data, errors change by"
        f" {RelativeError(judged['change'], judged['change_error'], 0)} on average relative to the"
        " unconstrained fit. This report uses the"
        f" {'physically consistent' if judged['used'] else 'unconstrained'} coefficients."
    )
    rms, free = judged["held_out_rms"], judged["free_held_out_rms"]
    pairs = zip(rms, free, strict=True)
    columns = [
        (Column("RMS error, unconstrained"), free),
        (Column("RMS error, consistent"), rms),
        (Column("ratio", digits=3), [a / b if a is not None and b else None for a, b in pairs]),
    ]
    caption = f"Held-out data ({judged['held_out']})"
    return [Paragraph(text), report.model.table(columns, caption, "bodies-held-out")]


def _bodies(report: AnyReport, bodies: PhysicalParameters) -> dict[str, Any]:
    """Return bodies as plain data, and the arm at the recording's first sample."""
    robot = report.network.robot
    names = [
        f"link of {joint}" if body.isdigit() else body
        for body, joint in zip(bodies.body_names, robot.joint_names, strict=True)
    ]
    document: dict[str, Any] = {
        "names": names,
        "links": [_link(link) for link in bodies.bodies],
        "file": [_link(link) for link in file_bodies(robot) or ()],
        "distance": float(bodies.distance),
        "torque_distance": bodies.torque_distance,
        "arm": None,
    }
    q = report.network.positions_of_all_joints(np.asarray(report.patterns["training"].q)[0])
    try:
        poses = link_poses(robot, np.asarray(q))
    except RobotError as error:  # a length without value
        return {**document, "no_arm": str(error)}
    origins = [np.zeros(3) if i < 0 else poses[i][:3, 3] for i in robot.parents]
    ellipsoids = zip(names, map(solid_ellipsoid, bodies.links), poses, strict=True)
    document["arm"] = {
        "lines": [[origin, pose[:3, 3]] for origin, pose in zip(origins, poses, strict=True)],
        "bodies": [
            {
                "name": name,
                "centre": pose[:3, :3] @ centre + pose[:3, 3],
                "axes": pose[:3, :3] @ axes,
            }
            for name, (centre, axes), pose in ellipsoids
        ],
    }
    return document


def _link(link: LinkParameters) -> dict[str, Any]:
    return {
        "mass": float(link.mass),
        "centre": link.centre_of_gravity,
        "inertia": link.inertia,
        "motor_inertia": float(link.motor_inertia),
    }


def solid_ellipsoid(link: LinkParameters) -> tuple[np.ndarray, np.ndarray]:
    """Return the solid ellipsoid with a body's mass, centre of gravity and inertia tensor.

    It exists for every physically consistent body. Along the principal axes, half axes are
    √(5 s / m), with s the spread ∫ x² dm of mass along an axis, an eigenvalue of tr(I)/2 - I.

    **Returns**

    - The centre, (3,) [m].
    - (3, 3), its columns the half axes [m].

    >>> import numpy as np
    >>> from jaxcslc.manipulator import LinkParameters
    >>> ball = LinkParameters(2.0, np.zeros(3), 0.4 * 2.0 * 0.1**2 * np.eye(3))
    >>> np.round(np.linalg.norm(solid_ellipsoid(ball)[1], axis=0), 6).tolist()
    [0.1, 0.1, 0.1]
    """
    tensor = np.asarray(link.inertia, float)
    spread, directions = np.linalg.eigh(0.5 * np.trace(tensor) * np.eye(3) - tensor)
    half = np.sqrt(5.0 * np.maximum(spread, 0.0) / float(link.mass))
    return np.asarray(link.centre_of_gravity, float), directions * half


def _arm_chart(document: Mapping[str, Any]) -> ArmChart:
    """Return the chart of the arm's bodies.

    Bodies larger than the arm are named in the caption instead of being drawn: where the motion
    determines a moment of inertia and not the mass, the ellipsoid has no meaningful size.
    """
    lines = np.asarray(document["lines"], float)
    reach = float(np.sum(np.linalg.norm(lines[:, 1] - lines[:, 0], axis=1)))
    caption = (
        "Solid ellipsoids of the same mass and inertia, at the recording's first sample. Torque"
        " determines combinations of links alone: other ellipsoids fit as well"
    )
    bodies: list[Ellipsoid] = []
    large: list[str] = []
    for body in document["bodies"]:
        ellipsoid = Ellipsoid(body["name"], np.asarray(body["centre"]), np.asarray(body["axes"]))
        if 0.0 < reach < float(np.max(np.linalg.norm(ellipsoid.axes, axis=0))):
            large.append(body["name"])
        else:
            bodies.append(ellipsoid)
    if large:
        caption += (
            f". Not drawn, because larger than the arm: {', '.join(large)} (the motion determines"
            " their inertia, but not their mass)"
        )
    return ArmChart(lines, tuple(bodies), caption)
