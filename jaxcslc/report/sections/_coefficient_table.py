"""Sections on the coefficients: table, verdicts, excitation, correlations, systematic errors."""

from collections import Counter
from collections.abc import Iterator, Mapping, Sequence
from types import MappingProxyType
from typing import Any

import numpy as np

from jaxcslc._environment import as_jax
from jaxcslc._text_table import number_text, readable
from jaxcslc.least_squares import Identification
from jaxcslc.network import CSLC, AbstractLinearNetwork
from jaxcslc.uncertainty import SHOWN_SCALE, TORQUE_SCALE, SystematicError

from .._charts import MatrixChart
from .._coefficients import WELL_DETERMINED, coefficient_text, legend_text
from .._excitation import Excitation
from .._page import (
    AbstractBlock,
    Column,
    Grid,
    Message,
    Messages,
    Paragraph,
    Section,
    Table,
    Tone,
    without_rounding,
)
from .._section import AbstractSection, AnyReport, counted, listed


# Above this share of signs that no body has, torque or positions are likely to have the wrong one.
_MANY_WRONG_SIGNS = 0.25
# Coefficients with a wrong sign that the verdict names: a line's worth.
_NAMED = 6
# Pairs of coefficients that are listed as correlated.
_MOST_PAIRS = 12
_CORRELATED = 0.9
# Coefficients whose correlations can be read from a picture.
_MOST_LABELS = 120

_VERDICT_TONES: dict[str, Tone] = {
    "well determined": "good",
    "well determined up to scale": "good",
    "systematic error": "caution",
    "poorly determined": "caution",
    "from the file": "plain",
    "indistinguishable from zero": "plain",
    "wrong sign": "bad",
    "not determined": "bad",
}
# Verdicts after a number, where they are no adjectives.
_COUNTED = {"systematic error": "with a systematic error", "wrong sign": "of the wrong sign"}
_COLUMNS = {
    "name": Column("name", numeric=False),
    "value": Column("value"),
    "low": Column("low"),
    "high": Column("high"),
    "file": Column(
        "file", "of the robot's file, whose missing motor inertias count as zero", digits=3
    ),
    "unit": Column("unit", numeric=False),
    "verdict": Column("verdict", numeric=False, tones=_VERDICT_TONES),
    "reason": Column("reason", numeric=False, wide=True),
    "expression": Column("expression", numeric=False, wide=True),
}


class CoefficientSection(AbstractSection):
    """Values, intervals and verdicts of the coefficients."""

    name = "coefficients"
    entries = MappingProxyType({"unidentifiable": list, "file_values": dict})
    position = 20

    always = True

    @classmethod
    def document_of(cls, result: None, report: AnyReport) -> Mapping[str, Any]:
        return {
            "unidentifiable": report.fit.unidentifiable,
            "file_values": _file_values(report.network),
        }

    def text(self, report: AnyReport) -> Iterator[Sequence[str]]:
        yield [coefficient_text(report.rows())]

    def tables(self, report: AnyReport) -> Mapping[str, Sequence[Mapping[str, Any]]]:
        return {"coefficients.csv": report.rows()}

    def messages(self, report: AnyReport) -> Iterator[Message]:
        rows = report.rows()
        kinds = Counter(row["verdict"] for row in rows)
        plain, scaled = (kinds.pop(kind, 0) for kind in WELL_DETERMINED)
        # What is zero on the arm cannot be known to a tenth of itself. What the motion leaves to
        # the robot's file changes its torque little.
        known = ("indistinguishable from zero", "from the file")
        doubtful = sum(kinds.values()) - sum(kinds[kind] for kind in known)
        others = ", ".join(
            f"{kinds[kind]} {_COUNTED.get(kind, kind)}" for kind in _VERDICT_TONES if kinds[kind]
        )
        yield Message(
            f"{plain or scaled} of {counted(len(rows), 'coefficient')} well determined"
            + ("" if not scaled else f", {scaled} up to scale" if plain else " up to scale")
            + (f"; {others}." if others else ".")
            + _scale_statement(getattr(report, "systematic", None)),
            "caution" if kinds["not determined"] or plain + scaled <= doubtful else "good",
        )
        signed = sum(bool(row["positive"]) for row in rows)
        if wrong := kinds["wrong sign"]:
            many = wrong > _MANY_WRONG_SIGNS * signed
            names = [str(row["name"]) for row in rows if row["verdict"] == "wrong sign"]
            shown = names if len(names) <= _NAMED else [*names[:_NAMED], "others"]
            yield Message(
                f"{listed(shown)}: negative, but positive for every physically consistent robot"
                + ("; check the signs of torques and positions." if many else "."),
                "bad" if many else "caution",
            )

    def blocks(self, report: AnyReport, charts: bool) -> Iterator[Section]:
        fit, legend = report.fit, report.model.legend
        values: Mapping[str, float] = self.data.get("file_values") or {}
        largest = max(map(abs, values.values()), default=0.0)
        file = dict(zip(values, without_rounding(values.values(), largest), strict=True))
        columns = {name: x for name, x in _COLUMNS.items() if file or name != "file"}
        rows = tuple(
            tuple(
                (row | _shown(row) | {"file": file.get(str(row["name"]))})[name] for name in columns
            )
            for row in report.rows()
        )
        undetermined = tuple(Message(text, "bad") for text in fit.unidentifiable)
        yield Section(
            "Coefficients",
            "Low and high are the ends of the 95 % confidence interval, for"
            f" {fit.errors} errors with {float(fit.degrees_of_freedom):.0f} degrees of freedom."
            " The interval contains two errors. Noise causes the standard error, which falls with"
            " more data. Smoothing, torque timing, missing terms, and errors of torque scale, clock"
            " and zero positions within tolerances cause the systematic error. More data of this"
            " motion do not reduce it. A coefficient is well determined if its standard error is at"
            " most 10 % of the value, and its systematic error at most 5 %. Up to scale: a common"
            " factor of all torques changes all of them alike, and neither the data nor the robot's"
            " file confirm it to 10 %. If only the systematic"
            " error is larger, the verdict is 'systematic error', and the reason names the main"
            " cause. A poorly determined coefficient has little effect on the torque of this"
            " motion.",
            [
                *([Messages(undetermined)] if undetermined else []),
                *([] if legend is None else [Paragraph(f"{legend}.")]),
                Table(tuple(columns.values()), rows, name="coefficients-table"),
            ],
        )


def _file_values(network: AbstractLinearNetwork) -> dict[str, float]:
    """Return values of coefficients by the robot's file, for those that it has values for."""
    if not isinstance(network, CSLC):
        return {}
    robot, values = network.robot, dict[str, float]()
    groups = [coefficient.group for coefficient in network.coefficients]
    lengths_known = all(x.value is not None for x in robot.named_lengths().values())
    if robot.links is not None and lengths_known:
        k = np.asarray(network.coefficients_from(robot.links)).tolist()
        rigid = list(zip(network.names, k, groups, strict=True))[: network.terms[0].size]
        values = {name: value for name, value, group in rigid if group != "payload"}
    for kind, known in (("viscous", robot.viscous), ("dry", robot.dry)):
        names = [x for x, group in zip(network.names, groups, strict=True) if group == kind]
        pairs = zip(known or (), network.friction_per_joint, strict=False)
        have = [value for value, kinds in pairs if kind in kinds]
        values |= dict(zip(names, map(float, have), strict=False))
    return values


def _scale_statement(systematic: SystematicError | None) -> str:
    """Return a sentence on an error of the torque scale, if only a tolerance bounds it.

    >>> within = {"torque scale": "± 6 %", "torque scale shown": "± 40 %"}
    >>> _scale_statement(SystematicError({}, within)).partition(". ")[2]
    "By the masses in the robot's file, only scale errors above 40 % can be excluded."
    """
    shown = None if systematic is None else systematic.within.get(SHOWN_SCALE)
    if systematic is None or shown is None:
        return ""
    return f" Intervals include a torque scale error of {systematic.within[TORQUE_SCALE]}. " + (
        "Nothing excludes a larger one."
        if shown == "nothing"
        else "By the masses in the robot's file, only scale errors above"
        f" {shown[2:]} can be excluded."
    )


class SystematicSection(AbstractSection):
    """Errors of the fit that no residual shows, by cause."""

    name = "systematic"
    results = MappingProxyType({"systematic": None})
    entries = MappingProxyType({"systematic_error": object, "tolerances": dict})

    @classmethod
    def document_of(cls, result: SystematicError, report: AnyReport) -> Mapping[str, Any]:
        parts = {"systematic_error": dict(result.parts)}
        return parts | ({"tolerances": dict(result.within)} if result.within else {})

    def result(self, name: str, report: AnyReport) -> SystematicError | None:
        where, size = "systematic_error", len(report.names)
        if self.data[where] is None:
            return None
        try:
            parts = self.data[where].items()
            arrays = {str(cause): np.array(values, float) for cause, values in parts}
        except (AttributeError, TypeError, ValueError):
            raise ValueError(f"{where}: expected numbers by cause") from None
        for cause, values in arrays.items():
            values[np.isnan(values)] = np.inf  # JSON has no number for it
            if values.shape != (size,) or np.any(values < 0):
                raise ValueError(f"{where}, {cause}: expected {size} numbers from 0 up")
        within = {str(cause): str(text) for cause, text in self.data.get("tolerances", {}).items()}
        return SystematicError(arrays, within) if arrays else None


class ExcitationSection(AbstractSection):
    """Excitation of the motion: rank, condition and correlations."""

    name = "excitation"
    results = MappingProxyType({"excitation": None})
    entries = MappingProxyType({"least_determined": str, "excitation": dict})
    position = 24

    always = True

    @classmethod
    def document_of(cls, result: Excitation | None, report: AnyReport) -> Mapping[str, Any]:
        if result is None:
            return {}
        numbers = ("condition", "smallest", "weakest", "length", "variance_inflation")
        return {
            "least_determined": result.worst_combination,
            "excitation": {
                **{name: getattr(result, name) for name in numbers},
                "group_condition": dict(result.group_condition),
            },
        }

    def result(self, name: str, report: AnyReport) -> Excitation | None:
        data = self.data.get("excitation")
        if data is None:
            return None
        groups = {group: _open(value) for group, value in data["group_condition"].items()}
        numbers = {name: _open(value) for name, value in data.items() if name != "group_condition"}
        return Excitation(**numbers, group_condition=groups, names=report.names)

    def text(self, report: AnyReport) -> Iterator[Sequence[str]]:
        fit, legend = report.fit, report.model.legend
        fixed = report.section("groups")
        fitted = len(report.names) - (0 if fixed is None else len(fixed.data["fixed"]))
        systematic = getattr(report, "systematic", None)
        causes = "" if systematic is None else ". Systematic errors included: "
        causes += "" if systematic is None else systematic.description
        errors = "std error: what noise causes"
        errors += (
            ""
            if systematic is None
            else ("; systematic: possible shift, which more data of this motion do not reduce")
        )
        condition = number_text(float(fit.condition))
        text = f"rank {int(fit.rank)} of {fitted}, condition number {condition}"
        if "least_determined" in self.data:
            text += f"; least determined combination: {readable(self.data['least_determined'])}"
        yield [
            *([] if legend is None else [legend_text(legend)]),
            errors,
            f"low, high: 95 % confidence interval for {fit.errors} errors (Student's t with"
            f" {float(fit.degrees_of_freedom):.0f} degrees of freedom){causes}",
            *(f"not determined: {sentence}" for sentence in fit.unidentifiable),
            text,
        ]

    def messages(self, report: AnyReport) -> Iterator[Message]:
        if not bool(report.fit.meaningful):
            yield Message(
                f"Condition number {float(report.fit.condition):.2g}: the motion does not separate"
                " the coefficients, so that no single value can be trusted.",
                "bad",
            )

    def blocks(self, report: AnyReport, charts: bool) -> Iterator[Section]:
        excitation = self.result(self.name, report)
        blocks: list[AbstractBlock] = []
        tables: list[AbstractBlock] = []
        if excitation is not None:
            blocks.append(Paragraph(f"Least determined: {readable(self.data['least_determined'])}"))
            columns = [Column("coefficients", numeric=False), Column("condition")]
            rows = tuple(tuple(row.values()) for row in excitation.rows())
            tables.append(Table(tuple(columns), rows, "Condition number", "excitation-table"))
        pairs = _correlated(report.fit)
        if pairs:
            columns = (
                Column("coefficient", numeric=False),
                Column("and", numeric=False),
                Column("correlation", digits=3),
            )
            tables.append(Table(columns, pairs, "Most correlated coefficients", "correlated"))
        else:
            tables.append(Paragraph("No two coefficients are correlated by more than 0.9."))
        blocks.append(Grid(tuple(tables)))
        if charts and 1 < len(report.names) <= _MOST_LABELS:
            matrix = np.asarray(report.fit.correlation).tolist()
            caption = "Correlations between the errors of coefficients"
            blocks.append(MatrixChart(report.names, matrix, caption))
        yield Section(
            "Excitation and correlations",
            "The condition number is the factor by which relative noise of the"
            f" {report.model.output_quantity} is amplified in the coefficients. It is 1 at best;"
            " above 100 the motion separates some of them poorly. Errors of correlated coefficients"
            " compensate each other: their sum or difference is known better than each of them.",
            blocks,
        )


def _shown(row: Mapping[str, Any]) -> dict[str, str]:
    """Return entries of a row as the page shows them: reasons of doubt, rounded expressions."""
    reason = "" if row["verdict"] in WELL_DETERMINED else row["reason"]
    return {"reason": reason, "expression": readable(row["expression"])}


def _correlated(fit: Identification) -> tuple[tuple[str, str, float], ...]:
    """Return the most correlated pairs of coefficients, the largest first."""
    correlation = np.asarray(fit.correlation)
    rows, columns = np.triu_indices(len(correlation), 1)
    size = np.abs(correlation[rows, columns])
    strongest = [i for i in np.argsort(-size, kind="stable")[:_MOST_PAIRS] if size[i] > _CORRELATED]
    return tuple(
        (fit.names[rows[i]], fit.names[columns[i]], float(correlation[rows[i], columns[i]]))
        for i in strongest
    )


def _open(value: Any) -> Any:
    """Return numbers that may be infinite, from JSON, which has none for it."""
    if isinstance(value, list):
        numbers = np.array(value, float)
        return as_jax(np.where(np.isnan(numbers), np.inf, numbers))
    return as_jax(np.float64(np.inf if value is None else value))
