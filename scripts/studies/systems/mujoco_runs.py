"""MuJoCo as the truth: forces that depend on time and state, integrated by its Runge-Kutta."""

from collections.abc import Callable

import mujoco
import numpy as np
from jaxtyping import Float


def run(
    model: mujoco.MjModel,
    data: mujoco.MjData,
    forces: Callable[[mujoco.MjModel, mujoco.MjData], None],
    steps: int,
    observe: Callable[[mujoco.MjModel, mujoco.MjData], np.ndarray],
    *,
    every: int = 1,
) -> Float[np.ndarray, "samples columns"]:
    """Simulates, and observes every so many steps, at the start first.

    **Arguments**

    - `forces`: writes the forces of a state into the data; called for every stage of a step.
    - `observe`: one row of numbers of a state.

    **Raises**

    - `RuntimeError`: the simulation became unstable.
    """
    rows: list[np.ndarray] = []
    mujoco.set_mjcb_control(forces)
    try:
        for step in range(steps):
            if step % every == 0:
                mujoco.mj_forward(model, data)
                rows.append(np.array(observe(model, data)))
            mujoco.mj_step(model, data)
    finally:
        mujoco.set_mjcb_control(None)
    if data.warning[mujoco.mjtWarning.mjWARN_BADQACC].number:
        raise RuntimeError("the simulation became unstable; expected milder inputs")
    return np.array(rows)
