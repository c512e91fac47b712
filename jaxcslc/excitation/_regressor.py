from typing import Any

import equinox as eqx
import jax.numpy as jnp
import numpy as np
from jaxtyping import Array, Float

from ..network import CSLC


# Of whole motions, where nothing is differentiated. NumPy computes them, from the network's
# expressions: for each of them, and each number of samples, XLA compiles for some seconds, which
# is longer than all calls of a design take.
States = Float[Array | np.ndarray, "samples joints"]


def regressor_of(
    network: CSLC, q: States, qd: States, qdd: States
) -> Float[np.ndarray, "samples joints coefficients"]:
    """The regressor of a motion; compiled for terms of which NumPy cannot compute columns."""
    if not network.has_host_columns:
        return np.asarray(_regressor(network, *(jnp.asarray(x) for x in (q, qd, qdd))))
    columns = _columns(network, q, qd, qdd)
    regressor = np.zeros((len(q), len(columns), network.size))
    for joint, (rows, support) in enumerate(zip(columns, network.support, strict=True)):
        regressor[:, joint, list(support)] = rows.T
    return regressor


def torques_of(
    network: CSLC, k: Float[np.ndarray, "models coefficients"], q: States, qd: States, qdd: States
) -> Float[np.ndarray, "models samples joints"]:
    """Torques of a motion by several models, a row of `k` each."""
    if not network.has_host_columns:
        return np.einsum("sjp,mp->msj", regressor_of(network, q, qd, qdd), k)
    columns = _columns(network, q, qd, qdd)
    torques = [
        k[:, list(support)] @ rows for rows, support in zip(columns, network.support, strict=True)
    ]
    return np.stack(torques, axis=-1)


def mass_matrices_of(
    network: CSLC, k: Float[np.ndarray, " coefficients"], q: States
) -> Float[np.ndarray, "samples joints joints"]:
    """M(q): what torques at rest change by with unit accelerations, joint by joint."""
    zero, joints = np.zeros_like(q), np.eye(q.shape[1])
    of_gravity = torques_of(network, k[None], q, zero, zero)[0]
    columns = [torques_of(network, k[None], q, zero, zero + unit)[0] for unit in joints]
    return np.stack(columns, axis=-1) - of_gravity[..., None]


def _columns(
    network: CSLC, q: States, qd: States, qdd: States
) -> tuple[Float[np.ndarray, "_ samples"], ...]:
    rows: Any = (np.ascontiguousarray(np.asarray(x, float).T) for x in (q, qd, qdd))
    return tuple(np.asarray(x) for x in network.columns(*rows))


@eqx.filter_jit
def _regressor(network: CSLC, q: Any, qd: Any, qdd: Any) -> Any:
    return network.regressor(q, qd, qdd)
