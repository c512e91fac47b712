"""Section on the settings: what was tried, and the part of a long recording that judged them."""

import json
from collections.abc import Iterator, Mapping, Sequence
from types import MappingProxyType
from typing import Any

from jaxcslc.least_squares import settings_document
from jaxcslc.selection import Selection

from .._blocks import AbstractBlock, Column, Details, Paragraph, Section, Table
from .._section import AbstractSection, AnyReport


# Trials that are shown before the others are asked for.
_FIRST_TRIALS = 10


class SettingsSection(AbstractSection):
    """Settings of preparation and fit, and how they were chosen."""

    name = "settings"
    results = MappingProxyType({"selection": None, "judged_part": None})
    entries = MappingProxyType({"settings": dict, "judged_part": str, "trials": list})
    position = 30

    always = True

    @classmethod
    def document_of(cls, result: Any, report: AnyReport) -> Mapping[str, Any]:
        selection: Selection | None = report.results.get("selection")
        part = report.results.get("judged_part")
        trials = () if selection is None else sorted(selection.trials, key=lambda x: x.score)
        return {
            "settings": settings_document(report.settings),
            **({} if part is None else {"judged_part": part}),
            "trials": [
                {
                    "settings": str(trial.settings),
                    "score": float(trial.score),
                    "error": trial.error,
                    "selected": selection is not None and trial.settings == selection.settings,
                }
                for trial in trials
            ],
        }

    def result(self, name: str, report: AnyReport) -> Any:
        if name == "judged_part" or not self.data.get("trials"):
            return self.data.get(name)
        return super().result(name, report)

    def text(self, report: AnyReport) -> Iterator[Sequence[str]]:
        del report
        yield [self.data["judged_part"]] if "judged_part" in self.data else []

    def blocks(self, report: AnyReport, charts: bool) -> Iterator[Section]:
        if report.settings is None:  # as of a file that holds a fit alone
            return
        blocks: list[AbstractBlock] = [Paragraph(f"Used: {report.settings}.")]
        if "judged_part" in self.data:
            blocks.append(Paragraph(f"Long recording: {self.data['judged_part']}."))
        yield Section(
            "Settings",
            "How recordings were smoothed and masked and coefficients fitted. What was not set was"
            " selected by cross-validation within the training recording: each trial was fitted to"
            " all stretches but one and judged on that one.",
            blocks + self._trials(),
        )

    def _trials(self) -> list[AbstractBlock]:
        trials = self.data.get("trials")
        if not trials:
            return [Paragraph("They were set, not selected.")]
        best = trials[0]["score"]
        columns = (
            Column("settings", numeric=False, wide=True, longest=400),
            Column("score", "geometric mean of held-out errors of all joints"),
            Column("to the best", digits=3),
            Column("", numeric=False, tones={"used": "good"}),
        )
        rows = tuple(
            (
                *(trial["settings"], trial["score"], trial["score"] / best if best else None),
                "used" if trial["selected"] else "",
            )
            for trial in trials
        )
        blocks: list[AbstractBlock] = [
            Table(columns, rows[:_FIRST_TRIALS], "Best trials", "trials")
        ]
        if len(rows) > _FIRST_TRIALS:
            others = Table(columns, rows[_FIRST_TRIALS:], name="other-trials")
            blocks.append(Details(f"{len(rows) - _FIRST_TRIALS} other trials", (others,)))
        return blocks

    @classmethod
    def compared(cls, sections: tuple[AbstractSection | None, AbstractSection | None]) -> Section:
        first, second = (
            dict(_flat({} if section is None else section.data.get("settings", {})))
            for section in sections
        )
        rows = tuple(
            (name, first.get(name, ""), second.get(name, ""))
            for name in dict.fromkeys((*first, *second))
            if first.get(name) != second.get(name)
        )
        columns = tuple(
            Column(name, numeric=False, wide=True) for name in ("setting", "first", "second")
        )
        blocks = [Table(columns, rows)] if rows else [Paragraph("All settings are equal.")]
        return Section("Settings", "Those that differ.", blocks)


def _flat(document: Mapping[str, Any], above: str = "") -> Iterator[tuple[str, str]]:
    """Yield nested entries as texts, named by their path."""
    for name, value in document.items():
        if isinstance(value, Mapping):
            yield from _flat(value, f"{above}{name}.")
        else:
            yield f"{above}{name}", json.dumps(value, ensure_ascii=False)
