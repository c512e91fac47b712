"""Physically consistent bodies: possible link parameters, nearest to identified coefficients.

Input is a fit (coefficients with their covariance), and knowledge of the robot: its file, or a
`Prior`. Output is masses, centres of gravity and inertia tensors, and the coefficients that these
imply. The physically consistent bodies solve a semidefinite programme (Sousa and Cortesão 2014).

     fit, prior, knowledge --> NearestBodies --> bodies --> PhysicalParameters --> PossibleFit
                               (programme)                  (link parameters)      (judged)

Modules, in reading order:

- `_body`: ten numbers, pseudo-inertia, and coefficients as forms in them.
- `_prior`: values, errors and bounds of coefficients and link parameters.
- `_nearest_bodies`: semidefinite least squares, of one body and of all links.
- `_principal_programme`: search for links with principal axes.
- `_physical_parameters`: link parameters of a fit.
- `_misfit`: how far errors of a fit and of its prior exceed what they say.
- `_file_prior`: the robot's file as prior of coefficients, and its weight.
- `_possible_fit`: consistent bodies compared with the unconstrained fit on held-out data.
"""

from ._body import (
    bodies_of as bodies_of,
    body_map as body_map,
    body_of as body_of,
    body_of_pseudo_inertia as body_of_pseudo_inertia,
    link_of as link_of,
    pseudo_inertia as pseudo_inertia,
)
from ._file_prior import (
    DECIDED as DECIDED,
    ChosenPrior as ChosenPrior,
    FilePrior as FilePrior,
    FileWeight as FileWeight,
    chosen_prior as chosen_prior,
)
from ._misfit import Misfit as Misfit, misfit_of as misfit_of
from ._nearest_bodies import (
    balls as balls,
    nearest_body as nearest_body,
    prior_of as prior_of,
)
from ._physical_parameters import (
    POSSIBILITY as POSSIBILITY,
    PhysicalParameters as PhysicalParameters,
    file_bodies as file_bodies,
    fixed_bodies as fixed_bodies,
    in_file_frames as in_file_frames,
    physical_parameters as physical_parameters,
    possible_coefficients as possible_coefficients,
)
from ._possible_fit import (
    Choice as Choice,
    InformedFit as InformedFit,
    JudgedPart as JudgedPart,
    PossibleFit as PossibleFit,
    held_out_of_parts as held_out_of_parts,
    judged_bodies as judged_bodies,
    moved_bodies as moved_bodies,
    other_masses as other_masses,
    possible_fit as possible_fit,
    possible_text as possible_text,
)
from ._prior import (
    Fitted as Fitted,
    Known as Known,
    LinkKnowledge as LinkKnowledge,
    Prior as Prior,
    information_rows as information_rows,
    load_prior as load_prior,
    prior_from as prior_from,
    with_knowledge as with_knowledge,
)


__all__ = [
    "POSSIBILITY",
    "FilePrior",
    "FileWeight",
    "Fitted",
    "Known",
    "LinkKnowledge",
    "PhysicalParameters",
    "PossibleFit",
    "Prior",
    "balls",
    "bodies_of",
    "body_map",
    "body_of",
    "body_of_pseudo_inertia",
    "link_of",
    "load_prior",
    "nearest_body",
    "physical_parameters",
    "prior_of",
    "pseudo_inertia",
]
