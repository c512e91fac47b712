"""Sections on errors: of the recordings, of held-out motion, by estimator, and over a horizon."""

import dataclasses
from collections.abc import Iterator, Mapping, Sequence
from itertools import product
from types import MappingProxyType
from typing import Any

import numpy as np
from jaxtyping import Bool, Float

from jaxcslc._plain_data import record_document, record_from
from jaxcslc._text_table import text_table
from jaxcslc.instruments import HorizonError
from jaxcslc.likelihood import estimator_text, presliding_line
from jaxcslc.recordings import Patterns, noise_level
from jaxcslc.uncertainty import HeldOut, RelativeError

from .._errors import ErrorTable
from .._page import AbstractBlock, Column, Message, Paragraph, Section, Table, Tone, Value
from .._section import AbstractSection, AnyReport, listed, open_errors, validation_first


# A model that explains less than half of the variance of a joint's training torque is not one of
# this joint. (A good model may explain less of a validation torque that barely changes.)
_LEAST_R_SQUARED = 0.5
# Errors with masked samples over those without, from which the verdict has both.
_NOTABLY = 1.2
# Errors in % of a joint's RMS torque.
_SMALL, _LARGE = 10.0, 50.0
# Seconds of simulation that the verdict quotes.
_HORIZON = 1.0
_SAMPLES = {"judged": "unmasked samples", "all": "all samples"}
_QUALITIES = {"rms": "RMS", "percent": "% of RMS torque", "r_squared": "R²"}

# Motion that was not fitted, by the source of held-out errors.
_MOTION = {
    "validation": "the validation recording",
    "cross-validation": "segments of the training recording, each held out in turn",
    "held-out recording": "the training recordings, each held out in turn",
    "held-out stretch": "the last part of the training recording",
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
        stem = report.model.error_kind
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
        """Yield one table per recording: RMS errors, also of other coefficients, %, and R²."""
        quality, model = report.section("quality"), report.model
        if quality is None:
            return
        for name, table in self.result(self.name, report).items():
            judged, every = (quality.data["quality"][name][samples] for samples in _SAMPLES)
            columns = {
                "RMS error": judged["rms"],
                **dict(zip((f"RMS, {x}" for x in table.names[1:]), table.rms[1:], strict=True)),
                f"[% of {model.output_quantity}]": judged["percent"],
                "R²": judged["r_squared"],
                "RMS error, all samples": every["rms"],
                "masked [%]": 100 * (1 - np.asarray(table.share_judged)),
            }
            rows = zip(model.output_names, model.output_units, *columns.values(), strict=True)
            cells = [
                [joint, unit, *(f"{np.nan if x is None else x:.4g}" for x in values)]
                for joint, unit, *values in rows
            ]
            header = [model.output_kind, "unit", *columns]
            title = f"{model.error_kind} error, {name} recording"
            yield [title, text_table(header, cells, left=("unit",))]

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
                name: {
                    **fit_quality(patterns, report.predicted(name)),
                    "noise": _noise(patterns),
                }
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
            yield Message(f"All samples of the {name} recording are masked.", "bad")
            return
        # Sensor noise is no error of the model.
        beyond = _beyond_noise(percent, quality)
        largest = float(np.nanmax(beyond))
        tone: Tone = "bad" if largest > _LARGE else "caution" if largest > _SMALL else "good"
        worst, other = int(np.nanargmax(percent)), float(np.nanmax(whole))
        noisy = beyond[worst] ** 2 < 0.5 * percent[worst] ** 2
        remarks = ", mostly sensor noise" if noisy else ""
        if other > _NOTABLY * percent[worst]:
            remarks += f"; with samples near standstill, up to {other:.2g} %"
        yield Message(
            f"Replay of the {name} recording: {report.model.error_kind} errors are"
            f" {_range(percent, names)} of the RMS {quantity}{remarks}.",
            tone,
        )
        r_squared = np.asarray(qualities["training"]["judged"]["r_squared"], float)
        if low := np.flatnonzero(r_squared < _LEAST_R_SQUARED).tolist():
            yield Message(
                f"The model explains less than half of the variance of the training {quantity} at"
                f" {listed([names[joint] for joint in low])}: check units, signs and friction"
                " terms.",
                "bad",
            )

    def blocks(self, report: AnyReport, charts: bool) -> Iterator[Section]:
        model = report.model
        quantity = model.output_quantity
        kinds = {
            "rms": Column("RMS error", f"root mean square of measured minus predicted {quantity}"),
            "percent": Column("[%]", f"of the RMS {quantity} of the same samples", digits=3),
            "r_squared": Column("R²", "share of the variance that the model explains", decimals=4),
        }
        blocks: list[AbstractBlock] = []
        for name in validation_first(self.data["quality"]):
            quality = self.data["quality"][name]
            columns = [
                (dataclasses.replace(column, title=column.title + title), quality[samples][kind])
                for samples, title in (("judged", ""), ("all", ", all samples"))
                for kind, column in kinds.items()
            ]
            if "noise" in quality:
                noise = Column("noise", f"standard deviation of white noise of the {quantity}")
                columns.insert(1, (noise, quality["noise"]))
            blocks.append(model.table(columns, f"{name} recording", f"errors-{name}"))
        yield Section(
            "Errors",
            f"Measured minus predicted {quantity}: root mean square (RMS), in % of the RMS"
            f" {quantity}, and R², the share of the {quantity}'s variance that the model explains."
            " Samples near standstill or possibly within backlash are masked, because the model"
            " does not hold there. Columns with 'all samples' include them.",
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
            "Measured minus predicted torque, each on its recordings: root mean square (RMS) in N m"
            " or N, in % of the RMS torque, and R², the share of the variance that the model"
            " explains.",
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
            yield [f"{held_out.source} RMS error over training RMS error, per {kind}: {ratios}"]

    def messages(self, report: AnyReport) -> Iterator[Message]:
        held_out = self.result(self.name, report)
        if held_out is None:
            yield Message("Not tested on held-out data.", "caution")
            return
        motion = _MOTION[held_out.source]
        names = report.model.output_names
        beyond = [names[joint - 1] for joint in held_out.beyond_chance]
        percent = self._percent(held_out, report)
        if np.any(percent > _LARGE):
            worst = int(np.nanargmax(percent))
            yield Message(
                f"Held-out data ({motion}): the error is {percent[worst]:.2g} % of the RMS"
                f" {report.model.output_quantity} at {names[worst]}.",
                "bad",
            )
        elif beyond:
            yield Message(
                f"Held-out data ({motion}): errors at {listed(beyond)} are larger than on fitted"
                " data, by more than noise explains. The model may lack a term.",
                "caution",
            )
        else:
            yield Message(
                f"Held-out data ({motion}): errors are as small as on fitted data. No overfitting.",
                "good",
            )

    @staticmethod
    def _percent(held_out: HeldOut, report: AnyReport) -> Float[np.ndarray, " outputs"]:
        """Return held-out errors beyond noise, in % of the RMS torque of the training recording."""
        quality = report.section("quality")
        if quality is None:
            return np.zeros(len(held_out.held_out))
        training = quality.data["quality"]["training"]
        size = np.asarray(training["judged"]["torque_rms"], float)
        percent = 100.0 * held_out.held_out / np.where(size > 0.0, size, np.inf)
        return _beyond_noise(percent, training)

    def blocks(self, report: AnyReport, charts: bool) -> Iterator[Section]:
        held_out, model = self.result(self.name, report), report.model
        if held_out is None:
            return
        limit = Column("limit", "largest ratio that noise explains", digits=3)
        columns = [
            (Column("RMS error, fitted"), held_out.training.tolist()),
            (Column("RMS error, held-out"), held_out.held_out.tolist()),
            (Column("ratio", digits=3), held_out.ratio.tolist()),
            (limit, held_out.limit.tolist()),
        ]
        caption = f"Held-out data ({_MOTION[held_out.source]})"
        yield Section("Errors", "", [model.table(columns, caption, "held-out")])


class EstimatorSection(AbstractSection):
    """Errors of both estimators on motion that neither was fitted to."""

    name = "estimators"
    results = MappingProxyType({"estimators": None})
    entries = MappingProxyType({"estimators": dict})
    position = 13

    def text(self, report: AnyReport) -> Iterator[Sequence[str]]:
        yield [estimator_text(open_errors(self.data["estimators"]), report.model.output_units)]

    def blocks(self, report: AnyReport, charts: bool) -> Iterator[Section]:
        estimators = open_errors(self.data["estimators"])
        relative = RelativeError(estimators["change"], estimators["change_error"], 0)
        ended = "converged" if estimators["converged"] else "did not converge"
        text = (
            f"Compared on {_MOTION[estimators['held_out']]}. The misfit of maximum likelihood is"
            f" {relative} relative to least squares, on average. This report uses"
            f" {estimators['used']}. Maximum likelihood {ended} after {estimators['steps']} steps."
        )
        if lengths := estimators.get("lengths"):
            line = presliding_line(lengths, report.model.output_units)
            text += f" {line[0].upper()}{line[1:]}."
        columns = [
            (Column(f"{estimator}{samples}"), errors)
            for kind, samples in (("rms", ""), ("rms_all_samples", ", all samples"))
            for estimator, errors in estimators[kind].items()
        ]
        table = report.model.table(columns, "RMS torque error by estimator", "estimators-table")
        blocks: list[AbstractBlock] = [Paragraph(text), table]
        if spacing := estimators.get("spacing"):
            tried = "; ".join(spacing["lines"])
            blocks.append(Paragraph(f"Spacing of estimated positions: {tried}."))
        yield Section(
            "Estimators",
            "Least squares fits torque to smoothed motion. Maximum likelihood estimates the true"
            " positions together with the coefficients, and needs no smoothing. The table uses"
            " smoothed motion, which favours least squares. The misfit compares encoder readings"
            " and torques with positions estimated for each set of coefficients.",
            blocks,
        )


class HorizonSection(AbstractSection):
    """Median errors of simulated positions, some time after simulations started."""

    name = "horizon"
    results = MappingProxyType({"horizon": None})
    entries = MappingProxyType({"horizon": dict})
    position = 14

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
        yield ["simulated without feedback: median absolute position error", table]

    def messages(self, report: AnyReport) -> Iterator[Message]:
        horizon = self.result(self.name, report)
        at = int(np.argmin(np.abs(horizon.horizons - _HORIZON)))
        joint = int(np.argmax(horizon.error["fit"][at]))
        yield Message(
            f"Simulation without feedback: after {horizon.horizons[at]:g} s, the median position"
            f" error is at most {horizon.error['fit'][at][joint]:.2g} {horizon.units[joint]}, at"
            f" {report.model.output_names[joint]}.",
            "plain",
        )

    def blocks(self, report: AnyReport, charts: bool) -> Iterator[Section]:
        horizon, names = self.data["horizon"], report.model.output_names
        whose = "of this report, of its fit with pre-sliding friction, or of the robot's file"
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
        table = Table(tuple(columns), rows, "Median absolute position error", "horizon")
        yield Section(
            "Prediction over a horizon",
            "The identified arm is simulated without feedback under the recorded torques, from"
            " recorded states. The table shows how far its positions are from the recorded ones"
            " after each horizon. An empty cell is a simulation that diverged.",
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


# Fewest samples whose scatter tells noise from motion.
_FEWEST = 10


def _noise(patterns: Patterns) -> list[float]:
    """Return the standard deviation of each torque's white noise [N m or N]."""
    torque = np.asarray(patterns.torque, float)
    return noise_level(torque).tolist() if len(torque) >= _FEWEST else [0.0] * torque.shape[1]


def _beyond_noise(
    percent: Float[np.ndarray, " outputs"], quality: Mapping[str, Any]
) -> Float[np.ndarray, " outputs"]:
    """Return errors [% of RMS torque] without the part that the torque's noise explains."""
    size = np.asarray(quality["judged"]["torque_rms"], float)
    noise = np.asarray(quality.get("noise", 0.0), float)
    share = 100.0 * noise / np.where(size > 0.0, size, np.inf)
    return np.sqrt(np.maximum(percent**2 - share**2, 0.0))


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


def _range(percent: Float[np.ndarray, " outputs"], names: Sequence[str]) -> str:
    """Return the least and the largest error with their joints; one alone if they are alike."""
    low, high = int(np.nanargmin(percent)), int(np.nanargmax(percent))
    shown = [f"{percent[joint]:.2g} %" for joint in (low, high)]
    if shown[0] == shown[1]:
        return shown[0]
    return f"{shown[0]} ({names[low]}) to {shown[1]} ({names[high]})"
