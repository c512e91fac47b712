import equinox as eqx
import numpy as np
from jaxtyping import Array, Float


Joints = Float[Array | np.ndarray, "*batch joints"]


class Reference(eqx.Module):
    """What the joints should be doing at an instant: q_d, its rate and its acceleration (2.7.1).

    >>> import numpy as np
    >>> from jaxcslc.control import Reference
    >>> Reference.rest(np.zeros(2)).qdd
    array([0., 0.])
    """

    q: Joints
    """[rad or m]."""
    qd: Joints
    """[rad/s or m/s]."""
    qdd: Joints
    """[rad/s² or m/s²]."""

    @classmethod
    def rest(cls, q: Joints) -> "Reference":
        """To stand still at `q`."""
        return cls(q, 0 * q, 0 * q)
