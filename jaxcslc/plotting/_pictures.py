from collections.abc import Mapping
from pathlib import Path
from typing import TYPE_CHECKING

import numpy as np
from jaxtyping import Array, Bool, Float

from ._look import COLOURS, MEASURED, STYLES, new_figure


if TYPE_CHECKING:
    from matplotlib.figure import Figure


def torque_picture(
    time: Float[np.ndarray, " samples"],
    measured: Float[Array | np.ndarray, "samples joints"],
    predicted: Mapping[str, Float[Array | np.ndarray, "samples joints"]],
    *,
    title: str,
    units: tuple[str, ...],
    mask: Bool[Array | np.ndarray, "samples joints"] | None = None,
    names: tuple[str, ...] | None = None,
) -> "Figure":
    """Measured and predicted torque of every joint against time (Figs. 7.6-1, 7.6-2).

    **Arguments**

    - `time`: (samples,) [s]; a gap longer than ten sampling intervals breaks the curves.
    - `measured`: (samples, n) [N m or N].
    - `predicted`: the same of each model, by name.
    - `units`: of each joint's torque.
    - `mask`: (samples, n), the judged samples: predictions are drawn for these only. By default
      for all.
    - `names`: of the joints; `"joint 1"` and so on if omitted.

    **Returns** a matplotlib figure; `figure.savefig(path)` draws it.
    """
    measured = np.asarray(measured)
    n = measured.shape[1]
    shown = np.ones(measured.shape, bool) if mask is None else np.asarray(mask)
    rows = -(-n // 2)
    figure = new_figure(11.0, 1.2 + 2.3 * rows)
    axes = np.atleast_2d(figure.subplots(rows, 2, sharex=True))
    breaks = np.flatnonzero(np.diff(time) > 10 * np.median(np.diff(time))) + 1

    def broken(values: np.ndarray) -> np.ndarray:
        return np.insert(values.astype(float), breaks, np.nan)

    # Down the columns, as in the thesis: joints 1 to 3 on the left of a six-jointed arm.
    for joint, axis in enumerate(axes.T.flat):
        if joint >= n:
            axis.set_visible(False)
            continue
        clock = broken(time)
        axis.plot(clock, broken(measured[:, joint]), color=MEASURED, lw=3.0, label="measured")
        for i, (name, torque) in enumerate(predicted.items()):
            axis.plot(
                clock,
                broken(np.where(shown[:, joint], np.asarray(torque)[:, joint], np.nan)),
                color=COLOURS[i % len(COLOURS)],
                ls=STYLES[i % len(STYLES)],
                lw=1.0,
                label=name,
            )
        name = f"joint {joint + 1}" if names is None else names[joint]
        axis.set_ylabel(f"{name} [{units[joint]}]" if units[joint] else name)
        axis.grid(alpha=0.25)
        axis.margins(x=0.01)
    for axis in axes[-1]:
        axis.set_xlabel("time [s]")
        axis.tick_params(labelbottom=True)
    if n % 2 and rows > 1:  # the last column ends one row higher
        axes[-2, 1].set_xlabel("time [s]")
        axes[-2, 1].tick_params(labelbottom=True)
    figure.suptitle(title)
    handles, labels = axes.flat[0].get_legend_handles_labels()
    figure.legend(handles, labels, loc="outside lower center", ncols=len(labels), frameon=False)
    return figure


def save_picture(figure: "Figure", path: Path) -> None:
    """Draw a figure into a PNG file."""
    figure.savefig(path, dpi=130)
