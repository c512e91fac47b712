"""Sections on errors: of recordings that were fitted or kept apart, and of held-out motion."""

from collections.abc import Iterator, Mapping, Sequence
from types import MappingProxyType
from typing import Any

import numpy as np

from jaxcslc._plain_data import record_document, record_from
from jaxcslc.uncertainty import HeldOut

from .._blocks import AbstractBlock, Column, Message, Paragraph, Section, Table, Tone, Value
from .._errors import ErrorTable
from .._section import AbstractSection, AnyReport, listed
from ._fit_quality import fit_quality, worst_joint


# A model that explains less than half of the variance of a joint's training torque is not one of
# this joint. (A good model may explain less of a validation torque that hardly changes.)
_LEAST_R_SQUARED = 0.5
# Errors in % of a joint's RMS torque.
_SMALL, _LARGE = 10.0, 50.0
_SAMPLES = {"judged": "samples that masks leave in", "all": "all samples"}
_QUALITIES = {"rms": "RMS", "percent": "% of RMS torque", "r_squared": "R²"}

# Motion that was not fitted, by the source of held-out errors.
_MOTION = {
    "validation": "the validation recording",
    "cross-validation": "stretches of the training recording that were left out in turn",
    "left-out recording": "training recordings that were left out in turn",
    "held-out stretch": "the last part of the training recording, held out",
}


class ErrorSection(AbstractSection):
    """Errors of coefficient vectors along each recording, as `ErrorTable` has them."""

    name = "errors"
    results = MappingProxyType({"errors": MappingProxyType({})})
    entries = MappingProxyType(
        {
            **{"errors_by_recording": dict, "counts": dict, "share_judged": dict},
            **{"torque_error_rms": dict, "torque_error_rms_all_samples": dict},
            "equation_error_rms": dict,
        }
    )

    @classmethod
    def document_of(cls, result: Mapping[str, ErrorTable], report: AnyReport) -> Mapping[str, Any]:
        stem = "torque" if report.model.per_joint else report.model.output_kind
        whole = {name: table.rms_all_samples[0] for name, table in result.items()}
        return {
            f"{stem}_error_rms": {name: table.rms[0] for name, table in result.items()},
            **({f"{stem}_error_rms_all_samples": whole} if report.model.per_joint else {}),
            "share_judged": {name: table.share_judged for name, table in result.items()},
            "errors_by_recording": {n: record_document(table) for n, table in result.items()},
            "counts": {
                name: {
                    "judged_samples": np.sum(np.asarray(report.patterns[name].mask), axis=0),
                    "samples": report.patterns[name].samples,
                }
                for name in result
            },
        }

    def result(self, name: str, report: AnyReport) -> dict[str, ErrorTable]:
        tables = self.data.get("errors_by_recording", {}).items()
        return {recording: record_from(ErrorTable, table) for recording, table in tables}

    def text(self, report: AnyReport) -> Iterator[Sequence[str]]:
        stem = "torque" if report.model.per_joint else report.model.output_kind
        for name, table in self.result(self.name, report).items():
            yield [f"{stem} error, {name} recording", str(table)]

    def tables(self, report: AnyReport) -> Mapping[str, Sequence[Mapping[str, Any]]]:
        return {
            f"errors_{name}.csv": [
                {
                    table.kind: label,
                    "rms": float(table.rms[0, joint]),
                    "mean_modulus": float(table.mean_modulus[0, joint]),
                    "judged_samples": self.data["counts"][name]["judged_samples"][joint],
                    "samples": self.data["counts"][name]["samples"],
                    "share_judged": float(table.share_judged[joint]),
                    "rms_all_samples": float(table.rms_all_samples[0, joint]),
                }
                for joint, label in enumerate(table.labels)
            ]
            for name, table in self.result(self.name, report).items()
        }


class QualitySection(AbstractSection):
    """Errors in units of the torque, in % of its RMS, and as R²."""

    name = "quality"
    entries = MappingProxyType({"quality": dict, "joints": list})
    position = 10

    @classmethod
    def document_of(cls, result: None, report: AnyReport) -> Mapping[str, Any]:
        return {
            "joints": report.model.output_names,
            "quality": {
                name: fit_quality(patterns, report.predicted(name))
                for name, patterns in report.patterns.items()
            },
        }

    def messages(self, report: AnyReport) -> Iterator[Message]:
        qualities, names = self.data["quality"], report.model.output_names
        quantity = report.model.output_quantity
        name = "validation" if "validation" in qualities else "training"
        quality = qualities[name]
        worst = worst_joint(quality, "judged")
        if worst is None:
            yield Message(f"No sample of the {name} recording could be judged.", "bad")
            return
        percent, whole = (np.asarray(quality[kind]["percent"], float) for kind in _SAMPLES)
        largest = float(np.nanmax(percent))
        tone: Tone = "bad" if largest > _LARGE else "caution" if largest > _SMALL else "good"
        yield Message(
            f"{quantity.capitalize()} error on the {name} recording:"
            f" {_range(percent)} % of the RMS {quantity} over the samples that masks leave in,"
            f" {_range(whole)} % over all; largest at {names[worst]}.",
            tone,
        )
        r_squared = np.asarray(qualities["training"]["judged"]["r_squared"], float)
        if low := np.flatnonzero(r_squared < _LEAST_R_SQUARED).tolist():
            yield Message(
                f"The model explains less than half of the training {quantity}'s variance of"
                f" {listed([names[joint] for joint in low])}: check units, signs and the model's"
                " terms.",
                "bad",
            )

    def blocks(self, report: AnyReport, charts: bool) -> Iterator[Section]:
        model = report.model
        quantity = model.output_quantity
        columns = [
            Column(model.output_kind, numeric=False),
            Column("RMS, judged", f"root mean square of measured less predicted {quantity}"),
            Column("RMS, all"),
            Column("unit", numeric=False),
            Column(
                "judged [%]", f"RMS error in % of the RMS {quantity} of the same samples", digits=3
            ),
            Column("all [%]", digits=3),
            Column("R², judged", "share of the variance that the model explains", decimals=4),
            Column("R², all", decimals=4),
        ]
        blocks: list[AbstractBlock] = []
        for name, quality in self.data["quality"].items():
            judged, everything = (quality[samples] for samples in _SAMPLES)
            values = [
                model.output_names,
                *(judged["rms"], everything["rms"], model.output_units),
                *(judged["percent"], everything["percent"]),
                *(judged["r_squared"], everything["r_squared"]),
            ]
            blocks.append(Table.of_columns(columns, values, f"{name} recording", f"errors-{name}"))
        yield Section(
            "Errors",
            f"Measured less predicted {quantity}, as root mean square (RMS), in % of the RMS"
            f" {quantity}, and as R², the share of the {quantity}'s variance that the model"
            " explains. Judged samples are those that masks leave in; the others are at a"
            " standstill or may be within backlash, where the model does not hold.",
            blocks,
        )

    @classmethod
    def compared(cls, sections: tuple[AbstractSection | None, AbstractSection | None]) -> Section:
        joints, qualities = zip(*(_whole(section) for section in sections), strict=True)
        blocks: list[AbstractBlock] = []
        for recording in qualities[0]:
            if recording not in qualities[1] or joints[0] != joints[1]:
                continue
            for samples, meaning in _SAMPLES.items():
                values = [quality[recording][samples] for quality in qualities]
                columns = [Column("joint", numeric=False)]
                cells: list[list[Value]] = [list(joints[0])]
                for name, title in _QUALITIES.items():
                    for which, value in zip(("first", "second"), values, strict=True):
                        columns.append(Column(f"{title}, {which}"))
                        cells.append(list(value[name]))
                caption = f"{recording} recording, {meaning}"
                blocks.append(Table.of_columns(columns, cells, caption))
        if not blocks:
            blocks.append(Paragraph("The files have no errors of the same joints to compare."))
        return Section(
            "Errors",
            "Measured less predicted, each on its recordings: root mean square (RMS) in N m or N,"
            " in % of the RMS torque, and R², the share of the variance that the model explains.",
            blocks,
        )


class HeldOutSection(AbstractSection):
    """Errors on motion that was not fitted, and the largest that noise explains."""

    name = "held_out"
    results = MappingProxyType({"held_out": None})
    entries = MappingProxyType({"held_out": dict})
    position = 11

    always = True

    @classmethod
    def document_of(cls, result: HeldOut | None, report: AnyReport) -> Mapping[str, Any]:
        if result is None:
            return {}
        return {
            "held_out": {
                "training_rms": result.training,
                "held_out_rms": result.held_out,
                "limit": result.limit,
                "beyond_chance": result.beyond_chance,
                "source": result.source,
            }
        }

    def result(self, name: str, report: AnyReport) -> HeldOut | None:
        if "held_out" not in self.data:
            return None
        data = self.data["held_out"]
        training, held_out, limit = (
            np.array(data[name], float) for name in ("training_rms", "held_out_rms", "limit")
        )
        return HeldOut(
            *(training, held_out, limit),
            source=data.get("source", "cross-validation"),
            units=report.model.output_units,
            names=report.model.output_names,
        )

    def text(self, report: AnyReport) -> Iterator[Sequence[str]]:
        held_out, kind = self.result(self.name, report), report.model.output_kind
        if held_out is not None:
            ratios = ", ".join(f"{ratio:.3g}" for ratio in held_out.ratio)
            yield [f"{held_out.source} RMS over training RMS, {kind} by {kind}: {ratios}"]

    def messages(self, report: AnyReport) -> Iterator[Message]:
        held_out = self.result(self.name, report)
        if held_out is None:
            yield Message("Not judged on motion that was not fitted.", "caution")
            return
        motion = _MOTION[held_out.source]
        beyond = [report.model.output_names[joint - 1] for joint in held_out.beyond_chance]
        if beyond:
            yield Message(
                f"Errors on {motion} are larger than noise explains at {listed(beyond)}: the model"
                " may lack a term.",
                "caution",
            )
        else:
            yield Message(f"Errors on {motion} are no larger than noise explains.", "good")

    def blocks(self, report: AnyReport, charts: bool) -> Iterator[Section]:
        held_out, model = self.result(self.name, report), report.model
        if held_out is None:
            return
        columns = [
            Column(model.output_kind, numeric=False),
            *(Column("RMS, fitted"), Column("RMS, held out"), Column("unit", numeric=False)),
            Column("ratio", digits=3),
            Column("limit", "largest ratio that noise explains", digits=3),
        ]
        values = [
            model.output_names,
            *(held_out.training.tolist(), held_out.held_out.tolist(), model.output_units),
            *(held_out.ratio.tolist(), held_out.limit.tolist()),
        ]
        caption = f"motion that was not fitted ({held_out.source})"
        yield Section("Errors", "", [Table.of_columns(columns, values, caption, "held-out")])


def _whole(section: AbstractSection | None) -> tuple[list[Any], dict[str, Any]]:
    """Return joints and errors of each recording of a file, those with a number per joint."""
    data = {} if section is None else section.data
    joints = data.get("joints", [])
    whole: dict[str, dict[str, Any]] = {}
    for recording, tables in data.get("quality", {}).items():
        try:
            lists = [tables[samples][name] for samples in _SAMPLES for name in _QUALITIES]
            numbers = np.array(lists, dtype=float)  # null is NaN
        except (KeyError, TypeError, ValueError):
            continue
        if numbers.shape == (len(lists), len(joints)):
            whole[recording] = tables
    return joints, whole


def _range(values: np.ndarray) -> str:
    finite = values[np.isfinite(values)]
    if not finite.size:
        return "-"
    low, high = f"{finite.min():.2g}", f"{finite.max():.2g}"
    return low if low == high else f"{low} to {high}"
