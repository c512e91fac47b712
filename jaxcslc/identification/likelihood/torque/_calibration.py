import dataclasses
from typing import Literal

import numpy as np
from jaxtyping import Bool, Float

from ._torque_record import TorqueRecord


TorqueUnknown = Literal["torque_lag", "torque_gains"]
"""What may be unknown of recorded torques: how much later than positions they were measured, and
how large a joint's torque is beside what was recorded."""

# Sizes of the lag, in mean intervals, and of a gain; the most by which a step changes them, in mean
# intervals and as a factor.
_LAG_SCALE, _GAIN_SCALE, _MOST_LAG, _MOST_FACTOR = 0.1, 0.1, 0.5, 2.0


@dataclasses.dataclass(frozen=True)
class TorqueCalibration:
    """Unknowns of recorded torques: a lag of all of them, and each joint's gain.

    The torque of joint j at time t is gain_j times what was recorded at t + lag. Equations stay in
    units of what was recorded, so that its noise does not depend on gains: recorded minus
    predicted torque over gain. Where gains and coefficients grow together, residuals stay: in
    gains, not in their logarithms, Gauss-Newton steps follow that line.

    **Attributes**

    - `record`: of torques.
    - `unknowns`: which of these are estimated; others are those of rest.
    """

    record: TorqueRecord
    unknowns: tuple[TorqueUnknown, ...] = ()

    @property
    def joints(self) -> int:
        """n."""
        return self.record.torques[0].shape[1]

    @property
    def scale(self) -> Float[np.ndarray, " unknowns"]:
        """(1 + n,) size of each unknown, none if neither is estimated."""
        if not self.unknowns:
            return np.zeros(0)
        interval = float(np.mean(np.diff(self.record.times[0])))
        lag = _LAG_SCALE * interval * ("torque_lag" in self.unknowns)
        return np.append(lag, np.full(self.joints, _GAIN_SCALE * ("torque_gains" in self.unknowns)))

    @property
    def start(self) -> Float[np.ndarray, " unknowns"]:
        """No lag, and gains of one."""
        return np.append(0.0, np.ones(self.joints)) if self.unknowns else np.zeros(0)

    def lag(self, values: Float[np.ndarray, " unknowns"]) -> float:
        """[s], 0 if it is not estimated."""
        return float(values[0]) if len(values) else 0.0

    def gain(self, values: Float[np.ndarray, " unknowns"]) -> Float[np.ndarray, " joints"]:
        """(n,), ones if they are not estimated."""
        return values[1:] if len(values) else np.ones(self.joints)

    def torque(
        self, values: Float[np.ndarray, " unknowns"]
    ) -> Float[np.ndarray, "equations joints"]:
        """Recorded torque of every equation, as late as it was measured."""
        return self.record.averaged(self.lag(values))

    def by_values(
        self,
        values: Float[np.ndarray, " unknowns"],
        predicted: Float[np.ndarray, "equations joints"],
    ) -> Float[np.ndarray, "equations joints unknowns"]:
        """Derivatives of predicted minus recorded torque, both in units of what was recorded.

        **Arguments**

        - `predicted`: torque over gain.
        """
        n = self.joints
        result = np.zeros((*predicted.shape, len(values)))
        if not len(values):
            return result
        if "torque_lag" in self.unknowns:
            result[:, :, 0] = -self.record.rate(self.lag(values))
        result[:, np.arange(n), 1 + np.arange(n)] = -predicted / self.gain(values)
        return result

    def bounded(
        self, values: Float[np.ndarray, " unknowns"], before: Float[np.ndarray, " unknowns"]
    ) -> Float[np.ndarray, " unknowns"]:
        """No further from the values before than a step may go."""
        if not len(values):
            return values
        lag = _MOST_LAG / _LAG_SCALE * self.scale[:1]
        low = np.append(before[:1] - lag, before[1:] / _MOST_FACTOR)
        high = np.append(before[:1] + lag, before[1:] * _MOST_FACTOR)
        return np.clip(values, low, high)

    def outside(self, values: Float[np.ndarray, " unknowns"]) -> Bool[np.ndarray, " equations"]:
        """Equations whose torque is outside of the record."""
        return self.record.outside(self.lag(values))
