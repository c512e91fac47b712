"""Section on physically consistent bodies: parameters, and how they predict held-out motion."""

import math
from collections.abc import Iterator, Mapping, Sequence
from types import MappingProxyType
from typing import Any

import numpy as np

from jaxcslc.bodies import PhysicalParameters, PossibleFit, possible_text
from jaxcslc.manipulator import RobotError

from .._blocks import AbstractBlock, Column, Paragraph, Section, Table
from .._section import AbstractSection, AnyReport, open_errors
from ._arm import arm_chart, arm_document


class PossibleSection(AbstractSection):
    """Bodies nearest to the fit, beside the free fit."""

    name = "possible"
    results = MappingProxyType({"possible": None, "bodies": None})
    entries = MappingProxyType({"possible": dict, "bodies": dict})
    position = 24

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

    def text(self, report: AnyReport) -> Iterator[Sequence[str]]:
        if "possible" in self.data:
            yield [possible_text(open_errors(self.data["possible"]))]

    def blocks(self, report: AnyReport, charts: bool) -> Iterator[Section]:
        if "bodies" not in self.data:
            return
        bodies = self.data["bodies"]
        columns = [
            Column("body", numeric=False),
            Column("mass [kg]"),
            *(Column(f"r{axis} [m]") for axis in "xyz"),
            *(Column(f"I{axis}{axis} [kg m²]") for axis in "xyz"),
            Column("motor inertia [kg m²]"),
        ]
        rows = tuple(
            (
                *(name, link["mass"], *link["centre"]),
                *(link["inertia"][axis][axis] for axis in range(3)),
                link["motor_inertia"],
            )
            for name, link in zip(bodies["names"], bodies["links"], strict=True)
        )
        caption = "Masses, centres of gravity, moments of inertia"
        blocks: list[AbstractBlock] = [
            Paragraph(
                f"Coefficients move by {bodies['distance']:.3g} standard errors (root mean square)"
                " to be those of possible bodies."
            ),
            Table(tuple(columns), rows, caption, "bodies"),
        ]
        if "possible" in self.data:
            blocks += _judged(report, open_errors(self.data["possible"]))
        if charts and bodies["arm"] is not None:
            blocks.append(arm_chart(bodies["arm"]))
        elif charts:
            blocks.append(Paragraph(f"Not drawn: {bodies['no_arm']}"))
        yield Section(
            "Possible bodies",
            "The masses, centres of gravity and inertia tensors nearest to the fit that bodies can"
            " have. What the motion does not determine is that of the prior. In the frames of the"
            " robot's file and without what the file fixes to a body, inertia about the centre of"
            " gravity.",
            blocks,
        )


def _judged(report: AnyReport, judged: Mapping[str, Any]) -> list[AbstractBlock]:
    """Return how bodies and free fit predict motion that neither was fitted to."""
    change, error = 100 * math.expm1(judged["change"]), 100 * judged["change_error"]
    used = "the bodies'" if judged["used"] else "the free fit's"
    text = (
        f"On motion that was left out in turn, errors of the bodies are {change:+.2g} % ±"
        f" {error:.2g} % on average beside those of the free fit: this report's coefficients are"
        f" {used}."
    )
    rms, free = judged["held_out_rms"], judged["free_held_out_rms"]
    ratio = [
        ours / theirs if ours is not None and theirs else None
        for ours, theirs in zip(rms, free, strict=True)
    ]
    model = report.model
    columns = [
        Column(model.output_kind, numeric=False),
        *(Column("RMS, free fit"), Column("RMS, possible bodies")),
        *(Column("unit", numeric=False), Column("ratio", digits=3)),
    ]
    values = [model.output_names, free, rms, model.output_units, ratio]
    caption = f"motion that was not fitted ({judged['held_out']})"
    return [Paragraph(text), Table.of_columns(columns, values, caption, "bodies-held-out")]


def _bodies(report: AnyReport, bodies: PhysicalParameters) -> dict[str, Any]:
    """Return bodies as plain data, and the arm at the recording's first sample."""
    robot = report.network.robot
    names = [
        f"link of {joint}" if body.isdigit() else body
        for body, joint in zip(bodies.body_names, robot.joint_names, strict=True)
    ]
    document: dict[str, Any] = {
        "names": names,
        "links": [
            {
                "mass": float(link.mass),
                "centre": link.centre_of_gravity,
                "inertia": link.inertia,
                "motor_inertia": float(link.motor_inertia),
            }
            for link in bodies.bodies
        ],
        "distance": float(bodies.distance),
        "torque_distance": bodies.torque_distance,
        "arm": None,
    }
    q = report.network.positions_of_all_joints(np.asarray(report.patterns["training"].q)[0])
    try:
        document["arm"] = arm_document(robot, bodies.links, names, np.asarray(q))
    except RobotError as error:
        document["no_arm"] = str(error)
    return document
