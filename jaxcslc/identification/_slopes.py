import dataclasses
from typing import Any

import equinox as eqx
import jax
import jax.numpy as jnp
import numpy as np
from jaxtyping import Array, Bool, Float, Int

from ..motion import Patterns
from ..network import CSLC
from .solver import Identification, JointWeights, LeastSquares, regressor_of


# Slopes that a fit starts from, tried joint by joint: static friction that has gone to exp(-3) at
# these parts of the joint's greatest speed. Beyond, it is dry friction or nothing that is seen.
_GONE_AT = (0.6, 0.3, 0.15, 0.08, 0.04, 0.02, 0.01, 0.005)
_ROUNDS = 3


class SlopeFit(eqx.Module):
    """Coefficients and the slopes of static friction, found together.

    **Attributes**

    - `network`: with the slopes found: `network.torque(fit.k, ...)` predicts.
    - `fit`: the coefficients. Their `covariance` and `standard_error` allow for the slopes having
      been fitted too.
    - `slopes`: (n,) [s/rad or s/m]; γ of Eqn. 2.5-4 is 1 / slope. Those of joints without static
      friction are the network's.
    - `slope_error`: (n,) standard deviation of each; infinite where the patterns do not tell it,
      zero for joints without static friction.
    - `steps`: of the search, all rounds together.
    - `settled`: whether it came to an end.

    >>> import numpy as np, jaxcslc as jc
    >>> robot = jc.Manipulator.from_modified_dh([(0, 0, 0, 0)], gravity=(0, -9.81, 0))
    >>> network = jc.derive(robot.with_friction("dry", "static"), lengths="numeric")
    >>> t = np.linspace(0, 20, 1000)[:, None]
    >>> motion, pairs = (np.sin(t), np.cos(t), -np.sin(t)), np.ones(t.shape, bool)
    >>> k = np.array([0.5, 0.3, -0.1, 0.2, 0.4])
    >>> torque = np.asarray(network.with_static_slopes([5.0]).torque(k, *motion))
    >>> found = jc.fit_slopes(network, jc.Patterns(t[:, 0], *motion, torque, pairs, pairs))
    >>> bool(found.settled), round(float(found.slopes[0]), 6)
    (True, 5.0)
    """

    network: CSLC
    fit: Identification
    slopes: Float[Array, " joints"]
    slope_error: Float[Array, " joints"]
    steps: Int[Array, ""]
    settled: Bool[Array, ""]

    def __repr__(self) -> str:
        pairs = zip(np.asarray(self.slopes), np.asarray(self.slope_error), strict=True)
        slopes = ", ".join(f"{slope:.3g} ± {error:.2g}" for slope, error in pairs)
        return f"SlopeFit(slopes [{slopes}]; {self.fit})"


def fit_slopes(
    network: CSLC,
    patterns: Patterns,
    *,
    start: Float[Array | np.ndarray, " joints"] | None = None,
    solver: LeastSquares | None = None,
    blocks: int | None = None,
    max_steps: int = 100,
) -> SlopeFit:
    """The coefficients and the slopes of static friction that fit best together (8.2.1).

    The thesis would keep the slopes constant, so that torque stays linear in what is learnt. Here
    they are found outside, by Levenberg and Marquardt's method on their logarithms, and for each
    of its steps all coefficients are solved for exactly inside (variable projection; Golub and
    Pereyra 1973): the search has as many unknowns as joints with static friction.

    **Arguments**

    - `network`: n joints, p coefficients; some joint has the friction term `"static"`.
    - `patterns`: as of `LeastSquares.fit`. Slow pairs must be among those that count.
    - `start`: (n,) slopes to start from; by default the best of some for each joint in turn.
    - `solver`: options of the fit; the defaults of `LeastSquares` if None.
    - `blocks`: by default, errors are for independent residuals. With a number, for residuals
      that hang together within so many equal stretches of time and not between them (a sandwich
      of their sums), as smoothing makes them; some 20 or more.
    - `max_steps`: of the search in each round of weights.

    **Raises**

    - `ValueError`: no joint has static friction, too few blocks, or as `LeastSquares.fit`.
    - `RuntimeError`: as `LeastSquares.fit`.

    >>> import jax.numpy as jnp, numpy as np, jaxcslc as jc
    >>> robot = jc.Manipulator.from_modified_dh([(0, 0, 0, 0)], gravity=(0, -9.81, 0))
    >>> robot = robot.with_friction("viscous", "dry", "static")
    >>> network = jc.derive(robot, lengths="numeric").with_static_slopes([5.0])
    >>> t = np.linspace(0, 20, 1000)[:, None]
    >>> q, qd, qdd = np.sin(t), np.cos(t), -np.sin(t)
    >>> k = jnp.array([0.5, 0.3, -0.1, 0.2, 0.05, 0.4])
    >>> torque = np.asarray(network.torque(k, q, qd, qdd))
    >>> pairs = np.ones(q.shape, bool)
    >>> found = jc.fit_slopes(network, jc.Patterns(t[:, 0], q, qd, qdd, torque, pairs, pairs))
    >>> bool(jnp.allclose(found.slopes, 5.0)), bool(jnp.allclose(found.fit.k, k))
    (True, True)
    """
    if "static" not in network.robot.friction_terms:
        raise ValueError(
            f"{network.robot.name!r} has no static friction, whose slopes could be fitted;"
            ' give its robot the friction term "static"'
        )
    import optimistix as optx  # loads when a fit needs it

    solver = dataclasses.replace(solver or LeastSquares(), errors="independent")
    joint_weights = solver.joint_weights
    if blocks is not None and not 2 <= blocks <= patterns.samples:
        raise ValueError(f"{blocks} blocks; expected 2 or more, and no more than samples")
    joints, columns = _static_columns(network)
    own = np.array(joints)
    if start is not None:
        network = network.with_static_slopes(np.asarray(start))
    slopes = jnp.asarray(network.static_slopes, float)
    # As an array, so that what is compiled for these slopes serves the next.
    network = network.with_static_slopes(slopes)
    counts = jnp.asarray(patterns.mask)
    qd, torque = jnp.asarray(patterns.qd), jnp.asarray(patterns.torque)
    fastest = jnp.max(jnp.abs(qd) * counts, axis=0)[own]
    regressor = jnp.asarray(regressor_of(network, patterns))
    fit = solver.fit(network, patterns)
    by_residual = isinstance(joint_weights, str) and joint_weights == "residual"
    steps, settled, weight = jnp.asarray(0), jnp.asarray(True), counts
    for number in range(_ROUNDS if by_residual else 1):
        weights = _weights(joint_weights, fit, network.joint_count)
        weight = counts * jnp.broadcast_to(weights, counts.shape)
        problem = _projected(regressor, qd, torque, weight, columns, joints)
        logs = jnp.log(slopes[own])
        if start is None and number == 0:
            logs = _best_start(problem, logs, fastest)
        solution = _search(problem, logs, max_steps)
        steps = steps + solution.stats["num_steps"]
        settled = solution.result == optx.RESULTS.successful
        slopes = slopes.at[own].set(jnp.exp(solution.value))
        network = network.with_static_slopes(slopes)
        fit = dataclasses.replace(solver, joint_weights=weights).fit(network, patterns)
    regressor = jnp.asarray(regressor_of(network, patterns))
    covariance, told = _covariance(
        regressor, qd, torque, weight, fit.k, slopes, columns, joints, blocks
    )
    p = network.size
    errors = jnp.where(told, jnp.sqrt(jnp.diag(covariance)), jnp.inf)
    fit = eqx.tree_at(
        lambda found: (found.covariance, found.standard_error),
        fit,
        (covariance[:p, :p], errors[:p]),
    )
    slope_error = jnp.zeros(network.joint_count).at[own].set(errors[p:])
    network = network.with_static_slopes(np.asarray(slopes))
    return SlopeFit(network, fit, slopes, slope_error, steps, settled)


def _weights(asked: JointWeights, fit: Identification, joints: int) -> Float[Array, " joints"]:
    if not isinstance(asked, str):
        return jnp.asarray(asked, float)
    if asked == "equal":
        return jnp.ones(joints)
    return 1.0 / jnp.maximum(fit.torque_error, 1e-12 * jnp.max(fit.torque_error))


class _Problem(eqx.Module):
    """Residuals of the best coefficients as a function of the slopes' logarithms.

    **Attributes**

    - `basis`: (equations, r) orthonormal, of what does not depend on the slopes.
    - `left`: (equations,) the torque that it cannot explain.
    - `speed`, `sign`: (s, samples) of the joints with static friction, signs weighted.
    - `joints`: those joints; `shape`: samples and joints of the equations.
    """

    basis: Float[Array, "equations rank"]
    left: Float[Array, " equations"]
    speed: Float[Array, "slopes samples"]
    sign: Float[Array, "slopes samples"]
    joints: tuple[int, ...] = eqx.field(static=True)
    shape: tuple[int, int] = eqx.field(static=True)

    def residuals(self, logs: Float[Array, " slopes"]) -> Float[Array, " equations"]:
        inputs = self.sign * jnp.exp(-jnp.exp(logs)[:, None] * self.speed)
        count = len(self.joints)
        wide = jnp.zeros((*self.shape, count), inputs.dtype)
        wide = wide.at[:, np.array(self.joints), np.arange(count)].set(inputs.T)
        columns = wide.reshape(-1, count)
        columns = columns - self.basis @ (self.basis.T @ columns)
        # Unit columns, and a little on the diagonal: where static friction is nothing but dry
        # friction, its column is gone and its coefficient is nothing rather than infinite.
        norm = jnp.sqrt(
            jnp.sum(columns**2, axis=0) + 1e-20 * jnp.sum(self.sign**2, axis=1) + 1e-300
        )
        columns = columns / norm[None, :]
        gram = columns.T @ columns + 1e-12 * jnp.eye(count)
        return self.left - columns @ jnp.linalg.solve(gram, columns.T @ self.left)


@eqx.filter_jit
def _projected(
    regressor: Array,
    qd: Array,
    torque: Array,
    weight: Array,
    columns: tuple[int, ...],
    joints: tuple[int, ...],
) -> _Problem:
    kept = np.setdiff1d(np.arange(regressor.shape[-1]), columns)
    matrix = (regressor[..., kept] * weight[..., None]).reshape(-1, kept.size)
    scale = jnp.linalg.norm(matrix, axis=0)
    q, r = jnp.linalg.qr(matrix / jnp.where(scale > 0, scale, 1.0)[None, :])
    left, singular, _ = jnp.linalg.svd(r)
    counted = singular > 1e-11 * singular[0]
    basis = q @ (left * counted[None, :])
    target = (torque * weight).reshape(-1)
    own = np.array(joints)
    return _Problem(
        basis,
        target - basis @ (basis.T @ target),
        jnp.abs(qd[:, own]).T,
        (jnp.sign(qd) * weight)[:, own].T,
        joints,
        (qd.shape[0], qd.shape[1]),
    )


@eqx.filter_jit
def _best_start(problem: _Problem, logs: Array, fastest: Array) -> Array:
    """The best of a few slopes for each joint in turn, the others held."""

    def cost(logs: Array) -> Array:
        return jnp.sum(problem.residuals(logs) ** 2)

    def improve(i: Array, logs: Array) -> Array:
        tried = jnp.log(3.0 / (jnp.asarray(_GONE_AT) * fastest[i]))
        tried = jnp.concatenate([logs[i][None], jnp.where(jnp.isfinite(tried), tried, logs[i])])
        costs = jax.lax.map(lambda value: cost(logs.at[i].set(value)), tried)
        return logs.at[i].set(tried[jnp.argmin(costs)])

    return jax.lax.fori_loop(0, logs.shape[0], improve, logs)


def _residuals(logs: Float[Array, " slopes"], problem: _Problem) -> Float[Array, " equations"]:
    return problem.residuals(logs)


def _search(problem: _Problem, logs: Array, max_steps: int) -> Any:
    import optimistix as optx

    return optx.least_squares(
        _residuals,  # by name: a function made anew would be compiled anew
        optx.LevenbergMarquardt(rtol=1e-8, atol=1e-8),
        logs,
        args=problem,
        max_steps=max_steps,
        throw=False,
    )


@eqx.filter_jit
def _covariance(
    regressor: Array,
    qd: Array,
    torque: Array,
    weight: Array,
    k: Array,
    slopes: Array,
    columns: tuple[int, ...],
    joints: tuple[int, ...],
    blocks: int | None,
) -> tuple[Array, Array]:
    """Of coefficients and slopes together, and which of them the equations tell (Gauss-Newton)."""
    own = np.array(joints)
    speed = jnp.abs(qd[:, own])
    size, rate = (jnp.broadcast_to(x, speed.shape) for x in (k[np.array(columns)], slopes[own]))
    bend = -size * speed * jnp.sign(qd[:, own]) * jnp.exp(-rate * speed)
    wide = jnp.zeros((*qd.shape, own.size), qd.dtype)
    wide = wide.at[:, own, np.arange(own.size)].set(bend)
    jacobian = jnp.concatenate([regressor, wide], axis=-1) * weight[..., None]
    residual = (torque - jnp.einsum("tjp,p->tj", regressor, k)) * weight
    size = jacobian.shape[-1]
    scale = jnp.linalg.norm(jacobian.reshape(-1, size), axis=0)
    seen = scale > 0
    scale = jnp.where(seen, scale, 1.0)
    triangle = jnp.linalg.qr(jacobian.reshape(-1, size) / scale[None, :], mode="r")
    _, singular, right = jnp.linalg.svd(triangle, full_matrices=False)
    counted = singular > 1e-10 * singular[0]
    inverse = jnp.where(counted, 1.0 / jnp.where(counted, singular, 1.0), 0.0)
    half = (right.T * inverse[None, :]) / scale[:, None]
    if blocks is None:
        freedom = jnp.maximum(jnp.sum(weight != 0) - jnp.sum(counted), 1)
        covariance = jnp.sum(residual**2) / freedom * half @ half.T
    else:
        part = np.arange(qd.shape[0]) * blocks // qd.shape[0]
        scores = jnp.einsum("tjp,tj->tp", jacobian, residual)
        sums = jax.ops.segment_sum(scores, part, num_segments=blocks) @ (half @ half.T)
        covariance = sums.T @ sums * blocks / (blocks - 1)
    share = jnp.sqrt(jnp.sum(jnp.where(counted[:, None], 0.0, right) ** 2, axis=0))
    return covariance, seen & (share < 1e-6)


def _static_columns(network: CSLC) -> tuple[tuple[int, ...], tuple[int, ...]]:
    """Joints with static friction, and the indices of its coefficients in `k`."""
    (term,) = (term for term in network.input_terms if term.kind == "static")
    return term.input_joints, tuple(network.layout.indices("static").tolist())
