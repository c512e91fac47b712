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
    """Spectral density of the torque's slow errors at each joint [N² m² s].

    The difference between an unloaded arm's torque and its model is not white: most of it is model
    error, which lasts as long as a pose or a direction of motion. A payload is identified by
    averaging over time, and the mean over T seconds has the variance density / T; it is measured
    over blocks of `block` seconds. White noise of standard deviation σ at a sampling interval h has
    the density σ² h.

    **Arguments**

    - `network`, `k`: (p,) the unloaded arm.
    - `patterns`: of another recording than that which `k` was identified from. Masked samples are
      left out, and blocks of which more than half is masked.
    - `block`: longer than the errors are correlated, shorter than a tenth of the recording [s].

    **Returns**

    (n,) [N² m² s].

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
    mask = np.asarray(patterns.mask)
    number = np.floor((time - time[0]) / block).astype(int)
    size = np.bincount(number)
    density = np.empty(residual.shape[1])
    for joint in range(len(density)):
        counted = mask[:, joint]
        samples = np.bincount(number, weights=counted)
        total = np.bincount(number[counted], weights=residual[counted, joint], minlength=len(size))
        enough = samples >= 0.5 * np.max(size)
        if np.count_nonzero(enough) < 4:
            raise ValueError(
                f"joint {joint + 1}: {np.count_nonzero(enough)} blocks of {block:g} s in which it"
                " moves; expected four or more: record for longer"
            )
        # The mean is over the unmasked part of a block, which is that much shorter.
        length = block * samples[enough] / np.max(size)
        density[joint] = np.mean(length * (total[enough] / samples[enough]) ** 2)
    return density
