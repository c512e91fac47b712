"""Search for constants that enter nonlinearly, with the coefficients that belong to them.

`search_constants` minimises a `ProjectedError`, in which coefficients are eliminated, from many
starts; then all unknowns are fitted together. A `ConstantSearch` is the result.
"""

import dataclasses
from collections.abc import Mapping, Sequence

import equinox as eqx
import jax
import jax.numpy as jnp
import numpy as np
from jaxtyping import Array, Float

from .._environment import require_float64
from ..least_squares import (
    Equations,
    Identification,
    JointFactors,
    LeastSquares,
    Solution,
    Unknowns,
    gauss_newton,
    minimum,
)
from ..recordings import Patterns
from ._description import DescriptionError
from ._network import SystemNetwork
from ._system import System


# Samples that a search looks at: more would only repeat what smoothing has made alike. The final
# fit looks at all.
_SAMPLES = 1500
_TOLERANCE = 1e-7  # of a local search, relative
_REFINED = 8  # candidates that local searches start from
_SAME = 1e-4  # of the bounds: minima no further apart are one
_AT_BOUND = 1e-5  # of the bounds: a constant no further from one of them ends there
_SHOWN = 6  # minima in a text


@dataclasses.dataclass(frozen=True)
class ConstantMinimum:
    """A minimum of the error over the constants that enter nonlinearly.

    **Attributes**

    - `values`: (s,) of the constants.
    - `error`: (n,) root mean square error of each output there, with the best coefficients.
    - `ratio`: error over that of the best minimum, of all outputs as they are weighted.
    - `starts`: how many of the evenly spread starts ended in it.
    """

    values: Float[np.ndarray, " constants"]
    error: Float[np.ndarray, " outputs"]
    ratio: float
    starts: int


@dataclasses.dataclass(frozen=True)
class ConstantSearch:
    """Constants that enter nonlinearly, with the coefficients that belong to them.

    **Attributes**

    - `fit`: coefficients and constants together, in this order, with standard errors that allow
      for each other; its last s names are those of the constants, without those `at_bound`.
    - `network`: the system's, with the constants at their values.
    - `minima`: all different ones, the best first.
    - `starts`: how many starts were spread evenly within the bounds.
    """

    fit: Identification
    network: SystemNetwork
    minima: tuple[ConstantMinimum, ...]
    starts: int

    @property
    def names(self) -> tuple[str, ...]:
        """Names of the s constants."""
        return tuple(constant.name for constant in self.network.system.nonlinear)

    @property
    def at_bound(self) -> tuple[str, ...]:
        """Names of constants that ended at one of their bounds."""
        return tuple(name for name in self.names if name not in self.fit.names)

    @property
    def coefficients(self) -> Identification:
        """The coefficients alone; their errors allow for those of the constants."""
        p, fit = self.network.size, self.fit
        rows = {name: getattr(fit, name)[:p] for name in ("k", "standard_error", "determined")}
        squares = ("covariance", "independent_covariance", "undetermined")
        return dataclasses.replace(
            fit,
            names=self.network.names,
            **rows,
            **{name: getattr(fit, name)[:p, :p] for name in squares},
        )

    @property
    def values(self) -> Mapping[str, float]:
        """The constants by name."""
        return dict(zip(self.names, np.asarray(self.network.nonlinear).tolist(), strict=True))

    def with_known_sides(self, patterns: Patterns) -> Patterns:
        """Return patterns whose known sides belong to the values of the constants.

        **Arguments**

        - `patterns`: of the system, as by `system_patterns`.
        """
        motion = tuple(np.asarray(x) for x in (patterns.q, patterns.qd, patterns.qdd))
        before = self.network.system.network.known(*motion)
        torque = np.asarray(patterns.torque + self.network.known(*motion) - before)
        return dataclasses.replace(patterns, torque=torque)

    @property
    def unexplored(self) -> float:
        """The part of the bounds, expected, from which starts would end in further minima.

        w (w + 1) / (N (N - 1)) for N starts that ended in w different minima (Boender and Rinnooy
        Kan, 'Bayesian stopping rules for multistart global optimization methods', Mathematical
        Programming 37, 1987).
        """
        different = sum(minimum.starts > 0 for minimum in self.minima)
        return min(1.0, different * (different + 1) / (self.starts * max(self.starts - 1, 1)))

    def __str__(self) -> str:
        error = dict(zip(self.fit.names, np.asarray(self.fit.standard_error), strict=True))
        width = max(map(len, self.names))
        lines = [
            f"{name:<{width}}  {value:>11.5g}"
            + (f" ± {error[name]:.2g}" if name in error else "  at its bound")
            for name, value in self.values.items()
        ]
        first, *others = self.minima
        text = (
            f"The equations are not linear in {', '.join(self.names)}: a single minimum is no"
            f" longer certain. {first.starts} of {self.starts} starts ended in the best minimum"
        )
        if not others:
            return "\n".join([*lines, f"{text}; no other was seen."])
        listed = "; ".join(
            ", ".join(
                f"{name} = {value:.4g}"
                for name, value in zip(self.names, minimum.values, strict=True)
            )
            + f" (error {minimum.ratio:.4g} times as large)"
            for minimum in others[:_SHOWN]
        )
        more = f"; and {len(others) - _SHOWN} more" if len(others) > _SHOWN else ""
        lines.append(
            f"{text}, {100 * self.unexplored:.2g} % of the bounds may lead to minima not seen."
            f" Others: {listed}{more}."
        )
        return "\n".join(lines)


class ProjectedError(eqx.Module):
    """The error as a function of the nonlinear constants, coefficients eliminated.

    Weights of outputs are the same for all values of the constants. Each output's error at these
    values would be the wrong weight: an equation whose known side is zero has an error that the
    constants themselves scale, and the search would shrink it (the flow between two tanks to a
    power of their levels: the error's logarithm fell by 0.4 from the true 0.5 to the bound of 0.1).

    - `network`: with the constants that the patterns' known sides were computed with.
    - `patterns`: some or all of the recording's.
    - `weights`: of outputs.
    """

    network: SystemNetwork
    patterns: Patterns
    weights: Float[Array, " outputs"]
    rcond: float | None = eqx.field(static=True)

    @classmethod
    def of(
        cls,
        network: SystemNetwork,
        patterns: Patterns,
        weights: Float[np.ndarray, " outputs"],
        rcond: float | None = None,
        samples: int | None = None,
    ) -> "ProjectedError":
        """Return the error on patterns, or on at most `samples` of them, evenly spread in time."""
        step = 1 if samples is None else -(-patterns.samples // samples)
        some = jax.tree.map(lambda x: jnp.asarray(x[::step]), patterns)
        return cls(network, some, jnp.asarray(weights), rcond)

    def weighted(self, error: Float[np.ndarray, " outputs"]) -> "ProjectedError":
        """Return the problem with weights by errors; the largest for an output without one."""
        largest = np.max(error) if np.any(error > 0.0) else 1.0
        weights = jnp.asarray(1.0 / np.where(error > 0.0, error, largest))
        return eqx.tree_at(lambda problem: problem.weights, self, weights)

    def values(self, point: Float[Array, " constants"]) -> Float[Array, " constants"]:
        """Constants from coordinates of the search: any real number is within the bounds."""
        low, high = map(jnp.asarray, _bounds(self.network.system))
        return low + (high - low) * (0.5 + 0.5 * jnp.sin(point))

    def at(
        self, values: Float[Array, " constants"]
    ) -> tuple[Float[Array, "samples outputs _"], Float[Array, "samples outputs"]]:
        """Return regressor and known sides with these values of the constants."""
        network, patterns = self.network.with_nonlinear(values), self.patterns
        motion = patterns.q, patterns.qd, patterns.qdd
        known = network.known(*motion) - self.network.known(*motion)
        return network.regressor(*motion), jnp.asarray(patterns.torque) + known

    def equations(
        self, values: Float[Array, " constants"]
    ) -> tuple[Float[Array, "outputs samples _"], Float[Array, "outputs samples"]]:
        """Return the same by output, zero outside of the mask."""
        (rows, torque), mask = self.at(values), self.patterns.mask
        rows = jnp.where(mask[..., None], rows, 0.0)
        return jnp.swapaxes(rows, 0, 1), jnp.where(mask, torque, 0.0).T

    def factors(self, rows: Array, torque: Array) -> JointFactors:
        equations = (
            jnp.concatenate([of_joint[:, np.array(support, int)], right[:, None]], axis=1)
            for of_joint, right, support in zip(rows, torque, self.network.support, strict=True)
        )
        counts = jnp.sum(self.patterns.mask, axis=0, dtype=rows.dtype)
        return JointFactors.from_rows(tuple(equations), counts)

    def solve(self, factors: JointFactors) -> Solution:
        """Return the best coefficients, by the direct solve."""
        return minimum(Unknowns.of(self.network), factors, self.weights, self.rcond)

    def error(
        self, values: Float[Array, " constants"]
    ) -> tuple[Float[Array, ""], Float[Array, " outputs"]]:
        """Return the weighted error of all outputs, and each output's, root mean squares."""
        factors = self.factors(*self.equations(values))
        error = factors.root_mean_squares(Unknowns.of(self.network), self.solve(factors).k)
        parts = factors.counts * (self.weights * error) ** 2
        return jnp.sqrt(jnp.sum(parts) / jnp.sum(factors.counts)), jnp.asarray(error)

    def residual(self, point: Float[Array, " constants"]) -> Float[Array, " rows"]:
        """The weighted error at a point, and Kaufman's approximation of its derivatives.

        Coefficients and their projection are taken as constant where derivatives are concerned:
        the projection of the change of the rows is what is left, which leaves the gradient exact.
        """
        rows, torque = self.equations(self.values(point))
        solution = self.solve(
            self.factors(jax.lax.stop_gradient(rows), jax.lax.stop_gradient(torque))
        )
        k, inverse_gram = (jax.lax.stop_gradient(x) for x in (solution.k, solution.inverse_gram))
        columns = (rows * self.weights[:, None, None]).reshape(-1, rows.shape[-1])
        error = (torque * self.weights[:, None]).ravel() - columns @ k
        constant = jax.lax.stop_gradient(columns)
        return error - constant @ (inverse_gram @ (constant.T @ error))


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
    given, count = solver.joint_weights, system.network.joint_count
    weights = np.ones(count) if isinstance(given, str) else np.asarray(given, float)
    problem = ProjectedError.of(system.network, patterns, weights, solver.rcond, _SAMPLES)
    by_error = isinstance(given, str) and given == "residual" and count > 1
    tried = _spread(candidates, len(system.nonlinear), seed + 1)
    if by_error:
        problem = problem.weighted(_typical_error(problem, tried))
    points = [*_spread(starts, len(system.nonlinear), seed), *_candidates(problem, tried)]
    minima = _minima(problem, points, [int(i < starts) for i in range(len(points))])
    if by_error:
        # Weights by the errors of the best minimum, where those of chance were good enough so far.
        problem = problem.weighted(minima[0].error)
        points = [_point(problem, minimum.values) for minimum in minima]
        minima = _minima(problem, points, [minimum.starts for minimum in minima])
    values, fit = _together(system.network, patterns, solver, minima[0].values)
    network = system.network.with_nonlinear(jnp.asarray(values))
    return ConstantSearch(fit, network, minima, starts)


def _bounds(
    system: System,
) -> tuple[Float[np.ndarray, " constants"], Float[np.ndarray, " constants"]]:
    low, high = np.array([constant.bounds for constant in system.nonlinear], float).T
    return low, high


def _typical_error(
    problem: ProjectedError, points: Float[np.ndarray, "points constants"]
) -> Float[np.ndarray, " outputs"]:
    """Return the median error of each output over points."""
    errors = np.array(_errors(problem, jnp.asarray(points))[1])
    errors[:, np.all(np.isnan(errors), axis=0)] = 0.0  # outputs without an equation
    return np.nanmedian(errors, axis=0)


def _spread(count: int, constants: int, seed: int) -> Float[np.ndarray, "points constants"]:
    """Evenly spread coordinates of the search, by Sobol's sequence, even in the constants."""
    from scipy.stats import qmc  # takes a second to import

    power = max(count - 1, 0).bit_length()
    part = qmc.Sobol(constants, rng=np.random.default_rng(seed)).random_base2(power)[:count]
    return np.arcsin(2.0 * part - 1.0)


def _point(
    problem: ProjectedError, values: Float[np.ndarray, " constants"]
) -> Float[np.ndarray, " constants"]:
    """Return the coordinates of values: the inverse of `ProjectedError.values`."""
    low, high = _bounds(problem.network.system)
    return np.arcsin(np.clip(2.0 * (values - low) / (high - low) - 1.0, -1.0, 1.0))


def _candidates(
    problem: ProjectedError, points: Float[np.ndarray, "points constants"]
) -> Float[np.ndarray, "best constants"]:
    """Return the best points whose error is less than that of all their neighbours."""
    total = np.asarray(_errors(problem, jnp.asarray(points))[0])
    total = np.where(np.isfinite(total), total, np.inf)
    if not np.any(np.isfinite(total)):
        raise RuntimeError(
            "the error is finite for no values of the searched constants; expected bounds within"
            " which the equations can be evaluated"
        )
    at = np.sin(points)
    neighbours = min(2 * at.shape[1] + 1, len(at))  # with the point itself
    distance = np.sum((at[:, None] - at[None]) ** 2, axis=-1)
    nearest = np.argsort(distance, axis=1)[:, :neighbours]
    lowest = np.flatnonzero(total <= np.min(total[nearest], axis=1))
    return points[lowest[np.argsort(total[lowest])][:_REFINED]]


@eqx.filter_jit
def _errors(problem: ProjectedError, points: Array) -> tuple[Array, Array]:
    """Return `ProjectedError.error` at points."""
    return jax.lax.map(lambda point: problem.error(problem.values(point)), points, batch_size=16)


def _minima(
    problem: ProjectedError,
    points: Sequence[Float[np.ndarray, " constants"]],
    starts: Sequence[int],
) -> tuple[ConstantMinimum, ...]:
    """Return the different minima of local searches, the best first.

    - `points`: where they start, each with how many of the evenly spread starts led there.
    """
    ends = [_descended(problem, jnp.asarray(point)) for point in points]
    totals = np.array([float(total) for _, total, _ in ends])
    order = [i for i in np.argsort(totals, kind="stable") if np.isfinite(totals[i])]
    if not order:
        raise RuntimeError("no local search ended in a finite error; expected other bounds")
    low, high = _bounds(problem.network.system)
    best, size = totals[order[0]], high - low
    minima: list[ConstantMinimum] = []
    for i in order:
        values, total, error = (np.asarray(x) for x in ends[i])
        same = (m for m in minima if np.all(np.abs(values - m.values) < _SAME * size))
        if (known := next(same, None)) is None:
            ratio = float(total / best) if best > 0.0 else 1.0
            minima.append(ConstantMinimum(values, error, ratio, starts[i]))
        else:
            at = minima.index(known)
            minima[at] = dataclasses.replace(known, starts=known.starts + starts[i])
    return tuple(minima)


@eqx.filter_jit
def _descended(problem: ProjectedError, point: Array) -> tuple[Array, Array, Array]:
    """Search from a point; values, and the error there as by `ProjectedError.error`."""
    import optimistix  # with its own dependencies, half a second

    solution = optimistix.least_squares(
        lambda point, problem: problem.residual(point),
        optimistix.LevenbergMarquardt(rtol=_TOLERANCE, atol=_TOLERANCE),
        point,
        args=problem,
        max_steps=60,
        throw=False,
    )
    values = problem.values(solution.value)
    return values, *problem.error(values)


def _together(
    network: SystemNetwork,
    patterns: Patterns,
    solver: LeastSquares,
    values: Float[np.ndarray, " constants"],
) -> tuple[Float[np.ndarray, " constants"], Identification]:
    """Return constants and coefficients that minimise the solver's loss, by Gauss and Newton.

    All patterns count, with the solver's filter, loss and errors. Constants at a bound stay there.
    """
    low, high = _bounds(network.system)
    margin = _AT_BOUND * (high - low)
    free = np.flatnonzero((values >= low + margin) & (values <= high - margin))
    names = [constant.name for constant in network.system.nonlinear]
    extra = range(network.size, network.size + len(free))
    unknowns = Unknowns(
        (*network.names, *(names[index] for index in free)),
        tuple((*support, *extra) for support in network.support),
    )
    problem = ProjectedError.of(network, patterns, np.ones(network.joint_count))
    fit = solver.fit(network.with_nonlinear(jnp.asarray(values)), patterns)

    def values_of(k: np.ndarray) -> np.ndarray:
        moved = values.copy()
        moved[free] = np.clip(k[network.size :], low[free], high[free])
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

    fit = gauss_newton(fitted, np.append(np.asarray(fit.k), values[free]))
    return values_of(np.asarray(fit.k)), fit


@eqx.filter_jit
def _linearised(problem: ProjectedError, values: Array, k: Array) -> tuple[Array, Array, Array]:
    """Regressor, torque, and derivatives by the constants of what coefficients predict beyond the
    torque, (samples, outputs, s)."""

    def excess(values: Array) -> Array:
        rows, torque = problem.at(values)
        return rows @ k - torque

    return *problem.at(values), jax.jacfwd(excess)(values)
