"""Gears that explain smoothed motion, where a search starts."""

import dataclasses
from collections.abc import Callable, Sequence

import numpy as np
from jaxtyping import Float, Int

from ..least_squares import regressor_of
from ..network import CSLC
from ..recordings import Patterns
from ._blocks import ConstantBlock, Normal
from ._elastic_equations import ElasticEquations
from ._point import Point, Step
from ._problem import LikelihoodProblem, SearchStart
from ._search import Minimum, search
from ._transmission import Transmission, TransmissionParameters


# Frequency at which motion and torque are halved before they are derived [Hz].
_CUTOFF = 15.0
# About so many samples are compared, none within this part of a recording from its ends.
_SAMPLES, _ENDS = 300, 0.06
# What is tried, joint by joint, so many times: natural frequencies of links on their gears [Hz] and
# inertia of the rotor over the joint's, as it would be were gears rigid.
_FREQUENCIES = (40.0, 28.0, 20.0, 14.0, 10.0, 7.0, 5.0, 3.5, 2.5)
_ROTORS = (0.1, 0.25, 0.5, 0.9, 1.5)
_ROUNDS = 2
# Damping at first, as a part of the critical one.
_DAMPING = 0.05

Series = Float[np.ndarray, "samples joints"]


@dataclasses.dataclass(frozen=True)
class FirstGears:
    """Gears that explain smoothed motion, to start from.

    **Attributes**

    - `compliance`, `lag`, `rotor_inertia`: (f,) as of `TransmissionParameters`, without play.
    - `k`: (p,) coefficients.
    - `windup`: (samples, f) rotor minus link [rad or m], smoothed.
    """

    compliance: Float[np.ndarray, " links"]
    lag: Float[np.ndarray, " links"]
    rotor_inertia: Float[np.ndarray, " links"]
    k: Float[np.ndarray, " coefficients"]
    windup: Float[np.ndarray, "samples links"]


def first_gears(
    problem: LikelihoodProblem, k: Float[np.ndarray, " coefficients"], links: Sequence[int]
) -> FirstGears:
    """Return gears that leave least of smoothed torques.

    What gears bear is the torque less what the rotor needs and friction takes, and a link is
    behind its rotor by the compliance times that: both follow from what was recorded of this joint
    alone. With links where they are, coefficients are a regression. So each joint's compliance and
    rotor are tried in turn, and the residual has one minimum where a search over phases of
    vibrations has many.

    **Arguments**

    - `problem`: with rigid gears; `k`: coefficients of a regression for these.
    - `links`: which move apart from their rotors, from 0.
    """
    network = problem.equations.network
    data = _Smoothed.of(problem, network)
    rows = data.rows(problem)
    joints = np.array(links)
    mass = np.asarray(network.mass_matrix(k, data.position[0][rows]))[:, joints, joints]
    apparent = np.maximum(np.abs(np.median(mass, axis=0)), 1e-9)

    compliance, inertia = np.zeros(len(joints)), np.zeros(len(joints))
    weights = np.ones(data.torque[0].shape[1])
    friction = np.zeros(network.size)
    friction[network.layout.friction] = k[network.layout.friction]
    fitted, residual = data.fit(network, joints, compliance, inertia, friction, weights, rows)
    weights = 1.0 / np.maximum(residual, 1e-12)
    for _ in range(_ROUNDS):
        for number, joint in enumerate(joints):
            best, solution = np.inf, (compliance, inertia, fitted, residual)
            for frequency in _FREQUENCIES:
                for part in _ROTORS:
                    tried, rotors = compliance.copy(), inertia.copy()
                    tried[number] = 1.0 / (apparent[number] * (2.0 * np.pi * frequency) ** 2)
                    rotors[number] = part * apparent[number]
                    values, left = data.fit(network, joints, tried, rotors, friction, weights, rows)
                    if left[joint] < best:
                        best, solution = left[joint], (tried, rotors, values, left)
            compliance, inertia, fitted, residual = solution
            weights = 1.0 / np.maximum(residual, 1e-12)
            friction[network.layout.friction] = fitted[network.layout.friction]
    borne = data.borne(joints, inertia, friction, 0)
    # Critical damping is 2 / ω times the stiffness.
    frequency = 1.0 / np.sqrt(compliance * apparent)
    return FirstGears(compliance, 2.0 * _DAMPING / frequency, inertia, fitted, compliance * borne)


def smoothed_windup(
    problem: LikelihoodProblem, k: Float[np.ndarray, " coefficients"], gears: Transmission
) -> Float[np.ndarray, "samples links"]:
    """Return rotor minus link of gears that are known, about [rad or m].

    **Arguments**

    - `problem`: with rigid gears; `k`: coefficients.
    - `gears`: of another motion.
    """
    network = problem.equations.network
    friction = np.zeros(network.size)
    friction[network.layout.friction] = k[network.layout.friction]
    joints = np.array(gears.joints) - 1
    data = _Smoothed.of(problem, network)
    borne = data.borne(joints, gears.rotor_inertia, friction, 0)
    return gears.compliance * borne + 0.5 * gears.play * np.sign(borne)


@dataclasses.dataclass(frozen=True)
class _Smoothed:
    """Smoothed motion, torque and friction with their derivatives by time.

    - `position`: from none to the fourth; `torque`: to the second, of positions' samples.
    - `friction`: to the second, (samples, n, p) for coefficients of one.
    """

    position: list[Series]
    torque: list[Series]
    friction: list[Float[np.ndarray, "samples joints coefficients"]]

    @classmethod
    def of(cls, problem: LikelihoodProblem, network: CSLC) -> "_Smoothed":
        readings = problem.readings
        n = readings.position.shape[1]
        parts: list[list[np.ndarray]] = []
        averaged = readings.torque.averaged
        averaged = np.concatenate([averaged[:1], averaged, averaged[-1:]])
        for number in range(int(readings.part[-1]) + 1):
            rows = readings.part == number
            time, torque = readings.time[rows], averaged[rows]
            torque[0], torque[-1] = torque[1], torque[-2]
            position = _derivatives(time, readings.position[rows], 4)
            moving = regressor_of(network, _patterns(time, position, torque))
            columns = np.array(moving)
            others = np.setdiff1d(np.arange(network.size), network.layout.friction)
            columns[:, :, others] = 0.0
            flat = _derivatives(time, columns.reshape(len(time), -1), 2)
            friction = [values.reshape(len(time), n, -1) for values in flat]
            parts.append([*position, *_derivatives(time, torque, 2), *friction])
        joined = [np.concatenate(values) for values in zip(*parts, strict=True)]
        return cls(joined[:5], joined[5:8], joined[8:])

    def rows(self, problem: LikelihoodProblem) -> Int[np.ndarray, " rows"]:
        """Return samples that are compared."""
        part = problem.readings.part
        step = max(len(part) // _SAMPLES, 1)
        result: list[np.ndarray] = []
        for number in range(int(part[-1]) + 1):
            samples = np.flatnonzero(part == number)
            ends = max(int(_ENDS * len(samples)), 2)
            result.append(samples[ends:-ends:step])
        return np.concatenate(result)

    def borne(
        self,
        joints: Int[np.ndarray, " links"],
        inertia: Float[np.ndarray, " links"],
        friction: Float[np.ndarray, " coefficients"],
        derivative: int,
    ) -> Float[np.ndarray, "samples links"]:
        """Return torque that gears bear, or a derivative of it."""
        taken = self.friction[derivative][:, joints] @ friction
        rotor = inertia * self.position[2 + derivative][:, joints]
        return self.torque[derivative][:, joints] - rotor - taken

    def fit(
        self,
        network: CSLC,
        joints: Int[np.ndarray, " links"],
        compliance: Float[np.ndarray, " links"],
        inertia: Float[np.ndarray, " links"],
        friction: Float[np.ndarray, " coefficients"],
        weights: Float[np.ndarray, " joints"],
        rows: Int[np.ndarray, " rows"],
    ) -> tuple[Float[np.ndarray, " coefficients"], Float[np.ndarray, " joints"]]:
        """Return coefficients of links that are behind their rotors, and (n,) RMS residuals."""
        motion = [values[rows].copy() for values in self.position[:3]]
        torque = self.torque[0][rows].copy()
        behind = [
            compliance * self.borne(joints, inertia, friction, order)[rows] for order in range(3)
        ]
        for values, windup in zip(motion, behind, strict=True):
            values[:, joints] -= windup
        torque[:, joints] -= inertia * behind[2]
        columns = np.array(
            regressor_of(network, _patterns(np.arange(len(rows), dtype=float), motion, torque))
        )
        index = network.layout.friction
        columns[:, :, index] = self.friction[0][rows][:, :, index]
        weighted = (columns * weights[:, None]).reshape(-1, network.size)
        size = np.maximum(np.linalg.norm(weighted, axis=0), 1e-300)
        k = np.linalg.lstsq(weighted / size, (torque * weights).ravel(), rcond=1e-8)[0] / size
        return k, np.sqrt(np.mean((torque - columns @ k) ** 2, axis=0))


def _patterns(
    time: Float[np.ndarray, " samples"], motion: Sequence[Series], torque: Series
) -> Patterns:
    q, qd, qdd = motion[:3]
    every = np.ones(q.shape, bool)
    return Patterns(time, q, qd, qdd, torque, every, every)


def _derivatives(
    time: Float[np.ndarray, " samples"], values: Float[np.ndarray, "samples columns"], most: int
) -> list[Float[np.ndarray, "samples columns"]]:
    """Return smoothed values and their derivatives by time, by Fourier's series of an odd
    continuation."""
    count, span = len(time), time[-1] - time[0]
    even = np.linspace(time[0], time[-1], count)
    slope = (values[-1] - values[0]) / span
    line = values[0] + (even - time[0])[:, None] * slope
    if not np.allclose(even, time, rtol=0.0, atol=1e-3 * span / count):
        values = np.stack([np.interp(even, time, column) for column in values.T], axis=1)
    about = values - line
    periodic = np.concatenate([about, -about[-2:0:-1]])
    frequency = np.fft.rfftfreq(len(periodic), span / (count - 1))[:, None]
    spectrum = np.fft.rfft(periodic, axis=0) * 0.5 ** ((frequency / _CUTOFF) ** 2)
    result: list[np.ndarray] = []
    for order in range(most + 1):
        derived = np.fft.irfft(spectrum * (2j * np.pi * frequency) ** order, len(periodic), axis=0)
        more = (line, slope)[order] if order < 2 else 0.0
        result.append(derived[:count] + more)
    return result


# Which of compliance, lag, play and inertia of rotors are free, for how many steps at most.
_STAGES = (((True, True, True, False), 12), ((True, True, True, True), 60))
# Least compliance and inertia of a rotor beside those at first, and the standard deviation
# beforehand of the latter.
_LEAST, _ROTOR = 1e-3, 1.0
# Standard deviation of a link's position beforehand [rad or m]: none that says anything, but at an
# end of a recording, where few equations are.
_UNREAD = 1e3
GEARS, LINKS = "gears", "links"


@dataclasses.dataclass(frozen=True)
class LinkBlock(ConstantBlock):
    """Positions of links, which nothing reads: about 0, within as much as a joint may ever turn.

    - `joints`: n; links are the columns behind them.
    """

    joints: int
    weight: Float[np.ndarray, "samples links"]

    def residuals(self, point: Point) -> Float[np.ndarray, "samples links"]:
        """Return minus positions."""
        return -point.q[:, self.joints :]

    def changes(self, step: Step) -> Float[np.ndarray, "samples links"]:
        """Return changes with positions."""
        return step.position[:, self.joints :]

    def add_gradient(self, force: Float[np.ndarray, "samples links"], total: Step) -> None:
        """Add the gradient by positions."""
        total.position[:, self.joints :] += force

    def add_squares(self, weight: Float[np.ndarray, "samples links"], normal: Normal) -> None:
        """Add squares of positions."""
        normal.equations.band[normal.order.position[:, self.joints :], 0] += weight


def with_gears(
    problem: LikelihoodProblem, start: SearchStart, links: Sequence[int], first: FirstGears
) -> tuple[LikelihoodProblem, SearchStart]:
    """Return a problem of rigid gears with elastic ones, which have no play at first.

    **Arguments**

    - `links`: which move apart from their rotors, from 0.
    - `first`: gears to start from.
    """
    readings, point, index = problem.readings, start.point, np.array(links)
    network, inertia = problem.equations.network, first.rotor_inertia
    friction = np.zeros(network.size, bool)
    friction[network.layout.friction] = True
    zeros = np.zeros(len(links))
    parameters = TransmissionParameters(first.compliance, first.lag, zeros, inertia)
    size = np.std(readings.torque.averaged[:, index], axis=0)
    wide = problem.with_unknowns(
        GEARS,
        parameters._replace(play=first.compliance * size).values,
        TransmissionParameters(zeros, zeros, zeros, inertia).values,
        TransmissionParameters(zeros, zeros, zeros, (_ROTOR * inertia) ** -2.0).values,
        TransmissionParameters(
            _LEAST * first.compliance, zeros, zeros - np.inf, _LEAST * inertia
        ).values,
    )
    width = np.max(start.position_noise, axis=0)[index]
    unread = np.full((len(point.q), len(links)), _UNREAD**-2.0)
    wide = dataclasses.replace(
        wide,
        equations=ElasticEquations(problem.equations, index, readings.time, friction, width),
        added={**problem.added, LINKS: LinkBlock(problem.joints, unread)},
    )
    border = wide.layout.inserted(point.border, GEARS, parameters.values)
    q = np.concatenate([point.q, point.q[:, index] - first.windup], axis=1)
    apart = dataclasses.replace(point, border=border, layout=wide.layout, q=q)
    k = np.where(problem.scale[: network.size] > 0.0, first.k, point.k)
    return wide, start._replace(point=apart.with_values(k=k))


def near_transmission(
    problem: LikelihoodProblem, start: SearchStart, gears: Transmission
) -> tuple[LikelihoodProblem, SearchStart]:
    """Return the same with gears that are known, and links where these have them.

    **Arguments** as of `with_gears`, and

    - `gears`: with positions of links at the point's samples, or at others.
    """
    links, point = [joint - 1 for joint in gears.joints], start.point
    if len(gears.link_position) == len(point.q):
        windup = point.q[:, links] - gears.link_position
    else:
        windup = smoothed_windup(problem, point.k, gears)
    first = FirstGears(gears.compliance, gears.lag, gears.rotor_inertia, point.k, windup)
    wide, apart = with_gears(problem, start, links, first)
    return wide, apart._replace(point=apart.point.with_values(gears=gears.parameters))


def transmission_search(
    problem: LikelihoodProblem,
    start: SearchStart,
    joints: Sequence[int],
    progress: Callable[[str], None],
) -> Minimum:
    """Search for the most likely rotors and links that move apart.

    From rigid gears, a search may end with ever stiffer ones: phases of vibrations change by more
    than a radian on the way to the right stiffness. So it starts from gears that explain smoothed
    motion (`first_gears`). Stiffness, damping and play are free at first, then rotors' inertias.

    **Arguments** of a problem with rigid gears, as of `search`, and

    - `joints`: whose links move apart from their rotors, from 1.

    **Returns** the minimum of rotors and links apart.

    **Raises** `ValueError` for joints that the robot does not have.
    """
    n = problem.joints
    if any(not 1 <= joint <= n for joint in joints) or len(set(joints)) < len(joints):
        raise ValueError(
            f"transmission: expected different joints from 1 to {n}, got {tuple(joints)}"
        )
    links = [joint - 1 for joint in joints]
    progress("maximum likelihood: gears of smoothed motion")
    wide, start = with_gears(problem, start, links, first_gears(problem, start.point.k, links))
    minimum: Minimum | None = None
    for free, most_steps in _STAGES:
        scale, part = wide.scale.copy(), wide.layout.part(GEARS)
        scale[part] *= np.repeat(np.array(free, float), len(links))
        stage = dataclasses.replace(wide, scale=scale)
        minimum = search(stage, *start, progress, most_steps=most_steps)
        start = SearchStart(minimum.point, minimum.torque_noise, minimum.position_noise)
    assert minimum is not None
    return minimum
