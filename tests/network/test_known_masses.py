"""Known masses and centres of gravity as numbers in the algebra (thesis C.1.2)."""

from collections.abc import Callable
from pathlib import Path
from typing import Any, Literal

import numpy as np
import pytest

import jaxcslc as jc
from jaxcslc import CSLC
from jaxcslc.least_squares import Fixed, reidentify
from jaxcslc.manipulator import LinkInertia, LinkParameters, Manipulator, RobotError


ROUNDING = 1e-12  # of the largest torque; both sides round at 1e-15 per operation
DOWN = (0.0, -9.81, 0.0)
ROWS = [(0.0, 0.0, 0.0, 0.0), (0.5 * np.pi, 0.3, 0.1, 0.0), (0.0, 0.4, 0.0, 0.2)]
SAMPLES = 300

Lengths = Literal["symbolic", "numeric"]
RandomLinks = Callable[..., tuple[LinkParameters, ...]]


def with_known(
    robot: Manipulator, links: tuple[LinkParameters, ...], which: tuple[int, ...], what: str
) -> Manipulator:
    """The robot with masses ("m"), centres ("r") or both ("mr") of some links as numbers."""
    for link in which:
        parameters = links[link - 1]
        robot = robot.with_known(
            link,
            mass=float(parameters.mass) if "m" in what else None,
            centre_of_gravity=parameters.centre_of_gravity if "r" in what else None,
        )
    return robot


def motion(rng: np.random.Generator, joints: int) -> np.ndarray:
    return rng.uniform(-3.0, 3.0, (3, SAMPLES, joints))


def patterns_of(states: np.ndarray, torque: np.ndarray) -> jc.Patterns:
    pairs = np.ones(torque.shape, bool)
    q, qd, qdd = states
    return jc.Patterns(np.arange(len(torque)) * 0.01, q, qd, qdd, torque, pairs, pairs)


@pytest.mark.parametrize("what", ["m", "r", "mr"])
@pytest.mark.parametrize("form", ["full", "principal"])
@pytest.mark.parametrize(
    ("lengths", "evaluator"),
    [("symbolic", "tables"), ("numeric", "tables"), ("numeric", "rolled"), ("numeric", "unrolled")],
)
def test_torque_is_that_of_the_full_network(
    what: str,
    form: Literal["full", "principal"],
    lengths: Lengths,
    evaluator: Any,
    random_links: RandomLinks,
    rng: np.random.Generator,
) -> None:
    robot = Manipulator.from_modified_dh(ROWS, gravity=DOWN, inertia=form)
    links = random_links(rng, 3, principal=form == "principal")
    states = motion(rng, 3)[:, :5]
    full = jc.derive(robot, lengths="numeric")
    expected = np.asarray(full.torque(full.coefficients_from(links), *states))
    known = jc.derive(with_known(robot, links, (2, 3), what), lengths=lengths, evaluator=evaluator)
    k = known.coefficients_from(links)
    actual = np.asarray(known.torque(k, *states))
    assert np.max(np.abs(actual - expected)) < ROUNDING * np.max(np.abs(expected))
    np.testing.assert_allclose(
        [float(k[known.names.index(name)]) for name in known.known_values],
        list(known.known_values.values()),
        rtol=1e-13,
    )


def test_links_that_move(
    mujoco_torque: Callable[..., Any], random_links: RandomLinks, rng: np.random.Generator
) -> None:
    """MuJoCo's torques determine the other coefficients, and predict with all of them."""
    robot = Manipulator.from_modified_dh(ROWS, gravity=DOWN, friction=())
    links = random_links(rng, 3)
    mujoco = mujoco_torque(ROWS, "RRR", DOWN, links)
    network = jc.derive(with_known(robot, links, (2, 3), "mr"), lengths="numeric")
    assert list(network.known_values.values()) == [float(links[1].mass), float(links[2].mass)]
    states, others = motion(rng, 3), motion(rng, 3)
    fit = jc.LeastSquares().fit(network, patterns_of(states, mujoco(*states)))
    error = np.asarray(network.torque(fit.k, *others)) - mujoco(*others)
    assert np.max(np.abs(error)) < 1e-9 * np.max(np.abs(mujoco(*others)))


@pytest.mark.parametrize("what", ["m", "r", "mr"])
@pytest.mark.parametrize("which", [(2,), (3,), (2, 3)])
@pytest.mark.parametrize("lengths", ["symbolic", "numeric"])
def test_number_of_unknown_coefficients(
    what: str,
    which: tuple[int, ...],
    lengths: Lengths,
    random_links: RandomLinks,
    rng: np.random.Generator,
) -> None:
    """Coefficients of random links that share what is known span as many dimensions."""
    robot = Manipulator.from_modified_dh(ROWS, gravity=DOWN, friction=())
    full = jc.derive(robot, lengths=lengths)
    links = random_links(rng, 3)
    draws: list[np.ndarray] = []
    for _ in range(3 * full.size):
        others = random_links(rng, 3)
        mixed = [
            LinkParameters(
                a.mass if i in which and "m" in what else b.mass,
                a.centre_of_gravity if i in which and "r" in what else b.centre_of_gravity,
                b.inertia,
                b.motor_inertia,
            )
            for i, (a, b) in enumerate(zip(links, others, strict=True), start=1)
        ]
        draws.append(np.asarray(full.coefficients_from(mixed)))
    spread = np.array(draws) - draws[0]
    spread /= np.maximum(np.linalg.norm(spread, axis=0), 1e-9)
    known = jc.derive(with_known(robot, links, which, what), lengths=lengths)
    unknown = known.size - len(known.known_values)
    if lengths == "numeric":
        assert np.linalg.matrix_rank(spread, rtol=1e-9) == unknown
    else:  # with symbols, products with different lengths are apart: numbers relate more of them
        assert np.linalg.matrix_rank(spread, rtol=1e-9) <= unknown <= full.size


def test_gravity_torque_is_known(rng: np.random.Generator) -> None:
    """Of a PUMA 560 whose masses and centres are known; link 1 turns about the vertical."""
    puma = jc.puma560()
    assert puma.links is not None
    network = jc.derive(with_known(puma, puma.links, (2, 3, 4, 5, 6), "mr"))
    assert len(network.known_values) == 17
    k = np.array([network.known_values.get(name, 0.0) for name in network.names])
    full = jc.derive(puma)
    q = rng.uniform(-3.0, 3.0, (16, 6))
    expected = np.asarray(full.gravity_term(full.coefficients_from(puma.links), q))
    np.testing.assert_allclose(network.gravity_term(k, q), expected, rtol=0, atol=1e-12)


def noisy(
    network: CSLC, links: tuple[LinkParameters, ...], rng: np.random.Generator
) -> jc.Patterns:
    states = motion(rng, 3)
    torque = np.asarray(network.torque(network.coefficients_from(links), *states))
    return patterns_of(states, torque + 0.1 * rng.standard_normal(torque.shape))


@pytest.fixture
def arm(random_links: RandomLinks, rng: np.random.Generator) -> tuple[CSLC, jc.Patterns]:
    """Three joints, link 3 known, and patterns with noise."""
    robot = Manipulator.from_modified_dh(ROWS, gravity=DOWN)
    links = random_links(rng, 3)
    network = jc.derive(with_known(robot, links, (3,), "mr"), lengths="numeric")
    return network, noisy(network, links, rng)


def test_fit_keeps_numbers(arm: tuple[CSLC, jc.Patterns]) -> None:
    """The others minimise the torque error, as NumPy says, less what the numbers explain."""
    network, patterns = arm
    fit = jc.LeastSquares(joint_weights="equal").fit(network, patterns)
    regressor = np.asarray(network.regressor(patterns.q, patterns.qd, patterns.qdd))
    matrix, target = regressor.reshape(-1, network.size), np.asarray(patterns.torque).ravel()
    fixed = [network.names.index(name) for name in network.known_values]
    free = np.setdiff1d(np.arange(network.size), fixed)
    values = np.array(list(network.known_values.values()))
    expected = np.linalg.lstsq(matrix[:, free], target - matrix[:, fixed] @ values)[0]
    np.testing.assert_allclose(np.asarray(fit.k)[fixed], values, rtol=1e-15)
    np.testing.assert_allclose(np.asarray(fit.k)[free], expected, rtol=1e-8, atol=1e-10)
    variances = np.diag(np.asarray(fit.covariance))
    assert np.all(variances[fixed] == 0.0) and np.all(variances[free] > 0.0)


def test_fit_of_a_stream_keeps_numbers(arm: tuple[CSLC, jc.Patterns]) -> None:
    network, patterns = arm
    solver = jc.LeastSquares(errors="independent")
    pieces = (patterns.between(start, start + 1.0) for start in (0.0, 1.0, 2.0))
    streamed = solver.fit_stream(network, pieces)
    np.testing.assert_allclose(streamed.k, solver.fit(network, patterns).k, rtol=1e-7, atol=1e-9)
    assert set(np.asarray(streamed.k)) >= set(network.known_values.values())


def test_reidentification_keeps_numbers(arm: tuple[CSLC, jc.Patterns]) -> None:
    network, patterns = arm
    first = jc.LeastSquares().fit(network, patterns)
    again = reidentify(network, patterns, first, groups=["base"])
    for name, value in network.known_values.items():
        assert float(again.k[network.names.index(name)]) == value


def test_nothing_is_fixed_without_numbers(puma: CSLC) -> None:
    assert puma.known_values == {} and Fixed.from_known(puma) is None


def test_robot_file(tmp_path: Path) -> None:
    text = """
        name = "arm"
        gravity = [0, -9.81, 0]
        [[joint]]
        alpha = 0
        a = 0
        d = 0
        [[joint]]
        alpha = 0
        a = 0.5
        d = 0
        [joint.link]
        known = ["mass", "centre_of_gravity"]
        mass = 3.0
        centre_of_gravity = [0.2, 0, 0]
    """
    path = tmp_path / "arm.toml"
    path.write_text(text, encoding="utf-8")
    robot = jc.load_robot(path)
    assert robot.links is None
    assert robot.inertia[1] == LinkInertia(mass=3.0, centre=(0.2, 0.0, 0.0))
    assert jc.derive(robot, lengths="numeric").known_values == {"kB6": 3.0}
    for old, new, message in (
        ('"mass", ', '"weight", ', "known: expected mass or centre_of_gravity, got 'weight'"),
        ("mass = 3.0", "", "mass is listed as known and has no value"),
        ("mass = 3.0", "mass = 0.0", "known mass: expected more than 0 kg"),
    ):
        path.write_text(text.replace(old, new), encoding="utf-8")
        with pytest.raises(RobotError, match=message):
            jc.load_robot(path)


@pytest.mark.parametrize(
    ("link", "values", "message"),
    [
        (4, {"mass": 1.0}, "no link 4; expected 1 to 3"),
        (0, {"mass": 1.0}, "no link 0"),
        (2, {"mass": -1.0}, "link 2: known mass: expected more than 0 kg, got -1.0"),
        (2, {"mass": np.nan}, "known mass"),
        (2, {"centre_of_gravity": (0.0, 1.0)}, "expected three finite numbers"),
        (2, {"centre_of_gravity": (0.0, 1.0, np.inf)}, "expected three finite numbers"),
    ],
)
def test_values_that_no_link_has(link: int, values: dict[str, Any], message: str) -> None:
    robot = Manipulator.from_modified_dh(ROWS, gravity=DOWN)
    with pytest.raises(RobotError, match=message):
        robot.with_known(link, **values)


def test_values_that_zero_excludes() -> None:
    with pytest.raises(RobotError, match=r"rx is listed as zero, got 0.1"):
        LinkInertia(zero=("rx",), centre=(0.1, 0.0, 0.0))
    with pytest.raises(RobotError, match="mass is listed as zero"):
        LinkInertia(zero=("m", "rx", "ry", "rz"), mass=1.0)


def test_length_without_a_value() -> None:
    rows = [(0, 0, 0, 0), (0, "a1", 0, 0)]
    robot = Manipulator.from_modified_dh(rows, gravity=DOWN)
    robot = robot.with_known(2, mass=1.0, centre_of_gravity=(0.1, 0.0, 0.0))
    with pytest.raises(RobotError, match="'a1' has no value"):
        _ = jc.derive(robot).known_values


def test_links_that_differ_from_the_numbers(arm: tuple[CSLC, jc.Patterns]) -> None:
    network, _ = arm
    nothing = LinkParameters(0.0, np.zeros(3), np.zeros((3, 3)))
    with pytest.raises(ValueError, match=r"link 3 has mass 0.0; the network has the known number"):
        network.coefficients_from([nothing] * 3)


def test_what_does_not_know_numbers_refuses(arm: tuple[CSLC, jc.Patterns]) -> None:
    """Each says so in one line, and what to do."""
    network, patterns = arm
    recording = jc.Recording(patterns.time, np.asarray(patterns.q), np.asarray(patterns.torque))
    with pytest.raises(ValueError, match=r"identify: .* known masses .* prior"):
        jc.identify(network, recording)
    fit = jc.LeastSquares().fit(network, patterns)
    with pytest.raises(ValueError, match="are fixed by `with_known`"):
        jc.physical_parameters(network, fit)
    fold = np.arange(SAMPLES) % 3
    with pytest.raises(ValueError, match=r"folds: kB.* are fixed by known masses"):
        jc.LeastSquares().fit_folds(network, patterns, fold)
    with pytest.raises(ValueError, match=r"equations: kB.* are fixed by known masses"):
        jc.LeastSquares().equations(network, patterns)
