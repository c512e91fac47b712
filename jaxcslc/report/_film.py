"""Film of a motion, drawn in the page."""

import dataclasses
from typing import ClassVar

import numpy as np
from jaxtyping import Float

from ._blocks import AbstractBlock


_VIEW, _MARGIN = 300, 26  # of a view [pixels]
Pixels = Float[np.ndarray, "frames lines 2"]
_VIEWS = ((0, 2, "from the side"), (1, 2, "from the front"), (0, 1, "from above"))


@dataclasses.dataclass(frozen=True, eq=False)
class Film(AbstractBlock):
    """A moving arm, its links lines from joint to joint, in three views beside each other.

    An SVG picture that animates itself: it needs no script, and is a few kilobytes a second.

    **Attributes**

    - `frames`: (frames, lines, 2, 3), from joint to joint, in the base frame [m].
    - `duration`: of all frames [s], which then begin again.
    - `caption`: below the film, and its text for those who do not see it.

    **Raises**

    - `ValueError`: fewer than two frames.

    >>> import numpy as np
    >>> frames = np.zeros((2, 1, 2, 3))
    >>> frames[1, 0, 1] = [0.1, 0.2, 0.3]
    >>> Film(frames, 1.0, "an arm").svg().count("<animate")
    9
    """

    kind: ClassVar[str] = "film"
    frames: Float[np.ndarray, "frames lines 2 3"]
    duration: float
    caption: str

    def __post_init__(self) -> None:
        if len(self.frames) < 2:
            raise ValueError(f"frames: expected two or more, got {len(self.frames)}")

    def svg(self) -> str:
        """The picture."""
        low = np.minimum(self.frames.min((0, 1, 2)), 0.0)
        high = np.maximum(self.frames.max((0, 1, 2)), 0.0)
        scale = (_VIEW - 2 * _MARGIN) / max(float(np.max(high - low)), 1e-9)
        parts: list[str] = []
        for number, (first, second, name) in enumerate(_VIEWS):
            pixels = scale * (self.frames - (low + high) / 2) + _VIEW / 2
            x = pixels[..., first] + number * _VIEW
            y = _VIEW - pixels[..., second]
            axes = f"{'xyz'[first]} to the right, {'xyz'[second]} upwards"
            parts.append(
                f'<text x="{number * _VIEW + 10}" y="18" font-size="13" fill="#4b5563">'
                f"{name}: {axes}</text>"
            )
            base = scale * (-(low + high) / 2) + _VIEW / 2
            parts.append(
                f'<circle cx="{base[first] + number * _VIEW:.1f}" cy="{_VIEW - base[second]:.1f}"'
                ' r="5" fill="#9aa1a9"/>'
            )
            parts.append(self._arm(x, y))
        scale_bar = _bar_length(float(np.max(high - low)))
        parts.append(
            f'<path d="M10 {_VIEW - 10} h{scale * scale_bar:.1f}" stroke="#4b5563"/>'
            f'<text x="{16 + scale * scale_bar:.1f}" y="{_VIEW - 6}" font-size="13" fill="#4b5563">'
            f"{scale_bar:g} m</text>"
        )
        return (
            f'<svg viewBox="0 0 {3 * _VIEW} {_VIEW}" xmlns="http://www.w3.org/2000/svg"'
            f' style="width:100%;max-width:{3 * _VIEW}px">{"".join(parts)}</svg>'
        )

    def _arm(self, x: Pixels, y: Pixels) -> str:
        """Links, and the end of the last one."""
        links = [_path(*frame) for frame in zip(x, y, strict=True)]
        ends = [[f"{value:.1f}" for value in values[:, -1, 1]] for values in (x, y)]
        return (
            f'<path d="{links[0]}" fill="none" stroke="#0072b2" stroke-width="5"'
            f' stroke-linecap="round">{self._animate("d", links)}</path>'
            f'<circle cx="{ends[0][0]}" cy="{ends[1][0]}" r="6" fill="#d55e00">'
            f"{self._animate('cx', ends[0])}{self._animate('cy', ends[1])}</circle>"
        )

    def _animate(self, attribute: str, values: list[str]) -> str:
        return (
            f'<animate attributeName="{attribute}" dur="{self.duration:g}s"'
            f' repeatCount="indefinite" values="{";".join(values)}"/>'
        )


def _path(x: Float[np.ndarray, "lines 2"], y: Float[np.ndarray, "lines 2"]) -> str:
    return "".join(
        f"M{a[0]:.1f} {b[0]:.1f}L{a[1]:.1f} {b[1]:.1f}" for a, b in zip(x, y, strict=True)
    )


def _bar_length(extent: float) -> float:
    """A round length of about a fifth of an extent [m]."""
    decade = 10.0 ** np.floor(np.log10(max(extent, 1e-9) / 5))
    return float(decade * max(step for step in (1, 2, 5) if step * decade <= extent / 5))
