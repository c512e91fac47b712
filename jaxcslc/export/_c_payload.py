import numpy as np
from jaxtyping import Float

from ..network import CSLC


def carrying_link(network: CSLC) -> int | None:
    """The link that carries the payload; None without one."""
    if network.payload is None:
        return None
    return network.coefficients[-1].addends[0].term.link


def payload_bodies(
    network: CSLC, k: Float[np.ndarray, " coefficients"]
) -> Float[np.ndarray, "links 10"]:
    """The payload's ten numbers, at the link that carries it."""
    load, link = np.zeros((network.joint_count, 10)), carrying_link(network)
    if link is not None:
        load[link] = k[-10:]
    return load
