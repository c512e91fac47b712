"""Tables and pictures of the control study's rows."""

from collections.abc import Mapping, Sequence
from pathlib import Path
from typing import Any

import numpy as np

from scripts.studies.control.pictures import (
    control_error_picture,
    joint_error_picture,
    traced_path_picture,
)
from scripts.studies.figures import save_picture


Rows = list[dict[str, Any]]

HAND = "hand rms [mm]"
CASE = ("motion", "duration", "controller", "coefficients")
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


def rows_of(rows: Rows, *case: Any) -> dict[int, dict[str, Any]]:
    """The rows of a motion, its duration, a controller and coefficients, by seed."""
    return {
        row["seed"]: row
        for row in rows
        if "failed" not in row and tuple(row[key] for key in CASE) == case
    }


def motions_of(rows: Rows) -> list[tuple[str, float]]:
    """Motions with their durations, slow ones first."""
    motions = {(row["motion"], row["duration"]) for row in rows}
    return sorted(motions, key=lambda motion: (motion[0] == "circle", -motion[1]))


def spread(values: Sequence[float]) -> dict[str, float]:
    """Median, and the 5 and 95 % quantiles."""
    low, middle, high = np.quantile(np.asarray(values), [0.05, 0.5, 0.95])
    return {"median": float(middle), "5 %": float(low), "95 %": float(high)}


def summary_rows(rows: Rows) -> Rows:
    """Medians over seeds of every figure, and the spread of the flange's."""
    cases = dict.fromkeys(tuple(row[key] for key in CASE) for row in rows)
    out: Rows = []
    for case in cases:
        good = list(rows_of(rows, *case).values())
        if not good:
            continue
        tried = sum(tuple(row[key] for key in CASE) == case for row in rows)
        ends = spread([row[HAND] for row in good])
        others = [key for key in good[0] if key not in (*CASE, "seed", "trace", HAND)]
        out.append(
            {
                **dict(zip(CASE, case, strict=True)),
                "seeds": len(good),
                "failed": tried - len(good),
                **{f"hand rms, {key} [mm]": value for key, value in ends.items()},
                **{key: float(np.median([row[key] for row in good])) for key in others},
            }
        )
    return out


# Rows of the page's tables, by controller and coefficients.
TRACKING = {
    "PID, gains for 20 rad/s": ("PID", "none"),
    "PID, the thesis's gains": ("PID, thesis", "none"),
    **{
        f"computed torque, {name}": ("computed torque", name)
        for name in ("30 % wrong", "Ar+LS", "Ar+Rg", "CSLC", "truth")
    },
}
PARTIAL = {
    "PID + gravity, the thesis's gains": ("PID + gravity", "CSLC"),
    **{name: (name, "CSLC") for name in ("gravity only", "no friction", "no velocity term")},
}


def page_table(rows: Rows, cases: Mapping[str, tuple[str, str]]) -> list[list[str]]:
    """The page's table of flange errors, medians over seeds [mm]: the head first."""
    motions = motions_of(rows)
    head = ["", *(f"{motion}, {duration:g} s" for motion, duration in motions)]
    table = [head]
    for label, case in cases.items():
        errors = (
            [row[HAND] for row in rows_of(rows, *motion, *case).values()] for motion in motions
        )
        table.append([label, *(f"{np.median(some):#.3g}" if some else "" for some in errors)])
    return table


def ratio_rows(rows: Rows) -> Rows:
    """Flange error with CSLC over that with others, seed by seed."""
    out: Rows = []
    for over, other in OTHERS.items():
        together: list[float] = []
        for motion, duration in motions_of(rows):
            above = rows_of(rows, motion, duration, "computed torque", "CSLC")
            below = rows_of(rows, motion, duration, *other)
            ratios = [
                above[seed][HAND] / below[seed][HAND]
                for seed in sorted(above.keys() & below.keys())
            ]
            together += ratios
            if ratios:
                labels = {"CSLC over": over, "motion": motion, "duration": f"{duration:g} s"}
                out.append({**labels, "seeds": len(ratios), **spread(ratios)})
        if together:
            labels = {"CSLC over": over, "motion": "all", "duration": "all"}
            out.append({**labels, "seeds": len(together), **spread(together)})
    return out


def draw(
    rows: Rows,
    folder: Path,
    controllers: Sequence[str],
    sets: Sequence[str],
    centre: Sequence[float],
    normal: Sequence[float],
) -> None:
    """Writes the pictures that the rows suffice for."""
    panels: dict[str, dict[str, dict[str, np.ndarray]]] = {}
    for motion, duration in motions_of(rows):
        panel = panels.setdefault(f"{motion}, {duration:g} s", {})
        for controller in controllers:
            for name in ("none", *sets):
                by_seed = rows_of(rows, motion, duration, controller, name)
                if by_seed:
                    errors = np.array([row[HAND] for row in by_seed.values()])
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
    """The first machine's motion under some of the controllers."""
    traces: dict[str, dict[str, np.ndarray]] = {}
    shown = {name: OTHERS[name] for name in SHOWN} | {"CSLC": ("computed torque", "CSLC")}
    for label, case in shown.items():
        row = rows_of(rows, motion, duration, *case).get(0)
        if row is not None:
            traces[label] = {key: np.array(values) for key, values in row["trace"].items()}
    return traces
