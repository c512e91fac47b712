"""Events of a recording: loads that are carried for a time, and faults of joints."""

import dataclasses
import math
from collections.abc import Sequence
from dataclasses import dataclass
from typing import Any, NamedTuple

import numpy as np
from jaxtyping import Bool, Float, Int

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

    **Raises** `MachineError`: a body that cannot be, or times that do not follow each other.

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
        """Return the mass at each sample [kg]."""
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

    **Returns** a machine that moves as `machine` does while it carries the body (see `Load`). If
    `machine` has tilted links, those of the result are tilted already.

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
    """Return which samples are from `start` on and before `stop` [s]."""
    after = time >= start - _ROUNDING
    return after if stop is None else after & (time < stop - _ROUNDING)


def check_times(what: str, start: float, stop: float | None) -> None:
    """**Raises** `MachineError` unless `start` is zero or more, and `stop` later [s]."""
    if not 0 <= start < math.inf:
        raise MachineError(f"{what} starts at {start} s; expected zero or more")
    if stop is not None and not stop > start:
        raise MachineError(f"{what} stops at {stop} s; expected later than its start, {start} s")


FAULTS = ("lost samples", "stuck encoder", "reversed torque")
"""Kinds of faults: see `Fault`."""


@dataclass(frozen=True)
class Fault:
    """A fault of a joint during an interval of time.

    - `"lost samples"`: the controller receives NaN instead of the encoder's reading. The
      recording, which holds numbers only, repeats the previous reading; `Truth.lost` marks it.
    - `"stuck encoder"`: the reading stays what it is at the first sample of the fault.
    - `"reversed torque"`: the drive's torque is the negative of the demand.

    It acts from the first sample at or after `start` until the last one before `stop`.

    **Raises** `MachineError`: another kind, a joint below 1, or times that do not follow each
    other.

    >>> import sim
    >>> sim.Fault("stuck encoder", 2, start=0.5).stop is None
    True
    """

    kind: str
    """One of those above."""

    joint: int | None
    """Counted from 1; None for all joints."""

    start: float
    """[s]."""

    stop: float | None = None
    """[s]; never if omitted."""

    def __post_init__(self) -> None:
        if self.kind not in FAULTS:
            names = ", ".join(repr(name) for name in FAULTS)
            raise MachineError(f"fault is {self.kind!r}; expected one of {names}")
        if self.joint is not None and self.joint < 1:
            raise MachineError(f"fault of joint {self.joint}; expected joints counted from 1")
        check_times("fault", self.start, self.stop)


class Faults(NamedTuple):
    """Faults sample by sample, or at one of them."""

    lost: Bool[Any, "*samples joints"]
    """Whether the reading is lost."""

    stuck: Bool[Any, "*samples joints"]
    """Whether the encoder keeps the reading of the sample before."""

    sense: Float[Any, "*samples joints"]
    """Factor by which the drives multiply a demand: 1 or, reversed, −1."""

    @classmethod
    def of(
        cls, faults: Sequence[Fault], joints: int, time: Float[np.ndarray, " samples"]
    ) -> "Faults":
        """The faults of some joints at `time` [s].

        **Raises** `MachineError`: a joint number beyond the machine's.
        """
        active = {kind: np.zeros((time.size, joints), dtype=bool) for kind in FAULTS}
        for fault in faults:
            if fault.joint is not None and fault.joint > joints:
                raise MachineError(f"fault of joint {fault.joint}; the machine has {joints}")
            which = slice(None) if fault.joint is None else slice(fault.joint - 1, fault.joint)
            active[fault.kind][:, which] |= during(time, fault.start, fault.stop)[:, None]
        stuck = active["stuck encoder"]
        frozen = stuck & np.concatenate([np.zeros((1, joints), dtype=bool), stuck[:-1]])
        return cls(active["lost samples"], frozen, np.where(active["reversed torque"], -1.0, 1.0))

    def at(self, sample: int) -> "Faults":
        """Return the faults at one sample."""
        return Faults(self.lost[sample], self.stuck[sample], self.sense[sample])

    def read(self, reading: Any, shown: Any, received: Any) -> tuple[Any, Any, Any]:
        """Applies the faults of one sample to an encoder's reading.

        **Arguments**

        - `reading`: what the encoders would read [rad or m].
        - `shown`, `received`: as returned for the sample before.

        **Returns** the reading for the controller, the one that the encoder shows, and the last one
        received.
        """
        xp = reading.__array_namespace__()
        shown = xp.where(self.stuck, shown, reading)
        received = xp.where(self.lost, received, shown)
        return xp.where(self.lost, np.nan, shown), shown, received
