import itertools
from dataclasses import dataclass

import numpy as np
from jaxtyping import Float
from scipy.optimize import least_squares

from ..manipulator import LinkInertia
from ._bodies import body_of_pseudo_inertia, central_tensor, principal_body, pseudo_inertia


_TOLERANCE = 1e-10
_EVALUATIONS = 300
_LOWER = [(a, b) for a in range(4) for b in range(a + 1)]


@dataclass(frozen=True, eq=False)
class BodyChart:
    """A body in numbers of the size of one that bounds alone keep possible.

    A link with principal axes: mass, coordinates of the centre, and spread of mass along each
    axis, equal spreads as one. A full tensor: a triangle M with J̃ = M Mᵀ + least, in units of
    the prior's pseudo-inertia. Both are the prior at `start`.
    """

    prior: Float[np.ndarray, "10"]
    scale: Float[np.ndarray, "4 4"]
    start: Float[np.ndarray, " numbers"]
    low: Float[np.ndarray, " numbers"]
    least: float
    centre: tuple[int, ...] = ()  # axes along which the centre is free
    spreads: tuple[tuple[int, ...], ...] = ()  # axes that share a spread; () for a full tensor

    @classmethod
    def of(cls, inertia: LinkInertia, prior: Float[np.ndarray, "10"], least: float) -> "BodyChart":
        scale = np.linalg.cholesky(pseudo_inertia(prior))
        if inertia.form == "full":
            start = np.array([np.sqrt(1 - least) if a == b else 0.0 for a, b in _LOWER])
            return cls(prior, scale, start, np.full(10, -np.inf), least)
        centre = tuple(i for i, axis in enumerate("xyz") if f"r{axis}" not in inertia.zero)
        same = [{axis} for axis in range(3)]
        for pair in inertia.equal:
            first, second = ("xyz".index(moment[1]) for moment in pair)
            joined = same[first] | same[second]
            for axis in joined:
                same[axis] = joined
        spreads = tuple(sorted({tuple(sorted(axes)) for axes in same}))
        start = np.array([1.0, *(0.0 for _ in centre), *(1.0 for _ in spreads)])
        low = np.array([least, *(-np.inf for _ in centre), *(least for _ in spreads)])
        return cls(prior, scale, start, low, least, centre, spreads)

    def body(self, z: Float[np.ndarray, " numbers"]) -> Float[np.ndarray, "10"]:
        if not self.spreads:
            lower = self._lower(z)
            return self._from_unit(lower @ lower.T + self.least * np.eye(4))
        mass, centre, spread = self._principal(z)
        return principal_body(mass, centre, spread)

    def slope(self, z: Float[np.ndarray, " numbers"]) -> Float[np.ndarray, "10 numbers"]:
        columns: list[np.ndarray] = []
        if not self.spreads:
            lower = self._lower(z)
            for a, b in _LOWER:
                change = np.zeros((4, 4))
                change[a] = lower[:, b]
                columns.append(self._from_unit(change + change.T))
            return np.stack(columns, axis=1)
        mass, centre, _ = self._principal(z)
        full, radius = np.append(centre, 1.0), self._radius()
        columns.append(self.prior[9] * body_of_pseudo_inertia(np.outer(full, full)))
        for axis in self.centre:
            change = np.zeros((4, 4))
            change[axis] = mass * radius * full
            columns.append(body_of_pseudo_inertia(change + change.T))
        sizes = self._prior_spread()
        for axes in self.spreads:
            change = np.zeros((4, 4))
            change[list(axes), list(axes)] = np.mean(sizes[list(axes)])
            columns.append(body_of_pseudo_inertia(change))
        return np.stack(columns, axis=1)

    def _principal(
        self, z: Float[np.ndarray, " numbers"]
    ) -> tuple[float, Float[np.ndarray, "3"], Float[np.ndarray, "3"]]:
        centre, spread = self.prior[6:9] / self.prior[9], self._prior_spread()
        centre[list(self.centre)] += self._radius() * z[1 : 1 + len(self.centre)]
        for value, axes in zip(z[1 + len(self.centre) :], self.spreads, strict=True):
            spread[list(axes)] = value * np.mean(spread[list(axes)])
        return float(z[0] * self.prior[9]), centre, spread

    def _prior_spread(self) -> Float[np.ndarray, "3"]:
        moments = np.diag(central_tensor(self.prior))
        return np.sum(moments) / 2 - moments

    def _radius(self) -> float:
        return float(np.sqrt(np.sum(self._prior_spread()) / self.prior[9]))

    def _lower(self, z: Float[np.ndarray, " numbers"]) -> Float[np.ndarray, "4 4"]:
        lower = np.zeros((4, 4))
        for value, (a, b) in zip(z, _LOWER, strict=True):
            lower[a, b] = value
        return lower

    def _from_unit(self, unit: Float[np.ndarray, "4 4"]) -> Float[np.ndarray, "10"]:
        matrix = self.scale @ unit @ self.scale.T
        return body_of_pseudo_inertia((matrix + matrix.T) / 2)


def nearest_in_charts(
    charts: list[BodyChart],
    of_bodies: Float[np.ndarray, "rows links 10"],
    of_others: Float[np.ndarray, "rows others"],
    target: Float[np.ndarray, " rows"],
    others: Float[np.ndarray, " others"],
    bounded: Float[np.ndarray, " others"],
    weight: float,
) -> tuple[Float[np.ndarray, "links 10"], Float[np.ndarray, " others"], bool]:
    """min |of_bodies · bodies + of_others · y - target|² + weight² |numbers - start|², bodies
    possible, y ≥ 0 where `bounded`. Not convex; the search starts at the prior.

    **Returns** bodies, y, and whether the search settled.
    """
    start = np.concatenate(
        [
            *(chart.start for chart in charts),
            np.where(bounded > 0, np.maximum(others, 1e-3), others),
        ]
    )
    wanted = np.concatenate([*(chart.start for chart in charts), others])
    low = np.concatenate([*(chart.low for chart in charts), np.where(bounded > 0, 0.0, -np.inf)])
    edges = np.cumsum([0, *(len(chart.start) for chart in charts)])
    places = [slice(a, b) for a, b in itertools.pairwise(edges)]

    def bodies(z: np.ndarray) -> np.ndarray:
        return np.stack([c.body(z[at]) for c, at in zip(charts, places, strict=True)])

    def residual(z: np.ndarray) -> np.ndarray:
        change = np.einsum("rle,le->r", of_bodies, bodies(z)) + of_others @ z[edges[-1] :] - target
        return np.concatenate([change, weight * (z - wanted)])

    def jacobian(z: np.ndarray) -> np.ndarray:
        blocks = [
            of_bodies[:, i] @ chart.slope(z[at])
            for i, (chart, at) in enumerate(zip(charts, places, strict=True))
        ]
        return np.concatenate(
            [np.concatenate([*blocks, of_others], axis=1), weight * np.eye(len(z))]
        )

    found = least_squares(
        residual,
        start,
        jacobian,
        bounds=(low, np.full(len(low), np.inf)),
        ftol=_TOLERANCE,
        xtol=_TOLERANCE,
        gtol=_TOLERANCE,
        max_nfev=_EVALUATIONS,
    )
    return bodies(found.x), found.x[edges[-1] :], found.status > 0
