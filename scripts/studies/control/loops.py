"""Feedback loops of the control study: controllers by name, behind encoders."""

from collections.abc import Sequence
from typing import Any, NamedTuple

import jax
import jax.numpy as jnp
import numpy as np

import jaxcslc as jc
import sim
from jaxcslc.control import (
    PID,
    ComputedTorque,
    Gravity,
    JointLimitAvoidance,
    LowPassChain,
    OutputFeedback,
)


CONTROLLERS = {
    "PID": "",
    "PID, thesis": "",
    "PID + gravity": "",
    "computed torque": "full",
    "no friction": "no friction",
    "no velocity term": "no velocity term",
    "gravity only": "gravity only",
}
"""Controllers, and which terms of the model each computed torque compensates."""
WITHOUT_MODEL = ("PID", "PID, thesis")
START = np.array([0.0, -np.pi / 2, np.pi / 2, 0.0, 0.0, 0.0])  # the comparison trajectory's
_RANGE_MARGIN = 0.15  # rad of joint ranges that the random motions' loops keep away from
_RANGE_RATE = 5.0  # 1/s, at which they approach that margin


class LoopDesign(NamedTuple):
    """What all feedback loops have in common."""

    network: jc.CSLC
    limit: np.ndarray
    frequency: float
    damping: float
    corner: float
    published: np.ndarray

    def loop(self, controller: str, k: Any, start: np.ndarray) -> OutputFeedback:
        """The loop of one machine with coefficients `k`, from a pose on."""
        n = self.network.joint_count
        low_pass = LowPassChain(self.corner, lags=2)
        if controller == "PID":
            M = np.diag(np.asarray(self.network.mass_matrix(jnp.asarray(self.published), start)))
            w = self.frequency
            pid = PID(n, position_gain=w**2 * M, velocity_gain=2 * self.damping * w * M,
                      integral_gain=4 / 27 * w**3 * M, torque_limit=self.limit)  # fmt: skip
            return OutputFeedback(pid, low_pass)
        if controller.startswith("PID"):
            thesis = sim.comparison().controller
            assert isinstance(thesis, PID)
            with_gravity = controller == "PID + gravity"
            gravity = Gravity.of_joints(self.network, k, (2, 3)) if with_gravity else None
            pid = PID(n, position_gain=thesis.position_gain, velocity_gain=thesis.velocity_gain,
                      integral_gain=thesis.integral_gain, torque_limit=self.limit,
                      gravity=gravity)  # fmt: skip
            return OutputFeedback(pid, low_pass)
        computed = ComputedTorque(
            self.network, k, self.frequency, self.damping, compensation=CONTROLLERS[controller],
            torque_limit=self.limit, friction_at="reference", pose=start,
        )  # fmt: skip
        return OutputFeedback(computed, low_pass)

    def loop_within_range(self, controller: str, k: Any, machine: sim.Machine) -> OutputFeedback:
        """The same, kept within the machine's joint ranges by the same coefficients."""
        loop = self.loop(controller, k, START)
        ends = np.array(machine.position_range) + _RANGE_MARGIN * np.array([1.0, -1.0])
        within = JointLimitAvoidance(
            loop.controller, self.network, k, ends, torque_limit=self.limit, rate=_RANGE_RATE
        )
        return OutputFeedback(within, loop.filter)


def stacked(loops: Sequence[OutputFeedback]) -> OutputFeedback:
    """Loops of one structure as one, every array with a leading axis of machines."""
    return jax.tree.map(lambda *leaves: jnp.stack([jnp.asarray(leaf) for leaf in leaves]), *loops)
