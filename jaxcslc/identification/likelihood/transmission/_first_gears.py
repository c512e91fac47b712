"""Gears that explain smoothed motion, where a search starts."""

import dataclasses
from collections.abc import Sequence

import numpy as np
from jaxtyping import Float, Int

from ....motion import Patterns
from ....network import CSLC
from ...solver import regressor_of
from .._problem import Problem
from ._transmission import Transmission


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
    problem: Problem, k: Float[np.ndarray, " coefficients"], links: Sequence[int]
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
    problem: Problem, k: Float[np.ndarray, " coefficients"], gears: Transmission
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
    def of(cls, problem: Problem, network: CSLC) -> "_Smoothed":
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

    def rows(self, problem: Problem) -> Int[np.ndarray, " rows"]:
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
