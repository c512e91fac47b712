"""The rigid-body term: from tables of the closed form, and by Newton and Euler's recursion."""

from ._closed_form import ClosedForm as ClosedForm, nested as nested
from ._expressed_bodies import (
    PARTS as PARTS,
    AbstractExpressedBodies as AbstractExpressedBodies,
    AbstractRigidBody as AbstractRigidBody,
    code as code,
)
from ._linked_bodies import RecursiveBodies as RecursiveBodies
from ._rigid_body_recursion import RigidBodyRecursion as RigidBodyRecursion
from ._rigid_body_tables import RigidBodyTables as RigidBodyTables, input_rows as input_rows
from ._rolled import paths_of as paths_of
