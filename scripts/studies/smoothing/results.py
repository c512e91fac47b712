"""Entries of the smoothing study: one method at one joint over all seeds; table and picture."""

import dataclasses
from collections.abc import Iterable, Sequence
from typing import Any

import numpy as np
from matplotlib.figure import Figure
from matplotlib.ticker import FormatStrFormatter, LogLocator, NullFormatter

from jaxcslc._text_table import text_table
from scripts.studies.figures import new_figure


SELECTED = "averaged splines, chosen"
"""The method that others are compared with."""


@dataclasses.dataclass(frozen=True)
class Entry:
    """Errors of one method at one joint, in one region of one trajectory, over all seeds."""

    trajectory: str
    region: str
    joint: int
    method: str
    setting: str
    rmse: float
    spread: float

    def row(self) -> dict[str, Any]:
        """Return the row for a CSV file."""
        return {
            "trajectory": self.trajectory,
            "region": self.region,
            "joint": self.joint,
            "method": self.method,
            "setting": self.setting,
            "acceleration RMSE [rad/s²]": self.rmse,
            "standard deviation over seeds [rad/s²]": self.spread,
        }


def grouped(entries: Iterable[Entry]) -> dict[tuple[str, str], dict[str, dict[int, Entry]]]:
    """Entries by trajectory and region, then by method, then by joint."""
    groups: dict[tuple[str, str], dict[str, dict[int, Entry]]] = {}
    for entry in entries:
        group = groups.setdefault((entry.trajectory, entry.region), {})
        group.setdefault(entry.method, {})[entry.joint] = entry
    return groups


def table(entries: Sequence[Entry], joints: int) -> str:
    """One table for each trajectory and region, and the method of least error."""
    parts: list[str] = []
    for (trajectory, region), methods in grouped(entries).items():
        rows = [
            [
                method,
                *(
                    f"{by_joint[j].rmse:.3f} ({by_joint[j].setting})" if j in by_joint else "-"
                    for j in range(1, joints + 1)
                ),
                f"{relative(by_joint, methods[SELECTED]):.2f}",
            ]
            for method, by_joint in methods.items()
        ]
        header = ["", *(f"joint {j}" for j in range(1, joints + 1)), "ratio"]
        least_by_joint = ", ".join(
            f"joint {j}: {min(methods, key=lambda m: methods[m][j].rmse)}"
            for j in sorted(methods[SELECTED])
        )
        least = min(methods, key=lambda m: relative(methods[m], methods[SELECTED]))
        parts.append(
            f"{trajectory} trajectory, {region}: acceleration RMSE [rad/s²] (setting)\n"
            f"{text_table(header, rows)}\nleast: {least_by_joint}; over all joints: {least}"
        )
    return "\n\n".join(parts)


def relative(entries: dict[int, Entry], selected: dict[int, Entry]) -> float:
    """Geometric mean over joints of the RMSE, in units of that of the selected splines."""
    ratios = [entries[joint].rmse / selected[joint].rmse for joint in entries]
    return float(np.exp(np.mean(np.log(ratios))))


def picture(entries: Sequence[Entry], seeds: int) -> Figure:
    """RMSE of every method at every joint, with its spread over seeds; a panel for each region."""
    # Okabe and Ito's palette, told apart by colour-blind readers; shapes tell them apart as well.
    styles = (
        ("#D55E00", "o"),
        ("#E69F00", "s"),
        ("#000000", "x"),
        ("#0072B2", "v"),
        ("#009E73", "^"),
        ("#56B4E9", "D"),
    )
    groups = grouped(entries)
    figure = new_figure(11.0, 1.2 + 2.8 * len(groups))
    axes = np.atleast_1d(figure.subplots(len(groups), 1))
    for axis, ((trajectory, region), methods) in zip(axes, groups.items(), strict=True):
        apart = 0.6 / len(methods)
        for number, (method, by_joint) in enumerate(methods.items()):
            colour, marker = styles[number % len(styles)]
            joints = np.array(sorted(by_joint))
            axis.errorbar(
                joints + (number - 0.5 * (len(methods) - 1)) * apart,
                [by_joint[j].rmse for j in joints],
                yerr=[by_joint[j].spread for j in joints] if seeds > 1 else None,
                color=colour,
                marker=marker,
                ms=6,
                ls="none",
                elinewidth=1.0,
                label=method,
            )
        axis.set_yscale("log")
        axis.yaxis.set_major_locator(LogLocator(subs=(1.0, 2.0, 5.0)))
        axis.yaxis.set_major_formatter(FormatStrFormatter("%g"))
        axis.yaxis.set_minor_formatter(NullFormatter())
        axis.set_xticks(sorted(methods[SELECTED]))
        axis.set_ylabel("acceleration RMSE\n[rad/s²]")
        axis.set_title(f"{trajectory} trajectory, {region}", fontsize="medium")
        axis.grid(axis="y", alpha=0.25)
    axes[-1].set_xlabel("joint")
    handles, labels = axes[0].get_legend_handles_labels()
    figure.legend(handles, labels, loc="outside lower center", ncols=3, frameon=False)
    figure.suptitle(
        f"PUMA 560, quantised positions: accelerations by averaged splines and others ({seeds} "
        f"seed{'s' if seeds > 1 else ''})"
    )
    return figure
