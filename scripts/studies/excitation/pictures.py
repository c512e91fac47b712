"""The figure of the page: motions side by side, and predicted against obtained errors."""

from collections.abc import Sequence
from pathlib import Path
from typing import Any

import numpy as np

from scripts.studies.excitation.motions import MOTIONS, predicted_errors
from scripts.studies.figures import COLOURS, new_figure, readable_decades


def figure(rows: Sequence[dict[str, Any]], motion: Any, path: Path) -> None:
    """Draws ε of each motion over seeds, and coefficients' errors against their predictions.

    **Arguments**

    - `rows`: of the study.
    - `motion`: the design of which errors were predicted.
    - `path`: of the picture.
    """
    drawing = new_figure(9.5, 3.6)
    left, right = drawing.subplots(1, 2, gridspec_kw={"width_ratios": [1.15, 1.0]})
    compared = [row for row in rows if row["part"] == "compare"]
    names = [name for name in MOTIONS if any(row["name"] == name for row in compared)]
    values = [[row["epsilon"] for row in compared if row["name"] == name] for name in names]
    left.boxplot(
        values, vert=False, whis=(10, 90), showfliers=False, medianprops={"color": COLOURS[0]}
    )
    left.set_yticks(range(1, len(names) + 1), names)
    left.invert_yaxis()
    left.set_xscale("log")
    readable_decades(left)
    left.set_xlabel("ε on the comparison trajectory [N m]")
    left.set_title("recordings with all disturbances", fontsize=10)
    left.grid(alpha=0.25, axis="x", which="both")
    for part, marker, colour in (("regression", "o", 1), ("likelihood", "x", 0)):
        errors = np.array([row["errors"] for row in rows if row["part"] == part])
        if len(errors) < 2:
            continue
        prediction = predicted_errors(motion, part)
        right.plot(
            100 * prediction.sized_error,
            100 * np.sqrt(np.mean(errors**2, axis=0)) / prediction.size,
            marker,
            ms=4,
            mfc="none",
            color=COLOURS[colour],
            label=f"{part}, {len(errors)} recordings",
        )
    ends = np.array(right.get_xlim())
    right.plot(ends, ends, color="0.4", lw=0.8, zorder=0)
    right.set(xscale="log", yscale="log")
    right.set_xlabel("predicted standard error over size [%]")
    right.set_ylabel("RMS error over size [%]")
    right.set_title("43 coefficients of the design", fontsize=10)
    right.grid(alpha=0.25, which="major")
    right.legend(loc="lower right", frameon=False, fontsize=9)
    path.parent.mkdir(parents=True, exist_ok=True)
    drawing.savefig(path, dpi=110)
