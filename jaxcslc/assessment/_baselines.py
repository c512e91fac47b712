import jax.numpy as jnp
import numpy as np
from jaxtyping import Array, Float

from ..motion import Patterns
from ..network import CSLC
from ._errors import torque_errors


def regress_friction(
    network: CSLC, patterns: Patterns, k: Float[Array | np.ndarray, " k"]
) -> Float[Array, " k"]:
    """The coefficients `k` with the friction that fits the patterns best (Eqn. 7.6-1).

    What the thesis calls Ar+Rg, for Armstrong's coefficients: rigid-body coefficients are kept,
    and what they leave of each joint's torque is regressed against that joint's own friction
    inputs, over the pairs that count.

    **Arguments**

    - `network`: p coefficients.
    - `patterns`: motion and torque of the training recording.
    - `k`: (p,); its friction coefficients are not used.

    **Returns** (p,).

    >>> import numpy as np, jaxcslc as jc
    >>> robot = jc.puma560()
    >>> network = jc.derive(robot)
    >>> k = network.coefficients_from(robot.links, viscous=robot.viscous, dry=robot.dry)
    >>> motion = np.sin(np.arange(60.0)).reshape(10, 6)
    >>> torque = np.asarray(network.torque(k, motion, motion, motion))
    >>> all_pairs = np.ones((10, 6), bool)
    >>> patterns = jc.Patterns(
    ...     np.arange(10.0), motion, motion, motion, torque, all_pairs, all_pairs
    ... )
    >>> wrong = network.coefficients_from(robot.links)
    >>> bool(np.allclose(jc.regress_friction(network, patterns, wrong), k))
    True
    """
    n, terms = network.joint_count, len(network.robot.friction)
    start = network.size - n * terms
    rigid = jnp.asarray(k).at[start:].set(0.0)
    left = np.asarray(torque_errors(network, patterns, rigid))
    counts = np.asarray(patterns.counts_in)
    inputs = [np.asarray(x) for x in network.friction_inputs(jnp.asarray(patterns.qd))]
    result = np.array(rigid)
    for joint in range(n):
        rows = counts[:, joint]
        columns = np.stack([x[rows, joint] for x in inputs], axis=1)
        found = np.linalg.lstsq(columns, left[rows, joint], rcond=None)[0]
        result[start + np.arange(terms) * n + joint] = found
    return jnp.asarray(result)
