from typing import Literal

import equinox as eqx
import jax.numpy as jnp
import numpy as np
from jaxtyping import Array, Float

from ..motion import Patterns
from ..network import CSLC
from ._compiled import filled_up, regressor_of, require_float64
from ._equations import Equations
from ._factors import JointFactors, factorise
from ._identification import Identification, solve
from ._solution import RESULTS


JointWeights = Literal["equal", "residual"] | Float[Array | np.ndarray, " joints"]
# Weights settle to a percent in two rounds: residuals hardly depend on them.
_ROUNDS = 3


def least_squares(
    network: CSLC,
    patterns: Patterns,
    *,
    cutoff: float | None = None,
    joint_weights: JointWeights = "equal",
    rcond: float | None = None,
    throw: bool = True,
) -> Identification:
    """The coefficients that minimise the squared torque error over the patterns that count.

    The direct solve that the thesis hoped for (Eqn. 4.1-4, section 8.2.3): torque is linear in
    the coefficients, so one orthogonal factorisation replaces training.

    **Arguments**

    - `network`: n joints, p coefficients.
    - `patterns`: motion and torque (samples, n); pairs outside `patterns.counts_in` are left out.
    - `cutoff`: filter regressor and torque alike by a zero-phase low pass of this frequency [Hz]
      and decimate ('parallel filter', see `jaxcslc.motion.parallel_filter`). Needs a uniform
      sampling interval, and runs on the host: not under `jit`.
    - `joint_weights`: `"equal"`; `"residual"` divides each joint's equations by its own root mean
      square residual, as for joints of different noise; or (n,) weights.
    - `rcond`: singular values below this part of the largest count as zero; by default what
      rounding alone explains.
    - `throw`: raise on NaN and on too few equations instead of returning the result code. A
      rank-deficient fit never raises: it returns the rest and names what is missing.

    **Returns** an `Identification`. Without `cutoff` and with `throw=False` the function can be
    jitted and vmapped over recordings.

    **Raises**

    - `ValueError`: if patterns and network differ in joints, or are not in float64.
    - `RuntimeError`: with `throw`, if patterns are not finite or too few.

    >>> import jax.numpy as jnp, numpy as np, jaxcslc as jc
    >>> pendulum = jc.Manipulator.from_modified_dh([(0, 0, 0, 0)], gravity=(0, -9.81, 0))
    >>> network = jc.derive(pendulum, lengths="numeric")
    >>> t = np.linspace(0, 5, 500)[:, None]
    >>> q, qd, qdd = np.sin(t), np.cos(t), -np.sin(t)
    >>> k = jnp.array([0.5, 0.3, -0.1, 0.2, 0.05])
    >>> everything = np.ones(q.shape, bool)
    >>> torque = network.torque(k, q, qd, qdd)
    >>> patterns = jc.Patterns(t[:, 0], q, qd, qdd, torque, everything, everything)
    >>> bool(jnp.allclose(jc.least_squares(network, patterns).k, k))
    True
    """
    _check(network, patterns)
    if cutoff is None:
        weight = jnp.asarray(patterns.counts_in, float)
        motion = (patterns.q, patterns.qd, patterns.qdd, patterns.torque, weight)
        factors = _factorise(network, *(jnp.asarray(filled_up(x)) for x in motion))
    else:
        factors = Equations.of(
            network,
            np.asarray(regressor_of(network, patterns)),
            np.asarray(patterns.torque),
            np.asarray(patterns.counts_in),
            time=np.asarray(patterns.time),
            cutoff=cutoff,
        ).factors()
    return fit_factors(network, factors, joint_weights=joint_weights, rcond=rcond, throw=throw)


def fit_factors(
    network: CSLC,
    factors: JointFactors,
    *,
    joint_weights: JointWeights = "equal",
    rcond: float | None = None,
    throw: bool = True,
) -> Identification:
    """The fit of factorised patterns; arguments, result and errors as of `least_squares`."""
    n = network.joint_count
    if isinstance(joint_weights, str):
        if joint_weights not in ("equal", "residual"):
            raise ValueError(
                f"joint_weights must be 'equal', 'residual' or ({n},) numbers,"
                f" got {joint_weights!r}"
            )
        weights = jnp.ones(n)
    else:
        weights = jnp.asarray(joint_weights, float)
        if weights.shape != (n,):
            raise ValueError(f"joint_weights: expected shape ({n},), got {weights.shape}")
    fit = _solve(network, factors, weights, rcond)
    if isinstance(joint_weights, str) and joint_weights == "residual":
        for _ in range(_ROUNDS):
            fit = _solve(network, factors, _residual_weights(fit), rcond)
    if throw:
        # Rank deficiency is an answer, not a failure.
        failed = (fit.result == RESULTS.nonfinite) | (fit.result == RESULTS.no_equations)
        fit = fit.result.error_if(fit, failed)
    return fit


def _residual_weights(fit: Identification) -> Float[Array, " joints"]:
    """One over each joint's residual; a joint without equations, or without error, weighs 1."""
    error = fit.torque_error
    largest = jnp.max(error)
    floor = jnp.where(largest > 0, 1e-12 * largest, 1.0)
    return jnp.where(fit.equations > 0, 1.0 / jnp.maximum(error, floor), 1.0)


_factorise = eqx.filter_jit(factorise)
_solve = eqx.filter_jit(solve)


def _check(network: CSLC, patterns: Patterns) -> None:
    if patterns.q.shape[-1] != network.joint_count:
        raise ValueError(
            f"patterns have {patterns.q.shape[-1]} joints, {network.robot.name!r} has"
            f" {network.joint_count}"
        )
    require_float64(patterns.q, patterns.qd, patterns.qdd, patterns.torque)
