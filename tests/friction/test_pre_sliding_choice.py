"""Pre-sliding among the friction that `identify` tries: used where it is there, nowhere else."""

import dataclasses
import json
from pathlib import Path

import numpy as np
import pytest
from numpy.testing import assert_allclose

import jaxcslc as jc
from tests.conftest import run


LENGTH = 0.04


def arm() -> jc.Manipulator:
    return jc.examples.planar_arm()


def yielding(q: np.ndarray) -> np.ndarray:
    """The state of a contact, in small explicit steps along a finely sampled path."""
    w, states = 0.0, [0.0]
    for change in np.diff(q):
        w += (change - abs(change) * w) / LENGTH
        states.append(w)
    return np.array(states)


def recording(network: jc.CSLC, *, yields: bool) -> jc.Recording:
    """Motion with many reversals; the friction of joint 1 yields before it slides, or does not."""
    fine, every = 0.0005 * np.arange(32_000)[:, None], 20
    rate, size = np.array([[2.0, 1.3], [3.1, 4.7]]), np.array([[0.3, 0.7], [0.2, 0.2]])
    cosines = list(zip(rate, size, strict=True))
    path = np.sum([s * np.sin(r * fine) for r, s in cosines], axis=0)
    t = fine[::every]
    q = path[::every]
    qd = np.sum([s * r * np.cos(r * t) for r, s in cosines], axis=0)
    qdd = np.sum([-s * r**2 * np.sin(r * t) for r, s in cosines], axis=0)
    k = np.full(network.size, 0.4)
    torque = np.array(network.torque(k, q, qd, qdd))
    if yields:
        torque[:, 0] += 0.4 * (yielding(path[:, 0])[::every] - np.sign(qd[:, 0]))
    torque += 0.02 * np.random.default_rng(3).normal(size=q.shape)
    return jc.Recording(t[:, 0], np.asarray(q), torque)


@pytest.fixture(scope="module")
def network() -> jc.CSLC:
    return jc.derive(arm(), lengths="numeric")


@pytest.fixture(scope="module")
def report(network: jc.CSLC) -> jc.Report:
    return jc.identify(
        network,
        recording(network, yields=True),
        settings=jc.Settings(),
        friction="auto",
        possible="never",
        systematic=False,
        simulate=True,
    )


def test_the_joint_that_yields_gets_its_length(report: jc.Report) -> None:
    assert report.pre_sliding is not None and report.friction is not None
    first, second = report.pre_sliding.presliding_distance
    assert_allclose(first, LENGTH, rtol=0.2)
    assert second == 0.0
    trials = {t.joint: t for t in report.friction.trials if t.kind == "pre-sliding"}
    assert trials[1].used and trials[1].relative.change < np.log(0.9)
    assert not trials[2].used


def test_states_have_the_bodies_of_the_robots_file() -> None:
    """Joint 2 stands still: what only its motion shows is the file's, with states as without."""
    links = tuple(
        jc.LinkParameters(mass, np.array([0.2, 0.05, 0.0]), 0.03 * np.eye(3)) for mass in (3.0, 2.0)
    )
    network = jc.derive(dataclasses.replace(arm(), links=links), lengths="numeric")
    k = np.asarray(network.coefficients_from(links, viscous=[0.4, 0.4], dry=[0.4, 0.4]))
    t = 0.01 * np.arange(1600)
    q, qd, qdd = (np.zeros((1600, 2)) for _ in range(3))
    for rate, size in ((2.0, 0.3), (3.1, 0.2)):
        q[:, 0] += size * np.sin(rate * t)
        qd[:, 0] += size * rate * np.cos(rate * t)
        qdd[:, 0] -= size * rate**2 * np.sin(rate * t)
    torque = np.array(network.torque(k, q, qd, qdd))
    torque[:, 0] += 0.4 * (yielding(q[:, 0]) - np.sign(qd[:, 0]))
    torque += 0.01 * np.random.default_rng(3).normal(size=q.shape)
    report = jc.identify(
        network,
        jc.Recording(t, q, torque),
        settings=jc.Settings(),
        friction="auto",
        possible="never",
        systematic=False,
        checks=False,
    )
    assert report.pre_sliding is not None
    index = [i for i, error in enumerate(report.fit.standard_error) if 0.0 < error < np.inf]
    inertial = [i for i in index if i in range(network.size)[network.layout.inertial]]
    assert len(inertial) == len(range(network.size)[network.layout.inertial])
    assert_allclose(np.asarray(report.pre_sliding.fit.k)[inertial], k[inertial], atol=0.05)


def test_terms_that_would_make_up_for_states_are_not_added(report: jc.Report) -> None:
    """Terms are tried beside the states: one that yields has no static friction too."""
    assert report.friction is not None and report.pre_sliding is not None
    tried = {(trial.joint, trial.kind) for trial in report.friction.trials}
    assert (1, "static") not in tried and (2, "static") in tried
    assert "ks1" not in report.names
    elsewhere = report.pre_sliding.elsewhere
    assert elsewhere[1].change < 0.0 and elsewhere[1].parts == 2


def test_torque_with_states_is_nearer(report: jc.Report) -> None:
    assert report.pre_sliding is not None
    motion = report.patterns["training"]
    states, _ = report.pre_sliding.torque(motion.q, motion.qd, motion.qdd)
    step = report.network.torque(report.k, motion.q, motion.qd, motion.qdd)
    rms = [np.std(np.asarray(motion.torque - torque)[:, 0]) for torque in (states, step)]
    assert rms[0] < 0.7 * rms[1]


def test_simulated_motion_with_states_is_nearer(report: jc.Report) -> None:
    """Beside that of the report's coefficients, whose dry friction follows the sign."""
    assert report.horizon is not None
    error = {name: values[:3, 0] for name, values in report.horizon.error.items()}
    assert tuple(error) == ("fit", "pre-sliding")
    assert np.all(error["pre-sliding"] < 0.7 * error["fit"])
    (line,) = [x for x in str(report).splitlines() if x.startswith("note: pre-sliding of joint 1")]
    assert "simulated motion" in line and "simulated motion included" not in line


def test_it_is_printed_beside_the_other_terms(report: jc.Report) -> None:
    (line,) = [x for x in str(report).splitlines() if x.startswith("note: friction of joint 1")]
    assert (
        "; root " in line
        and "pre-sliding -" in line
        and ", length 0.0" in line
        and " rad, used" in line
    )
    assert "note: pre-sliding of joint 1: a state along the motion" in str(report)


def test_it_is_saved_and_read_again(report: jc.Report, tmp_path: Path) -> None:
    report.save(tmp_path, pictures=False)
    document = json.loads((tmp_path / "identification.json").read_text("utf-8"))
    tried = [x for x in document["friction_trials"] if x["kind"] == "pre-sliding"]
    assert [x["used"] for x in tried] == [True, False]
    page = (tmp_path / "index.html").read_text("utf-8")
    assert "Friction terms tried" in page and "pre-sliding of joint 1" in page
    saved = jc.load_report(tmp_path, arm()).pre_sliding
    assert saved is not None and report.pre_sliding is not None
    motion = report.patterns["training"]
    for ours, theirs in zip(
        saved.torque(motion.q, motion.qd, motion.qdd),
        report.pre_sliding.torque(motion.q, motion.qd, motion.qdd),
        strict=True,
    ):
        assert_allclose(ours, theirs, atol=1e-12)
    assert saved.relative == report.pre_sliding.relative
    document["pre_sliding"]["lengths"] = [0.1]
    (tmp_path / "identification.json").write_text(json.dumps(document), encoding="utf-8")
    with pytest.raises(ValueError, match="pre_sliding: lengths: expected 2 numbers"):
        jc.load_report(tmp_path, arm())


def test_friction_without_pre_sliding(network: jc.CSLC) -> None:
    result = jc.identify(
        network,
        recording(network, yields=False),
        settings=jc.Settings(),
        friction="auto",
        possible="never",
        systematic=False,
    )
    assert result.pre_sliding is None and result.friction is not None
    assert len([t for t in result.friction.trials if t.kind == "pre-sliding"]) == 2
    assert "a state along the motion" not in str(result)


def test_several_recordings_are_not_tried(network: jc.CSLC) -> None:
    whole = recording(network, yields=True)
    parts = [whole.between(0.0, 8.0), whole.between(8.0, 16.0)]
    settings = jc.Settings()
    result = jc.identify(
        network, parts, settings=settings, friction="auto", possible="never", systematic=False
    )
    assert result.pre_sliding is None
    assert "pre-sliding was not tried: several recordings" in str(result)


def test_it_is_not_of_a_part_of_the_coefficients(network: jc.CSLC) -> None:
    k = np.zeros(network.size)
    with pytest.raises(ValueError, match=r"friction='auto' cannot be combined with previous"):
        jc.identify(
            network,
            recording(network, yields=False),
            previous=k,
            groups=["dry"],
            friction="auto",
        )


def test_exported_code_has_the_state_and_robot_files_do_not(
    report: jc.Report, tmp_path: Path
) -> None:
    assert report.pre_sliding is not None
    report.save(tmp_path, pictures=False)
    robot = tmp_path / "arm.toml"
    robot.write_text("gravity = [0, -9.81, 0]\n[[joint]]\n[[joint]]\na = 0.5\n", "utf-8")
    arguments = ["export", str(robot), str(tmp_path)]
    result = run(*arguments, "--c", "-o", tmp_path / "arm.c")
    assert result.exit_code == 0, result.output
    assert "note: pre-sliding of joint 1 has a state, which arm_pre_sliding" in result.output
    source = (tmp_path / "arm.c").read_text("ascii")
    k = dict(zip(report.network.names, report.pre_sliding.fit.k.tolist(), strict=True))
    assert f"kd1 = {k['kd1']:.17g} N m" in source and "w[0]" in source
    result = run(*arguments, "-o", tmp_path / "new.toml")
    assert result.exit_code == 0, result.output
    assert "note: pre-sliding of joint 1 is omitted: Coulomb friction is a step" in result.output
