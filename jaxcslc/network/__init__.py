"""The CSLC: inverse dynamics as a sum of terms, each linear in coefficients of its own.

`derive` takes a robot and gives a `CSLC`. Its `torque`, `regressor` and `mass_matrix` are pure
functions of JAX; `columns` also computes NumPy's arrays without compilation.

     Manipulator --> derivation --> Algebra --> terms --> CSLC
                                                            |
     k, q, qd, qdd  ------------------------------------>  torque = regressor @ k

Modules, in reading order:

- `_linear_network`: what any network that is linear in its coefficients offers.
- `_cslc`: the network of one robot: M, V, G, friction, and its variants (payload, other laws);
  `derive`, which chooses lengths and evaluator.
- `_layout`: which entries of `k` belong to which term, and their values for known links.
- `terms`: rigid body, friction, springs, coupled joints, payload.
"""

from ._cslc import CSLC as CSLC, derive as derive
from ._layout import Layout as Layout
from ._linear_network import AbstractLinearNetwork as AbstractLinearNetwork
from .terms import (
    DIRECTIONAL_LOAD as DIRECTIONAL_LOAD,
    JAX_FUNCTIONS as JAX_FUNCTIONS,
    JOINT_LAWS as JOINT_LAWS,
    LOAD as LOAD,
    PARTS as PARTS,
    PAYLOAD as PAYLOAD,
    AbstractExpressedBodies as AbstractExpressedBodies,
    AbstractFunctions as AbstractFunctions,
    AbstractInputTerm as AbstractInputTerm,
    AbstractManipulatorTerm as AbstractManipulatorTerm,
    AbstractTerm as AbstractTerm,
    ClosedForm as ClosedForm,
    Coefficients as Coefficients,
    Columns as Columns,
    CoupledTerm as CoupledTerm,
    ExpressionFunctions as ExpressionFunctions,
    JointLaw as JointLaw,
    JointProjection as JointProjection,
    Joints as Joints,
    JointTerm as JointTerm,
    LawProperties as LawProperties,
    LoadedRigidBody as LoadedRigidBody,
    Matrices as Matrices,
    ProjectedTerm as ProjectedTerm,
    RecursiveBodies as RecursiveBodies,
    Regressor as Regressor,
    RigidBodyRecursion as RigidBodyRecursion,
    RigidBodyTables as RigidBodyTables,
    Rows as Rows,
    carrier as carrier,
    code as code,
    content_hash as content_hash,
    input_rows as input_rows,
    nested as nested,
    newton_euler as newton_euler,
)


__all__ = [
    "CSLC",
    "JAX_FUNCTIONS",
    "JOINT_LAWS",
    "PAYLOAD",
    "AbstractFunctions",
    "AbstractInputTerm",
    "AbstractLinearNetwork",
    "AbstractManipulatorTerm",
    "AbstractTerm",
    "JointLaw",
    "JointTerm",
    "LawProperties",
    "Layout",
    "RigidBodyRecursion",
    "RigidBodyTables",
    "carrier",
    "derive",
    "input_rows",
]
