"""The robot's file as prior: identities, MuJoCo's torques as oracle, wrong files, and limits."""

import dataclasses

import numpy as np
import pytest
from numpy.testing import assert_allclose

import jaxcslc as jc
from jaxcslc.bodies import (
    FilePrior,
    bodies_of,
    body_map,
    body_of_pseudo_inertia,
    pseudo_inertia,
    with_knowledge,
)
from jaxcslc.bodies._file_prior import _changes
from jaxcslc.manipulator import LinkParameters
from scripts.studies.file_prior.study import (
    NOISE,
    ROBOTS,
    model_of,
    moved,
    torque_of,
    true_coefficients,
    wrong,
)


WIDE = 1e4  # a prior of this width says nothing


@pytest.fixture(scope="module")
def robot() -> jc.Manipulator:
    return jc.load_robot(ROBOTS / "ur5.urdf")


@pytest.fixture(scope="module")
def network(robot: jc.Manipulator) -> jc.CSLC:
    return jc.derive(robot, lengths="numeric")


def with_links(network: jc.CSLC, links: list[LinkParameters]) -> jc.CSLC:
    return jc.derive(dataclasses.replace(network.robot, links=tuple(links)), lengths="numeric")


def patterns_of(network: jc.CSLC, motion: str, seed: int = 0) -> jc.Patterns:
    """Motion and torques of a frictionless UR5, by MuJoCo, with noise."""
    rng, model = np.random.default_rng(seed), model_of("ur5", False)
    q, qd, qdd = states = moved(rng, model, motion)
    torque = torque_of(model, states)
    torque += NOISE * np.std(torque, axis=0) * rng.standard_normal(torque.shape)
    mask = np.ones(q.shape, bool)
    return jc.Patterns(np.arange(len(q)) / 200.0, q, qd, qdd, torque, mask, mask)


def prior_of(network: jc.CSLC) -> FilePrior:
    prior = FilePrior.of(network)
    assert prior is not None
    return prior


class TestIdentity:
    def test_the_mean_is_what_mujoco_says_of_the_file(self, network: jc.CSLC) -> None:
        expected = true_coefficients(network, model_of("ur5", False))
        assert_allclose(prior_of(network).mean[network.layout.inertial], expected, atol=1e-9)

    def test_the_covariance_is_that_of_drawn_bodies(self, network: jc.CSLC) -> None:
        prior = dataclasses.replace(prior_of(network), motors=np.zeros((network.size, 6)))
        draws = np.random.default_rng(0).normal(size=(20_000, 6, 10)) * prior.widths[:, None]
        k = np.einsum("lpc,dlc->dp", prior.links, draws)
        assert_allclose(np.std(k, axis=0), np.sqrt(np.diag(prior.covariance)), rtol=0.03)

    def test_a_mass_of_a_body_moves_by_its_width(self, network: jc.CSLC) -> None:
        """A change of a body is one of its mass by that part, whatever its frame."""
        prior = prior_of(network)
        of_bodies, _ = body_map(network.algebra)
        for link, body in enumerate(bodies_of(prior.bodies)):
            scaled = of_bodies[:, link] @ (0.2 * body)
            span = prior.links[link][network.layout.inertial]
            part = np.linalg.lstsq(span, scaled)[0]
            assert_allclose(span @ part, scaled, atol=1e-12)

    def test_changes_depend_on_no_frame(self, network: jc.CSLC) -> None:
        """The covariance of a turned and shifted body is the covariance, turned and shifted."""
        rng = np.random.default_rng(2)
        pose = np.eye(4)
        pose[:3, :3] = np.linalg.qr(rng.normal(size=(3, 3)))[0]
        pose[:3, 3] = rng.normal(size=3)
        body = bodies_of(prior_of(network).bodies)[2]
        there = body_of_pseudo_inertia(pose @ pseudo_inertia(body) @ pose.T)
        covariances = []
        for some, placed in ((body, pose), (there, np.eye(4))):
            changes = [
                body_of_pseudo_inertia(placed @ pseudo_inertia(column) @ placed.T)
                for column in _changes(some, 0.1).T
            ]
            covariances.append(np.einsum("ca,cb->ab", changes, changes))
        assert_allclose(covariances[0], covariances[1], atol=1e-9 * np.max(covariances[0]))

    def test_a_wide_prior_changes_nothing(self, network: jc.CSLC) -> None:
        fit = jc.LeastSquares().fit(network, patterns_of(network, "rich"))
        prior = prior_of(network).scaled(WIDE)
        informed = with_knowledge(fit, {}, prior.rows)
        change = np.abs(np.asarray(informed.k) - np.asarray(fit.k))
        assert np.max(change / np.asarray(fit.standard_error)) < 1e-3


class TestDetermined:
    def test_the_file_is_not_felt_where_the_motion_determines(self, network: jc.CSLC) -> None:
        links = wrong(np.random.default_rng(1), "usual", list(network.robot.links or ()))
        other = with_links(network, links)
        patterns = patterns_of(network, "rich")
        fit = jc.LeastSquares().fit(other, patterns)
        prior = prior_of(other)
        share = prior.share(fit)
        informed = with_knowledge(fit, {}, prior.rows)
        change = np.abs(np.asarray(informed.k) - np.asarray(fit.k))
        told = share < 0.01
        assert np.sum(told) > 10
        assert np.max((change / np.asarray(fit.standard_error))[told]) < 0.1

    def test_shares_are_those_of_finite_differences(self, network: jc.CSLC) -> None:
        fit = jc.LeastSquares().fit(network, patterns_of(network, "slow"))
        prior = prior_of(network)
        share = prior.share(fit)
        for index in (0, 5, 20):
            mean = prior.mean.copy()
            step = 1e-3 * (1.0 + abs(mean[index]))
            mean[index] += step
            moved_prior = dataclasses.replace(prior, mean=mean)
            there, here = (
                float(with_knowledge(fit, {}, each.rows).k[index]) for each in (moved_prior, prior)
            )
            change = there - here
            assert change / step == pytest.approx(share[index], abs=1e-4)


class TestBias:
    def test_it_is_a_part_of_the_covariance(self, network: jc.CSLC) -> None:
        fit = jc.LeastSquares().fit(network, patterns_of(network, "rich"))
        error = np.asarray(fit.standard_error)
        bias = 3.0 * error * np.random.default_rng(2).standard_normal(len(error))
        prior = dataclasses.replace(prior_of(network), correlation=4.0, bias=bias)
        rows = prior.rows.rows_of(fit)
        expected = 4.0 * np.asarray(fit.independent_covariance) + np.outer(bias, bias)
        size = np.sqrt(np.diag(expected))
        found = np.linalg.inv((rows * size).T @ (rows * size))
        assert_allclose(found, expected / np.outer(size, size), atol=1e-5)

    def test_the_file_decides_along_a_large_one(self, network: jc.CSLC) -> None:
        """A fit that is off by its bias: the posterior is that of data without this direction."""
        fit = jc.LeastSquares().fit(network, patterns_of(network, "rich"))
        bias = prior_of(network).mean * 0.1
        wrong_fit = fit.with_k(np.asarray(fit.k) + 100.0 * bias)
        prior = dataclasses.replace(prior_of(network), bias=1e4 * bias)
        k, off = (with_knowledge(each, {}, prior.rows).k for each in (fit, wrong_fit))
        assert np.max(np.abs(np.asarray(off) - np.asarray(k))) < 0.02 * np.max(np.abs(bias))


@pytest.fixture(scope="module")
def wider(robot: jc.Manipulator) -> jc.CSLC:
    terms = ("viscous", "dry", "offset")
    return jc.derive(robot.with_friction(*terms), lengths="numeric")


@pytest.fixture(scope="module")
def shifted(network: jc.CSLC) -> jc.Patterns:
    """Slow motion with torque offsets and Coulomb friction [N m]."""
    some = patterns_of(network, "slow")
    offsets = np.array([2.0, -3.0, 1.5, 0.3, -0.4, 0.2])
    dry = np.array([3.0, 3.0, 2.0, 0.5, 0.5, 0.3]) * np.sign(np.asarray(some.qd))
    return dataclasses.replace(some, torque=some.torque + offsets + dry)


class TestOffsets:
    """Torque offsets of a UR5 with friction, which weak motion does not tell from gravity."""

    def test_an_offset_is_as_large_as_dry_friction_and_noise(
        self, wider: jc.CSLC, shifted: jc.Patterns
    ) -> None:
        fit = jc.LeastSquares().fit(wider, shifted)
        k, error = np.asarray(fit.k), np.asarray(fit.torque_error)
        dry, offset = (
            [wider.names.index(f"{kind}{joint}") for joint in range(1, 7)] for kind in ("kd", "ko")
        )
        covariance = prior_of(wider).of_fit(wider, fit).covariance
        expected = k[dry] ** 2 + error**2
        assert_allclose(np.diag(covariance)[offset], expected, rtol=1e-12)
        assert_allclose(np.diag(covariance)[dry], 0.0)

    def test_torques_of_other_motion_are_better_with_them(
        self, network: jc.CSLC, wider: jc.CSLC, shifted: jc.Patterns
    ) -> None:
        model = model_of("ur5", False)
        other = moved(np.random.default_rng(7), model, "rich")
        expected = torque_of(model, other)
        errors: list[np.ndarray] = []
        for some in (jc.derive(network.robot.with_friction("viscous", "dry")), wider):
            fit = jc.LeastSquares().fit(some, shifted)
            informed = with_knowledge(fit, {}, prior_of(some).of_fit(some, fit).rows)
            rigid = np.where(prior_of(some).inertial, informed.k, 0.0)
            error = np.asarray(some.torque(rigid, *other)) - expected
            errors.append(np.sqrt(np.mean(error**2, axis=0)))
        without, within = errors
        assert np.all(within[1:4] < without[1:4] / 2.0)

    def test_another_network_has_them_by_name(
        self, robot: jc.Manipulator, wider: jc.CSLC, shifted: jc.Patterns
    ) -> None:
        prior = prior_of(wider).of_fit(wider, jc.LeastSquares().fit(wider, shifted))
        more = jc.derive(robot.with_friction("viscous", "dry", "quadratic", "offset"))
        there = prior.of_names(more.names)
        known = dict(zip(prior.coefficients, np.diag(prior.covariance), strict=True))
        expected = [known.get(name, 0.0) for name in more.names]
        assert_allclose(np.diag(there.covariance), expected)


class TestWrongFiles:
    @pytest.mark.parametrize("file", ["half masses", "double masses"])
    def test_masses_that_the_data_contradict_are_named(self, network: jc.CSLC, file: str) -> None:
        links = wrong(np.random.default_rng(1), file, list(network.robot.links or ()))
        other = with_links(network, links)
        fit = jc.LeastSquares().fit(other, patterns_of(network, "rich"))
        widened, names = prior_of(other).widened(fit)
        assert names
        assert np.max(widened.widths) > 0.5

    def test_a_right_file_is_not_contradicted(self, network: jc.CSLC) -> None:
        fit = jc.LeastSquares().fit(network, patterns_of(network, "rich"))
        assert prior_of(network).widened(fit)[1] == ()

    def test_files_that_are_usually_wrong_are_rarely_contradicted(self, network: jc.CSLC) -> None:
        """Arms that are drawn from the prior: one in twenty by each of two rules, at most."""
        fit = jc.LeastSquares().fit(network, patterns_of(network, "slow"))
        prior, rng = prior_of(network), np.random.default_rng(5)
        roots = prior.links * prior.widths[:, None, None]
        noise = np.linalg.cholesky(
            np.asarray(fit.independent_covariance) + 1e-12 * np.eye(network.size)
        )
        named = 0
        for _ in range(20):
            changes = rng.standard_normal((6, 10))
            changes[:, 0] = np.expm1(prior.widths * changes[:, 0]) / prior.widths  # no mass below 0
            truth = prior.mean + np.einsum("lpc,lc->p", roots, changes)
            truth = truth + prior.motors @ rng.standard_normal(6)
            k = truth + noise @ rng.standard_normal(network.size)
            named += bool(prior.widened(fit.with_k(k))[1])
        assert named <= 4  # 2 are expected at most

    def test_inertia_beyond_the_link_is_cut_off(self, network: jc.CSLC) -> None:
        links = list(network.robot.links or ())
        links[4] = dataclasses.replace(links[4], inertia=100.0 * np.asarray(links[4].inertia))
        prior = prior_of(with_links(network, links))
        assert prior.implausible == ("wrist_2_link",)
        assert prior.widths[4] == pytest.approx(0.6)

    def test_a_link_without_mass_is_guessed(self, network: jc.CSLC) -> None:
        links = list(network.robot.links or ())
        links[3] = LinkParameters(0.0, np.zeros(3), np.zeros((3, 3)))
        prior = prior_of(with_links(network, links))
        assert prior.guessed == ("wrist_1_link",)
        assert float(prior.bodies[3].mass) > 0.1

    def test_intervals_hold_where_the_file_is_wrong_by_a_factor_of_two(
        self, network: jc.CSLC
    ) -> None:
        truth = true_coefficients(network, model_of("ur5", False))
        links = wrong(np.random.default_rng(3), "double masses", list(network.robot.links or ()))
        other = with_links(network, links)
        fit = jc.LeastSquares().fit(other, patterns_of(network, "wrist"))
        informed = with_knowledge(fit, {}, prior_of(other).widened(fit)[0].rows)
        low, high = informed.confidence_interval().T
        inertial = network.layout.inertial
        assert np.mean((low[inertial] <= truth) & (truth <= high[inertial])) > 0.9
