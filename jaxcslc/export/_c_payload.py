import numpy as np
from jaxtyping import Float

from ..network import CSLC


def payload_bodies(
    network: CSLC, k: Float[np.ndarray, " coefficients"]
) -> Float[np.ndarray, "links 10"]:
    """The payload's ten numbers, at the link that carries it."""
    load = np.zeros((network.joint_count, 10))
    if network.carrying_link is not None:
        load[network.carrying_link - 1] = k[-10:]
    return load
