"""Link parameters: moved between frames as point masses move, and a pytree."""

import jax
import jax.numpy as jnp
import numpy as np

from jaxcslc.manipulator import LinkParameters


def second_moments(masses: np.ndarray, points: np.ndarray) -> np.ndarray:
    """Inertia tensor of point masses about the origin, from its definition."""
    return sum(
        (m * (p @ p * np.eye(3) - np.outer(p, p)) for m, p in zip(masses, points, strict=True)),
        np.zeros((3, 3)),
    )


def test_parallel_axes_against_point_masses(rng: np.random.Generator) -> None:
    masses, points = rng.uniform(0.1, 2.0, 9), rng.standard_normal((9, 3))
    mass = float(np.sum(masses))
    centre = masses @ points / mass
    link = LinkParameters(mass, centre, second_moments(masses, points - centre))
    np.testing.assert_allclose(link.first_moment, masses @ points, rtol=1e-13)
    np.testing.assert_allclose(link.inertia_at_frame, second_moments(masses, points), rtol=1e-12)


def test_off_diagonal_elements_are_minus_the_products() -> None:
    # One kilogram at (1, 2, 0): Ixy = -∫ x y dm = -2, the sign of URDF and MJCF.
    link = LinkParameters(1.0, np.array([1.0, 2.0, 0.0]), np.zeros((3, 3)))
    assert np.array_equal(link.inertia_at_frame, [[4, -2, 0], [-2, 1, 0], [0, 0, 5]])


def test_motor_inertia_is_zero_unless_given() -> None:
    assert LinkParameters(1.0, np.zeros(3), np.eye(3)).motor_inertia == 0.0


def test_is_a_pytree() -> None:
    link = LinkParameters(2.0, np.array([0.5, 0, 0.1]), np.diag([1.0, 2.0, 3.0]), 0.25)

    def moment(link: LinkParameters) -> jax.Array:
        return jnp.asarray(link.inertia_at_frame)[2, 2]

    expected = 3.0 + 2.0 * 0.25
    np.testing.assert_allclose(moment(link), expected)
    arrays: LinkParameters = jax.tree.map(jnp.asarray, link)
    np.testing.assert_allclose(jax.jit(moment)(arrays), expected)
    gradient = jax.grad(moment)(arrays)
    np.testing.assert_allclose(gradient.mass, 0.25)
    np.testing.assert_allclose(gradient.centre_of_gravity, [2.0, 0, 0])
    several: LinkParameters = jax.tree.map(lambda x: jnp.stack([x, 2 * x]), arrays)
    np.testing.assert_allclose(jax.vmap(moment)(several), [expected, 6.0 + 4.0 * 1.0])
