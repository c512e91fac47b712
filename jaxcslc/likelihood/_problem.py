"""The problem of recordings, what is known beforehand, and where its search starts.

A search starts from regression on smoothed motion.
"""

import dataclasses
from collections.abc import Callable, Iterable, Mapping, Sequence
from typing import NamedTuple

import numpy as np
from jaxtyping import Bool, Float

from ..bodies import Known, Prior
from ..friction import checked_distance
from ..least_squares import Identification, Settings, masked_rms, regressor_of, torque_of
from ..network import CSLC
from ..recordings import Patterns, Recording, Sampling
from ..uncertainty import fit_recordings
from ._blocks import AbstractResidualBlock
from ._equations import AbstractEquations, MotionEquations
from ._point import Point, UnknownLayout
from ._pre_sliding_equations import PreSlidingEquations
from ._readings import Readings, TorqueSampling
from ._signs import LATEST_TURN, rests, runs


# No torque noise is below this part of the torque, where errors of second differences are: 1e-6 to
# 2e-5 of the joints of a simulated arm at 500 Hz.
_LEAST_TORQUE_NOISE = 3e-6
# How far the logarithm of a slope moves in a step.
_SLOPE_STEP = 0.7

Values = Float[np.ndarray, " values"]


class SearchStart(NamedTuple):
    """Start of a search.

    - `point`: all unknowns.
    - `torque_noise`, `position_noise`: (recordings, n) standard deviations.
    """

    point: Point
    torque_noise: Float[np.ndarray, "recordings joints"]
    position_noise: Float[np.ndarray, "recordings joints"]


@dataclasses.dataclass(frozen=True)
class LikelihoodProblem:
    """Problem of maximum likelihood that a search solves.

    **Attributes**

    - `equations`: torque as a function of positions.
    - `readings`: of one recording or of several.
    - `stuck`: (intervals, n), where joints are at standstill.
    - `layout`, `scale`: (border,) of the unknowns that all equations share; 0 fixes one.
    - `known`: from a point, and from one whose dry friction counts, mean and inverse variance,
      (border,) each, of what is known of these beforehand.
    - `bounds`: least and greatest values of parts of the border, by name.
    - `breakaway`: from a point, (n,) the greatest friction at standstill, as it is recorded.
    - `encoder_step`: (recordings, n) [rad or m]; 0 where positions are not counts.
    - `least_position_noise`: (recordings, n) [rad or m]; of counts, that of their steps.
    - `scatter`: (recordings, n) of readings about smooth motion [rad or m]; 0 of counts.
    - `added`: blocks beside those that every problem has, by name.
    """

    equations: AbstractEquations
    readings: Readings
    stuck: Bool[np.ndarray, "intervals joints"]
    layout: UnknownLayout
    scale: Float[np.ndarray, " border"]
    known: Callable[
        [Point, Point], tuple[Float[np.ndarray, " border"], Float[np.ndarray, " border"]]
    ]
    bounds: Mapping[str, tuple[Float[np.ndarray, " values"], Float[np.ndarray, " values"]]]
    breakaway: Callable[[Point], Float[np.ndarray, " joints"]]
    encoder_step: Float[np.ndarray, "recordings joints"]
    least_position_noise: Float[np.ndarray, "recordings joints"]
    scatter: Float[np.ndarray, "recordings joints"]
    added: Mapping[str, AbstractResidualBlock] = dataclasses.field(default_factory=dict)

    def bounded(self, point: Point, before: Point) -> Point:
        """Return a point within bounds, whose slopes and reversals are no further than a step may
        go."""
        near = np.clip(point.slopes, before.slopes - _SLOPE_STEP, before.slopes + _SLOPE_STEP)
        values = {"slopes": near}
        for name, (low, high) in self.bounds.items():
            values[name] = np.clip(values.get(name, point.values(name)), low, high)
        turn = np.clip(point.turn, -LATEST_TURN, LATEST_TURN)
        return dataclasses.replace(point.with_values(**values), turn=turn)

    def fixing(self, *names: str) -> "LikelihoodProblem":
        """Fix parts of the border."""
        scale = self.scale.copy()
        for name in names:
            scale[self.layout.part(name)] = 0.0
        return dataclasses.replace(self, scale=scale)

    def with_unknowns(
        self, name: str, scale: Values, mean: Values, precision: Values, low: Values
    ) -> "LikelihoodProblem":
        """Add the unknowns of an added block to the border.

        - `scale`: sizes; `mean`, `precision`: what is known of them beforehand; `low`: bounds.
        """
        layout = self.layout.with_part(name, len(scale))

        def known(point: Point, of_dry: Point) -> tuple[np.ndarray, np.ndarray]:
            means, precisions = self.known(point, of_dry)
            return layout.inserted(means, name, mean), layout.inserted(precisions, name, precision)

        return dataclasses.replace(
            self,
            layout=layout,
            scale=layout.inserted(self.scale, name, scale),
            known=known,
            bounds={**self.bounds, name: (low, np.full(len(low), np.inf))},
        )

    @property
    def at_rest(self) -> Bool[np.ndarray, "equations joints"]:
        """Equations of joints at standstill."""
        return self.stuck[1:] | self.stuck[:-1]

    @property
    def moving(self) -> Bool[np.ndarray, "samples joints"]:
        """Readings of joints that are not."""
        return ~np.concatenate([self.stuck, np.zeros_like(self.stuck[:1])])

    @property
    def reading_shares(self) -> Float[np.ndarray, "samples joints"]:
        """The readings of a rest are one reading, for they have one error."""
        shares = np.ones((len(self.stuck) + 1, self.stuck.shape[1]))
        for joint in range(self.stuck.shape[1]):
            for start, end in runs(self.stuck[:, joint]):
                shares[start : end + 1, joint] = 1.0 / (end + 1 - start)
        return shares

    @property
    def least_torque_noise(self) -> Float[np.ndarray, " joints"]:
        """(n,) [N m or N]."""
        size = np.sqrt(np.mean(self.readings.torque.averaged**2, axis=0))
        return np.maximum(_LEAST_TORQUE_NOISE * size, 1e-9)


def check_prior(prior: Prior | None, *, possible: bool) -> None:
    """Check that the search can make use of a prior.

    - `prior`: of `MaximumLikelihood`.
    - `possible`: whether bodies are to be possible.

    **Raises** `ValueError` for links without physically consistent bodies, and for bounds.
    """
    entries: dict[str, Known] = {} if prior is None else dict(prior.coefficients)
    if prior is not None and prior.links and not possible:
        raise ValueError(
            "prior: maximum likelihood takes coefficients; [links] needs physically consistent"
            " parameters (possible)"
        )
    for name, entry in entries.items():
        if not entry.is_value:
            raise ValueError(f"prior, {name}: maximum likelihood takes values, got bounds")


def prior_values(
    prior: Prior | None, network: CSLC
) -> tuple[
    Float[np.ndarray, " coefficients"],
    Float[np.ndarray, " coefficients"],
    Bool[np.ndarray, " coefficients"],
]:
    """Return values, (p,) inverse variances that are 0 where nothing is known, and what is
    fixed."""
    known: Mapping[int, Known] = {} if prior is None else prior.coefficient_values(network)
    size = network.size
    values, precision, fixed = np.zeros(size), np.zeros(size), np.zeros(size, bool)
    for index, entry in known.items():
        assert entry.value is not None
        values[index], fixed[index] = entry.value, entry.fixed
        precision[index] = 0.0 if entry.fixed else entry.error**-2.0
    return values, precision, fixed


# Positions that a recording has at least: five span an acceleration and its neighbours.
_FEWEST_SAMPLES = 10
# The share of its dry friction that static friction starts with; the speed at which it has gone to
# 1/e as a part of the joint's greatest speed, at first, at most and at least.
_STATIC_SHARE, _DECAY, _LEAST_DECAY, _MOST_DECAY = 0.1, 1 / 30, 1 / 1.5, 1 / 300
# Standard deviation of the logarithm of a slope about the first one, beforehand.
_SLOPE_DEVIATION = 1.0
# Standard deviation of static friction below dry friction, as a part of the one above it.
_BELOW_DRY = 0.1
# Below this part of its greatest speed, a joint whose readings stay the same is at rest.
_SLOW = 2e-3
# Steps of readings below this part of their noise are those of rounding, not of an encoder.
_LEAST_STEP = 0.1
# Positions without noise count as noisy by this part of the range of motion.
_LEAST_NOISE = 1e-9

Joints = Float[np.ndarray, " joints"]
Recordings = Float[np.ndarray, "recordings joints"]


def starting_point(
    network: CSLC,
    recordings: Sequence[Recording],
    settings: Settings,
    torque_sampling: TorqueSampling,
    resolution: Joints | None,
    start: Identification | None,
    prior: Prior | None = None,
    every: int = 1,
    presliding_distance: tuple[float, ...] = (),
) -> tuple[LikelihoodProblem, SearchStart]:
    """Return the problem of recordings, and where its search starts: regression on smoothed motion.

    **Arguments** as attributes of `MaximumLikelihood`, and

    - `prior`: values of coefficients that are known beforehand.

    **Returns** the problem, and where its search starts.

    **Raises** as `MaximumLikelihood.fit`.
    """
    _check(network, recordings, every)
    n, p = network.joint_count, network.size
    static = _Static(network)
    settings = settings.with_options(
        torque_alignment="mean" if torque_sampling == "held" else "sample"
    )
    patterns = {str(i): settings.patterns(recording) for i, recording in enumerate(recordings)}
    regression = _regression(static.without, patterns, settings.for_network(static.without))
    smooth = [
        settings.preparation.smoothing.smooth(recording.time, recording.position)
        for recording in recordings
    ]
    q, speed = (np.concatenate([np.array(motion[i])[::every] for motion in smooth]) for i in (0, 1))
    speed = np.abs(speed)
    fastest = np.maximum(speed.max(axis=0), 1e-6)

    readings = Readings.of(recordings, torque_sampling, every)
    encoders = _Encoders.of(recordings, readings, resolution)
    position_noise = encoders.noise

    k = np.zeros(p)
    index = {name: number for number, name in enumerate(network.names)}
    for fit in (regression, start):
        if fit is not None:
            k[[index[name] for name in fit.names]] = np.asarray(fit.k)
    slopes = np.log(1.0 / (_DECAY * fastest))
    if start is None:
        k[static.indices] = _STATIC_SHARE * static.dry(k)[static.joints]
    values, precision, fixed = prior_values(prior, network)
    k[fixed] = values[fixed]

    moves = np.zeros(n)
    moves[static.joints] = 0.5
    residual = [_residual(static.without, values, regression) for values in patterns.values()]
    torque_noise = np.sqrt(np.mean(np.square(residual), axis=0))
    scale = np.where(fixed, 0.0, _scale(network, patterns.values(), torque_noise))
    equations = MotionEquations(network, np.diff(readings.time))
    if any(presliding_distance):
        checked = checked_distance(network, presliding_distance)
        equations = PreSlidingEquations.of(equations, checked, q, readings.time, readings.part)
    offset = np.zeros(position_noise.shape)
    point = Point.of({"k": k, "slopes": slopes, "offset": offset}, q, np.zeros(0))
    problem = LikelihoodProblem(
        equations=equations,
        layout=point.layout,
        readings=readings,
        stuck=_rests(readings, speed, encoders.same, _SLOW * fastest),
        scale=np.concatenate([scale, moves, position_noise.ravel()]),
        known=_Known(static, values, precision, slopes, position_noise),
        bounds={
            "slopes": (
                np.log(1.0 / (_LEAST_DECAY * fastest)),
                np.log(1.0 / (_MOST_DECAY * fastest)),
            )
        },
        breakaway=static.breakaway,
        encoder_step=encoders.steps,
        least_position_noise=encoders.least_noise,
        scatter=encoders.scatter,
    )
    return problem, SearchStart(point, np.array(residual), position_noise)


def _regression(
    network: CSLC, patterns: Mapping[str, Patterns], settings: Settings
) -> Identification:
    """Fit all recordings together."""
    if len(patterns) > 1:
        return fit_recordings(network, patterns, settings.solver).fit
    (only,) = patterns.values()
    return settings.fit(network, only)


def _residual(network: CSLC, patterns: Patterns, fit: Identification) -> Joints:
    """Return (n,) RMS residual of a recording."""
    error = np.asarray(patterns.torque) - torque_of(network, patterns, fit.k)
    return masked_rms(error, np.asarray(patterns.mask))


def _rests(
    readings: Readings,
    speed: Float[np.ndarray, "samples joints"],
    resolution: Recordings,
    slowest: Joints,
) -> Bool[np.ndarray, "intervals joints"]:
    """Tell where joints are at rest, never between two recordings."""
    stuck = np.zeros((len(speed) - 1, speed.shape[1]), bool)
    for number in range(readings.recordings):
        rows = np.flatnonzero(readings.part == number)
        stuck[rows[:-1]] = rests(readings.position[rows], speed[rows], resolution[number], slowest)
    return stuck


class _Static:
    """Joints with static friction, and those of them with dry friction; a network without it."""

    def __init__(self, network: CSLC) -> None:
        laws = network.friction_per_joint
        self.joints = [joint for joint, kinds in enumerate(laws) if "static" in kinds]
        self.without, self.indices = network, np.zeros(0, int)
        if self.joints:
            self.without = network.without_law("static", [joint + 1 for joint in self.joints])
            self.indices = network.layout.indices("static")
        self.with_dry = np.array(["dry" in laws[joint] for joint in self.joints], bool)
        self._dry_joints = [joint for joint, kinds in enumerate(laws) if "dry" in kinds]
        self._dry = network.layout.indices("dry") if self._dry_joints else self.indices[:0]
        self._joint_count = network.joint_count

    def dry(self, k: Float[np.ndarray, " coefficients"]) -> Joints:
        """Return (n,) absolute coefficients of dry friction, 0 for joints without."""
        result = np.zeros(self._joint_count)
        result[self._dry_joints] = np.abs(k[self._dry])
        return result

    def breakaway(self, point: Point) -> Joints:
        """Return (n,) the greatest friction at standstill [N m or N]."""
        dry, at_rest = self.dry(point.k), np.zeros(self._joint_count)
        at_rest[self.joints] = np.abs(point.k[self.indices])
        beyond = np.where(dry > 0.0, np.minimum(at_rest, dry), at_rest)
        return dry + beyond + 1e-9


@dataclasses.dataclass(frozen=True)
class _Known:
    """Knowledge of the border beforehand, as `LikelihoodProblem.known`.

    Encoders are within half a step, and friction at rest rarely is above twice the dry one: without
    the latter, static friction that the motion does not show grows without bounds, with a slope
    that hides it. Nor is it below the dry one: a search whose motion crosses zero too quickly to
    show it may end at friction that would drive a joint at rest.

    - `values`, `precision`: (p,) of coefficients, from a prior.
    - `slopes`: (n,) expected logarithms; `position_noise`: (recordings, n) of encoders.
    """

    static: _Static
    values: Float[np.ndarray, " coefficients"]
    precision: Float[np.ndarray, " coefficients"]
    slopes: Joints
    position_noise: Recordings

    def __call__(self, point: Point, of_dry: Point) -> tuple[np.ndarray, np.ndarray]:
        """Return mean and inverse variance, (border,) each."""
        static = self.static
        spread = static.dry(of_dry.k)[static.joints]
        spread = np.where(point.k[static.indices] < 0.0, _BELOW_DRY * spread, spread)
        of_k = np.zeros(len(self.values))
        of_k[static.indices] = np.where(static.with_dry, np.maximum(spread, 1e-9) ** -2.0, 0.0)
        of_slopes = np.zeros(len(self.slopes))
        of_slopes[static.joints] = _SLOPE_DEVIATION**-2
        precision = of_k + self.precision
        expected = self.precision * self.values / np.maximum(precision, 1e-300)
        offsets = self.position_noise.ravel()
        return (
            np.concatenate([expected, self.slopes, np.zeros(len(offsets))]),
            np.concatenate([precision, of_slopes, offsets**-2.0]),
        )


class _Encoders(NamedTuple):
    """Encoders, by recording and joint.

    - `steps`: of encoders [rad or m], 0 where readings are no counts.
    - `readings_noise`: what readings scatter by; `least`: (n,) of any reading.
    """

    steps: Recordings
    readings_noise: Recordings
    least: Joints

    @classmethod
    def of(
        cls, recordings: Sequence[Recording], readings: Readings, resolution: Joints | None
    ) -> "_Encoders":
        """Read them off recordings; `resolution`: (n,) of the encoders, if it is known."""
        samplings = [Sampling.of(recording) for recording in recordings]
        noise = np.array([sampling.noise for sampling in samplings])
        if resolution is None:
            steps = np.array([sampling.resolution for sampling in samplings])
            steps = np.where(steps > _LEAST_STEP * noise, steps, 0.0)
        else:
            steps = np.tile(resolution, (len(recordings), 1))
        least = _LEAST_NOISE * np.maximum(np.ptp(readings.position, axis=0), 1e-3)
        return cls(steps, np.maximum(noise, least), least)

    @property
    def noise(self) -> Recordings:
        """Noise of positions; of encoder ticks, that of their steps."""
        return np.where(self.steps > 0.0, self.steps / np.sqrt(12.0), self.readings_noise)

    @property
    def least_noise(self) -> Recordings:
        """Least noise of positions."""
        return np.where(self.steps > 0.0, self.steps / np.sqrt(12.0), self.least)

    @property
    def scatter(self) -> Recordings:
        """Scatter of readings about smooth motion; 0 for encoder ticks."""
        return np.where(self.steps > 0.0, 0.0, self.readings_noise)

    @property
    def same(self) -> Recordings:
        """Readings that differ by less than half of it are the same."""
        return np.where(self.steps > 0.0, self.steps, 2 * self.least)


def _scale(
    network: CSLC, patterns: Iterable[Patterns], torque_error: Joints
) -> Float[np.ndarray, " coefficients"]:
    """Return one over the length of each column of the regressor, joints weighted by their
    residual."""
    weights = 1.0 / np.maximum(torque_error, 1e-6 * max(float(torque_error.max()), 1e-12))
    square = np.zeros(network.size)
    for values in patterns:
        regressor = np.asarray(regressor_of(network, values)) * weights[None, :, None]
        square += np.sum(regressor**2, axis=(0, 1))
    return 1.0 / np.sqrt(np.where(square > 0.0, square, 1.0))


def _check(network: CSLC, recordings: Sequence[Recording], every: int) -> None:
    """**Raises** `ValueError` as `MaximumLikelihood.fit`."""
    n = network.joint_count
    if network.payload is not None:
        raise ValueError(f"{network.name!r} has a payload; expected a network without one")
    if network.load_terms:
        raise ValueError(
            f"{network.name!r} has friction of kind 'load'; expected a network without"
        )
    if not recordings:
        raise ValueError("got no recording; expected one or more")
    for number, recording in enumerate(recordings, start=1):
        which = "the recording" if len(recordings) == 1 else f"recording {number}"
        if recording.position.shape[1] != n:
            raise ValueError(
                f"{which} has {recording.position.shape[1]} joints; expected {n}, those of"
                f" {network.name!r}"
            )
        if recording.samples < _FEWEST_SAMPLES * every:
            raise ValueError(
                f"{which} has {recording.samples} samples; expected at least"
                f" {_FEWEST_SAMPLES * every}"
            )
