"""Sections on how coefficients were identified: network, settings, what was given, the command."""

import json
import platform
from collections.abc import Iterator, Mapping, Sequence
from importlib.metadata import PackageNotFoundError, version
from types import MappingProxyType
from typing import Any

import numpy as np

from jaxcslc._plain_data import plain, record_document
from jaxcslc.bodies import FileWeight, Prior, prior_from
from jaxcslc.least_squares import settings_document
from jaxcslc.recordings import Patterns
from jaxcslc.selection import Selection

from .._page import AbstractBlock, Code, Column, Details, Paragraph, Section, Table
from .._section import AbstractSection, AnyReport, counted


# States of the motion that are stored: enough to compare torques over it later.
_STATES = 100
# Positions and their derivatives in SI units: no robot comes near.
_LARGEST = 1e12
# Trials that are shown before the others are asked for.
_FIRST_TRIALS = 10
_LIBRARIES = ("jaxcslc", "jax", "jaxlib", "equinox", "numpy", "scipy", "sympy")


class ModelSection(AbstractSection):
    """Description of the network; `manipulator` is the robot, as its file had it."""

    name = "model"
    entries = MappingProxyType(
        {
            "robot": str,
            "lengths": object,
            "static_slopes": list,
            "friction": list,
            "joint_friction": list,
            "coupled": list,
            "manipulator": dict,
        }
    )

    always = True

    @classmethod
    def document_of(cls, result: None, report: AnyReport) -> Mapping[str, Any]:
        network, robot = report.network, report.network.robot
        slopes = network.static_slopes
        return {
            "robot": robot.name,
            "lengths": network.algebra.lengths,
            **({} if slopes is None else {"static_slopes": np.asarray(slopes, float)}),
            "friction": robot.friction,
            "joint_friction": robot.friction_per_joint,
            "coupled": robot.coupled,
            "manipulator": record_document(robot),
        }

    def text(self, report: AnyReport) -> Iterator[Sequence[str]]:
        yield [*report.model.lines, f"settings: {report.settings}"]


class MotionSection(AbstractSection):
    """States of the training recording, evenly spaced."""

    name = "states"
    results = MappingProxyType({"states": None})
    entries = MappingProxyType({"motion": dict})

    @classmethod
    def of(cls, report: AnyReport) -> AbstractSection:
        return cls(lambda: cls.document_of(None, report))

    @classmethod
    def document_of(cls, result: None, report: AnyReport) -> Mapping[str, Any]:
        patterns = report.patterns["training"]
        every = max(patterns.samples // _STATES, 1)
        names = ("q", "qd", "qdd")
        return {"motion": {name: np.asarray(getattr(patterns, name))[::every] for name in names}}

    def result(self, name: str, report: AnyReport) -> Patterns:
        """Return the states as patterns without torques."""
        motion, joints = self.data["motion"], len(report.model.output_names)
        try:
            q, qd, qdd = (np.asarray(motion[name], float) for name in ("q", "qd", "qdd"))
        except (KeyError, TypeError, ValueError):
            raise ValueError("motion: expected arrays q, qd and qdd") from None
        finite = q.shape == qd.shape == qdd.shape and np.all(np.abs([q, qd, qdd]) <= _LARGEST)
        if not finite or q.shape != (len(q), joints):
            raise ValueError(f"motion: expected finite q, qd and qdd of {joints} joints each")
        mask = np.ones(q.shape, bool)
        return Patterns(np.arange(len(q), dtype=float), q, qd, qdd, 0 * q, mask, mask)


class SettingsSection(AbstractSection):
    """Settings of preparation and fit, and how they were chosen."""

    name = "settings"
    results = MappingProxyType({"selection": None, "judged_part": None})
    entries = MappingProxyType({"settings": dict, "judged_part": str, "trials": list})
    position = 40

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
            "Smoothing, masks and options of the fit. What was not set was selected by"
            " cross-validation within the training recording: each candidate was fitted to all"
            " segments except one and tested on that one.",
            blocks + self._trials(),
        )

    def _trials(self) -> list[AbstractBlock]:
        trials = self.data.get("trials")
        if not trials:
            return [Paragraph("Set by the user, not selected.")]
        best = trials[0]["score"]
        columns = (
            Column("settings", numeric=False, wide=True, longest=400),
            Column("score", "geometric mean of the held-out errors of all joints"),
            Column("relative to the best", digits=3),
            Column("result", numeric=False, tones={"used": "good"}),
        )
        rows = tuple(
            (
                *(trial["settings"], trial["score"], trial["score"] / best if best else None),
                "used" if trial["selected"] else "",
            )
            for trial in trials
        )
        blocks: list[AbstractBlock] = [
            Table(columns, rows[:_FIRST_TRIALS], "Best candidates", "trials")
        ]
        if len(rows) > _FIRST_TRIALS:
            others = Table(columns, rows[_FIRST_TRIALS:], name="other-trials")
            blocks.append(Details(f"{len(rows) - _FIRST_TRIALS} other candidates", (others,)))
        return blocks

    @classmethod
    def compared(cls, first: Mapping[str, Any], second: Mapping[str, Any]) -> Section:
        texts = [dict(_flat(data.get("settings", {}))) for data in (first, second)]
        rows = tuple(
            (name, *values)
            for name in dict.fromkeys(name for entries in texts for name in entries)
            for values in (tuple(entries.get(name, "") for entries in texts),)
            if values[0] != values[1]
        )
        columns = [
            Column(name, numeric=False, wide=True) for name in ("setting", "first", "second")
        ]
        block = Table(tuple(columns), rows) if rows else Paragraph("All settings are equal.")
        return Section("Settings", "Those that differ.", [block])


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
            " are kept from the previous identification"
        ]


class PriorSection(AbstractSection):
    """Prior knowledge of coefficients and links."""

    name = "prior"
    results = MappingProxyType({"prior": None})
    entries = MappingProxyType({"prior": dict})

    def result(self, name: str, report: AnyReport) -> Prior:
        return prior_from(self.data["prior"], "prior")

    def text(self, report: AnyReport) -> Iterator[Sequence[str]]:
        yield [f"prior knowledge: {self.result(self.name, report)}"]


class FilePriorSection(AbstractSection):
    """The robot's file as prior of its inertial parameters."""

    name = "file_prior"
    results = MappingProxyType({"file_prior": None})
    entries = MappingProxyType({"file_prior": dict})
    position = 22

    def result(self, name: str, report: AnyReport) -> FileWeight:
        data = self.data["file_prior"]
        share = np.array(data["share"], float)
        if share.shape != (len(report.names),):
            raise ValueError(f"file_prior, share: expected {len(report.names)} numbers")
        names = (
            tuple(map(str, data[key]))
            for key in ("contradicted", "guessed", "invented", "implausible")
        )
        return FileWeight(share, data["widths"], float(data["misfit"]), *names)

    def text(self, report: AnyReport) -> Iterator[Sequence[str]]:
        yield [str(self.result(self.name, report))]

    def blocks(self, report: AnyReport, charts: bool) -> Iterator[Section]:
        weight = self.result(self.name, report)
        widths = [100 * width for width in weight.widths.values()]
        columns = [
            (Column("link", numeric=False), list(weight.widths)),
            (Column("assumed error of its mass [%]", digits=3), widths),
        ]
        yield Section(
            "The robot's file as prior",
            "The log decides the inertial parameters that its motion determines, and the robot's"
            " file the others. Masses of the file are assumed to be known to 20 %, or less well if"
            " fits to parts of the motion then predict the other parts better. Links that the data"
            " contradict, or that share one inertia, are assumed to be known less well. Errors of"
            f" the data are assumed to be {np.sqrt(weight.misfit):.3g} times as large as residuals"
            f" show. The file decides {weight.decided} of"
            f" {counted(len(weight.share), 'coefficient')}.",
            [Table.from_columns(columns, "Assumed errors", "file-prior")],
        )


class RepeatSection(AbstractSection):
    """The command, and the versions of Python and of the libraries that numbers depend on."""

    name = "command"
    results = MappingProxyType({"command": None})
    entries = MappingProxyType({"command": str, "versions": dict})
    position = 50

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
            blocks.append(Paragraph(", ".join(f"{name} {x}" for name, x in numbers.items()) + "."))
        if report.settings is not None:  # as of a file that holds a fit alone
            settings = plain(settings_document(report.settings))
            text = json.dumps(settings, indent=2, ensure_ascii=False)
            blocks.append(Details("Settings, as --settings reads them", (Code(text),)))
        yield Section(
            "To repeat it",
            "The command and the versions of the libraries. With --settings identification.json the"
            " same settings are used again.",
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


def _flat(document: Mapping[str, Any], above: str = "") -> Iterator[tuple[str, str]]:
    """Yield nested entries as texts, named by their path."""
    for name, value in document.items():
        if isinstance(value, Mapping):
            yield from _flat(value, f"{above}{name}.")
        else:
            yield f"{above}{name}", json.dumps(value, ensure_ascii=False)
