"""Generated code: compiled functions of C, kept in a folder of the user's own."""

from ._c_function import (
    INTEGERS as INTEGERS,
    LONG as LONG,
    CArray as CArray,
    CFunction as CFunction,
    CRows as CRows,
)
