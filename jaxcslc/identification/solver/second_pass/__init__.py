from ._rows import (
    AbstractRows as AbstractRows,
    CosineSums as CosineSums,
    KeptRows as KeptRows,
    PatternRows as PatternRows,
)
