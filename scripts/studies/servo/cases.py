"""Recordings that confound parameters of servos: does the fit name them, and a remedy?

Each case is one joint of `arms.py`, moved so that two parameters have the same effect, or one has
none.
"""

from collections.abc import Callable
from dataclasses import dataclass

import numpy as np

from jaxcslc.servo import ESTIMATED, identify_servo
from scripts.studies.servo.arms import RATE, Servos, recorded, robot


LEVEL = (("0 1 0", "0 0 0", 0.3, "0.15 0 0.01", "2e-4 1e-3 1e-3"),)
"""A link that gravity loads."""
UPRIGHT = (("0 0 1", "0 0 0", 0.3, "0.15 0 0.01", "2e-4 1e-3 1e-3"),)
"""The same about a vertical axis."""

TIME = np.arange(round(30.0 * RATE)) / RATE
SLOW = 0.5 * np.sin(0.4 * TIME)[:, None]
RICH = (0.6 * np.sin(0.9 * TIME) + 0.2 * np.sin(2.3 * TIME) + 0.08 * np.sin(8.0 * TIME))[:, None]
CREEPING = 0.1 * np.sin(0.15 * TIME)[:, None]
NARROW = 0.05 * np.sin(2.0 * TIME)[:, None] + 0.01 * np.sin(9.0 * TIME)[:, None]


@dataclass(frozen=True)
class Case:
    """A joint, its motion, what is estimated, and the parameters that should be named."""

    links: tuple[tuple[str, str, float, str, str], ...]
    command: np.ndarray
    expected: tuple[str, ...]
    more: tuple[str, ...] = ()
    without: tuple[str, ...] = ("static", "stribeck", "load_friction")
    mass_error: float = 0.2

    def __call__(self) -> tuple[bool, str]:
        """Return whether the parameters are named, and with which remedy."""
        one = np.ones(1)
        servos = Servos(
            gain=12.0 * one,
            damping=0.8 * one,
            delay=0.03 * one,
            offset=0.05 * one,
            armature=0.015 * one,
            coulomb=0.1 * one,
            static=0.05 * one,
            stribeck=0.1 * one,
            load_friction=0.0 * one,
            dead_zone=0.0 * one,
            play=0.0 * one,
        )
        names = tuple(x for x in (*ESTIMATED, *self.more) if x not in self.without)
        recording = recorded(self.links, servos, self.command)
        fit = identify_servo(
            robot(self.links), recording, estimated=names, mass_error=self.mass_error
        )
        for pair in fit.confounded:
            if set(pair.parameters) == set(self.expected):
                return True, pair.remedy
        return False, ", ".join(" and ".join(pair.parameters) for pair in fit.confounded)


CASES: dict[str, Callable[[], tuple[bool, str]]] = {
    "torque constant and friction, no known mass": Case(
        LEVEL, RICH, ("gain",), mass_error=float("inf")
    ),
    "delay and damping, slow motion": Case(LEVEL, SLOW, ("delay", "damping")),
    "zero position of a joint about a vertical axis": Case(UPRIGHT, RICH, ("offset",)),
    "dead zone and static friction": Case(
        UPRIGHT,
        CREEPING,
        ("dead_zone", "static"),
        ("dead_zone",),
        ("coulomb", "stribeck", "load_friction"),
    ),
    "dead zone and Coulomb friction": Case(UPRIGHT, RICH, ("dead_zone", "coulomb"), ("dead_zone",)),
    "play and compliance": Case(UPRIGHT, RICH, ("play",), ("play",)),
    "load-dependent and Coulomb friction, one load": Case(
        LEVEL, NARROW, ("coulomb", "load_friction"), without=("static", "stribeck")
    ),
    "D gain and viscous friction": Case(LEVEL, RICH, ("damping", "viscous")),
    "gain of a joint about a vertical axis": Case(UPRIGHT, RICH, ("gain",)),
    "torque limit that is never reached": Case(LEVEL, RICH, ("torque_limit",), ("torque_limit",)),
}
"""Cases by title."""
