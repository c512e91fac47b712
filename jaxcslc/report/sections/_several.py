"""Section on several training recordings: each against all others together."""

from collections.abc import Iterator, Mapping, Sequence
from types import MappingProxyType
from typing import Any

from jaxcslc.uncertainty import SeveralFit, several_text

from .._blocks import Column, Section, Table
from .._section import AbstractSection, AnyReport, axis_title


class SeveralSection(AbstractSection):
    """Noise and offsets of each recording, and coefficients in which it differs."""

    name = "several"
    results = MappingProxyType({"several": None})
    entries = MappingProxyType({"recordings": dict})
    position = 2

    @classmethod
    def document_of(cls, result: SeveralFit, report: AnyReport) -> Mapping[str, Any]:
        return {"recordings": result.document()}

    def text(self, report: AnyReport) -> Iterator[Sequence[str]]:
        yield [several_text(self.data["recordings"])]

    def blocks(self, report: AnyReport, charts: bool) -> Iterator[Section]:
        model = report.model
        columns = [
            Column("recording", numeric=False),
            Column("samples"),
            Column("differs in", "coefficients, beyond chance", numeric=False, wide=True),
            *(
                Column(f"RMS residual, {axis_title(joint, unit)}", digits=3)
                for joint, unit in zip(model.output_names, model.output_units, strict=True)
            ),
        ]
        rows = tuple(
            (name, entry["samples"], ", ".join(entry["differing"]) or "none", *entry["noise"])
            for name, entry in self.data["recordings"].items()
        )
        caption = "Training recordings, each against all others together"
        yield Section("Data check", "", [Table(tuple(columns), rows, caption, "several")])
