"""Torque equations whose columns of static friction follow from slopes."""

import dataclasses
from collections.abc import Sequence

import numpy as np
from jaxtyping import Bool, Float

from ..._rank import rank_tolerance
from ...motion import Patterns
from ...network import CSLC
from ..solver import (
    Equations,
    JointFactors,
    LeastSquares,
    Unknowns,
    minimum_coefficients,
    triangle_of,
)


# One pair in a hundred is slower than what counts as the slowest observed speed: fewer cannot
# separate static friction from dry friction.
_SLOWEST = 0.01
# Slopes this near to a bound, in logarithms, have reached it.
_REACHED = 1e-6
_TWO_COLUMNS = Unknowns(("static friction", "slope"), ((0, 1),))


@dataclasses.dataclass(frozen=True)
class SlopeEquations:
    """Torque equations as a function of the slopes of static friction.

    The unknowns are the network's p coefficients and a relative change of each slope.

    **Attributes**

    - `unknowns`: names and support of both.
    - `base`: the equations for the network's present slopes.
    - `joints`: those with static friction, from 0; `columns`: indices of its coefficients.
    - `slowest`, `fastest`: speeds that a slope of each of these joints can be determined by.
    - `weights`: for each joint, the roots of its equations' weights.
    """

    unknowns: Unknowns
    base: Equations
    joints: tuple[int, ...]
    columns: tuple[int, ...]
    slowest: Float[np.ndarray, " slopes"]
    fastest: Float[np.ndarray, " slopes"]
    weights: tuple[Float[np.ndarray, " _"], ...]
    qd: Float[np.ndarray, "samples joints"]
    mask: Bool[np.ndarray, "samples joints"]
    time: Float[np.ndarray, " samples"]
    cutoff: float | None
    triangles: dict[tuple[int, float], np.ndarray] = dataclasses.field(default_factory=dict)

    @classmethod
    def of(cls, network: CSLC, patterns: Patterns, solver: LeastSquares) -> "SlopeEquations":
        """Of a network with static friction."""
        base = solver.equations(network, patterns)
        columns = tuple(int(index) for index in network.layout.indices("static"))
        joints = tuple(
            next(j for j, support in enumerate(network.support) if column in support)
            for column in columns
        )
        support = list(network.support)
        for i, joint in enumerate(joints):
            support[joint] = (*support[joint], network.size + i)
        names = (*network.names, *(f"slope of {network.output_names[joint]}" for joint in joints))
        qd, mask = np.asarray(patterns.qd), np.asarray(patterns.mask)
        speeds = [np.abs(qd[mask[:, joint], joint]) for joint in joints]
        moving = [speed[speed > 0.0] for speed in speeds]
        return cls(
            Unknowns(names, tuple(support)),
            base,
            joints,
            columns,
            np.array([np.quantile(v, _SLOWEST) if v.size else 0.0 for v in moving]),
            np.array([v.max() if v.size else 0.0 for v in moving]),
            tuple(np.ones(len(rows)) for rows in base.rows),
            qd,
            mask,
            np.asarray(patterns.time),
            solver.cutoff,
        )

    @property
    def joint_count(self) -> int:
        """Number of joints, n."""
        return len(self.base.rows)

    @property
    def samples(self) -> int:
        """Number of samples of the recording."""
        return len(self.time)

    def within_bounds(self, slopes: Float[np.ndarray, " slopes"]) -> Float[np.ndarray, " slopes"]:
        """The nearest slopes whose characteristic speed 1 / slope was observed."""
        return np.where(self.fastest > 0.0, np.clip(slopes, *self.bounds()), slopes)

    def bounds(self) -> tuple[Float[np.ndarray, " slopes"], Float[np.ndarray, " slopes"]]:
        """Compute the least and the greatest slopes; 0 and 1 of joints that never move."""
        some = self.fastest > 0.0
        low = 1.0 / np.where(some, self.fastest, np.inf)
        return low, 1.0 / np.where(some, self.slowest, 1.0)

    def at_bound(self, i: int, slope: float) -> bool:
        """Whether a slope has reached the end of what was observed."""
        if self.fastest[i] <= 0.0:
            return True
        ends = np.log([slope * self.slowest[i], slope * self.fastest[i]])
        return bool(np.min(np.abs(ends)) < _REACHED)

    def reason(self, i: int, slope: float, error: float = np.inf) -> str:
        """Why a joint loses its static friction."""
        joint = self.unknowns.names[i - len(self.joints)].removeprefix("slope of ")
        head = f"{joint}: static friction dropped, its slope is not determined"
        if self.fastest[i] <= 0.0:
            return f"{head} (no pair in motion)"
        if self.at_bound(i, slope):
            return (
                f"{head} (characteristic speed {1.0 / slope:.3g}, at the end of the observed"
                f" speeds {self.slowest[i]:.3g} to {self.fastest[i]:.3g})"
            )
        return f"{head} ({slope:.3g}, standard error {error:.2g})"

    def reweighted(self, roots: Float[np.ndarray, "instants joints"]) -> "SlopeEquations":
        """With other weights of equations, given at the instants of `base.instants()`."""
        _, indices = self.base.instants()
        weights = tuple(roots[at, joint] for joint, at in enumerate(indices))
        return dataclasses.replace(self, weights=weights, triangles={})

    def plain(self, slopes: Float[np.ndarray, " slopes"]) -> Equations:
        """The equations of the coefficients alone, for some slopes."""
        rows = [self._rows(joint, slopes) for joint in range(self.joint_count)]
        with_slope = set(self.joints)
        return Equations(
            self.base.unknowns,
            tuple(
                np.delete(joint_rows, -2, axis=1) if joint in with_slope else joint_rows
                for joint, joint_rows in enumerate(rows)
            ),
            self.base.sample,
        )

    def linearised(
        self, slopes: Float[np.ndarray, " slopes"], heights: Float[np.ndarray, " slopes"]
    ) -> Equations:
        """The equations of coefficients and relative changes of slopes, to first order.

        - `heights`: coefficients of static friction.
        """
        rows = [self._rows(joint, slopes) for joint in range(self.joint_count)]
        for i, joint in enumerate(self.joints):
            rows[joint][:, -2] *= heights[i]
        return Equations(self.unknowns, tuple(rows), self.base.sample)

    def factors(
        self, slopes: Float[np.ndarray, " slopes"], heights: Float[np.ndarray, " slopes"]
    ) -> JointFactors:
        """The factors of `linearised`, weighted; heights of zero leave slopes as they are."""
        triangles: list[np.ndarray] = []
        slope_of = dict(zip(self.joints, slopes.tolist(), strict=True))
        for joint in range(self.joint_count):
            key = (joint, slope_of.get(joint, 0.0))
            if key not in self.triangles:
                rows = self._rows(joint, slopes) * self.weights[joint][:, None]
                self.triangles[key] = triangle_of(rows)
            triangles.append(self.triangles[key])
        for i, joint in enumerate(self.joints):
            triangles[joint] = triangles[joint].copy()
            triangles[joint][:, -2] *= heights[i]
        return JointFactors(tuple(triangles), np.array([float(len(x)) for x in self.base.rows]))

    def projected(
        self,
        slopes: Float[np.ndarray, " slopes"],
        weights: Float[np.ndarray, " joints"],
        rcond: float | None,
    ) -> tuple[Float[np.ndarray, " rows"], Float[np.ndarray, "rows slopes"]]:
        """Compute what the best coefficients leave, and its derivatives by logarithms of slopes.

        Derivatives after Kaufman (BIT 15, 1975). Both are in a basis that turns with the slopes:
        lengths and products count.
        """
        count, p = len(self.joints), self.unknowns.size - len(self.joints)
        factors = self.factors(slopes, np.ones(count))
        k = minimum_coefficients(
            self.unknowns, self.factors(slopes, np.zeros(count)), weights, rcond
        ).k
        rows = factors.stacked(self.unknowns, weights)
        columns, torque = np.asarray(rows[:, :p]), np.asarray(rows[:, -1])
        changes = np.asarray(rows[:, p:-1]) * k[list(self.columns)]
        scale = np.linalg.norm(columns, axis=0)
        basis, singular, _ = np.linalg.svd(
            columns / np.where(scale > 0.0, scale, 1.0), full_matrices=False
        )
        equations = float(np.sum(factors.counts))
        basis = basis[:, singular > rank_tolerance(p, equations, rcond) * singular[0]]
        return (
            torque - basis @ (basis.T @ torque),
            basis @ (basis.T @ changes) - changes,
        )

    def _rows(self, joint: int, slopes: Sequence[float] | np.ndarray) -> np.ndarray:
        """The equations of a joint: coefficients, the change of its slope if it has one, torque."""
        rows = self.base.rows[joint]
        if joint not in self.joints:
            return rows
        i = self.joints.index(joint)
        speed, slope = np.abs(self.qd[:, joint]), slopes[i]
        static = np.sign(self.qd[:, joint]) * np.exp(-slope * speed)
        inputs = np.stack([static, -slope * speed * static], axis=-1)[:, None, :]
        slope_rows = Equations.of(
            _TWO_COLUMNS,
            inputs,
            np.zeros((len(static), 1)),
            self.mask[:, [joint]],
            time=self.time,
            cutoff=self.cutoff,
        ).rows[0]
        column = self.base.unknowns.support[joint].index(self.columns[i])
        rows = np.concatenate([rows[:, :-1], slope_rows[:, 1:2], rows[:, -1:]], axis=1)
        rows[:, column] = slope_rows[:, 0]
        return rows
