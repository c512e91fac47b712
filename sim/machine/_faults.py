from collections.abc import Sequence
from dataclasses import dataclass
from typing import Any, NamedTuple

import numpy as np
from jaxtyping import Bool, Float

from sim.machine._bodies import MachineError
from sim.machine._loads import check_times, during


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

    **Raises**

    - `MachineError`: another kind, a joint below 1, or times that do not follow each other.

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

        **Raises**

        - `MachineError`: a joint number beyond the machine's.
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
        """Those at one sample."""
        return Faults(self.lost[sample], self.stuck[sample], self.sense[sample])

    def read(self, reading: Any, shown: Any, received: Any) -> tuple[Any, Any, Any]:
        """Applies the faults of one sample to an encoder's reading.

        **Arguments**

        - `reading`: what the encoders would read [rad or m].
        - `shown`, `received`: as returned for the sample before.

        **Returns**

        The reading for the controller, the one that the encoder shows, and the last one received.
        """
        xp = reading.__array_namespace__()
        shown = xp.where(self.stuck, shown, reading)
        received = xp.where(self.lost, received, shown)
        return xp.where(self.lost, np.nan, shown), shown, received
