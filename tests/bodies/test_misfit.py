"""Misfit of fits: recordings whose noise is known, faults, and predictions written out."""

import dataclasses

import numpy as np
import pytest

import jaxcslc as jc
from jaxcslc.bodies import FilePrior, Misfit, misfit_of
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
