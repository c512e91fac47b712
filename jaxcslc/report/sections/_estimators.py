"""Section on least squares and maximum likelihood beside each other."""

import math
from collections.abc import Iterator, Mapping, Sequence
from types import MappingProxyType
from typing import Any

from jaxcslc.likelihood import EstimatorComparison, estimator_text, lengths_line, transmission_lines

from .._blocks import AbstractBlock, Column, Paragraph, Section, Table
from .._section import AbstractSection, AnyReport, open_errors


class EstimatorSection(AbstractSection):
    """Errors of both estimators on motion that neither was fitted to."""

    name = "estimators"
    results = MappingProxyType({"estimators": None})
    entries = MappingProxyType({"estimators": dict})
    position = 13

    @classmethod
    def document_of(cls, result: EstimatorComparison, report: AnyReport) -> Mapping[str, Any]:
        return {"estimators": result.document()}

    def text(self, report: AnyReport) -> Iterator[Sequence[str]]:
        yield [estimator_text(open_errors(self.data["estimators"]), report.model.output_units)]

    def blocks(self, report: AnyReport, charts: bool) -> Iterator[Section]:
        estimators = open_errors(self.data["estimators"])
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
            line = lengths_line(lengths, report.model.output_units)
            text += f" {line[0].upper()}{line[1:]}."
        if lines := transmission_lines(estimators.get("transmission")):
            text += f" Estimated along: {'; '.join(lines)}."
        columns = [Column(report.model.output_kind, numeric=False)]
        values: list[Sequence[Any]] = [report.model.output_names]
        for kind, name in (("rms", "judged"), ("rms_all_samples", "all")):
            for estimator, errors in estimators[kind].items():
                columns.append(Column(f"RMS, {name}, {estimator}"))
                values.append(errors)
        columns.append(Column("unit", numeric=False))
        values.append(report.model.output_units)
        rows = tuple(zip(*values, strict=True))
        blocks: list[AbstractBlock] = [
            Paragraph(text),
            Table(tuple(columns), rows, "Torque errors by estimator", "estimators-table"),
        ]
        if spacing := estimators.get("spacing"):
            tried = "; ".join(spacing["lines"])
            blocks.append(Paragraph(f"Spacing of estimated positions: {tried}."))
        yield Section(
            "Estimators",
            "Least squares regresses torque on smoothed motion. Maximum likelihood estimates the"
            " true positions along with the coefficients and needs no smoothing. The table has"
            " errors of smoothed motion, which favour least squares; the misfit is of readings and"
            " torques when positions are estimated for the coefficients of each.",
            blocks,
        )
