"""A payload from recordings: against dense NumPy, against a simulated arm, and what it refuses."""

import dataclasses
import re
from typing import Any

import jax
import numpy as np
import pytest
from numpy.testing import assert_allclose

import jaxcslc as jc
import sim
from jaxcslc.bodies import body_of, link_of, nearest_body, pseudo_inertia
from jaxcslc.manipulator import fixed_together
from jaxcslc.network import PAYLOAD
from tests import arms
from tests.patterns import ORDINARY


_ROUNDING = 1e-9
# Samples of drawn recordings: tests of the same numbers share compiled programs.
FEW, MANY = 200, 600
BODY = jc.LinkParameters(
    1.5,
    np.array([0.02, -0.01, 0.12]),
    np.array([[3e-3, 2e-4, 0.0], [2e-4, 4e-3, 0.0], [0.0, 0.0, 2e-3]]),
)


def _drawn(
    network: jc.CSLC, k: Any, rng: np.random.Generator, samples: int, noise: float
) -> jc.Patterns:
    n = network.joint_count
    q, qd, qdd = rng.uniform(-2, 2, (3, samples, n))
    torque = np.asarray(network.torque(k, q, qd, qdd)) + noise * rng.normal(size=q.shape)
    pairs = rng.random(q.shape) < 0.8
    return jc.Patterns(0.01 * np.arange(samples), q, qd, qdd, torque, pairs, np.ones_like(pairs))


def _rows(network: jc.CSLC, patterns: jc.Patterns) -> tuple[np.ndarray, np.ndarray]:
    counts = np.asarray(patterns.mask)
    rows = np.asarray(network.regressor(patterns.q, patterns.qd, patterns.qdd))
    return rows[counts], np.asarray(patterns.torque)[counts]


@pytest.fixture(scope="module")
def loaded(puma: jc.CSLC) -> jc.CSLC:
    return puma.with_payload()


@pytest.fixture(scope="module")
def loaded_k(puma_k: jax.Array) -> np.ndarray:
    return np.concatenate([np.asarray(puma_k), body_of(BODY)])


class TestKnownArm:
    def test_equals_numpy(
        self, puma: jc.CSLC, loaded: jc.CSLC, loaded_k: np.ndarray, rng: np.random.Generator
    ) -> None:
        """Oracle: dense least squares of ten columns, errors of the other 43 spread into them."""
        arm = ORDINARY.fit(puma, _drawn(puma, loaded_k[loaded.layout.unloaded], rng, FEW, 0.5))
        patterns = _drawn(loaded, loaded_k, rng, FEW, 0.3)
        payload = jc.fit_payload(puma, patterns, previous=arm, solver=ORDINARY)
        rows, torque = _rows(loaded, patterns)
        of_arm, of_payload = rows[:, loaded.layout.unloaded], rows[:, loaded.layout.payload]
        target = torque - of_arm @ np.asarray(arm.k)
        body, squares, *_ = np.linalg.lstsq(of_payload, target, rcond=None)
        inverse = np.linalg.inv(of_payload.T @ of_payload)
        follow = inverse @ of_payload.T @ of_arm
        covariance = squares[0] / (len(target) - 10) * inverse
        covariance += follow @ np.asarray(arm.covariance) @ follow.T
        assert_allclose(payload.parameters, body, atol=_ROUNDING)
        assert_allclose(payload.covariance, covariance, rtol=1e-6, atol=1e-14)
        assert_allclose(payload.standard_error, np.sqrt(np.diag(covariance)), rtol=1e-6)

    def test_is_relearning_the_payload(
        self, loaded: jc.CSLC, loaded_k: np.ndarray, rng: np.random.Generator
    ) -> None:
        solver = jc.LeastSquares(cutoff=10.0, errors="independent")
        patterns = _drawn(loaded, loaded_k, rng, MANY, 0.3)
        payload = jc.fit_payload(loaded, patterns, previous=loaded_k, solver=solver)
        fit = jc.reidentify(loaded, patterns, loaded_k, groups=("payload",), solver=solver)
        assert_allclose(payload.fit.k, fit.k)
        assert_allclose(payload.standard_error, fit.standard_error[loaded.layout.payload])


class TestTwoRecordings:
    @pytest.mark.parametrize("robust", [False, True])
    def test_equals_numpy(
        self,
        robust: bool,
        puma: jc.CSLC,
        loaded: jc.CSLC,
        loaded_k: np.ndarray,
        rng: np.random.Generator,
    ) -> None:
        """Oracle: all rows of both, zeros for the payload of the unloaded arm."""
        empty = _drawn(puma, loaded_k[loaded.layout.unloaded], rng, FEW, 0.5)
        patterns = _drawn(loaded, loaded_k, rng, FEW, 0.5)
        solver = jc.LeastSquares(joint_weights="equal", loss="huber" if robust else "squared")
        payload = jc.fit_payload(puma, patterns, empty, solver=solver)
        loaded_rows, torque = _rows(loaded, patterns)
        other, more = _rows(puma, empty)
        rows = np.concatenate([loaded_rows, np.pad(other, ((0, 0), (0, 10)))])
        target = np.concatenate([torque, more])
        k = np.linalg.lstsq(rows, target, rcond=None)[0]
        if robust:  # the same noise, of normal distribution: nearly the same
            error = np.sqrt(np.diag(np.linalg.inv(rows.T @ rows))) * 0.5
            assert np.max(np.abs(np.asarray(payload.fit.k) - k) / error) < 1.0
        else:
            assert_allclose(payload.fit.k, k, atol=_ROUNDING)
            usual = jc.fit_payload(puma, patterns, empty, solver=ORDINARY)
            squares = np.sum((target - rows @ k) ** 2) / (len(target) - 53)
            assert_allclose(
                usual.fit.covariance, squares * np.linalg.inv(rows.T @ rows), rtol=1e-6, atol=1e-12
            )
            # Noise is white here: allowing for correlation changes little.
            ratio = np.asarray(payload.standard_error) / np.asarray(usual.standard_error)
            assert np.all((ratio > 0.5) & (ratio < 2.0))

    def test_tells_more_than_the_unloaded_recording_alone(
        self, puma: jc.CSLC, loaded: jc.CSLC, loaded_k: np.ndarray, rng: np.random.Generator
    ) -> None:
        """The loaded arm's motion is motion of the arm too."""
        empty = _drawn(puma, loaded_k[loaded.layout.unloaded], rng, 60, 0.5)
        patterns = _drawn(loaded, loaded_k, rng, MANY, 0.5)
        both = jc.fit_payload(puma, patterns, empty, solver=ORDINARY)
        arm = ORDINARY.fit(puma, empty)
        one_by_one = jc.fit_payload(puma, patterns, previous=arm, solver=ORDINARY)
        assert np.all(both.standard_error < one_by_one.standard_error)

    def test_with_a_filter(
        self, puma: jc.CSLC, loaded: jc.CSLC, loaded_k: np.ndarray, rng: np.random.Generator
    ) -> None:
        """Filtering both sides alike loses nothing of what has no noise."""
        empty = _drawn(puma, loaded_k[loaded.layout.unloaded], rng, MANY, 0.0)
        patterns = _drawn(loaded, loaded_k, rng, MANY, 0.0)
        payload = jc.fit_payload(
            puma, patterns, empty, solver=dataclasses.replace(ORDINARY, cutoff=20.0)
        )
        assert_allclose(payload.fit.k, loaded_k, atol=1e-8)


@pytest.fixture(scope="module")
def performed() -> tuple[jc.Recording, jc.Recording]:
    """Three seconds of the training trajectory with encoders, without and with `BODY`."""
    machine = sim.disturbed(sim.puma560(), "quantisation")
    robot = machine.robot
    assert robot.links is not None
    links = (*robot.links[:-1], fixed_together([robot.links[-1], BODY]))
    carrying = dataclasses.replace(machine, robot=dataclasses.replace(robot, links=links))
    trajectory = sim.training(samples=1500)
    empty, full = (sim.simulate(m, trajectory, seed=3).recording for m in (machine, carrying))
    return empty, full


@pytest.mark.parametrize("together", [False, True])
def test_of_a_simulated_arm(
    together: bool, puma: jc.CSLC, performed: tuple[jc.Recording, jc.Recording]
) -> None:
    """A body that the simulator fixed to the last link, from encoders' counts."""
    settings = jc.Settings(
        jc.Preparation(torque_alignment="mean", threshold_fraction=0.01),
        jc.LeastSquares(cutoff=15.0),
    )
    empty, full = (settings.patterns(recording) for recording in performed)
    other: dict[str, Any] = (
        {"unloaded": empty} if together else {"previous": settings.fit(puma, empty)}
    )
    payload = jc.fit_payload(puma, full, **other, solver=settings.solver)
    assert abs(float(payload.mass) - 1.5) < 0.02 * 1.5
    assert np.max(np.abs(np.asarray(payload.centre_of_gravity) - BODY.centre_of_gravity)) < 2e-3
    low, high = payload.physical_interval(0.999)[:4].T
    truth = np.array([1.5, *BODY.centre_of_gravity])
    assert np.all((low < truth) & (truth < high))
    assert payload.unidentifiable == ()
    assert payload.possible is not None
    assert np.min(np.linalg.eigvalsh(pseudo_inertia(body_of(payload.possible)))) > 0


class TestPhysical:
    def _fitted(
        self, puma: jc.CSLC, loaded: jc.CSLC, k: np.ndarray, rng: np.random.Generator, noise: float
    ) -> jc.PayloadFit:
        return jc.fit_payload(
            puma,
            _drawn(loaded, k, rng, FEW, noise),
            previous=k[loaded.layout.unloaded],
            solver=ORDINARY,
        )

    def test_is_the_body(
        self, puma: jc.CSLC, loaded: jc.CSLC, loaded_k: np.ndarray, rng: np.random.Generator
    ) -> None:
        payload = self._fitted(puma, loaded, loaded_k, rng, 0.0)
        assert_allclose(payload.mass, BODY.mass, rtol=_ROUNDING)
        assert_allclose(payload.centre_of_gravity, BODY.centre_of_gravity, atol=_ROUNDING)
        assert_allclose(payload.inertia, BODY.inertia, atol=_ROUNDING)
        link = link_of(np.asarray(payload.parameters))
        assert_allclose(payload.inertia, link.inertia, atol=_ROUNDING)

    def test_errors_to_first_order(
        self, puma: jc.CSLC, loaded: jc.CSLC, loaded_k: np.ndarray, rng: np.random.Generator
    ) -> None:
        """Against the scatter of bodies drawn from the estimate's covariance."""
        payload = self._fitted(puma, loaded, loaded_k, rng, 0.3)
        bodies = rng.multivariate_normal(
            np.asarray(payload.parameters), np.asarray(payload.covariance), size=4000
        )
        centres = bodies[:, 6:9] / bodies[:, 9:]
        assert_allclose(np.std(bodies[:, 9]), payload.physical_error[0], rtol=0.1)
        assert_allclose(np.std(centres, axis=0), payload.physical_error[1:4], rtol=0.1)
        tensors = [np.asarray(link_of(body).inertia) for body in bodies[:1000]]
        diagonal = np.diagonal(np.std(tensors, axis=0))
        assert_allclose(diagonal, payload.physical_error[4:7], rtol=0.15)
        low, high = payload.physical_interval(0.9)[0]
        assert_allclose(high - low, 2 * 1.645 * payload.physical_error[0], rtol=0.01)

    def test_rows_and_document(
        self, puma: jc.CSLC, loaded: jc.CSLC, loaded_k: np.ndarray, rng: np.random.Generator
    ) -> None:
        payload = self._fitted(puma, loaded, loaded_k, rng, 0.1)
        assert [row["name"] for row in payload.rows()][:4] == ["m", "rx", "ry", "rz"]
        document = payload.document()
        assert document["physical"]["m"]["low"] < 1.5 < document["physical"]["m"]["high"]
        assert list(document["parameters"])[-1] == "pm"
        assert repr(payload).startswith(f"PayloadFit({document['physical']['m']['value']:.4g} ± ")
        for interval in (payload.physical_interval, payload.confidence_interval):
            with pytest.raises(ValueError, match="level"):
                interval(1.0)

    def test_what_an_arm_cannot_feel(self, rng: np.random.Generator) -> None:
        """One joint with an upright axis: nothing but the moment of inertia about it."""
        network = arms.turntable().with_payload()
        k = np.full(network.size, 0.1)
        k[network.layout.payload] = body_of(BODY)
        arm_k = k[network.layout.unloaded]
        payload = jc.fit_payload(
            network, _drawn(network, k, rng, 50, 0.0), previous=arm_k, solver=ORDINARY
        )
        assert np.flatnonzero(np.asarray(payload.determined)).tolist() == [2]
        assert len(payload.unidentifiable) == 9
        assert "pm: nothing in the patterns depends on it" in payload.unidentifiable
        assert np.all(np.isinf(np.asarray(payload.physical_error)))
        for (
            row
        ) in payload.rows():  # no value of what is not known, nor a NaN for the end of a range
            assert np.isnan(row["value"]) and (row["low"], row["high"]) == (-np.inf, np.inf)
        assert payload.possible is not None
        body = body_of(payload.possible)
        assert_allclose(body[2], body_of(BODY)[2], rtol=1e-4)
        assert np.min(np.linalg.eigvalsh(pseudo_inertia(body))) > 0

    def test_the_report_says_what_is_determined_instead(self) -> None:
        """A pendulum feels first moments and a moment of inertia, and no mass."""
        network = arms.pendulum().with_payload()
        k = np.full(network.size, 0.1)
        k[network.layout.payload] = body_of(BODY)
        t = np.arange(500)[:, None] * 0.01
        torque = np.asarray(network.torque(k, np.sin(t), np.cos(t), -np.sin(t)))
        report = jc.identify_payload(
            network,
            jc.Recording(t[:, 0], np.sin(t), torque),
            settings=jc.Settings(),
            previous=k[network.layout.unloaded],
        )
        text = str(report)
        assert "nan" not in text and "inf" not in text
        assert re.search(r"^determined: pIzz [\d.e-]+ \(.* phx .* phy .* kg m$", text, re.MULTILINE)

    @pytest.mark.parametrize("length", [0.0, 0.5])
    def test_two_joints_that_do_not_sense_the_mass(
        self, length: float, rng: np.random.Generator
    ) -> None:
        """A twist of π/2 in floating point leaves 6e-17 of a gravity term, and its first moment
        1e12 of anything. What is determined is met by a body that can exist."""
        rows = [(0, 0, 0, 0), (np.pi / 2, length, 0, 0)]
        arm = jc.Manipulator.from_modified_dh(rows, gravity=(0, 0, -9.81))
        network = jc.derive(arm, lengths="numeric").with_payload()
        k = np.full(network.size, 0.1)
        k[network.layout.payload] = body_of(BODY)
        arm_k = k[network.layout.unloaded]
        payload = jc.fit_payload(
            network, _drawn(network, k, rng, FEW, 0.01), previous=arm_k, solver=ORDINARY
        )
        assert np.isinf(np.asarray(payload.physical_error)[0])  # the mass
        assert any("pm" in sentence for sentence in payload.unidentifiable)
        assert payload.possible is not None
        body = body_of(payload.possible)
        assert np.min(np.linalg.eigvalsh(pseudo_inertia(body))) > 0
        assert np.linalg.norm(payload.possible.centre_of_gravity) < 1.0
        index = list(PAYLOAD).index("phx")
        assert_allclose(body[index], body_of(BODY)[index], atol=0.01)

    def test_an_arm_of_unknown_link_and_payload(self, rng: np.random.Generator) -> None:
        """A recording of the empty arm that does not determine the arm leaves the payload open."""
        network = arms.pendulum()
        loaded = network.with_payload()
        k = np.concatenate([np.full(5, 0.1), body_of(BODY)])
        still = _drawn(network, k[:5], rng, 50, 0.0)
        still = dataclasses.replace(still, q=0 * still.q, qdd=0 * still.qdd)
        torque = network.torque(k[:5], still.q, still.qd, still.qdd)
        empty = dataclasses.replace(still, torque=np.asarray(torque))
        payload = jc.fit_payload(network, _drawn(loaded, k, rng, 50, 0.0), empty, solver=ORDINARY)
        sentences = " ".join(payload.unidentifiable)
        assert "pIzz" in sentences and "phy" in sentences and not payload.determined[2]
        assert payload.determined[6]


class TestPossible:
    def test_a_body_is_its_own(self) -> None:
        body = body_of(BODY)
        nearest = nearest_body(body, 1e-6 * np.eye(10))
        assert nearest is not None
        assert_allclose(nearest, body, rtol=1e-4, atol=1e-7)

    def test_none_is_nearer(self, rng: np.random.Generator, random_links: Any) -> None:
        """Steps from it towards any body that exists lead away from the estimate."""
        body = body_of(BODY) - [4e-2, 0, 0, 0, 0, 0, 0, 0, 0, 0]
        half = rng.normal(size=(10, 10)) * 10.0 ** rng.uniform(-3, -1, 10)
        covariance = half.T @ half
        nearest = nearest_body(body, covariance)
        assert nearest is not None
        assert np.min(np.linalg.eigvalsh(pseudo_inertia(nearest))) > 0
        assert np.min(np.linalg.eigvalsh(pseudo_inertia(body))) < 0
        distance = lambda x: (x - body) @ np.linalg.solve(covariance, x - body)
        for link in (*random_links(rng, 50), BODY):
            nearby = nearest + 0.01 * (body_of(link) - nearest)
            assert distance(nearby) > distance(nearest) * (1 - 1e-3)

    def test_of_nothing_at_all(self) -> None:
        """A hand that is empty: an estimate around zero still has a body beside it."""
        error = np.array([*[1e-3] * 6, *[1e-3] * 3, 0.01])
        nearest = nearest_body(-0.5 * error, np.diag(error**2))
        assert nearest is not None and 0 < nearest[9] < 0.02


def test_on_another_link(puma: jc.CSLC, puma_k: jax.Array, rng: np.random.Generator) -> None:
    network = puma.with_payload(3)
    k = np.concatenate([np.asarray(puma_k), body_of(BODY)])
    payload = jc.fit_payload(
        network, _drawn(network, k, rng, FEW, 0.0), previous=puma_k, solver=ORDINARY
    )
    assert_allclose(payload.parameters, body_of(BODY), atol=_ROUNDING)


def test_failures(
    puma: jc.CSLC, loaded: jc.CSLC, loaded_k: np.ndarray, rng: np.random.Generator
) -> None:
    patterns = _drawn(loaded, loaded_k, rng, FEW, 0.0)
    both: dict[str, Any] = {"unloaded": patterns, "previous": loaded_k}
    with pytest.raises(ValueError, match="cannot tell payload and last link apart"):
        jc.fit_payload(puma, patterns)
    with pytest.raises(ValueError, match="got both unloaded and previous; expected one of them"):
        jc.fit_payload(puma, patterns, **both)
    with pytest.raises(ValueError, match="expected 53 coefficients, got 12"):
        jc.fit_payload(puma, patterns, previous=np.zeros(12))
    arm = arms.turntable()
    with pytest.raises(ValueError, match="patterns have 6 joints"):
        jc.fit_payload(arm, patterns, patterns)
    wrong = dataclasses.replace(patterns, torque=np.full((FEW, 6), np.nan))
    with pytest.raises(RuntimeError, match="NaN"):
        jc.fit_payload(puma, wrong, previous=loaded_k)
