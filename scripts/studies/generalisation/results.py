"""Rows, table and picture of the generalisation study."""

from collections.abc import Mapping, Sequence
from typing import Any

import numpy as np
from matplotlib.figure import Figure

from scripts.studies.generalisation.pictures import generalisation_picture


CSLC, MEAN = "CSLC", "mean torque"


def row_of(
    name: str,
    family: str,
    inputs: int,
    weights: Sequence[int],
    order: Sequence[int | None],
    stopped: Mapping[str, Sequence[float]],
    last: Mapping[str, Sequence[float]],
) -> dict[str, Any]:
    """A row of the table; what differs between seeds is a list over them."""
    return {
        "network": name,
        "family": family,
        "inputs": inputs,
        "weights": list(weights),
        "order": list(order),
        **stopped,
        "not stopped": last["comparison"],
        "training, not stopped": last["training"],
    }


def summary(rows: Sequence[Mapping[str, Any]]) -> list[dict[str, Any]]:
    """Medians and quartiles over seeds; ratios to the CSLC's error of the same seed."""
    reference = next(row for row in rows if row["network"] == CSLC)
    document: list[dict[str, Any]] = []
    for row in rows:
        ratio = np.array(row["comparison"]) / np.array(reference["comparison"])
        entry: dict[str, Any] = {"network": row["network"], "inputs": row["inputs"]}
        for name in ("weights", "order"):
            entry[name] = "" if None in row[name] else float(np.median(row[name]))
        columns = {
            "training ε [N m]": row["training"],
            "stop set ε [N m]": row["stop"],
            "comparison ε [N m]": row["comparison"],
            "comparison ε in range [N m]": row["in_range"],
            "comparison ε not stopped [N m]": row["not stopped"],
            "training ε not stopped [N m]": row["training, not stopped"],
            "comparison ε over the CSLC's": ratio,
        }
        for name, values in columns.items():
            quartiles = np.quantile(values, [0.5, 0.25, 0.75]).tolist()
            ends = ("", ", lower quartile", ", upper quartile")
            entry |= {f"{name}{end}": value for end, value in zip(ends, quartiles, strict=True)}
        document.append(entry)
    return document


def table(document: Sequence[Mapping[str, Any]]) -> list[list[str]]:
    """The printed table, the head first: medians, some with quartiles."""

    def spread(entry: Mapping[str, Any], name: str) -> str:
        low, high = (entry[f"{name}, {end} quartile"] for end in ("lower", "upper"))
        return f"{entry[name]:.3g} ({low:.3g} to {high:.3g})"

    cells = [
        [
            entry["network"],
            *("-" if entry[name] == "" else f"{entry[name]:.0f}" for name in ("weights", "order")),
            f"{entry['training ε [N m]']:.3g}",
            f"{entry['stop set ε [N m]']:.3g}",
            spread(entry, "comparison ε [N m]"),
            "-" if np.isnan(inside := entry["comparison ε in range [N m]"]) else f"{inside:.3g}",
            f"{entry['training ε not stopped [N m]']:.3g}",
            f"{entry['comparison ε not stopped [N m]']:.3g}",
            spread(entry, "comparison ε over the CSLC's"),
        ]
        for entry in document
    ]
    header = ["", "weights", "order", "training", "stop set", "comparison", "in range"]
    header += ["training, not stopped", "comparison, not stopped", "over the CSLC's"]
    return [header, *cells]


def picture(rows: Sequence[Mapping[str, Any]], seeds: int) -> Figure:
    """Errors by number of weights, families apart."""

    def family_of(name: str) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
        members = [row for row in rows if row["family"] == name]
        weights = np.array([float(np.median(row["weights"])) for row in members])
        training, comparison = (
            np.array([row[part] for row in members]) for part in ("training", "comparison")
        )
        return weights, training, comparison

    names = [
        name for name in dict.fromkeys(row["family"] for row in rows) if name not in (CSLC, MEAN)
    ]
    return generalisation_picture(
        {name: family_of(name) for name in names},
        {CSLC: family_of(CSLC), MEAN: family_of(MEAN)},
        title=f"PUMA 560: trained on one recording, judged on another ({seeds} seeds)",
    )
