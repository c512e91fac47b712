from dataclasses import dataclass
from typing import Any

import numpy as np
from jaxtyping import Float

from sim.machine._drivetrain import Transmission
from sim.machine._machine import Machine


@dataclass(frozen=True, eq=False)
class Friction:
    """The three-part friction of Eqn. 2.5-4, for each degree of freedom.

    F(qd) = (k^v |qd| + k^d + (k^s − k^d) exp(−|qd| / γ)) (sgn(qd) + a) opposes the motion. At
    rest, friction balances any torque from −k^s (1 − a) to k^s (1 + a). The thesis's law
    has no asymmetry a.

    MuJoCo's friction loss is a constant: its constraint solver computes stick and slip. Its damping
    is symmetric. Written F(qd) = k^v qd + sgn(qd) k^s − w(qd), the law is these two and a
    continuous torque w: MuJoCo gets k^v and k^s, and w is applied as an external torque in the
    direction of motion (see `help`). Changing the friction loss with the speed would do the same,
    but constants of a model cannot differ between the members of a batch at no cost.

    Every array may have leading batch axes.

    >>> import numpy as np
    >>> import sim
    >>> sim.Friction.of(sim.puma560()).torque(np.array([1.0, -1.0, 0, 0, 0, 0]))
    array([ 9.355, -9.638,  0.   ,  0.   ,  0.   ,  0.   ])
    """

    viscous: Float[Any, "*batch dofs"]
    """k^v [N m s/rad or N s/m]."""

    dry: Float[Any, "*batch dofs"]
    """k^d [N m or N]."""

    static: Float[Any, "*batch dofs"]
    """k^s [N m or N]."""

    static_velocity: Float[Any, "*batch dofs"]
    """γ [rad/s or m/s]."""

    asymmetry: Float[Any, "*batch dofs"]
    """a."""

    @classmethod
    def of(cls, machine: Machine) -> "Friction":
        """The friction of a machine's joints, that of rotor and link together."""
        return cls(
            np.array(machine.viscous),
            np.array(machine.dry),
            np.array(machine.static),
            np.array(machine.static_velocity),
            np.array(machine.asymmetry),
        )

    def torque(self, qd: Float[Any, "*batch dofs"]) -> Float[Any, "*batch dofs"]:
        """F(qd), friction torque of a moving joint [N m or N], opposite to `qd` [rad/s or m/s];
        zero where `qd` is zero."""
        xp = qd.__array_namespace__()
        moving = xp.where(qd == 0, 0.0, 1.0)
        return moving * (self.viscous * qd + xp.sign(qd) * self.static - self.help(qd))

    def help(self, qd: Float[Any, "*batch dofs"]) -> Float[Any, "*batch dofs"]:
        """w(qd), by how much friction falls short of k^v qd + sgn(qd) k^s [N m or N], from `qd`
        [rad/s or m/s]; continuous where that is zero. NumPy or JAX arrays."""
        xp = qd.__array_namespace__()
        speed = xp.abs(qd)
        excess = self.static - self.dry
        weaker = -excess * xp.expm1(-speed / self.static_velocity)
        one_sided = self.viscous * speed + self.static - weaker
        return xp.sign(qd) * weaker - self.asymmetry * one_sided


def friction_of(machine: Machine) -> Friction:
    """The friction of each degree of freedom of a machine's plant, rotors apart from links."""
    transmission = Transmission.of(machine)
    joints, share = Friction.of(machine), np.array(machine.link_share)

    def divided(values: Float[np.ndarray, " joints"]) -> Float[np.ndarray, " dofs"]:
        return transmission.spread((1 - share) * values, share * values)

    def repeated(values: Float[np.ndarray, " joints"]) -> Float[np.ndarray, " dofs"]:
        return np.concatenate([values, values[transmission.flexible]])

    return Friction(
        divided(joints.viscous),
        divided(joints.dry),
        divided(joints.static),
        repeated(joints.static_velocity),
        repeated(joints.asymmetry),
    )
