"""Tables and pictures of the rows of `control_study.py`. Not a program of its own."""

from collections.abc import Sequence
from pathlib import Path
from typing import Any

import numpy as np

from jaxcslc.identification import text_table
from jaxcslc.plotting import save_picture
from scripts.studies.control.pictures import (
    control_error_picture,
    joint_error_picture,
    traced_path_picture,
)


Rows = list[dict[str, Any]]

HAND = "hand rms [mm]"
WORDS = ("motion", "duration", "controller", "coefficients")
# What errors with CSLC coefficients are divided by: another controller or other coefficients.
OTHERS = {
    "Ar+LS": ("computed torque", "Ar+LS"),
    "Ar+Rg": ("computed torque", "Ar+Rg"),
    "truth": ("computed torque", "truth"),
    "30 % wrong": ("computed torque", "30 % wrong"),
    "PID": ("PID", "none"),
    "PID, thesis": ("PID, thesis", "none"),
    "PID + gravity (CSLC)": ("PID + gravity", "CSLC"),
}
SHOWN = ("PID, thesis", "Ar+LS", "truth")  # beside CSLC, in pictures of one machine
MAGNIFIED = 20.0


def chosen(rows: Rows, *words: Any) -> dict[int, dict[str, Any]]:
    """The rows of a motion, its duration, a controller and coefficients, by seed."""
    return {
        row["seed"]: row
        for row in rows
        if "failed" not in row and tuple(row[key] for key in WORDS) == words
    }


def motions_of(rows: Rows) -> list[tuple[str, float]]:
    """Motions with their durations, slow ones first."""
    found = {(row["motion"], row["duration"]) for row in rows}
    return sorted(found, key=lambda each: (each[0] == "circle", -each[1]))


def spread(values: Sequence[float]) -> dict[str, float]:
    low, middle, high = np.quantile(np.asarray(values), [0.05, 0.5, 0.95])
    return {"median": float(middle), "5 %": float(low), "95 %": float(high)}


def summary_rows(rows: Rows) -> Rows:
    """Medians over seeds of every figure, and the spread of the flange's."""
    cases = dict.fromkeys(tuple(row[key] for key in WORDS) for row in rows)
    out: Rows = []
    for words in cases:
        own = list(chosen(rows, *words).values())
        if not own:
            continue
        tried = sum(tuple(row[key] for key in WORDS) == words for row in rows)
        ends = spread([row[HAND] for row in own])
        others = [key for key in own[0] if key not in (*WORDS, "seed", "trace", HAND)]
        out.append(
            {
                **dict(zip(WORDS, words, strict=True)),
                "seeds": len(own),
                "failed": tried - len(own),
                **{f"hand rms, {key} [mm]": value for key, value in ends.items()},
                **{key: float(np.median([row[key] for row in own])) for key in others},
            }
        )
    return out


def ratio_rows(rows: Rows) -> Rows:
    """Flange error with CSLC over that with others, seed by seed."""
    out: Rows = []
    for over, other in OTHERS.items():
        together: list[float] = []
        for motion, duration in motions_of(rows):
            above = chosen(rows, motion, duration, "computed torque", "CSLC")
            below = chosen(rows, motion, duration, *other)
            ratios = [
                above[seed][HAND] / below[seed][HAND]
                for seed in sorted(above.keys() & below.keys())
            ]
            together += ratios
            if ratios:
                words = {"CSLC over": over, "motion": motion, "duration": f"{duration:g} s"}
                out.append({**words, "seeds": len(ratios), **spread(ratios)})
        if together:
            words = {"CSLC over": over, "motion": "all", "duration": "all"}
            out.append({**words, "seeds": len(together), **spread(together)})
    return out


def table(rows: Rows, columns: Sequence[str]) -> str:
    def cell(value: Any) -> str:
        return f"{value:.3g}" if isinstance(value, float) else str(value)

    left = [name for name in columns if isinstance(rows[0][name], str)]
    return text_table(columns, [[cell(row[name]) for name in columns] for row in rows], left=left)


def draw(
    rows: Rows,
    folder: Path,
    controllers: Sequence[str],
    sets: Sequence[str],
    centre: Sequence[float],
    normal: Sequence[float],
) -> None:
    """The pictures that the rows suffice for."""
    panels: dict[str, dict[str, dict[str, np.ndarray]]] = {}
    for motion, duration in motions_of(rows):
        panel = panels.setdefault(f"{motion}, {duration:g} s", {})
        for controller in controllers:
            for name in ("none", *sets):
                own = chosen(rows, motion, duration, controller, name)
                if own:
                    errors = np.array([row[HAND] for row in own.values()])
                    panel.setdefault(controller, {})[name] = errors
    durations = sorted({row["duration"] for row in rows})
    picture = control_error_picture(
        panels, columns=len(durations), quantity="error of the flange, rms [mm]"
    )
    save_picture(picture, folder / "hand_errors.png")
    middle = durations[len(durations) // 2]
    traces = traces_of(rows, "circle", middle)
    if traces:
        across = np.cross([0.0, 0.0, 1.0], normal)
        plane = np.stack([across, np.cross(normal, across)])
        plane /= np.linalg.norm(plane, axis=1, keepdims=True)
        asked = 1e3 * (next(iter(traces.values()))["asked"] - np.array(centre))
        picture = traced_path_picture(
            asked @ plane.T,
            {name: trace["off"] @ plane.T for name, trace in traces.items()},
            magnified=MAGNIFIED,
            title=f"The circle in {middle:g} s, as the flange draws it",
        )
        save_picture(picture, folder / "circle.png")
    traces = traces_of(rows, "go-to", durations[0])
    if traces:
        picture = joint_error_picture(
            next(iter(traces.values()))["time"],
            {name: trace["joint"] for name, trace in traces.items()},
            title=f"A go-to in {durations[0]:g} s",
        )
        save_picture(picture, folder / "joint_errors.png")


def traces_of(rows: Rows, motion: str, duration: float) -> dict[str, dict[str, np.ndarray]]:
    """What the first machine did under some of the controllers."""
    found: dict[str, dict[str, np.ndarray]] = {}
    shown = {name: OTHERS[name] for name in SHOWN} | {"CSLC": ("computed torque", "CSLC")}
    for label, words in shown.items():
        row = chosen(rows, motion, duration, *words).get(0)
        if row is not None:
            found[label] = {key: np.array(values) for key, values in row["trace"].items()}
    return found
