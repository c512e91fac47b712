"""What holds between the network's functions, whatever the robot."""

from collections.abc import Callable
from typing import Any

import hypothesis
import jax
import jax.numpy as jnp
import numpy as np
import pytest
from hypothesis import strategies as st

import jaxcslc
from jaxcslc.manipulator import LinkInertia, LinkParameters, Manipulator
from jaxcslc.network import RigidBodyTables


# Of the largest entry: a few hundred products of numbers below ten, in float64.
ROUNDING = 1e-12

# Functions are called as they are: compiling each as a whole would take longer than what it saves.
# The operations' own compiled forms are shared by tests that use the same shapes.
NETWORKS = [
    "puma560",
    "elbow",
    "prismatic-first",
    "prismatic-first-recursive",
    "panda",
]


@pytest.fixture(params=NETWORKS)
def case(request: pytest.FixtureRequest, cases: Callable[[str], Any]) -> Any:
    return cases(request.param)


def assert_equal(actual: Any, expected: Any, *, of: Any = None, rounding: float = ROUNDING) -> None:
    """Equal to rounding, relative to the largest entry of `of`."""
    actual, expected = np.asarray(actual), np.asarray(expected)
    assert actual.shape == expected.shape
    scale = np.max(np.abs(expected if of is None else np.asarray(of)))
    assert np.max(np.abs(actual - expected)) <= rounding * scale


def test_regressor_times_k_is_torque(case: Any, rng: np.random.Generator) -> None:
    states = case.states(rng)
    regressor = case.network.regressor(*states)
    assert regressor.shape == (16, case.network.joint_count, case.network.size)
    assert_equal(regressor @ case.k, case.network.torque(case.k, *states))


def test_torque_is_linear_in_k(case: Any, rng: np.random.Generator) -> None:
    states = case.states(rng)
    one, other = rng.standard_normal((2, case.network.size))
    assert_equal(
        case.network.torque(2 * one - 3 * other, *states),
        2 * case.network.torque(one, *states) - 3 * case.network.torque(other, *states),
    )


def test_columns_are_the_regressor_without_its_zeros(case: Any, rng: np.random.Generator) -> None:
    q, qd, qdd = case.states(rng)
    full = np.asarray(case.network.regressor(q, qd, qdd))
    columns = case.network.columns(*(jnp.asarray(x.T) for x in (q, qd, qdd)))
    rebuilt = np.zeros_like(full)
    for joint, (support, rows) in enumerate(zip(case.network.support, columns, strict=True)):
        assert list(support) == sorted(set(support))
        rebuilt[:, joint, list(support)] = np.asarray(rows).T
    assert_equal(rebuilt, full)


def test_host_and_compiled_columns_agree(case: Any, rng: np.random.Generator) -> None:
    network = case.network
    assert network.has_host_columns
    motion = [x.T for x in case.states(rng)]
    on_host = network.columns(*motion)
    compiled = network.columns(*map(jnp.asarray, motion))
    for host, other in zip(on_host, compiled, strict=True):
        assert isinstance(host, np.ndarray)
        assert_equal(host, np.asarray(other), of=np.concatenate(on_host))


def test_terms_add_up(case: Any, rng: np.random.Generator) -> None:
    network, k = case.network, case.k
    q, qd, qdd = case.states(rng)
    total = (
        jnp.einsum("...ij,...j->...i", network.mass_matrix(k, q), qdd)
        + network.velocity_term(k, q, qd)
        + network.gravity_term(k, q)
        + network.friction_term(k, qd)
    )
    assert_equal(network.torque(k, q, qd, qdd), total)


def test_special_cases_of_torque(case: Any, rng: np.random.Generator) -> None:
    network, k = case.network, case.k
    q, qd, qdd = case.states(rng)
    zero = np.zeros_like(q)
    torque = network.torque(k, q, qd, qdd)
    offset = network.friction_term(k, zero)
    assert_equal(network.torque(k, q, zero, zero), network.gravity_term(k, q) + offset, of=torque)
    unmoved = network.torque(k, q, qd, zero) - network.torque(k, q, zero, zero) + offset
    assert_equal(unmoved, network.velocity_term(k, q, qd) + network.friction_term(k, qd), of=torque)
    pushed = network.torque(k, q, zero, qdd) - network.torque(k, q, zero, zero)
    mass = network.mass_matrix(k, q)
    assert_equal(pushed, jnp.einsum("...ij,...j->...i", mass, qdd), of=torque)


def test_no_velocity_no_velocity_term(case: Any, rng: np.random.Generator) -> None:
    q, qd, _ = case.states(rng)
    assert np.all(np.asarray(case.network.velocity_term(case.k, q, 0 * qd)) == 0)
    # Quadratic in the velocity.
    once = case.network.velocity_term(case.k, q, qd)
    assert_equal(case.network.velocity_term(case.k, q, -2 * qd), 4 * once)


def test_mass_matrix_is_symmetric_and_positive(case: Any, rng: np.random.Generator) -> None:
    q, _, _ = case.states(rng)
    mass = np.asarray(case.network.mass_matrix(case.k, q))
    assert_equal(mass, np.swapaxes(mass, -1, -2))
    assert np.all(np.linalg.eigvalsh(mass) > 0)


def christoffel_matrix(case: Any, q: np.ndarray, qd: np.ndarray) -> jax.Array:
    """C of V = C qd from the network's symbols c_ijk, which are listed for j <= k (2.4-5)."""
    network = case.network
    n = network.joint_count
    k = jnp.asarray(case.k)[network.layout.inertial]
    rows = [[jnp.zeros(q.shape[:-1]) for _ in range(n)] for _ in range(n)]
    for (i, j, m), value in network.rigid_body.christoffel_symbols(k, jnp.asarray(q)).items():
        rows[i][j] = rows[i][j] + value * qd[..., m]
        if j != m:
            rows[i][m] = rows[i][m] + value * qd[..., j]
    return jnp.stack([jnp.stack(row, axis=-1) for row in rows], axis=-2)


@pytest.mark.parametrize("name", ["puma560", "elbow", "stanford", "prismatic-first"])
def test_rate_of_mass_less_twice_coriolis_is_skew(
    cases: Callable[[str], Any], rng: np.random.Generator, name: str
) -> None:
    case = cases(name)
    assert isinstance(case.network.rigid_body, RigidBodyTables)
    q, qd, _ = case.states(rng)
    _, rate = jax.jvp(lambda q: case.network.mass_matrix(case.k, q), (q,), (qd,))
    coriolis = christoffel_matrix(case, q, qd)
    skew = rate - 2 * coriolis
    assert_equal(skew, -jnp.swapaxes(skew, -1, -2), of=coriolis)
    assert_equal(
        jnp.einsum("...ij,...j->...i", coriolis, qd), case.network.velocity_term(case.k, q, qd)
    )


def test_coriolis_forces_do_no_work_of_their_own(case: Any, rng: np.random.Generator) -> None:
    """qd' (dM/dt) qd = 2 qd' V: what remains of skewness where there is no C."""
    q, qd, _ = case.states(rng)
    _, rate = jax.jvp(lambda q: case.network.mass_matrix(case.k, q), (q,), (qd,))
    power = jnp.einsum("ni,nij,nj->n", qd, rate, qd)
    assert_equal(2 * jnp.sum(qd * case.network.velocity_term(case.k, q, qd), axis=-1), power)


def derivative(function: Callable[[np.ndarray], jax.Array], q: np.ndarray) -> jax.Array:
    """Partial derivatives with respect to every joint of each sample, on a new last axis."""
    units = np.broadcast_to(np.eye(q.shape[-1])[:, None], (q.shape[-1], *q.shape))
    return jnp.stack([jax.jvp(function, (q,), (unit,))[1] for unit in units], axis=-1)


def test_velocity_term_is_lagranges(case: Any, rng: np.random.Generator) -> None:
    """V = (dM/dt) qd - grad(qd' M qd) / 2, differentiated automatically."""
    q, qd, _ = case.states(rng)
    slopes = derivative(lambda q: case.network.mass_matrix(case.k, q), q)
    lagrange = jnp.einsum("nijk,nj,nk->ni", slopes, qd, qd) - 0.5 * jnp.einsum(
        "njki,nj,nk->ni", slopes, qd, qd
    )
    assert_equal(case.network.velocity_term(case.k, q, qd), lagrange)


def test_gravity_has_a_potential(case: Any, rng: np.random.Generator) -> None:
    q, _, _ = case.states(rng)
    stiffness = derivative(lambda q: case.network.gravity_term(case.k, q), q)
    gravity = case.network.gravity_term(case.k, q)
    assert_equal(stiffness, jnp.swapaxes(stiffness, -1, -2), of=gravity)


def test_forward_dynamics_undoes_torque(case: Any, rng: np.random.Generator) -> None:
    network, k = case.network, case.k
    q, qd, qdd = case.states(rng)
    torque = network.torque(k, q, qd, qdd)
    condition = np.max(np.linalg.cond(np.asarray(network.mass_matrix(k, q))))
    bias = np.max(np.abs(np.asarray(torque)))
    smallest = np.min(np.linalg.eigvalsh(np.asarray(network.mass_matrix(k, q))))
    recovered = network.forward_dynamics(k, q, qd, torque)
    # Rounding of the torque, seen through the inverse of M.
    error = ROUNDING * (condition * np.max(np.abs(qdd)) + bias / smallest)
    assert np.max(np.abs(np.asarray(recovered) - qdd)) < error


def test_without_forces_nothing_accelerates() -> None:
    robot = jaxcslc.puma560().with_gravity((0, 0, 0))
    network = jaxcslc.derive(robot, lengths="numeric")
    assert robot.links is not None
    k = network.coefficients_from(robot.links)
    zero = np.zeros((3, 6))
    assert np.all(np.asarray(network.forward_dynamics(k, zero + 0.3, zero, zero)) == 0)


@pytest.mark.parametrize(
    "name", ["puma560-base", "stanford", "prismatic-first-recursive"], ids=lambda name: name
)
def test_evaluators_agree(cases: Callable[[str], Any], rng: np.random.Generator, name: str) -> None:
    case = cases(name)
    robot = case.network.robot
    tables, recursive = (
        jaxcslc.derive(robot, lengths="numeric", evaluator=evaluator)
        for evaluator in ("tables", "recursive")
    )
    assert tables.names == recursive.names
    q, qd, qdd = case.states(rng)
    torque = tables.torque(case.k, q, qd, qdd)
    assert_equal(recursive.torque(case.k, q, qd, qdd), torque)
    assert_equal(recursive.regressor(q, qd, qdd), tables.regressor(q, qd, qdd))
    assert_equal(recursive.mass_matrix(case.k, q), tables.mass_matrix(case.k, q))
    assert_equal(recursive.velocity_term(case.k, q, qd), tables.velocity_term(case.k, q, qd))
    assert_equal(recursive.gravity_term(case.k, q), tables.gravity_term(case.k, q))
    assert_equal(
        recursive.forward_dynamics(case.k, q, qd, torque),
        tables.forward_dynamics(case.k, q, qd, torque),
        rounding=1e-9,  # the mass matrix's condition number
    )
    # The recursion knows less of what vanishes, and may count in more.
    for few, many in zip(tables.support, recursive.support, strict=True):
        assert set(few) <= set(many)


def test_symbolic_and_numeric_lengths_agree(
    rng: np.random.Generator, cases: Callable[[str], Any]
) -> None:
    for name in ("puma560", "elbow"):
        case = cases(name)
        robot = case.network.robot.with_friction()
        states = case.states(rng)
        torques: list[Any] = []
        for lengths in ("symbolic", "numeric"):
            network = jaxcslc.derive(robot, lengths=lengths)
            torques.append(network.torque(network.coefficients_from(case.links), *states))
        assert_equal(*torques)


def test_principal_axes_parallel_to_the_frame(
    rng: np.random.Generator, random_links: Callable[..., tuple[LinkParameters, ...]]
) -> None:
    """For such bodies the substitution of Eqn. 2.3-20 loses nothing."""
    rows = [(0.0, 0.0, 0.3, 0.0), ("pi/2", 0.1, 0.0, 0.2), (0.7, 0.4, -0.1, 0.0)]
    links = random_links(rng, 3, principal=True)
    states = rng.uniform(-3, 3, (3, 16, 3))
    torques: list[Any] = []
    for form in ("full", "principal"):
        robot = Manipulator.from_modified_dh(rows, kinds="RRP", inertia=form, friction=())
        network = jaxcslc.derive(robot, lengths="numeric")
        torques.append(network.torque(network.coefficients_from(links), *states))
    assert_equal(*torques)


@pytest.mark.parametrize("form", ["full", "principal"])
def test_what_is_zero_or_equal_may_be_left_out(
    rng: np.random.Generator,
    random_links: Callable[..., tuple[LinkParameters, ...]],
    form: Any,
) -> None:
    """A pattern of zero and equal entries, on links that have it, changes no torque."""
    rows = [(0.3, 0.1, 0.3, 0.0), ("pi/2", 0.1, 0.0, 0.2), (0.7, 0.4, -0.1, 0.0)]
    first, second, third = random_links(rng, 3)
    links = (
        LinkParameters(0.0, np.zeros(3), np.zeros((3, 3)), 0.0),  # without mass and motor
        LinkParameters(
            second.mass,
            np.array([0.0, 0.1, 0.0]),
            np.diag([0.3, 0.3, 0.2]) if form == "principal" else np.diag([0.1, 0.2, 0.25]),
            second.motor_inertia,
        ),
        LinkParameters(third.mass, first.centre_of_gravity, np.diag([0.3, 0.4, 0.5]), 0.1),
    )
    everything = ("m", "rx", "ry", "rz", "Ixx", "Iyy", "Izz")
    products = () if form == "principal" else ("Ixy", "Ixz", "Iyz")
    equal = (("Ixx", "Iyy"),) if form == "principal" else ()
    patterns = [
        LinkInertia(form, zero=(*everything, *products), motor=False),
        LinkInertia(form, zero=("rx", "rz", *products), equal=equal),
        LinkInertia(form),
    ]
    states = rng.uniform(-3, 3, (3, 16, 3))
    networks = [
        jaxcslc.derive(
            Manipulator.from_modified_dh(rows, inertia=inertia, friction=()), lengths="numeric"
        )
        for inertia in (form, patterns)
    ]
    torques = [network.torque(network.coefficients_from(links), *states) for network in networks]
    assert_equal(*torques)
    assert networks[1].size < networks[0].size


@pytest.mark.parametrize("kind", [np.array, jnp.array])
def test_friction_may_be_given_as_arrays(kind: Callable[..., Any]) -> None:
    robot = jaxcslc.puma560()
    network = jaxcslc.derive(robot)
    assert robot.links is not None and robot.viscous is not None
    k = network.coefficients_from(robot.links, viscous=kind(robot.viscous))
    assert np.array_equal(k, network.coefficients_from(robot.links, viscous=robot.viscous))


def test_friction_is_each_joints_own(rng: np.random.Generator) -> None:
    terms = ("viscous", "dry", "offset")
    robot = Manipulator.from_modified_dh(
        [(0, 0, 0.2, 0), ("pi/2", 0.1, 0, 0)], kinds="RP", friction=terms
    )
    network = jaxcslc.derive(robot)
    viscous, dry, offset = rng.uniform(0.1, 2.0, (3, 2))
    nothing = [LinkParameters(0.0, np.zeros(3), np.zeros((3, 3)))] * 2
    k = network.coefficients_from(
        nothing, viscous=viscous.tolist(), dry=dry.tolist(), offset=offset.tolist()
    )
    qd = rng.uniform(-3, 3, (16, 2))
    qd[0] = 0.0
    # Eqn. 2.5-3; no dry friction at rest, where its sign is unknown.
    expected = viscous * qd + dry * np.sign(qd) + offset
    assert_equal(network.friction_term(k, qd), expected)
    assert_equal(network.torque(k, 0 * qd, qd, 0 * qd), expected)
    friction = network.coefficients[-6:]
    assert [coefficient.name for coefficient in friction] == [
        "kv1",
        "kv2",
        "kd1",
        "kd2",
        "ko1",
        "ko2",
    ]
    assert [coefficient.group for coefficient in friction] == [
        term for term in terms for _ in range(2)
    ]
    assert [coefficient.unit for coefficient in friction] == [
        "N m s/rad",
        "N s/m",
        "N m",
        "N",
        "N m",
        "N",
    ]
    # Friction opposes motion; a sensor's zero may lie on either side.
    assert [coefficient.positive for coefficient in friction] == [True] * 4 + [False] * 2


@st.composite
def chains(draw: st.DrawFn) -> tuple[list[tuple[float, ...]], str]:
    """Rows and kinds of one to three joints: any angles and lengths, right angles among them."""
    angle = st.one_of(
        st.sampled_from([0.0, np.pi / 2, -np.pi / 2, np.pi]),
        st.floats(-3, 3).map(lambda x: x + 1e-3),
    )
    length = st.one_of(st.just(0.0), st.floats(-1, 1))
    rows = draw(st.lists(st.tuples(angle, length, length, angle), min_size=1, max_size=3))
    return rows, draw(st.text("RP", min_size=len(rows), max_size=len(rows)))


@hypothesis.settings(max_examples=8)
@hypothesis.given(chain=chains(), offset=st.floats(-2, 2))
def test_an_offset_is_a_shift_of_the_joint_variable(
    chain: tuple[list[tuple[float, ...]], str], offset: float
) -> None:
    """theta of a revolute joint and d of a prismatic one are added to what the encoder says.

    The one robot is computed through tables, the other by recursion.
    """
    rows, kinds = chain
    moved = [
        (alpha, a, d + offset * (kind == "P"), theta + offset * (kind == "R"))
        for (alpha, a, d, theta), kind in zip(rows, kinds, strict=True)
    ]
    rng = np.random.default_rng(7)
    q, qd, qdd = rng.uniform(-2, 2, (3, 16, len(rows)))
    body = LinkParameters(2.0, np.array([0.1, -0.2, 0.15]), np.diag([0.3, 0.4, 0.5]), 0.1)
    torques: list[Any] = []
    cases: list[tuple[Any, float, Any]] = [(rows, offset, "tables"), (moved, 0.0, "recursive")]
    for frames, shift, evaluator in cases:
        robot = Manipulator.from_modified_dh(
            frames, kinds=kinds, gravity=(1.0, -2.0, 9.0), friction=()
        )
        network = jaxcslc.derive(robot, lengths="numeric", evaluator=evaluator)
        k = network.coefficients_from([body] * len(rows))
        torques.append(network.torque(k, q + shift, qd, qdd))
    # Angles are replaced by rational ones nearby, better than 1e-9 away from simple fractions.
    assert_equal(*torques, of=np.append(np.abs(torques[0]), 1.0), rounding=1e-8)
