import json
from collections.abc import Mapping
from typing import Any

from ....page import (
    AbstractBlock,
    Code,
    Column,
    Curve,
    Details,
    Grid,
    MatrixChart,
    Message,
    Messages,
    Page,
    Panel,
    PanelChart,
    Paragraph,
    Section,
    Table,
)
from ._bodies_section import bodies_section
from ._estimators import estimators_section
from ._friction_trials import friction_trials_section
from ._horizon import horizon_section
from ._summary import VERDICT_TONES, counted, summary


# Trials that are shown before the others are asked for.
_FIRST_TRIALS = 10
# Coefficients whose correlations can be read from a picture.
_MOST_LABELS = 120


def report_page(data: Mapping[str, Any], *, charts: bool = True) -> Page:
    """The page of a report.

    **Arguments**

    - `data`: of the report, from `report_data`.
    - `charts`: whether it has drawings.

    **Returns** a `Page` for `jaxcslc.page.render`.
    """
    tone, headline, messages = summary(data)
    sections = (
        _data_check(data),
        _errors(data),
        *([_curves(data)] if charts else []),
        *([estimators_section(data)] if data["estimators"] else []),
        *([horizon_section(data)] if data["horizon"] else []),
        _coefficients(data),
        _excitation(data, charts=charts),
        *([_friction(data)] if charts and data["friction"] else []),
        *([friction_trials_section(data)] if data["friction_trials"] else []),
        *([bodies_section(data, charts=charts)] if data["bodies"] else []),
        _settings(data),
        _repeat(data),
    )
    return Page(
        title=f"Identification of {data['name']}",
        subtitle=f"{counted(len(data['joints']), data['kind'])},"
        f" {counted(len(data['coefficients']), 'coefficient')}",
        headline=headline,
        tone=tone,
        summary=messages,
        sections=sections,
    )


def _data_check(data: Mapping[str, Any]) -> Section:
    sentences = [*data["findings"], *data["warnings"]]
    blocks: list[AbstractBlock] = [
        Messages(
            tuple(Message(sentence) for sentence in sentences),
            empty="Nothing looks wrong.",
        )
    ]
    if data["notes"]:
        blocks.append(Messages(tuple(Message(note, "plain") for note in data["notes"])))
    motion = dict.fromkeys("m" if unit == "N" else "rad" for unit in data["units"])
    length = " or ".join(motion)
    for name, recording in data["recordings"].items():
        rate = "" if not recording["interval"] else f", {1 / recording['interval']:.4g} Hz"
        caption = (
            f"{name} recording: {recording['samples']} samples, {recording['duration']:.4g} s{rate}"
        )
        columns = [
            Column(data["kind"], numeric=False),
            Column("fitted [%]", "samples that masks leave in", digits=3),
        ]
        values: list[list[Any]] = [[100 * share for share in recording["share_judged"]]]
        if recording["lowest"] is not None:
            columns += [
                Column(f"lowest position [{length}]", decimals=3),
                Column("highest", decimals=3),
                Column("top speed [per s]", decimals=3),
            ]
            values += [recording["lowest"], recording["highest"], recording["top_speed"]]
        columns.append(Column(f"RMS {data['quantity']}"))
        values.append(recording["quality"]["all"]["torque_rms"])
        columns.append(Column("unit", numeric=False))
        values.append(data["units"])
        blocks.append(Table.of_columns(columns, [data["joints"], *values], caption, f"data-{name}"))
    if data["several"] is not None:
        blocks.append(_several(data))
    return Section(
        "Data check",
        "What the recordings hold after smoothing, and what looks wrong with them or the fit."
        " Samples near standstill and possibly within backlash are masked: they are not fitted.",
        blocks,
    )


def _several(data: Mapping[str, Any]) -> Table:
    """The training recordings one by one, and whether they agree."""
    columns = [
        Column("recording", numeric=False),
        Column("samples"),
        Column("differs in", "coefficients, beyond chance", numeric=False, wide=True),
        *(
            Column(f"RMS residual, {_axis(joint, unit)}", digits=3)
            for joint, unit in zip(data["joints"], data["units"], strict=True)
        ),
    ]
    recordings = data["several"]
    rows = tuple(
        (name, entry["samples"], ", ".join(entry["differing"]) or "none", *entry["noise"])
        for name, entry in recordings.items()
    )
    caption = "Training recordings, each against all others together"
    return Table(tuple(columns), rows, caption, "several")


def _errors(data: Mapping[str, Any]) -> Section:
    quantity, held_out = data["quantity"], data["held_out"]
    columns = [
        Column(data["kind"], numeric=False),
        Column("RMS, judged", f"root mean square of measured less predicted {quantity}"),
        Column("RMS, all"),
        Column("unit", numeric=False),
        Column("judged [%]", f"RMS error in % of the RMS {quantity} of the same samples", digits=3),
        Column("all [%]", digits=3),
        Column("R², judged", "share of the variance that the model explains", decimals=4),
        Column("R², all", decimals=4),
    ]
    blocks: list[AbstractBlock] = []
    for name, recording in data["recordings"].items():
        judged, everything = (recording["quality"][samples] for samples in ("judged", "all"))
        values = [
            data["joints"],
            *(judged["rms"], everything["rms"], data["units"]),
            *(judged["percent"], everything["percent"]),
            *(judged["r_squared"], everything["r_squared"]),
        ]
        blocks.append(Table.of_columns(columns, values, f"{name} recording", f"errors-{name}"))
    if held_out is not None:
        held_out_columns = [
            Column(data["kind"], numeric=False),
            *(Column("RMS, fitted"), Column("RMS, held out"), Column("unit", numeric=False)),
            Column("ratio", digits=3),
            Column("limit", "largest ratio that noise explains", digits=3),
        ]
        values = [
            data["joints"],
            *(held_out["training_rms"], held_out["held_out_rms"], data["units"]),
            *(held_out["ratio"], held_out["limit"]),
        ]
        caption = f"motion that was not fitted ({held_out['source']})"
        blocks.append(Table.of_columns(held_out_columns, values, caption, "held-out"))
    return Section(
        "Errors",
        f"Measured less predicted {quantity}, as root mean square (RMS), in % of the RMS"
        f" {quantity}, and as R², the share of the {quantity}'s variance that the model explains."
        " Judged samples are those that masks leave in; the others are at a standstill or may be"
        " within backlash, where the model does not hold.",
        blocks,
    )


def _curves(data: Mapping[str, Any]) -> Section:
    quantity = data["quantity"]
    blocks: list[AbstractBlock] = []
    for name, recording in data["recordings"].items():
        panels: list[Panel] = []
        rows = zip(data["joints"], data["units"], recording["curves"], strict=True)
        for joint, unit, curves in rows:
            measured, predicted, residual = (
                Curve(look, curves[look]["x"], curves[look]["y"], look)
                for look in ("measured", "predicted", "residual")
            )
            masked = tuple((start, end) for start, end in curves["masked"])
            panels.append(Panel(_axis(joint, unit), (measured, predicted), masked, 150))
            limits = curves["residual_range"]
            panels.append(Panel(_axis("residual", unit), (residual,), masked, 60, limits))
        caption = f"{name} recording: measured and predicted {quantity}, and their difference"
        blocks.append(PanelChart(tuple(panels), "time [s]", caption))
    return Section(
        f"Measured and predicted {quantity}",
        "Masked samples are shaded; the axes of residuals are those of the fitted samples. Long"
        " recordings are drawn by their extremes.",
        blocks,
    )


def _coefficients(data: Mapping[str, Any]) -> Section:
    rows = data["coefficients"]
    names = [
        (Column("name", numeric=False), "name"),
        (Column("value"), "value"),
        (Column("low"), "low"),
        (Column("high"), "high"),
        (Column("unit", numeric=False), "unit"),
        (Column("verdict", numeric=False, tones=VERDICT_TONES), "verdict"),
        (Column("reason", numeric=False, wide=True), "reason"),
        (Column("expression", numeric=False, wide=True), "expression"),
    ]
    table = Table(
        tuple(column for column, _ in names),
        tuple(tuple(row[name] for _, name in names) for row in rows),
        name="coefficients-table",
    )
    undetermined = tuple(Message(text, "bad") for text in data["unidentifiable"])
    legend = [] if data["legend"] is None else [Paragraph(data["legend"] + ".")]
    return Section(
        "Coefficients",
        "Low and high are the ends of 95 % intervals, for"
        f" {data['errors_of_fit']} errors with {data['degrees_of_freedom']:.0f} degrees of freedom."
        " Well determined: standard error at most a tenth of the value; systematic error: more data"
        " of this motion would not help, another model or smoothing would.",
        [*([Messages(undetermined)] if undetermined else []), *legend, table],
    )


def _excitation(data: Mapping[str, Any], *, charts: bool) -> Section:
    excitation = data["excitation"]
    blocks: list[AbstractBlock] = []
    tables: list[AbstractBlock] = []
    if excitation is not None:
        blocks.append(Paragraph(f"Least determined: {excitation['least_determined']}"))
        columns = [Column("coefficients", numeric=False), Column("condition")]
        groups = excitation["groups"]
        values = [[row["coefficients"] for row in groups], [row["condition"] for row in groups]]
        tables.append(Table.of_columns(columns, values, "Condition number", "excitation-table"))
    columns = [
        Column("coefficient", numeric=False),
        Column("and", numeric=False),
        Column("correlation", digits=3),
    ]
    pairs = data["correlated"]
    if pairs:
        values = [[pair[name] for pair in pairs] for name in ("first", "second", "correlation")]
        tables.append(
            Table.of_columns(columns, values, "Most correlated coefficients", "correlated")
        )
    else:
        tables.append(Paragraph("No two coefficients are correlated by more than 0.9."))
    blocks.append(Grid(tuple(tables)))
    if charts and 1 < len(data["coefficients"]) <= _MOST_LABELS:
        labels = tuple(row["name"] for row in data["coefficients"])
        caption = "Correlations of the coefficients' errors"
        blocks.append(MatrixChart(labels, data["correlation"], caption))
    return Section(
        "Excitation and correlations",
        "The condition number says by how much relative noise of the"
        f" {data['quantity']} is amplified in the coefficients: 1 at best, above a hundred the"
        " motion hardly separates some of them. The errors of correlated coefficients compensate"
        " each other: their sum or difference is better known than they are.",
        blocks,
    )


def _friction(data: Mapping[str, Any]) -> Section:
    charts: list[AbstractBlock] = []
    for joint, unit, points in zip(data["joints"], data["units"], data["friction"], strict=True):
        cloud = Curve("measured", points["data"]["x"], points["data"]["y"], "points")
        model = Curve("friction terms", points["model"]["x"], points["model"]["y"], "fitted")
        speed = "velocity [rad/s]" if unit == "N m" else "velocity [m/s]"
        charts.append(PanelChart((Panel(_axis(joint, unit), (cloud, model), (), 210),), speed, ""))
    return Section(
        "Friction",
        "Each joint's friction over its velocity, training recording: the measured torque less what"
        " all other terms predict, and the friction terms at the same samples. A curved cloud"
        " beside a straight line calls for another friction term.",
        [Grid(tuple(charts))],
    )


def _settings(data: Mapping[str, Any]) -> Section:
    blocks: list[AbstractBlock] = [Paragraph(f"Used: {data['settings']}.")]
    if data["judged_part"] is not None:
        blocks.append(Paragraph(f"Long recording: {data['judged_part']}."))
    trials = data["trials"]
    if trials:
        best = trials[0]["score"]
        columns = [
            Column("settings", numeric=False, wide=True, longest=400),
            Column("score", "geometric mean of held-out errors of all joints"),
            Column("to the best", digits=3),
            Column("", numeric=False, tones={"used": "good"}),
        ]
        rows = [
            (
                *(trial["settings"], trial["score"], trial["score"] / best if best else None),
                "used" if trial["selected"] else "",
            )
            for trial in trials
        ]
        first = Table(tuple(columns), tuple(rows[:_FIRST_TRIALS]), "Best trials", "trials")
        blocks.append(first)
        if len(rows) > _FIRST_TRIALS:
            others = Table(tuple(columns), tuple(rows[_FIRST_TRIALS:]), name="other-trials")
            blocks.append(Details(f"{len(rows) - _FIRST_TRIALS} other trials", (others,)))
    else:
        blocks.append(Paragraph("They were set, not selected."))
    return Section(
        "Settings",
        "How recordings were smoothed and masked and coefficients fitted. What was not set was"
        " selected by cross-validation within the training recording: each trial was fitted to all"
        " stretches but one and judged on that one.",
        blocks,
    )


def _repeat(data: Mapping[str, Any]) -> Section:
    blocks: list[AbstractBlock] = []
    if data["command"] is not None:
        blocks.append(Code(data["command"]))
    versions = "\n".join(f"{name} {number}" for name, number in data["versions"].items())
    settings = json.dumps(data["settings_document"], indent=2, ensure_ascii=False, default=str)
    blocks += [Code(versions), Details("Settings, as --settings reads them", (Code(settings),))]
    return Section(
        "To repeat it",
        "The command, if it was one, and the versions of the libraries that computed it."
        " With --settings identification.json the same settings are used again.",
        blocks,
    )


def _axis(name: str, unit: str) -> str:
    return f"{name} [{unit}]" if unit else name
