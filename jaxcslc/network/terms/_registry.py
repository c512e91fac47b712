"""Terms of a robot's friction model, from the names of its laws."""

from collections.abc import Callable

from jaxcslc.manipulator import Manipulator

from ._coupled import CoupledTerm
from ._expressed_bodies import AbstractRigidBody
from ._friction_laws import (
    AsymmetricDry,
    AsymmetricViscous,
    Dry,
    Offset,
    QuadraticFriction,
    Root,
    Spring,
    StaticFriction,
    Viscous,
)
from ._input_term import AbstractInputTerm
from ._joint_projection import ProjectedTerm
from ._joint_term import AbstractJointLaw, JointTerm
from ._load_friction import DIRECTIONAL_LOAD, LOAD, LoadFriction


# The law of each kind of `jaxcslc.manipulator.FRICTION_TERMS`, made for a robot.
_LAWS: dict[str, Callable[[Manipulator], AbstractJointLaw]] = {
    "viscous": lambda _: Viscous(),
    "asymmetric_viscous": lambda _: AsymmetricViscous(),
    "dry": lambda _: Dry(),
    "asymmetric_dry": lambda _: AsymmetricDry(),
    "static": StaticFriction.from_robot,
    "root": lambda _: Root(),
    "quadratic": lambda _: QuadraticFriction(),
    "offset": lambda _: Offset(),
    "spring": lambda _: Spring(),
}


def input_terms(
    robot: Manipulator, rigid: AbstractRigidBody | ProjectedTerm
) -> tuple[AbstractInputTerm, ...]:
    """The terms of the robot's friction model, in its order, then those of coupled joints, and
    last the friction that follows the torque of `rigid`, links and motors."""
    kinds = (kind for kind in robot.friction_terms if kind not in (LOAD, DIRECTIONAL_LOAD))
    joint_terms = [JointTerm.of(_LAWS[kind](robot), robot) for kind in kinds]
    return (*joint_terms, *CoupledTerm.all_of(robot), *LoadFriction.all_of(robot, rigid))
