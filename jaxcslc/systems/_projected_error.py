"""Error as a function of the nonlinear constants, coefficients eliminated."""

from typing import NamedTuple

import equinox as eqx
import jax
import jax.numpy as jnp
import numpy as np
from jaxtyping import Array, Float

from ..least_squares import JointFactors, Solution, Unknowns, minimum
from ..recordings import Patterns
from ._network import SystemNetwork


class JudgedError(NamedTuple):
    """The root mean square of all outputs' weighted errors, and that of each output's error."""

    total: Float[Array, ""]
    error: Float[Array, " outputs"]


class ProjectedError(eqx.Module):
    """The error as a function of the nonlinear constants, coefficients eliminated.

    Weights of outputs are the same for all values of the constants. Each output's error at these
    values would be the wrong weight: an equation whose known side is zero has an error that the
    constants themselves scale, and the search would shrink it (the flow between two tanks to a
    power of their levels: the error's logarithm fell by 0.4 from the true 0.5 to the bound of 0.1).

    - `network`: with the constants that `torque` was measured with.
    - `q`, `qd`, `qdd`, `torque`, `mask`: a part of the patterns.
    - `weights`: of outputs.
    - `low`, `high`: bounds of the constants.
    """

    network: SystemNetwork
    q: Float[Array, "samples variables"]
    qd: Float[Array, "samples variables"]
    qdd: Float[Array, "samples variables"]
    torque: Float[Array, "samples outputs"]
    mask: Float[Array, "samples outputs"]
    weights: Float[Array, " outputs"]
    low: Float[Array, " constants"]
    high: Float[Array, " constants"]
    rcond: float | None = eqx.field(static=True)

    @classmethod
    def of(
        cls,
        network: SystemNetwork,
        patterns: Patterns,
        weights: Float[np.ndarray, " outputs"],
        bounds: tuple[Float[np.ndarray, " constants"], Float[np.ndarray, " constants"]],
        rcond: float | None = None,
        samples: int | None = None,
    ) -> "ProjectedError":
        """Return the error on patterns, or on at most `samples` of them, evenly spread in time."""
        step = 1 if samples is None else -(-patterns.samples // samples)
        arrays = (patterns.q, patterns.qd, patterns.qdd, patterns.torque, patterns.mask)
        q, qd, qdd, torque, mask = (jnp.asarray(x[::step], float) for x in arrays)
        low, high = (jnp.asarray(x) for x in bounds)
        return cls(
            network, q, qd, qdd, torque, mask, jnp.asarray(weights), low, high, rcond
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

    def solve(self, factors: JointFactors) -> Solution:
        """The best coefficients, by the direct solve."""
        return minimum(Unknowns.of(self.network), factors, self.weights, self.rcond)

    def judged(self, values: Float[Array, " constants"]) -> JudgedError:
        """The error with the best coefficients."""
        factors = self.factors(*self.equations(values))
        error = factors.root_mean_squares(Unknowns.of(self.network), self.solve(factors).k)
        parts = factors.counts * (self.weights * error) ** 2
        return JudgedError(jnp.sqrt(jnp.sum(parts) / jnp.sum(factors.counts)), jnp.asarray(error))

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
