from ._cslc import CSLC as CSLC
from ._derive import derive as derive
from ._layout import Layout as Layout
from ._linear_network import AbstractLinearNetwork as AbstractLinearNetwork
from ._term_sum import AbstractTermSum as AbstractTermSum
from .terms import (
    JAX_FUNCTIONS as JAX_FUNCTIONS,
    PAYLOAD as PAYLOAD,
    AbstractFunctions as AbstractFunctions,
    AbstractInputTerm as AbstractInputTerm,
    AbstractJointLaw as AbstractJointLaw,
    AbstractManipulatorTerm as AbstractManipulatorTerm,
    AbstractTerm as AbstractTerm,
    JointTerm as JointTerm,
    LawProperties as LawProperties,
    RigidBodyRecursion as RigidBodyRecursion,
    RigidBodyTables as RigidBodyTables,
    StaticFriction as StaticFriction,
    carrier as carrier,
    input_rows as input_rows,
)
