"""Regressors, torques and mass matrices by NumPy: against those that JAX traces."""

import jax.numpy as jnp
import numpy as np
import pytest

import jaxcslc as jc
from jaxcslc.excitation._information import motion_mass_matrices, motion_regressor, motion_torques


ROUNDING = 1e-12  # of a few dozen operations on numbers about 1


@pytest.fixture(scope="module")
def arm() -> jc.CSLC:
    """Two links, with friction that differs between directions."""
    robot = jc.Manipulator.from_modified_dh(
        [(0, 0, 0, 0), (np.pi / 2, 0.4, 0, 0)], gravity=(0, 0, -9.81)
    )
    robot = robot.with_friction("asymmetric_viscous", "dry", "offset")
    return jc.derive(robot, lengths="numeric")


@pytest.mark.parametrize("on_host", [True, False])
def test_they_are_those_of_the_network(
    arm: jc.CSLC, on_host: bool, rng: np.random.Generator, monkeypatch: pytest.MonkeyPatch
) -> None:
    if not on_host:  # as of a network with a term that NumPy cannot compute
        monkeypatch.setattr(type(arm), "has_host_columns", property(lambda _: False))
    assert arm.has_host_columns is on_host
    q, qd, qdd = rng.normal(size=(3, 7, 2))
    models = rng.normal(size=(2, arm.size))
    traced = [jnp.asarray(x) for x in (q, qd, qdd)]
    expected = np.asarray(arm.regressor(*traced))
    np.testing.assert_allclose(motion_regressor(arm, q, qd, qdd), expected, atol=ROUNDING)
    torques = [np.asarray(arm.torque(jnp.asarray(k), *traced)) for k in models]
    np.testing.assert_allclose(motion_torques(arm, models, q, qd, qdd), torques, atol=ROUNDING)
    # The network's mass matrix is computed from terms of its own, not from torques.
    mass = np.asarray(arm.mass_matrix(jnp.asarray(models[0]), traced[0]))
    np.testing.assert_allclose(motion_mass_matrices(arm, models[0], q), mass, atol=10 * ROUNDING)
