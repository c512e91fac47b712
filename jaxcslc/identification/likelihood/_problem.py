import dataclasses
from collections.abc import Callable
from typing import NamedTuple

import numpy as np
from jaxtyping import Bool, Float, Int

from ._objective import Point
from ._readings import Readings
from ._signs import runs
from .equations import AbstractEquations
from .transmission import TransmissionModel


# No torque noise is below this part of the torque, where errors of second differences are: 1e-6 to
# 2e-5 of the joints of a simulated arm at 500 Hz.
_LEAST_TORQUE_NOISE = 3e-6


class SearchStart(NamedTuple):
    """Where a search starts.

    - `point`: all unknowns.
    - `torque_noise`, `position_noise`: (recordings, n) standard deviations.
    """

    point: Point
    torque_noise: Float[np.ndarray, "recordings joints"]
    position_noise: Float[np.ndarray, "recordings joints"]


@dataclasses.dataclass(frozen=True)
class Problem:
    """What a search needs to know.

    **Attributes**

    - `equations`: torque as a function of positions.
    - `readings`: of one recording or of several.
    - `stuck`: (intervals, n), where joints are at standstill.
    - `scale`: (border,) of the unknowns that all equations share; 0 fixes one.
    - `known`: from a point, and from one whose dry friction counts, mean and inverse variance,
      (border,) each, of what is known of these beforehand.
    - `slope_bounds`: (n,) each, least and greatest logarithms of slopes.
    - `breakaway`: from a point, (n,) the greatest friction at standstill, as it is recorded.
    - `encoder_step`: (recordings, n) [rad or m]; 0 where positions are not counts.
    - `least_position_noise`: (recordings, n) [rad or m]; of counts, that of their steps.
    - `scatter`: (recordings, n) of readings about smooth motion [rad or m]; 0 of counts.
    - `transmission`: of links that move apart from their rotors. They are further columns behind
      the joints, whose positions nothing reads. None if gears are rigid.
    """

    equations: AbstractEquations
    readings: Readings
    stuck: Bool[np.ndarray, "intervals joints"]
    scale: Float[np.ndarray, " border"]
    known: Callable[
        [Point, Point], tuple[Float[np.ndarray, " border"], Float[np.ndarray, " border"]]
    ]
    slope_bounds: tuple[Float[np.ndarray, " slopes"], Float[np.ndarray, " slopes"]]
    breakaway: Callable[[Point], Float[np.ndarray, " joints"]]
    encoder_step: Float[np.ndarray, "recordings joints"]
    least_position_noise: Float[np.ndarray, "recordings joints"]
    scatter: Float[np.ndarray, "recordings joints"]
    transmission: TransmissionModel | None = None

    @property
    def joints(self) -> int:
        """How many columns are joints, whose positions are read."""
        return self.stuck.shape[1] if self.transmission is None else self.transmission.joints

    @property
    def transmission_indices(self) -> Int[np.ndarray, " parameters"]:
        """Which unknowns of the border are parameters of gears."""
        if self.transmission is None:
            return np.zeros(0, int)
        first = self.equations.network.size + self.joints
        return np.arange(first, first + len(self.transmission.least))

    @property
    def at_rest(self) -> Bool[np.ndarray, "equations joints"]:
        """Equations of joints at standstill."""
        return self.stuck[1:] | self.stuck[:-1]

    @property
    def moving(self) -> Bool[np.ndarray, "samples joints"]:
        """Readings of joints that are not."""
        moving = ~np.concatenate([self.stuck, np.zeros_like(self.stuck[:1])])
        moving[:, self.joints :] = False
        return moving

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
