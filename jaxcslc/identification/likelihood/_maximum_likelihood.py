import dataclasses
from collections.abc import Callable, Sequence
from typing import get_args

import equinox as eqx
import jax.numpy as jnp
import numpy as np
from jaxtyping import Array, Float

from ..._environment import require_float64
from ...motion import Recording
from ...network import CSLC
from .._settings import Settings
from ..solver import RESULTS, Identification
from ._band import Spectrum
from ._readings import TorqueSampling
from ._search import Minimum, search
from ._start import starting_point


_FEWEST_SAMPLES = 10


class LikelihoodFit(eqx.Module):
    """Coefficients, positions and noise levels that make a recording most likely.

    **Attributes**

    - `network`: with the slopes that were fitted: `network.torque(fit.k, ...)` predicts.
    - `fit`: its coefficients. `covariance` is the inverse of the information that positions,
      slopes, encoder offsets and reversals leave: the Cramér-Rao bound for noise of the estimated
      levels.
    - `slopes`: (n,) of static friction [s/rad or s/m]; `slope_error`: their standard deviations.
      Zeros for a network without static friction.
    - `offset`: (recordings, n) of each encoder within a step [rad or m]; `offset_error`.
    - `position`: (samples, n) estimated positions [rad or m], of one recording after the other.
    - `torque_noise`: (recordings, n) [N m or N]; `position_noise`: (recordings, n) [rad or m]:
      standard deviations.
    - `reversals`: how many moments of reversals were estimated.
    - `steps`: of the search; `converged`: whether it ended at a minimum.

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
    reversals: int = eqx.field(static=True)
    steps: int = eqx.field(static=True)
    converged: bool = eqx.field(static=True)

    @property
    def k(self) -> Float[Array, " coefficients"]:
        """The coefficients, (p,)."""
        return self.fit.k

    def __repr__(self) -> str:
        noise = "; ".join(
            ", ".join(f"{level:.2g}" for level in levels) for levels in self.torque_noise
        )
        ended = "converged" if self.converged else "did not converge"
        return (
            f"LikelihoodFit({ended} after {self.steps} steps; torque noise [{noise}]; {self.fit})"
        )


@dataclasses.dataclass(frozen=True)
class MaximumLikelihood:
    """Identification without a smoothing: positions and coefficients are estimated together.

    Regression takes derivatives of smoothed positions as they are: what smoothing takes out of the
    motion is a bias that more data do not average out. Here the true position at every sample is
    an unknown beside the coefficients k,

        minimise  Σ ((y - q - offset) / σ_q)² + Σ ((torque - ID(q, q', q''; k)) / σ_τ)²

    with velocities and accelerations from differences of the unknown q, errors in variables
    (Britt and Luecke 1973). The equations are banded in time and bordered by k; each Gauss-Newton
    step eliminates the positions exactly, in memory and time that are linear in the recording.

    - Friction is averaged over two intervals as the second difference averages acceleration, with
      the moment of each reversal as an unknown. Which way a joint moves is fixed while a step is
      judged, so that the objective is smooth.
    - Torque noise of each joint is estimated by marginal likelihood, from a large value downwards;
      so is the noise of positions, but for encoders, whose step is read off the recording. Their
      constant offset within a step is an unknown.
    - Where a joint rests, friction has any value up to break-away: its equation is left out and
      its readings count as one. Equations far beyond the noise count by size, not square (Huber).

    Right where torque acts on rigid bodies. Compliance and backlash make errors that are neither
    white nor small; see `docs/likelihood.md` for what that costs.

    **Attributes**

    - `torque_sampling`: `"held"`, a demand that acts until the next sample; or `"sampled"`.
    - `settings`: of the regression that it starts from; None for the defaults of `Settings`.
    - `resolution`: (n,) of the encoders [rad or m], 0 for none; read off the recording if None.

    **Raises** `ValueError`: a `torque_sampling` that is neither.

    >>> import numpy as np, jaxcslc as jc
    >>> robot = jc.Manipulator.from_modified_dh([(0, 0, 0, 0)], gravity=(0, -9.81, 0))
    >>> network = jc.derive(robot.with_friction("viscous"), lengths="numeric")
    >>> t = np.arange(300)[:, None] * 0.01
    >>> q, qd, qdd = np.sin(2 * t), 2 * np.cos(2 * t), -4 * np.sin(2 * t)
    >>> torque = np.asarray(network.torque(np.array([0.5, 0.3, -0.1, 0.2]), q, qd, qdd))
    >>> recording = jc.Recording(t[:, 0], q, torque)
    >>> result = jc.MaximumLikelihood(torque_sampling="sampled").fit(network, recording)
    >>> np.round(result.k, 3).tolist()
    [0.5, 0.3, -0.1, 0.2]
    """

    torque_sampling: TorqueSampling = "held"
    settings: Settings | None = None
    resolution: tuple[float, ...] | None = None

    def __post_init__(self) -> None:
        if self.torque_sampling not in get_args(TorqueSampling):
            raise ValueError(
                f"torque_sampling {self.torque_sampling!r} is unknown; expected 'held' or 'sampled'"
            )

    def fit(
        self,
        network: CSLC,
        recording: Recording | Sequence[Recording],
        start: Identification | None = None,
        progress: Callable[[str], None] | None = None,
    ) -> LikelihoodFit:
        """The most likely coefficients of a recording, or of several together.

        **Arguments**

        - `network`: n joints, p coefficients; without a payload.
        - `recording`: at least ten samples. Velocities that it holds are not used. Each of several
          has noise levels and encoder offsets of its own.
        - `start`: coefficients to start from; by default those of a regression.
        - `progress`: is called with a few words at each stage.

        **Returns** a `LikelihoodFit`; look at `converged`.

        **Raises**

        - `ValueError`: recording and network differ in joints, the recording is too short, or the
          network has a payload.
        - `RuntimeError`: the regression that it starts from fails.
        """
        require_float64()
        recordings = [recording] if isinstance(recording, Recording) else list(recording)
        _check(network, recordings)
        problem, point, torque_noise, position_noise = starting_point(
            network,
            recordings,
            self.settings or Settings(),
            self.torque_sampling,
            None if self.resolution is None else np.array(self.resolution),
            start,
        )
        report = progress or (lambda words: None)
        return _result(network, search(problem, point, torque_noise, position_noise, report))


def _check(network: CSLC, recordings: Sequence[Recording]) -> None:
    """**Raises** `ValueError` as `MaximumLikelihood.fit`."""
    n = network.joint_count
    if network.payload is not None:
        raise ValueError(f"{network.name!r} has a payload; expected a network without one")
    if not recordings:
        raise ValueError("got no recording; expected one or more")
    for number, recording in enumerate(recordings, start=1):
        which = "the recording" if len(recordings) == 1 else f"recording {number}"
        if recording.position.shape[1] != n:
            raise ValueError(
                f"{which} has {recording.position.shape[1]} joints; expected {n}, those of"
                f" {network.name!r}"
            )
        if recording.samples < _FEWEST_SAMPLES:
            raise ValueError(
                f"{which} has {recording.samples} samples; expected at least {_FEWEST_SAMPLES}"
            )


# A coefficient that shares this part of a unit null vector is not determined by itself.
_SHARE = 1e-6


def _result(network: CSLC, minimum: Minimum) -> LikelihoodFit:
    point, p, n = minimum.point, network.size, network.joint_count
    spectrum, border = Spectrum.of(minimum.information), minimum.objective.scale
    covariance = spectrum.covariance * border[:, None] * border[None, :]
    null = spectrum.undetermined[:, :p]
    undetermined = np.zeros((p, p))
    undetermined[: len(null)] = null * (border / spectrum.unit)[:p]
    determined = np.sqrt(np.sum(null**2, axis=0)) < _SHARE
    error = np.sqrt(np.diag(covariance))
    residual, used = minimum.linear.residuals.torque, minimum.counted
    counts = used.sum(axis=0).astype(float)
    squares = np.sum(np.where(used, residual, 0.0) ** 2, axis=0)
    complete = len(null) == 0
    fit = Identification(
        k=jnp.asarray(point.k),
        standard_error=jnp.asarray(np.where(determined, error[:p], np.inf)),
        covariance=jnp.asarray(covariance[:p, :p]),
        independent_covariance=jnp.asarray(covariance[:p, :p]),
        torque_error=jnp.asarray(np.sqrt(squares / np.maximum(counts, 1.0))),
        equations=jnp.asarray(counts),
        effective_equations=jnp.asarray(counts),
        degrees_of_freedom=jnp.asarray(max(float(counts.sum()) - p, 1.0)),
        rank=jnp.asarray(p - len(null)),
        condition=jnp.asarray(np.sqrt(spectrum.values[-1] / spectrum.values[spectrum.counted][0])),
        undetermined=jnp.asarray(undetermined),
        determined=jnp.asarray(determined),
        result=RESULTS.successful if complete else RESULTS.rank_deficient,
        names=network.names,
        errors="independent",
    )
    static = network.static_slopes is not None
    slopes = np.exp(point.slopes) if static else np.zeros(n)
    return LikelihoodFit(
        network=network.with_static_slopes(slopes) if static else network,
        fit=fit,
        slopes=slopes,
        slope_error=slopes * error[p : p + n],
        offset=point.offset,
        offset_error=error[p + n :].reshape(point.offset.shape),
        position=point.q,
        torque_noise=minimum.torque_noise,
        position_noise=minimum.position_noise,
        reversals=len(minimum.objective.signs.samples),
        steps=minimum.steps,
        converged=minimum.converged,
    )
