import numpy as np
from jaxtyping import Float

from ...network import CSLC
from ..solver import Identification
from ..systematic import SystematicError, standard_uncertainty
from ._physical_parameters import PhysicalParameters


# A coefficient that moves by more combined standard errors is warned of: one in sixteen thousand
# normal errors does.
_FAR = 4.0
# A mass that is this many times the file's, or this part of it, is not the link's own.
_OTHER_MASS = 2.0
# Coefficients that a warning names of each body.
_MOST_NAMES = 3


def movement_of(
    fit: Identification, parameters: PhysicalParameters, systematic: SystematicError | None
) -> Float[np.ndarray, " coefficients"]:
    """How far each coefficient moves, in standard errors, systematic ones included; zero where the
    motion does not determine it."""
    error = standard_uncertainty(fit, systematic)
    change = parameters.k - np.asarray(fit.k)
    known = np.isfinite(error) & (error > 0.0)
    return np.where(known, change / np.where(known, error, 1.0), 0.0)


def moved_bodies(
    network: CSLC,
    fit: Identification,
    parameters: PhysicalParameters,
    systematic: SystematicError | None = None,
    *,
    motors: bool = True,
) -> tuple[str, ...]:
    """A sentence about bodies whose coefficients are those of no body, and what to do; or none.

    - `systematic`: of the fit.
    - `motors`: whether motor inertia was allowed for.
    """
    movement = movement_of(fit, parameters, systematic)
    far: dict[int, list[int]] = {}
    for index, coefficient in enumerate(network.algebra.coefficients):
        if abs(movement[index]) > _FAR:
            # Base parameters are named after the first link; later ones are what it carries.
            link = min(addend.term.link for addend in coefficient.addends)
            far.setdefault(link, []).append(index)
    if not far:
        return ()
    bodies: list[str] = []
    for link, indices in sorted(far.items()):
        indices.sort(key=lambda i: -abs(movement[i]))
        names = ", ".join(network.names[i] for i in indices[:_MOST_NAMES])
        more = "" if len(indices) <= _MOST_NAMES else f" and {len(indices) - _MOST_NAMES} more"
        name = parameters.body_names[link]
        name = f"link {name}" if name.isdigit() else name
        bodies.append(f"{name} by {abs(movement[indices[0]]):.3g} standard errors ({names}{more})")
    without_motor = [
        name
        for name, inertia in zip(network.robot.joint_names, network.robot.inertia, strict=True)
        if not (motors and inertia.motor)
    ]
    remedies = [
        "record motion that excites these links more",
        "say what is known of them with --prior",
        "add the friction terms that the residuals show",
    ]
    if without_motor:
        remedies.insert(0, f"let {', '.join(without_motor)} have a motor inertia")
    return (
        "possible bodies: to be possible, these move from the fit further than its errors explain:"
        f" {'; '.join(bodies)}. Identified coefficients are those of no body:"
        f" {', '.join(remedies)}",
    )


def other_masses(network: CSLC, parameters: PhysicalParameters) -> tuple[str, ...]:
    """A sentence about masses that make up for each other far from the file's, or none.

    Written into a robot's file they surprise: the torque that they give is right, but they are not
    those of the links.
    """
    links = network.robot.links
    if links is None:
        return ()
    texts: list[str] = []
    for name, link, file in zip(parameters.body_names, parameters.links, links, strict=True):
        mass, expected = float(link.mass), float(file.mass)
        if expected > 0.0 and not expected / _OTHER_MASS < mass < expected * _OTHER_MASS:
            named = f"link {name}" if name.isdigit() else name
            texts.append(f"{named} {mass:.3g} kg in place of {expected:.3g}")
    if not texts:
        return ()
    return (
        f"possible bodies: masses far from the robot's file: {', '.join(texts)}. They give the"
        " identified torques, but motion of the joints tells combinations of masses, centres and"
        " motor inertias only: say what is known of them with --prior (motor inertias first,"
        " where the file has none)",
    )
