from collections.abc import Mapping
from typing import Any

from ....page import Column, Section, Table


def horizon_section(data: Mapping[str, Any]) -> Section:
    """Position errors of open-loop simulation, over the time since it started.

    - `data`: of the report, with an entry `"horizon"`.
    """
    horizon = data["horizon"]
    columns = [
        Column("horizon [s]"),
        Column("starts", "simulations that are that long"),
        Column(
            "coefficients",
            "of this report, of its fit with pre-sliding states, or of the robot's file",
            numeric=False,
        ),
        *(
            Column(f"{joint} [{unit}]", digits=3)
            for joint, unit in zip(data["joints"], horizon["units"], strict=True)
        ),
    ]
    if horizon["distance"]:
        columns.append(Column("last frame [m]", "distance of its origin", digits=3))
    rows = tuple(
        (length, horizon["starts"][row], name, *errors[row])
        + ((horizon["distance"][name][row],) if horizon["distance"] else ())
        for row, length in enumerate(horizon["horizons"])
        for name, errors in horizon["error"].items()
    )
    table = Table(tuple(columns), rows, "Median absolute error of positions", "horizon")
    return Section(
        "Prediction over a horizon",
        "The arm simulated without feedback, from recorded states and under recorded torques:"
        " how far its positions are from the recorded ones after some time. An empty cell is a"
        " simulation that diverged.",
        [table],
    )
