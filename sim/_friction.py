from dataclasses import dataclass

import numpy as np
from jaxtyping import Float

from ._machine import Machine


@dataclass(frozen=True, eq=False)
class Friction:
    """The three-part friction of Eqn. 2.5-4, joint by joint.

    F(qd) = k^v qd + sgn(qd) [k^d + (k^s − k^d) exp(−|qd| / γ)] opposes a joint that moves; one at
    rest is held by whatever keeps it still, up to k^s.

    MuJoCo's friction loss is a constant that its constraint solver makes stick and slip. Written
    F(qd) = k^v qd + sgn(qd) k^s − w(qd), the law is that constant and a torque w that is zero at
    rest and continuous: MuJoCo is given k^s, and w is applied to the joint as a help to its motion
    (see `weakening`). Changing the friction loss with the speed would do the same, but constants
    of a model cannot differ between the members of a batch at no cost.

    ```python
    >>> import numpy as np
    >>> import sim
    >>> sim.Friction.of(sim.puma560()).torque(np.array([1.0, -1.0, 0, 0, 0, 0]))
    array([ 9.355, -9.638,  0.   ,  0.   ,  0.   ,  0.   ])

    ```
    """

    viscous: Float[np.ndarray, " joints"]
    """k^v [N m s/rad or N s/m]."""

    dry: Float[np.ndarray, " joints"]
    """k^d [N m or N]."""

    static: Float[np.ndarray, " joints"]
    """k^s [N m or N]."""

    static_velocity: Float[np.ndarray, " joints"]
    """γ [rad/s or m/s]."""

    @classmethod
    def of(cls, machine: Machine) -> "Friction":
        """The friction of a machine."""
        return cls(
            np.array(machine.viscous),
            np.array(machine.dry),
            np.array(machine.static),
            np.array(machine.static_velocity),
        )

    def torque(self, qd: Float[np.ndarray, "*batch joints"]) -> Float[np.ndarray, "*batch joints"]:
        """F(qd), what friction takes from sliding joints [N m or N]; of the sign of `qd`
        [rad/s or m/s], and zero where that is zero."""
        return self.viscous * qd + np.sign(qd) * self.static - self.weakening(qd)

    def weakening(
        self, qd: Float[np.ndarray, "*batch joints"]
    ) -> Float[np.ndarray, "*batch joints"]:
        """w(qd), by how much dry and static friction of a moving joint fall short of k^s
        [N m or N]; of the sign of `qd` [rad/s or m/s], and continuous where that is zero."""
        excess = self.static - self.dry
        return -np.sign(qd) * excess * np.expm1(-np.abs(qd) / self.static_velocity)
