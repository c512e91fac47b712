from ._prior import (
    Known as Known,
    Prior as Prior,
    load_prior as load_prior,
    prior_from as prior_from,
)
from ._update import information_rows as information_rows, with_knowledge as with_knowledge
