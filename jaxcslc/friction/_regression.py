"""Regression of friction alone, beside fixed coefficients of the rigid bodies."""

import jax.numpy as jnp
import numpy as np
from jaxtyping import Array, Float

from ..least_squares import Fixed, LeastSquares
from ..network import CSLC
from ..recordings import Patterns


def regress_friction(
    network: CSLC, patterns: Patterns, k: Float[Array | np.ndarray, " k"]
) -> Float[Array, " k"]:
    """Regress friction alone, with fixed rigid-body coefficients (Eqn. 7.6-1).

    The thesis calls the result Ar+Rg, for Armstrong's coefficients: the torque that rigid-body
    coefficients do not explain is regressed against the friction inputs of each joint, over the
    samples in the mask.

    **Arguments**

    - `network`: p coefficients.
    - `patterns`: motion and torque of the training recording.
    - `k`: (p,); its friction coefficients are not used.

    **Returns** (p,): `k` with the regressed friction coefficients.

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
    rigid = network.without_friction(jnp.asarray(k))
    names = [network.names[index] for index in network.layout.friction]
    if not names:
        return rigid
    solver = LeastSquares(joint_weights="equal", errors="independent")
    fixed = Fixed.except_for(network, rigid, names)
    equations = solver.equations(network, patterns)  # on the host: nothing to compile
    return solver.fit_equations(equations, patterns.samples, fixed, throw=False).k
