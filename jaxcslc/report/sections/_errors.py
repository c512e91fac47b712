"""Sections on errors: of the recordings, of held-out motion, by estimator, and over a horizon."""

import math
from collections.abc import Iterator, Mapping, Sequence
from itertools import product
from types import MappingProxyType
from typing import Any

import numpy as np
from jaxtyping import Bool, Float

from jaxcslc._plain_data import record_document, record_from
from jaxcslc.instruments import HorizonError
from jaxcslc.likelihood import (
    EstimatorComparison,
    estimator_text,
    presliding_line,
)
from jaxcslc.recordings import Patterns
from jaxcslc.uncertainty import HeldOut

from .._errors import ErrorTable
from .._page import AbstractBlock, Column, Message, Paragraph, Section, Table, Tone, Value
from .._section import AbstractSection, AnyReport, listed, open_errors


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
        percent, whole = (np.asarray(quality[kind]["percent"], float) for kind in _SAMPLES)
        if not np.any(np.isfinite(percent)):
            yield Message(f"No sample of the {name} recording could be judged.", "bad")
            return
        worst = int(np.nanargmax(percent))
        largest = float(percent[worst])
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
        kind, unit = (Column(name, numeric=False) for name in (model.output_kind, "unit"))
        rms = f"root mean square of measured less predicted {quantity}"
        percent = f"RMS error in % of the RMS {quantity} of the same samples"
        r_squared = "share of the variance that the model explains"
        blocks: list[AbstractBlock] = []
        for name, quality in self.data["quality"].items():
            judged, everything = (quality[samples] for samples in _SAMPLES)
            columns = [
                (kind, model.output_names),
                (Column("RMS, judged", rms), judged["rms"]),
                (Column("RMS, all"), everything["rms"]),
                (unit, model.output_units),
                (Column("judged [%]", percent, digits=3), judged["percent"]),
                (Column("all [%]", digits=3), everything["percent"]),
                (Column("R², judged", r_squared, decimals=4), judged["r_squared"]),
                (Column("R², all", decimals=4), everything["r_squared"]),
            ]
            blocks.append(Table.from_columns(columns, f"{name} recording", f"errors-{name}"))
        yield Section(
            "Errors",
            f"Measured less predicted {quantity}, as root mean square (RMS), in % of the RMS"
            f" {quantity}, and as R², the share of the {quantity}'s variance that the model"
            " explains. Judged samples are those that masks leave in; the others are at a"
            " standstill or may be within backlash, where the model does not hold.",
            blocks,
        )

    @classmethod
    def compared(cls, first: Mapping[str, Any], second: Mapping[str, Any]) -> Section:
        joints = first.get("joints", [])
        qualities = [_whole(data) for data in (first, second)]
        blocks: list[AbstractBlock] = []
        for recording, (samples, meaning) in product(qualities[0], _SAMPLES.items()):
            if recording in qualities[1] and joints == second["joints"]:
                columns: list[tuple[Column, Sequence[Value]]] = [
                    (Column("joint", numeric=False), joints),
                    *(
                        (Column(f"{title}, {which}"), quality[recording][samples][name])
                        for name, title in _QUALITIES.items()
                        for which, quality in zip(("first", "second"), qualities, strict=True)
                    ),
                ]
                blocks.append(Table.from_columns(columns, f"{recording} recording, {meaning}"))
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
        limit = "largest ratio that noise explains"
        columns = [
            (Column(model.output_kind, numeric=False), model.output_names),
            (Column("RMS, fitted"), held_out.training.tolist()),
            (Column("RMS, held out"), held_out.held_out.tolist()),
            (Column("unit", numeric=False), model.output_units),
            (Column("ratio", digits=3), held_out.ratio.tolist()),
            (Column("limit", limit, digits=3), held_out.limit.tolist()),
        ]
        caption = f"motion that was not fitted ({held_out.source})"
        yield Section("Errors", "", [Table.from_columns(columns, caption, "held-out")])


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
        if distance := estimators.get("lengths"):
            line = presliding_line(distance, report.model.output_units)
            text += f" {line[0].upper()}{line[1:]}."
        columns = [
            (Column(report.model.output_kind, numeric=False), report.model.output_names),
            *(
                (Column(f"RMS, {name}, {estimator}"), errors)
                for kind, name in (("rms", "judged"), ("rms_all_samples", "all"))
                for estimator, errors in estimators[kind].items()
            ),
            (Column("unit", numeric=False), report.model.output_units),
        ]
        table = Table.from_columns(columns, "Torque errors by estimator", "estimators-table")
        blocks: list[AbstractBlock] = [Paragraph(text), table]
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


class HorizonSection(AbstractSection):
    """Median errors of simulated positions, some time after simulations started."""

    name = "horizon"
    results = MappingProxyType({"horizon": None})
    entries = MappingProxyType({"horizon": dict})
    position = 14

    @classmethod
    def document_of(cls, result: HorizonError, report: AnyReport) -> Mapping[str, Any]:
        return {"horizon": result.document()}

    def result(self, name: str, report: AnyReport) -> HorizonError:
        data = self.data[self.name]
        # JSON has no number for simulations that diverged.
        error, distance = (
            {which: np.nan_to_num(np.array(x, float), nan=np.inf) for which, x in entries.items()}
            for entries in (data["error"], data["distance"])
        )
        return HorizonError(
            np.array(data["horizons"]),
            error,
            distance,
            tuple(data["starts"]),
            tuple(data["units"]),
        )

    def text(self, report: AnyReport) -> Iterator[Sequence[str]]:
        table = str(self.result(self.name, report))
        yield ["simulated open loop, median absolute error of positions", table]

    def blocks(self, report: AnyReport, charts: bool) -> Iterator[Section]:
        horizon, names = self.data["horizon"], report.model.output_names
        whose = "of this report, of its fit with pre-sliding states, or of the robot's file"
        columns = [
            Column("horizon [s]"),
            Column("starts", "simulations that are that long"),
            Column("coefficients", whose, numeric=False),
            *(Column(f"{a} [{b}]", digits=3) for a, b in zip(names, horizon["units"], strict=True)),
        ]
        if distance := horizon["distance"]:
            columns.append(Column("last frame [m]", "distance of its origin", digits=3))
        rows = tuple(
            (length, starts, which, *errors[i], *([distance[which][i]] if distance else []))
            for i, (length, starts) in enumerate(
                zip(horizon["horizons"], horizon["starts"], strict=True)
            )
            for which, errors in horizon["error"].items()
        )
        table = Table(tuple(columns), rows, "Median absolute error of positions", "horizon")
        yield Section(
            "Prediction over a horizon",
            "The arm simulated without feedback, from recorded states and under recorded torques:"
            " how far its positions are from the recorded ones after some time. An empty cell is a"
            " simulation that diverged.",
            [table],
        )


def fit_quality(
    patterns: Patterns, predicted: Float[np.ndarray, "samples joints"]
) -> dict[str, dict[str, list[float]]]:
    """Return errors of a prediction in units of the torque, in % of its RMS, and as R².

    **Arguments**

    - `patterns`: measured torque; n joints.
    - `predicted`: of the same samples.

    **Returns** for `"judged"` samples, those in `Patterns.mask`, and for `"all"` samples, by name,
    a number a joint: `rms` and `torque_rms` [N m or N], `percent`, the first of the second, and
    `r_squared`, one less the squared errors over the squared deviations of the torque from its
    mean. NaN of a joint without samples, and in `r_squared` without any deviation.

    >>> import numpy as np
    >>> time, pairs = np.arange(4.0), np.ones((4, 1), bool)
    >>> torque = np.array([[3.0], [-3.0], [3.0], [-3.0]])
    >>> patterns = Patterns(time, torque, torque, torque, torque, pairs, pairs)
    >>> quality = fit_quality(patterns, 0.9 * torque)["judged"]
    >>> [round(quality[name][0], 6) for name in ("rms", "torque_rms", "percent", "r_squared")]
    [0.3, 3.0, 10.0, 0.99]
    """
    torque, judged = np.asarray(patterns.torque), np.asarray(patterns.mask)
    every = np.ones_like(judged)
    return {
        "judged": _over_samples(torque, predicted, judged),
        "all": _over_samples(torque, predicted, every),
    }


def _over_samples(
    torque: Float[np.ndarray, "samples joints"],
    predicted: Float[np.ndarray, "samples joints"],
    mask: Bool[np.ndarray, "samples joints"],
) -> dict[str, list[float]]:
    def total(x: Float[np.ndarray, "samples joints"]) -> Float[np.ndarray, " joints"]:
        return np.sum(np.where(mask, x, 0.0), axis=0)

    with np.errstate(divide="ignore", invalid="ignore"):
        count = np.sum(mask, axis=0)
        squares = total((torque - predicted) ** 2)
        deviation = total((torque - total(torque) / count) ** 2)
        rms, size = np.sqrt(squares / count), np.sqrt(total(torque**2) / count)
        percent, r_squared = 100 * rms / size, 1 - squares / deviation
    return {
        "rms": rms.tolist(),
        "torque_rms": size.tolist(),
        "percent": np.where(size > 0, percent, np.nan).tolist(),
        "r_squared": np.where(deviation > 0, r_squared, np.nan).tolist(),
    }


def _whole(data: Mapping[str, Any]) -> dict[str, Any]:
    """Return errors of the recordings of a file that have a number per joint."""
    whole: dict[str, Any] = {}
    for recording, tables in data.get("quality", {}).items():
        try:
            lists = [tables[samples][name] for samples in _SAMPLES for name in _QUALITIES]
            numbers = np.array(lists, dtype=float)  # null is NaN
        except (KeyError, TypeError, ValueError):
            continue
        if numbers.shape == (len(lists), len(data.get("joints", []))):
            whole[recording] = tables
    return whole


def _range(values: np.ndarray) -> str:
    finite = values[np.isfinite(values)]
    if not finite.size:
        return "-"
    low, high = f"{finite.min():.2g}", f"{finite.max():.2g}"
    return low if low == high else f"{low} to {high}"
