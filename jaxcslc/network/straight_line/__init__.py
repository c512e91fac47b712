from ._arrays import array_outputs as array_outputs
from ._closed_form import ClosedForm as ClosedForm, nested as nested
from ._compiled_program import CompiledProgram as CompiledProgram
from ._cuda import Kernel as Kernel, assembly as assembly, kernels_run as kernels_run
from ._derivative import derivatives as derivatives
from ._expressions import (
    Expressions as Expressions,
    Motion as Motion,
    Operation as Operation,
    Value as Value,
)
from ._kernel_text import KernelText as KernelText
from ._program import Program as Program
from ._recursion import newton_euler as newton_euler
from ._rigid_body import (
    LinkedBodies as LinkedBodies,
    StraightLine as StraightLine,
    columns_code as columns_code,
    mass_matrix_code as mass_matrix_code,
    named as named,
    regressor_rows as regressor_rows,
    torque_code as torque_code,
)
from ._sines_text import SINES_TEXT as SINES_TEXT
from ._traced import traced as traced
