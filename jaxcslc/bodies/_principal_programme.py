"""Search for consistent bodies with principal axes, in coordinates that keep them consistent.

The search is Levenberg and Marquardt's within bounds (`bounded_least_squares`).
"""

import itertools
from collections.abc import Callable, Sequence
from dataclasses import dataclass
from functools import cached_property
from typing import NamedTuple

import numpy as np
from jaxtyping import Bool, Float

from ..manipulator import LinkInertia
from ._body import ENTRIES, MASS, MOMENT, body_of_pseudo_inertia, central_tensor, pseudo_inertia


_TOLERANCE = 1e-10
_EVALUATIONS = 400
_LOWER = [(a, b) for a in range(4) for b in range(a + 1)]


@dataclass(frozen=True, eq=False)
class BodyChart:
    """Coordinates of a body, each of order one, that are possible wherever their bounds hold.

    A link with principal axes (`_Charts` evaluates it): mass, coordinates of the centre, and spread
    of mass along each axis, equal spreads as one. A full tensor: a triangle M with J̃ = M Mᵀ +
    least, in units of the prior's pseudo-inertia.

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
        """Ten numbers of the body with a full tensor that has coordinates z."""
        lower = self._lower(z)
        return self._from_unit(lower @ lower.T + self.least * np.eye(4))

    def jacobian(self, z: Float[np.ndarray, " coordinates"]) -> Float[np.ndarray, "10 coordinates"]:
        """Derivatives of a full tensor's ten numbers by the coordinates."""
        lower = self._lower(z)
        columns: list[np.ndarray] = []
        for a, b in _LOWER:
            change = np.zeros((4, 4))
            change[a] = lower[:, b]
            columns.append(self._from_unit(change + change.T))
        return np.stack(columns, axis=1)

    @cached_property
    def by_spread(self) -> list[Float[np.ndarray, "10"]]:
        """Derivatives of the ten numbers by the spreads, which they are linear in."""
        columns: list[np.ndarray] = []
        for axes in self.spreads:
            change = np.zeros((4, 4))
            change[list(axes), list(axes)] = np.mean(self._prior_spread[list(axes)])
            columns.append(body_of_pseudo_inertia(change))
        return columns

    @cached_property
    def _prior_spread(self) -> Float[np.ndarray, "3"]:
        moments = np.diag(central_tensor(self.prior))
        return np.sum(moments) / 2 - moments

    @cached_property
    def radius(self) -> float:
        """Radius of gyration: unit of the coordinates of a centre."""
        return float(np.sqrt(np.sum(self._prior_spread) / self.prior[MASS]))

    def _lower(self, z: Float[np.ndarray, " coordinates"]) -> Float[np.ndarray, "4 4"]:
        lower = np.zeros((4, 4))
        for value, (a, b) in zip(z, _LOWER, strict=True):
            lower[a, b] = value
        return lower

    def _from_unit(self, unit: Float[np.ndarray, "4 4"]) -> Float[np.ndarray, "10"]:
        matrix = self.scale @ unit @ self.scale.T
        return body_of_pseudo_inertia((matrix + matrix.T) / 2)


# What multiplies the sixteen entries of a pseudo-inertia in its ten numbers.
_NUMBERS = np.stack(
    [body_of_pseudo_inertia(unit.reshape(4, 4)) for unit in np.eye(ENTRIES)], axis=1
)
_MOST = 7  # coordinates of a chart with principal axes


class _Charts:
    """Charts of all links, those with principal axes in a few products.

    A search evaluates them some hundred times, and link by link NumPy's calls took four fifths of
    its time.
    """

    def __init__(self, charts: Sequence[BodyChart]) -> None:
        self.charts = charts
        edges = np.cumsum([0, *(len(chart.start) for chart in charts)])
        self.size = int(edges[-1])
        self._parts = [slice(a, b) for a, b in itertools.pairwise(edges)]
        self._principal = [i for i, chart in enumerate(charts) if chart.spreads]
        self._full = [i for i, chart in enumerate(charts) if not chart.spreads]
        principal = [charts[i] for i in self._principal]
        # Where in (links, mass and centre and spreads) each coordinate is.
        slots = [
            [0, *(1 + axis for axis in c.centre), *range(4, 4 + len(c.spreads))] for c in principal
        ]
        self._slots = np.array([_MOST * i + s for i, row in enumerate(slots) for s in row], int)
        self._from = np.array(
            [j for i in self._principal for j in range(edges[i], edges[i + 1])], int
        )
        self._mass = np.array([c.prior[MASS] for c in principal])
        self._centre = np.array([c.prior[MOMENT] / c.prior[MASS] for c in principal]).reshape(-1, 3)
        self._radius = np.array([c.radius for c in principal])
        self._by_spread = np.zeros((len(principal), 10, 3))
        for of_link, c in zip(self._by_spread, principal, strict=True):
            of_link[:, : len(c.spreads)] = np.stack(c.by_spread, axis=1)

    def bodies(self, z: Float[np.ndarray, " unknowns"]) -> Float[np.ndarray, "links 10"]:
        """Ten numbers of each body; unknowns behind the coordinates are not used."""
        bodies = np.empty((len(self.charts), 10))
        mass, full, spread = self._of_principal(z)
        outer = (full[:, :, None] * full[:, None, :]).reshape(-1, ENTRIES)
        bodies[self._principal] = (self._by_spread @ spread[:, :, None])[:, :, 0]
        bodies[self._principal] += mass[:, None] * (outer @ _NUMBERS.T)
        for i in self._full:
            bodies[i] = self.charts[i].body(z[self._parts[i]])
        return bodies

    def columns(
        self, of_bodies: Float[np.ndarray, "links rows 10"], z: Float[np.ndarray, " unknowns"]
    ) -> Float[np.ndarray, "rows coordinates"]:
        """Derivatives by the coordinates of what is linear in the bodies."""
        mass, full, _ = self._of_principal(z)
        by_entry = np.zeros((len(mass), _MOST, 4, 4))
        by_entry[:, 0] = self._mass[:, None, None] * full[:, :, None] * full[:, None, :]
        moved = (mass * self._radius)[:, None] * full
        for axis in range(3):
            by_entry[:, 1 + axis, axis] += moved
            by_entry[:, 1 + axis, :, axis] += moved
        numbers = by_entry.reshape(-1, _MOST, ENTRIES) @ _NUMBERS.T
        numbers[:, 4:] = np.swapaxes(self._by_spread, 1, 2)
        columns = np.empty((of_bodies.shape[1], self.size))
        products = of_bodies[self._principal] @ np.swapaxes(numbers, 1, 2)
        stacked = np.moveaxis(products, 0, 1).reshape(of_bodies.shape[1], -1)
        columns[:, self._from] = stacked[:, self._slots]
        for i in self._full:
            columns[:, self._parts[i]] = of_bodies[i] @ self.charts[i].jacobian(z[self._parts[i]])
        return columns

    def _of_principal(
        self, z: Float[np.ndarray, " unknowns"]
    ) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
        """Masses, centres with a one behind, and coordinates of the spreads."""
        slots = np.zeros((len(self._principal), _MOST))
        slots.flat[self._slots] = z[self._from]
        centre = self._centre + self._radius[:, None] * slots[:, 1:4]
        full = np.concatenate([centre, np.ones((len(centre), 1))], axis=1)
        return self._mass * slots[:, 0], full, slots[:, 4:]


def nearest_in_charts(
    charts: list[BodyChart],
    of_bodies: Float[np.ndarray, "rows links 10"],
    of_others: Float[np.ndarray, "rows others"],
    target: Float[np.ndarray, " rows"],
    others: Float[np.ndarray, " others"],
    bounded: Float[np.ndarray, " others"],
    weights: Float[np.ndarray, " unknowns"],
) -> tuple[Float[np.ndarray, "links 10"], Float[np.ndarray, " others"], bool]:
    """Find the physically consistent bodies nearest to a target, in coordinates of charts.

    Minimises |of_bodies · bodies + of_others · y - target|² + |weights (z - start)|². z are the
    bodies' coordinates and y; y ≥ 0 where `bounded`. The problem is not convex; the search starts
    at the prior. **Returns** bodies, y, and whether the search converged.
    """
    start = np.concatenate(
        [
            *(chart.start for chart in charts),
            np.where(bounded > 0, np.maximum(others, 1e-3), others),
        ]
    )
    wanted = np.concatenate([*(chart.start for chart in charts), others])
    low = np.concatenate([*(chart.low for chart in charts), np.where(bounded > 0, 0.0, -np.inf)])
    together = _Charts(charts)
    by_link = np.ascontiguousarray(np.swapaxes(of_bodies, 0, 1))
    flat, size = of_bodies.reshape(len(of_bodies), -1), together.size

    def residual(z: np.ndarray) -> np.ndarray:
        change = flat @ together.bodies(z).ravel() + of_others @ z[size:] - target
        return np.concatenate([change, weights * (z - wanted)])

    def jacobian(z: np.ndarray) -> np.ndarray:
        columns = np.concatenate([together.columns(by_link, z), of_others], axis=1)
        return np.concatenate([columns, np.diag(weights)])

    # SciPy's dogleg stops early on PUMA A's bodies: their held-out RMS was 1.4 times the free fit's
    # instead of 0.98 (reference puma_a of scripts.tools.references). Its reflective method takes
    # fifteen times as long.
    optimum = bounded_least_squares(
        residual, jacobian, start, low, tolerance=_TOLERANCE, evaluations=_EVALUATIONS
    )
    return together.bodies(optimum.x), optimum.x[size:], optimum.converged


Vector = Float[np.ndarray, " unknowns"]

# Damping, added to the diagonal of the normal equations: at first, and its least.
_DAMPING, _LEAST_DAMPING = 1e-3, 1e-12
# A step that keeps less or more than these parts of what it promised changes the damping.
_POOR, _GOOD = 0.25, 0.75
_GROWTH, _DECAY = 2.0, 5.0


class BoundedMinimum(NamedTuple):
    """Minimum of a sum of squares within bounds, its value, and whether the search converged."""

    x: Vector
    value: float
    converged: bool


def bounded_least_squares(
    residual: Callable[[Vector], Float[np.ndarray, " rows"]],
    jacobian: Callable[[Vector], Float[np.ndarray, "rows unknowns"]],
    start: Vector,
    low: Vector,
    *,
    tolerance: float,
    evaluations: int,
) -> BoundedMinimum:
    """Minimise |residual(x)|² within x ≥ low: Levenberg and Marquardt's method with an active set.

    Unknowns at their bound whose gradient points outwards stay there; others that a step would
    carry beyond theirs stop at it, and the step is computed anew for those that remain. (Marquardt
    1963.)

    - `jacobian`: of full rank; unknowns are of order one.
    - `tolerance`: the search ends where a step promises less than this part of the value, or moves
      the unknowns by less than this part of their length.
    - `evaluations`: of the residual, at most.
    """
    x = np.maximum(start, low)
    errors = residual(x)
    value, damping = float(errors @ errors), _DAMPING
    columns = jacobian(x)
    for _ in range(evaluations - 1):
        gradient, normal = columns.T @ errors, columns.T @ columns
        at_bound = (x <= low) & (gradient >= 0.0)
        damped = normal + damping * np.eye(len(x))
        step = _step(damped, gradient, low - x, at_bound)
        promise = -float(step @ (2.0 * gradient + normal @ step))
        if promise <= tolerance * value and damping <= _DAMPING:
            return BoundedMinimum(x, value, True)
        if np.linalg.norm(step) <= tolerance * (tolerance + np.linalg.norm(x)):
            return BoundedMinimum(x, value, True)
        moved = np.maximum(x + step, low)
        errors_there = residual(moved)
        value_there = float(errors_there @ errors_there)
        part = (value - value_there) / promise if promise > 0.0 else 0.0
        if not part >= _POOR:
            damping *= _GROWTH
        elif part > _GOOD:
            damping = max(damping / _DECAY, _LEAST_DAMPING)
        if value_there < value:
            x, errors, value = moved, errors_there, value_there
            columns = jacobian(x)
    return BoundedMinimum(x, value, False)


def _step(
    matrix: Float[np.ndarray, "unknowns unknowns"],
    gradient: Vector,
    least: Vector,
    at_bound: Bool[np.ndarray, " unknowns"],
) -> Vector:
    """The step that solves the damped normal equations and is nowhere less than `least`."""
    step, free = np.zeros(len(gradient)), ~at_bound
    while np.any(free):
        inner = np.ix_(free, free)
        target = gradient[free] + matrix[np.ix_(free, ~free)] @ step[~free]
        step[free] = -np.linalg.solve(matrix[inner], target)
        beyond = free & (step < least)
        if not np.any(beyond):
            break
        step[beyond] = least[beyond]
        free &= ~beyond
    return step
