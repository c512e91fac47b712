"""Drives, encoders, transmission, friction: from demands to links, in NumPy and JAX alike."""

from dataclasses import dataclass
from functools import cached_property
from typing import Any

import numpy as np
from jaxtyping import Bool, Float, Int

from sim.machine._machine import Machine


@dataclass(frozen=True, eq=False)
class Drives:
    """Torque of the motors as a function of the demand: linear, then saturating (7.2.3).

    Up to its limit of linearity the torque equals the demand. Beyond, it is progressively less, as
    in Fig. 7.2-1, and approaches the greatest torque; the curve is
    L + (S − L) (1 − exp(−(u − L) / (S − L))) for a demand of u, smooth where it leaves the line.
    The thesis gives no formula. Without a limit of linearity the greatest torque cuts off.

    >>> import numpy as np
    >>> from sim import Drives
    >>> drives = Drives(linear=np.array([10.0]), most=np.array([20.0]))
    >>> [float(drives.torque(np.array([u])).round(2)[0]) for u in (8.0, -8.0, 20.0, 200.0)]
    [8.0, -8.0, 16.32, 20.0]
    """

    linear: Float[Any, "*batch joints"]
    """L, the limit of linearity [N m or N]; infinite for none."""

    most: Float[Any, "*batch joints"]
    """S, the greatest torque [N m or N]."""

    @classmethod
    def of(cls, machine: Machine) -> "Drives":
        """The drives of a machine."""
        return cls(np.array(machine.linear_torque), np.array(machine.maximum_torque))

    def torque(self, demand: Float[Any, "*batch joints"]) -> Float[Any, "*batch joints"]:
        """Torque for a demand [N m or N]; NumPy or JAX arrays."""
        xp = demand.__array_namespace__()
        size = xp.abs(demand)
        of_numpy = isinstance(self.linear, np.ndarray)
        bends, linear, headroom = self._numpy_curve if of_numpy else self._curve()
        curve = linear - headroom * xp.expm1(-xp.maximum(size - linear, 0.0) / headroom)
        torque_size = xp.where(bends & (size > linear), curve, size)
        return xp.sign(demand) * xp.minimum(torque_size, self.most)

    @cached_property
    def _numpy_curve(self) -> tuple[Any, Any, Any]:
        """Kept from sample to sample, as tracers of JAX must not be."""
        return self._curve()

    def _curve(self) -> tuple[Any, Any, Any]:
        """Return where motors saturate, from which torque on, and how much it still grows."""
        xp = self.linear.__array_namespace__()
        # Where the motor does not saturate, the curve is unused: any finite headroom serves.
        bends = (self.linear < self.most) & xp.isfinite(self.most)
        linear = xp.where(bends, self.linear, 0.0)
        return bends, linear, xp.where(bends, self.most - linear, 1.0)


@dataclass(frozen=True, eq=False)
class Transmission:
    """Coupling of rotors and links (2.5.3), and the degrees of freedom that a plant has for them.

    A plant's degrees of freedom are the links, one a joint, and after them the rotors of the
    joints whose transmission is flexible. Every array here may have leading batch axes: machines
    with the same flexible joints can be simulated together.

    >>> import dataclasses
    >>> import sim
    >>> soft = (float("inf"), 5e4, *(float("inf"),) * 4)
    >>> transmission = sim.Transmission.of(dataclasses.replace(sim.puma560(), stiffness=soft))
    >>> transmission.rotor, transmission.degrees_of_freedom
    (array([0, 6, 2, 3, 4, 5]), 7)
    """

    flexible: Bool[np.ndarray, " joints"]
    """Which joints have a rotor and a link that move apart."""

    backlash: Float[np.ndarray, "*batch joints"]
    """b [rad or m]."""

    @classmethod
    def of(cls, machine: Machine) -> "Transmission":
        """The transmission of a machine."""
        return cls(np.array(machine.flexible), np.array(machine.backlash))

    @property
    def degrees_of_freedom(self) -> int:
        """Number of degrees of freedom."""
        return int(self.flexible.size + np.count_nonzero(self.flexible))

    @property
    def rotor(self) -> Int[np.ndarray, " joints"]:
        """Degree of freedom of each joint's rotor: its link's, where they are one body."""
        n = self.flexible.size
        return np.where(self.flexible, n + np.cumsum(self.flexible) - 1, np.arange(n))

    def spread(
        self,
        on_rotor: Float[np.ndarray, "*batch joints"],
        on_link: Float[np.ndarray, "*batch joints"],
    ) -> Float[np.ndarray, "*batch dofs"]:
        """Values of each degree of freedom from those of rotors and links; added up where rotor
        and link are one body."""
        links = np.where(self.flexible, on_link, on_rotor + on_link)
        return np.concatenate([links, on_rotor[..., self.flexible]], axis=-1)

    def apart(
        self,
        rotor: Float[np.ndarray, "*batch joints"],
        link: Float[np.ndarray, "*batch joints"],
    ) -> Bool[np.ndarray, "*batch joints"]:
        """Return whether the gears are apart: the joint is in backlash (2.5.3)."""
        return np.abs(rotor - link) < self.backlash / 2


@dataclass(frozen=True, eq=False)
class Encoders:
    """Incremental encoders, one a joint, on its rotor (7.1, 7.2.5).

    An encoder counts the lines that have passed since it was set to zero, so a reading is a whole
    number of counts. Where between two lines the rotor stood at that moment is its phase, which
    differs every time the machine is switched on.

    >>> import numpy as np
    >>> import sim
    >>> encoders = sim.Encoders(np.array([0.1, 0.0]), phase=np.array([0.5, 0.5]))
    >>> encoders.read(np.array([1.23, 1.23]))
    array([1.2 , 1.23])
    """

    resolution: Float[Any, "*batch joints"]
    """What one count means at the joint [rad or m]; zero reads the position as it is."""

    phase: Float[Any, "*batch joints"]
    """In counts, from 0 to 1. A half makes a reading the nearest whole count; with any other, it
    is at most `max(phase, 1 - phase)` counts from the position."""

    @classmethod
    def of(cls, machine: Machine, phase: Float[np.ndarray, "*batch joints"]) -> "Encoders":
        """The encoders of a machine."""
        return cls(np.array(machine.encoder_resolution), phase)

    def read(self, q: Float[Any, "*batch joints"]) -> Float[Any, "*batch joints"]:
        """Readings of rotor positions, `resolution * floor(q / resolution + phase)` [rad or m];
        NumPy or JAX arrays."""
        xp = q.__array_namespace__()
        exact = self.resolution == 0
        count = xp.where(exact, 1.0, self.resolution)
        return xp.where(exact, q, count * xp.floor(q / count + self.phase))


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
