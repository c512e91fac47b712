import jax
import jax.numpy as jnp
import numpy as np
from jaxtyping import Array, Bool, Float

from .._environment import array_namespace


Velocities = Float[Array | np.ndarray, "samples joints"]

# A joint that is slower than this part of its greatest speed, for so many samples, is at rest.
# Encoder noise and the creep of a position controller are there; a joint that turns back passes
# through in less than a sample.
_REST_FRACTION, _REST_SAMPLES = 1e-4, 5


def at_rest(qd: Velocities) -> Bool[Array | np.ndarray, "samples joints"]:
    """Marks the joint-and-sample pairs of joints that stand still.

    **Arguments**

    - `qd`: velocities in order of time, shape `(samples, joints)` [rad/s or m/s].

    **Returns**

    True where a joint is slower than 1e-4 of its greatest speed for five samples at least, shape
    `(samples, joints)`. A joint that never moves is not marked.

    >>> import numpy as np
    >>> from jaxcslc.motion import at_rest
    >>> qd = np.array([1.0, 1e-6, 0.5, 0.0, 1e-6, -1e-6, 0.0, 1e-6])[:, None]
    >>> at_rest(qd)[:, 0].tolist()
    [False, False, False, True, True, True, True, True]
    """
    xp = array_namespace(qd)
    samples = qd.shape[0]
    if samples < _REST_SAMPLES:
        return xp.zeros(qd.shape, bool)
    slow = xp.abs(qd) < _REST_FRACTION * xp.max(xp.abs(qd), axis=0, keepdims=True)
    starts = samples - _REST_SAMPLES + 1
    lasting = xp.ones((starts, qd.shape[1]), bool)
    for shift in range(_REST_SAMPLES):
        lasting = lasting & slow[shift : shift + starts]
    # Every sample of a run that is long enough, not only the first ones.
    padded = xp.pad(lasting, ((_REST_SAMPLES - 1, _REST_SAMPLES - 1), (0, 0)))
    still = xp.zeros(qd.shape, bool)
    for shift in range(_REST_SAMPLES):
        still = still | padded[shift : shift + samples]
    return still


def directions_beside(
    qd: Velocities, still: Bool[Array | np.ndarray, "samples joints"]
) -> tuple[
    Float[Array | np.ndarray, "samples joints"], Float[Array | np.ndarray, "samples joints"]
]:
    """Which way each joint went before it stands still, and which way it goes afterwards.

    **Arguments**

    - `qd`: velocities in order of time, shape `(samples, joints)` [rad/s or m/s].
    - `still`: where joints stand still, as of `at_rest`.

    **Returns**

    The signs of the last velocity before and of the first one after, outside `still`, shape
    `(samples, joints)` each; 0 where there is none. Outside `still` both are the sign of the
    velocity itself.

    >>> import numpy as np
    >>> from jaxcslc.motion import directions_beside
    >>> qd = np.array([0.0, -1.0, 1e-6, 1e-6, 2.0])[:, None]
    >>> before, after = directions_beside(qd, np.abs(qd) < 1e-3)
    >>> before[:, 0].tolist(), after[:, 0].tolist()
    ([0.0, -1.0, -1.0, -1.0, 1.0], [-1.0, -1.0, 1.0, 1.0, 1.0])
    """
    return _before(qd, still), _before(qd[::-1], still[::-1])[::-1]


def _before(
    qd: Velocities, still: Bool[Array | np.ndarray, "samples joints"]
) -> Float[Array | np.ndarray, "samples joints"]:
    xp = array_namespace(qd, still)
    index = xp.where(still, -1, xp.arange(qd.shape[0])[:, None])
    last = np.maximum.accumulate(index) if xp is np else jax.lax.cummax(jnp.asarray(index))
    before = xp.take_along_axis(qd, xp.maximum(last, 0), axis=0)
    return xp.where(last < 0, 0.0, xp.sign(before))
