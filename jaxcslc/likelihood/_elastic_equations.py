"""Equations of motion of rotors and links that move apart."""

import dataclasses
from functools import cached_property

import numpy as np
from jaxtyping import Bool, Float, Int

from ..network import CSLC
from ._columns import JointColumns
from ._equations import AbstractEquations, Linearisation
from ._gears import Stencil
from ._transmission import TransmissionParameters


Series = Float[np.ndarray, "samples series"]
Rows = Float[np.ndarray, "equations series"]
Turns = Float[np.ndarray, "equations joints"]
# Noise of torque that links have and motors have not, as a part of the motors': equations of gears
# are not quite exact, which also keeps a search from following a wrong spring.
_LINK_NOISE = 0.1


@dataclasses.dataclass(frozen=True)
class ElasticEquations(AbstractEquations):
    """Equations of motion of rotors and links that move apart, as functions of positions alone.

    Positions are those of n rotors, then those of f links that move apart from them; all other
    links move with their rotors. With ID the torque of the links' motion without friction, rotors'
    inertia J included, F friction, which is the rotors', and u = rotor minus link,

        torque = ID(link) + J (rotor'' - link'') + F(rotor)              n equations
        0 = ID(link) - J link'' - (beyond play(u) + lag u') / compliance   f equations

    All terms are averaged over two intervals with a triangle (`MotionEquations`).

    **Attributes**

    - `rigid`: equations of rotors and links that move together; of n joints.
    - `joints`: (f,) which links move apart, from 0.
    - `time`: (samples,) [s].
    - `friction`: (p,) coefficients that are of friction.
    - `width`: (f,) least width of a dead band's edges [rad or m].
    """

    rigid: AbstractEquations
    joints: Int[np.ndarray, " links"]
    time: Float[np.ndarray, " samples"]
    friction: Bool[np.ndarray, " coefficients"]
    width: Float[np.ndarray, " links"]

    @property
    def network(self) -> CSLC:  # pyright: ignore[reportIncompatibleVariableOverride]
        """Network of rigid links."""
        return self.rigid.network

    @property
    def intervals(self) -> Float[np.ndarray, " intervals"]:  # pyright: ignore[reportIncompatibleVariableOverride]
        """(samples - 1,) between samples [s]."""
        return self.rigid.intervals

    def noise(
        self, torque_noise: Float[np.ndarray, "recordings joints"]
    ) -> Float[np.ndarray, "recordings series"]:
        """Add that of gears' equations, which is small beside that of motors [N m or N]."""
        return np.concatenate([torque_noise, _LINK_NOISE * torque_noise[:, self.joints]], axis=1)

    def torque(
        self,
        k: Float[np.ndarray, " coefficients"],
        laws: Float[np.ndarray, " laws"],
        q: Series,
        turn: Turns,
        direction: Turns,
    ) -> Rows:
        """Return torque of motors, then what is left of gears' equations, (equations, n + f).

        **Arguments**

        - `laws`: (n + 4 f,) logarithms of friction's slopes, then `TransmissionParameters`.
        - `q`: (samples, n + f); `turn`, `direction`: (equations, n), of rotors.
        """
        n = self.rigid.network.joint_count
        slopes, rotor, link = laws[:n], q[:, :n], self._link(q)
        signs = turn, direction
        of_links = self.rigid.torque(np.where(self.friction, 0.0, k), slopes, link, *signs)
        of_friction = self.rigid.torque(np.where(self.friction, k, 0.0), slopes, rotor, *signs)
        return self._equations(laws, q, of_links, of_friction)

    def linearised(
        self,
        k: Float[np.ndarray, " coefficients"],
        laws: Float[np.ndarray, " laws"],
        q: Series,
        turn: Turns,
        direction: Turns,
    ) -> Linearisation:
        """Return the same with derivatives by positions, by `k` and `laws`, and by turns."""
        n, f = self.rigid.network.joint_count, len(self.joints)
        slopes, rotor, link = laws[:n], q[:, :n], self._link(q)
        parameters = TransmissionParameters.of(laws[n:])
        signs = turn, direction
        of_links = self.rigid.linearised(np.where(self.friction, 0.0, k), slopes, link, *signs)
        of_friction = self.rigid.linearised(np.where(self.friction, k, 0.0), slopes, rotor, *signs)
        stencil = self._stencil
        beyond = stencil.windup(rotor[:, self.joints] - q[:, n:], parameters.play, self.width)
        count = len(q) - 2
        compliance, inertia = parameters.compliance, parameters.rotor_inertia
        joints, gears, series = self.joints, np.arange(f), n + np.arange(f)

        by_position = np.zeros((count, n + f, 3, n + f))
        moved = of_links.by_position.reshape(count, n, 3, n).swapaxes(1, 2)  # (count, 3, n, n)
        rubbed = of_friction.by_position.reshape(count, n, 3, n).swapaxes(1, 2)
        together = np.setdiff1d(np.arange(n), joints)
        for i in range(3):
            of_motor = by_position[:, :n, i]
            of_motor[:, :, :n] = rubbed[:, i]
            of_motor[:, :, together] += moved[:, i][:, :, together]
            of_motor[:, :, n:] = moved[:, i][:, :, joints]
            turned = inertia * stencil.acceleration[i][:, None]
            of_motor[:, joints, joints] += turned
            of_motor[:, joints, series] -= turned
            of_gear = by_position[:, n:, i]
            borne = moved[:, i][:, joints]  # (count, f, n)
            of_gear[:, :, together] = borne[:, :, together]
            of_gear[:, :, n:] = borne[:, :, joints]
            apart = beyond.by_difference[i] + parameters.lag * stencil.rate[i][:, None]
            apart = apart / compliance
            of_gear[:, gears, joints] -= apart
            of_gear[:, gears, series] += apart - turned

        p = len(k)
        by_law = np.zeros((count, n + f, p + len(laws)))
        frictions, links = of_friction.by_coefficient.dense, of_links.by_coefficient.dense
        by_law[:, :n, :p] = np.where(self.friction, frictions[:, :, :p], links[:, :, :p])
        by_law[:, n:, :p] = np.where(self.friction, 0.0, links[:, joints, :p])
        by_law[:, :n, p : p + n] = frictions[:, :, p:]
        of_link = self._acceleration(q[:, n:])
        rate_of_windup = self._rate(rotor[:, joints] - q[:, n:])
        gears_give = beyond.value + parameters.lag * rate_of_windup
        first = p + n + gears
        by_law[:, series, first] = gears_give / compliance**2
        by_law[:, series, first + f] = -rate_of_windup / compliance
        by_law[:, series, first + 2 * f] = -beyond.by_play / compliance
        by_law[:, joints, first + 3 * f] = self._acceleration(rotor[:, joints] - q[:, n:])
        by_law[:, series, first + 3 * f] = -of_link
        torques = np.asarray(of_links.torque), np.asarray(of_friction.torque)
        return Linearisation(
            self._equations(laws, q, *torques),
            by_position.reshape(count, n + f, -1),
            JointColumns.of(by_law),
            of_friction.by_turn,
        )

    def _equations(
        self,
        laws: Float[np.ndarray, " laws"],
        q: Series,
        of_links: Float[np.ndarray, "equations joints"],
        of_friction: Float[np.ndarray, "equations joints"],
    ) -> Rows:
        n = self.rigid.network.joint_count
        parameters = TransmissionParameters.of(laws[n:])
        difference = q[:, self.joints] - q[:, n:]
        beyond = self._stencil.windup(difference, parameters.play, self.width).value
        motor = of_links + of_friction
        motor[:, self.joints] += parameters.rotor_inertia * self._acceleration(difference)
        borne = of_links[:, self.joints] - parameters.rotor_inertia * self._acceleration(q[:, n:])
        gears = beyond + parameters.lag * self._rate(difference)
        return np.concatenate([motor, borne - gears / parameters.compliance], axis=1)

    def _link(self, q: Series) -> Float[np.ndarray, "samples joints"]:
        """Return positions of all links."""
        n = self.rigid.network.joint_count
        result = q[:, :n].copy()
        result[:, self.joints] = q[:, n:]
        return result

    @cached_property
    def _stencil(self) -> Stencil:
        return Stencil.of(self.time)

    def _rate(self, values: Series) -> Rows:
        return Stencil.applied(self._stencil.rate, values)

    def _acceleration(self, values: Series) -> Rows:
        return Stencil.applied(self._stencil.acceleration, values)
