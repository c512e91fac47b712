"""The result of maximum likelihood, and the misfit of fixed coefficients."""

import dataclasses
from typing import Any, NamedTuple

import equinox as eqx
import numpy as np
from jaxtyping import Array, Bool, Float, Int

from .._environment import as_jax
from ..bodies import PhysicalParameters
from ..least_squares import RESULTS, Errors, Identification
from ..network import CSLC
from ..uncertainty import SystematicError
from ._normal_equations import Spectrum
from ._reported_errors import CorrelatedErrors, RowSums, reported_errors, systematic_errors
from ._search import Minimum
from ._spacing import NoiseExcitation, SpacingChoice


# A coefficient that shares this part of a unit null vector is not determined by itself.
_SHARE = 1e-6


class LikelihoodFit(eqx.Module):
    """Coefficients, positions and noise levels that make a recording most likely.

    **Attributes**

    - `network`: with the slopes that were fitted: `network.torque(fit.k, ...)` predicts.
    - `fit`: its coefficients. `independent_covariance` is the inverse of the information that
      positions, slopes, encoder offsets and reversals leave: the Cramér-Rao bound for noise of the
      estimated levels, or what the edges of encoders' intervals leave. `covariance` allows for
      what `MaximumLikelihood.errors` says.
    - `slopes`: (n,) of static friction [s/rad or s/m]; `slope_error`: their standard deviations.
      Zeros for a network without static friction.
    - `offset`: (recordings, n) of each encoder within a step [rad or m]; `offset_error`.
    - `position`: (samples, n) estimated positions [rad or m], of one recording after the other; at
      every `MaximumLikelihood.every`-th sample.
    - `torque_noise`: (recordings, n) [N m or N]; `position_noise`: (recordings, n) [rad or m]:
      standard deviations.
    - `edge`: (recordings, n) widths of the edges of counts that are intervals, in steps of the
      encoder; 0 where readings count as normally distributed.
    - `reversal_moments`: (samples, n) when a joint reverses next to a sample, in intervals after
      it; NaN where it does not.
    - `reversals`: how many moments of reversals were estimated.
    - `steps`: of the search; `converged`: whether it ended at a minimum.
    - `bodies`: with `MaximumLikelihood.possible`, those whose coefficients `fit` has; its standard
      errors are those of coefficients that nothing confines, an upper bound. `free`: the fit
      without bodies. Both are None otherwise.
    - `every`: positions were unknown at every so many samples.
    - `systematic`: what a wrong time of torques, and terms that the network lacks, may do to `fit`
      beyond its standard errors, by cause (`uncertainty_interval(fit, systematic)`); None with
      `errors="independent"`, and where more than joints moves.
    - `presliding_distance`: (n,) [rad or m], as that of `MaximumLikelihood`: dry friction of these
      joints is for motion that slides. Standard errors are for known distances.
    - `spacing`: why positions are as far apart as they are, where `every` was `"auto"`; None
      otherwise.

    >>> import numpy as np, jaxcslc as jc
    >>> robot = jc.Manipulator.from_modified_dh([(0, 0, 0, 0)], gravity=(0, 0, -9.81))
    >>> network = jc.derive(robot.with_friction("viscous"), lengths="numeric")
    >>> t = np.arange(200)[:, None] * 0.01
    >>> torque = 0.5 * -4 * np.sin(2 * t) + 0.2 * 2 * np.cos(2 * t)
    >>> recording = jc.Recording(t[:, 0], np.sin(2 * t), torque)
    >>> result = jc.MaximumLikelihood(torque_sampling="sampled").fit(network, recording)
    >>> result.converged, result.position.shape, result.fit.names
    (True, (200, 1), ('kB1', 'kv1'))
    """

    network: CSLC
    fit: Identification
    slopes: Float[np.ndarray, " joints"]
    slope_error: Float[np.ndarray, " joints"]
    offset: Float[np.ndarray, "recordings joints"]
    offset_error: Float[np.ndarray, "recordings joints"]
    position: Float[np.ndarray, "samples joints"]
    torque_noise: Float[np.ndarray, "recordings joints"]
    position_noise: Float[np.ndarray, "recordings joints"]
    edge: Float[np.ndarray, "recordings joints"]
    reversal_moments: Float[np.ndarray, "samples joints"]
    presliding_distance: Float[np.ndarray, " joints"]
    reversals: int = eqx.field(static=True)
    steps: int = eqx.field(static=True)
    converged: bool = eqx.field(static=True)
    bodies: PhysicalParameters | None = None
    free: Identification | None = None
    systematic: SystematicError | None = None
    every: int = eqx.field(static=True, default=1)
    spacing: SpacingChoice | None = eqx.field(static=True, default=None)
    noise_excitation: NoiseExcitation | None = eqx.field(static=True, default=None)

    @property
    def k(self) -> Float[Array, " coefficients"]:
        """The coefficients, (p,)."""
        return self.fit.k

    def at(self, samples: Bool[np.ndarray, " samples"]) -> "LikelihoodFit":
        """Return the same with some of the estimated positions."""
        return dataclasses.replace(
            self,
            position=self.position[samples],
            reversal_moments=self.reversal_moments[samples],
        )

    def __repr__(self) -> str:
        noise = "; ".join(
            ", ".join(f"{level:.2g}" for level in levels) for levels in self.torque_noise
        )
        ended = "converged" if self.converged else "did not converge"
        return (
            f"LikelihoodFit({ended} after {self.steps} steps; torque noise [{noise}]; {self.fit})"
        )


@dataclasses.dataclass(frozen=True)
class Misfit:
    """Residuals of recordings with fixed coefficients, when positions are estimated.

    **Attributes**

    - `error`: (equations, n), root of the squares of an equation's torque residual and of its
      reading, each in standard deviations of its noise.
    - `torque`: (equations, n) residuals [N m or N].
    - `mask`: (equations, n), equations that count: neither next to a reversal nor at standstill.

    >>> import numpy as np, jaxcslc as jc
    >>> robot = jc.Manipulator.from_modified_dh([(0, 0, 0, 0)], gravity=(0, 0, -9.81))
    >>> network = jc.derive(robot.with_friction("viscous"), lengths="numeric")
    >>> t = np.arange(200)[:, None] * 0.01
    >>> torque = 0.5 * -4 * np.sin(2 * t) + 0.2 * 2 * np.cos(2 * t)
    >>> recording = jc.Recording(t[:, 0], np.sin(2 * t), torque)
    >>> levels = np.array([0.01]), np.array([1e-5])
    >>> estimator = jc.MaximumLikelihood(torque_sampling="sampled")
    >>> right, wrong = (
    ...     np.mean(estimator.misfit(network, recording, np.array(k), *levels).error)
    ...     for k in ([0.5, 0.2], [0.5, 0.3])
    ... )
    >>> bool(right < 0.1 * wrong)
    True
    """

    error: Float[np.ndarray, "equations joints"]
    torque: Float[np.ndarray, "equations joints"]
    mask: Bool[np.ndarray, "equations joints"]

    @classmethod
    def of(cls, minimum: Minimum, part: Int[np.ndarray, " samples"], joints: int) -> "Misfit":
        """Read it off the minimum of a search; `part`: number of the recording of each sample."""
        left, of_equation = minimum.linear.residuals, part[1:-1]
        error = np.hypot(
            left["torque"][:, :joints] / minimum.torque_noise[of_equation],
            left["position"][1:-1] / minimum.position_noise[of_equation],
        )
        return cls(error, left["torque"][:, :joints], minimum.counted)


class BorderErrors(NamedTuple):
    """Errors of all that equations share, for independent or correlated residuals.

    - `reported`: of the border in units of its scale; `spectrum`: of its information.
    - `covariance`, `independent_covariance`: (border, border).
    - `error`: (border,) standard errors; infinite for what the recording does not determine.
    """

    reported: CorrelatedErrors
    spectrum: Spectrum
    covariance: Float[np.ndarray, "border border"]
    independent_covariance: Float[np.ndarray, "border border"]
    error: Float[np.ndarray, " border"]


def border_errors(minimum: Minimum, errors: Errors) -> BorderErrors:
    """Return the errors of the end of a search; `errors`: as of `MaximumLikelihood`."""
    spectrum, scale = Spectrum.of(minimum.factored.information), minimum.objective.scale
    counts, inverse = minimum.counted.sum(axis=0).astype(float), spectrum.covariance
    sums = RowSums.of(minimum.linear, minimum.factored)
    bound = sums.independent_covariance(inverse)
    freedom = max(float(counts.sum()) - len(minimum.point.k), 1.0)
    reported = CorrelatedErrors(bound, freedom, counts)
    if errors == "correlated":
        reported = reported_errors(minimum.linear, sums, inverse, bound, minimum.counted)
    independent, covariance = (
        matrix * scale[:, None] * scale[None, :] for matrix in (bound, reported.covariance)
    )
    unclear = np.sqrt(np.sum(spectrum.undetermined**2, axis=0)) >= _SHARE
    error = np.where(unclear, np.inf, np.sqrt(np.maximum(np.diag(covariance), 0.0)))
    return BorderErrors(reported, spectrum, covariance, independent, error)


def likelihood_fit(network: CSLC, minimum: Minimum, errors: Errors) -> LikelihoodFit:
    """Return the result of a search, with standard errors for independent or correlated
    residuals."""
    point, p, n = minimum.point, network.size, network.joint_count
    residual, used = minimum.linear.residuals["torque"][:, :n], minimum.counted
    counts = used.sum(axis=0).astype(float)
    reported, spectrum, covariance, independent, error = border_errors(minimum, errors)
    systematic = None
    if errors == "correlated" and point.q.shape[1] == n:
        systematic = systematic_errors(
            minimum.linear, minimum.factored, point, used, reported.effective
        )
    null = spectrum.undetermined[:, :p]
    undetermined = np.zeros((p, p))
    undetermined[: len(null)] = null * (minimum.objective.scale / spectrum.unit)[:p]
    squares = np.sum(np.where(used, residual, 0.0) ** 2, axis=0)
    complete = len(null) == 0
    # Put on the device together: one by one, each is a program of its own.
    arrays: dict[str, Any] = as_jax(
        {
            "k": point.k,
            "standard_error": error[:p],
            "covariance": covariance[:p, :p],
            "independent_covariance": independent[:p, :p],
            "torque_error": np.sqrt(squares / np.maximum(counts, 1.0)),
            "equations": counts,
            "effective_equations": reported.effective,
            "degrees_of_freedom": np.float64(reported.degrees_of_freedom),
            "rank": p - len(null),
            "condition": np.sqrt(spectrum.values[-1] / spectrum.values[spectrum.counted][0]),
            "undetermined": undetermined,
            "determined": np.isfinite(error[:p]),
        }
    )
    result = RESULTS.successful if complete else RESULTS.rank_deficient
    fit = Identification(**arrays, result=result, names=network.names, errors=errors)
    static = network.static_slopes is not None
    slopes = np.exp(point.slopes) if static else np.zeros(n)
    intervals, part = minimum.objective.readings.intervals, minimum.objective.readings.part
    return LikelihoodFit(
        network=network.with_static_slopes(slopes) if static else network,
        fit=fit,
        slopes=slopes,
        slope_error=slopes * error[p : p + n],
        offset=point.offset,
        offset_error=error[point.layout.part("offset")].reshape(point.offset.shape),
        position=point.q[:, :n],
        torque_noise=minimum.torque_noise,
        position_noise=minimum.position_noise,
        edge=np.zeros_like(point.offset) if intervals is None else intervals.edges(part),
        reversal_moments=minimum.objective.motion.signs.moments(point.turn, len(point.q)),
        presliding_distance=minimum.objective.motion.equations.presliding_distance,
        reversals=len(minimum.objective.motion.signs.samples),
        steps=minimum.steps,
        converged=minimum.converged,
        systematic=systematic,
    )
