from ._bodies import (
    bodies_of as bodies_of,
    body_map as body_map,
    body_of as body_of,
    constrained as constrained,
    link_of as link_of,
    pseudo_inertia as pseudo_inertia,
)
from ._coefficient_metric import Fitted as Fitted
from ._nearest_bodies import NearestBodies as NearestBodies, Optimum as Optimum
from ._nearest_body import nearest_body as nearest_body
