"""Pictures of the library: written to files, and drawn only when asked for."""

import subprocess
import sys
from pathlib import Path

from matplotlib.figure import Figure

from jaxcslc.plotting import new_figure, save_picture


def test_saved_as_a_file(tmp_path: Path) -> None:
    figure = new_figure(3.0, 2.0)
    assert isinstance(figure, Figure)
    save_picture(figure, tmp_path / "empty.png")
    assert (tmp_path / "empty.png").read_bytes().startswith(b"\x89PNG")


def test_importing_the_package_draws_nothing() -> None:
    command = "import sys, jaxcslc.plotting; print('matplotlib' in sys.modules)"
    done = subprocess.run(
        [sys.executable, "-c", command], capture_output=True, text=True, check=True
    )
    assert done.stdout.strip() == "False"
