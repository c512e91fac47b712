"""One joint whose rotor drives its link by gears with play, integrated step by step."""

import dataclasses

import numpy as np
from jaxtyping import Float

import jaxcslc as jc


@dataclasses.dataclass(frozen=True)
class TwoMasses:
    """A rotor, and a link that hangs on it by a spring with play and a damper, under gravity.

    - `time`: (samples,); `rotor`, `link`: (samples, 1) positions; `torque`: (samples, 1), held.
    """

    rotor_inertia: float
    link_inertia: float
    stiffness: float
    damping: float
    play: float
    gravity: float
    viscous: float
    time: Float[np.ndarray, " samples"]
    rotor: Float[np.ndarray, "samples 1"]
    link: Float[np.ndarray, "samples 1"]
    torque: Float[np.ndarray, "samples 1"]

    @property
    def k(self) -> Float[np.ndarray, " coefficients"]:
        """Coefficients of `network_of_two_masses`: inertia, centre of gravity, friction."""
        inertia = self.rotor_inertia + self.link_inertia
        return np.array([inertia, 0.0, -self.gravity / 9.81, self.viscous])

    def recording(
        self, step: float, noise: float, rng: np.random.Generator, samples: int | None = None
    ) -> jc.Recording:
        """Encoder counts of the rotor, and torque with noise."""
        counts = step * np.round(self.rotor / step)
        torque = self.torque + noise * rng.normal(size=self.torque.shape)
        return jc.Recording(self.time[:samples], counts[:samples], torque[:samples])


def two_masses(
    play: float,
    samples: int = 1500,
    interval: float = 2e-3,
    seed: int = 5,
) -> TwoMasses:
    """Under feedback control, on a sum of sines, integrated by the midpoint rule.

    - `play`: [rad].
    - `seed`: of the sines' frequencies and phases.
    """
    rotor_inertia, link_inertia, stiffness, damping, gravity, viscous = (
        0.5,
        1.0,
        2500.0,
        8.0,
        5.0,
        1.0,
    )
    time, substeps = np.arange(samples) * interval, 10
    rng = np.random.default_rng(seed)
    frequency, phase = rng.uniform(0.15, 2.5, 6), rng.uniform(0.0, 2 * np.pi, 6)
    angle = 2 * np.pi * frequency * time[:, None] + phase
    reference = np.sum(0.3 * np.sin(angle) / np.sqrt(frequency), axis=1)
    reference -= reference[0]
    rate = np.gradient(reference, interval)
    h, half = interval / substeps, 0.5 * play
    x, y, v, w = 0.0, 0.0, 0.0, 0.0
    rows = np.zeros((samples, 3))

    def accelerations(x: float, y: float, v: float, w: float, torque: float) -> tuple[float, float]:
        apart = x - y
        beyond = apart - half if apart > half else apart + half if apart < -half else 0.0
        gears = stiffness * beyond + damping * (v - w)
        rotor = (torque - viscous * v - gears) / rotor_inertia
        return rotor, (gears - gravity * np.sin(y)) / link_inertia

    for number in range(samples):
        torque = 60.0 * (reference[number] - x) + 8.0 * (rate[number] - v) + gravity * np.sin(x)
        rows[number] = x, y, torque
        for _ in range(substeps):
            a, b = accelerations(x, y, v, w, torque)
            middle = (x + 0.5 * h * v, y + 0.5 * h * w, v + 0.5 * h * a, w + 0.5 * h * b)
            c, d = accelerations(*middle, torque)
            x, y, v, w = x + h * middle[2], y + h * middle[3], v + h * c, w + h * d
    rotor, link, torque = np.split(rows, 3, axis=1)
    return TwoMasses(
        rotor_inertia,
        link_inertia,
        stiffness,
        damping,
        play,
        gravity,
        viscous,
        time,
        rotor,
        link,
        torque,
    )


def network_of_two_masses() -> jc.CSLC:
    """Return the network of the joint with rigid gears."""
    robot = jc.Manipulator.from_modified_dh([(0, 0, 0, 0)], gravity=(0, -9.81, 0))
    return jc.derive(robot.with_friction("viscous"), lengths="numeric")
