"""Means over two intervals of what elastic gears bear."""

import dataclasses
from typing import NamedTuple

import numpy as np
from jaxtyping import Float


# Least width of a dead band's edges as a part of the play.
_EDGE = 0.005
# Gauss-Legendre nodes and weights on (0, 1), of each of two intervals.
_NODES, _WEIGHTS = (np.polynomial.legendre.leggauss(4)[i] / 2 + (0.5, 0.0)[i] for i in (0, 1))

Series = Float[np.ndarray, "samples links"]
Rows = Float[np.ndarray, "equations links"]
Weights = Float[np.ndarray, "3 equations"]


class Windup(NamedTuple):
    """Windup of gears, less their play, averaged with a triangle; and its derivatives.

    **Attributes**

    - `value`: (equations, f) [rad or m].
    - `by_difference`: (3, equations, f) by rotor minus link at three samples.
    - `by_play`: (equations, f) by the play.
    """

    value: Rows
    by_difference: Float[np.ndarray, "3 equations links"]
    by_play: Rows


@dataclasses.dataclass(frozen=True)
class Stencil:
    """Weights of three samples in an equation, from a parabola through them.

    **Attributes**

    - `mean`: in the triangle's mean over the two intervals that meet at the middle sample; `rate`:
      in that of the rate; `acceleration`: (3, equations) each.
    - `nodes`: (3, nodes, equations) at instants in these intervals, whose triangle's mean is that
      with `weights`, (nodes, equations).
    """

    mean: Weights
    rate: Weights
    acceleration: Weights
    nodes: Float[np.ndarray, "3 nodes equations"]
    weights: Float[np.ndarray, "nodes equations"]

    @classmethod
    def of(cls, time: Float[np.ndarray, " samples"]) -> "Stencil":
        """Compute it at samples of these times [s]."""
        h = np.diff(time)
        before, after = h[:-1], h[1:]
        total = before + after
        acceleration = np.stack(
            [2.0 / (before * total), -2.0 / (before * after), 2.0 / (after * total)]
        )
        rate = np.stack(
            [
                -after / (before * total),
                after / (before * total) - before / (after * total),
                before / (after * total),
            ]
        )
        one = np.array([[0.0], [1.0], [0.0]])
        instants = np.concatenate(
            [-_NODES[:, None] * before, _NODES[:, None] * after]
        )  # from the middle sample
        shares = np.concatenate([np.tile(before / total, (4, 1)), np.tile(after / total, (4, 1))])
        weights = shares * 2.0 * np.tile(_WEIGHTS * (1.0 - _NODES), 2)[:, None]
        nodes = (
            one[:, None]
            + rate[:, None] * instants[None]
            + 0.5 * acceleration[:, None] * instants[None] ** 2
        )
        return cls(
            np.sum(nodes * weights, axis=1),
            rate + (after - before) / 3.0 * acceleration,
            acceleration,
            nodes,
            weights,
        )

    @staticmethod
    def applied(weights: Weights, values: Series) -> Rows:
        """Return the weighted sum of three samples, for each equation."""
        before, now, after = weights[:, :, None]
        return before * values[:-2] + now * values[1:-1] + after * values[2:]

    def windup(
        self,
        difference: Series,
        play: Float[np.ndarray, " links"],
        width: Float[np.ndarray, " links"],
    ) -> Windup:
        """Return rotor minus link beyond the dead band of gears with play.

        A dead band of smooth edges: its derivatives are right for a play of zero too, where that by
        the play is minus half of the difference's sign. Beyond the band gears are linear, and the
        mean is a parabola's; in it, gears meet and part amid intervals, and the mean is that of a
        few instants.

        **Arguments**

        - `difference`: rotor minus link [rad or m].
        - `play`: (f,) how far a link moves while its rotor stands still [rad or m].
        - `width`: (f,) over which the edges are smooth at least [rad or m]; more than 0.

        >>> import numpy as np
        >>> time, u = np.arange(4.0), np.array([[-0.3], [-0.3], [-0.3], [0.3]])
        >>> stencil = Stencil.of(time)
        >>> stencil.windup(u, np.array([0.2]), np.array([1e-6])).value.round(3)[:, 0].tolist()
        [-0.2, -0.167]
        """
        edge = np.hypot(width, _EDGE * play)
        weights = self.weights[:, :, None]
        inside = sum(
            basis[:, :, None] * difference[index : len(difference) - 2 + index]
            for index, basis in enumerate(self.nodes)
        )  # (nodes, equations, f)
        above, below = inside + 0.5 * play, inside - 0.5 * play
        far, near = np.hypot(above, edge), np.hypot(below, edge)
        clipped = weights * 0.5 * (far - near)
        slope = weights * 0.5 * (above / far - below / near)
        by_edge = 0.5 * edge * (1.0 / far - 1.0 / near) * _EDGE**2 * play / edge
        by_play = weights * (0.25 * (above / far + below / near) + by_edge)
        taken = np.stack([np.sum(basis[:, :, None] * slope, axis=0) for basis in self.nodes])
        return Windup(
            self.applied(self.mean, difference) - np.sum(clipped, axis=0),
            self.mean[:, :, None] - taken,
            -np.sum(by_play, axis=0),
        )
