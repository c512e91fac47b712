"""Terms of two joints that share a motor's shaft: inertia, viscous and Coulomb friction."""

from collections.abc import Sequence
from functools import lru_cache
from typing import Any

import equinox as eqx

from jaxcslc.derivation import Coefficient
from jaxcslc.manipulator import Coupling, Manipulator, RobotError

from ._input_term import AbstractFunctions, AbstractInputTerm


# Of each kind: the letters of its coefficients' names, what they are, units for revolute and
# prismatic joints, and the sum of the equation of motion that it belongs to.
_KINDS = {
    "coupled_inertia": ("kcm", "inertia", ("kg m²", "kg"), "mass"),
    "coupled_viscous": ("kcv", "viscous friction", ("N m s/rad", "N s/m"), "friction"),
    "coupled_dry": ("kcd", "dry friction", ("N m", "N"), "friction"),
}


class CoupledTerm(AbstractInputTerm):
    """Torque that two joints share of a motor's shaft: inertia, viscous or Coulomb friction.

    The shaft of a pair turns by `q[first] + ratio * q[second]`.

    **Attributes**

    - `kind`: `"coupled_inertia"`, `"coupled_viscous"` or `"coupled_dry"`.
    - `pairs`: of joints that have torques, with one coefficient each; `joint_count`: how many.
    """

    kind: str = eqx.field(static=True)
    coefficients: tuple[Coefficient, ...] = eqx.field(static=True)
    pairs: tuple[Coupling, ...] = eqx.field(static=True)
    joint_count: int = eqx.field(static=True)

    @classmethod
    def from_robot(cls, robot: Manipulator) -> list["CoupledTerm"]:
        """Return one term of each kind, or none without coupled joints.

        **Raises** `RobotError` for a joint that follows another.
        """
        if not robot.coupled:
            return []
        prismatic = tuple(robot.joints[pair.first - 1].kind == "P" for pair in robot.coupled)
        number = {joint: i for i, joint in enumerate(robot.independent_joints)}
        for joint in (joint for pair in robot.coupled for joint in (pair.first, pair.second)):
            if joint - 1 not in number:
                raise RobotError(
                    f"coupled: joint {joint} ({robot.joint_names[joint - 1]}) follows another and"
                    " has no motor; expected joints that follow none"
                )
        pairs = tuple(
            Coupling(number[pair.first - 1] + 1, number[pair.second - 1] + 1, pair.ratio)
            for pair in robot.coupled
        )
        return [
            cls(
                kind=kind,
                coefficients=_coefficients(kind, robot.coupled, prismatic),
                pairs=pairs,
                joint_count=len(number),
            )
            for kind in _KINDS
        ]

    @property
    def keyword(self) -> str:
        return "coupled"

    @property
    def parts(self) -> tuple[str, ...]:
        return (_KINDS[self.kind][-1],)

    @property
    def input_joints(self) -> tuple[int, ...]:
        return tuple(joint - 1 for pair in self.pairs for joint in (pair.first, pair.second))

    @property
    def input_indices(self) -> tuple[int, ...]:
        return tuple(index for index in range(self.size) for _ in range(2))

    @property
    def value_shape(self) -> tuple[int, ...]:
        return (len(self.pairs), len(_KINDS))

    @property
    def value_index(self) -> tuple[tuple[int, ...], ...]:
        return tuple(range(self.size)), (list(_KINDS).index(self.kind),) * self.size

    @property
    def value_meaning(self) -> str:
        return "inertia, viscous and dry of each pair"

    def inputs(
        self, functions: AbstractFunctions, q: Sequence[Any], qd: Sequence[Any], qdd: Sequence[Any]
    ) -> list[Any]:
        """Return the shaft's additional inputs of both joints of each pair.

        The shaft's inertia and viscous friction enter joint i's torque by its own motion too; that
        part cannot be told from the joint's own motor and friction, and is left to them.
        """
        del q
        values: list[Any] = []
        for pair in self.pairs:
            i, j, ratio = pair.first - 1, pair.second - 1, float(pair.ratio)
            if self.kind == "coupled_dry":
                sign = functions.sign(qd[i] + ratio * qd[j])
                values += [sign, ratio * sign]
            else:
                motion = qdd if self.kind == "coupled_inertia" else qd
                values += [ratio * motion[j], ratio * motion[i]]
        return values


# Made once for some pairs: coefficients are compared by identity.
@lru_cache(maxsize=256)
def _coefficients(
    kind: str, pairs: tuple[Coupling, ...], prismatic: tuple[bool, ...]
) -> tuple[Coefficient, ...]:
    letters, quantity, units, _ = _KINDS[kind]
    return tuple(
        Coefficient(
            f"{letters}{pair.first}_{pair.second}",
            kind,
            f"{quantity} that joints {pair.first} and {pair.second} share",
            units[slides],
            positive=True,
        )
        for pair, slides in zip(pairs, prismatic, strict=True)
    )
