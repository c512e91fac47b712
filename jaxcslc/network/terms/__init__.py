"""Terms of a network: rigid body, friction laws, springs, coupled joints, load friction, payload.

Every term is an `AbstractTerm`: it computes torque, regressor and columns of its own
coefficients.

- `_term`, `_input_term`, `_joint_term`: the classes from which terms derive.
- `_rigid_body_tables`, `_rigid_body_recursion`: links and motors, in closed form or by recursion.
- `_expressed_bodies`: the class of both; `_closed_form`, `_linked_bodies`: their expressions;
  `_rolled`: the recursion as scans of JAX.
- `_friction_laws`, `_coupled`, `_load_friction`: friction, offsets, springs.
- `_payload`: a body fixed to a link.
- `_joint_projection`: terms of robots with joints that follow others.
- `_input_expressions`: inputs of terms as expressions of generated code.
- `_registry`: the terms of a robot's friction model.
"""

from ._closed_form import ClosedForm as ClosedForm, nested as nested
from ._coupled import CoupledTerm as CoupledTerm
from ._expressed_bodies import (
    PARTS as PARTS,
    AbstractExpressedBodies as AbstractExpressedBodies,
    AbstractRigidBody as AbstractRigidBody,
    code as code,
)
from ._friction_laws import StaticFriction as StaticFriction
from ._input_expressions import (
    ExpressionFunctions as ExpressionFunctions,
    term_entries as term_entries,
)
from ._input_term import (
    JAX_FUNCTIONS as JAX_FUNCTIONS,
    AbstractFunctions as AbstractFunctions,
    AbstractInputTerm as AbstractInputTerm,
)
from ._joint_projection import JointProjection as JointProjection, ProjectedTerm as ProjectedTerm
from ._joint_term import (
    AbstractJointLaw as AbstractJointLaw,
    JointTerm as JointTerm,
    LawProperties as LawProperties,
)
from ._linked_bodies import RecursiveBodies as RecursiveBodies
from ._load_friction import (
    DIRECTIONAL_LOAD as DIRECTIONAL_LOAD,
    LOAD as LOAD,
    LoadedRigidBody as LoadedRigidBody,
    LoadFriction as LoadFriction,
)
from ._payload import PAYLOAD as PAYLOAD, carrier as carrier, payload_term as payload_term
from ._registry import input_terms as input_terms
from ._rigid_body_recursion import RigidBodyRecursion as RigidBodyRecursion
from ._rigid_body_tables import RigidBodyTables as RigidBodyTables, input_rows as input_rows
from ._term import (
    AbstractManipulatorTerm as AbstractManipulatorTerm,
    AbstractTerm as AbstractTerm,
    Coefficients as Coefficients,
    Columns as Columns,
    Joints as Joints,
    Matrices as Matrices,
    Regressor as Regressor,
    Rows as Rows,
)
