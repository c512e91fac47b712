from ._bodies import (
    bodies_of as bodies_of,
    body_map as body_map,
    body_of as body_of,
    body_of_pseudo_inertia as body_of_pseudo_inertia,
    constrained as constrained,
    link_of as link_of,
    pseudo_inertia as pseudo_inertia,
)
from ._coefficient_metric import Fitted as Fitted, whitening as whitening
from ._link_knowledge import (
    KNOWN_PARAMETERS as KNOWN_PARAMETERS,
    Known as Known,
    LinkKnowledge as LinkKnowledge,
)
from ._nearest_bodies import (
    WEAK as WEAK,
    NearestBodies as NearestBodies,
    Optimum as Optimum,
)
from ._nearest_body import nearest_body as nearest_body
from ._prior_bodies import balls as balls, prior_of as prior_of
from ._prior_weight import by_discrepancy as by_discrepancy
