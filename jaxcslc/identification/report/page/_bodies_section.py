import math
from collections.abc import Mapping
from typing import Any

from ....page import AbstractBlock, Column, Paragraph, Section, Table
from ._bodies import arm_chart


def bodies_section(data: Mapping[str, Any], *, charts: bool) -> Section:
    """Masses, centres and inertia tensors, and how they predict motion that was left out.

    - `data`: the page's, whose `"bodies"` are not None.
    - `charts`: whether the arm is drawn.
    """
    bodies = data["bodies"]
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
    table = Table(tuple(columns), rows, "Masses, centres of gravity, moments of inertia", "bodies")
    blocks: list[AbstractBlock] = [
        Paragraph(
            f"Coefficients move by {bodies['distance']:.3g} standard errors (root mean square) to"
            " be those of possible bodies."
        ),
        table,
    ]
    if bodies["judged"] is not None:
        blocks += _judged_bodies(data, bodies["judged"])
    if charts and bodies["arm"] is not None:
        blocks.append(arm_chart(bodies["arm"]))
    elif charts:
        blocks.append(Paragraph(f"Not drawn: {bodies['no_arm']}"))
    return Section(
        "Possible bodies",
        "The masses, centres of gravity and inertia tensors nearest to the fit that bodies can"
        " have. What the motion does not determine is that of the prior. In the frames of the"
        " robot's file and without what the file fixes to a body, inertia about the centre of"
        " gravity.",
        blocks,
    )


def _judged_bodies(data: Mapping[str, Any], judged: Mapping[str, Any]) -> list[AbstractBlock]:
    """How bodies and free fit predict motion that neither was fitted to."""
    change, error = 100 * math.expm1(judged["change"]), 100 * judged["change_error"]
    used = "the bodies'" if judged["used"] else "the free fit's"
    text = (
        f"On motion that was left out in turn, errors of the bodies are {change:+.2g} % ±"
        f" {error:.2g} % on average beside those of the free fit: this report's coefficients are"
        f" {used}."
    )
    ratio = [
        ours / theirs if theirs else None
        for ours, theirs in zip(judged["held_out_rms"], judged["free_held_out_rms"], strict=True)
    ]
    columns = [
        Column(data["kind"], numeric=False),
        *(Column("RMS, free fit"), Column("RMS, possible bodies")),
        *(Column("unit", numeric=False), Column("ratio", digits=3)),
    ]
    values = [
        data["joints"],
        *(judged["free_held_out_rms"], judged["held_out_rms"], data["units"], ratio),
    ]
    caption = f"motion that was not fitted ({judged['source']})"
    return [Paragraph(text), Table.of_columns(columns, values, caption, "bodies-held-out")]
