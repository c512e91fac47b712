from typing import Any, NamedTuple

import equinox as eqx
import jax
import jax.numpy as jnp
import numpy as np
from jaxtyping import Array, Float

from ..identification import LeastSquares
from ..identification.solver import (
    JointFactors,
    Solution,
    Unknowns,
    minimum,
    weighted_minimum,
)
from ..motion import Patterns
from ._network import SystemNetwork


class JudgedError(NamedTuple):
    """The mean logarithm of the outputs' errors, their weights, and the errors."""

    objective: Float[Array, ""]
    weights: Float[Array, " outputs"]
    error: Float[Array, " outputs"]


class ProjectedError(eqx.Module):
    """The error as a function of the nonlinear constants, coefficients eliminated.

    - `network`: with the constants that `torque` was measured with.
    - `q`, `qd`, `qdd`, `torque`, `mask`: a part of the patterns.
    - `low`, `high`: bounds of the constants.
    """

    network: SystemNetwork
    q: Float[Array, "samples variables"]
    qd: Float[Array, "samples variables"]
    qdd: Float[Array, "samples variables"]
    torque: Float[Array, "samples outputs"]
    mask: Float[Array, "samples outputs"]
    low: Float[Array, " constants"]
    high: Float[Array, " constants"]
    joint_weights: Any = eqx.field(static=True)
    rcond: float | None = eqx.field(static=True)

    @classmethod
    def of(
        cls,
        network: SystemNetwork,
        patterns: Patterns,
        solver: LeastSquares,
        low: np.ndarray,
        high: np.ndarray,
        samples: int | None = None,
    ) -> "ProjectedError":
        """Of patterns, or of so many of them at most, evenly spread in time."""
        step = 1 if samples is None else -(-patterns.samples // samples)
        arrays = (patterns.q, patterns.qd, patterns.qdd, patterns.torque, patterns.mask)
        q, qd, qdd, torque, mask = (jnp.asarray(x[::step], float) for x in arrays)
        return cls(
            network, q, qd, qdd, torque, mask, jnp.asarray(low), jnp.asarray(high),
            solver.joint_weights, solver.rcond,
        )  # fmt: skip

    def values(self, point: Float[Array, " constants"]) -> Float[Array, " constants"]:
        """Constants from coordinates of the search: any real number is within the bounds."""
        return self.low + (self.high - self.low) * (0.5 + 0.5 * jnp.sin(point))

    def equations(
        self, values: Float[Array, " constants"]
    ) -> tuple[Float[Array, "outputs samples _"], Float[Array, "outputs samples"]]:
        """Regressor and torque, zero outside of the mask."""
        network = self.network.with_nonlinear(values)
        motion = (self.q, self.qd, self.qdd)
        torque = self.torque + network.known(*motion) - self.network.known(*motion)
        rows = jnp.where(self.mask[..., None] > 0, network.regressor(*motion), 0.0)
        return jnp.swapaxes(rows, 0, 1), jnp.where(self.mask > 0, torque, 0.0).T

    def factors(self, rows: Array, torque: Array) -> JointFactors:
        triangles = [
            jnp.linalg.qr(
                jnp.concatenate([of_joint[:, np.array(support, int)], right[:, None]], axis=1),
                mode="r",
            )
            for of_joint, right, support in zip(rows, torque, self.network.support, strict=True)
        ]
        return JointFactors(tuple(triangles), jnp.sum(self.mask, axis=0))

    def solve(self, factors: JointFactors, weights: Any) -> tuple[Solution, Array]:
        unknowns = Unknowns.of(self.network)
        solution, weights = weighted_minimum(
            unknowns,
            factors,
            weights,
            lambda weights: minimum(unknowns, factors, weights, self.rcond),
        )
        return solution, jnp.asarray(weights)

    def judged(self, values: Float[Array, " constants"]) -> "JudgedError":
        """The error with the best coefficients."""
        rows, torque = self.equations(values)
        factors = self.factors(rows, torque)
        solution, weights = self.solve(factors, self.joint_weights)
        error = factors.root_mean_squares(Unknowns.of(self.network), solution.k)
        counts = factors.counts / jnp.sum(factors.counts)
        if self.joint_weights == "residual":
            objective = jnp.sum(counts * jnp.log(error))
        else:
            objective = 0.5 * jnp.log(jnp.sum(counts * (weights * error) ** 2))
        return JudgedError(objective, weights, jnp.asarray(error))

    def residual(
        self, point: Float[Array, " constants"], weights: Float[Array, " outputs"]
    ) -> Float[Array, " rows"]:
        """The weighted error at a point, and Kaufman's approximation of its derivatives.

        Coefficients and their projection are taken as constant where derivatives are concerned:
        the projection of the change of the rows is what is left, which leaves the gradient exact.
        """
        rows, torque = self.equations(self.values(point))
        rows, torque = rows * weights[:, None, None], torque * weights[:, None]
        solution, _ = self.solve(
            self.factors(jax.lax.stop_gradient(rows), jax.lax.stop_gradient(torque)),
            jnp.ones(len(weights)),
        )
        k, inverse_gram = (jax.lax.stop_gradient(x) for x in (solution.k, solution.inverse_gram))
        columns = rows.reshape(-1, rows.shape[-1])
        error = torque.ravel() - columns @ k
        constant = jax.lax.stop_gradient(columns)
        return error - constant @ (inverse_gram @ (constant.T @ error))
