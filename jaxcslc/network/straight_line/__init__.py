from ._closed_form import ClosedForm as ClosedForm, nested as nested
from ._expressions import (
    Expressions as Expressions,
    Motion as Motion,
    Operation as Operation,
    Value as Value,
)
from ._program import Program as Program
from ._recursion import newton_euler as newton_euler
