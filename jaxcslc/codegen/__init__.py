"""Generated code: one graph of expressions, and back ends for NumPy, JAX, C and CUDA.

    JAX function ──► _traced ──┐
    dynamics, laws ────────────┴──► _expressions ──┬──► _arrays       arrays of NumPy or JAX
                                                   ├──► _programs     blocks of NumPy arrays, or C
                                                   └──► _c_text       statements of C and CUDA C
                                                          └──► _c_function

`_arrays` also says how JAX compiles: per platform, in blocks. The package knows nothing
of robots and imports no other package of the project.
"""

from ._arrays import (
    array_outputs as array_outputs,
    by_platform as by_platform,
    in_blocks as in_blocks,
    motion_outputs as motion_outputs,
    named as named,
)
from ._c_function import (
    BLOCK_OVERHEAD as BLOCK_OVERHEAD,
    INTEGERS as INTEGERS,
    LONG as LONG,
    SHARED_MEMORY as SHARED_MEMORY,
    CArray as CArray,
    CFunction as CFunction,
    CRows as CRows,
    Kernel as Kernel,
    assembly as assembly,
    kernels_run as kernels_run,
    multiprocessors as multiprocessors,
)
from ._c_text import (
    LANES_TEXT as LANES_TEXT,
    SINES_TEXT as SINES_TEXT,
    KernelText as KernelText,
    block_row as block_row,
    block_text as block_text,
    called_functions as called_functions,
    comment_text as comment_text,
    identifier as identifier,
    is_identifier as is_identifier,
)
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
