"""Pictures of measured and predicted torque (Figs. 7.6-1, 7.6-2), and their files."""

from pathlib import Path
from typing import TYPE_CHECKING


if TYPE_CHECKING:
    from matplotlib.figure import Figure


def save_picture(figure: "Figure", path: Path) -> None:
    """Draw a figure into a PNG file."""
    figure.savefig(path, dpi=130)
