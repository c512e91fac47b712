"""Generated code: a graph of expressions, and what computes its values.

```
 functions of JAX ──traced──► Expressions ──► array_outputs     arrays of NumPy's or JAX's
 dynamics, laws ────────────►  (Value)    ──► Program           blocks of NumPy's arrays
                                          ──► CompiledProgram   the same by C, once it is compiled
                                          ──► KernelText        statements of C and CUDA C
                                                                  └─► CFunction, Kernel
```

It knows nothing of robots, and imports no other package of the project.
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
from ._compilation import by_platform as by_platform, in_blocks as in_blocks, in_stage as in_stage
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
