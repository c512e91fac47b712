"""Pictures of the gallery are drawn by the code that the page shows."""

import functools
import re

import matplotlib.pyplot as plt
import pytest

import jaxcslc as jc
from scripts.tools.gallery import FOLDER, PAGE, blocks, figures


MOST = 60_000  # bytes of a picture


def test_twelve_pictures_each_with_its_code() -> None:
    text = PAGE.read_text("utf-8")
    names = re.findall(r"\]\(images/gallery/([a-z-]+)\.png\)", text)
    assert len(names) == len(blocks()) - 1 == 12
    assert {path.stem for path in FOLDER.iterdir()} == set(names)
    assert all((FOLDER / f"{name}.png").stat().st_size < MOST for name in names)


def test_some_are_drawn_as_they_stand(monkeypatch: pytest.MonkeyPatch) -> None:
    """Of a report without selected settings: tests of the README and the tutorial select them."""
    quick = functools.partial(jc.identify, settings=jc.Settings(), possible="never")
    monkeypatch.setattr(jc, "identify", quick)
    plt.switch_backend("agg")
    names = ["measured-and-predicted-torque", "friction-of-a-joint", "gravity-torque"]
    drawn = {name: len(figure.axes) for name, figure in figures(names)}
    assert drawn == dict(zip(names, (1, 1, 2), strict=True))
