"""Tables and pictures of the budget's rows."""

import dataclasses
from collections.abc import Mapping, Sequence
from pathlib import Path
from typing import Any

import numpy as np
from jaxtyping import Float
from scipy.stats import t as student

from jaxcslc._text_table import text_table
from jaxcslc.report import write_csv
from scripts.studies.disturbances.measures import OFF, ON, Line, lines
from scripts.studies.disturbances.pictures import budget_picture
from scripts.studies.figures import save_picture


FIGURES = {"epsilon": "ε [N m]", "coefficient_error": "coefficient error [N m]"}


@dataclasses.dataclass(frozen=True)
class Summary:
    """One figure of one line over the seeds."""

    line: Line
    figure: str
    off: Float[np.ndarray, " seeds"]
    on: Float[np.ndarray, " seeds"]
    floor: float

    def gain(self) -> tuple[float, float]:
        """Off less on, seed by seed: mean, and half of its 95 % confidence interval (t)."""
        difference = self.off - self.on
        count = difference.size
        if count < 2:
            return float(np.mean(difference)), float("nan")
        half = student.ppf(0.975, count - 1) * np.std(difference, ddof=1) / np.sqrt(count)
        return float(np.mean(difference)), float(half)

    def row(self) -> dict[str, Any]:
        """Return the row for a CSV file."""
        gain, half = self.gain()
        row: dict[str, Any] = {
            "case": self.line.case,
            "line": self.line.name,
            "measure": self.line.measure,
            "figure": FIGURES[self.figure],
            "seeds": self.on.size,
        }
        for name, values in (("off", self.off), ("on", self.on)):
            mean, deviation, low, high = spread(values)
            row |= {f"{name} mean": mean, f"{name} standard deviation": deviation}
            row |= {f"{name} 5 %": low, f"{name} 95 %": high}
        row |= {
            "floor": self.floor,
            "gain": gain,
            "gain low": gain - half,
            "gain high": gain + half,
        }
        return row | {"helped": int(np.sum(self.off > self.on))}


def spread(values: Float[np.ndarray, " seeds"]) -> tuple[float, float, float, float]:
    """Mean, standard deviation, and the 5 and 95 % quantiles over the seeds."""
    deviation = float(np.std(values, ddof=1)) if values.size > 1 else float("nan")
    low, high = np.quantile(values, (0.05, 0.95)).tolist()
    return float(np.mean(values)), deviation, low, high


def summarise(cases: Sequence[str], rows: Sequence[Mapping[str, Any]]) -> list[Summary]:
    """Every line and figure over the seeds that did not fail."""
    summaries: list[Summary] = []
    for figure in FIGURES:
        for line in (line for case in cases for line in lines(case)):
            fits = [row["fits"] for row in rows if row["case"] == line.case and "fits" in row]
            if not fits:
                continue
            off, on = (np.array([fit[name][figure] for fit in fits]) for name in (line.off, ON))
            floor = float(np.mean([fit[ON]["floor"] for fit in fits]))
            floor = floor if figure == "epsilon" else np.nan
            summaries.append(Summary(line, figure, off, on, floor))
    return summaries


def table(summaries: Sequence[Summary], figure: str) -> str:
    """Mean ± standard deviation (5 to 95 % of the seeds) of one figure."""

    def cell(values: Float[np.ndarray, " seeds"]) -> str:
        mean, deviation, low, high = spread(values)
        return f"{mean:.4f} ± {deviation:.4f} ({low:.4f} to {high:.4f})"

    def entries(summary: Summary) -> list[str]:
        gain, half = summary.gain()
        helped = f"{np.sum(summary.off > summary.on)}/{summary.on.size}"
        floor = [f"{summary.floor:.4f}"] if figure == "epsilon" else []
        return [
            summary.line.name,
            summary.line.measure,
            cell(summary.off),
            cell(summary.on),
            *floor,
            f"{gain:+.4f} ± {half:.4f}",
            helped,
        ]

    header = ["disturbance", "counter-measure", "off", "on"]
    header += ["floor"] if figure == "epsilon" else []
    header += ["gain, 95 % confidence", "helped"]
    cells = [entries(summary) for summary in summaries if summary.figure == figure]
    return text_table(header, cells, left=("counter-measure",))


def mask_text(rows: Sequence[Mapping[str, Any]]) -> list[str]:
    """Return what the backlash mask caught and gave up, over all seeds and joints of a case."""
    texts: list[str] = []
    for case in dict.fromkeys(row["case"] for row in rows if row.get("mask")):
        counts = [row["mask"] for row in rows if row["case"] == case and row.get("mask")]
        total = {name: sum(count[name] for count in counts) for name in counts[0]}
        good = total["pairs"] - total["disturbed"]
        caught = total["caught"] / max(total["disturbed"], 1)
        lost = (total["left_out"] - total["caught"]) / max(good, 1)
        texts.append(
            f"backlash mask, {case}: gears apart in {total['disturbed'] / total['pairs']:.1%} of"
            f" the pairs, of which it leaves out {caught:.1%}, and {lost:.1%} of the others"
        )
    return texts


def write(
    folder: Path, summaries: Sequence[Summary], rows: Sequence[Mapping[str, Any]], title: str
) -> None:
    """Writes tables of seeds and of the summary, and a picture of each figure."""
    fits = [
        {"case": row["case"], "seed": row["seed"], "variant": name, **figures}
        for row in rows
        for name, figures in row.get("fits", {}).items()
    ]
    write_csv(folder / "seeds.csv", fits)
    write_csv(folder / "summary.csv", [summary.row() for summary in summaries])
    for figure, quantity in FIGURES.items():
        drawn = [summary for summary in summaries if summary.figure == figure]
        off, on = (padded([getattr(summary, name) for summary in drawn]) for name in ("off", "on"))
        names = [
            f"{summary.line.name}: {summary.line.measure}"
            if summary.line.off == OFF
            else summary.line.name
            for summary in drawn
        ]
        picture = budget_picture(names, off, on, title=title, quantity=quantity)
        save_picture(picture, folder / f"{figure}.png")


def padded(rows: Sequence[Float[np.ndarray, " seeds"]]) -> Float[np.ndarray, "lines seeds"]:
    """Rows of a matrix, NaN where a case has fewer seeds."""
    most = max(row.size for row in rows)
    return np.stack([np.pad(row, (0, most - row.size), constant_values=np.nan) for row in rows])
