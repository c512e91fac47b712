"""Section on how to repeat an identification: command, versions of libraries, settings."""

import json
import platform
from collections.abc import Iterator, Mapping
from importlib.metadata import PackageNotFoundError, version
from types import MappingProxyType
from typing import Any

from jaxcslc._plain_data import plain
from jaxcslc.least_squares import settings_document

from .._blocks import AbstractBlock, Code, Details, Section
from .._section import AbstractSection, AnyReport


_LIBRARIES = ("jaxcslc", "jax", "jaxlib", "equinox", "numpy", "scipy", "sympy")


class RepeatSection(AbstractSection):
    """The command, and the versions of Python and of the libraries that numbers depend on."""

    name = "command"
    results = MappingProxyType({"command": None})
    entries = MappingProxyType({"command": str, "versions": dict})
    position = 40

    always = True

    @classmethod
    def document_of(cls, result: str | None, report: AnyReport) -> Mapping[str, Any]:
        before = {} if report.document is None else report.document
        numbers = before.get("versions", versions())
        return {**({} if result is None else {"command": result}), "versions": numbers}

    def result(self, name: str, report: AnyReport) -> str | None:
        return self.data.get("command")

    def blocks(self, report: AnyReport, charts: bool) -> Iterator[Section]:
        blocks: list[AbstractBlock] = []
        if "command" in self.data:
            blocks.append(Code(self.data["command"]))
        if numbers := self.data.get("versions"):
            blocks.append(Code("\n".join(f"{name} {number}" for name, number in numbers.items())))
        if report.settings is not None:  # as of a file that holds a fit alone
            settings = plain(settings_document(report.settings))
            text = json.dumps(settings, indent=2, ensure_ascii=False)
            blocks.append(Details("Settings, as --settings reads them", (Code(text),)))
        yield Section(
            "To repeat it",
            "The command, if it was one, and the versions of the libraries that computed it."
            " With --settings identification.json the same settings are used again.",
            blocks,
        )


def versions() -> dict[str, str]:
    """Return the versions of Python and of the libraries that numbers depend on."""
    numbers = {"Python": platform.python_version()}
    for library in _LIBRARIES:
        try:
            numbers[library] = version(library)
        except PackageNotFoundError:  # a copy that was not installed
            numbers[library] = "unknown"
    return numbers
