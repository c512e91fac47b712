"""What is known before a fit: against least squares with further rows, and in files."""

from pathlib import Path
from typing import Any

import numpy as np
import pytest
import scipy
from jaxtyping import Float

import jaxcslc as jc
from jaxcslc.bodies import Known, Prior, load_prior, with_knowledge
from tests import arms


_ROUNDING = 1e-6  # what the covariance of a fit keeps of its equations
SOLVER = jc.LeastSquares(joint_weights="equal", errors="independent")


@pytest.fixture(scope="module")
def network() -> jc.CSLC:
    return arms.elbow()


@pytest.fixture(scope="module")
def patterns(network: jc.CSLC) -> jc.Patterns:
    """Noisy motion of two bodies; the second joint stands still."""
    rng = np.random.default_rng(2)
    q, qd, qdd = rng.uniform(-2, 2, (3, 200, 2)) * [1.0, 0.0]
    ball = jc.LinkParameters(2.0, np.array([0.05, 0.02, 0.1]), 0.01 * np.eye(3), 0.05)
    k = network.coefficients_from([ball, ball], viscous=[0.3, 0.2], dry=[0.1, 0.1])
    torque = np.asarray(network.torque(k, q, qd, qdd)) + 0.1 * rng.normal(size=q.shape)
    every = np.ones(q.shape, bool)
    return jc.Patterns(np.arange(200.0), q, qd, qdd, torque, every, every)


def equations(
    network: jc.CSLC, patterns: jc.Patterns, sigma: float
) -> tuple[Float[np.ndarray, "rows coefficients"], Float[np.ndarray, " rows"]]:
    """Those of the fit, in units of the residual."""
    regressor = np.asarray(network.regressor(patterns.q, patterns.qd, patterns.qdd))
    return regressor.reshape(-1, network.size) / sigma, np.asarray(patterns.torque).ravel() / sigma


def test_values_are_further_rows(network: jc.CSLC, patterns: jc.Patterns) -> None:
    fit = SOLVER.fit(network, patterns)
    index = {name: network.names.index(name) for name in ("kv1", "kd1", "kv2")}
    known = {
        index["kv1"]: Known(0.5, 0.01),
        index["kd1"]: Known(0.2),
        index["kv2"]: Known(1.0, 2.0),
    }
    informed = with_knowledge(fit, known)
    rows, target = equations(network, patterns, 1.0)
    residual = target - rows @ np.asarray(fit.k)
    sigma = float(np.sqrt(residual @ residual / (residual.size - np.linalg.matrix_rank(rows))))
    rows, target = equations(network, patterns, sigma)
    further = np.zeros((2, network.size))
    further[0, index["kv1"]], further[1, index["kv2"]] = 100.0, 0.5
    matrix = np.concatenate([rows, further])
    target = np.concatenate([target, [50.0, 0.5]]) - 0.2 * matrix[:, index["kd1"]]
    free = np.delete(np.arange(network.size), index["kd1"])
    # The torque of the motion and the values are unique, whatever nothing determines.
    expected = np.linalg.lstsq(matrix[:, free], target, rcond=1e-10)[0]
    k = np.asarray(informed.k)
    np.testing.assert_allclose(matrix[:, free] @ k[free], matrix[:, free] @ expected, atol=1e-4)
    assert k[index["kd1"]] == 0.2 and float(informed.standard_error[index["kd1"]]) == 0.0
    covariance = np.linalg.pinv(matrix[:, free].T @ matrix[:, free], rcond=1e-12, hermitian=True)
    for name in ("kv1", "kv2"):
        at = int(np.flatnonzero(free == index[name])[0])
        assert bool(informed.determined[index[name]])
        assert float(informed.standard_error[index[name]]) == pytest.approx(
            np.sqrt(covariance[at, at]), rel=1e-4
        )
    # A joint that stands still has friction that only the value determines.
    assert not bool(fit.determined[index["kv2"]]) and k[index["kv2"]] == pytest.approx(1.0)
    assert int(informed.rank) == np.linalg.matrix_rank(matrix[:, free] / 100, tol=1e-9)


def test_bounds_are_those_of_a_quadratic_programme(network: jc.CSLC, patterns: jc.Patterns) -> None:
    fit = SOLVER.fit(network, patterns)
    index = network.names.index("kv1")
    inside = with_knowledge(fit, {index: Known(low=0.0, high=1.0)})
    np.testing.assert_allclose(np.asarray(inside.k), np.asarray(fit.k), rtol=1e-9)
    bound = float(fit.k[index]) + 0.05
    outside = with_knowledge(fit, {index: Known(low=bound)})
    rows, target = equations(network, patterns, 1.0)
    low = np.full(network.size, -np.inf)
    low[index] = bound
    expected = scipy.optimize.lsq_linear(rows, target, (low, np.full(network.size, np.inf)))
    assert float(outside.k[index]) == pytest.approx(bound)
    np.testing.assert_allclose(rows @ np.asarray(outside.k), rows @ expected.x, atol=1e-4)


def test_links_have_what_is_known_of_them(tmp_path: Path) -> None:
    """In the frame of the file's body: fixed, near a value, within bounds, whatever the prior."""
    (tmp_path / "arm.urdf").write_text("""<robot name="arm"><link name="floor"/>
  <link name="upper"><inertial><origin xyz="0.1 0.02 0.03"/><mass value="2"/>
    <inertia ixx="0.1" iyy="0.1" izz="0.1" ixy="0" ixz="0" iyz="0"/></inertial></link>
  <link name="fore"><inertial><origin xyz="0.1 0 0"/><mass value="1"/>
    <inertia ixx="0.1" iyy="0.1" izz="0.1" ixy="0" ixz="0" iyz="0"/></inertial></link>
  <joint name="shoulder" type="continuous"><parent link="floor"/><child link="upper"/>
    <origin xyz="0 0 0.3" rpy="0.2 0 0.1"/><axis xyz="0.6 0 0.8"/></joint>
  <joint name="elbow" type="continuous"><parent link="upper"/><child link="fore"/>
    <origin xyz="0.3 0 0.1" rpy="0.4 0 0"/><axis xyz="0 1 0"/></joint></robot>""")
    robot = jc.load_robot(tmp_path / "arm.urdf")
    network = jc.derive(robot, lengths="numeric")
    assert robot.links is not None
    k = np.asarray(network.coefficients_from(robot.links, viscous=[1.0, 1.0], dry=[1.0, 1.0]))
    rng = np.random.default_rng(0)
    q, qd, qdd = rng.uniform(-2, 2, (3, 200, 2))
    every = np.ones(q.shape, bool)
    torque = np.asarray(network.torque(k, q, qd, qdd)) + 0.05 * rng.normal(size=q.shape)
    fit = SOLVER.fit(network, jc.Patterns(np.arange(200.0), q, qd, qdd, torque, every, every))
    prior = Prior(
        {},
        {
            "upper": {"mass": Known(3.5), "ry": Known(0.04)},
            "2": {"mass": Known(low=1.3), "motor_inertia": Known(0.02, 1e-5)},
        },
    )
    bodies = jc.physical_parameters(network, fit, knowledge=prior.link_values(robot))
    upper, fore = bodies.bodies
    assert float(upper.mass) == pytest.approx(3.5, abs=_ROUNDING)
    assert float(upper.centre_of_gravity[1]) == pytest.approx(0.04, abs=_ROUNDING)
    assert float(fore.mass) > 1.3 - _ROUNDING
    assert float(fore.motor_inertia) == pytest.approx(0.02, abs=1e-4)
    # The torque sees no mass of the first link: what is known costs nothing there.
    free = jc.physical_parameters(network, fit)
    assert bodies.distance < free.distance + 2.0


FILE = """
[coefficients]
kv1 = { value = 2.0, error = 0.1 }
kd2 = 0.5
[links.2]
mass = { low = 1.0, high = 4 }
"""


def test_files(tmp_path: Path, network: jc.CSLC) -> None:
    path = tmp_path / "priors.toml"
    path.write_text(FILE)
    prior = load_prior(path)
    assert prior == Prior(
        {"kv1": Known(2.0, 0.1), "kd2": Known(0.5)}, {"2": {"mass": Known(low=1.0, high=4.0)}}
    )
    assert str(prior) == "kv1 2 ± 0.1, kd2 fixed at 0.5; link 2: mass from 1 to 4"
    assert prior.document()["links"] == {"2": {"mass": {"low": 1.0, "high": 4.0}}}
    (entry,) = prior.link_values(network.robot)
    assert (entry.link, entry.parameter) == (1, "mass")


@pytest.mark.parametrize(
    ("text", "message"),
    [
        ("[coefficients]\nkv1 = { value = 1, sigma = 2 }", "kv1: unknown entry 'sigma'"),
        ("[coefficients]\nkv1 = 'a'", "kv1: value: expected a finite number up to 1e+12, got 'a'"),
        ("[coefficients]\nkv1 = nan", "coefficients, kv1: value: expected a finite number"),
        ("[coefficients]\nkv1 = { error = 1 }", "coefficients, kv1: expected a value or a bound"),
        ("[coefficients]\nkv1 = { value = 1, error = -1 }", "error: expected 0 or more, got -1"),
        ("[coefficients]\nkv1 = { low = 2, high = 1 }", "low: expected less than high"),
        ("[coefficients]\nkv1 = { value = 3, high = 1 }", "value: expected a number at most 1,"),
        ("coefficients = 3", "coefficients: expected a table, got 3"),
        ("[links.2]\nIxx = 1", "links, 2: unknown parameter 'Ixx'; expected some of mass"),
        ("[link.2]\nmass = 1", "unknown entry 'link'"),
        ("=", "not valid TOML"),
    ],
)  # fmt: skip
def test_wrong_files(text: str, message: str, tmp_path: Path) -> None:
    (tmp_path / "priors.toml").write_text(text)
    with pytest.raises(ValueError) as caught:
        load_prior(tmp_path / "priors.toml")
    assert "priors.toml" in str(caught.value) and message in str(caught.value)


@pytest.mark.parametrize(
    ("prior", "options", "message"),
    [
        (Prior({"kx": Known(1.0)}), {}, "has no 'kx'; expected some of"),
        (Prior({}, {"3": {"mass": Known(1.0)}}), {}, "'3' names no link of 'elbow'; expected one"),
        (
            Prior({}, {"2": {"mass": Known(1.0)}}),
            {"possible": "never"},
            'needs possible="auto" or "always"',
        ),
        (
            Prior({"kv1": Known(1.0)}),
            {"previous": np.zeros(14), "groups": ["dry"]},
            "prior= cannot be combined with previous=",
        ),
    ],
)
def test_wrong_names_are_known_before_any_work(
    prior: Prior, options: dict[str, Any], message: str, network: jc.CSLC
) -> None:
    recording = jc.Recording(np.arange(9.0), np.zeros((9, 2)), np.zeros((9, 2)))
    with pytest.raises(ValueError, match=message):
        jc.identify(network, recording, prior=prior, **options)
