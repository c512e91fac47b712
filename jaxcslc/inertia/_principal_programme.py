import itertools
from dataclasses import dataclass
from functools import cached_property

import numpy as np
from jaxtyping import Float

from ..manipulator import LinkInertia
from ._bodies import body_of_pseudo_inertia, central_tensor, principal_body, pseudo_inertia


_TOLERANCE = 1e-10
_EVALUATIONS = 300
_LOWER = [(a, b) for a in range(4) for b in range(a + 1)]


@dataclass(frozen=True, eq=False)
class BodyChart:
    """Coordinates of a body, each of order one, that are possible wherever their bounds hold.

    A link with principal axes: mass, coordinates of the centre, and spread of mass along each
    axis, equal spreads as one. A full tensor: a triangle M with J̃ = M Mᵀ + least, in units of
    the prior's pseudo-inertia.

    **Attributes**

    - `prior`: ten numbers of the body at `start`.
    - `scale`: triangular factor of the prior's pseudo-inertia.
    - `start`, `low`: coordinates of the prior, and lower bounds.
    - `least`: part of the prior that every body holds at least.
    - `centre`: axes along which the centre is free.
    - `spreads`: axes that share a spread; () for a full tensor.
    """

    prior: Float[np.ndarray, "10"]
    scale: Float[np.ndarray, "4 4"]
    start: Float[np.ndarray, " coordinates"]
    low: Float[np.ndarray, " coordinates"]
    least: float
    centre: tuple[int, ...] = ()
    spreads: tuple[tuple[int, ...], ...] = ()

    @classmethod
    def from_prior(
        cls, inertia: LinkInertia, prior: Float[np.ndarray, "10"], least: float
    ) -> "BodyChart":
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

    def body(self, z: Float[np.ndarray, " coordinates"]) -> Float[np.ndarray, "10"]:
        """Ten numbers of the body with coordinates z."""
        if not self.spreads:
            lower = self._lower(z)
            return self._from_unit(lower @ lower.T + self.least * np.eye(4))
        mass, centre, spread = self._principal(z)
        return principal_body(mass, centre, spread)

    def jacobian(self, z: Float[np.ndarray, " coordinates"]) -> Float[np.ndarray, "10 coordinates"]:
        """Derivatives of the ten numbers by the coordinates."""
        columns: list[np.ndarray] = []
        if not self.spreads:
            lower = self._lower(z)
            for a, b in _LOWER:
                change = np.zeros((4, 4))
                change[a] = lower[:, b]
                columns.append(self._from_unit(change + change.T))
            return np.stack(columns, axis=1)
        mass, centre, _ = self._principal(z)
        full, radius = np.append(centre, 1.0), self._radius
        columns.append(self.prior[9] * body_of_pseudo_inertia(np.outer(full, full)))
        for axis in self.centre:
            change = np.zeros((4, 4))
            change[axis] = mass * radius * full
            columns.append(body_of_pseudo_inertia(change + change.T))
        return np.stack([*columns, *self._by_spread], axis=1)

    @cached_property
    def _by_spread(self) -> list[Float[np.ndarray, "10"]]:
        """Derivatives of the ten numbers by the spreads, which they are linear in."""
        columns: list[np.ndarray] = []
        for axes in self.spreads:
            change = np.zeros((4, 4))
            change[list(axes), list(axes)] = np.mean(self._prior_spread[list(axes)])
            columns.append(body_of_pseudo_inertia(change))
        return columns

    def _principal(
        self, z: Float[np.ndarray, " coordinates"]
    ) -> tuple[float, Float[np.ndarray, "3"], Float[np.ndarray, "3"]]:
        centre, spread = self.prior[6:9] / self.prior[9], self._prior_spread.copy()
        centre[list(self.centre)] += self._radius * z[1 : 1 + len(self.centre)]
        for value, axes in zip(z[1 + len(self.centre) :], self.spreads, strict=True):
            spread[list(axes)] = value * np.mean(spread[list(axes)])
        return float(z[0] * self.prior[9]), centre, spread

    @cached_property
    def _prior_spread(self) -> Float[np.ndarray, "3"]:
        moments = np.diag(central_tensor(self.prior))
        return np.sum(moments) / 2 - moments

    @cached_property
    def _radius(self) -> float:
        return float(np.sqrt(np.sum(self._prior_spread) / self.prior[9]))

    def _lower(self, z: Float[np.ndarray, " coordinates"]) -> Float[np.ndarray, "4 4"]:
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
    weights: Float[np.ndarray, " unknowns"],
) -> tuple[Float[np.ndarray, "links 10"], Float[np.ndarray, " others"], bool]:
    """min |of_bodies · bodies + of_others · y - target|² + |weights (z - start)|², z the bodies'
    coordinates and y; bodies possible, y ≥ 0 where `bounded`. Not convex; the search starts at
    the prior.

    **Returns**

    - Bodies, y, and whether the search converged.
    """
    from scipy.optimize import least_squares  # half a second to import

    start = np.concatenate(
        [
            *(chart.start for chart in charts),
            np.where(bounded > 0, np.maximum(others, 1e-3), others),
        ]
    )
    wanted = np.concatenate([*(chart.start for chart in charts), others])
    low = np.concatenate([*(chart.low for chart in charts), np.where(bounded > 0, 0.0, -np.inf)])
    edges = np.cumsum([0, *(len(chart.start) for chart in charts)])
    slices = [slice(a, b) for a, b in itertools.pairwise(edges)]

    def bodies(z: np.ndarray) -> np.ndarray:
        return np.stack([c.body(z[part]) for c, part in zip(charts, slices, strict=True)])

    def residual(z: np.ndarray) -> np.ndarray:
        change = np.einsum("rle,le->r", of_bodies, bodies(z)) + of_others @ z[edges[-1] :] - target
        return np.concatenate([change, weights * (z - wanted)])

    def jacobian(z: np.ndarray) -> np.ndarray:
        blocks = [
            of_bodies[:, i] @ chart.jacobian(z[part])
            for i, (chart, part) in enumerate(zip(charts, slices, strict=True))
        ]
        return np.concatenate([np.concatenate([*blocks, of_others], axis=1), np.diag(weights)])

    optimum = least_squares(
        residual,
        start,
        jacobian,
        bounds=(low, np.full(len(low), np.inf)),
        ftol=_TOLERANCE,
        xtol=_TOLERANCE,
        gtol=_TOLERANCE,
        max_nfev=_EVALUATIONS,
    )
    return bodies(optimum.x), optimum.x[edges[-1] :], optimum.status > 0
