"""The estimator of maximum likelihood: its options, and what it fits."""

import dataclasses
from collections.abc import Callable, Sequence
from typing import Any, Literal, NamedTuple, get_args

import numpy as np
from jaxtyping import Array, Float

from .._environment import require_float64
from ..bodies import Prior
from ..least_squares import ERRORS, Errors, Identification, Settings
from ..network import CSLC
from ..recordings import Recording
from ._likelihood_fit import SPACED, LikelihoodFit, Misfit, likelihood_fit
from ._point import Point
from ._possible_bodies import possible_bodies
from ._problem import LikelihoodProblem, SearchStart, check_prior, starting_point
from ._readings import TorqueSampling
from ._search import Minimum, search
from ._spacing import NoiseExcitation, SpacingChoice, excess_noise, spacing_for


class _Searched(NamedTuple):
    """A problem, where its search started, where it ended, noise that excites there, and why
    positions are as far apart as they are."""

    problem: LikelihoodProblem
    first: SearchStart
    minimum: Minimum
    noise: NoiseExcitation
    spacing: SpacingChoice | None = None


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
    - Noise of positions and of each joint's torque is estimated by marginal likelihood, from a
      large value downwards; that of an encoder is at least that of its step, which is read off the
      recording. An encoder's constant offset within a step is an unknown.
    - Where the equations say much more of a motion than single counts do, a count is the interval
      that it is: the position is within a step of it. The edges of these intervals say more than
      counts with normally distributed errors would; elsewhere counts have such errors.
    - Where a joint rests, friction has any value up to break-away: torque that it bears bounds
      its coefficients (a censored observation), and its readings count as one. Equations far beyond
      the noise count by size, not square (Huber).

    Right where torque acts on rigid bodies. Compliance and backlash make errors that are neither
    white nor small: see `every`, and `docs/likelihood.md`.

    **Attributes**

    - `torque_sampling`: `"held"`, a demand that acts until the next sample; or `"sampled"`.
    - `settings`: of the regression that it starts from; None for the defaults of `Settings`.
    - `resolution`: (n,) of the encoders [rad or m], 0 for none; read off the recording if None.
    - `errors`: what standard errors allow for: `"independent"` residuals of the estimated levels
      only, for which they are the Cramér-Rao bound; or `"correlated"` ones where a test says that
      residuals are, as a model that lacks something leaves them.
    - `every`: equations of motion hold over two times so many samples, and positions are unknown at
      every so many; torque between them counts, readings do not. Two or more for arms whose
      transmission vibrates: a rigid model is right below those frequencies only. `"auto"`: 1, and
      3 where positions have more noise than readings explain; more where noise excites
      (`NoiseExcitation`).
    - `prior`: values of coefficients that are known beforehand, with their errors, or fixed; with
      `possible`, of links, too.
    - `possible`: whether coefficients are those of consistent bodies, near to the robot's where the
      recording says nothing (`physical_parameters`), with positions that belong to them.
    - `presliding_distance`: (n,) over which dry friction yields before it slides [rad or m], such
      as that of `fit_pre_sliding`; 0 where it follows the sign of velocity; of no joint if there
      are none.

    **Raises** `ValueError`: a `torque_sampling`, `errors` or `every` that is none of these, bounds
    in a prior, or links without `possible`.

    >>> import numpy as np, jaxcslc as jc
    >>> network = jc.derive(jc.examples.pendulum("viscous"), lengths="numeric")
    >>> recording = jc.examples.swing_recording(network, [0.5, 0.3, -0.1, 0.2], samples=300)
    >>> result = jc.MaximumLikelihood(torque_sampling="sampled").fit(network, recording)
    >>> np.round(result.k, 3).tolist()
    [0.5, 0.3, -0.1, 0.2]
    """

    torque_sampling: TorqueSampling = "held"
    settings: Settings | None = None
    resolution: tuple[float, ...] | None = None
    errors: Errors = "correlated"
    every: int | Literal["auto"] = "auto"
    prior: Prior | None = None
    possible: bool = False
    presliding_distance: tuple[float, ...] = ()

    def __post_init__(self) -> None:
        if self.torque_sampling not in get_args(TorqueSampling):
            raise ValueError(
                f"torque_sampling {self.torque_sampling!r} is unknown; expected 'held' or 'sampled'"
            )
        if self.errors not in ERRORS:
            raise ValueError(f"errors: expected {' or '.join(ERRORS)}, got {self.errors!r}")
        if self.every != "auto" and self.every < 1:
            raise ValueError(f"every: expected 1 or more or 'auto', got {self.every}")
        check_prior(self.prior, possible=self.possible)

    def fit(
        self,
        network: CSLC,
        recording: Recording | Sequence[Recording],
        start: Identification | LikelihoodFit | None = None,
        progress: Callable[[str], None] | None = None,
    ) -> LikelihoodFit:
        """Fit the most likely coefficients of a recording, or of several together.

        **Arguments**

        - `network`: n joints, p coefficients; without a payload.
        - `recording`: at least ten samples. Velocities that it holds are not used. Each of several
          has noise levels and encoder offsets of its own.
        - `start`: coefficients to start from; by default those of a regression. Or a fit that is
          near, with positions at the same samples, as of recordings that go on: its noise levels
          are kept, and a few steps are enough.
        - `progress`: is called with a few words at each step.

        **Returns** a `LikelihoodFit`; look at `converged`.

        **Raises**

        - `ValueError`: recording and network differ in joints, the recording is too short, the
          network has a payload, distances are not n or of joints without dry friction.
        - `RuntimeError`: the regression that it starts from fails, or no bodies are possible.
        - `ImportError`: with `possible`, without the conic solver (the extra `inertia`).
        """
        require_float64()
        recordings = [recording] if isinstance(recording, Recording) else list(recording)
        report = progress or (lambda words: None)
        if isinstance(start, LikelihoodFit):
            problem, minimum = self._near(network, recordings, start, report)
            fields: dict[str, Any] = {name: getattr(start, name) for name in SPACED}
            levels = None  # those of `start`
        else:
            problem, first, minimum, noise, spacing = self._spaced(
                network, recordings, start, report
            )
            fields = {"every": noise.every, "spacing": spacing, "noise_excitation": noise}
            levels = first[1:]
        fit = likelihood_fit(network, minimum, self.errors, **fields)
        if not self.possible:
            return fit
        found = network, problem, minimum, fit, levels
        return possible_bodies(*found, prior=self.prior, errors=self.errors, progress=report)

    def _spaced(
        self,
        network: CSLC,
        recordings: Sequence[Recording],
        start: Identification | None,
        report: Callable[[str], None],
    ) -> _Searched:
        """Search with positions as far apart as they are to be, and say why if that is chosen."""

        def searched(every: int) -> _Searched:
            problem, first = self.start(network, recordings, start, every)
            minimum = search(problem, *first, report)
            noise = NoiseExcitation.of(network, minimum, first.point.q, every)
            return _Searched(problem, first, minimum, noise)

        if self.every != "auto":
            return searched(self.every)
        result = searched(1)
        excess = excess_noise(result.problem, result.minimum)
        noisy: tuple[NoiseExcitation, ...] = ()
        samples = min(recording.samples for recording in recordings)
        wider: int | None = spacing_for(excess, samples)
        while wider:
            if wider > result.noise.every:
                result = searched(wider)
            wider = result.noise.wider_spacing(samples)
            noisy += (result.noise,) if wider else ()
        spacing = SpacingChoice(result.noise.every, tuple(excess.tolist()), noisy)
        return result._replace(spacing=spacing)

    def as_of(self, fit: LikelihoodFit) -> "MaximumLikelihood":
        """Return the same with the spacing of a fit."""
        return dataclasses.replace(self, every=fit.every)

    def _near(
        self,
        network: CSLC,
        recordings: Sequence[Recording],
        near: LikelihoodFit,
        report: Callable[[str], None],
    ) -> tuple[LikelihoodProblem, Minimum]:
        """Search near a fit, with its noise levels."""
        problem, (point, *_) = self.start(network, recordings, near.fit, near.every)
        levels = near.torque_noise, near.position_noise
        minimum = search(
            problem,
            _point_near(point, near),
            *levels,
            report,
            fixed_levels=True,
            edge=near.edge,
            moments=near.reversal_moments,
        )
        return problem, minimum

    def misfit(
        self,
        network: CSLC,
        recording: Recording | Sequence[Recording],
        k: Float[Array | np.ndarray, " coefficients"],
        torque_noise: Float[np.ndarray, " joints"],
        position_noise: Float[np.ndarray, " joints"],
    ) -> Misfit:
        """Return how well coefficients agree with recordings that are not smoothed.

        Torque errors of smoothed motion are least for coefficients that absorb what smoothing
        does: true ones lose. Here positions are estimated, for coefficients, slopes and noise
        levels as they are, and what is left of torques and readings is looked at.

        **Arguments**

        - `network`: n joints, p coefficients, with its slopes of static friction.
        - `recording`: as of `fit`.
        - `k`: (p,) coefficients.
        - `torque_noise`: (n,) standard deviations [N m or N].
        - `position_noise`: (n,) [rad or m]; of encoders, at least that of their steps counts.

        **Returns** a `Misfit`.

        **Raises** as `fit`.
        """
        require_float64()
        recordings = [recording] if isinstance(recording, Recording) else list(recording)
        every = 1 if self.every == "auto" else self.every
        problem, (point, residual, noise) = self.start(network, recordings, None, every)
        slopes, encoders = network.static_slopes, problem.encoder_step > 0.0
        point = point.with_values(
            k=np.asarray(k, float),
            slopes=point.slopes if slopes is None else np.log(np.asarray(slopes, float)),
        )
        noise = np.where(encoders, np.maximum(noise, position_noise), position_noise)
        first = SearchStart(point, np.broadcast_to(torque_noise, residual.shape), noise)
        others = (name for name, _ in problem.layout.sizes if name != "offset")
        # A misfit is known well enough when the sum of squares falls by no more than this part in
        # a step.
        minimum = search(
            problem.fixing(*others),
            *first,
            lambda words: None,
            fixed_levels=True,
            tolerance=1e-3,
        )
        return Misfit.of(minimum, problem.readings.part)

    def start(
        self,
        network: CSLC,
        recordings: Sequence[Recording],
        start: Identification | None,
        every: int,
    ) -> tuple[LikelihoodProblem, SearchStart]:
        """Return the problem, and where its search starts."""
        return starting_point(
            network,
            recordings,
            self.settings or Settings(),
            self.torque_sampling,
            None if self.resolution is None else np.array(self.resolution),
            start,
            self.prior,
            every,
            self.presliding_distance,
        )


def _point_near(point: Point, fit: LikelihoodFit) -> Point:
    """Return a point with the values of a fit that is near.

    **Raises** `ValueError` if the fit's positions are at other samples than the point's.
    """
    if fit.position.shape != point.q.shape or fit.offset.shape != point.offset.shape:
        raise ValueError(
            f"start: its positions are {fit.position.shape} of {len(fit.offset)} recordings;"
            f" expected {point.q.shape} of {len(point.offset)}"
        )
    slopes = np.log(fit.slopes) if fit.network.static_slopes is not None else point.slopes
    values = point.with_values(k=np.asarray(fit.k), slopes=slopes, offset=fit.offset)
    return dataclasses.replace(values, q=fit.position)
