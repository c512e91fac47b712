"""The ten kinds of object: random dimensions, and the paths of their echoes.

Each kind is a function of a sonar, a random generator and a number of patterns. Sizes are in metres
and angles in radians, uniform in the ranges named at the top. Reflections by two objects, or by
the floor (except for the kerb's), are omitted.

Paths of echoes are those of geometrical acoustics and diffraction. Points have the axis "3" last
and are in the sonar's frame. Every function of paths gives one to each receiver for a batch of
objects, or, for `scattered`, one a scatterer.
"""

import math
from collections.abc import Callable, Mapping
from types import MappingProxyType

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


# The detection field: where the nearest point of an object lies. A pulse's end leaves the emitter
# in 0.5 ms, long before the first echo; at the far end the weakest echoes are near the noise.
RANGE = (0.6, 2.4)  # m
BEARING = (-math.radians(15), math.radians(15))

# Pressure reflection coefficient of hard surfaces: painted or papered wall, wood, stone.
REFLECTION = (0.7, 1.0)
# Angle between the bisector of an edge or corner and the line of sight: within it, no face of a
# box or of a corner has specular reflection.
SKEW = (-math.radians(25), math.radians(25))
BOX_FACE = (0.1, 0.4)
CORNER_FACE = (0.12, 0.25)
POLE_RADIUS = (0.005, 0.025)  # from a rod to a broomstick and a scaffold tube
COLUMN_RADIUS = (0.06, 0.25)  # from a drainpipe to a pillar
BALL_RADIUS = (0.05, 0.2)  # from a small ball to a football's double
BALL_HEIGHT = (-0.1, 0.1)  # of its centre over the sonar
PAIR_SPACING = (0.08, 0.3)  # from chair legs to railings
PAIR_TURN = (-math.radians(60), math.radians(60))  # beyond, one would occlude the other
DOORWAY_WIDTH = (0.3, 0.8)
DOORWAY_TURN = (-math.radians(15), math.radians(15))
KERB_HEIGHT = (0.08, 0.2)  # from a pavement's to a stair's
BUSH_LEAVES = 40
BUSH_WIDTH = (0.15, 0.5)
BUSH_DEPTH = (0.1, 0.35)
# A flat leaf of area A that faces the sonar has a strength A / wavelength, 0.1 m for 30 by 30 mm;
# one that does not, far less. The root mean square of a leaf's strength:
LEAF_STRENGTH = (0.005, 0.02)
# Depth of leaves that attenuates by 8.7 dB there and back, as a share of the bush's depth.
BUSH_SHADE = 0.7

_UP = np.array([0.0, 0.0, 1.0])

Draw = Callable[[Sonar, np.random.Generator, int], EchoPaths]


def _nearest_point(rng: np.random.Generator, n: int) -> Float[np.ndarray, "patterns 3"]:
    distance, bearing = rng.uniform(*RANGE, n), rng.uniform(*BEARING, n)
    return np.stack([distance * np.cos(bearing), distance * np.sin(bearing), np.zeros(n)], axis=-1)


def _unit(vector: Float[np.ndarray, "patterns 3"]) -> Float[np.ndarray, "patterns 3"]:
    return vector / np.sqrt(np.sum(vector**2, axis=-1, keepdims=True))


def _turned(
    vector: Float[np.ndarray, "patterns 3"], angle: Float[np.ndarray, " patterns"]
) -> Float[np.ndarray, "patterns 3"]:
    """About the vertical, to the left."""
    c, s = np.cos(angle), np.sin(angle)
    x, y, z = vector.T
    return np.stack([c * x - s * y, s * x + c * y, z], axis=-1)


def _upright(at: Float[np.ndarray, "patterns 3"]) -> Float[np.ndarray, "patterns 3"]:
    return np.broadcast_to(_UP, at.shape)


def wall(sonar: Sonar, rng: np.random.Generator, n: int) -> EchoPaths:
    """A plane wall with its ends out of the field."""
    return plane(sonar, _nearest_point(rng, n), rng.uniform(*REFLECTION, n))


def corner(sonar: Sonar, rng: np.random.Generator, n: int) -> EchoPaths:
    """A concave right-angled corner of two boards: both in turn, and the boards' ends."""
    at, reflection = _nearest_point(rng, n), rng.uniform(*REFLECTION, n)
    middle = _turned(_unit(-at), rng.uniform(*SKEW, n))
    paths = vertical_corner(sonar, at, reflection)
    for side in (1, -1):
        face = _turned(middle, np.full(n, side * math.pi / 4))
        inward = _turned(face, np.full(n, -side * math.pi / 2))
        end = at + rng.uniform(*CORNER_FACE, n)[:, None] * face
        paths += edge(sonar, end, _upright(at), -face, inward, reflection, exterior=2 * math.pi)
    return paths


def box_edge(sonar: Sonar, rng: np.random.Generator, n: int) -> EchoPaths:
    """A convex right-angled edge of a box, and the far edges of the two faces seen."""
    at, reflection = _nearest_point(rng, n), rng.uniform(*REFLECTION, n)
    middle = _turned(_unit(-at), rng.uniform(*SKEW, n))
    box = {"exterior": 1.5 * math.pi}
    left, right = (_turned(middle, np.full(n, side * 0.75 * math.pi)) for side in (1, -1))
    # A face runs 135° off the middle, and its outward normal is 45° off.
    normals = [_turned(middle, np.full(n, side * 0.25 * math.pi)) for side in (1, -1)]
    paths = edge(sonar, at, _upright(at), left, normals[0], reflection, **box)
    for face, normal in zip((left, right), normals, strict=True):
        end = at + rng.uniform(*BOX_FACE, n)[:, None] * face
        paths += edge(sonar, end, _upright(at), -face, normal, reflection, **box)
    return paths


def pole(sonar: Sonar, rng: np.random.Generator, n: int) -> EchoPaths:
    """A thin vertical cylinder."""
    return _cylinder(sonar, _nearest_point(rng, n), rng.uniform(*POLE_RADIUS, n), rng)


def column(sonar: Sonar, rng: np.random.Generator, n: int) -> EchoPaths:
    """A thick vertical cylinder."""
    return _cylinder(sonar, _nearest_point(rng, n), rng.uniform(*COLUMN_RADIUS, n), rng)


def _cylinder(
    sonar: Sonar,
    nearest: Float[np.ndarray, "patterns 3"],
    radius: Float[np.ndarray, " patterns"],
    rng: np.random.Generator,
) -> EchoPaths:
    centre = nearest + radius[:, None] * _unit(nearest)
    return curved(sonar, centre, radius, rng.uniform(*REFLECTION, len(radius)))


def ball(sonar: Sonar, rng: np.random.Generator, n: int) -> EchoPaths:
    """A sphere."""
    nearest, radius = _nearest_point(rng, n), rng.uniform(*BALL_RADIUS, n)
    centre = nearest + radius[:, None] * _unit(nearest) + rng.uniform(*BALL_HEIGHT, (n, 1)) * _UP
    return curved(sonar, centre, radius, rng.uniform(*REFLECTION, n), sphere=True)


def pair(sonar: Sonar, rng: np.random.Generator, n: int) -> EchoPaths:
    """Two thin vertical cylinders side by side, about equally strong."""
    middle, radius = _nearest_point(rng, n), rng.uniform(*POLE_RADIUS, n)
    across = _turned(_unit(middle), math.pi / 2 + rng.uniform(*PAIR_TURN, n))
    half = 0.5 * rng.uniform(*PAIR_SPACING, n)[:, None] * across
    return _cylinder(sonar, middle + half, radius, rng) + _cylinder(
        sonar, middle - half, radius, rng
    )


def doorway(sonar: Sonar, rng: np.random.Generator, n: int) -> EchoPaths:
    """An opening in a wall: both its edges, and the wall where it is met squarely."""
    middle, reflection = _nearest_point(rng, n), rng.uniform(*REFLECTION, n)
    normal = _turned(-_unit(middle), rng.uniform(*DOORWAY_TURN, n))
    across = _turned(normal, np.full(n, -math.pi / 2))
    half = 0.5 * rng.uniform(*DOORWAY_WIDTH, n)
    foot = np.sum(middle * normal, axis=-1, keepdims=True) * normal
    aside = np.abs(np.sum((foot - middle) * across, axis=-1))
    paths = plane(sonar, foot, np.where(aside > half, reflection, 0.0))
    for side in (1, -1):
        face = side * across
        post = middle + half[:, None] * face
        paths += edge(sonar, post, _upright(post), face, normal, reflection, exterior=1.5 * math.pi)
    return paths


def kerb(sonar: Sonar, rng: np.random.Generator, n: int) -> EchoPaths:
    """A step in the floor: its upper edge, and its riser together with the floor before it."""
    foot, reflection = _nearest_point(rng, n), rng.uniform(*REFLECTION, n)
    outward = -_unit(foot)
    below = sonar.height - rng.uniform(*KERB_HEIGHT, n)[:, None]
    down = np.broadcast_to(-_UP, foot.shape)
    along = _turned(outward, np.full(n, math.pi / 2))
    top = edge(sonar, foot - below * _UP, along, down, outward, reflection, exterior=1.5 * math.pi)
    floor = 2 * sonar.height * _UP
    before = np.sum((foot[:, None] - sonar.receivers) * -outward[:, None], axis=-1)
    behind = sonar.receivers - 2 * before[..., None] * outward[:, None]
    return top + mirrored(sonar, 2 * foot - floor, behind - floor, reflection**2)


def bush(sonar: Sonar, rng: np.random.Generator, n: int) -> EchoPaths:
    """Leaves throughout a volume, those behind in the shade of those before."""
    front, size = _nearest_point(rng, n)[:, None], (n, BUSH_LEAVES)
    ahead = front / np.sqrt(np.sum(front**2, axis=-1, keepdims=True))
    across = np.stack([-ahead[..., 1], ahead[..., 0], ahead[..., 2]], axis=-1)
    into = rng.uniform(size=size)
    depth, width = rng.uniform(*BUSH_DEPTH, (n, 1)), rng.uniform(*BUSH_WIDTH, (n, 1))
    aside, up = width * rng.uniform(-0.5, 0.5, (2, *size))
    leaves = front + (depth * into)[..., None] * ahead + aside[..., None] * across
    leaves = leaves + up[..., None] * _UP
    strength = rng.uniform(*LEAF_STRENGTH, (n, 1)) * rng.rayleigh(math.sqrt(0.5), size)
    return scattered(sonar, leaves, strength * np.exp(-into / BUSH_SHADE))


KINDS: Mapping[str, Draw] = MappingProxyType(
    {
        "wall": wall,
        "corner": corner,
        "edge": box_edge,
        "pole": pole,
        "column": column,
        "ball": ball,
        "pair of poles": pair,
        "doorway": doorway,
        "kerb": kerb,
        "bush": bush,
    }
)
