"""C code of contacts that yield before they slide: the library's torque along a motion."""

import ctypes
import re
import shutil
import subprocess
from collections.abc import Callable
from pathlib import Path
from typing import Any

import equinox as eqx
import jax.numpy as jnp
import numpy as np
import pytest
from jaxtyping import Float
from numpy.testing import assert_allclose

import jaxcslc as jc
from jaxcslc.friction import PreSlidingFit, contact_states


Compiled = Callable[[jc.CCode], Callable[..., Float[np.ndarray, "..."]]]
Motion = tuple[np.ndarray, np.ndarray, np.ndarray]
# Sums of a few hundred products in another order.
_ROUNDING = 1e-12
_PAGE = Path(__file__).parents[2] / "docs" / "export.md"


@pytest.fixture(scope="module")
def network() -> jc.CSLC:
    """A revolute, a prismatic and another revolute joint, each with several kinds of friction."""
    robot = jc.Manipulator.from_modified_dh(
        [(0.3, 0.1, 0.2, 0.4), ("-pi/2", 0.2, 0.1, 0), ("pi/2", 0.1, 0.2, 0)],
        kinds="RPR",
        gravity=(1.0, 2.0, -9.0),
        name="arm",
    ).with_friction("viscous", "dry", "static", "spring")
    return jc.derive(robot, lengths="numeric")


@pytest.fixture(scope="module")
def motion() -> Motion:
    """With reversals, rests and noise: positions are not those that velocities lead to."""
    rng = np.random.default_rng(4)
    t = 0.01 * np.arange(300)[:, None]
    rate = np.array([3.0, 5.0, 7.0])
    q, qd, qdd = np.sin(rate * t), rate * np.cos(rate * t), -(rate**2) * np.sin(rate * t)
    q = 1e-3 * np.round(1e3 * q + rng.normal(size=q.shape))
    q[100:120], qd[100:120] = q[100], 0.0
    return q, qd, qdd


def along(call: Any, motion: Motion, distance: np.ndarray, size: int, name: str) -> np.ndarray:
    """A function of the C code at every sample, states updated from sample to sample."""
    n = len(distance)
    w, rows, before = np.zeros(n), [], motion[0][0]
    for q, qd, qdd in zip(*motion, strict=True):
        w = call("pre_sliding", q - before, w, size=n)
        rows.append(call(name, q, qd, qdd, w, size=size))
        before = q
    return np.array(rows)


@pytest.mark.parametrize("distance", [[0.02, 0.005, 0.3], [0.02, 0.0, 0.1]])
def test_torque_along_a_recorded_motion(
    distance: list[float],
    network: jc.CSLC,
    motion: Motion,
    compiled: Compiled,
    rng: np.random.Generator,
) -> None:
    """That of the fit, whose columns have the same states, to rounding."""
    k, size = rng.normal(size=network.size), np.array(distance)
    time, pairs = 0.01 * np.arange(len(motion[0])), np.ones(motion[0].shape, bool)
    patterns = jc.Patterns(time, *motion, motion[0], pairs, pairs)
    fit = jc.LeastSquares(errors="independent").fit(network, patterns)
    result = PreSlidingFit(
        network, eqx.tree_at(lambda fit: fit.k, fit, jnp.asarray(k)), size, {}, size
    )
    expected = np.asarray(result.torque(*motion)[0])
    call = compiled(jc.c_code(network, k, presliding_distance=size))
    torque = along(call, motion, size, 3, "torque")
    assert_allclose(torque, expected, rtol=_ROUNDING, atol=_ROUNDING * np.max(np.abs(expected)))
    # Torque is the regressor times the coefficients here, too.
    regressor = along(call, motion, size, 3 * network.size, "regressor")
    products = regressor.reshape(-1, 3, network.size) @ k
    assert_allclose(products, torque, rtol=_ROUNDING, atol=_ROUNDING * np.max(np.abs(expected)))


def test_states_after_a_reversal_and_a_rest(network: jc.CSLC, compiled: Compiled) -> None:
    """The closed form: 1 - exp(-x / length) from rest, its mirror image, and no change at rest."""
    distance = np.array([0.1, 0.2, 0.0])
    call = compiled(jc.c_code(network, np.ones(network.size), presliding_distance=distance))

    def after(dq: list[float], w: np.ndarray) -> np.ndarray:
        return call("pre_sliding", np.array(dq), w, size=3)

    there = after([0.1, -0.1, 5.0], np.zeros(3))
    assert_allclose(there, [1.0 - np.exp(-1.0), np.exp(-0.5) - 1.0, 0.0], rtol=1e-15)
    assert after([0.0, 0.0, 0.0], there).tolist() == there.tolist()
    back = after([-0.1, 0.1, 0.0], there)
    assert_allclose(back[0], -1.0 + (there[0] + 1.0) * np.exp(-1.0), rtol=1e-15)
    assert_allclose(back[1], 1.0 + (there[1] - 1.0) * np.exp(-0.5), rtol=1e-15)
    assert_allclose(after([1e3, -1e3, 0.0], back), [1.0, -1.0, 0.0], rtol=1e-15)


def test_one_interval_is_as_good_as_many(network: jc.CSLC, compiled: Compiled) -> None:
    """Exact for a constant velocity, whatever the interval."""
    distance = np.array([0.1, 0.2, 0.3])
    call = compiled(jc.c_code(network, np.ones(network.size), presliding_distance=distance))
    w = start = np.array([0.4, -0.9, 0.1])
    velocity, interval = np.array([0.3, -2.0, 1.0]), 0.05
    for _ in range(100):
        w = call("pre_sliding", 0.01 * interval * velocity, w, size=3)
    whole = call("pre_sliding", interval * velocity, start, size=3)
    assert_allclose(w, whole, rtol=1e-13)


def test_code_without_pre_sliding_is_what_it_was(network: jc.CSLC) -> None:
    k = np.ones(network.size)
    code = jc.c_code(network, k)
    assert code == jc.c_code(network, k, presliding_distance=np.zeros(3))
    assert "pre_sliding" not in code.header and "w[" not in code.source
    with_states = jc.c_code(network, k, presliding_distance=np.array([0.02, 0.0, 0.0]))
    assert "over a length of the path: joint 1 0.02 rad." in with_states.header
    functions = ("mass_matrix", "gravity")
    for text in (code.source, with_states.source):
        assert all(f"void arm_{name}(const double q[3], double" in text for name in functions)


@pytest.mark.parametrize("distance", [[0.1], [0.1, -0.1, 0.0], [0.1, np.nan, 0.0]])
def test_distances_of_no_contact(distance: list[float], network: jc.CSLC) -> None:
    with pytest.raises(
        ValueError, match="presliding_distance: expected 3 finite numbers from 0 up"
    ):
        jc.c_code(network, np.ones(network.size), presliding_distance=np.array(distance))


def test_a_length_whose_reciprocal_overflows(network: jc.CSLC) -> None:
    with pytest.raises(ValueError, match="pre_sliding: a constant overflows; expected"):
        jc.c_code(network, np.ones(network.size), presliding_distance=np.array([0.1, 1e-310, 0.0]))


def test_a_displacement_that_is_no_number(network: jc.CSLC, compiled: Compiled) -> None:
    """Its state is none from then on, and neither is torque; those of other joints are."""
    distance, still = np.array([0.1, 0.2, 0.3]), np.zeros(3)
    call = compiled(jc.c_code(network, np.ones(network.size), presliding_distance=distance))
    w = call("pre_sliding", np.array([0.1, np.nan, np.inf]), still, size=3)
    w = call("pre_sliding", np.full(3, 0.01), w, size=3)
    assert np.isfinite(w).tolist() == [True, False, True] and w[2] == 1.0
    torque = call("torque", still, still, still, w, size=3)
    assert np.isfinite(torque).tolist() == [True, False, True]


def test_joints_without_dry_friction(network: jc.CSLC) -> None:
    robot = network.robot.with_friction("viscous", joint=2)
    some = jc.derive(robot, lengths="numeric")
    with pytest.raises(
        ValueError, match="presliding_distance: joint 2 has no friction of kind 'dry'"
    ):
        jc.c_code(some, np.ones(some.size), presliding_distance=np.array([0.1, 0.1, 0.0]))


def test_the_example_of_the_page(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    """Compiled as it stands, and called along a motion: states are updated in place."""
    if shutil.which("cc") is None:
        pytest.skip("no C compiler (cc) on this machine")
    page = _PAGE.read_text("utf-8").split("### Friction with a state")[1]
    python, program = (
        re.findall(rf"^```{language}\n(.*?)^```", page, re.DOTALL | re.MULTILINE)[0]
        for language in ("python", "c")
    )
    monkeypatch.chdir(tmp_path)
    names: dict[str, Any] = {}
    exec(compile(python, str(_PAGE), "exec"), names)
    Path("feedforward.c").write_text(program, encoding="ascii")
    strict = ("-std=c99", "-Wall", "-Wextra", "-Werror", "-pedantic", "-shared", "-fPIC")
    line = ["cc", *strict, "-o", "feedforward.so", "feedforward.c", "arm.c", "-lm"]
    done = subprocess.run(line, capture_output=True, text=True)
    assert done.returncode == 0, done.stderr
    feedforward = ctypes.CDLL(str(tmp_path / "feedforward.so")).feedforward
    result, interval = names["result"], 0.01
    t = interval * np.arange(200)[:, None]
    q, qd, qdd = 0.1 * np.sin(2 * t), 0.2 * np.cos(2 * t), -0.4 * np.sin(2 * t)
    w, tau, torque = np.zeros(1), np.zeros(1), []
    for row in zip(q, qd, qdd, strict=True):
        feedforward(
            *(x.ctypes.data_as(ctypes.POINTER(ctypes.c_double)) for x in row),
            ctypes.c_double(interval),
            *(x.ctypes.data_as(ctypes.POINTER(ctypes.c_double)) for x in (w, tau)),
        )
        torque.append(float(tau[0]))
    path = np.concatenate([[[0.0]], np.cumsum(interval * qd, axis=0)])
    states = np.asarray(contact_states(path, result.presliding_distance, np.zeros(1)))[1:]
    k = dict(zip(result.fit.names, np.asarray(result.fit.k).tolist(), strict=True))
    assert_allclose(torque, (k["kB1"] * qdd + k["kd1"] * states)[:, 0], atol=1e-14)


def test_code_of_a_saved_identification_by_maximum_likelihood(
    compiled: Compiled, tmp_path: Path
) -> None:
    """Torques along the recorded motion are those that the report has of its coefficients."""
    robot = jc.Manipulator.from_modified_dh([(0, 0, 0, 0)], gravity=(0, 0, -9.81), name="arm")
    network = jc.derive(robot.with_friction("viscous", "dry"), lengths="numeric")
    t = 0.01 * np.arange(500)[:, None]
    q = 0.3 * np.sin(2 * t) + 0.1 * np.sin(7 * t)
    qd = 0.6 * np.cos(2 * t) + 0.7 * np.cos(7 * t)
    qdd = -1.2 * np.sin(2 * t) - 4.9 * np.sin(7 * t)
    distance = np.array([0.02])
    torque = 0.5 * qdd + 0.2 * qd + 0.4 * np.asarray(contact_states(q, distance, np.zeros(1)))
    report = jc.identify(
        network,
        jc.Recording(t[:, 0], q, torque + 0.01 * np.random.default_rng(0).normal(size=t.shape)),
        settings=jc.Settings(),
        estimator="maximum-likelihood",
        likelihood=jc.MaximumLikelihood(every=1, presliding_distance=(0.02,)),
        possible="never",
        systematic=False,
    )
    report.save(tmp_path, pictures=False)
    states = jc.load_report(tmp_path, robot).pre_sliding
    assert states is not None
    call = compiled(
        jc.c_code(states.network, states.fit.k, presliding_distance=states.presliding_distance)
    )
    motion = report.patterns["training"]
    recorded = (np.asarray(motion.q), np.asarray(motion.qd), np.asarray(motion.qdd))
    expected = np.asarray(report.network_along("training").torque(report.k, *recorded))
    torque = along(call, recorded, states.presliding_distance, 1, "torque")
    assert_allclose(torque, expected, rtol=_ROUNDING, atol=_ROUNDING * np.max(np.abs(expected)))
