"""Echo paths of surfaces, edges and points: geometrical acoustics and diffraction.

Points have the axis "3" last and are in the sonar's frame. Every function gives one path to each
receiver for a batch of objects, or, for `scattered`, one a scatterer.
"""

import math

import numpy as np
from jaxtyping import Complex, Float
from scipy.special import modfresnelm

from sim.ultrasound._sonar import EchoPaths, Sonar


# Steps of the search for a curved surface's point of reflection: of the objects used here, two
# leave errors of 1e-8 and four those of rounding.
_STEPS = 6


def _norm(vector: Float[np.ndarray, "*batch 3"]) -> Float[np.ndarray, "*batch"]:
    return np.sqrt(np.sum(vector**2, axis=-1))


def _ahead(vector: Float[np.ndarray, "*batch 3"]) -> Float[np.ndarray, "*batch"]:
    """Cosine of the angle between a direction and the sonar's axis."""
    return vector[..., 0] / _norm(vector)


def _one(
    length: Float[np.ndarray, "patterns 2"],
    gain: Complex[np.ndarray, "patterns 2"],
    departure: Float[np.ndarray, "patterns 2"],
    arrival: Float[np.ndarray, "patterns 2"],
) -> EchoPaths:
    return EchoPaths(length[:, None], gain[:, None], departure[:, None], arrival[:, None])


def mirrored(
    sonar: Sonar,
    emitter: Float[np.ndarray, "patterns 3"],
    receivers: Float[np.ndarray, "patterns 2 3"],
    reflection: Float[np.ndarray, " patterns"],
) -> EchoPaths:
    """Reflection by one or more planes, by the emitter's image and the receivers' images in them.

    An image radiates as the emitter does: pressure falls as 1/length. `reflection` is the product
    of the planes' pressure reflection coefficients; zero where there is no reflection.
    """
    back = emitter[:, None] - sonar.receivers
    length = _norm(back)
    gain = (reflection[:, None] / length).astype(np.complex128)
    return _one(length, gain, _ahead(receivers), _ahead(back))


def plane(
    sonar: Sonar,
    foot: Float[np.ndarray, "patterns 3"],
    reflection: Float[np.ndarray, " patterns"],
) -> EchoPaths:
    """Reflection by a plane whose point nearest to the emitter is `foot`."""
    normal = foot / _norm(foot)[:, None]
    # Distance of each receiver before the plane.
    before = _norm(foot)[:, None] - np.einsum("rc,pc->pr", sonar.receivers, normal)
    images = sonar.receivers + 2 * before[..., None] * normal[:, None]
    return mirrored(sonar, 2 * foot, images, reflection)


def vertical_corner(
    sonar: Sonar,
    corner: Float[np.ndarray, "patterns 3"],
    reflection: Float[np.ndarray, " patterns"],
) -> EchoPaths:
    """Reflection by both faces of a vertical right-angled corner one after the other.

    The image in both is the point opposite about the corner's line, for any orientation.
    """
    return mirrored(sonar, 2 * corner, 2 * corner[:, None] - sonar.receivers, reflection**2)


def curved(
    sonar: Sonar,
    centre: Float[np.ndarray, "patterns 3"],
    radius: Float[np.ndarray, " patterns"],
    reflection: Float[np.ndarray, " patterns"],
    *,
    sphere: bool = False,
) -> EchoPaths:
    """Reflection by a vertical cylinder or a sphere, by geometrical acoustics.

    The reflected wave has two radii of curvature at the surface, 1/ρ = 1/s + 2/(a cos θ) in the
    plane of incidence and 1/ρ = 1/s + 2 cos θ/a across it, where s is the distance from the
    emitter, a the surface's radius there and θ the angle of incidence; a cylinder is flat across.
    Pressure falls as sqrt(ρ₁ρ₂ / ((ρ₁ + s')(ρ₂ + s'))). Holds from about three
    wavelengths of circumference up (wavenumber × radius > 3). A cylinder's centre has the sonar's
    height.
    """
    receivers = np.broadcast_to(sonar.receivers, (len(centre), 2, 3))
    middle = centre[:, None]
    normal = -middle / _norm(middle)[..., None] + np.zeros_like(receivers)
    point = middle + radius[:, None, None] * normal
    for _ in range(_STEPS):
        there, back = -point, receivers - point
        s, s_back = _norm(there)[..., None], _norm(back)[..., None]
        bisector = there / s + back / s_back
        wanted = bisector / _norm(bisector)[..., None]
        # Turning the normal moves the point, which turns the bisector the other way by so much:
        swing = 0.5 * radius[:, None, None] * (1 / s + 1 / s_back)
        turned = normal + (wanted - normal) / (1 + swing)
        normal = turned / _norm(turned)[..., None]
        point = middle + radius[:, None, None] * normal
    there, back = -point, receivers - point
    s, s_back = _norm(there), _norm(back)
    slant = np.sum(there * normal, axis=-1) / s
    along = 1 / (1 / s + 2 / (radius[:, None] * slant))
    across = 1 / (1 / s + 2 * slant / radius[:, None]) if sphere else s
    gain = reflection[:, None] / s * np.sqrt(along * across / (along + s_back) / (across + s_back))
    return _one(s + s_back, gain.astype(np.complex128), _ahead(point), _ahead(-back))


def edge(
    sonar: Sonar,
    at: Float[np.ndarray, "patterns 3"],
    along: Float[np.ndarray, "patterns 3"],
    face: Float[np.ndarray, "patterns 3"],
    normal: Float[np.ndarray, "patterns 3"],
    reflection: Float[np.ndarray, " patterns"],
    *,
    exterior: float,
) -> EchoPaths:
    """Diffraction by a straight edge between two plane faces, by the uniform theory.

    **Arguments**

    - `at`: any point of the edge [m]; `along`: its unit direction.
    - `face`: unit vector in one of the faces, off the edge and square to it; `normal`: that face's
      outward normal.
    - `exterior`: the angle of air about the edge [rad]: 3π/2 for the edge of a box, 2π for that of
      a thin board.
    """
    from_emitter = -at[:, None] + np.zeros((1, 2, 1))
    from_receiver = sonar.receivers - at[:, None]
    axis = along[:, None]

    def about(offset: Float[np.ndarray, "patterns 2 3"]):
        """Distance along the edge, off the edge, and angle from the face."""
        z = np.sum(offset * axis, axis=-1)
        square = offset - z[..., None] * axis
        up = np.sum(square * normal[:, None], axis=-1)
        out = np.sum(square * face[:, None], axis=-1)
        return z, _norm(square), np.arctan2(up, out) % (2 * math.pi)

    z, off, angle = about(from_emitter)
    z_back, off_back, angle_back = about(from_receiver)
    # Of all ways over the edge the shortest: the edge unfolded, a straight line.
    point = at[:, None] + (z + (z_back - z) * off / (off + off_back))[..., None] * axis
    back = sonar.receivers - point
    s, s_back = _norm(point), _norm(back)
    reach = s * s_back / (s + s_back)
    strength = diffraction(sonar.wavenumber, angle, angle_back, reach, exterior)
    gain = reflection[:, None] * strength / np.sqrt(s * s_back * (s + s_back))
    return _one(s + s_back, gain, _ahead(point), _ahead(-back))


def diffraction(
    wavenumber: float,
    incident: Float[np.ndarray, "*batch"],
    diffracted: Float[np.ndarray, "*batch"],
    reach: Float[np.ndarray, "*batch"],
    exterior: float,
) -> Complex[np.ndarray, "*batch"]:
    """Coefficient of a rigid edge [m^½], from Kouyoumjian & Pathak (1974), for a tone exp(iωt).

    Keller's coefficient, kept finite where a face's reflection begins or ends: there the diffracted
    wave is half the reflected one. Angles are from one face [rad], `reach` is s s'/(s + s') [m] and
    the edge is met squarely.
    """
    n = exterior / math.pi
    total = np.zeros(np.shape(incident), dtype=np.complex128)
    for beta in (diffracted - incident, diffracted + incident):
        for sign in (1, -1):
            half = (math.pi + sign * beta) / (2 * n)
            # Where the cotangent is infinite the transition is zero; their product has a limit.
            half = np.where(np.abs(np.sin(half)) < 1e-7, half + 1e-7, half)
            turns = np.round((beta + sign * math.pi) / (2 * math.pi * n))
            beyond = 2 * np.cos((2 * math.pi * n * turns - beta) / 2) ** 2
            total += _transition(wavenumber * reach * beyond) / np.tan(half)
    scale = 2 * n * math.sqrt(2 * math.pi * wavenumber)
    return -np.exp(-0.25j * math.pi) / scale * total


def _transition(x: Float[np.ndarray, "*batch"]) -> Complex[np.ndarray, "*batch"]:
    """2i √x exp(ix) ∫ exp(-iτ²) dτ from √x up: 0 at zero, 1 far from it."""
    root = np.sqrt(x)
    return 2j * root * np.exp(1j * x) * modfresnelm(root)[0]


def scattered(
    sonar: Sonar,
    points: Float[np.ndarray, "patterns paths 3"],
    strength: Float[np.ndarray, "patterns paths"],
) -> EchoPaths:
    """Point scatterers, each isotropic.

    `strength` [m] is the scattered pressure 1 m away over the incident pressure.
    """
    back = sonar.receivers - points[:, :, None]
    s, s_back = _norm(points)[..., None], _norm(back)
    departure = np.broadcast_to(_ahead(points)[..., None], s_back.shape)
    gain = (strength[..., None] / (s * s_back)).astype(np.complex128)
    return EchoPaths(s + s_back, gain, departure, _ahead(-back))
