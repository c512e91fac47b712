"""Torque constants from currents: exact without noise, their intervals with it, and refusals."""

import tomllib
from pathlib import Path

import numpy as np
import pytest

import jaxcslc as jc
from jaxcslc.identification import fit_torque_constants, identify_torque_constants
from jaxcslc.least_squares import LeastSquares
from tests.conftest import run


CONSTANTS = np.array([8.0, -3.0])  # with a joint whose current counts the other way
MASS = 2.0
BODY = jc.LinkParameters(MASS, np.array([0.1, 0.02, 0.03]), 0.01 * np.eye(3))
LINK = jc.LinkParameters(5.0, np.array([0.2, 0.01, 0.02]), 0.05 * np.eye(3))
SAMPLES = 600


@pytest.fixture(scope="module")
def network() -> jc.CSLC:
    rows = [(0, 0, 0, 0), ("pi/2", 0.4, 0, 0)]
    robot = jc.Manipulator.from_modified_dh(rows, gravity=(0, -9.81, 0))
    return jc.derive(robot, lengths="numeric").with_payload()


@pytest.fixture(scope="module")
def exact(network: jc.CSLC) -> tuple[jc.Patterns, jc.Patterns]:
    """Unloaded and loaded motion, and the currents that go with it."""
    links = [LINK, LINK]
    k = network.coefficients_from(links, viscous=[1.0, 0.5], dry=[0.7, 0.4], payload=BODY)
    payload = network.layout.payload
    patterns: list[jc.Patterns] = []
    for carried, shift in ((False, 0.0), (True, 1.0)):
        t = np.arange(SAMPLES) * 0.02
        rate, phase = np.array([1.1, 1.7]), np.array([0.0, 1.0]) + shift
        angle = np.outer(t, rate) + phase
        q, qd, qdd = np.sin(angle), rate * np.cos(angle), -(rate**2) * np.sin(angle)
        coefficients = k * np.where(np.arange(network.size) >= payload.start, carried, True)
        current = np.asarray(network.torque(coefficients, q, qd, qdd)) / CONSTANTS
        pairs = np.ones(q.shape, bool)
        patterns.append(jc.Patterns(t, q, qd, qdd, current, pairs, pairs))
    return patterns[0], patterns[1]


def noisy(patterns: jc.Patterns, rng: np.random.Generator, size: float) -> jc.Patterns:
    current = np.asarray(patterns.torque)
    motion = (patterns.time, patterns.q, patterns.qd, patterns.qdd)
    noise = size * rng.standard_normal(current.shape)
    return jc.Patterns(*motion, current + noise, patterns.backlash_mask, patterns.friction_mask)


def test_exact_currents_give_exact_constants(
    network: jc.CSLC, exact: tuple[jc.Patterns, jc.Patterns]
) -> None:
    result = fit_torque_constants(network, *exact, MASS)
    np.testing.assert_allclose(result.constants, CONSTANTS, rtol=1e-7)
    assert result.joint_names == ("joint 1", "joint 2")
    assert result.undetermined == ()
    assert "constant = [8, -3]" in str(result)
    twice = fit_torque_constants(network, *exact, 2 * MASS)
    np.testing.assert_allclose(twice.constants, 2 * CONSTANTS, rtol=1e-7)


def test_intervals_hold_the_truth(
    network: jc.CSLC, exact: tuple[jc.Patterns, jc.Patterns], rng: np.random.Generator
) -> None:
    """Noise of 5 % of the currents: no attenuation, as a regression on them would have."""
    solver = LeastSquares(errors="independent")
    results = [
        fit_torque_constants(
            network, noisy(exact[0], rng, 0.05), noisy(exact[1], rng, 0.05), MASS, solver=solver
        )
        for _ in range(12)
    ]
    scores = np.array([(r.constants - CONSTANTS) / r.standard_error for r in results])
    # 24 scores in correlated pairs: their mean square is 1 with a deviation of about 0.4, and the
    # mean of each constant's is 0 with one of 0.3.
    assert 0.3 < np.mean(scores**2) < 2.2
    assert np.all(np.abs(np.mean(scores, axis=0)) < 0.9)


def test_a_joint_that_says_nothing_is_refused(
    network: jc.CSLC, exact: tuple[jc.Patterns, jc.Patterns]
) -> None:
    """Every sample of joint 2 is masked."""
    masks = np.ones((SAMPLES, 2), bool) & [True, False]
    masked = [
        jc.Patterns(p.time, p.q, p.qd, p.qdd, p.torque, p.backlash_mask, masks) for p in exact
    ]
    with pytest.raises(ValueError, match="do not determine the torque constant of joint 2"):
        fit_torque_constants(network, masked[0], masked[1], MASS)


def test_recordings_in_the_wrong_order_are_refused(
    network: jc.CSLC, exact: tuple[jc.Patterns, jc.Patterns]
) -> None:
    """They fit as well, by constants and coefficients of the other sign."""
    with pytest.raises(ValueError, match=r"friction drives the arm .* without the payload first"):
        fit_torque_constants(network, exact[1], exact[0], MASS)


def test_units_are_those_of_the_joints(exact: tuple[jc.Patterns, jc.Patterns]) -> None:
    """A joint that slides has a force for each ampere."""
    rows = [(0, 0, 0, 0), ("pi/2", 0.4, 0, 0)]
    robot = jc.Manipulator.from_modified_dh(rows, kinds="RP", gravity=(0, -9.81, 0))
    network = jc.derive(robot, lengths="numeric").with_payload()
    k = np.full(network.size, 0.3)
    k[network.layout.payload] = 0.01, 0.01, 0.02, 0, 0, 0, 0.1, 0.05, 0, MASS
    recorded: list[jc.Patterns] = []
    for patterns, carried in zip(exact, (0.0, 1.0), strict=True):
        factors = np.ones(network.size)
        factors[network.layout.payload] = carried
        motion = np.asarray(patterns.q), np.asarray(patterns.qd), np.asarray(patterns.qdd)
        current = np.asarray(network.torque(factors * k, *motion)) / CONSTANTS
        pairs = np.ones(current.shape, bool)
        recorded.append(jc.Patterns(patterns.time, *motion, current, pairs, pairs))
    result = fit_torque_constants(network, recorded[0], recorded[1], MASS)
    assert [row["unit"] for row in result.rows()] == ["N m/A", "N/A"]
    np.testing.assert_allclose(result.constants, CONSTANTS, rtol=1e-6)


@pytest.mark.parametrize("mass", [0.0, -1.0, np.nan, np.inf])
def test_mass_is_positive(
    network: jc.CSLC, exact: tuple[jc.Patterns, jc.Patterns], mass: float
) -> None:
    with pytest.raises(ValueError, match="mass of the payload is"):
        fit_torque_constants(network, *exact, mass)


def test_recordings_are_named_in_errors(network: jc.CSLC) -> None:
    t = np.arange(10) * 0.01
    one = jc.Recording(t, t[:, None], t[:, None])
    with pytest.raises(ValueError, match="unloaded recording: "):
        identify_torque_constants(network, one, one, MASS)


def test_the_command(exact: tuple[jc.Patterns, jc.Patterns], tmp_path: Path) -> None:
    """Currents in mA in columns of a user's own, of an arm whose joints have names."""
    robot, mapping = tmp_path / "arm.toml", tmp_path / "mapping.toml"
    robot.write_text(
        'name = "arm"\ngravity = [0, -9.81, 0]\n[[joint]]\nname = "shoulder"\n'
        '[[joint]]\nname = "elbow"\nalpha = "pi/2"\na = 0.4\n'
    )
    mapping.write_text(
        'joints = ["shoulder", "elbow"]\n[time]\ncolumns = "t"\n[position]\ncolumns = "q{number}"\n'
        '[torque]\ncolumns = "i{number}"\nunit = "mA"\nconstant = 1\n'
    )
    paths = [tmp_path / "unloaded.csv", tmp_path / "loaded.csv"]
    for path, patterns in zip(paths, exact, strict=True):
        current = 1e3 * np.asarray(patterns.torque)
        table = np.concatenate([np.c_[patterns.time], patterns.q, current], axis=1)
        np.savetxt(path, table, delimiter=",", header="t,q1,q2,i1,i2")
    result = run("constants", robot, *paths, "--mass", "2.0", "--columns", mapping)
    assert result.exit_code == 0, result.output
    (line,) = [line for line in result.output.splitlines() if line.startswith("constant")]
    values = tomllib.loads(line)["constant"]
    # Smoothing 50 Hz of motion up to 0.3 Hz changes accelerations by less than a percent.
    np.testing.assert_allclose(values, CONSTANTS, rtol=0.02)
    assert result.output.startswith("shoulder  ")

    result = run("constants", robot, *paths[:1], *paths[:1], "--mass", "2", "--columns", mapping)
    assert result.exit_code == 2 and "is given twice" in result.stderr

    mapping.write_text(mapping.read_text().replace("constant = 1\n", ""))
    result = run("constants", robot, *paths, "--mass", "2.0", "--columns", mapping)
    assert result.exit_code == 2
    assert "mA is a current; expected constant = ..." in result.stderr
