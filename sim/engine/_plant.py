from collections.abc import Sequence

import numpy as np
from jaxtyping import Bool, Float
from mujoco import MjModel
from mujoco.batch import Batch

from jaxcslc.manipulator import LinkParameters

from ..machine import Drives, Machine, Transmission, carrying
from ._models import check_time_step, model_of, rubbing
from ._plan import Plan
from ._stacking import stacked


class Plant:
    """The mechanics of machines in motion: drives, rotors, gears, links and friction.

    Any number of machines move side by side, on as many threads as asked for. What a machine does
    depends on no other, and not on the number of threads, to the last bit.

    The equations of motion are integrated by a fourth-order Runge-Kutta method. A semi-implicit
    Euler method of the same cost lets positions run ahead of torques by half a step, which an
    identification would see: at a step of an eighth of a millisecond, as an error of 0.01 N m at
    joint 6 in the training trajectory.

    A joint sticks or slips as MuJoCo's friction constraint decides. The part of Eqn. 2.5-4 that
    varies with the speed (`Friction.help`) is held over a step, at its value for the speed
    expected at the step's middle.

    Every array below has shape `(machines, joints)`, or `(joints,)` for a plant of one machine
    that was not given as a sequence. A plant is the one mutable thing in the simulator.

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
        self,
        machines: Machine | Sequence[Machine],
        position: Float[np.ndarray, "*machines joints"],
        *,
        interval: float,
        threads: int = 1,
    ) -> None:
        """Machines at rest, their gears in the middle of the dead band.

        **Arguments**

        - `machines`: one, or several of as many joints, of which the same have a transmission
            that gives way, and with the same time step.
        - `position`: of their joints [rad or m].
        - `interval`: by how much `advance` goes on [s]; divided into equal steps, each at most
            the machines' `time_step`.
        - `threads`: how many to use.

        **Raises**

        - `MachineError`: machines that do not go together, a torque limit below gravity's need, a
            time step too long for a transmission, a torque delay as long as the interval.
        """
        self._alone = isinstance(machines, Machine)
        group = [machines] if isinstance(machines, Machine) else list(machines)
        plan = Plan.of(group, interval)
        first = group[0]
        self._steps, self._step, self._stale = plan.steps, plan.step, plan.stale
        self._is_late = bool(plan.stale.any())
        self._transmission = stacked([Transmission.of(machine) for machine in group], ("flexible",))
        self._rotor = self._transmission.rotor
        self._friction = stacked([rubbing(machine) for machine in group])
        self._share = np.array([machine.link_share for machine in group])
        self._drives = stacked([Drives.of(machine) for machine in group])
        links = [machine.links for machine in group]
        self._inertia = np.array([[float(link.motor_inertia) for link in row] for row in links])

        at = np.atleast_2d(position)
        self._group, self._start = group, at
        self._compiled: dict[int, tuple[LinkParameters | None, list[MjModel]]] = {}
        self._batch = Batch(self._models(None)[0], len(group), nthread=threads)
        self.carry(None)
        self._q, self._qd = self._batch.bind("qpos"), self._batch.bind("qvel")
        self._control, self._applied = self._batch.bind("ctrl"), self._batch.bind("qfrc_applied")
        self._qdd = self._batch.bind("qacc")
        self._constraint = self._batch.bind("qfrc_constraint")
        n = first.joint_count
        self._q[:, :n] = at
        self._q[:, self._rotor] = at
        self._torque = np.zeros(at.shape)
        self._before = self._torque
        self._n = n
        self.drive(np.zeros(position.shape))

    @property
    def position(self) -> Float[np.ndarray, "*machines joints"]:
        """Positions of the links [rad or m]."""
        return self._given(self._q[:, : self._n])

    @property
    def velocity(self) -> Float[np.ndarray, "*machines joints"]:
        """Velocities of the links [rad/s or m/s]."""
        return self._given(self._qd[:, : self._n])

    @property
    def acceleration(self) -> Float[np.ndarray, "*machines joints"]:
        """Accelerations of the links at the latest `drive` [rad/s² or m/s²]."""
        return self._given(self._acceleration[:, : self._n])

    @property
    def rotor_position(self) -> Float[np.ndarray, "*machines joints"]:
        """Positions of the rotors, at the joint [rad or m]."""
        return self._given(self._q[:, self._rotor])

    @property
    def rotor_velocity(self) -> Float[np.ndarray, "*machines joints"]:
        """Velocities of the rotors, at the joint [rad/s or m/s]."""
        return self._given(self._qd[:, self._rotor])

    @property
    def rotor_acceleration(self) -> Float[np.ndarray, "*machines joints"]:
        """Accelerations of the rotors at the latest `drive` [rad/s² or m/s²]."""
        return self._given(self._acceleration[:, self._rotor])

    @property
    def torque(self) -> Float[np.ndarray, "*machines joints"]:
        """What the drives give just after the latest `drive` [N m or N]."""
        return self._given(self._acting(0))

    @property
    def friction(self) -> Float[np.ndarray, "*machines joints"]:
        """What friction of rotor and link took of it at the latest `drive` [N m or N]."""
        return self._given(self._rotor_friction + self._link_friction)

    @property
    def link_friction(self) -> Float[np.ndarray, "*machines joints"]:
        """What friction of the link alone took [N m or N]."""
        return self._given(self._link_friction)

    @property
    def transmitted(self) -> Float[np.ndarray, "*machines joints"]:
        """What went through the gears from rotor to link at the latest `drive` [N m or N]."""
        inertial = self._inertia * self._acceleration[:, self._rotor]
        return self._given(self._acting(0) - self._rotor_friction - inertial)

    @property
    def apart(self) -> Bool[np.ndarray, "*machines joints"]:
        """Whether the gears are apart: whether the joint is experiencing backlash."""
        rotor, link = self._q[:, self._rotor], self._q[:, : self._n]
        apart = self._transmission.apart(rotor, link)
        return apart[0] if self._alone else apart

    def carry(self, body: LinkParameters | None) -> None:
        """Fixes a body to the last link from now on, in place of any before, or lets go of it.

        Positions and velocities stay as they are; the next `drive` tells the accelerations. The
        models of a body are compiled when it is carried first, and kept.

        **Arguments**

        - `body`: in the last link's frame; None for none.

        **Raises**

        - `MachineError`: as for a machine with such a link.

        ```python
        >>> import numpy as np
        >>> import jaxcslc, sim
        >>> plant = sim.Plant(sim.undisturbed(sim.puma560()), np.zeros(6), interval=0.002)
        >>> ball = jaxcslc.LinkParameters(2.0, np.array([0.0, 0.0, 0.1]), np.zeros((3, 3)))
        >>> accelerations = []
        >>> for body in (None, ball):
        ...     plant.carry(body)
        ...     plant.drive(np.array([0.0, 0.0, 0.0, 0.0, 5.0, 0.0]))
        ...     accelerations.append(plant.acceleration[4])
        >>> bool(accelerations[1] < accelerations[0])
        True

        ```
        """
        self._batch.set_models(self._models(body))

    def drive(self, demand: Float[np.ndarray, "*machines joints"]) -> None:
        """Makes the drives give the torque demanded, as far and as soon as they can [N m or N]."""
        self._before = self._torque
        self._torque = self._drives.torque(np.atleast_2d(demand))
        self._control[:] = self._acting(0)
        self._applied[:] = self._friction.help(self._qd)
        self._batch.forward()
        self._acceleration = self._qdd.copy()
        taken = self._friction.viscous * self._qd - self._applied - self._constraint
        link, rotor = taken[:, : self._n], taken[:, self._rotor]
        soft, share = self._transmission.flexible, self._share
        self._rotor_friction = np.where(soft, rotor, (1 - share) * link)
        self._link_friction = np.where(soft, link, share * link)

    def advance(self) -> None:
        """Goes on by one interval."""
        half = 0.5 * self._step
        acceleration = self._acceleration
        for step in range(self._steps):
            before = self._qd.copy()
            if self._is_late:
                self._control[:] = self._acting(step)
            self._applied[:] = self._friction.help(before + half * acceleration)
            self._batch.step()
            acceleration = (self._qd - before) / self._step

    def _models(self, body: LinkParameters | None) -> list[MjModel]:
        """Each machine's mechanics with a body."""
        if id(body) not in self._compiled:
            # Machines of many recordings are often the same one.
            each = {id(machine): carrying(machine, body) for machine in self._group}
            models = {key: model_of(machine, self._step) for key, machine in each.items()}
            for machine, row in zip(self._group, self._start, strict=True):
                check_time_step(machine, models[id(machine)], row)
            self._compiled[id(body)] = body, [models[id(machine)] for machine in self._group]
        return self._compiled[id(body)][1]

    def _acting(self, step: int) -> Float[np.ndarray, "machines joints"]:
        """The drives' mean torque over a step of the interval."""
        if not self._is_late:
            return self._torque
        stale = self._stale[:, step, None]
        return stale * self._before + (1 - stale) * self._torque

    def _given(self, values: np.ndarray) -> np.ndarray:
        return values[0].copy() if self._alone else values.copy()
