from ._coupled import CoupledTerm as CoupledTerm
from ._input_expressions import (
    ExpressionFunctions as ExpressionFunctions,
    term_entries as term_entries,
)
from ._input_term import (
    HOST_FUNCTIONS as HOST_FUNCTIONS,
    JAX_FUNCTIONS as JAX_FUNCTIONS,
    AbstractFunctions as AbstractFunctions,
    AbstractInputTerm as AbstractInputTerm,
)
from ._joint_projection import (
    JointProjection as JointProjection,
    ProjectedTerm as ProjectedTerm,
)
from ._joint_term import (
    AbstractJointLaw as AbstractJointLaw,
    JointTerm as JointTerm,
    LawProperties as LawProperties,
)
from ._load_friction import (
    DIRECTIONAL_LOAD as DIRECTIONAL_LOAD,
    LOAD as LOAD,
    LoadedRigidBody as LoadedRigidBody,
    LoadFriction as LoadFriction,
)
from ._payload import PAYLOAD as PAYLOAD, carrier as carrier, payload_term as payload_term
from ._registry import input_terms as input_terms
from ._static_friction import StaticFriction as StaticFriction
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
from .rigid_body import (
    AbstractRigidBody as AbstractRigidBody,
    RigidBodyRecursion as RigidBodyRecursion,
    RigidBodyTables as RigidBodyTables,
    input_rows as input_rows,
)
