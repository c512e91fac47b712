import math

import mujoco
import numpy as np
from jaxtyping import Float

from ._friction import Friction
from ._machine import Machine
from ._mjcf import mjcf


class Plant:
    """A machine's mechanics in motion: drives, rigid links and friction, without encoders.

    The equations of motion are integrated by a fourth-order Runge-Kutta method. A semi-implicit
    Euler method of the same cost lets positions run ahead of torques by half a step, which an
    identification would see: at a step of an eighth of a millisecond, as an error of 0.01 N m at
    joint 6 in the training trajectory.

    A joint sticks or slips as MuJoCo's friction constraint decides. The part of Eqn. 2.5-4 that
    varies with the speed (`Friction.weakening`) is held over a step, at its value for the speed
    expected at the step's middle.

    This is the one mutable thing in the simulator; `simulate` makes one for each recording.

    ```python
    >>> import numpy as np
    >>> import sim
    >>> plant = sim.Plant(sim.puma560(), np.zeros(6), interval=0.002)
    >>> plant.drive(np.array([10.0, 0, 0, 0, 0, 0]))
    >>> plant.advance()
    >>> bool(plant.velocity[0] > 0)
    True

    ```
    """

    def __init__(
        self, machine: Machine, position: Float[np.ndarray, " joints"], *, interval: float
    ) -> None:
        """A machine at rest.

        **Arguments**

        - `machine`: the machine.
        - `position`: of its joints [rad or m].
        - `interval`: by how much `advance` goes on [s]; divided into equal steps, each at most
            `machine.time_step`.
        """
        self._steps = max(1, math.ceil(interval / machine.time_step - 1e-9))
        self._step = interval / self._steps
        self._friction = Friction.of(machine)
        self._limit = np.array(machine.maximum_torque)
        self._model = mujoco.MjModel.from_xml_string(
            mjcf(
                machine.robot,
                viscous=machine.viscous,
                breakaway=machine.static,
                time_step=self._step,
            )
        )
        # A state that is not finite has to show, and not to be put back to the start.
        self._model.opt.disableflags |= mujoco.mjtDisableBit.mjDSBL_AUTORESET
        self._data = mujoco.MjData(self._model)
        self._data.qpos[:] = position
        self.drive(np.zeros(machine.joint_count))

    @property
    def position(self) -> Float[np.ndarray, " joints"]:
        """Joint positions [rad or m]."""
        return self._data.qpos.copy()

    @property
    def velocity(self) -> Float[np.ndarray, " joints"]:
        """Joint velocities [rad/s or m/s]."""
        return self._data.qvel.copy()

    @property
    def acceleration(self) -> Float[np.ndarray, " joints"]:
        """Joint accelerations at the latest `drive` [rad/s² or m/s²]."""
        return self._acceleration

    @property
    def torque(self) -> Float[np.ndarray, " joints"]:
        """What the drives give [N m or N]."""
        return self._data.ctrl.copy()

    @property
    def friction(self) -> Float[np.ndarray, " joints"]:
        """What friction took of it at the latest `drive` [N m or N]."""
        return self._taken

    def drive(self, demand: Float[np.ndarray, " joints"]) -> None:
        """Makes the drives give the torque demanded, as far as they can, from now on [N m or N]."""
        data = self._data
        data.ctrl[:] = np.clip(demand, -self._limit, self._limit)
        data.qfrc_applied[:] = self._friction.weakening(data.qvel)
        mujoco.mj_forward(self._model, data)
        self._acceleration = data.qacc.copy()
        self._taken = -(data.qfrc_passive + data.qfrc_constraint + data.qfrc_applied)

    def advance(self) -> None:
        """Goes on by one interval."""
        data, half = self._data, 0.5 * self._step
        acceleration = self._acceleration
        for _ in range(self._steps):
            before = data.qvel.copy()
            data.qfrc_applied[:] = self._friction.weakening(before + half * acceleration)
            mujoco.mj_step(self._model, data)
            acceleration = (data.qvel - before) / self._step
