import dataclasses
import math
from collections.abc import Sequence
from dataclasses import dataclass
from typing import NamedTuple

import numpy as np
from jaxtyping import Float, Int

from jaxcslc.manipulator import LinkParameters, fixed_together
from sim.machine._bodies import MachineError, are_rigid_bodies
from sim.machine._machine import Machine


# Times of samples are multiples of the interval, rounded.
_ROUNDING = 1e-9


@dataclass(frozen=True, eq=False)
class Load:
    """A body that is fixed to the last link during an interval of time.

    It is fixed from the first sample at or after `start` until the last one before `stop`.
    Positions and velocities of the joints do not change at these moments; accelerations do.
    Several loads at a time are carried together. Grasping is not simulated: the body has the
    hand's velocity when it is picked up.

    **Raises**

    - `MachineError`: a body that cannot be, or times that do not follow each other.

    >>> import numpy as np
    >>> import jaxcslc, sim
    >>> ball = jaxcslc.LinkParameters(2.0, np.array([0.0, 0.0, 0.1]), np.zeros((3, 3)))
    >>> sim.Load(0.5, ball, stop=2.0).stop
    2.0
    """

    start: float
    """When it is picked up [s]."""

    body: LinkParameters
    """In the last link's frame."""

    stop: float | None = None
    """When it is put down [s]; never if omitted."""

    def __post_init__(self) -> None:
        check_times("load", self.start, self.stop)
        if not 0 <= float(self.body.mass) < math.inf:
            raise MachineError(f"load has a mass of {self.body.mass} kg; expected zero or more")
        if float(self.body.motor_inertia) != 0:
            raise MachineError(
                f"load has a motor inertia of {self.body.motor_inertia}; expected none"
            )
        inertia = np.asarray(self.body.inertia, dtype=np.float64)
        if not np.isfinite(inertia).all() or not are_rigid_bodies(inertia[None])[0]:
            raise MachineError(
                "load cannot be a rigid body: one of its principal moments is more than the sum of"
                f" the other two, {np.linalg.eigvalsh(inertia).round(6).tolist()} kg m²"
            )


class Carried(NamedTuple):
    """The body carried at each sample."""

    bodies: tuple[LinkParameters | None, ...]
    """The different bodies that are carried; None for nothing."""

    which: Int[np.ndarray, " samples"]
    """Index into `bodies` at each sample."""

    @property
    def mass(self) -> Float[np.ndarray, " samples"]:
        """At each sample [kg]."""
        masses = [0.0 if body is None else float(body.mass) for body in self.bodies]
        return np.array(masses)[self.which]

    @classmethod
    def of(cls, loads: Sequence[Load], time: Float[np.ndarray, " samples"]) -> "Carried":
        """The combined bodies of the `loads` carried at `time` [s]."""
        active = np.stack(
            [during(time, load.start, load.stop) for load in loads] or [np.zeros_like(time, bool)],
            axis=1,
        )
        sets, which = np.unique(active, axis=0, return_inverse=True)
        bodies = tuple(
            fixed_together([load.body for load, on in zip(loads, row, strict=True) if on])
            if row.any()
            else None
            for row in sets
        )
        return cls(bodies, which.reshape(-1))


def carrying(machine: Machine, body: LinkParameters | None) -> Machine:
    """The machine whose last link includes another body.

    **Arguments**

    - `machine`: the machine.
    - `body`: in the last link's frame; None for none.

    **Returns**

    A machine that moves as `machine` does while it carries the body (see `Load`). If `machine` has
    tilted links, those of the result are tilted already.

    >>> import numpy as np
    >>> import jaxcslc, sim
    >>> ball = jaxcslc.LinkParameters(2.0, np.array([0.0, 0.0, 0.1]), np.zeros((3, 3)))
    >>> float(sim.carrying(sim.puma560(), ball).links[-1].mass)
    2.09
    """
    if body is None:
        return machine
    *links, last = machine.links
    robot = dataclasses.replace(machine.robot, links=(*links, fixed_together([last, body])))
    return dataclasses.replace(machine, robot=robot, tilt=())


def during(time: Float[np.ndarray, " samples"], start: float, stop: float | None) -> np.ndarray:
    """Which samples are from `start` on and before `stop` [s]."""
    after = time >= start - _ROUNDING
    return after if stop is None else after & (time < stop - _ROUNDING)


def check_times(what: str, start: float, stop: float | None) -> None:
    """**Raises** `MachineError` unless `start` is zero or more, and `stop` later [s]."""
    if not 0 <= start < math.inf:
        raise MachineError(f"{what} starts at {start} s; expected zero or more")
    if stop is not None and not stop > start:
        raise MachineError(f"{what} stops at {stop} s; expected later than its start, {start} s")
