"""The task of the payload study: pick up, carry, place."""

from typing import Any, NamedTuple

import numpy as np

import jaxcslc as jc
import sim


INTERVAL = 0.002  # s
MOMENTS = (0.5, 1.0, 2.0)  # of motion with the payload [s]
CENTRE, BOX = np.array([0.02, -0.03, 0.10]), 0.12  # of gravity, and edge of the box [m]
START = np.array([0.0, -1.2, 2.6, 0.8, -0.3, -1.0])
PICK = np.array([0.7, -0.35, 2.9, 0.3, 0.6, 0.2])
VIA = np.array([[0.3, -1.0, 2.6, -0.7, 1.1, 1.2], [-0.4, -0.9, 3.1, 0.8, 0.1, -1.0]])
PLACE = np.array([-0.8, -0.45, 2.75, -0.2, 0.8, 0.4])
_LEG = 1.1  # s; of the legs with a payload


class Case(NamedTuple):
    """The disturbances of the machines, and the duration of the last leg with the payload [s]."""

    description: str
    disturbances: tuple[str, ...]
    last_leg: float = _LEG


CASES = {
    "encoders": Case("quantised encoders", ("quantisation",)),
    "friction": Case("static friction as well", ("quantisation", "static friction")),
    "slowly": Case("static friction, placed slowly", ("quantisation", "static friction"), 2.5),
    "everything": Case("all disturbances", ()),
}


class Task:
    """The path of the arm, and its payload.

    **Attributes**

    - `picked`, `placed`: when the payload is there and when it is gone [s].
    - `departed`, `arrived`, `left`: when the arm leaves the pick-up pose, arrives at the place and
      leaves it [s].
    - `moments`: samples at which estimates are judged, by name.
    """

    def __init__(self, mass: float, last_leg: float) -> None:
        self.path = sim.ViaPoints(
            np.stack([PICK, *VIA, PLACE, START]),
            np.array([1.2, _LEG, _LEG, last_leg, 1.2]),
            np.array([0.4, 0.1, 0.1, 0.6, 0.3]),
        )
        arrivals = self.path.arrivals
        self.picked, self.placed = arrivals[0] + 0.2, arrivals[3] + 0.4
        self.arrived, self.left = arrivals[3], arrivals[3] + 0.6
        self.departed = arrivals[0] + 0.4
        self.samples = round((arrivals[-1] + 0.3) / INTERVAL) + 1
        self.time = INTERVAL * np.arange(self.samples)
        self.body = jc.LinkParameters(mass, CENTRE, mass * BOX**2 / 6 * np.eye(3))
        self.loads = (sim.Load(self.picked, self.body, self.placed),) if mass else ()
        origin = np.broadcast_to(START, (self.samples, len(START)))
        moving = np.any(self.path.reference(self.time[:, None], origin).qd != 0.0, axis=1)
        in_motion = INTERVAL * np.cumsum(moving & (self.time > self.departed))
        self.moments = {f"{t:g} s": int(np.searchsorted(in_motion, t)) for t in MOMENTS}
        self.moments["end"] = self.sample(self.placed) - 1

    @property
    def carried(self) -> slice:
        """The samples at which the payload is there."""
        return slice(self.sample(self.picked), self.sample(self.placed))

    def sample(self, time: float) -> int:
        """The sample at a time."""
        return round(time / INTERVAL)

    def trajectory(self, loop: Any) -> sim.Trajectory:
        """The task performed by a feedback loop."""
        return sim.Trajectory("task", START, loop, self.samples, loads=self.loads, path=self.path)


def rehearsal() -> sim.ViaPoints:
    """Other motions, without a payload."""
    middle = np.array([0.0, -1.2, 2.6, 0.0, 0.3, 0.0])
    spread = np.array([1.0, 0.6, 0.6, 1.6, 1.2, 1.6])
    poses = middle + np.random.default_rng(5).uniform(-1.0, 1.0, (10, 6)) * spread
    return sim.ViaPoints(poses, np.full(10, 1.0), np.full(10, 0.1))
