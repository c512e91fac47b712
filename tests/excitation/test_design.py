"""Designs: limits hold at all times, gradients are those of differences, seeds repeat."""

import dataclasses
from pathlib import Path
from typing import Any

import jax
import jax.numpy as jnp
import numpy as np
import pytest

import jaxcslc as jc
from jaxcslc.bodies import body_of, body_of_pseudo_inertia, link_of, pseudo_inertia
from jaxcslc.excitation import (
    CRITERIA,
    BSplines,
    DenseCheck,
    Design,
    Effort,
    Goal,
    Knowledge,
    Limits,
    Noise,
    Planner,
    Use,
    design_motion,
    family_named,
    random_parameters,
)
from jaxcslc.excitation._criteria import body_prior, body_variances, log_criterion
from jaxcslc.excitation._information import Moments
from jaxcslc.excitation._search import Multipliers, padded_contacts
from tests import arms


def test_all_limits_hold_on_a_much_finer_grid(pendulum_design: Design) -> None:
    family, limits = pendulum_design.family, pendulum_design.limits
    time = np.linspace(0.0, family.duration, 60001)
    q, qd, qdd = family.motion(pendulum_design.parameters, time)
    jerk = family.derivative(pendulum_design.parameters, time, 3)
    assert np.all((q >= limits.low) & (q <= limits.high))
    for values, limit in ((qd, limits.velocity), (qdd, limits.acceleration), (jerk, limits.jerk)):
        assert np.all(np.abs(values) <= limit)
    torque = pendulum_design.network.torque(pendulum_design.prediction.k, q, qd, qdd)
    assert np.all(np.abs(torque) <= limits.torque)


def test_it_is_better_than_random_motions(
    pendulum_planner: Planner, pendulum_design: Design
) -> None:
    random = []
    for seed in range(5):
        draw = random_parameters(pendulum_planner.check, np.zeros(1), np.random.default_rng(seed))
        random.append(pendulum_planner.criterion_value(pendulum_planner.check.scaled(draw)[0]))
    assert pendulum_design.value < 0.8 * min(random)


def test_the_same_seed_gives_the_same_design(
    pendulum_planner: Planner, pendulum_design: Design
) -> None:
    again = pendulum_planner.design(Effort(1, 3, 15))
    np.testing.assert_array_equal(again.parameters, pendulum_design.parameters)


def test_an_interrupted_search_returns_the_best_so_far(pendulum_planner: Planner) -> None:
    def interrupt(text: str) -> None:
        if text.startswith("refining, round 1"):
            raise KeyboardInterrupt

    design = pendulum_planner.design(Effort(1, 3, 15), interrupt)
    assert design.use.feasible
    assert "interrupted" in design.notes[-1]


def test_gradient_of_the_lagrangian(pendulum_planner: Planner, rng: np.random.Generator) -> None:
    problem = pendulum_planner.problem
    x = jnp.asarray(rng.normal(size=problem.unit.size))
    q = np.asarray(problem.basis[0] @ problem.parameters(x))
    spectra = problem.information.spectra(q)
    samples, joints = q.shape
    multipliers = Multipliers(
        jnp.full((4, samples, joints), 0.1),
        jnp.zeros((samples, joints)),
        jnp.zeros((samples, joints)),
        jnp.zeros(1024),
    )

    @jax.jit
    def value(x: jax.Array) -> jax.Array:
        return problem.lagrangian(
            x, spectra, multipliers, jnp.asarray(5.0), padded_contacts(joints)
        )[0]

    direction = jnp.asarray(rng.normal(size=x.size))
    step = 1e-6
    numeric = (value(x + step * direction) - value(x - step * direction)) / (2 * step)
    # The threshold of slow pairs follows the top speed, which the gradient takes as fixed.
    np.testing.assert_allclose(jax.grad(value)(x) @ direction, numeric, rtol=1e-3)


@pytest.mark.parametrize("criterion", [name for name in CRITERIA if name != "bodies"])
def test_criteria_follow_their_definitions(
    pendulum_planner: Planner, pendulum_design: Design, criterion: str
) -> None:
    problem, time = pendulum_planner.problem, pendulum_planner.time
    moments = pendulum_planner.moments(
        pendulum_design.family.motion(pendulum_design.parameters, time)
    )
    size = problem.information.size
    prior, wanted, task = np.eye(5), np.array([0, 2, 3]), np.diag([1.0, 0, 2, 0, 0])
    covariance = np.linalg.inv(np.asarray(moments.normal) + prior)
    part = covariance[np.ix_(wanted, wanted)]
    error = np.sqrt(np.diag(part))
    of_torque = np.trace(part @ task[np.ix_(wanted, wanted)])
    plain = np.asarray(moments.plain)[np.ix_(wanted, wanted)]
    length = np.sqrt(np.diag(plain))
    expected = {
        "error": error.mean(),
        "worst": np.sum(error**8) ** 0.125,
        "A": np.sqrt(np.mean(error**2)),
        "D": np.linalg.det(part) ** (1 / 6),
        "E": np.sqrt(np.linalg.eigvalsh(part)[-1]),
        "torque": np.sqrt(of_torque),
        "overall": np.sqrt(error.mean() * np.sqrt(of_torque)),
        "condition": np.sqrt(np.linalg.cond(plain)),
        "scaled_condition": np.sqrt(np.linalg.cond(plain / np.outer(length, length))),
    }
    value = np.exp(
        log_criterion(
            criterion, moments, jnp.asarray(prior), jnp.asarray(wanted), jnp.asarray(task)
        )
    )
    np.testing.assert_allclose(value, expected[criterion], rtol=1e-6)
    assert size.shape == (5,)


def two_links() -> jc.CSLC:
    """An arm in a plane with bodies off their axes."""
    links = (
        jc.LinkParameters(3.0, np.array([0.2, 0.01, 0.0]), np.diag([0.02, 0.05, 0.06]), 0.1),
        jc.LinkParameters(1.0, np.array([0.1, 0.0, 0.02]), np.diag([0.004, 0.01, 0.012]), 0.0),
    )
    arm = dataclasses.replace(jc.examples.planar_arm(), links=links)
    return jc.derive(arm, lengths="numeric")


def test_changes_of_bodies_are_those_of_their_coefficients(rng: np.random.Generator) -> None:
    """A body's changed pseudo-inertia, by the network's way from links to coefficients."""
    network = two_links()
    assert network.robot.links is not None
    prior = body_prior(network, np.ones(network.size))
    links = list(network.robot.links)
    k = np.asarray(network.coefficients_from(links, viscous=[0.0, 0.0], dry=[0.0, 0.0]))
    change = 0.05 * rng.normal(size=(2, 10))
    unknowns = np.zeros(prior.to_coefficients.shape[1])
    for i, link in enumerate(links):
        symmetric = np.zeros((4, 4))
        symmetric[np.tril_indices(4)] = change[i]
        symmetric = np.where(np.eye(4) > 0, np.sqrt(2) * symmetric, symmetric + symmetric.T)
        root = np.linalg.cholesky(pseudo_inertia(body_of(link)))
        body = body_of_pseudo_inertia(root @ (np.eye(4) + symmetric) @ root.T)
        links[i] = link_of(body, float(link.motor_inertia))
        unknowns[10 * i : 10 * i + 10] = change[i]
    changed = np.asarray(network.coefficients_from(links, viscous=[0.0, 0.0], dry=[0.0, 0.0]))
    np.testing.assert_allclose(prior.to_coefficients @ unknowns, changed - k, atol=1e-12)


def test_errors_of_bodies_begin_at_what_the_file_leaves_open() -> None:
    """Nothing recorded: all of it; much recorded: what coefficients do not determine is left."""
    network = two_links()
    prior = body_prior(network, np.ones(network.size))
    weak = np.eye(network.size)
    for much, least, most in ((0.0, 1 - 1e-9, 1 + 1e-9), (1e8, 0.01, 0.9)):
        moments = Moments(much * weak, much * weak, weak)
        variances = np.asarray(body_variances(moments, weak, prior))
        assert least <= variances.mean() <= most
        assert np.all(variances <= 1 + 1e-9)


def test_a_design_for_bodies_is_better_than_its_start() -> None:
    network = two_links()
    limits = Limits.of(network.robot, {"position": [-2, 2], "velocity": 3, "torque": 80})
    goal = Goal("bodies")
    planner = Planner.of(network, limits, Noise(0.5, 1e-3), BSplines(2.0, 5), goal=goal)
    design = planner.design(Effort(1, 2, 8))
    start = random_parameters(
        planner.check, planner.rest_pose(np.random.default_rng(0)), np.random.default_rng(0)
    )
    assert design.use.feasible
    assert design.value < planner.criterion_value(start)
    assert design.value < 1.0


def test_other_limits_compile_nothing_more(pendulum_planner: Planner) -> None:
    """However many random states limits of torque leave, programs are those of all states."""
    compiled: list[str] = []

    def count(event: str, duration_secs: float, **kwargs: str | int) -> None:
        del duration_secs, kwargs
        if event.endswith("backend_compile_duration"):
            compiled.append(event)

    jax.monitoring.register_event_duration_secs_listener(count)
    network = pendulum_planner.problem.information.network
    tasks: list[np.ndarray] = []
    for torque in (30.0, 12.0, 9.0):
        compiled.clear()
        limits = dataclasses.replace(pendulum_planner.limits, torque=np.array([torque]))
        planner = Planner.of(
            network,
            limits,
            pendulum_planner.noise,
            pendulum_planner.family,
            knowledge=pendulum_planner.knowledge,
        )
        tasks.append(np.asarray(planner.problem.task))
    jax.monitoring.unregister_event_duration_listener(count)
    assert not compiled
    assert not np.allclose(tasks[1], tasks[2])


def test_an_infeasible_wish_names_the_limit() -> None:
    network = arms.pendulum("viscous")
    knowledge = Knowledge(np.array([0.5, 2.0, 3.0, 0.2]), None, np.full(4, np.inf))
    limits = Limits.of(network.robot, {"position": [-0.1, 0.1], "velocity": 3, "torque": 1})
    with pytest.raises(ValueError, match="at rest in any of 200 poses, torque of joint 1"):
        design_motion(network, limits, Noise(0.1), duration=1.0, knowledge=knowledge)


@pytest.mark.parametrize(
    ("arguments", "message"),
    [
        ({"goal": Goal("bodies")}, "criterion 'bodies': the file of .* has no masses"),
        ({"goal": Goal(wanted=["kd9"])}, "has no coefficient or group 'kd9'"),
        ({"family": "other"}, "family: expected splines, fourier, periodic, moves, got 'other'"),
        ({"start": np.zeros(2)}, "start: expected 1 positions"),
    ],
)
def test_arguments_that_do_not_fit_are_named(
    pendulum_planner: Planner, arguments: dict[str, Any], message: str
) -> None:
    with pytest.raises(ValueError, match=message):
        design_motion(
            pendulum_planner.problem.information.network,
            pendulum_planner.limits,
            Noise(0.1),
            **arguments,
        )


def test_wrong_goals_are_named() -> None:
    with pytest.raises(ValueError, match="criterion: expected overall, error, "):
        Goal("other")
    with pytest.raises(ValueError, match="criterion 'D' has no task; expected overall or"):
        Goal("D", task=(0, 0, 0))


@pytest.mark.parametrize(
    ("stated", "message"),
    [
        ({"velocity": -1, "position": [0, 1]}, "limit of velocity of joint 1 is -1"),
        ({"velocity": 1e-12, "position": [0, 1]}, "joint 1 is 1e-12; expected from 1e-06 to 1e"),
        ({"torque": 1e160, "velocity": 1, "position": [0, 1]}, "limit of torque of joint 1 is 1e"),
        ({"position": [0, 1]}, "no velocity limit of joint 1"),
        ({"velocity": 1, "position": [1, 0]}, "limits of position of joint 1 are 1 and 0"),
        ({"velocity": [1, 2], "position": [0, 1]}, "velocity: expected one number or 1"),
        ({"speed": 1}, "unknown entry 'speed'"),
    ],
)
def test_wrong_limits_are_named(stated: dict[str, Any], message: str) -> None:
    with pytest.raises(ValueError, match=message):
        Limits.of(jc.examples.pendulum(), stated)


def test_limits_of_mjcf_files_are_kept(tmp_path: Path) -> None:
    """A joint that may turn by 30° is not swung by 180°."""
    file = tmp_path / "arm.xml"
    file.write_text(
        """<mujoco><worldbody><body><joint name="hinge" axis="0 1 0" range="-30 30"/>
        <geom size="0.1" pos="0.3 0 0"/><body><joint name="spin" axis="1 0 0"/>
        <geom size="0.1" pos="0.3 0 0"/></body></body></worldbody>
        <actuator><motor joint="hinge" forcerange="-8 9"/></actuator></mujoco>"""
    )
    arm = jc.load_robot(file)
    limits = Limits.of(arm, {"velocity": 2.0})
    np.testing.assert_allclose(limits.high, [np.pi / 6, np.pi])
    np.testing.assert_allclose(limits.torque, [8.0, np.inf])
    assert limits.notes[0] == "position: not stated of spin; from -pi to pi rad"
    stated = Limits.of(arm, {"velocity": 2.0, "position": [-1.0, 1.0]})
    assert not any("position" in note for note in stated.notes)
    with pytest.raises(ValueError, match="no velocity limit of hinge of"):
        Limits.of(arm)


def test_margins_name_joints_as_the_robot_does() -> None:
    use = Use({"velocity": np.array([0.5, 0.9])}, names=("base", "elbow"))
    assert str(use) == "margins: velocity 10 % (elbow)"
    assert use.worst == "velocity of elbow (90 % of its limit)"


def test_margins_of_positions_are_kept_back_at_both_ends() -> None:
    stated = {"position": [[-1, 1], [0, 2]], "velocity": 1, "position_margin": [0.1, 0.2]}
    limits = Limits.of(jc.examples.planar_arm(), stated)
    np.testing.assert_allclose(limits.low, [-0.9, 0.2])
    np.testing.assert_allclose(limits.high, [0.9, 1.8])


def test_torque_between_samples_counts() -> None:
    """A check at few samples says at least what one at many samples finds."""
    network = arms.pendulum()
    k = np.array([0.5, 2.0, 0.1, 0.2, 0.3])
    stated = {"position": [-2, 2], "velocity": 3, "torque": 30, "power": 40}
    limits = Limits.of(network.robot, stated)
    family = BSplines(2.0, 8)
    parameters = np.random.default_rng(0).normal(size=(family.size, 1))
    coarse, fine = (
        DenseCheck(network, k, limits, family, rate=rate).use(parameters).joints
        for rate in (20.0, 5000.0)
    )
    for name, values in fine.items():
        assert np.all(coarse[name] >= values * (1 - 1e-6)), name


def test_the_searched_torque_bounds_torque_and_is_continuous_at_reversals(
    pendulum_planner: Planner, rng: np.random.Generator
) -> None:
    """Friction of both signs where a joint reverses, the model's torque where it moves."""
    problem = pendulum_planner.problem
    network, k = problem.information.network, pendulum_planner.knowledge.k
    q, qdd = rng.normal(size=(200, 1)), rng.normal(size=(200, 1))

    def bound_and_torque(qd: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
        regressor = network.regressor(jnp.asarray(q), jnp.asarray(qd), jnp.asarray(qdd))
        bound = problem._torque_bound(regressor, jnp.asarray(qd))
        return np.asarray(bound), np.abs(np.asarray(network.torque(k, q, qd, qdd)))

    speed = np.abs(rng.normal(size=(200, 1)))
    for qd in (speed, -speed, 1e-4 * speed):
        bound, torque = bound_and_torque(qd)
        assert np.all(bound >= torque - 1e-12)
    forward, backward = (bound_and_torque(np.full((200, 1), qd)) for qd in (1e-9, -1e-9))
    np.testing.assert_allclose(forward[0], backward[0], atol=1e-6)
    np.testing.assert_allclose(forward[0], np.maximum(forward[1], backward[1]), atol=1e-6)
    fast, torque = bound_and_torque(np.full((200, 1), 1e3))
    np.testing.assert_allclose(fast, torque, rtol=1e-6)


def test_a_motion_at_its_limit_of_torque_is_hardly_shrunk(pendulum_planner: Planner) -> None:
    """What lies between the search's samples narrows its limits, rather than the whole motion."""
    network, knowledge = pendulum_planner.problem.information.network, pendulum_planner.knowledge
    stated = {"position": [-2, 2], "velocity": 3, "torque": 4, "torque_margin": 0.0}
    limits = Limits.of(network.robot, stated)
    family = pendulum_planner.family
    planner = Planner.of(network, limits, Noise(0.1, 1e-4), family, knowledge=knowledge)
    design = planner.design(Effort(1, 4, 30))
    assert design.use.feasible
    assert design.use.joints["torque"].max() > 0.95
    assert design.scale > 0.995


def test_a_motion_that_cannot_start_is_shrunk_towards_a_pose_to_rest_in(
    pendulum_planner: Planner, rng: np.random.Generator
) -> None:
    check = pendulum_planner.check
    parameters = random_parameters(check, np.zeros(1), rng)
    parameters[0] = 1.1 * check.limits.high
    with pytest.raises(ValueError, match="at rest there, position"):
        check.scaled(parameters)
    found, use, factor = check.scaled(parameters, np.zeros(1))
    assert use.feasible
    assert 0.1 < factor < 1.0
    np.testing.assert_allclose(found, factor * parameters)


def test_families_by_name() -> None:
    assert [family_named(name, 6.0).duration for name in ("splines", "moves")] == [6.0, 6.0]
