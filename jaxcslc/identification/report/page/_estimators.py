import math
from collections.abc import Mapping
from typing import Any

from ....page import AbstractBlock, Column, Paragraph, Section, Table
from ...likelihood import lengths_line, transmission_lines


def estimators_section(data: Mapping[str, Any]) -> Section:
    """Least squares and maximum likelihood beside each other.

    - `data`: of the report, with an entry `"estimators"`.
    """
    estimators = data["estimators"]
    motion = (
        "the validation recording"
        if estimators["held_out"] == "validation"
        else "the last part of each training recording, predicted by fits to what is before it"
    )
    text = f"On {motion}: this report's coefficients are those of {estimators['used']}."
    if estimators["change_error"] < math.inf:
        change, error = 100 * math.expm1(estimators["change"]), 100 * estimators["change_error"]
        text += (
            f" With positions estimated, the misfit of maximum likelihood is {change:+.2g} % ±"
            f" {error:.2g} % on average beside that of least squares."
        )
    ended = "converged" if estimators["converged"] else "did not converge"
    text += f" Maximum likelihood {ended} after {estimators['steps']} steps."
    if lengths := estimators.get("lengths"):
        line = lengths_line(lengths, data["units"])
        text += f" {line[0].upper()}{line[1:]}."
    if lines := transmission_lines(estimators.get("transmission")):
        text += f" Estimated along: {'; '.join(lines)}."
    columns = [Column(data["kind"], numeric=False)]
    values: list[list[Any]] = [data["joints"]]
    for kind, name in (("rms", "judged"), ("rms_all_samples", "all")):
        for estimator, errors in estimators[kind].items():
            columns.append(Column(f"RMS, {name}, {estimator}"))
            values.append(errors)
    columns.append(Column("unit", numeric=False))
    values.append(data["units"])
    rows = tuple(zip(*values, strict=True))
    blocks: list[AbstractBlock] = [
        Paragraph(text),
        Table(tuple(columns), rows, "Torque errors by estimator", "estimators-table"),
    ]
    if spacing := estimators.get("spacing"):
        tried = "; ".join(spacing["lines"])
        blocks.append(Paragraph(f"How far apart maximum likelihood has positions: {tried}."))
    return Section(
        "Estimators",
        "Least squares regresses torque on smoothed motion. Maximum likelihood estimates the true"
        " positions along with the coefficients and needs no smoothing. The table has errors of"
        " smoothed motion, which favour least squares; the misfit is of readings and torques when"
        " positions are estimated for the coefficients of each.",
        blocks,
    )
