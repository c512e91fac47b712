"""Sections on what an identification was given: coefficients to keep, and prior knowledge."""

from collections.abc import Iterator, Mapping, Sequence
from types import MappingProxyType
from typing import Any

from jaxcslc.bodies import Prior, prior_from

from .._section import AbstractSection, AnyReport


class GroupsSection(AbstractSection):
    """Groups that were fitted again, and coefficients that were kept."""

    name = "groups"
    results = MappingProxyType({"groups": None})
    entries = MappingProxyType({"fixed": list, "groups": list})

    @classmethod
    def document_of(cls, result: tuple[str, ...], report: AnyReport) -> Mapping[str, Any]:
        return {
            "groups": result,
            "fixed": [
                coefficient.name
                for coefficient in report.model.coefficients
                if coefficient.group not in result and coefficient.name not in result
            ],
        }

    def result(self, name: str, report: AnyReport) -> tuple[str, ...]:
        return tuple(self.data.get("groups", ()))

    def text(self, report: AnyReport) -> Iterator[Sequence[str]]:
        yield [
            f"re-identified: {', '.join(self.result(self.name, report))}; all other coefficients"
            " are fixed at those of the previous identification"
        ]


class PriorSection(AbstractSection):
    """Prior knowledge of coefficients and links."""

    name = "prior"
    results = MappingProxyType({"prior": None})
    entries = MappingProxyType({"prior": dict})

    @classmethod
    def document_of(cls, result: Prior, report: AnyReport) -> Mapping[str, Any]:
        return {"prior": result.document()}

    def result(self, name: str, report: AnyReport) -> Prior:
        return prior_from(self.data["prior"], "prior")

    def text(self, report: AnyReport) -> Iterator[Sequence[str]]:
        yield [f"known before: {self.result(self.name, report)}"]
