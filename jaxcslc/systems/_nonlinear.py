"""Search for constants that enter nonlinearly, with the coefficients that belong to them.

`_projected_error` is minimised from many starts, then all unknowns together.
"""

import dataclasses
from collections.abc import Sequence
from typing import NamedTuple

import equinox as eqx
import jax
import jax.numpy as jnp
import numpy as np
from jaxtyping import Array, Float

from .._environment import require_float64
from ..least_squares import Equations, Identification, LeastSquares, Unknowns, gauss_newton
from ..recordings import Patterns
from ._constants import ConstantMinimum, ConstantSearch
from ._network import SystemNetwork
from ._projected_error import JudgedError, ProjectedError
from ._system import System
from .description import DescriptionError


# Samples that a search looks at: more would only repeat what smoothing has made alike. The final
# fit looks at all.
_SAMPLES = 1500
_BATCH = 16  # candidates at once
_STEPS = 60  # of a local search
_TRIED = 8  # points that the first weights of outputs are taken from
_TOLERANCE = 1e-7
_REFINED = 8  # candidates that local searches start from
# Minima no further apart than this part of the bounds are one.
_SAME = 1e-4
_AT_BOUND = 1e-5
_FINAL_STEPS = 8


def search_constants(
    system: System,
    patterns: Patterns,
    solver: LeastSquares | None = None,
    *,
    starts: int = 32,
    candidates: int = 512,
    seed: int = 0,
) -> ConstantSearch:
    """Searches the constants that enter nonlinearly, and fits the coefficients that belong to them.

    The extension that thesis 8.2.5 ends with: an equation that is not linear in all its constants.
    For any values of those that enter nonlinearly, the coefficients are the solution of the direct
    solve, so that only the former are searched (variable projection: Golub and Pereyra, SIAM J.
    Numer. Anal. 10, 1973; derivatives after Kaufman, BIT 15, 1975), by Levenberg and Marquardt's
    method of optimistix, within their bounds. A last fit of both together gives standard errors.

    What is lost is the single minimum. Searches start from points spread evenly within the bounds,
    and from the best candidates whose error is less than that of their neighbours (Törn and
    Viitanen's topographical search); the result lists all minima.

    **Arguments**

    - `patterns`: a prepared recording, as by `system_patterns`.
    - `solver`: of the direct solve, with its weights; loss and cutoff count in the last fit.
    - `starts`: evenly spread; `candidates`: evenly spread points at which the error is evaluated.
      More candidates see narrower minima.
    - `seed`: of the points.

    **Returns** values, coefficients, and all minima.

    **Raises**

    - `DescriptionError`: no constant of the system is to be searched.
    - `ValueError`: fewer than one start or candidate.
    - `RuntimeError`: the error is finite for no candidate.

    >>> import numpy as np, sympy
    >>> from jaxcslc.systems import (
    ...     Constant, System, SystemRecording, Variable, search_constants, system_patterns
    ... )
    >>> x, y, a, n = sympy.symbols("x y a n")
    >>> power = System(
    ...     "power law", {"y": sympy.Eq(y, a * x**n)}, (Variable(x), Variable(y)),
    ...     (Constant(a), Constant(n, bounds=(0.2, 2.0))),
    ... )
    >>> t = np.linspace(0, 2, 201)
    >>> recording = SystemRecording(t, {"x": 1 + t, "y": 3 * (1 + t) ** 0.7})
    >>> search = search_constants(power, system_patterns(power, recording), starts=2, candidates=8)
    >>> round(search.values["n"], 6)
    0.7
    """
    if not system.nonlinear:
        raise DescriptionError(
            f"{system.name}: no constant is to be searched; expected some with bounds, as in"
            " Constant(n, bounds=(0.2, 1.0))"
        )
    if starts < 1 or candidates < 1:
        raise ValueError(
            f"starts is {starts} and candidates {candidates}; expected 1 or more of both"
        )
    solver = LeastSquares() if solver is None else solver
    require_float64(patterns.q, patterns.qd, patterns.qdd, patterns.torque)
    low, high = np.array([constant.bounds for constant in system.nonlinear], float).T
    weights = _first_weights(system.network, patterns, solver, (low, high))
    problem = ProjectedError.of(
        system.network, patterns, weights, (low, high), solver.rcond, _SAMPLES
    )
    spread = _spread(starts, len(low), seed)
    points = np.concatenate([spread, _candidates(problem, candidates, seed)])
    ends = [_local_search(problem, x, int(i < starts)) for i, x in enumerate(points)]
    minima = _different(problem, ends)
    if solver.joint_weights == "residual" and len(weights) > 1:
        # Weights by the errors of the best minimum, where those of chance were good enough so far.
        weights = jnp.asarray(_weights_of(minima[0].error))
        problem = eqx.tree_at(lambda p: p.weights, problem, weights)
        points = [_point_of(problem, minimum.values) for minimum in minima]
        ends = [
            _local_search(problem, point, minimum.starts)
            for point, minimum in zip(points, minima, strict=True)
        ]
        minima = _different(problem, ends)
    values, fit = _together(system.network, patterns, solver, minima[0].values, (low, high))
    at_bound = _at_bound(values, low, high)
    return ConstantSearch(
        tuple(constant.name for constant in system.nonlinear),
        fit,
        system.network.with_nonlinear(jnp.asarray(values)),
        minima,
        starts,
        tuple(
            constant.name
            for constant, ends_there in zip(system.nonlinear, at_bound, strict=True)
            if ends_there
        ),
    )


class _End(NamedTuple):
    """End of local searches, and how many of the evenly spread ones ended there."""

    values: Float[np.ndarray, " constants"]
    total: float
    error: Float[np.ndarray, " outputs"]
    starts: int


def _first_weights(
    network: SystemNetwork,
    patterns: Patterns,
    solver: LeastSquares,
    bounds: tuple[Float[np.ndarray, " constants"], Float[np.ndarray, " constants"]],
) -> Float[np.ndarray, " outputs"]:
    """Return the solver's weights; for `"residual"`, by median errors of fits at some points."""
    weights = solver.joint_weights
    outputs = network.joint_count
    if weights == "equal" or (isinstance(weights, str) and outputs == 1):
        return np.ones(outputs)
    if not isinstance(weights, str):
        return np.asarray(weights, float)
    low, high = bounds
    points = low + (high - low) * (0.5 + 0.5 * np.sin(_spread(_TRIED, len(low), 0)))
    plain = dataclasses.replace(solver, loss="squared", errors="independent", cutoff=None)
    fits = [
        np.asarray(plain.fit(network.with_nonlinear(point), patterns, throw=False).torque_error)
        for point in points
    ]
    errors = np.stack(fits)
    errors[:, np.all(np.isnan(errors), axis=0)] = 0.0  # outputs without an equation
    return _weights_of(np.nanmedian(errors, axis=0))


def _weights_of(error: Float[np.ndarray, " outputs"]) -> Float[np.ndarray, " outputs"]:
    """The inverse errors; the largest for an output without one."""
    largest = np.max(error) if np.any(error > 0.0) else 1.0
    return 1.0 / np.where(error > 0.0, error, largest)


def _spread(count: int, constants: int, seed: int) -> Float[np.ndarray, "points constants"]:
    """Evenly spread coordinates of the search, by Sobol's sequence, even in the constants."""
    from scipy.stats import qmc  # takes a second to import

    power = max(count - 1, 0).bit_length()
    part = qmc.Sobol(constants, rng=np.random.default_rng(seed)).random_base2(power)[:count]
    return np.arcsin(2.0 * part - 1.0)


def _point_of(
    problem: ProjectedError, values: Float[np.ndarray, " constants"]
) -> Float[np.ndarray, " constants"]:
    """The coordinates of values."""
    low, high = np.asarray(problem.low), np.asarray(problem.high)
    return np.arcsin(np.clip(2.0 * (values - low) / (high - low) - 1.0, -1.0, 1.0))


def _candidates(
    problem: ProjectedError, count: int, seed: int
) -> Float[np.ndarray, "points constants"]:
    """The best points whose error is less than that of all their neighbours."""
    points = _spread(count, len(problem.low), seed + 1)
    total = np.asarray(_totals(problem, jnp.asarray(points)))
    total = np.where(np.isfinite(total), total, np.inf)
    if not np.any(np.isfinite(total)):
        raise RuntimeError(
            "the error is finite for no values of the searched constants; expected bounds within"
            " which the equations can be evaluated"
        )
    at = np.sin(points)
    neighbours = min(2 * at.shape[1] + 1, count)  # with the point itself
    distance = np.sum((at[:, None] - at[None]) ** 2, axis=-1)
    nearest = np.argsort(distance, axis=1)[:, :neighbours]
    lowest = np.flatnonzero(total <= np.min(total[nearest], axis=1))
    return points[lowest[np.argsort(total[lowest])][:_REFINED]]


@eqx.filter_jit
def _totals(problem: ProjectedError, points: Array) -> Array:
    return jax.lax.map(
        lambda point: problem.judged(problem.values(point)).total, points, batch_size=_BATCH
    )


def _local_search(
    problem: ProjectedError, point: Float[np.ndarray, " constants"], starts: int
) -> _End:
    values, judged = _descended(problem, jnp.asarray(point))
    return _End(np.asarray(values), float(judged.total), np.asarray(judged.error), starts)


@eqx.filter_jit
def _descended(problem: ProjectedError, point: Array) -> tuple[Array, JudgedError]:
    import optimistix  # with its own dependencies, half a second

    solution = optimistix.least_squares(
        lambda point, problem: problem.residual(point),
        optimistix.LevenbergMarquardt(rtol=_TOLERANCE, atol=_TOLERANCE),
        point,
        args=problem,
        max_steps=_STEPS,
        throw=False,
    )
    values = problem.values(solution.value)
    return values, problem.judged(values)


def _different(problem: ProjectedError, ends: Sequence[_End]) -> tuple[ConstantMinimum, ...]:
    """The minima that local searches ended in, the best first."""
    size = np.asarray(problem.high - problem.low)
    groups: list[list[_End]] = []
    for end in sorted((e for e in ends if np.isfinite(e.total)), key=lambda e: e.total):
        for group in groups:
            if np.all(np.abs(end.values - group[0].values) < _SAME * size):
                group.append(end)
                break
        else:
            groups.append([end])
    if not groups:
        raise RuntimeError("no local search ended in a finite error; expected other bounds")
    best = groups[0][0].total
    return tuple(
        ConstantMinimum(
            first.values,
            first.error,
            first.total / best if best > 0.0 else 1.0,
            sum(end.starts for end in (first, *others)),
        )
        for first, *others in groups
    )


def _at_bound(values: np.ndarray, low: np.ndarray, high: np.ndarray) -> np.ndarray:
    margin = _AT_BOUND * (high - low)
    return (values < low + margin) | (values > high - margin)


def _together(
    network: SystemNetwork,
    patterns: Patterns,
    solver: LeastSquares,
    values: Float[np.ndarray, " constants"],
    bounds: tuple[np.ndarray, np.ndarray],
) -> tuple[Float[np.ndarray, " constants"], Identification]:
    """Coefficients and constants that minimise the solver's loss, by Gauss and Newton's method:
    all patterns, and the solver's filter, loss and errors. Constants at a bound stay there."""
    free = np.flatnonzero(~_at_bound(values, *bounds))
    names = [constant.name for constant in network.system.nonlinear]
    unknowns = Unknowns(
        (*network.names, *(names[index] for index in free)),
        tuple(
            (*support, *range(network.size, network.size + len(free)))
            for support in network.support
        ),
    )
    problem = ProjectedError.of(network, patterns, np.ones(network.joint_count), bounds)
    fit = solver.fit(network.with_nonlinear(jnp.asarray(values)), patterns)

    def values_of(k: np.ndarray) -> np.ndarray:
        moved = values.copy()
        moved[free] = np.clip(k[network.size :], *(bound[free] for bound in bounds))
        return moved

    def fitted(k: np.ndarray) -> Identification:
        at = values_of(k)
        rows, torque, slope = _linearised(problem, jnp.asarray(at), jnp.asarray(k[: network.size]))
        columns = np.asarray(slope)[..., free]
        equations = Equations.of(
            unknowns,
            np.concatenate([np.asarray(rows), columns], axis=-1),
            np.asarray(torque) + columns @ at[free],
            np.asarray(patterns.mask),
            time=np.asarray(patterns.time),
            cutoff=solver.cutoff,
        )
        return solver.fit_equations(equations, patterns.samples)

    fit = gauss_newton(fitted, np.append(np.asarray(fit.k), values[free]), _FINAL_STEPS)
    return values_of(np.asarray(fit.k)), fit


@eqx.filter_jit
def _linearised(problem: ProjectedError, values: Array, k: Array) -> tuple[Array, Array, Array]:
    """Regressor, torque, and derivatives by the constants of what coefficients predict beyond the
    torque, (samples, outputs, s)."""

    def excess(values: Array) -> Array:
        network = problem.network.with_nonlinear(values)
        motion = (problem.q, problem.qd, problem.qdd)
        torque = problem.torque + network.known(*motion) - problem.network.known(*motion)
        return network.regressor(*motion) @ k - torque

    network = problem.network.with_nonlinear(values)
    motion = (problem.q, problem.qd, problem.qdd)
    rows = network.regressor(*motion)
    return rows, rows @ k - excess(values), jax.jacfwd(excess)(values)
