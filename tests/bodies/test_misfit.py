"""Misfit of fits: recordings whose noise is known, faults, and predictions written out."""

import dataclasses

import numpy as np
import pytest
from numpy.testing import assert_allclose

import jaxcslc as jc
from jaxcslc.bodies import FilePrior, Misfit, misfit_of
from jaxcslc.bodies._misfit import _OF_DATA, _chosen, _splits
from scripts.studies.file_prior.study import NOISE, ROBOTS, model_of, moved, torque_of


@pytest.fixture(scope="module")
def network() -> jc.CSLC:
    return jc.derive(jc.load_robot(ROBOTS / "ur5.urdf"), lengths="numeric")


def recorded(motion: str) -> jc.Patterns:
    """Motion and torques of a frictionless UR5, by MuJoCo, with noise."""
    rng, model = np.random.default_rng(4), model_of("ur5", False)
    q, qd, qdd = states = moved(rng, model, motion)
    torque = torque_of(model, states)
    torque += NOISE * np.std(torque, axis=0) * rng.standard_normal(torque.shape)
    mask = np.ones(q.shape, bool)
    return jc.Patterns(np.arange(len(q)) / 200.0, q, qd, qdd, torque, mask, mask)


@pytest.fixture(scope="module")
def patterns() -> jc.Patterns:
    return recorded("single sine")


def misfit(network: jc.CSLC, patterns: jc.Patterns, file: FilePrior | None = None) -> Misfit:
    solver = jc.LeastSquares()
    prior = file or FilePrior.of(network)
    assert prior is not None
    fit = solver.fit(network, patterns)
    return misfit_of(network, patterns, solver, fit, prior.rows)


def test_white_noise_and_a_right_file_are_no_misfit(
    network: jc.CSLC, patterns: jc.Patterns
) -> None:
    assert misfit(network, patterns) == Misfit()


def test_halves_have_the_weights_and_the_noise_of_the_whole(network: jc.CSLC) -> None:
    """Covariances of fits to halves, written out, where the late half has ten times the noise."""
    some = recorded("rich")
    late = (np.arange(some.samples) >= some.samples // 2)[:, None]
    noise = np.random.default_rng(5).standard_normal(np.shape(some.torque))
    torque = some.torque + 0.5 * np.where(late, 1.0, 0.1) * noise
    patterns = dataclasses.replace(some, torque=torque)
    solver = jc.LeastSquares(errors="independent")
    fit = solver.fit(network, patterns)
    regressor = np.asarray(network.regressor(patterns.q, patterns.qd, patterns.qdd))
    weighted = regressor / np.asarray(fit.torque_error)[:, None]
    *_, of_early, of_late = _splits(network, patterns, solver, fit)
    for split, half in ((of_early, ~late), (of_late, late)):
        rows = weighted[half[:, 0]].reshape(-1, network.size)
        error = np.sqrt(np.diag(np.linalg.inv(rows.T @ rows)))
        assert_allclose(np.sqrt(np.diag(split.near.covariance)), error, rtol=0.02)


class TestFaults:
    def test_half_of_the_time_at_a_wrong_rate(
        self, network: jc.CSLC, patterns: jc.Patterns
    ) -> None:
        late = (np.arange(patterns.samples) >= patterns.samples // 2)[:, None]
        slower = dataclasses.replace(
            patterns,
            qd=np.where(late, 0.5, 1.0) * np.asarray(patterns.qd),
            qdd=np.where(late, 0.25, 1.0) * np.asarray(patterns.qdd),
        )
        assert misfit(network, slower).data >= 10.0

    def test_torque_that_no_coefficient_explains(
        self, network: jc.CSLC, patterns: jc.Patterns
    ) -> None:
        torque = np.asarray(patterns.torque)
        bent = torque * (1.0 + 0.3 * np.tanh(torque / np.std(torque, axis=0)))
        assert misfit(network, dataclasses.replace(patterns, torque=bent)).data > 1.0

    def test_a_file_that_is_far_off_its_errors(self, network: jc.CSLC) -> None:
        """Three times the masses, stated to 2 %."""
        links = [
            dataclasses.replace(link, mass=3.0 * link.mass, inertia=3.0 * np.asarray(link.inertia))
            for link in network.robot.links or ()
        ]
        robot = dataclasses.replace(network.robot, links=tuple(links))
        file = FilePrior.of(jc.derive(robot, lengths="numeric"))
        assert file is not None
        found = misfit(network, recorded("slow"), file.scaled(0.1))
        assert found.prior > 1.0
        assert found.data == 1.0


@pytest.mark.parametrize(
    ("of_data", "of_prior", "expected"),
    [
        ((2.0, 1.95), (2.0, 2.0), 0),  # a gain of less than a tenth
        ((2.0, 1.5), (1.45, 1.45), 1),
        ((2.0, 1.95), (1.8, 1.75), len(_OF_DATA)),  # the wider prior gains nothing more
        ((2.0, 1.95), (1.8, 1.6), len(_OF_DATA) + 1),
    ],
)
def test_every_step_has_to_gain(
    of_data: tuple[float, ...], of_prior: tuple[float, ...], expected: int
) -> None:
    rest = (9.0,) * (len(_OF_DATA) - len(of_data))
    assert _chosen(np.array([*of_data, *rest, *of_prior])) == expected
