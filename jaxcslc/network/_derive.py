"""Entry of the package: `derive`, which builds the network of a robot.

It chooses the lengths that stay symbols, and the evaluator of the rigid body.
"""

from collections.abc import Sequence
from typing import Literal, cast

from ..derivation import Algebra, Lengths, derive_algebra
from ..manipulator import Manipulator, RobotError
from ._cslc import CSLC, input_terms
from .terms import (
    AbstractRigidBody,
    JointProjection,
    ProjectedTerm,
    RigidBodyRecursion,
    RigidBodyTables,
)


# Up to this many links straight-line code compiles in a few seconds and outruns the recursion.
_LARGEST_TABLES = 1500
# Beyond this many independent angles tables are large whatever the twists: not worth deriving
# them to find out. (A Panda, 7 angles: 27,243 velocity links.)
_MOST_ANGLES = 6
# Base parameters of 20 joints take 4 s, of 30 joints half a minute, and the time grows with the
# fourth power.
_MOST_JOINTS = 40


def derive(
    robot: Manipulator,
    *,
    lengths: Literal["symbolic", "numeric", "auto"] | Sequence[str] = "auto",
    evaluator: Literal["auto", "tables", "recursive", "rolled", "unrolled"] = "auto",
) -> CSLC:
    """Derive a robot's inverse dynamics and build the network that computes them.

    Of a robot some of whose joints follow others (`load_robot(mimic="couple")`), motion and torque
    are those of the `robot.independent_joints`.

    **Arguments**

    - `robot`: from `load_robot`, `puma560`, `panda` or `Manipulator.from_modified_dh`.
    - `lengths`: `"symbolic"`: the thesis's coefficients, valid whatever the lengths are.
      `"numeric"`: the base parameters, the fewest coefficients that describe the torque; use it
      for identification unless the lengths themselves are in doubt, and for any robot of more
      than 6 joints. A list of names keeps these lengths as symbols and puts the others' values
      in, mass and gravity coefficients apart (thesis 8.2.1). `"auto"`: symbolic for robots of up
      to 6 joints, numeric for others and for those from URDF and MJCF files.
    - `evaluator`: `"tables"`: straight-line code from the closed form; `"recursive"`:
      Newton-Euler, numeric lengths only, `"rolled"` as a loop over links or `"unrolled"` as
      straight-line code, whichever was measured to be quicker (see `RigidBodyRecursion`);
      `"auto"`: tables where they are small.

    **Raises**

    - `RobotError`: if a length that is to be a number has no value, a name is no length, or
      there are more than 40 joints.
    - `ValueError`: if `lengths` or `evaluator` is none of these, or for a recursive evaluator
      with symbolic lengths.

    >>> import jaxcslc as jc
    >>> jc.derive(jc.puma560())
    CSLC(PUMA 560: 6 joints, 43 coefficients: 26 mass, 5 gravity, 6 viscous, 6 dry; RigidBodyTables)
    """
    if robot.joint_count > _MOST_JOINTS:
        raise RobotError(
            f"robot {robot.name!r} has {robot.joint_count} joints; expected at most"
            f" {_MOST_JOINTS}: derivation takes minutes beyond. A part of a file is chosen by base"
            " and tip"
        )
    if lengths == "auto":
        lengths = "numeric" if _has_many_lengths(robot) else "symbolic"
    if isinstance(lengths, str) and lengths not in ("symbolic", "numeric"):
        raise ValueError(
            f"lengths must be 'symbolic', 'numeric', 'auto' or a list of names, got {lengths!r}"
        )
    symbols = lengths if isinstance(lengths, str) else tuple(lengths)
    algebra = derive_algebra(robot, cast(Lengths, symbols))
    rigid = ProjectedTerm.of(_rigid_body(algebra, evaluator), JointProjection.of(robot))
    return CSLC(algebra=algebra, terms=(rigid, *input_terms(robot, rigid)))


def _has_many_lengths(robot: Manipulator) -> bool:
    """Return whether a robot has too many lengths to keep as symbols.

    Files of CAD models give every axis an arbitrary offset, and each would be a symbol.
    """
    from_cad = robot.source is not None and robot.source.format != "toml"
    return from_cad or robot.joint_count > 6


def _rigid_body(algebra: Algebra, choice: str) -> AbstractRigidBody:
    if choice == "tables" or (choice == "auto" and _tables_are_small(algebra)):
        return RigidBodyTables.from_algebra(algebra)
    forms = {"auto": None, "recursive": None, "rolled": False, "unrolled": True}
    if choice in forms:
        return RigidBodyRecursion.from_algebra(algebra, forms[choice])
    raise ValueError(
        f"evaluator must be 'auto', 'tables', 'recursive', 'rolled' or 'unrolled', got {choice!r}"
    )


def _tables_are_small(algebra: Algebra) -> bool:
    if algebra.lengths != "numeric":
        return True
    right_angles = all(0 in link.twist for link in algebra.chain.links)
    if len(algebra.chain.angles) > (_MOST_ANGLES if right_angles else 3):
        return False
    return len(algebra.mass.links) + len(algebra.velocity.links) <= _LARGEST_TABLES
