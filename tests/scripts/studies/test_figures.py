"""Pictures of studies: written to files."""

from pathlib import Path

from matplotlib.figure import Figure

from scripts.studies.figures import new_figure, save_picture


def test_saved_as_a_file(tmp_path: Path) -> None:
    figure = new_figure(3.0, 2.0)
    assert isinstance(figure, Figure)
    save_picture(figure, tmp_path / "empty.png")
    assert (tmp_path / "empty.png").read_bytes().startswith(b"\x89PNG")
