import math

import mujoco
import numpy as np
import scipy.linalg
from jaxtyping import Float

from ..machine import Machine, MachineError, Transmission, friction_of
from ._gravity import check_gravity
from ._mjcf import mjcf


# A fourth-order Runge-Kutta method is stable up to 2.8 rad of an undamped oscillation a step. At
# 1.5 each step removes a twentieth of the amplitude, of an oscillation too fast to matter.
_LARGEST_PHASE = 1.5


def model_of(machine: Machine, step: float) -> mujoco.MjModel:
    """A machine's mechanics as a MuJoCo model with a time step [s].

    **Raises**

    - `MachineError`: a torque limit below gravity's need, or a time step too long for a
        transmission.
    """
    friction, links = friction_of(machine), machine.links
    check_gravity(machine, links)
    model = mujoco.MjModel.from_xml_string(
        mjcf(
            machine.robot,
            links,
            viscous=friction.viscous.tolist(),
            breakaway=friction.static.tolist(),
            stiffness=machine.stiffness,
            backlash=machine.backlash,
            transmission_damping=machine.transmission_damping,
            time_step=step,
        )
    )
    # Without a reset by MuJoCo, a state that is not finite stays visible.
    model.opt.disableflags |= mujoco.mjtDisableBit.mjDSBL_AUTORESET
    # Friction of a chain's joints is one island: looking for islands takes a sixth of a step.
    model.opt.disableflags |= mujoco.mjtDisableBit.mjDSBL_ISLAND
    return model


def check_time_step(
    machine: Machine, model: mujoco.MjModel, position: Float[np.ndarray, " joints"]
) -> None:
    """Refuses a step too long for the quickest oscillation or decay of a machine's transmissions.

    **Raises**

    - `MachineError`: names the joint and the longest step.
    """
    n, dofs = machine.joint_count, model.nv
    transmission = Transmission.of(machine)
    if dofs == n:
        return
    data = mujoco.MjData(model)
    data.qpos[:n], data.qpos[transmission.rotor] = position, position
    mujoco.mj_forward(model, data)
    mass, stiffness, damping = np.zeros((3, dofs, dofs))
    mujoco.mj_fullM(model, data, mass)
    for i in np.flatnonzero(transmission.flexible):
        apart = np.zeros(dofs)
        apart[transmission.rotor[i]], apart[i] = 1.0, -1.0
        stiffness += machine.stiffness[i] * np.outer(apart, apart)
        damping += machine.transmission_damping[i] * np.outer(apart, apart)
    squares, shapes = scipy.linalg.eigh(stiffness, mass)
    decays = scipy.linalg.eigh(damping, mass, eigvals_only=True)
    quickest = max(math.sqrt(float(squares[-1])), float(decays[-1]))
    if model.opt.timestep * quickest > _LARGEST_PHASE:
        joint = int(np.argmax(np.abs(shapes[:n, -1]))) + 1
        raise MachineError(
            f"time_step is {model.opt.timestep:.3g} s; expected no more than"
            f" {_LARGEST_PHASE / quickest:.3g} s for the transmission of joint {joint}"
        )
