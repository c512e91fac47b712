"""The acoustics of the ultrasound scene against hand geometry, tables, limits and brute force."""

import math

import numpy as np
import pytest
from scipy.special import jn_zeros

import sim
from sim.ultrasound._objects import (
    curved,
    diffraction,
    edge,
    mirrored,
    plane,
    scattered,
    vertical_corner,
)
from sim.ultrasound._sonar import (
    EchoPaths,
    absorption,
    amplitude,
    directivity,
    pulse,
    received,
    receiver_noise,
)


SONAR = sim.Sonar()
LEFT, RIGHT = SONAR.receivers
UP = np.array([[0.0, 0.0, 1.0]])
FLIP = np.array([1.0, -1.0, 1.0])


def at(distance: float, degrees: float) -> np.ndarray:
    angle = math.radians(degrees)
    return np.array([[distance * math.cos(angle), distance * math.sin(angle), 0.0]])


@pytest.mark.parametrize(
    ("temperature", "humidity", "per_km"),
    [(10.0, 70.0, [0.1, 0.4, 1.0, 1.9, 3.7, 9.7, 32.8, 117]), (20.0, 70.0, [0.1, 0.3, 1.1, 2.8])],
)
def test_absorption_is_that_of_the_standard_s_table(
    temperature: float, humidity: float, per_km: list[float]
):
    """ISO 9613-2, table 2 [dB/km], in octaves about 1 kHz, to the digits printed."""
    for octave, expected in enumerate(per_km):
        # The standard's midband frequencies are powers of 10^0.3.
        result = 1e3 * absorption(1e3 * 10 ** (0.3 * (octave - 4)), temperature, humidity)
        assert result == pytest.approx(expected, abs=0.05, rel=0.003)


def test_a_piston_has_its_null_where_j1_has():
    ka = SONAR.wavenumber * SONAR.aperture
    sine = np.array([0.0, jn_zeros(1, 1)[0] / ka])
    np.testing.assert_allclose(directivity(SONAR, np.sqrt(1 - sine**2)), [1.0, 0.0], atol=1e-12)
    assert directivity(SONAR, np.array([-1.0]))[0] == 0
    # The field's docstring.
    assert directivity(SONAR, np.array([math.cos(math.radians(22))]))[0] == pytest.approx(
        0.5, abs=0.02
    )


def test_the_pulse_is_a_burst_through_two_resonators():
    step = 2e-7
    t = step * np.arange(10_000)
    tau = 1 / (math.pi * SONAR.bandwidth)
    burst = (t < SONAR.cycles / SONAR.frequency).astype(np.float64)
    response = np.exp(-t / tau) / tau
    twice = np.convolve(np.convolve(burst, response)[: t.size], response)[: t.size] * step**2
    np.testing.assert_allclose(pulse(SONAR, t), twice, atol=5e-3)  # the sums' step over tau
    assert pulse(SONAR, np.array([-1e-6, 0.0])).tolist() == [0.0, 0.0]


def test_a_wall_is_as_far_as_the_emitter_s_image():
    """A wall 2 m ahead, turned by 10°, worked out in coordinates."""
    paths = plane(SONAR, at(2.0, 10.0), np.array([0.8]))
    x, y = 4 * math.cos(math.radians(10)), 4 * math.sin(math.radians(10))
    expected = [math.hypot(x, y - 0.1), math.hypot(x, y + 0.1)]
    np.testing.assert_allclose(paths.length[0, 0], expected, rtol=1e-14)
    np.testing.assert_allclose(paths.gain[0, 0], 0.8 / np.array(expected), rtol=1e-14)
    np.testing.assert_allclose(paths.arrival[0, 0], x / np.array(expected), rtol=1e-14)
    # What leaves meets the wall where it is as far from it as what returns, mirrored.
    normal = at(1.0, 10.0)[0]
    for side, receiver in enumerate(SONAR.receivers):
        share = 2.0 / (2.0 + (2.0 - receiver @ normal))
        hit = share * (receiver + 2 * (2.0 - receiver @ normal) * normal)
        assert hit @ normal == pytest.approx(2.0)
        assert paths.departure[0, 0, side] == pytest.approx(hit[0] / math.dist(hit, (0, 0, 0)))


def test_a_corner_is_two_mirrors():
    """Reflected in one face and then the other, however the corner is turned."""
    corner = at(1.3, -7.0)
    result = vertical_corner(SONAR, corner, np.array([0.9]))
    for turn in (0.3, 1.1):
        image = np.zeros(3)
        for angle in (turn, turn + math.pi / 2):
            normal = np.array([math.cos(angle), math.sin(angle), 0.0])
            image = image - 2 * ((image - corner[0]) @ normal) * normal
        expected = [math.dist(image, LEFT), math.dist(image, RIGHT)]
        np.testing.assert_allclose(result.length[0, 0], expected, rtol=1e-14)
    np.testing.assert_allclose(result.gain * result.length, 0.81, rtol=1e-14)


def test_a_cylinder_s_echo_is_the_shortest_way():
    centre, radius = at(1.0, 12.0), 0.25
    paths = curved(SONAR, centre, np.array([radius]), np.array([1.0]))
    angle = np.linspace(0, 2 * np.pi, 2_000_001)
    point = centre[0, :2] + radius * np.stack([np.cos(angle), np.sin(angle)], axis=-1)
    for side, receiver in enumerate(SONAR.receivers):
        way = np.hypot(*point.T) + np.hypot(*(point - receiver[:2]).T)
        assert paths.length[0, 0, side] == pytest.approx(way.min(), abs=1e-10)


@pytest.mark.parametrize("sphere", [False, True])
def test_a_huge_radius_is_a_wall(sphere: bool):
    radius = 1e6
    paths = curved(SONAR, at(1.5 + radius, 5.0), np.array([radius]), np.array([0.7]), sphere=sphere)
    wall = plane(SONAR, at(1.5, 5.0), np.array([0.7]))
    for name, value in vars(paths).items():
        np.testing.assert_allclose(value, vars(wall)[name], rtol=1e-5)


def test_a_far_sphere_scatters_half_its_radius_and_a_far_pole_its_root():
    """Pressure a/(2 r²) and, of a cylinder, sqrt(a/2) / sqrt(2 r³), at distances r ≫ a."""
    radius, r = np.array([0.01]), 50.0
    one = np.array([1.0])
    ball = curved(SONAR, at(r, 0.0), radius, one, sphere=True)
    assert abs(ball.gain[0, 0, 0]) == pytest.approx(0.01 / (2 * r**2), rel=1e-3)
    pole = curved(SONAR, at(r, 0.0), radius, one)
    assert abs(pole.gain[0, 0, 0]) == pytest.approx(math.sqrt(0.005 / (2 * r**3)), rel=1e-3)


@pytest.mark.parametrize("exterior", [1.5 * math.pi, 2 * math.pi])
def test_sound_is_continuous_where_a_face_s_reflection_ends(exterior: float):
    """Diffraction is half the reflection there, and its jump is what the reflection's end takes."""
    s, s_back, angle = 1.2, 1.3, 1.0
    reach = s * s_back / (s + s_back)
    spread = 1 / math.sqrt(s * s_back * (s + s_back))
    reflected = 1 / (s + s_back)
    boundary = math.pi - angle
    inside, outside = (
        spread
        * diffraction(
            SONAR.wavenumber,
            np.array([angle]),
            np.array([boundary + step]),
            np.array([reach]),
            exterior,
        )[0]
        for step in (-1e-5, 1e-5)
    )
    assert inside + reflected == pytest.approx(outside, rel=1e-3)
    # The incident wave's own boundary is far; its share is what a few percent allow for.
    assert abs(outside) == pytest.approx(reflected / 2, rel=0.05)


@pytest.mark.parametrize("exterior", [1.5 * math.pi, 2 * math.pi])
def test_far_from_that_it_is_keller_s(exterior: float):
    k, n = SONAR.wavenumber, exterior / math.pi
    incident, diffracted = np.array([2.3, 1.95, 2.6]), np.array([2.35, 2.0, 2.5])

    def term(beta: np.ndarray) -> np.ndarray:
        return 1 / (math.cos(math.pi / n) - np.cos(beta / n))

    keller = np.exp(-0.25j * math.pi) * math.sin(math.pi / n) / (n * math.sqrt(2 * math.pi * k))
    keller = keller * (term(diffracted - incident) + term(diffracted + incident))
    result = diffraction(k, incident, diffracted, np.full(3, 100.0), exterior)
    np.testing.assert_allclose(result, keller, rtol=2e-3)
    swapped = diffraction(k, diffracted, incident, np.full(3, 100.0), exterior)
    np.testing.assert_allclose(result, swapped, rtol=1e-12)  # reciprocity


def test_a_level_edge_is_met_where_the_way_is_shortest():
    """A kerb's upper edge, askew and below the sonar."""
    foot, below = at(0.8, 14.0), np.array([0.0, 0.0, -0.2])
    outward = -at(1.0, 14.0)
    along = np.cross(UP, outward)
    paths = edge(SONAR, foot + below, along, -UP, outward, np.array([1.0]), exterior=1.5 * math.pi)
    points = foot + below + np.linspace(-0.3, 0.3, 600_001)[:, None] * along
    for side, receiver in enumerate(SONAR.receivers):
        way = np.linalg.norm(points, axis=1) + np.linalg.norm(points - receiver, axis=1)
        assert paths.length[0, 0, side] == pytest.approx(way.min(), abs=1e-10)


def test_mirrored_objects_swap_the_receivers():
    one, point = np.array([0.9]), at(1.1, 9.0)
    face, normal = at(1.0, 80.0), at(1.0, 170.0)
    radius = np.array([0.1])

    def echoes(flip: np.ndarray) -> list[EchoPaths]:
        images = point * flip * 2 - np.array([[0.0, 0.0, 0.4]])
        box = 1.5 * math.pi
        return [
            plane(SONAR, point * flip, one),
            vertical_corner(SONAR, point * flip, one),
            curved(SONAR, point * flip, radius, one),
            curved(SONAR, point * flip, radius, one, sphere=True),
            edge(SONAR, point * flip, UP, face * flip, normal * flip, one, exterior=box),
            scattered(SONAR, (point * flip)[:, None], one[:, None]),
            mirrored(SONAR, images, images[:, None] + SONAR.receivers * [1, -1, 1], one),
        ]

    for here, there in zip(echoes(np.ones(3)), echoes(FLIP), strict=True):
        for name, value in vars(here).items():
            np.testing.assert_allclose(value[..., ::-1], vars(there)[name], rtol=1e-9)


def test_a_wall_twice_as_far_loses_what_spreading_and_air_take():
    close = sim.Sonar(offset=1e-6)
    feet = np.array([[1.0, 0.0, 0.0], [2.0, 0.0, 0.0]])
    size = np.abs(amplitude(close, plane(close, feet, np.ones(2))))[:, 0, 0]
    # 2 m more of air.
    assert size[0] / size[1] == pytest.approx(2 * 10 ** (2 * close.absorption / 20), rel=1e-9)


def test_a_record_holds_the_echo_at_its_time():
    paths = plane(SONAR, at(1.5, -6.0), np.array([1.0]))
    start, signal = received(SONAR, paths)
    t = start[0] + SONAR.sampling * np.arange(signal.shape[-1])
    size = amplitude(SONAR, paths)[0, 0]
    for side in (0, 1):
        late = t - paths.length[0, 0, side] / SONAR.speed_of_sound
        np.testing.assert_allclose(signal[0, side], size[side] * pulse(SONAR, late), atol=1e-15)
        assert late[0] < 0 < late[-1]


def test_echoes_add():
    one = np.array([1.0])
    wall, post = plane(SONAR, at(1.5, 3.0), one), curved(SONAR, at(1.5, -4.0), 0.01 * one, one)
    both = received(SONAR, wall + post)[1]
    (first, alone), (second, other) = received(SONAR, wall), received(SONAR, post)
    begin = round(abs(first[0] - second[0]) / SONAR.sampling)
    early, late = (alone, other) if first[0] <= second[0] else (other, alone)
    together = early.copy()
    together[..., begin:] += late[..., : late.shape[-1] - begin]
    np.testing.assert_allclose(both, together, atol=1e-12)


def test_noise_is_stationary_and_of_the_receiver_s_band(rng: np.random.Generator):
    noise = receiver_noise(SONAR, (20_000, 30), rng)
    square = np.mean(np.abs(noise) ** 2, axis=0)
    np.testing.assert_allclose(square, 1.0, atol=0.05)  # seven standard errors
    lag = 4
    kept = np.mean(noise[:, lag:] * noise[:, :-lag].conj())
    expected = math.exp(-math.pi * SONAR.bandwidth * SONAR.sampling * lag)
    assert abs(kept - expected) < 0.02
