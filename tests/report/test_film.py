"""Films of arms: what moves in each view, frame by frame."""

import re

import numpy as np
import pytest

from jaxcslc.report import Film, Page, Section, render


def positions(svg: str, attribute: str) -> list[list[float]]:
    """Values of an attribute of the end of the arm, view by view."""
    texts = re.findall(rf'attributeName="{attribute}"[^>]*values="([^"]*)"', svg)
    return [[float(value) for value in text.split(";")] for text in texts]


def test_views_show_the_coordinates_that_they_name(rng: np.random.Generator) -> None:
    frames = rng.normal(size=(5, 2, 2, 3))
    svg = Film(frames, 2.0, "an arm").svg()
    low, high = (limit(frames, axis=(0, 1, 2)) for limit in (np.min, np.max))
    scale = 248 / np.max(np.maximum(high, 0.0) - np.minimum(low, 0.0))
    for view, (first, second) in enumerate(((0, 2), (1, 2), (0, 1))):
        right, down = np.array(positions(svg, "cx")[view]), np.array(positions(svg, "cy")[view])
        np.testing.assert_allclose(
            np.diff(right), scale * np.diff(frames[:, -1, 1, first]), atol=0.11
        )
        np.testing.assert_allclose(
            np.diff(down), -scale * np.diff(frames[:, -1, 1, second]), atol=0.11
        )
        assert right.min() >= 300 * view
        assert right.max() <= 300 * (view + 1)


def test_a_page_has_the_film_and_its_caption() -> None:
    frames = np.zeros((2, 1, 2, 3))
    frames[:, 0, 1] = [[0.0, 0.3, 1.0], [0.5, 0.0, 1.0]]
    film = Film(frames, 1.5, "From pose < to pose")
    page = render(Page("A page", "", "", "good", (), (Section("Film", "", (film,)),)))
    assert film.svg() in page
    assert "From pose &lt; to pose" in page
    assert 'dur="1.5s"' in page


def test_one_frame_is_no_film() -> None:
    with pytest.raises(ValueError, match="frames: expected two or more, got 1"):
        Film(np.zeros((1, 1, 2, 3)), 1.0, "")
