"""Sections on friction: terms that were tried joint by joint, and pre-sliding friction."""

import math
from collections.abc import Iterator, Mapping, Sequence
from types import MappingProxyType
from typing import Any

from jaxcslc.friction import PreSlidingFit, pre_sliding_document, pre_sliding_from
from jaxcslc.selection import FrictionChoice

from .._blocks import Column, Section, Table
from .._section import AbstractSection, AnyReport


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
            Column("length", "of pre-sliding", digits=3),
            Column("unit", numeric=False),
            Column("", numeric=False, tones={"used": "good"}),
        )
        rows = tuple(_row(trial, report.model.output_names) for trial in trials)
        yield Section(
            "Friction terms tried",
            "Errors on stretches of the training recording that were left out of the fit, with a"
            " term over those without it; of pre-sliding over all samples, of other terms over"
            " those that masks leave in. Terms are used where they gain more than chance explains.",
            [Table(columns, rows, "joint by joint, in the order of the trials", "friction-trials")],
        )


class PreSlidingSection(AbstractSection):
    """Dry friction that yields before it slides."""

    name = "pre_sliding"
    results = MappingProxyType({"pre_sliding": None})
    entries = MappingProxyType({"pre_sliding": object})

    @classmethod
    def document_of(cls, result: PreSlidingFit, report: AnyReport) -> Mapping[str, Any]:
        return {"pre_sliding": pre_sliding_document(result)}

    def result(self, name: str, report: AnyReport) -> PreSlidingFit | None:
        data = self.data[self.name]
        return None if data is None else pre_sliding_from(data, report.network, self.name)


def _row(trial: Mapping[str, Any], joints: tuple[str, ...]) -> tuple[str | float | None, ...]:
    joint, kind = joints[trial["joint"] - 1], trial["kind"]
    if not trial["possible"]:
        return joint, kind, None, None, None, "", "dropped by the fit"
    error = trial["change_error"]
    return (
        joint,
        kind,
        100 * math.expm1(trial["change"]),
        None if error is None else 100 * error,
        trial["length"],
        "" if trial["length"] is None else trial["length_unit"],
        "used" if trial["used"] else "",
    )
