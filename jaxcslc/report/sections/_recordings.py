"""Sections on recordings: what they hold, what looks wrong with them, torque over time."""

from collections.abc import Iterator, Mapping, Sequence
from types import MappingProxyType
from typing import Any

import numpy as np
from jaxtyping import Float

from jaxcslc.checks import SPOILING_KINDS, DataCheck, Finding
from jaxcslc.recordings import Patterns
from jaxcslc.uncertainty import SeveralFit, drift_text, several_text

from .._charts import Curve, Panel, PanelChart, envelope, intervals, rounded
from .._coefficients import ModelDescription
from .._page import (
    AbstractBlock,
    Column,
    Details,
    Grid,
    Message,
    Messages,
    Section,
    Table,
)
from .._section import AbstractSection, AnyReport, axis_title, counted, validation_first


# Points of all curves of a page, which keep it below 8 MB; of a curve.
_ALL_POINTS, _MOST_POINTS, _LEAST_POINTS = 150_000, 5000, 200
# A gap of more sampling intervals breaks curves.
_GAP = 10
_DATA_CHECK = (
    "The recordings after smoothing, and warnings about them or the fit. Samples near standstill or"
    " possibly within backlash are masked: they are not fitted."
)


class WarningSection(AbstractSection):
    """Warnings on recordings and fit, and decisions made in reading them."""

    name = "warnings"
    results = MappingProxyType({"warnings": (), "data_check": None, "notes": ()})
    entries = MappingProxyType({"warnings": list, "findings": list, "notes": list})
    position = 30

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

    def _findings(self) -> list[str]:
        return [str(Finding(**entry)) for entry in self.data.get("findings", ())]

    def text(self, report: AnyReport) -> Iterator[Sequence[str]]:
        for sentences in (self._findings(), self.data.get("warnings", ())):
            yield [f"warning: {sentence}" for sentence in sentences]
        yield [f"note: {note}" for section in report.sections for note in section.notes()]

    def notes(self) -> Sequence[str]:
        return self.data.get("notes", ())

    def messages(self, report: AnyReport) -> Iterator[Message]:
        wrong = [x for x in self.data.get("findings", ()) if x["kind"] in SPOILING_KINDS]
        if wrong:
            yield Message(f"The recording is wrong: {Finding(**wrong[0]).cause}.", "bad")
        if count := len([*self._findings(), *self.data.get("warnings", ())]):
            yield Message(
                f"{counted(count, 'warning')} about the recordings or the fit.", "caution"
            )

    def blocks(self, report: AnyReport, charts: bool) -> Iterator[Section]:
        messages = tuple(map(Message, [*self._findings(), *self.data.get("warnings", ())]))
        blocks: list[AbstractBlock] = [Messages(messages, empty="No warnings.")]
        if notes := self.data.get("notes"):
            blocks.append(Messages(tuple(Message(note, "plain") for note in notes)))
        yield Section("Data check", _DATA_CHECK, blocks)

    @classmethod
    def compared(cls, first: Mapping[str, Any], second: Mapping[str, Any]) -> Section:
        messages = tuple(
            Message(f"{which}: {text}")
            for which, data in (("first", first), ("second", second))
            for text in data.get("warnings", ())
        )
        return Section("Warnings", "", [Messages(messages, empty="Neither has any.")])


class RecordingSection(AbstractSection):
    """Samples, duration and range of motion of each recording."""

    name = "recorded"
    entries = MappingProxyType({"recorded": dict})
    position = 31

    @classmethod
    def document_of(cls, result: None, report: AnyReport) -> Mapping[str, Any]:
        return {"recorded": {name: _recorded(report, name) for name in report.patterns}}

    def blocks(self, report: AnyReport, charts: bool) -> Iterator[Section]:
        model = report.model
        units = dict.fromkeys("m" if unit == "N" else "rad" for unit in model.output_units)
        position = " or ".join(units)
        blocks: list[AbstractBlock] = []
        for name, recording in self.data["recorded"].items():
            rate = "" if not recording["interval"] else f", {1 / recording['interval']:.4g} Hz"
            caption = (
                f"{name} recording: {recording['samples']} samples,"
                f" {recording['duration']:.4g} s{rate}"
            )
            columns: list[tuple[Column, Sequence[Any]]] = [
                (Column(f"RMS {model.output_quantity}"), recording["torque_rms"]),
                (
                    Column("unmasked [%]", "share of samples", 3),
                    [100 * share for share in recording["share_judged"]],
                ),
            ]
            if recording["lowest"] is not None:
                columns += [
                    (Column(f"lowest position [{position}]", decimals=3), recording["lowest"]),
                    (Column("highest", decimals=3), recording["highest"]),
                    (Column("top speed [per s]", decimals=3), recording["top_speed"]),
                ]
            blocks.append(model.table(columns, caption, f"data-{name}"))
        yield Section("Data check", _DATA_CHECK, blocks)


class SeveralSection(AbstractSection):
    """Noise and offsets of each recording, coefficients in which it differs, and which drift."""

    name = "several"
    results = MappingProxyType({"several": None})
    entries = MappingProxyType({"recordings": dict, "drift": dict})
    position = 32

    @classmethod
    def document_of(cls, result: SeveralFit, report: AnyReport) -> Mapping[str, Any]:
        return {"recordings": result.document(), "drift": result.drift.document()}

    def text(self, report: AnyReport) -> Iterator[Sequence[str]]:
        drift = (drift_text(self.data["drift"]),) if "drift" in self.data else ()
        yield [several_text(self.data["recordings"]), *drift]

    def blocks(self, report: AnyReport, charts: bool) -> Iterator[Section]:
        model = report.model
        columns = [
            Column("recording", numeric=False),
            Column("samples"),
            Column("differs in", "coefficients, by more than chance", numeric=False, wide=True),
            *(
                Column(f"RMS residual, {axis_title(joint, unit)}", digits=3)
                for joint, unit in zip(model.output_names, model.output_units, strict=True)
            ),
        ]
        rows = tuple(
            (name, entry["samples"], ", ".join(entry["differing"]) or "none", *entry["noise"])
            for name, entry in self.data["recordings"].items()
        )
        caption = "Training recordings, each compared with all others together"
        blocks: list[AbstractBlock] = [Table(tuple(columns), rows, caption, "several")]
        if "drift" in self.data:
            blocks.append(Messages((Message(drift_text(self.data["drift"]), "plain"),)))
        yield Section("Data check", "", blocks)


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
                name: _torque_curves(patterns, report.predicted(name), count)
                for name, patterns in report.patterns.items()
            }
        }

    def blocks(self, report: AnyReport, charts: bool) -> Iterator[Section]:
        blocks: list[AbstractBlock] = []
        for name in validation_first(self.data["curves"]):
            charts_of_joints = Grid(tuple(self._details(report, name)))
            title = f"{name} recording"
            blocks.append(Details(title, (charts_of_joints,), opened=not blocks))
        yield Section(
            f"Measured and predicted {report.model.output_quantity}",
            "Masked samples are shaded. The axes of residuals fit the unmasked samples. Long"
            " recordings are drawn by their extremes.",
            blocks,
        )

    def _details(self, report: AnyReport, name: str) -> Iterator[Details]:
        """Yield a chart for each joint, its error in the summary."""
        model, quality = report.model, report.section("quality")
        errors = None if quality is None else quality.data["quality"][name]["judged"]
        for joint, output in enumerate(model.output_names):
            summary = output
            if errors is not None and errors["percent"][joint] is not None:
                rms = f"{errors['rms'][joint]:.3g} {model.output_units[joint]}".strip()
                summary += f": RMS error {rms}, {errors['percent'][joint]:.3g} %"
            chart = curve_chart(self.data["curves"][name][joint], model, joint, name)
            yield Details(summary, (chart,), opened=True)


def curve_chart(
    curves: Mapping[str, Any], model: ModelDescription, joint: int, name: str
) -> PanelChart:
    """Return the chart of measured and predicted torque of a joint, and of their difference.

    - `curves`: of the joint, as a section's data have them.
    - `name`: of the recording.
    """
    output, unit = model.output_names[joint], model.output_units[joint]
    measured, predicted, residual = (
        Curve(look, curves[look]["x"], curves[look]["y"], look)
        for look in ("measured", "predicted", "residual")
    )
    masked = tuple((start, end) for start, end in curves["masked"])
    panels = (
        Panel(axis_title(output, unit), (measured, predicted), masked, 150),
        Panel(axis_title("residual", unit), (residual,), masked, 60, curves["residual_range"]),
    )
    return PanelChart(panels, "time [s]", "", group=name)


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


def _torque_curves(
    patterns: Patterns, predicted: Float[np.ndarray, "samples joints"], recordings: int
) -> list[dict[str, Any]]:
    """Return per joint the measured and predicted torque and their difference, and what is masked.

    Long recordings are thinned to their extremes, the more the more joints and recordings there
    are. The residuals' range is that over fitted samples.
    """
    time, torque = np.asarray(patterns.time, float), np.asarray(patterns.torque, float)
    mask, steps = np.asarray(patterns.mask), np.diff(time)
    breaks = np.flatnonzero(steps > _GAP * np.median(steps)) + 1 if len(steps) else []
    broken = np.insert(time, breaks, time[breaks])
    most = _ALL_POINTS // (3 * recordings * torque.shape[1])
    most = min(max(most, _LEAST_POINTS), _MOST_POINTS)

    def thinned(values: Float[np.ndarray, " samples"]) -> dict[str, list[float | None]]:
        x, y = envelope(broken, np.insert(values, breaks, np.nan), most)
        return {"x": rounded(x, 8), "y": rounded(y)}

    return [
        {
            "measured": thinned(measured),
            "predicted": thinned(modelled),
            "residual": thinned(measured - modelled),
            "masked": intervals(time, ~fitted),
            "residual_range": _range((measured - modelled)[fitted]),
        }
        for measured, modelled, fitted in zip(torque.T, predicted.T, mask.T, strict=True)
    ]


def _range(values: Float[np.ndarray, " samples"]) -> list[float] | None:
    """Return the range of numbers, a little wider; None without any."""
    if not values.size or not np.ptp(values) > 0:
        return None
    low, high = float(values.min()), float(values.max())
    return [low - 0.1 * (high - low), high + 0.1 * (high - low)]
