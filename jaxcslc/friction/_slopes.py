"""Torque equations whose columns of static friction follow from slopes."""

import dataclasses
from collections.abc import Sequence

import equinox as eqx
import jax.numpy as jnp
import numpy as np
from jaxtyping import Array, Bool, Float, Int

from .._rank import rank_tolerance
from ..least_squares import (
    Equations,
    Identification,
    JointFactors,
    LeastSquares,
    Rows,
    Solution,
    Unknowns,
    joint_weights_of,
    minimum,
    minimum_coefficients,
    residual_weights,
    robust_weights,
    triangle_of,
    weights_of_scales,
)
from ..network import CSLC
from ..recordings import Patterns


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
        """Return the equations of a network with static friction."""
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
        """Return whether a slope has reached the end of the observed speeds."""
        if self.fastest[i] <= 0.0:
            return True
        ends = np.log([slope * self.slowest[i], slope * self.fastest[i]])
        return bool(np.min(np.abs(ends)) < _REACHED)

    def reason(self, i: int, slope: float, error: float = np.inf) -> str:
        """Return the reason why a joint loses its static friction."""
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
        """Return equations with other weights, given at the instants of `base.instants()`."""
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
        fixed_slopes = self.factors(slopes, np.zeros(count))
        k = minimum_coefficients(self.unknowns, fixed_slopes, weights, rcond)
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


# Slopes that a fit starts from, tried joint by joint: static friction that has gone to exp(-3) at
# these parts of the joint's greatest speed. Beyond, it is dry friction or nothing that is seen.
_GONE_AT = (0.6, 0.3, 0.15, 0.08, 0.04, 0.02, 0.01, 0.005)
# Rounds of weighting joints by residual, and of reweighting for a robust loss.
_ROUNDS = 3
_ROBUST_ROUNDS = 30
# The search ends with a step of this part of a slope: of a round of weights that others follow, of
# the last one, and of rounds of a robust loss, which end with a change of this part themselves.
_TOLERANCE_BEFORE, _TOLERANCE, _ROBUST_TOLERANCE = 1e-3, 1e-6, 1e-8
# A search starts this part of what is between its bounds away from them.
_INSIDE = 1e-9
# Steps of a search in each round of weights; a PUMA 560 needs 15 to 22.
_MOST_STEPS = 100


class SlopeFit(eqx.Module):
    """Coefficients and the slopes of static friction, fitted together.

    **Attributes**

    - `network`: with the fitted slopes, and without static friction of the joints of `dropped`:
      `network.torque(fit.k, ...)` predicts.
    - `fit`: the coefficients of `network`. Their `covariance` and `standard_error` allow for the
      slopes having been fitted too.
    - `slopes`: (n,) [s/rad or s/m]; γ of Eqn. 2.5-4 is 1 / slope. Those of joints without static
      friction are the network's, those of `dropped` the last ones of the search.
    - `slope_error`: (n,) standard deviation of each; infinite for `dropped`, zero for joints
      without static friction.
    - `steps`: of the search, all rounds together.
    - `converged`: whether the search converged.
    - `dropped`: joints, counted from 1, whose slope the patterns do not determine.
    - `warnings`: one sentence for each of them.

    >>> import jaxcslc as jc
    >>> network = jc.derive(jc.examples.pendulum("dry", "static"))
    >>> patterns = jc.examples.swing(network, [0.5, 0.3, -0.1, 0.2, 0.1], torque_noise=0.01)
    >>> fit = jc.fit_slopes(network, patterns)
    >>> fit.dropped, bool(fit.converged)
    ((), True)
    """

    network: CSLC
    fit: Identification
    slopes: Float[Array, " joints"]
    slope_error: Float[Array, " joints"]
    steps: Int[Array, ""]
    converged: Bool[Array, ""]
    dropped: tuple[int, ...] = eqx.field(static=True, default=())
    warnings: tuple[str, ...] = eqx.field(static=True, default=())

    def after(self, earlier: "SlopeFit") -> "SlopeFit":
        """Add the joints that an earlier fit has dropped, and the reasons."""
        lost = np.isin(np.arange(1, len(np.asarray(self.slopes)) + 1), earlier.dropped)
        return dataclasses.replace(
            self,
            slope_error=jnp.where(lost, jnp.inf, self.slope_error),
            dropped=tuple(sorted({*earlier.dropped, *self.dropped})),
            warnings=(*earlier.warnings, *self.warnings),
        )

    def __repr__(self) -> str:
        pairs = zip(np.asarray(self.slopes), np.asarray(self.slope_error), strict=True)
        slopes = ", ".join(f"{slope:.3g} ± {error:.2g}" for slope, error in pairs)
        return f"SlopeFit(slopes [{slopes}]; {self.fit})"


def fit_slopes(
    network: CSLC,
    patterns: Patterns,
    *,
    solver: LeastSquares | None = None,
    start: Float[Array | np.ndarray, " joints"] | None = None,
) -> SlopeFit:
    """Fit the coefficients and the slopes of static friction together (8.2.1).

    The thesis would keep the slopes constant, so that torque stays linear in what is learnt. Here
    Powell's dogleg (`scipy.optimize.least_squares`) searches for their logarithms, and each of its
    steps solves exactly for all coefficients (variable projection; Golub and Pereyra 1973, with
    Kaufman's derivatives): the search has as many unknowns as joints with static friction.

    A slope is determined by speeds on both sides of its characteristic speed 1 / slope. Above the
    greatest speed, static friction is a parabola over all that was observed, which dry and viscous
    friction resemble up to differences of huge coefficients; below the slowest, it has vanished
    in every pair. So slopes stay between 1 / (greatest speed) and 1 / (the speed that one pair in
    a hundred is below), for each joint. A joint whose slope reaches one of these bounds, or has a
    standard error greater than itself, loses its static friction, and the fit is repeated.

    **Arguments**

    - `network`: n joints, p coefficients; some joint has the friction term `"static"`.
    - `patterns`: as of `LeastSquares.fit`. Slow pairs must be within the mask.
    - `solver`: options of the fit, loss, cut-off and error model included; the defaults of
      `LeastSquares` if None.
    - `start`: (n,) slopes to start from; by default the best of some for each joint in turn.

    **Raises**

    - `ValueError`: no joint has static friction, or as `LeastSquares.fit`.
    - `RuntimeError`: as `LeastSquares.fit`.

    >>> import jaxcslc as jc
    >>> network = jc.derive(jc.examples.pendulum("viscous", "dry", "static"))
    >>> true = network.with_static_slopes([5.0])
    >>> patterns = jc.examples.swing(true, [0.5, 0.3, -0.1, 0.2, 0.05, 0.4], samples=2000)
    >>> result = jc.fit_slopes(network, patterns)
    >>> result.slopes.round(4).tolist(), result.fit.k.round(4).tolist()
    ([5.0], [0.5, 0.3, -0.1, 0.2, 0.05, 0.4])
    """
    if "static" not in network.robot.friction_terms:
        raise ValueError(
            f"{network.robot.name!r} has no static friction, whose slopes could be fitted;"
            ' give its robot the friction term "static"'
        )
    solver = LeastSquares() if solver is None else solver
    if start is not None:
        network = network.with_static_slopes(np.asarray(start))
    slopes = np.array(network.static_slopes, float)
    slope_error = np.zeros(network.joint_count)
    warnings: dict[int, str] = {}
    steps, converged, from_start = 0, True, start is not None
    while "static" in network.robot.friction_terms:
        equations = SlopeEquations.of(network, patterns, solver)
        joints = np.array(equations.joints)
        search = _fitted_slopes(equations, solver, slopes[joints], from_start)
        steps, converged, from_start = steps + search.steps, search.converged, True
        slopes[joints] = search.slopes
        network = network.with_static_slopes(slopes)
        lost = {
            int(joint) + 1: equations.reason(i, search.slopes[i])
            for i, joint in enumerate(joints)
            if equations.at_bound(i, search.slopes[i])
        }
        if not lost:
            fit, error = _with_slope_errors(equations, solver, search)
            slope_error[joints] = error
            lost = {
                int(joint) + 1: equations.reason(i, search.slopes[i], error[i])
                for i, joint in enumerate(joints)
                if not error[i] < search.slopes[i]
            }
            if not lost:
                break
        warnings |= lost
        slope_error[[joint - 1 for joint in lost]] = np.inf
        network = network.without_law("static", tuple(lost))
    else:
        fit = solver.fit(network, patterns)
    return SlopeFit(
        network,
        fit,
        jnp.asarray(slopes),
        jnp.asarray(slope_error),
        jnp.asarray(steps),
        jnp.asarray(converged),
        tuple(sorted(warnings)),
        tuple(warnings[joint] for joint in sorted(warnings)),
    )


@dataclasses.dataclass(frozen=True)
class _Search:
    """Result of a search for slopes: slopes, solution, steps, and whether it converged."""

    slopes: Float[np.ndarray, " slopes"]
    solution: Solution
    steps: int
    converged: bool


def _fitted_slopes(
    equations: SlopeEquations,
    solver: LeastSquares,
    start: Float[np.ndarray, " slopes"],
    from_start: bool,
) -> _Search:
    """The search in rounds of weights: of joints by residual, of equations for a robust loss."""
    slopes = equations.within_bounds(start)
    robust, by_residual = solver.loss != "squared", solver.joint_weights == "residual"
    if robust:
        plain = dataclasses.replace(solver, errors="independent")
        k = np.asarray(plain.fit_equations(equations.plain(slopes), equations.samples).k)
    else:
        unknowns, factors = equations.unknowns, equations.factors(slopes, np.zeros(len(slopes)))
        weights = joint_weights_of(unknowns, factors, solver.joint_weights, solver.rcond)
        k = minimum_coefficients(unknowns, factors, weights, solver.rcond)
        k = k[: unknowns.size - len(slopes)]
    rounds = _ROBUST_ROUNDS if robust else _ROUNDS if by_residual else 1
    weights = np.ones(equations.joint_count)
    if not isinstance(solver.joint_weights, str):
        weights = np.asarray(solver.joint_weights)
    steps = 0
    search = None
    for number in range(rounds):
        if robust:
            rows = Rows.from_equations(equations.plain(slopes), equations.samples)
            roots, scale = robust_weights(rows, k, solver.loss)
            equations = equations.reweighted(roots)
            weights = weights_of_scales(rows, scale) if by_residual else weights
        elif by_residual:
            factors = equations.factors(slopes, np.zeros(len(slopes)))
            k_all = np.append(k, np.zeros(len(slopes)))
            error = factors.root_mean_squares(equations.unknowns, k_all)
            weights = np.asarray(
                residual_weights(
                    error,
                    factors.counts,
                    factors.torque_scale(),
                    equations.unknowns.joint_sizes,
                )
            )
        if not from_start and number == 0:
            slopes = _best_start(equations, slopes, weights, solver.rcond)
        before = slopes
        last = _TOLERANCE if number + 1 == rounds else _TOLERANCE_BEFORE
        tolerance = _ROBUST_TOLERANCE if robust else last
        search = _searched(equations, slopes, weights, solver.rcond, tolerance)
        slopes, steps, k = search.slopes, steps + search.steps, search.solution.k[: len(k)]
        if robust and np.max(np.abs(np.log(slopes / before))) < _TOLERANCE:
            break
    assert search is not None
    return dataclasses.replace(search, steps=steps)


def _best_start(
    equations: SlopeEquations,
    slopes: Float[np.ndarray, " slopes"],
    weights: Float[np.ndarray, " joints"],
    rcond: float | None,
) -> Float[np.ndarray, " slopes"]:
    """The best of a few slopes for each joint in turn, the others fixed."""
    for i, fastest in enumerate(equations.fastest):
        tried = [slopes]
        for part in _GONE_AT if fastest > 0.0 else ():
            candidate = slopes.copy()
            candidate[i] = 3.0 / (part * fastest)
            tried.append(equations.within_bounds(candidate))
        slopes = min(tried, key=lambda x: _evaluated(equations, x, weights, rcond)[1])
    return slopes


def _evaluated(
    equations: SlopeEquations,
    slopes: Float[np.ndarray, " slopes"],
    weights: Float[np.ndarray, " joints"],
    rcond: float | None,
) -> tuple[Solution, float]:
    """The best coefficients for some slopes, and the sum of squares that they leave."""
    factors = equations.factors(slopes, np.zeros(len(slopes)))
    solution = minimum(equations.unknowns, factors, weights, rcond)
    degrees_of_freedom = np.maximum(factors.counts.sum() - solution.rank, 1.0)
    return solution, float(solution.variance * degrees_of_freedom)


def _searched(
    equations: SlopeEquations,
    slopes: Float[np.ndarray, " slopes"],
    weights: Float[np.ndarray, " joints"],
    rcond: float | None,
    tolerance: float,
) -> _Search:
    """Search the logarithms of the slopes, within their bounds, by SciPy's dogleg."""
    # Optimistix has no bounds: its Levenberg-Marquardt, called back and bounded by a sine, needed
    # 69 to 335 steps and 2.1 to 8.8 s of processor time for a PUMA 560, this 15 to 22 and 0.2 to
    # 1.7 s, and 0.7 s once to import and compile.
    from scipy.optimize import least_squares  # takes longer to import than most searches last

    movable = equations.fastest > equations.slowest
    solution = _evaluated(equations, slopes, weights, rcond)[0]
    if not (movable.any() and solution.finite):
        return _Search(slopes, solution, 0, True)
    low, high = (np.log(end[movable]) for end in equations.bounds())
    last: dict[bytes, tuple[np.ndarray, np.ndarray]] = {}

    def slopes_at(point: np.ndarray) -> np.ndarray:
        moved = slopes.copy()
        moved[movable] = np.exp(point)
        return moved

    def projected(point: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
        key = point.tobytes()
        if key not in last:
            last.clear()
            residual, slope = equations.projected(slopes_at(point), weights, rcond)
            last[key] = residual, slope[:, movable]
        return last[key]

    inside = _INSIDE * (high - low)
    result = least_squares(
        lambda point: projected(point)[0],
        np.clip(np.log(slopes[movable]), low + inside, high - inside),
        lambda point: projected(point)[1],
        bounds=(low, high),
        method="dogbox",
        xtol=tolerance,
        ftol=None,
        gtol=None,
        max_nfev=_MOST_STEPS,
    )
    ended = slopes_at(result.x)
    solution = _evaluated(equations, ended, weights, rcond)[0]
    return _Search(ended, solution, result.nfev, result.success)


def _with_slope_errors(
    equations: SlopeEquations, solver: LeastSquares, search: _Search
) -> tuple[Identification, Float[np.ndarray, " slopes"]]:
    """The fit with the slopes of a search, and the slopes' standard errors (Gauss-Newton)."""
    slopes, p = search.slopes, equations.unknowns.size - len(search.slopes)
    plain = dataclasses.replace(solver, errors="independent").fit_equations(
        equations.plain(slopes), equations.samples
    )
    heights = np.asarray(plain.k)[list(equations.columns)]
    linearised = equations.linearised(slopes, heights)
    both = solver.fit_equations(linearised, equations.samples, throw=False)
    fit = dataclasses.replace(
        plain,
        covariance=both.covariance[:p, :p],
        standard_error=jnp.where(plain.determined, both.standard_error[:p], jnp.inf),
        effective_equations=both.effective_equations,
        degrees_of_freedom=both.degrees_of_freedom,
        errors=both.errors,
    )
    return fit, np.asarray(both.standard_error[p:]) * slopes
