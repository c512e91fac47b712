import jax.numpy as jnp
import numpy as np
from jaxtyping import Array, Float

from ..motion import Patterns
from ..network import CSLC


def torque_noise(
    network: CSLC,
    k: Float[Array | np.ndarray, " coefficients"],
    patterns: Patterns,
    *,
    block: float = 0.25,
) -> Float[np.ndarray, " joints"]:
    """How strong the torque's slow errors are: their spectral density at each joint [N² m² s].

    What an unloaded arm's torque and its model differ by is no white noise: most of it is the
    model's error, which lasts as long as a pose or a direction of motion does. A payload is told
    from it by averaging over time, and what the mean of T seconds still holds is its variance
    times T, over blocks of `block` seconds. White noise of deviation σ at a sampling interval h
    has σ² h.

    **Arguments**

    - `network`, `k`: (p,) the unloaded arm.
    - `patterns`: of a recording other than that which `k` was found from; samples that do not
      count are left out, and blocks of which fewer than half count.
    - `block`: longer than errors last, shorter than a tenth of the recording [s].

    **Raises**

    - `ValueError`: a joint has fewer than four such blocks; names it.

    >>> import jax.numpy as jnp, numpy as np, jaxcslc as jc
    >>> from jaxcslc.payload import torque_noise
    >>> arm = jc.Manipulator.from_modified_dh([(0, 0, 0, 0)], gravity=(0, 0, -9.81))
    >>> network, t = jc.derive(arm, lengths="numeric"), 0.002 * np.arange(5000)[:, None]
    >>> every, noise = np.ones(t.shape, bool), np.random.default_rng(0).normal(size=t.shape)
    >>> patterns = jc.Patterns(t[:, 0], t, 0 * t, 0 * t, 0.1 * noise, every, every)
    >>> bool(abs(torque_noise(network, jnp.zeros(3), patterns)[0] / (0.1**2 * 0.002) - 1) < 0.5)
    True
    """
    residual = np.asarray(patterns.torque) - np.asarray(
        network.torque(jnp.asarray(k), patterns.q, patterns.qd, patterns.qdd)
    )
    time = np.asarray(patterns.time)
    counts = np.asarray(patterns.mask)
    number = np.floor((time - time[0]) / block).astype(int)
    size = np.bincount(number)
    found = np.empty(residual.shape[1])
    for joint in range(len(found)):
        own = counts[:, joint]
        kept = np.bincount(number, weights=own)
        total = np.bincount(number[own], weights=residual[own, joint], minlength=len(size))
        enough = kept >= 0.5 * np.max(size)
        if np.count_nonzero(enough) < 4:
            raise ValueError(
                f"joint {joint + 1}: {np.count_nonzero(enough)} blocks of {block:g} s in which it"
                " moves; expected four or more: record for longer"
            )
        # Of a mean over the part of the block that counts, which is that much shorter.
        length = block * kept[enough] / np.max(size)
        found[joint] = np.mean(length * (total[enough] / kept[enough]) ** 2)
    return found
