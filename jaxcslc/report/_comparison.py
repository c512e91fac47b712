"""Two reports side by side."""

import dataclasses
from collections.abc import Iterator, Mapping
from pathlib import Path
from typing import Any

import numpy as np
import scipy

from .._scratch import all_together
from .._text_table import text_table
from ..uncertainty import TOLERATED, standard_uncertainty
from ._page import Column, Message, Page, Section, Table, Tone, render
from ._report import Report, read_report


# Standard errors beyond which a difference is listed as one.
_NOTABLE = 2.0
# How many comparisons of equal arms are said to differ.
_CHANCE = 0.01
# Rows of the printed table.
_PRINTED = 15


@dataclasses.dataclass(frozen=True, eq=False)
class ReportComparison:
    """Two reports side by side: coefficients, errors and settings.

    `print` shows the verdict and the coefficients that differ most, `page` everything.

    **Attributes**

    - `names`: of the two folders or files.
    - `first`, `second`: the two reports.
    - `rows`: one a coefficient of either: `name`, `unit`, `first`, `second`, `difference`
      (second less first) and `standard_errors`, the difference over the root of the sum of both
      variances, systematic errors included except those of faults within tolerances
      (`possible_faults`), which both share. None where only one has the coefficient, where it
      stands for another combination of link parameters, or where one is not determined or was
      not fitted; `note` says which.

    >>> import tempfile, jaxcslc as jc
    >>> from jaxcslc.report import compare_reports
    >>> network = jc.derive(jc.examples.pendulum(), lengths="numeric")
    >>> with tempfile.TemporaryDirectory() as folder:
    ...     for name, inertia in (("a", 0.5), ("b", 0.6)):
    ...         k = [inertia, 0.3, 0.0, 0.2, 0.1]
    ...         patterns = jc.examples.swing(network, k, torque_noise=0.01)
    ...         jc.LeastSquares().fit(network, patterns).save(f"{folder}/{name}.json")
    ...     comparison = compare_reports(f"{folder}/a.json", f"{folder}/b.json")
    >>> [round(row["difference"], 3) for row in comparison.rows[:2]]
    [0.1, 0.0]
    """

    names: tuple[str, str]
    first: Report
    second: Report
    rows: tuple[Mapping[str, Any], ...]

    @property
    def verdict(self) -> tuple[Tone, str, tuple[Message, ...]]:
        """Verdict on the agreement of the coefficients: tone, headline, and sentences."""
        return _verdict(self)

    def page(self) -> Page:
        """Return the comparison as a `jaxcslc.report.Page`."""
        tone, headline, messages = self.verdict
        reports = (self.first, self.second)
        robots = dict.fromkeys(report.model.name for report in reports if report.model.name)
        return Page(
            title=f"Comparison of {' and '.join(self.names)}",
            subtitle=", ".join(robots),
            headline=headline,
            tone=tone,
            summary=messages,
            sections=(_coefficient_section(self), *_compared_sections(self)),
        )

    def save(self, path: str | Path) -> None:
        """Writes the page.

        **Arguments**

        - `path`: of the HTML file.

        **Raises**

        - `OSError`: the file cannot be written.
        """
        with all_together([Path(path)]) as (file,):
            file.write_text(render(self.page()), encoding="utf-8", errors="backslashreplace")

    def __str__(self) -> str:
        _, headline, messages = self.verdict
        parts = [headline, *(message.text for message in messages)]
        shown = sorted(self.rows, key=_size, reverse=True)[:_PRINTED]
        cells = [
            [row["name"], *(_number(row[name]) for name in _SHOWN), row["unit"]] for row in shown
        ]
        header = ["name", *_SHOWN.values(), "unit"]
        text = "\n".join(parts) + "\n\n" + text_table(header, cells, left=("unit",))
        hidden = len(self.rows) - len(shown)
        return text + (
            f"\n{hidden} more, errors and settings: on the page (-o, save)" if hidden else ""
        )


_SHOWN = {
    "first": "first",
    "second": "second",
    "difference": "difference",
    "standard_errors": "standard errors",
}


def compare_reports(first: str | Path, second: str | Path) -> ReportComparison:
    """Compares two identifications: of two arms, two days, or two ways to fit.

    **Arguments**

    - `first`, `second`: folders that `Report.save` wrote, or their `identification.json`.

    **Returns** a `ReportComparison`.

    **Raises**

    - `ValueError`: a file that is no identification, or two without a common coefficient.

    >>> import tempfile, jaxcslc as jc
    >>> from jaxcslc.report import compare_reports
    >>> network = jc.derive(jc.examples.turntable(), lengths="numeric")
    >>> recording = jc.examples.swing_recording(network, [0.5, 0.2, 0.05])
    >>> report = jc.identify(network, recording, settings=jc.Settings())
    >>> with tempfile.TemporaryDirectory() as folder:
    ...     _ = report.save(folder, pictures=False)
    ...     comparison = compare_reports(folder, folder)
    >>> [row["name"] for row in comparison.rows]
    ['kB1', 'kv1', 'kd1']
    """
    a, b = read_report(first, Report), read_report(second, Report)
    columns = [_values(a, first), _values(b, second)]
    names = dict.fromkeys((*a.names, *b.names))
    if len(names) == len(a.names) + len(b.names):
        raise ValueError(f"{first} and {second} have no coefficient in common")
    rows = tuple(_row(name, *columns) for name in names)
    return ReportComparison((str(first), str(second)), a, b, rows)


def _values(report: Report, path: str | Path) -> dict[str, dict[str, Any]]:
    """Return by coefficient its value, uncertainty, unit and expression."""
    k, determined = np.asarray(report.k), np.asarray(report.fit.determined)
    try:
        systematic = getattr(report, "systematic", None)
        # Two recordings of an arm share the scale of its torques, its clock and its zeros.
        own = None if systematic is None else systematic.without_causes(TOLERATED)
        uncertainty = np.where(determined, standard_uncertainty(report.fit, own), np.inf)
    except ValueError as error:
        raise ValueError(f"{path}: {error}") from None
    return {
        coefficient.name: {
            "value": float(k[i]),
            "uncertainty": float(uncertainty[i]),
            "fixed": coefficient.name in report.fixed_names,
            "unit": coefficient.unit,
            "expression": coefficient.expression or None,
        }
        for i, coefficient in enumerate(report.model.coefficients)
    }


def _row(
    name: str, first: Mapping[str, Mapping[str, Any]], second: Mapping[str, Mapping[str, Any]]
) -> dict[str, Any]:
    a, b = first.get(name), second.get(name)
    some = a or b or {}
    row: dict[str, Any] = {
        "name": name,
        "unit": some["unit"],
        "first": None if a is None else a["value"],
        "second": None if b is None else b["value"],
        "difference": None,
        "standard_errors": None,
        "note": "",
        "fixed": any(some is not None and some["fixed"] for some in (a, b)),
    }
    if a is None or b is None:
        return row | {"note": f"only in the {'first' if b is None else 'second'}"}
    if None not in (a["expression"], b["expression"]) and a["expression"] != b["expression"]:
        return row | {"note": f"stands for {a['expression']}, and for {b['expression']}"}
    row["difference"] = b["value"] - a["value"]
    if row["fixed"]:  # equal by construction, or as the identification before that it is of
        which = [name for name, some in (("first", a), ("second", b)) if some["fixed"]]
        return row | {"note": f"kept from a previous identification in the {' and '.join(which)}"}
    scale = float(np.hypot(a["uncertainty"], b["uncertainty"]))
    if not np.isfinite(scale):
        return row | {"note": "not determined by both"}
    if scale > 0:
        row["standard_errors"] = row["difference"] / scale
    return row


def _verdict(comparison: ReportComparison) -> tuple[Tone, str, tuple[Message, ...]]:
    sizes = [abs(r["standard_errors"]) for r in comparison.rows if r["standard_errors"] is not None]
    notable = sum(size > _NOTABLE for size in sizes)
    # Standard errors that follow from few independent residuals are uncertain themselves.
    degrees_of_freedom = min(
        float(r.fit.degrees_of_freedom) for r in (comparison.first, comparison.second)
    )
    degrees_of_freedom, count = max(degrees_of_freedom, 1.0), max(len(sizes), 1)
    chance = 2.0 * float(scipy.special.stdtr(degrees_of_freedom, -_NOTABLE))
    # What one comparison in a hundred of equal arms exceeds, if coefficients' errors were
    # independent: how many differ, and by how much the most different does.
    most = float(scipy.stats.binom.isf(_CHANCE, count, chance))
    largest = float(scipy.special.stdtrit(degrees_of_freedom, 1.0 - 0.5 * _CHANCE / count))
    messages = [
        Message(
            f"{notable} of {len(sizes)} coefficients differ by more than {_NOTABLE:g} standard"
            f" errors; {chance * len(sizes):.2g} would by chance.",
            "caution" if notable > most else "good",
        )
    ]
    worst = max(comparison.rows, key=_size)
    agree = bool(sizes) and notable <= most and _size(worst) <= largest
    if _size(worst) > _NOTABLE:
        messages.append(
            Message(
                f"Most different: {worst['name']}, by {worst['standard_errors']:.3g} standard"
                f" errors; of {len(sizes)}, chance rarely brings about more than {largest:.3g}.",
                "caution" if _size(worst) > largest else "plain",
            )
        )
    kept = sum(row["fixed"] for row in comparison.rows)
    if kept:
        messages.append(
            Message(
                f"{kept} coefficients were not tested: they were not fitted, but kept from a"
                " previous identification.",
                "plain",
            )
        )
    apart = sum(bool(row["note"]) and not row["fixed"] for row in comparison.rows)
    if apart:
        things = "coefficient" if apart == 1 else "coefficients"
        messages.append(Message(f"{apart} {things} cannot be compared.", "caution"))
    robots = comparison.first.model.name, comparison.second.model.name
    if robots[0] != robots[1]:
        messages.append(Message(f"Of different robots: {robots[0]} and {robots[1]}.", "caution"))
    headline = (
        "The coefficients agree within their uncertainty."
        if agree
        else "The coefficients differ by more than their uncertainty."
    )
    return "good" if agree and not apart else "caution", headline, tuple(messages)


def _coefficient_section(comparison: ReportComparison) -> Section:
    columns = (
        Column("name", numeric=False),
        Column("first"),
        Column("second"),
        Column("difference", "second less first"),
        Column("standard errors", "difference over the uncertainty of both together", digits=3),
        Column("unit", numeric=False),
        Column("note", numeric=False, wide=True),
    )
    ordered = sorted(comparison.rows, key=_size, reverse=True)
    names = ("name", *_SHOWN, "unit", "note")
    rows = tuple(tuple(row[name] for name in names) for row in ordered)
    return Section(
        "Coefficients",
        "The most different first. A difference is in standard errors of"
        " both together, systematic errors included. For one coefficient, more than 2 is unlikely"
        " by chance; of forty, two are expected.",
        [Table(columns, rows, name="coefficients-table")],
    )


def _compared_sections(comparison: ReportComparison) -> Iterator[Section]:
    """Yield how sections differ, in the order of the page."""
    for kind in sorted(Report.kinds, key=lambda kind: kind.position):
        sections = (report.section(kind.name) for report in (comparison.first, comparison.second))
        data = ({} if section is None else section.data for section in sections)
        if (section := kind.compared(*data)) is not None:
            yield section


def _size(row: Mapping[str, Any]) -> float:
    return -1.0 if row["standard_errors"] is None else abs(row["standard_errors"])


def _number(value: float | None) -> str:
    return "" if value is None else f"{value:.4g}"
