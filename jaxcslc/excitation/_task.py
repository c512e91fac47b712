from typing import Any

import jax.numpy as jnp
import numpy as np
from jaxtyping import Float

from ..motion import Preparation, Recording
from ..network import CSLC
from ._families import Parameters, Times
from ._feasibility import DenseCheck
from ._information import Motion, MotionInformation


_TASKS, _TASK_STRIDE = 40, 5  # random motions on which torques matter, samples apart


def random_parameters(
    check: DenseCheck,
    pose: Float[np.ndarray, " joints"],
    rng: np.random.Generator,
    spread: float | None = None,
) -> Parameters:
    """A random motion about a pose that keeps limits of positions and derivatives, by nine tenths.

    **Arguments**

    - `spread`: of its start about the pose, as a part of the ranges; a tenth if None.
    """
    limits, family = check.limits, check.family
    half = (limits.high - limits.low) / 2
    parameters = half * rng.normal(0.0, 0.7, (family.size, len(half)))
    shift = (0.1 if spread is None else spread) * half * rng.uniform(-1.0, 1.0, len(half))
    parameters[0] = np.clip(pose + shift, limits.low + 0.1 * half, limits.high - 0.1 * half)
    if spread == 0.0:
        parameters[0] = pose
    return check.within_kinematic_limits(parameters, 0.9)


def random_states(
    check: DenseCheck,
    network: CSLC,
    k: Float[np.ndarray, " coefficients"] | None,
    time: Times,
    rng: np.random.Generator,
) -> Motion:
    """States of random motions all over the ranges, those whose torques keep the limits.

    **Arguments**

    - `check`: of limits, with the family of the motions.
    - `k`: (p,) the model of torques; None if there is none.
    - `time`: of the states.
    """
    limits, family = check.limits, check.family
    half = (limits.high - limits.low) / 2
    motions = [
        family.motion(random_parameters(check, limits.middle + half * pose, rng), time)
        for pose in rng.uniform(-0.8, 0.8, (_TASKS, len(half)))
    ]
    q, qd, qdd = (np.concatenate(x)[::_TASK_STRIDE] for x in zip(*motions, strict=True))
    if k is None:
        return q, qd, qdd
    torque = network.torque(jnp.asarray(k), jnp.asarray(q), jnp.asarray(qd), jnp.asarray(qdd))
    within = np.all(np.abs(np.asarray(torque)) <= limits.usable_torque, axis=1)
    within |= not within.any()
    return q[within], qd[within], qdd[within]


def task_products(information: MotionInformation, task: Any) -> Float[np.ndarray, "_ _"]:
    """Mean squared torque, over the noise's, of errors of coefficients on a motion."""
    network, size = information.network, information.size
    if task is None:
        return np.zeros((network.size, network.size))
    if isinstance(task, Recording):
        task = Preparation().derivatives(task)
    rows = np.asarray(network.regressor(*(jnp.asarray(x) for x in task))) * size
    deviation = information.noise.torque_deviation(network.joint_count)
    rows = (rows / deviation[:, None]).reshape(-1, network.size)
    return rows.T @ rows / (len(rows))
