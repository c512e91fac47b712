"""Disturbances between demands and links at each step, for both engines."""

import dataclasses
import functools
from collections.abc import Sequence
from dataclasses import dataclass
from typing import Any

import jax
import numpy as np
from jaxtyping import Int

from sim.engine._plan import Plan, RandomDraws, stacked
from sim.machine._drivetrain import Drives, Encoders, Friction, Transmission, friction_of
from sim.machine._machine import Machine


# Arrays of NumPy or of JAX, tracers included: (machines, joints) for joints, and
# (machines, degrees of freedom) for links and rotors together.
Values = Any


# No `eqx.Module`: its methods are called many times a sample, on NumPy arrays.
@dataclass(frozen=True, eq=False)
class JointHardware:
    """Encoders, drives, transmissions and friction of machines side by side.

    Pure functions of arrays, NumPy's or JAX's: C MuJoCo's engine and MJX's both call them, and
    leave only the integration of the equations of motion to MuJoCo. A disturbance of readings,
    torques or friction belongs here or in the classes of `sim.machine` that are called here.

    **Attributes**

    - `encoders`, `drives`, `friction`: of all machines; arrays with a first axis of machines.
    - `backlash`, `link_share`, `motor_inertia`: (machines, joints).
    - `stale`: the part of each integration step in which the previous command still acts,
      (machines, steps).
    - `step`: of the integrator [s]; static.
    - `flexible`: which joints have a rotor apart from their link; static.
    - `delayed`: whether any machine has a torque delay; static.
    """

    encoders: Encoders
    drives: Drives
    friction: Friction
    backlash: Values
    link_share: Values
    motor_inertia: Values
    stale: Values
    step: float
    flexible: tuple[bool, ...]
    delayed: bool

    @classmethod
    def of(
        cls, machines: Sequence[Machine], plan: Plan, draws: Sequence[RandomDraws] | None = None
    ) -> "JointHardware":
        """The hardware of machines of one structure.

        **Arguments**

        - `machines`, `draws`: one of each for a recording. Without draws, encoders have phase 0.
        - `plan`: of the sampling interval.
        """
        n = machines[0].joint_count
        phases = [np.zeros(n)] * len(machines) if draws is None else [one.phase for one in draws]
        return cls(
            stacked([Encoders.of(m, phase) for m, phase in zip(machines, phases, strict=True)]),
            stacked([Drives.of(machine) for machine in machines]),
            stacked([friction_of(machine) for machine in machines]),
            np.array([machine.backlash for machine in machines]),
            np.array([machine.link_share for machine in machines]),
            np.array([[float(link.motor_inertia) for link in m.links] for m in machines]),
            plan.stale,
            plan.step,
            machines[0].flexible,
            bool(plan.stale.any()),
        )

    @property
    def rotor(self) -> Int[np.ndarray, " joints"]:
        """Return the degree of freedom that is each joint's rotor."""
        return _rotor(self.flexible)

    def read(self, q: Values, qd: Values, late: Values) -> Values:
        """Encoder readings, (machines, joints).

        **Arguments**

        - `q`, `qd`: of the degrees of freedom.
        - `late`: how late each machine reads them, (machines,) [s].
        """
        return self.encoders.read(q[:, self.rotor] + late[:, None] * qd[:, self.rotor])

    def acting(self, step: int, before: Values, torque: Values) -> Values:
        """The drives' mean torque over a step of the sampling interval, (machines, joints).

        **Arguments**

        - `step`: counted from 0.
        - `before`, `torque`: the drives' torque for the previous and the present command.
        """
        return self.mixed(self.stale[:, step], before, torque)

    def mixed(self, stale: Values, before: Values, torque: Values) -> Values:
        """Return what `acting` does, from the step's column of `stale`, (machines,)."""
        if not self.delayed:
            return torque
        stale = stale[:, None]
        return stale * before + (1 - stale) * torque

    def assist(self, qd: Values, acceleration: Values | None = None) -> Values:
        """The applied force that turns MuJoCo's friction into Eqn. 2.5-4 (`Friction.help`).

        **Arguments**

        - `qd`: at the beginning of an integration step.
        - `acceleration`: if any, friction is that of the velocity expected at the step's middle.
        """
        if acceleration is not None:
            qd = qd + 0.5 * self.step * acceleration
        return self.friction.help(qd)

    def observed(
        self,
        q: Values,
        qd: Values,
        acceleration: Values,
        torque: Values,
        assist: Values,
        constraint: Values,
    ) -> dict[str, Values]:
        """The machine's true state at a sample, by the names of `Truth`'s fields.

        **Arguments**

        - `q`, `qd`, `acceleration`: of the degrees of freedom.
        - `torque`: of the drives, (machines, joints).
        - `assist`: the applied force.
        - `constraint`: MuJoCo's constraint force, which is friction's constant part.

        **Returns** arrays (machines, joints).
        """
        n, rotor = len(self.flexible), self.rotor
        xp = acceleration.__array_namespace__()
        friction = self.friction.viscous * qd - assist - constraint
        link, motor = friction[:, :n], friction[:, rotor]
        flexible = np.array(self.flexible)
        on_rotor = xp.where(flexible, motor, (1 - self.link_share) * link)
        on_link = xp.where(flexible, link, self.link_share * link)
        rotor_acceleration = acceleration[:, rotor]
        return {
            "position": q[:, :n],
            "velocity": qd[:, :n],
            "acceleration": acceleration[:, :n],
            "torque": torque,
            "friction": on_rotor + on_link,
            "rotor_position": q[:, rotor],
            "rotor_velocity": qd[:, rotor],
            "rotor_acceleration": rotor_acceleration,
            "link_friction": on_link,
            "transmitted": torque - on_rotor - self.motor_inertia * rotor_acceleration,
            "apart": self.apart(q),
        }

    def apart(self, q: Any) -> Any:
        """Return whether the teeth are apart, (machines, joints), at these positions."""
        return abs(q[:, self.rotor] - q[:, : len(self.flexible)]) < self.backlash / 2


_STATIC = ("flexible", "delayed", "step")
for _class in (Encoders, Drives, Friction, JointHardware):
    _names = [field.name for field in dataclasses.fields(_class)]
    jax.tree_util.register_dataclass(
        _class,
        data_fields=[name for name in _names if name not in _STATIC],
        meta_fields=[name for name in _names if name in _STATIC],
    )


@functools.cache
def _rotor(flexible: tuple[bool, ...]) -> Int[np.ndarray, " joints"]:
    return Transmission(np.array(flexible), np.zeros(len(flexible))).rotor
