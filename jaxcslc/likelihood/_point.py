"""Values of all unknowns: positions and reversals in order of time, and the border by name."""

import dataclasses
from collections.abc import Mapping

import numpy as np
from jaxtyping import Float


Border = Float[np.ndarray, " border"]
# Where unknowns of added blocks are: what they are is known to their equations.
_LAST = "offset"


@dataclasses.dataclass(frozen=True)
class UnknownLayout:
    """Layout of the border: unknowns that all equations share.

    **Attributes**

    - `sizes`: name and number of each part, one after the other. The first two are `"k"`,
      coefficients, and `"slopes"`, logarithms of static friction's slopes; the last one is
      `"offset"`, of the encoders of all recordings. Between them are those of added blocks.

    >>> layout = UnknownLayout((("k", 3), ("slopes", 1), ("offset", 1))).with_part("gears", 4)
    >>> layout.part("gears"), layout.size
    (slice(4, 8, None), 9)
    """

    sizes: tuple[tuple[str, int], ...]

    @property
    def size(self) -> int:
        """Return how many unknowns."""
        return sum(size for _, size in self.sizes)

    def part(self, name: str) -> slice:
        """Return indices of a part; none of one that there is not."""
        first = 0
        for other, size in self.sizes:
            if other == name:
                return slice(first, first + size)
            first += size
        return slice(0, 0)

    @property
    def laws(self) -> slice:
        """Return what equations have beside coefficients: slopes, and unknowns of added blocks."""
        return slice(self.part("slopes").start, self.part(_LAST).start)

    def with_part(self, name: str, size: int) -> "UnknownLayout":
        """Return it with the unknowns of an added block."""
        return UnknownLayout((*self.sizes[:-1], (name, size), self.sizes[-1]))

    def inserted(
        self,
        values: Border,
        name: str,
        added: Float[np.ndarray, " added"],
    ) -> Float[np.ndarray, " longer"]:
        """Return values in this layout, from those of a layout without a part, and the part's."""
        return np.insert(values, self.part(name).start, added)


@dataclasses.dataclass(frozen=True)
class Point:
    """Values of all unknowns.

    **Attributes**

    - `border`: what all equations share; `layout`: where what of it is.
    - `q`: (samples, n) positions of joints.
    - `turn`: (reversals,) moments of the reversals.
    """

    border: Border
    layout: UnknownLayout
    q: Float[np.ndarray, "samples joints"]
    turn: Float[np.ndarray, " reversals"]

    @classmethod
    def of(
        cls,
        values: Mapping[str, np.ndarray],
        q: Float[np.ndarray, "samples joints"],
        turn: Float[np.ndarray, " reversals"],
    ) -> "Point":
        """Return from values of the border by name, in the order of `Layout`."""
        layout = UnknownLayout(tuple((name, np.size(part)) for name, part in values.items()))
        return cls(np.concatenate([np.ravel(part) for part in values.values()]), layout, q, turn)

    def with_values(self, **values: np.ndarray) -> "Point":
        """Return it with other values of some parts of the border."""
        border = self.border.copy()
        for name, part in values.items():
            border[self.layout.part(name)] = np.ravel(part)
        return dataclasses.replace(self, border=border)

    def values(self, name: str) -> Float[np.ndarray, " values"]:
        """Return those of a part of the border; none of one that there is not."""
        return self.border[self.layout.part(name)]

    @property
    def k(self) -> Float[np.ndarray, " coefficients"]:
        """Return (p,) coefficients."""
        return self.values("k")

    @property
    def slopes(self) -> Float[np.ndarray, " joints"]:
        """Return (n,) logarithms of static friction's slopes."""
        return self.values("slopes")

    @property
    def laws(self) -> Float[np.ndarray, " laws"]:
        """Return what equations have beside coefficients, see `Layout.laws`."""
        return self.border[self.layout.laws]

    @property
    def offset(self) -> Float[np.ndarray, "recordings joints"]:
        """Return (recordings, n) of the encoders [rad or m]."""
        return self.values(_LAST).reshape(-1, len(self.slopes))


@dataclasses.dataclass(frozen=True)
class Step:
    """Changes of all unknowns; `border` in units of its scale."""

    border: Border
    position: Float[np.ndarray, "samples joints"]
    turn: Float[np.ndarray, " reversals"]

    def scaled(self, factor: float) -> "Step":
        """Return a part of it."""
        return Step(factor * self.border, factor * self.position, factor * self.turn)
