"""From coefficients to bodies that can exist: identities, independent oracles, fixed bodies."""

import sys
from collections.abc import Callable
from pathlib import Path
from typing import Any, NamedTuple

import numpy as np
import pinocchio
import pytest
from jaxtyping import Float

import jaxcslc as jc
from jaxcslc.bodies import POSSIBILITY, file_bodies
from jaxcslc.bodies._body import (
    bodies_of,
    body_map,
    body_of,
    body_of_pseudo_inertia,
    link_of,
    pseudo_inertia,
)
from jaxcslc.bodies._nearest_bodies import whitening
from jaxcslc.manipulator import LinkInertia
from tests import arms


Links = tuple[jc.LinkParameters, ...]
_ROUNDING = 1e-10
_SOLVER = 1e-6  # a conic solver's part of the optimum


class Fit(NamedTuple):
    """Coefficients as they might have been identified."""

    k: Float[np.ndarray, " coefficients"]
    covariance: Float[np.ndarray, "coefficients coefficients"]
    undetermined: Float[np.ndarray, "rows coefficients"]


def fit_of(k: Any, error: float = 0.01) -> Fit:
    """A fit of the same standard error everywhere."""
    k = np.asarray(k, float)
    return Fit(k, error**2 * np.eye(len(k)), np.zeros((0, len(k))))


@pytest.fixture(scope="module")
def elbow() -> jc.CSLC:
    """Three joints with full tensors and motors."""
    robot = jc.Manipulator.from_modified_dh(
        [(0, 0, 0.3, 0), ("-pi/2", 0.05, 0, 0), (0.7, 0.4, 0.1, 0.2)], gravity=(0, 0, -9.81)
    )
    return jc.derive(robot, lengths="numeric")


@pytest.fixture(scope="module")
def pendulum() -> jc.CSLC:
    return arms.pendulum()


def spectrum(link: jc.LinkParameters) -> Float[np.ndarray, "4"]:
    """Eigenvalues of the pseudo-inertia, as NumPy and the definition have them."""
    mass, r = float(link.mass), np.asarray(link.centre_of_gravity)
    tensor = np.asarray(link.inertia_at_frame)
    matrix = np.block(
        [
            [np.trace(tensor) / 2 * np.eye(3) - tensor, mass * r[:, None]],
            [mass * r[None, :], np.array([[mass]])],
        ]
    )
    return np.linalg.eigvalsh(matrix)


class TestBodies:
    def test_pseudo_inertia_is_pinocchios(
        self, random_links: Callable[..., Links], rng: np.random.Generator
    ) -> None:
        (link,) = random_links(rng, 1)
        inertia = pinocchio.Inertia(
            float(link.mass), np.asarray(link.centre_of_gravity), np.asarray(link.inertia)
        )
        expected = pinocchio.PseudoInertia.FromInertia(inertia).toMatrix()
        np.testing.assert_allclose(pseudo_inertia(body_of(link)), expected, atol=_ROUNDING)

    def test_there_and_back(
        self, random_links: Callable[..., Links], rng: np.random.Generator
    ) -> None:
        (link,) = random_links(rng, 1)
        body = body_of(link)
        again = link_of(body_of_pseudo_inertia(pseudo_inertia(body)), float(link.motor_inertia))
        for name in ("mass", "centre_of_gravity", "inertia", "motor_inertia"):
            np.testing.assert_allclose(getattr(again, name), getattr(link, name), atol=_ROUNDING)

    @pytest.mark.parametrize("lengths", ["symbolic", "numeric"])
    @pytest.mark.parametrize("form", ["full", "principal"])
    def test_coefficients_are_linear_in_bodies(
        self, lengths: Any, form: Any, random_links: Callable[..., Links], rng: np.random.Generator
    ) -> None:
        robot = jc.Manipulator.from_modified_dh(
            [(0, 0, 0.1, 0), ("pi/2", 0.2, 0, 0)],
            inertia=[form, LinkInertia(form, zero=("ry",), equal=())],
        )
        network = jc.derive(robot, lengths=lengths)
        links = list(random_links(rng, 2, principal=form == "principal"))
        centre = np.array(links[1].centre_of_gravity) * [1, 0, 1]
        links[1] = jc.LinkParameters(links[1].mass, centre, links[1].inertia, 0.1)
        bodies, motors = body_map(network.algebra)
        k = np.einsum("ile,le->i", bodies, bodies_of(links))
        k += motors @ np.array([float(link.motor_inertia) for link in links])
        expected = np.asarray(network.coefficients_from(links))[: len(k)]
        np.testing.assert_allclose(k, expected, atol=_ROUNDING)

    def test_undetermined_changes_cost_nothing(self, rng: np.random.Generator) -> None:
        """The metric's square is the added sum of squared residuals over their variance."""
        regressor = rng.normal(size=(50, 4)) @ rng.normal(size=(4, 6)) * np.logspace(-3, 3, 6)
        right = np.linalg.svd(regressor)[2]
        gram = regressor.T @ regressor
        inverse = np.linalg.pinv(gram, rcond=1e-30, hermitian=True)
        null = right[4:]
        # Any generalised inverse with the right range will do: move it along the null space.
        slant = np.eye(6) + null.T @ rng.normal(size=(2, 6)) * 1e-3
        fit = Fit(np.zeros(6), slant @ inverse @ slant.T, null)
        white = whitening(fit, np.full(6, 1e-9))
        change = rng.normal(size=6)
        np.testing.assert_allclose(white @ null.T, 0.0, atol=1e-3)
        assert np.sum((white @ change) ** 2) == pytest.approx(change @ gram @ change, rel=1e-4)

    def test_variances_that_rounding_takes_below_zero(self) -> None:
        """As those of a motion that smoothing left nothing of: correlations beyond one."""
        beyond = 1.0 + 1e-9
        fit = Fit(np.zeros(2), np.array([[1.0, beyond], [beyond, 1.0]]), np.zeros((0, 2)))
        white = whitening(fit, np.full(2, 1e-9))
        assert np.isfinite(white).all()
        together = np.sum((white @ [1.0, 1.0]) ** 2)
        assert together == pytest.approx(2.0 / (1.0 + beyond), rel=1e-6)


class TestIdentity:
    def test_possible_coefficients_stay(
        self, elbow: jc.CSLC, random_links: Callable[..., Links], rng: np.random.Generator
    ) -> None:
        """Coefficients of possible bodies stay as they are."""
        links = random_links(rng, 3)
        k = elbow.coefficients_from(links, viscous=[1.0, 2.0, 3.0], dry=[0.1, 0.2, 0.3])
        parameters = jc.physical_parameters(elbow, fit_of(k, 1e-7))
        assert parameters.result == POSSIBILITY.successful
        np.testing.assert_allclose(parameters.k, np.asarray(k), atol=1e-6)
        np.testing.assert_allclose(np.asarray(parameters.friction["viscous"]), [1, 2, 3], atol=1e-6)
        again = elbow.coefficients_from(parameters.links, **dict[str, Any](parameters.friction))
        np.testing.assert_allclose(np.asarray(again), parameters.k, atol=_ROUNDING)

    def test_the_prior_is_its_own_answer(
        self, elbow: jc.CSLC, random_links: Callable[..., Links], rng: np.random.Generator
    ) -> None:
        links = random_links(rng, 3)
        k = elbow.coefficients_from(links, viscous=[1.0] * 3, dry=[0.1] * 3)
        parameters = jc.physical_parameters(elbow, fit_of(k), links)
        for body, truth in zip(parameters.links, links, strict=True):
            np.testing.assert_allclose(body_of(body), body_of(truth), atol=1e-8)
            assert float(body.motor_inertia) == pytest.approx(float(truth.motor_inertia))

    def test_principal_axes_stay_principal(
        self, random_links: Callable[..., Links], rng: np.random.Generator
    ) -> None:
        """Symbolic lengths, products of parameters, equal moments, centres on an axis."""
        robot = jc.Manipulator.from_modified_dh(
            [(0, 0, 0.1, 0), ("pi/2", "a1", 0, 0), (0, "a2", 0, 0)],
            inertia=[
                "principal",
                LinkInertia("principal", zero=("ry",)),
                LinkInertia("principal", zero=("rx", "ry"), equal=(("Ixx", "Iyy"),)),
            ],
            lengths={"a1": 0.2, "a2": 0.3},
        )
        network = jc.derive(robot)
        links = list(random_links(rng, 3, principal=True))
        for i, free in ((1, [1, 0, 1]), (2, [0, 0, 1])):
            tensor = np.array(links[i].inertia)
            if i == 2:
                tensor[1, 1] = tensor[0, 0]
            links[i] = jc.LinkParameters(
                links[i].mass, np.array(links[i].centre_of_gravity) * free, tensor, 0.1
            )
        k = network.coefficients_from(links, viscous=[1.0] * 3, dry=[0.1] * 3)
        parameters = jc.physical_parameters(network, fit_of(k, 1e-6))
        np.testing.assert_allclose(parameters.k, np.asarray(k), atol=1e-5)
        tensors = np.stack([np.asarray(link.inertia) for link in parameters.links])
        assert np.count_nonzero(tensors) == 9
        assert tensors[2, 0, 0] == pytest.approx(tensors[2, 1, 1])
        assert np.asarray(parameters.links[1].centre_of_gravity)[1] == 0.0
        again = network.coefficients_from(parameters.links, **dict[str, Any](parameters.friction))
        np.testing.assert_allclose(np.asarray(again), parameters.k, atol=_ROUNDING)

    def test_of_an_identification(self, elbow: jc.CSLC, random_links: Any, rng: Any) -> None:
        """From patterns with noise: within the fit's standard errors, and the distance is the
        torque that the change makes."""
        links = random_links(rng, 3)
        k = elbow.coefficients_from(links, viscous=[1.0] * 3, dry=[0.1] * 3)
        q, qd, qdd = rng.uniform(-2, 2, (3, 300, 3))
        torque = np.asarray(elbow.torque(k, q, qd, qdd))
        every = np.ones(q.shape, bool)
        patterns = jc.Patterns(
            np.arange(300.0), q, qd, qdd, torque + rng.normal(size=q.shape), every, every
        )
        fit = jc.LeastSquares(joint_weights="equal", errors="independent").fit(elbow, patterns)
        parameters = jc.physical_parameters(elbow, fit, patterns=patterns)
        change = np.asarray(elbow.torque(parameters.k - np.asarray(fit.k), q, qd, qdd))
        np.testing.assert_allclose(parameters.torque_distance, np.sqrt(np.mean(change**2, 0)))
        assert parameters.distance < 1.0
        assert min(float(spectrum(link)[0]) for link in parameters.links) > 0


class TestImpossible:
    def test_negative_inertia_is_lifted_to_the_least(self, pendulum: jc.CSLC) -> None:
        """By hand: the nearest motor and body of a negative moment have almost none."""
        parameters = jc.physical_parameters(pendulum, fit_of([-0.5, 0.3, 0.0, 0.2, 0.05]))
        assert 0 < parameters.k[0] < 0.1
        np.testing.assert_allclose(parameters.k[3:], [0.2, 0.05], atol=1e-3)
        assert float(parameters.links[0].motor_inertia) == pytest.approx(0.0, abs=1e-6)

    def test_nearest_on_the_boundary(self, pendulum: jc.CSLC) -> None:
        """Only kB1 is certain: it stays, and so does a body that has it."""
        fit = Fit(
            np.array([1e-3, 1.0, 0.0, 0.1, 0.1]),
            np.diag([1e-5, 1e-1, 1e-5, 1e-3, 1e-3]) ** 2,
            np.zeros((0, 5)),
        )
        parameters = jc.physical_parameters(pendulum, fit)
        assert parameters.k[0] == pytest.approx(1e-3, rel=0.05)
        assert np.all(np.linalg.eigvalsh(np.asarray(parameters.links[0].inertia)) > 0)

    def test_eigenvalues_are_no_less_than_asked_for(
        self, elbow: jc.CSLC, random_links: Callable[..., Links], rng: np.random.Generator
    ) -> None:
        prior = random_links(rng, 3)
        k = rng.normal(size=elbow.size)
        for least in (1e-3, 0.1):
            parameters = jc.physical_parameters(elbow, fit_of(k), prior, least=least)
            for body, before in zip(parameters.links, prior, strict=True):
                scale = np.linalg.inv(np.linalg.cholesky(pseudo_inertia(body_of(before))))
                unit = scale @ pseudo_inertia(body_of(body)) @ scale.T
                lowest = float(np.linalg.eigvalsh(unit)[0])
                assert lowest > least - _SOLVER
            assert np.all(np.asarray(parameters.friction["viscous"]) >= 0) and np.all(
                np.asarray(parameters.friction["dry"]) >= 0
            )
            assert all(float(link.motor_inertia) >= 0 for link in parameters.links)

    def test_nothing_possible_is_nearer(
        self, elbow: jc.CSLC, random_links: Callable[..., Links], rng: np.random.Generator
    ) -> None:
        """Optimality of a convex programme: no step towards any possible robot is downhill."""
        prior = random_links(rng, 3)
        fit = fit_of(rng.normal(size=elbow.size))
        weak = 1e-4
        parameters = jc.physical_parameters(elbow, fit, prior, prior_weight=weak, least=1e-6)

        def cost(k: Float[np.ndarray, " _"]) -> float:
            return float(np.sum((k - fit.k) ** 2)) / 0.01**2

        lowest = cost(parameters.k)
        for _ in range(20):
            other = random_links(rng, 3)
            k = np.asarray(
                elbow.coefficients_from(other, viscous=rng.uniform(0, 1, 3), dry=[0.5] * 3)
            )
            step = 1e-3
            assert cost(parameters.k + step * (k - parameters.k)) > lowest * (1 - 1e-5)


class TestPriorWeight:
    """The largest weight of the robot's bodies that the errors of the data allow."""

    def test_imprecise_data_leave_the_bodies_as_they_are(
        self, elbow: jc.CSLC, random_links: Callable[..., Links], rng: np.random.Generator
    ) -> None:
        """Bodies that are a fraction of a standard error away are taken with the largest weight."""
        prior = random_links(rng, 3)
        k = elbow.coefficients_from(prior, viscous=[1.0] * 3, dry=[0.1] * 3)
        parameters = jc.physical_parameters(elbow, fit_of(1.02 * np.asarray(k), 1.0), prior)
        assert parameters.prior_weight == pytest.approx(10.0)
        for body, before in zip(parameters.links, prior, strict=True):
            np.testing.assert_allclose(body_of(body), body_of(before), rtol=0.1, atol=0.05)

    @pytest.mark.parametrize("possible", [True, False])
    def test_it_is_the_largest_within_the_discrepancy(
        self,
        elbow: jc.CSLC,
        random_links: Callable[..., Links],
        rng: np.random.Generator,
        possible: bool,
    ) -> None:
        """By trying all weights, for a fit of other bodies and for one of no bodies."""
        prior, links = random_links(rng, 3), random_links(rng, 3)
        k = np.asarray(elbow.coefficients_from(links, viscous=[1.0] * 3, dry=[0.1] * 3))
        fit = fit_of(k if possible else k + rng.normal(size=k.shape), 0.05)
        weights = 0.01 * 10 ** (0.5 * np.arange(7))
        distances = np.array(
            [jc.physical_parameters(elbow, fit, prior, prior_weight=w).distance for w in weights]
        )
        assert np.all(np.diff(distances) > -_SOLVER)
        limit = np.hypot(distances[0], 0.5)
        assert distances[-1] > limit  # or there would be nothing to find
        parameters = jc.physical_parameters(elbow, fit, prior)
        assert parameters.prior_weight == pytest.approx(np.max(weights[distances <= limit]))

    def test_a_motor_that_the_file_lacks_is_no_motor_of_zero(
        self, elbow: jc.CSLC, random_links: Callable[..., Links], rng: np.random.Generator
    ) -> None:
        """Motors explain what they can, and bodies stay those of the file."""
        links = random_links(rng, 3)
        with_motors = [
            jc.LinkParameters(body.mass, body.centre_of_gravity, body.inertia, 0.7)
            for body in links
        ]
        without = [
            jc.LinkParameters(body.mass, body.centre_of_gravity, body.inertia) for body in links
        ]
        k = elbow.coefficients_from(with_motors, viscous=[1.0] * 3, dry=[0.1] * 3)
        parameters = jc.physical_parameters(elbow, fit_of(k), without)
        assert parameters.prior_weight == pytest.approx(10.0)
        for body, truth in zip(parameters.links, links, strict=True):
            np.testing.assert_allclose(body_of(body), body_of(truth), atol=1e-3)
            assert float(body.motor_inertia) == pytest.approx(0.7, rel=1e-2)

    def test_balls_keep_the_weak_one(self, pendulum: jc.CSLC) -> None:
        parameters = jc.physical_parameters(pendulum, fit_of([1.0, 0.3, 0.0, 0.2, 0.05]))
        assert parameters.prior_weight == 0.01


class TestFixedBodies:
    def test_they_stay_and_the_other_bodies_are_possible(
        self, elbow: jc.CSLC, random_links: Callable[..., Links], rng: np.random.Generator
    ) -> None:
        links, gripper = random_links(rng, 3), random_links(rng, 1)[0]
        whole = link_of(body_of(links[2]) + body_of(gripper), float(links[2].motor_inertia))
        k = elbow.coefficients_from((*links[:2], whole), viscous=[1.0] * 3, dry=[0.1] * 3)
        parameters = jc.physical_parameters(elbow, fit_of(k), fixed=(None, None, gripper))
        np.testing.assert_allclose(
            body_of(parameters.links[2]) - body_of(parameters.links_without_fixed[2]),
            body_of(gripper),
            atol=_ROUNDING,
        )
        assert spectrum(parameters.links_without_fixed[2])[0] > 0
        np.testing.assert_allclose(parameters.k, np.asarray(k), atol=0.05)

    def test_a_body_too_heavy_for_the_data_stays(self, pendulum: jc.CSLC) -> None:
        """A fixed body stays, whatever the coefficients."""
        lead = jc.LinkParameters(50.0, np.array([1.0, 0, 0]), np.eye(3))
        parameters = jc.physical_parameters(
            pendulum, fit_of([1.0, 0.3, 0.0, 0.2, 0.05]), fixed=(lead,)
        )
        assert parameters.k[0] > 51.0
        assert float(parameters.links[0].mass) > 50.0

    def test_not_on_principal_axes(self) -> None:
        robot = jc.Manipulator.from_modified_dh([(0, 0, 0, 0)], inertia="principal")
        network = jc.derive(robot)
        ball = jc.LinkParameters(1.0, np.zeros(3), np.eye(3))
        with pytest.raises(ValueError, match="full inertia tensors only"):
            jc.physical_parameters(network, fit_of(np.ones(network.size)), fixed=(ball,))


def test_all_kinds_of_friction_come_back(rng: np.random.Generator) -> None:
    """In the form that `coefficients_from` takes."""
    robot = jc.Manipulator.from_modified_dh([(0, 0, 0, 0), ("pi/2", 0.2, 0, 0)])
    robot = robot.with_friction("asymmetric_viscous", "asymmetric_dry", "static", "spring")
    network = jc.derive(robot.with_coupling((1, 2)), lengths="numeric")
    parameters = jc.physical_parameters(network, fit_of(rng.uniform(0.5, 1.0, network.size)))
    assert parameters.friction["asymmetric_dry"].shape == (2, 2)
    assert parameters.friction["coupled"].shape == (1, 3)
    again = network.coefficients_from(parameters.links, **dict[str, Any](parameters.friction))
    np.testing.assert_allclose(np.asarray(again), parameters.k, atol=_ROUNDING)


def test_motors_can_be_fixed_at_zero(elbow: jc.CSLC, rng: np.random.Generator) -> None:
    parameters = jc.physical_parameters(elbow, fit_of(rng.normal(size=elbow.size)), motors=False)
    assert [float(link.motor_inertia) for link in parameters.links] == [0.0, 0.0, 0.0]


def test_reads_well(elbow: jc.CSLC) -> None:
    parameters = jc.physical_parameters(elbow, fit_of(np.ones(elbow.size)))
    assert repr(parameters).startswith("PhysicalParameters(3 links of [")
    table = parameters.to_pandas()
    assert table.index.tolist() == [1, 2, 3]
    assert table.loc[2, "mass"] == float(parameters.links[1].mass)
    assert {"rx", "Ixz", "motor_inertia"} <= set(table.columns)


@pytest.mark.parametrize(
    ("arguments", "message"),
    [
        ({"prior": ()}, "prior: expected 3 entries, one a joint, got 0"),
        ({"fixed": (None,)}, "fixed: expected 3 entries"),
        ({"prior_weight": 0.0}, "prior_weight: expected a number above 0"),
        ({"least": 1.0}, "least: expected a number between 0 and 1"),
    ],
)
def test_wrong_arguments(elbow: jc.CSLC, arguments: dict[str, Any], message: str) -> None:
    with pytest.raises(ValueError, match=message):
        jc.physical_parameters(elbow, fit_of(np.ones(elbow.size)), **arguments)


def test_a_fit_that_does_not_fit(elbow: jc.CSLC) -> None:
    with pytest.raises(ValueError, match=f"expected {elbow.size} coefficients"):
        jc.physical_parameters(elbow, fit_of(np.ones(2)))
    with pytest.raises(ValueError, match="not finite"):
        jc.physical_parameters(elbow, fit_of(np.full(elbow.size, np.nan)))


def test_a_missing_conic_solver_is_named(
    pendulum: jc.CSLC, monkeypatch: pytest.MonkeyPatch
) -> None:
    """Only where it is needed: possible coefficients are their own answer."""
    monkeypatch.setitem(sys.modules, "clarabel", None)
    possible = np.array([1.0, 0.3, 0.0, 0.2, 0.05])
    assert jc.physical_parameters(pendulum, fit_of(possible)).result == POSSIBILITY.successful
    with pytest.raises(ImportError, match=r"pip install 'jaxcslc\[inertia\]'"):
        jc.physical_parameters(pendulum, fit_of(-possible))


def test_bodies_of_a_file_are_those_that_it_has(tmp_path: Path) -> None:
    """A tool that is fixed to the second link is no part of it; frames are the file's."""
    links = {"base": None, "upper": (2.0, 0.1), "fore": (1.5, -0.2), "tool": (0.5, 0.3)}
    joints = (("shoulder", "base", "upper"), ("elbow", "upper", "fore"), ("mount", "fore", "tool"))
    text = '<robot name="arm">'
    for name, entry in links.items():
        text += f'<link name="{name}">'
        if entry is not None:
            text += (
                f'<inertial><origin xyz="{entry[1]} 0.02 0.03"/><mass value="{entry[0]}"/>'
                '<inertia ixx="0.1" iyy="0.1" izz="0.1" ixy="0" ixz="0" iyz="0"/></inertial>'
            )
        text += "</link>"
    for name, parent, child in joints:
        kind = "fixed" if name == "mount" else "continuous"
        text += (
            f'<joint name="{name}" type="{kind}"><parent link="{parent}"/><child link="{child}"/>'
            '<origin xyz="0.3 0 0.1" rpy="0.2 0 0.4"/><axis xyz="0 1 0"/></joint>'
        )
    path = tmp_path / "arm.urdf"
    path.write_text(text + "</robot>", encoding="utf-8")
    bodies = file_bodies(jc.load_robot(path))
    assert bodies is not None
    for body, name in zip(bodies, ("upper", "fore"), strict=True):
        mass, x = links[name] or (0.0, 0.0)
        np.testing.assert_allclose(float(body.mass), mass)
        np.testing.assert_allclose(body.centre_of_gravity, [x, 0.02, 0.03], atol=1e-12)
        np.testing.assert_allclose(body.inertia, 0.1 * np.eye(3), atol=1e-12)
    assert file_bodies(jc.examples.pendulum()) is None
