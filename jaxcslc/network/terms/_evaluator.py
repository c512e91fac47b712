import abc

import equinox as eqx
from jaxtyping import Array, Float


Coefficients = Float[Array, " coefficients"]
Joints = Float[Array, "*batch joints"]
Matrices = Float[Array, "*batch joints joints"]
Regressor = Float[Array, "*batch joints coefficients"]


class AbstractEvaluator(eqx.Module):
    """How the rigid-body part of a network is computed; friction is not its concern.

    `k` holds the inertial coefficients only. Positions, velocities and accelerations have any
    leading batch axes. Everything is linear in `k`, and `regressor` is that linear map.
    """

    @property
    @abc.abstractmethod
    def has_tables(self) -> bool:
        """Whether it computes from the closed-form tables: they are small enough to be expanded."""

    @abc.abstractmethod
    def regressor(self, q: Joints, qd: Joints, qdd: Joints) -> Regressor: ...

    @property
    @abc.abstractmethod
    def support(self) -> tuple[tuple[int, ...], ...]:
        """For each joint, the coefficients that its torque can depend on, in ascending order."""

    @abc.abstractmethod
    def columns(
        self,
        q: Float[Array, "joints samples"],
        qd: Float[Array, "joints samples"],
        qdd: Float[Array, "joints samples"],
    ) -> tuple[Float[Array, "_ samples"], ...]:
        """For each joint, the regressor's columns in its `support` as rows: (support, samples).

        The layout that a factorisation of many patterns wants: joints first, samples last,
        nothing that is always zero.
        """

    @abc.abstractmethod
    def torque(self, k: Coefficients, q: Joints, qd: Joints, qdd: Joints) -> Joints: ...

    @abc.abstractmethod
    def mass_matrix(self, k: Coefficients, q: Joints) -> Matrices: ...

    @abc.abstractmethod
    def velocity_term(self, k: Coefficients, q: Joints, qd: Joints) -> Joints: ...

    @abc.abstractmethod
    def gravity_term(self, k: Coefficients, q: Joints) -> Joints: ...
