"""Generated code: one graph of expressions, evaluated by NumPy, JAX, C or CUDA.

    arithmetic ──► _expressions ──┬──► _program (NumPy) ──► _compiled_program (C, once compiled)
    JAX function ──► _traced ─────┤──► _arrays (NumPy, JAX)
                                  └──► _kernel_text ──► _c_library (C), _cuda (NVIDIA GPU)

`_derivative` adds derivatives to a graph, `_sines_text` is C text of sines and cosines, and
`_compilation` splits compiled functions.
"""

from ._arrays import (
    array_outputs as array_outputs,
    motion_outputs as motion_outputs,
    named as named,
)
from ._c_function import (
    INTEGERS as INTEGERS,
    LONG as LONG,
    CArray as CArray,
    CFunction as CFunction,
    CRows as CRows,
)
from ._c_text import (
    LANES_TEXT as LANES_TEXT,
    SINES_TEXT as SINES_TEXT,
    KernelText as KernelText,
    block_row as block_row,
    block_text as block_text,
    called_functions as called_functions,
)
from ._compilation import by_platform as by_platform, in_blocks as in_blocks
from ._cuda import Kernel as Kernel, assembly as assembly, kernels_run as kernels_run
from ._expressions import (
    Expressions as Expressions,
    Motion as Motion,
    Operation as Operation,
    StraightLine as StraightLine,
    Value as Value,
    derivatives as derivatives,
)
from ._programs import CompiledProgram as CompiledProgram, Program as Program
from ._traced import traced as traced
