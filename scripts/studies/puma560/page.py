"""Pages of the demo: the front page, and all tables and figures of the experiment by topic."""

import math
from collections.abc import Mapping, Sequence
from typing import Any

import numpy as np

from jaxcslc.report import (
    AbstractBlock,
    Column,
    Details,
    Link,
    Message,
    Messages,
    Page,
    Paragraph,
    Picture,
    Section,
    Table,
    Tone,
    render,
)
from scripts.studies.puma560.machines import CHOSEN, TRAINED
from scripts.studies.puma560.own_arm import OwnArm, own_arm_sections


Rows = list[dict[str, Any]]

# Sections: title, explanation, tables (all whose names begin so) and figures.
_TOPICS: tuple[tuple[str, str, tuple[str, ...], tuple[str, ...]], ...] = (
    (
        "Torque errors",
        "Predicted against measured torque of the comparison trajectory, to which nothing was"
        " fitted (Figs. 7.6-1 to 7.6-4). Mean |e1|: mean modulus of joint 1's error. ε: half the"
        " root mean square of the joints' errors in one sample, averaged over samples, without the"
        " beginning and the end of the trajectory, with the torque of the sample before (7.4)."
        " CSLC trained: the network trained on the training trajectory by backpropagation and"
        " PERAL. CSLC solved: the direct solve of the same patterns. CSLC: the direct solve with"
        " the settings that jaxcslc identify chooses. Ar+LS: links as Armstrong et al. measured"
        " them on another arm, with the friction of Leahy and Saridis. Ar+Rg: the same links,"
        " friction regressed from this arm's training trajectory. True: the coefficients of the"
        " simulated arm itself.",
        ("errors", "hand"),
        ("7.6-1", "7.6-2"),
    ),
    (
        "Coefficients",
        "Identified values with their 95 % intervals, beside the true ones, those that Ar+LS has,"
        " and the thesis's of its real arms (Figs. B.1 to B.5). Expressions, verdicts' reasons and"
        " sensitivities are in the CSV files.",
        ("intervals", "coefficients", "one_design"),
        (),
    ),
    (
        "Networks trained as in 7.5",
        "Every seed has recordings of its own. Their networks are trained side by side from zero"
        " weights: by backpropagation, and by backpropagation and PERAL in turns from ε of Ar+LS"
        " on. Slow pairs of joint and sample are left out. Training ends when a round of bouts"
        " lowers half the summed squared errors by less than 3e-5 (N m)² per epoch. The other"
        " tables are the training of 7.5 to the letter. It leaves out pairs in possible backlash"
        " as well, slow pairs in the friction subnetworks only, and ends where an epoch lowers ε by"
        " less than 0.001 N m.",
        ("training", "letter"),
        ("7.5",),
    ),
    (
        "Static friction and backlash",
        "From which speed static friction may be neglected, what other thresholds cost, and how"
        " well Eqn. 2.5-7 tells samples within backlash.",
        ("threshold", "backlash"),
        ("7.6-4", "2.5-1", "2.5-3"),
    ),
    (
        "Motors",
        "Do the motors deliver what is demanded (7.2.3)? All demands stay within the range that"
        " was seen to be linear; one table says what it costs if they do not.",
        ("demands", "peaks", "weak"),
        ("7.2-1", "7.2-2", "7.2-2b", "7.4-1"),
    ),
    (
        "Motion and its smoothing",
        "Training motion, and how velocities and accelerations come out of encoder counts.",
        (),
        ("7.3-1", "7.3-2", "7.4-2"),
    ),
)
# Columns of tables of coefficients that fit a laptop, by the name of the rows' entry.
_COEFFICIENTS = ("name", "value", "low", "high", "true", "trained", "Ar+LS", "thesis", "unit")
_SHORT = 20  # rows of a table; longer ones open on a click
_VERDICTS: dict[str, Tone] = {
    "well determined": "good",
    "well determined up to scale": "good",
    "poorly determined": "caution",
    "systematic error": "caution",
    "wrong sign": "bad",
    "not determined": "bad",
    "indistinguishable from zero": "plain",
}


# Models of the front page: column of the table of errors, name, and what it means.
MODELS = (
    ("Ar+LS", "published", "Links that Armstrong et al. measured on another PUMA 560, with friction"
     " of Leahy and Saridis (Ar+LS). This is what you have without identification."),
    ("Ar+Rg", "published, friction fitted", "The same links, with friction fitted to this arm's"
     " recording (Ar+Rg)."),
    (CHOSEN, "identified", "All coefficients by least squares from the recording, with the settings"
     " that jaxcslc identify chooses (CSLC)."),
    (TRAINED, "trained network", "The same coefficients, learnt as weights of a network as in the"
     " thesis, by gradient descent and by its own rule, PERAL."),
    ("true", "true", "The coefficients of the simulated arm. The error that remains is due to what"
     " the model does not have: backlash, static friction, encoder ticks."),
)  # fmt: skip
EXPERIMENT = "experiment.html"  # the page with all tables and figures


def front_page(
    arm: OwnArm, tables: Mapping[str, tuple[str, Rows]], captions: Mapping[str, str]
) -> str:
    """The first page: an arm identified from its files, then what the experiment found.

    **Arguments**

    - `arm`: that was identified.
    - `tables`: captions and rows, by the name of the CSV file.
    - `captions`: of the figures, by number.
    """
    tone, headline, _ = _verdict(tables)
    tool = arm.report.page()
    lines = [*tool.summary, *(Message(f"{x[0].upper()}{x[1:]}.", "good") for x in arm.sentences)]
    names = {column: name for column, name, _ in MODELS}
    machines = ("PUMA A", "PUMA B", "thesis, PUMA A", "thesis, PUMA B")
    columns = [Column("coefficients", numeric=False)]
    columns += [Column(machine, decimals=3) for machine in machines]
    errors = [{row[""]: row for row in tables[f"errors_{letter}"][1]} for letter in "ab"]
    shown = [name for name in names if name in errors[0]["mean ε"]]
    rows = tuple(
        (
            names[model],
            *(
                _value(table[row][model])
                for row in ("mean ε", "mean ε, thesis")
                for table in errors
            ),
        )
        for model in shown
    )
    terms = tuple((name, text) for model, name, text in MODELS if model in shown)
    meaning = (
        Column("coefficients", numeric=False),
        Column("meaning", numeric=False, wide=True, longest=400),
    )
    experiment = Section(
        "The experiment of the thesis",
        "The model is that of a doctoral thesis, the context-sensitive linear combiner (CSLC). Its"
        " Chapter 7 identifies two PUMA 560 arms from a recording of their motion each, and judges"
        " the coefficients on another motion, the comparison trajectory. This run repeats it on two"
        " simulated arms, PUMA A and PUMA B. Their true coefficients are known, and they have the"
        " disturbances of real arms: encoder ticks, static friction, backlash, elastic gears.",
        [
            Messages((Message(headline, tone),)),
            Table(
                tuple(columns),
                rows,
                "Error cost ε on the comparison trajectory [N m]: half the root mean square of the"
                " joints' torque errors, averaged over samples. The thesis's arms were real.",
                "epsilon",
            ),
            Table(meaning, terms, "What the coefficients are", "terms"),
            *_figures({"7.6-1": captions["7.6-1"]}, ["7.6-1"]),
            Link(EXPERIMENT, "All tables and figures of the experiment"),
        ],
    )
    tones: tuple[Tone, ...] = ("bad", "caution", "good", "plain")
    worst = tones[min(tones.index(tone), tones.index(tool.tone))]
    page = Page(
        title="Identification of robot arms with jaxcslc",
        subtitle="An arm from its files, and the experiment of the thesis on two simulated arms",
        headline=tool.headline,
        tone=worst,
        summary=(
            *lines,
            Message(f"The experiment of the thesis: {headline[0].lower()}{headline[1:]}", tone),
        ),
        sections=(*own_arm_sections(arm), experiment),
    )
    return render(page)


def experiment_page(
    tables: Mapping[str, tuple[str, Rows]], captions: Mapping[str, str], notes: Sequence[str]
) -> str:
    """One page with every table and figure, in sections by topic.

    **Arguments**

    - `tables`: captions and rows, by the name of the CSV file.
    - `captions`: of the figures, by number.
    - `notes`: about the machines: settings, condition, agreement.
    """
    sections: list[Section] = []
    shown: set[str] = set()
    for title, lead, prefixes, figures in _TOPICS:
        names = [name for prefix in prefixes for name in tables if name.startswith(prefix)]
        numbers = [number for number in figures if number in captions]
        shown |= {*names, *numbers}
        blocks = _tables(tables, names) + _figures(captions, numbers)
        if blocks:
            sections.append(Section(title, lead, blocks))
    others = _tables(tables, [name for name in tables if name not in shown])
    others += _figures(captions, [number for number in captions if number not in shown])
    if others:
        sections.append(Section("More", "", others))
    sections.append(
        Section(
            "Machines and settings",
            "Settings of the fits, selected by cross-validation within the training recording;"
            " conditions, signs, and the combination of coefficients that each recording determines"
            " least.",
            [Paragraph(note) for note in notes],
        )
    )
    tone, headline, messages = _verdict(tables)
    page = Page(
        title="The identification experiment on two simulated PUMA 560s",
        subtitle="Chapter 7 of the thesis, on machines with every disturbance of its Section 7.2",
        headline=headline,
        tone=tone,
        summary=messages,
        sections=tuple(sections),
    )
    return render(page)


def _verdict(tables: Mapping[str, tuple[str, Rows]]) -> tuple[Tone, str, tuple[Message, ...]]:
    """Return whether identification beats direct measurement on both machines, in words."""
    messages: list[Message] = []
    better: list[bool] = []
    for name, (_, rows) in tables.items():
        row = next((row for row in rows if row.get("") == "mean ε"), None)
        if not name.startswith("errors") or row is None:
            continue
        measured = min(row["Ar+LS"], row["Ar+Rg"])
        identified = row.get(TRAINED, row[CHOSEN])
        better.append(identified < measured)
        messages.append(
            Message(
                f"PUMA {name.removeprefix('errors_').upper()}: mean torque error ε"
                f" {identified:.3g} N m with {'trained' if TRAINED in row else 'identified'}"
                f" coefficients, {row['Ar+LS']:.3g} with"
                f" measured ones (Ar+LS), {row['Ar+Rg']:.3g} with measured links and regressed"
                f" friction (Ar+Rg), {row['true']:.3g} with the true ones.",
                "good" if better[-1] else "caution",
            )
        )
    if all(better):
        return (
            "good",
            "Identified coefficients predict torques better than published ones, on both machines.",
            tuple(messages),
        )
    return (
        "caution",
        "Identified coefficients do not predict torques better than published ones everywhere.",
        tuple(messages),
    )


def _tables(tables: Mapping[str, tuple[str, Rows]], names: Sequence[str]) -> list[AbstractBlock]:
    blocks: list[AbstractBlock] = []
    for name in names:
        caption, rows = tables[name]
        long = len(rows) > _SHORT
        table = _table(name, "" if long else caption, rows)
        file = Link(f"{name}.csv")
        blocks += [Details(caption, (table, file))] if long else [table, file]
    return blocks


def _table(name: str, caption: str, rows: Rows) -> Table:
    names = list(rows[0])
    if name.startswith("coefficients"):
        names = [column for column in (*_COEFFICIENTS, "verdict") if column in names]
    columns = tuple(_column(column, [row.get(column) for row in rows]) for column in names)
    body = tuple(tuple(_value(row.get(column)) for column in names) for row in rows)
    return Table(columns, body, caption, name)


def _column(name: str, values: Sequence[Any]) -> Column:
    text = any(isinstance(value, str | bool | np.bool_) for value in values)
    tones = _VERDICTS if name == "verdict" else {}
    wide = text and name not in ("", "name", "unit", "verdict")
    return Column(name.replace("_", " ") or "quantity", numeric=not text, tones=tones, wide=wide)


def _value(value: Any) -> Any:
    value = value.item() if isinstance(value, np.generic) else value
    if isinstance(value, bool):
        return "yes" if value else "no"
    return None if isinstance(value, float) and math.isnan(value) else value


def _figures(captions: Mapping[str, str], numbers: Sequence[str]) -> list[AbstractBlock]:
    return [
        Picture(f"figure_{number}.png", f"Fig. {number}. {captions[number]}") for number in numbers
    ]
