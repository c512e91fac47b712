from typing import Literal

import equinox as eqx
import jax.numpy as jnp
import numpy as np
from jax.core import Tracer
from jaxtyping import Array, Float

from ...motion import Patterns
from ...network import CSLC
from ._compiled import filled_up, regressor_of, require_float64
from ._correlated import ERRORS, Errors
from ._equations import Equations
from ._factors import JointFactors, factorise
from ._held import Held
from ._identification import Identification
from ._losses import LOSSES, Loss
from ._robust import ordinary_residuals, robust_residuals, with_errors
from ._rows import AbstractRows, KeptRows, PatternRows
from ._solution import RESULTS
from ._solve import Solution, solve


JointWeights = Literal["equal", "residual"] | Float[Array | np.ndarray, " joints"]
# Weights settle to a percent in two rounds: residuals hardly depend on them.
_ROUNDS = 3
# A regressor of no more entries is kept for the second pass, half a gigabyte of them.
_KEPT = 1 << 26


def least_squares(
    network: CSLC,
    patterns: Patterns,
    *,
    cutoff: float | None = None,
    joint_weights: JointWeights = "equal",
    loss: Loss = "squared",
    errors: Errors = "independent",
    rcond: float | None = None,
    throw: bool = True,
) -> Identification:
    """The coefficients that minimise the squared torque error over the patterns that count.

    The direct solve that the thesis hoped for (Eqn. 4.1-4, section 8.2.3): torque is linear in
    the coefficients, so one orthogonal factorisation replaces training.

    **Arguments**

    - `network`: n joints, p coefficients.
    - `patterns`: motion and torque (samples, n); pairs outside `patterns.mask` are left out.
    - `cutoff`: filter regressor and torque alike by a zero-phase low pass of this frequency [Hz]
      and decimate ('parallel filter', see `jaxcslc.motion.parallel_filter`). Needs a uniform
      sampling interval, and runs on the host: not under `jit`.
    - `joint_weights`: `"equal"`; `"residual"` divides each joint's equations by its own root mean
      square residual, as for joints of different noise; or (n,) weights.
    - `loss`: `"squared"`, ordinary least squares; or one that outliers pull less at,
      `"huber"` (no harder than errors of 1.345 standard deviations) or `"bisquare"` (not at all
      beyond 4.685), minimised by iteratively reweighted least squares. Each joint's standard
      deviation is then estimated by the median modulus of its errors, and `"residual"` divides by
      that. With `cutoff` it is the filtered equations that are reweighted: an outlier should not
      be longer than a filter's memory.
    - `errors`: what standard errors allow for. `"independent"`: errors that have nothing to do
      with each other, of one variance once joints are weighted. `"correlated"`: correlation in
      time, as every smoothing makes it, and between joints, and strength that varies with the
      motion; a second pass over the patterns. See `docs/uncertainty.md`.
    - `rcond`: singular values below this part of the largest count as zero; by default what
      rounding alone explains.
    - `throw`: raise on NaN and on too few equations instead of returning the result code. A
      rank-deficient fit never raises: it returns the rest and names what is missing.

    **Returns** an `Identification`. Without `cutoff` and with `throw=False` the function can be
    jitted and vmapped over recordings.

    **Raises**

    - `ValueError`: if patterns and network differ in joints, or are not in float64; or for an
      unknown word.
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
    return checked(
        fit_patterns(
            network,
            patterns,
            cutoff=cutoff,
            joint_weights=joint_weights,
            loss=loss,
            errors=errors,
            rcond=rcond,
        ),
        throw,
    )


def fit_patterns(
    network: CSLC,
    patterns: Patterns,
    *,
    cutoff: float | None,
    joint_weights: JointWeights,
    loss: Loss,
    errors: Errors,
    rcond: float | None,
    held: Held | None = None,
) -> Identification:
    """The fit of patterns, of all coefficients or of those that are not held."""
    check_patterns(network, patterns)
    check_words(loss, errors)
    # The ordinary fit needs no more of its equations than their factors.
    again = loss != "squared" or errors != "independent"
    rows: AbstractRows | None = None
    samples = patterns.q.shape[0]
    if cutoff is None:
        weight = jnp.asarray(patterns.mask, float)
        motion = (patterns.q, patterns.qd, patterns.qdd, patterns.torque, weight)
        q, qd, qdd, torque, weight = (jnp.asarray(filled_up(x)) for x in motion)
        factors = _factorise(network, q, qd, qdd, torque, weight)
        if again and (_traced(*motion) or patterns.q.size * network.size > _KEPT):
            phase = (jnp.arange(len(q)) + 0.5) / samples
            rows = PatternRows(q, qd, qdd, torque, weight, phase)
        elif again:
            rows = KeptRows.of(equations_of(network, patterns, None), samples)
    else:
        equations = equations_of(network, patterns, cutoff)
        factors = equations.factors()
        rows = KeptRows.of(equations, samples) if again else None
    return fit_rows(
        network,
        factors,
        rows,
        joint_weights=joint_weights,
        loss=loss,
        errors=errors,
        rcond=rcond,
        held=held,
    )


def fit_rows(
    network: CSLC,
    factors: JointFactors,
    rows: AbstractRows | None,
    *,
    joint_weights: JointWeights,
    loss: Loss,
    errors: Errors,
    rcond: float | None,
    held: Held | None = None,
) -> Identification:
    """The fit of equations, which are gone over again if there are `rows` of them."""
    fit, solution, weights = _fit(network, factors, joint_weights, rcond, held)
    if rows is None:
        return fit
    if loss == "squared":
        found = _ordinary(network, rows, solution, weights)
    else:
        residual = isinstance(joint_weights, str) and joint_weights == "residual"
        found = _robust(
            network,
            rows,
            factors,
            solution,
            weights,
            residual_weights=residual,
            loss=loss,
            rcond=rcond,
            held=held,
        )
    return _with_errors(network, rows, factors, found, errors, held)


def fit_factors(
    network: CSLC,
    factors: JointFactors,
    *,
    joint_weights: JointWeights = "equal",
    rcond: float | None = None,
    throw: bool = True,
) -> Identification:
    """The ordinary fit of factorised patterns, for errors that are independent.

    Arguments, result and errors as of `least_squares`.
    """
    return checked(_fit(network, factors, joint_weights, rcond)[0], throw)


def _fit(
    network: CSLC,
    factors: JointFactors,
    joint_weights: JointWeights,
    rcond: float | None,
    held: Held | None = None,
) -> tuple[Identification, Solution, Float[Array, " joints"]]:
    """The ordinary fit, and the weights of joints that it ended with."""
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
    solution, fit = _solve(network, factors, weights, rcond, held)
    if isinstance(joint_weights, str) and joint_weights == "residual":
        for _ in range(_ROUNDS):
            weights = _residual_weights(fit)
            solution, fit = _solve(network, factors, weights, rcond, held)
    return fit, solution, weights


def checked(fit: Identification, throw: bool) -> Identification:
    """**Raises** `RuntimeError` for results that are failures, if `throw` says so."""
    if not throw:
        return fit
    # Rank deficiency is an answer, not a failure.
    failed = (fit.result == RESULTS.nonfinite) | (fit.result == RESULTS.no_equations)
    return fit.result.error_if(fit, failed)


def _residual_weights(fit: Identification) -> Float[Array, " joints"]:
    """One over each joint's residual; a joint without equations, or without error, weighs 1."""
    error = fit.torque_error
    largest = jnp.max(error)
    floor = jnp.where(largest > 0, 1e-12 * largest, 1.0)
    return jnp.where(fit.equations > 0, 1.0 / jnp.maximum(error, floor), 1.0)


def equations_of(network: CSLC, patterns: Patterns, cutoff: float | None) -> Equations:
    """One a pair that counts, or those that a parallel filter makes of them; on the host."""
    return Equations.of(
        network,
        np.asarray(regressor_of(network, patterns)),
        np.asarray(patterns.torque),
        np.asarray(patterns.mask),
        time=np.asarray(patterns.time),
        cutoff=cutoff,
    )


def _traced(*arrays: Array | np.ndarray) -> bool:
    return any(isinstance(x, Tracer) for x in arrays)


_factorise = eqx.filter_jit(factorise)
_solve = eqx.filter_jit(solve)
_ordinary = eqx.filter_jit(ordinary_residuals)
_robust = eqx.filter_jit(robust_residuals)
_with_errors = eqx.filter_jit(with_errors)


def check_words(loss: str, errors: str) -> None:
    if loss not in LOSSES:
        raise ValueError(f"loss is {loss!r}; expected {', '.join(map(repr, LOSSES))}")
    if errors not in ERRORS:
        raise ValueError(f"errors is {errors!r}; expected {' or '.join(map(repr, ERRORS))}")


def check_patterns(network: CSLC, patterns: Patterns) -> None:
    """**Raises** `ValueError` for another robot's patterns, and for others than float64."""
    if patterns.q.shape[-1] != network.joint_count:
        raise ValueError(
            f"patterns have {patterns.q.shape[-1]} joints, {network.robot.name!r} has"
            f" {network.joint_count}"
        )
    require_float64(patterns.q, patterns.qd, patterns.qdd, patterns.torque)
