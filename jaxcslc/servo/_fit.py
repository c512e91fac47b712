"""Result of a fit of servo drives to commands and positions."""

from dataclasses import dataclass
from typing import Literal

import numpy as np
from jaxtyping import Float

from ..manipulator import Manipulator
from ._drive import ServoDrive


@dataclass(frozen=True)
class ServoParameter:
    """Estimate of one parameter of a drive, with its 95 % interval.

    **Attributes**

    - `joint`: index of the joint, from 0.
    - `name`: of the parameter, as of `ServoDrive`.
    - `value`, `error`: estimate and standard error; the error is infinite if the recordings do not
      determine the parameter.
    - `low`, `high`: ends of the 95 % interval.
    - `unit`: of all four.

    >>> from jaxcslc.servo import ServoParameter
    >>> ServoParameter(0, "delay", 0.04, 0.001, 0.038, 0.042, "s").is_determined
    True
    """

    joint: int
    name: str
    value: float
    error: float
    low: float
    high: float
    unit: str

    @property
    def is_determined(self) -> bool:
        """True if the recordings determine the parameter."""
        return bool(np.isfinite(self.error))


@dataclass(frozen=True)
class ConfoundedParameters:
    """Parameters of a joint that the recordings cannot tell apart, and what would separate them.

    **Attributes**

    - `joint`: index of the joint, from 0.
    - `parameters`: names of the parameters.
    - `reason`: why they have the same effect in these recordings.
    - `remedy`: the motion, load or known value that would separate them.

    >>> from jaxcslc.servo import ConfoundedParameters
    >>> pair = ConfoundedParameters(0, ("delay", "damping"), "slow motion", "add fast motion")
    >>> pair.remedy
    'add fast motion'
    """

    joint: int
    parameters: tuple[str, ...]
    reason: str
    remedy: str


@dataclass(frozen=True, eq=False)
class ServoFit:
    """Drives of an arm of position servos, with errors and what cannot be told apart.

    **Attributes**

    - `robot`: the arm, with the masses that the fit used.
    - `drives`: one per joint.
    - `parameters`: the estimated parameters of all joints, in the order of `covariance`.
    - `covariance`: of `parameters`.
    - `units`: `"torque"` if the unit of torque is determined, `"gain"` if only ratios to the gain
      are. In the latter case torques are those of the file's masses.
    - `confounded`: parameters that the recordings cannot tell apart.
    - `notes`: sentences about what was decided, as ends of travel that were found.
    """

    robot: Manipulator
    drives: tuple[ServoDrive, ...]
    parameters: tuple[ServoParameter, ...]
    covariance: Float[np.ndarray, "parameters parameters"]
    units: Literal["torque", "gain"]
    confounded: tuple[ConfoundedParameters, ...] = ()
    notes: tuple[str, ...] = ()
