"""A rigid body as ten numbers, its pseudo-inertia, and coefficients as linear forms in bodies.

A body can exist if and only if its pseudo-inertia is positive semidefinite (Wensing, Kim and
Slotine 2018).
"""

from collections.abc import Iterator, Sequence

import numpy as np
from jaxtyping import Float

from ..derivation import BODY, Algebra, Coefficient, InertialTerm, constant_values
from ..manipulator import TENSOR_ENTRIES, LinkInertia, LinkParameters


_ENTRY = {name: index for index, name in enumerate(BODY)}
# Of the ten numbers: products of inertia, first moments and mass, behind moments of inertia.
_PRODUCTS, MOMENT, MASS = slice(3, 6), slice(6, 9), 9
ENTRIES = 16
"""Entries of a pseudo-inertia, a matrix of 4 x 4."""

_AXES = "xyz"
_PAIRS = ((0, 1), (0, 2), (1, 2))
# The linear map exists for every network; this much of its largest entry is rounding.
_ROUNDING = 1e-9


def body_of(link: LinkParameters) -> Float[np.ndarray, "10"]:
    """Return the ten numbers of `BODY`: what a rigid body's dynamics are linear in."""
    tensor, moment = np.asarray(link.inertia_at_frame, float), np.asarray(link.first_moment, float)
    return np.array([*(tensor[entry] for entry in TENSOR_ENTRIES), *moment, float(link.mass)])


def link_of(body: Float[np.ndarray, "10"], motor_inertia: float = 0.0) -> LinkParameters:
    """Return the link of a body of positive mass: the inverse of `body_of`."""
    mass, centre = float(body[MASS]), body[MOMENT] / body[MASS]
    tensor = central_tensor(body)
    return LinkParameters(mass, centre, (tensor + tensor.T) / 2, motor_inertia)


def central_tensor(body: Float[np.ndarray, "10"]) -> Float[np.ndarray, "3 3"]:
    """Inertia tensor at the centre of gravity, of a body of positive mass."""
    tensor = np.diag(body[:3])
    for value, (a, b) in zip(body[_PRODUCTS], _PAIRS, strict=True):
        tensor[a, b] = tensor[b, a] = value
    moment = body[MOMENT]
    return tensor - (moment @ moment * np.eye(3) - np.outer(moment, moment)) / body[MASS]


def pseudo_inertia(body: Float[np.ndarray, "10"]) -> Float[np.ndarray, "4 4"]:
    """Return the 4 x 4 matrix ∫ (x, 1)(x, 1)ᵀ dm of a body (Wensing, Kim and Slotine 2018).

    A body can exist if and only if it is positive semidefinite: it holds the mass, the first
    moment and the spread of mass tr(I)/2 - I, all at once.
    """
    matrix = np.zeros((4, 4))
    matrix[:3, :3] = np.diag(np.sum(body[:3]) / 2 - body[:3])
    for value, (a, b) in zip(body[_PRODUCTS], _PAIRS, strict=True):
        matrix[a, b] = matrix[b, a] = -value
    matrix[:3, 3] = matrix[3, :3] = body[MOMENT]
    matrix[3, 3] = body[MASS]
    return matrix


def body_of_pseudo_inertia(matrix: Float[np.ndarray, "4 4"]) -> Float[np.ndarray, "10"]:
    """Return the inverse of `pseudo_inertia`; linear."""
    spread = np.diag(matrix)[:3]
    off = [-matrix[a, b] for a, b in _PAIRS]
    return np.array([*(np.sum(spread) - spread), *off, *matrix[:3, 3], matrix[3, 3]])


def principal_body(
    mass: float, centre: Float[np.ndarray, "3"], spread: Float[np.ndarray, "3"]
) -> Float[np.ndarray, "10"]:
    """The body with principal axes along the frame's, its mass spread by ∫ x² dm along each."""
    matrix = np.zeros((4, 4))
    matrix[:3, :3] = np.diag(spread) + mass * np.outer(centre, centre)
    matrix[:3, 3] = matrix[3, :3] = mass * centre
    matrix[3, 3] = mass
    return body_of_pseudo_inertia(matrix)


def body_map(
    algebra: Algebra,
) -> tuple[Float[np.ndarray, "inertial links 10"], Float[np.ndarray, "inertial links"]]:
    """Inertial coefficients as linear forms in the links' bodies and motor inertias.

    The torque sees a link through its ten numbers alone, so every coefficient is a linear form
    in them, also where links have principal axes and the algebra's own terms are products such
    as m rx ry.

    **Returns**

    - What multiplies each body's ten numbers.
    - What multiplies each motor's inertia.

    **Raises** `ValueError` for masses and centres of gravity that are numbers in the algebra.
    """
    if any(inertia.has_known for inertia in algebra.robot.inertia):
        raise ValueError(
            f"bodies of {algebra.robot.name!r}: masses or centres of gravity are fixed by"
            " `with_known`; expected a robot without it, and what is known as a prior"
        )
    n = algebra.robot.joint_count
    constants = constant_values(algebra.robot) if algebra.lengths != "numeric" else {}
    columns = [
        {term: i for i, term in enumerate(t for t in algebra.terms if t.link == link and t.body)}
        for link in range(n)
    ]
    body_entries = [np.zeros((10, len(terms))) for terms in columns]
    for terms, matrix in zip(columns, body_entries, strict=True):
        for term, column in terms.items():
            for entry, multiple in term.body:
                matrix[_ENTRY[entry], column] += multiple
    bodies = np.zeros((len(algebra.coefficients), n, 10))
    motors = np.zeros((len(algebra.coefficients), n))
    for row, coefficient in enumerate(algebra.coefficients):
        forms = [np.zeros(len(terms)) for terms in columns]
        for term, factor in _factors(coefficient, constants):
            if term.factors == ("motor",):
                motors[row, term.link] += factor
            else:
                forms[term.link][columns[term.link][term]] += factor
        for link, (matrix, form) in enumerate(zip(body_entries, forms, strict=True)):
            if not form.any():
                continue
            entries = np.linalg.lstsq(matrix.T, form)[0]
            entries[np.abs(entries) < _ROUNDING * np.max(np.abs(entries))] = 0.0
            if np.max(np.abs(matrix.T @ entries - form)) > _ROUNDING * np.max(np.abs(form)):
                raise ValueError(
                    f"{coefficient.name}: {coefficient.expression} is no linear form in bodies"
                )
            bodies[row, link] = entries
    return bodies, motors


def _factors(
    coefficient: Coefficient, constants: dict[str, float]
) -> Iterator[tuple[InertialTerm, float]]:
    for addend in coefficient.addends:
        factor = float(addend.factor)
        for name, power in addend.constants:
            factor *= constants[name] ** power
        yield addend.term, factor


def constraints_of(inertia: LinkInertia) -> Float[np.ndarray, "constraints 10"]:
    """Return the equations `rows @ body = 0` that a link's `LinkInertia` states for its body.

    For a full tensor: products of inertia and coordinates of the centre that are zero, moments
    that are equal. A moment or a mass that is listed as zero is no equation: no body has it, and
    it is listed because the torque does not depend on it.
    """
    unit = np.eye(10)
    rows = [unit[_ENTRY[f"h{axis}"]] for axis in _AXES if f"r{axis}" in inertia.zero]
    rows += [unit[_ENTRY[product]] for product in ("Ixy", "Ixz", "Iyz") if product in inertia.zero]
    rows += [unit[_ENTRY[first]] - unit[_ENTRY[second]] for first, second in inertia.equal]
    return np.array(rows).reshape(-1, 10)


def bodies_of(links: Sequence[LinkParameters]) -> Float[np.ndarray, "links 10"]:
    """Return `body_of` of each link."""
    return np.stack([body_of(link) for link in links])


def constrained(inertia: LinkInertia, link: LinkParameters) -> LinkParameters:
    """A link with exactly the zeros of its `LinkInertia`, which it has except for rounding."""
    zero = [f"r{axis}" in inertia.zero for axis in _AXES]
    centre, tensor = np.where(zero, 0.0, link.centre_of_gravity), np.asarray(link.inertia)
    if inertia.form == "principal":
        tensor = np.diag(np.diag(tensor))
    return LinkParameters(link.mass, centre, tensor, link.motor_inertia)
