import math
from collections.abc import Mapping
from typing import Any

from ....page import Column, Section, Table


def friction_trials_section(data: Mapping[str, Any]) -> Section:
    """Friction terms that were tried, and what each was worth.

    - `data`: of the report, with an entry `"friction_trials"`.
    """
    columns = (
        Column(data["kind"], numeric=False),
        Column("friction", numeric=False),
        Column("change of held-out error [%]", digits=2),
        Column("standard error [%]", digits=2),
        Column("length", "of pre-sliding", digits=3),
        Column("unit", numeric=False),
        Column("", numeric=False, tones={"used": "good"}),
    )
    rows = tuple(_row(trial, data["joints"]) for trial in data["friction_trials"])
    return Section(
        "Friction terms tried",
        "Errors on stretches of the training recording that were left out of the fit, with a term"
        " over those without it; of pre-sliding over all samples, of other terms over those that"
        " masks leave in. Terms are used where they gain more than chance explains.",
        [Table(columns, rows, "joint by joint, in the order of the trials", "friction-trials")],
    )


def _row(trial: Mapping[str, Any], joints: list[str]) -> tuple[str | float | None, ...]:
    joint, kind = joints[trial["joint"] - 1], trial["kind"]
    if not trial["possible"]:
        return joint, kind, None, None, None, "", "dropped by the fit"
    spread = 100 * trial["change_error"]
    return (
        joint,
        kind,
        100 * math.expm1(trial["change"]),
        spread if math.isfinite(spread) else None,
        trial["length"],
        "" if trial["length"] is None else trial["length_unit"],
        "used" if trial["used"] else "",
    )
