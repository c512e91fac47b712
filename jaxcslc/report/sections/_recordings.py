"""Sections on recordings: what they hold, what looks wrong with them, torque over time."""

from collections.abc import Iterator, Mapping, Sequence
from types import MappingProxyType
from typing import Any

import numpy as np

from jaxcslc.checks import DataCheck, Finding

from .._blocks import AbstractBlock, Column, Grid, Message, Messages, Section, Table
from .._chart_curves import Curve
from .._panel_chart import Panel, PanelChart
from .._section import AbstractSection, AnyReport, axis_title, counted
from ._thinned import friction_points, torque_curves


_DATA_CHECK = (
    "What the recordings hold after smoothing, and what looks wrong with them or the fit."
    " Samples near standstill and possibly within backlash are masked: they are not fitted."
)


class WarningSection(AbstractSection):
    """Warnings on recordings and fit, and decisions made in reading them."""

    name = "warnings"
    results = MappingProxyType({"warnings": (), "data_check": None, "notes": ()})
    entries = MappingProxyType({"warnings": list, "findings": list, "notes": list})
    position = 0

    always = True

    @classmethod
    def document_of(cls, result: Any, report: AnyReport) -> Mapping[str, Any]:
        check: DataCheck | None = report.results.get("data_check")
        findings = () if check is None else check.findings
        return {
            **{name: report.results.get(name, ()) for name in ("warnings", "notes")},
            "findings": [vars(finding) for finding in findings],
        }

    def result(self, name: str, report: AnyReport) -> Any:
        if name != "data_check":
            return tuple(self.data.get(name, ()))
        return DataCheck((), tuple(Finding(**entry) for entry in self.data.get("findings", ())))

    def _sentences(self) -> list[str]:
        findings = (str(Finding(**entry)) for entry in self.data.get("findings", ()))
        return [*findings, *self.data.get("warnings", ())]

    def text(self, report: AnyReport) -> Iterator[Sequence[str]]:
        sentences, found = self._sentences(), len(self.data.get("findings", ()))
        yield [f"warning: {sentence}" for sentence in sentences[:found]]
        yield [f"warning: {sentence}" for sentence in sentences[found:]]
        yield [f"note: {note}" for section in report.sections for note in section.notes()]

    def notes(self) -> Sequence[str]:
        return self.data.get("notes", ())

    def messages(self, report: AnyReport) -> Iterator[Message]:
        if count := len(self._sentences()):
            yield Message(f"{counted(count, 'warning')} about data and fit.", "caution")

    def blocks(self, report: AnyReport, charts: bool) -> Iterator[Section]:
        sentences = tuple(Message(sentence) for sentence in self._sentences())
        blocks: list[AbstractBlock] = [Messages(sentences, empty="Nothing looks wrong.")]
        if notes := self.data.get("notes"):
            blocks.append(Messages(tuple(Message(note, "plain") for note in notes)))
        yield Section("Data check", _DATA_CHECK, blocks)

    @classmethod
    def compared(cls, sections: tuple[AbstractSection | None, AbstractSection | None]) -> Section:
        messages = tuple(
            Message(f"{which}: {text}")
            for which, section in zip(("first", "second"), sections, strict=True)
            for text in ([] if section is None else section.data.get("warnings", []))
        )
        return Section("Warnings", "", [Messages(messages, empty="Neither has any.")])


class RecordingSection(AbstractSection):
    """Samples, duration and range of motion of each recording."""

    name = "recorded"
    entries = MappingProxyType({"recorded": dict})
    position = 1

    @classmethod
    def document_of(cls, result: None, report: AnyReport) -> Mapping[str, Any]:
        return {"recorded": {name: _recorded(report, name) for name in report.patterns}}

    def blocks(self, report: AnyReport, charts: bool) -> Iterator[Section]:
        model = report.model
        motion = dict.fromkeys("m" if unit == "N" else "rad" for unit in model.output_units)
        blocks: list[AbstractBlock] = []
        for name, recording in self.data["recorded"].items():
            rate = "" if not recording["interval"] else f", {1 / recording['interval']:.4g} Hz"
            caption = (
                f"{name} recording: {recording['samples']} samples,"
                f" {recording['duration']:.4g} s{rate}"
            )
            columns = [
                Column(model.output_kind, numeric=False),
                Column("fitted [%]", "samples that masks leave in", digits=3),
            ]
            values: list[Sequence[Any]] = [
                model.output_names,
                [100 * share for share in recording["share_judged"]],
            ]
            if recording["lowest"] is not None:
                columns += [
                    Column(f"lowest position [{' or '.join(motion)}]", decimals=3),
                    Column("highest", decimals=3),
                    Column("top speed [per s]", decimals=3),
                ]
                values += [recording["lowest"], recording["highest"], recording["top_speed"]]
            columns += [Column(f"RMS {model.output_quantity}"), Column("unit", numeric=False)]
            values += [recording["torque_rms"], model.output_units]
            blocks.append(Table.of_columns(columns, values, caption, f"data-{name}"))
        yield Section("Data check", _DATA_CHECK, blocks)


class CurveSection(AbstractSection):
    """Measured and predicted torque over time, thinned for drawing."""

    name = "curves"
    entries = MappingProxyType({"curves": dict})
    file = "charts.json"
    position = 12

    @classmethod
    def document_of(cls, result: None, report: AnyReport) -> Mapping[str, Any]:
        count = len(report.patterns)
        return {
            "curves": {
                name: torque_curves(patterns, report.predicted(name), count)
                for name, patterns in report.patterns.items()
            }
        }

    def blocks(self, report: AnyReport, charts: bool) -> Iterator[Section]:
        if not charts:
            return
        model = report.model
        blocks: list[AbstractBlock] = []
        for name, recording in self.data["curves"].items():
            panels: list[Panel] = []
            rows = zip(model.output_names, model.output_units, recording, strict=True)
            for joint, unit, curves in rows:
                measured, predicted, residual = (
                    Curve(look, curves[look]["x"], curves[look]["y"], look)
                    for look in ("measured", "predicted", "residual")
                )
                masked = tuple((start, end) for start, end in curves["masked"])
                panels.append(Panel(axis_title(joint, unit), (measured, predicted), masked, 150))
                limits, title = curves["residual_range"], axis_title("residual", unit)
                panels.append(Panel(title, (residual,), masked, 60, limits))
            caption = (
                f"{name} recording: measured and predicted {model.output_quantity}, and their"
                " difference"
            )
            blocks.append(PanelChart(tuple(panels), "time [s]", caption))
        yield Section(
            f"Measured and predicted {model.output_quantity}",
            "Masked samples are shaded; the axes of residuals are those of the fitted samples. Long"
            " recordings are drawn by their extremes.",
            blocks,
        )


class FrictionSection(AbstractSection):
    """Each joint's friction over its velocity, training recording, thinned for drawing."""

    name = "friction_points"
    entries = MappingProxyType({"friction_points": list})
    file = "charts.json"
    position = 22

    @classmethod
    def of(cls, report: AnyReport) -> AbstractSection | None:
        return super().of(report) if report.network.layout.friction.size else None

    @classmethod
    def document_of(cls, result: None, report: AnyReport) -> Mapping[str, Any]:
        network, patterns = report.network_along("training"), report.patterns["training"]
        k, predicted = np.asarray(report.k), report.predicted("training")
        return {"friction_points": friction_points(network, k, patterns, predicted)}

    def blocks(self, report: AnyReport, charts: bool) -> Iterator[Section]:
        if not charts:
            return
        model, drawn = report.model, self.data["friction_points"]
        blocks: list[AbstractBlock] = []
        for joint, unit, points in zip(model.output_names, model.output_units, drawn, strict=True):
            cloud = Curve("measured", points["data"]["x"], points["data"]["y"], "points")
            fitted = Curve("friction terms", points["model"]["x"], points["model"]["y"], "fitted")
            speed = "velocity [rad/s]" if unit == "N m" else "velocity [m/s]"
            panel = Panel(axis_title(joint, unit), (cloud, fitted), (), 210)
            blocks.append(PanelChart((panel,), speed, ""))
        yield Section(
            "Friction",
            "Each joint's friction over its velocity, training recording: the measured torque less"
            " what all other terms predict, and the friction terms at the same samples. A curved"
            " cloud beside a straight line calls for another friction term.",
            [Grid(tuple(blocks))],
        )


def _recorded(report: AnyReport, name: str) -> dict[str, Any]:
    patterns = report.patterns[name]
    time, q, qd, torque = (
        np.asarray(values) for values in (patterns.time, patterns.q, patterns.qd, patterns.torque)
    )
    per_joint = report.model.per_joint  # of other systems, motion is of variables
    return {
        "samples": patterns.samples,
        "duration": float(time[-1] - time[0]),
        "interval": float(np.median(np.diff(time))) if len(time) > 1 else None,
        "share_judged": np.mean(np.asarray(patterns.mask), axis=0),
        "lowest": np.min(q, axis=0) if per_joint else None,
        "highest": np.max(q, axis=0) if per_joint else None,
        "top_speed": np.max(np.abs(qd), axis=0) if per_joint else None,
        "torque_rms": np.sqrt([np.sum(column**2) / patterns.samples for column in torque.T]),
    }
