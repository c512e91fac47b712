"""Terms of a network: rigid body, friction laws, springs, coupled joints, load friction, payload.

Every term is an `AbstractTerm`: it computes torque, regressor and columns of its own
coefficients.

- `_term`, `_input_term`: the classes from which terms derive, and functions of their inputs.
- `_joint_term`: the table of laws of single joints, and terms of one joint or of two that share a
  shaft; `_load_friction`: friction with the rigid torque.
- `_rigid_body`: links and motors in any form; `_rigid_body_tables`: in closed form;
  `_rigid_body_recursion`: by recursion, unrolled or as `_rolled` scans of JAX.
- `_joint_projection`: terms of robots with joints that follow others.
"""

from ._input_term import (
    JAX_FUNCTIONS as JAX_FUNCTIONS,
    AbstractFunctions as AbstractFunctions,
    AbstractInputTerm as AbstractInputTerm,
    ExpressionFunctions as ExpressionFunctions,
)
from ._joint_projection import JointProjection as JointProjection, ProjectedTerm as ProjectedTerm
from ._joint_term import (
    DIRECTIONAL_LOAD as DIRECTIONAL_LOAD,
    JOINT_LAWS as JOINT_LAWS,
    LOAD as LOAD,
    CoupledTerm as CoupledTerm,
    JointLaw as JointLaw,
    JointTerm as JointTerm,
    LawProperties as LawProperties,
)
from ._load_friction import LoadedRigidBody as LoadedRigidBody, LoadFriction as LoadFriction
from ._rigid_body import (
    PARTS as PARTS,
    AbstractExpressedBodies as AbstractExpressedBodies,
    AbstractRigidBody as AbstractRigidBody,
    code as code,
)
from ._rigid_body_recursion import (
    PAYLOAD as PAYLOAD,
    RecursiveBodies as RecursiveBodies,
    RigidBodyRecursion as RigidBodyRecursion,
    carrier as carrier,
    newton_euler as newton_euler,
    payload_term as payload_term,
)
from ._rigid_body_tables import (
    ClosedForm as ClosedForm,
    RigidBodyTables as RigidBodyTables,
    input_rows as input_rows,
    nested as nested,
)
from ._term import (
    AbstractManipulatorTerm as AbstractManipulatorTerm,
    AbstractTerm as AbstractTerm,
    Coefficients as Coefficients,
    Columns as Columns,
    Joints as Joints,
    Matrices as Matrices,
    Regressor as Regressor,
    Rows as Rows,
    content_hash as content_hash,
)
