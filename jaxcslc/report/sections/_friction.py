"""Sections on friction: slopes, pre-sliding, terms that were tried, friction over velocity."""

import math
from collections.abc import Iterator, Mapping, Sequence
from types import MappingProxyType
from typing import Any

import numpy as np

from jaxcslc.friction import PreSlidingFit, SlopeFit, pre_sliding_document, pre_sliding_from
from jaxcslc.selection import FrictionChoice

from .._charts import Curve, Panel, PanelChart, rounded
from .._errors import predicted_torque
from .._page import AbstractBlock, Column, Grid, Section, Table
from .._section import AbstractSection, AnyReport, axis_title, open_errors


# Points of all clouds of a page, and of one.
_ALL_DOTS, _MOST_DOTS = 30_000, 1500


class SlopeSection(AbstractSection):
    """Fitted slopes of static friction."""

    name = "slopes"
    results = MappingProxyType({"slopes": None})
    entries = MappingProxyType({"slopes": list})

    @classmethod
    def document_of(cls, result: SlopeFit, report: AnyReport) -> Mapping[str, Any]:
        columns = (report.model.output_names, result.slopes, result.slope_error)
        kinds = result.network.friction_per_joint
        return {
            "slopes": [
                {"joint": name, "slope": float(slope), "error": float(error)}
                for name, slope, error, terms in zip(*columns, kinds, strict=True)
                if "static" in terms
            ]
        }

    def text(self, report: AnyReport) -> Iterator[Sequence[str]]:
        joints = ", ".join(
            f"{entry['joint']} {entry['slope']:.4g} ± {entry['error']:.2g}"
            for entry in open_errors(self.data["slopes"])
        )
        if joints:
            yield [
                f"slopes of static friction [s/rad or s/m]: {joints};"
                " the intervals above include their errors"
            ]


class FrictionTrialSection(AbstractSection):
    """Friction terms that were tried, and what each was worth."""

    name = "friction"
    results = MappingProxyType({"friction": None})
    entries = MappingProxyType({"friction_trials": list, "friction_notes": list})
    position = 23

    @classmethod
    def document_of(cls, result: FrictionChoice, report: AnyReport) -> Mapping[str, Any]:
        return {"friction_trials": result.document(), "friction_notes": result.sentences}

    def notes(self) -> Sequence[str]:
        return self.data.get("friction_notes", ())

    def blocks(self, report: AnyReport, charts: bool) -> Iterator[Section]:
        trials = self.data["friction_trials"]
        if not trials:
            return
        columns = (
            Column(report.model.output_kind, numeric=False),
            Column("friction", numeric=False),
            Column("change of held-out error [%]", digits=2),
            Column("standard error [%]", digits=2),
            Column("elsewhere [%]", "on other speeds, positions and recordings", digits=2),
            Column("length", "of pre-sliding", digits=3),
            Column("unit", numeric=False),
            Column("result", numeric=False, tones={"used": "good"}),
        )
        rows = tuple(_row(trial, report.model.output_names) for trial in trials)
        yield Section(
            "Friction terms tried",
            "Errors on held-out segments of the training recording, with a term relative to without"
            " it. Pre-sliding is tested over all samples, other terms over unmasked ones. A term is"
            " used where it improves prediction by more than chance, and does not make it worse on"
            " motion that differs in speed, position or recording from what was fitted.",
            [Table(columns, rows, "Per joint, in the order of the trials", "friction-trials")],
        )


class PreSlidingSection(AbstractSection):
    """Pre-sliding (Dahl) friction."""

    name = "pre_sliding"
    results = MappingProxyType({"pre_sliding": None})
    entries = MappingProxyType({"pre_sliding": object})

    @classmethod
    def document_of(cls, result: PreSlidingFit, report: AnyReport) -> Mapping[str, Any]:
        return {"pre_sliding": pre_sliding_document(result)}

    def result(self, name: str, report: AnyReport) -> PreSlidingFit | None:
        data = self.data[self.name]
        return None if data is None else pre_sliding_from(data, report.network, self.name)


class FrictionSection(AbstractSection):
    """Friction of each joint over its velocity, training recording, thinned for drawing."""

    name = "friction_points"
    entries = MappingProxyType({"friction_points": list})
    file = "charts.json"
    position = 22

    @classmethod
    def of(cls, report: AnyReport) -> AbstractSection | None:
        return super().of(report) if report.network.layout.friction.size else None

    @classmethod
    def document_of(cls, result: None, report: AnyReport) -> Mapping[str, Any]:
        """Measured is the torque less what all other terms predict, where it was fitted."""
        network, patterns = report.network_along("training"), report.patterns["training"]
        friction = np.isin(np.arange(network.size), network.layout.friction)
        model = np.asarray(predicted_torque(network, patterns, np.where(friction, report.k, 0.0)))
        data = np.asarray(patterns.torque) - report.predicted("training") + model
        speed, mask = np.asarray(patterns.qd), np.asarray(patterns.mask)
        most = max(min(_ALL_DOTS // network.joint_count, _MOST_DOTS), 1)
        clouds: list[dict[str, Any]] = []
        for joint in range(network.joint_count):
            samples = np.flatnonzero(mask[:, joint])
            samples = samples[:: max(-(-len(samples) // most), 1)]
            order = samples[np.argsort(speed[samples, joint], kind="stable")]
            velocity, *torques = (rounded(x[order, joint]) for x in (speed, data, model))
            pairs = zip(("data", "model"), torques, strict=True)
            clouds.append({name: {"x": velocity, "y": torque} for name, torque in pairs})
        return {"friction_points": clouds}

    def blocks(self, report: AnyReport, charts: bool) -> Iterator[Section]:
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
            "Friction of each joint over its velocity, training recording. Grey: measured torque"
            " minus the prediction of all other terms. Colour: the friction terms at the same"
            " samples. If the grey points bend away from the coloured ones, another friction term"
            " is needed.",
            [Grid(tuple(blocks))],
        )


def _row(trial: Mapping[str, Any], joints: tuple[str, ...]) -> tuple[str | float | None, ...]:
    joint, kind = joints[trial["joint"] - 1], trial["kind"]
    if not trial["possible"]:
        return joint, kind, None, None, None, None, "", "dropped by the fit"
    error, elsewhere = trial["change_error"], trial.get("change_elsewhere")
    return (
        joint,
        kind,
        100 * math.expm1(trial["change"]),
        None if error is None else 100 * error,
        None if elsewhere is None else 100 * math.expm1(elsewhere),
        trial["length"],
        "" if trial["length"] is None else trial["length_unit"],
        "used" if trial["used"] else "",
    )
