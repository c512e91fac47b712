"""Friction terms chosen joint by joint on motion that was left out."""

import dataclasses
from collections.abc import Sequence
from pathlib import Path
from typing import Literal

import numpy as np
import pytest

import jaxcslc as jc
from jaxcslc.manipulator import LinkParameters
from jaxcslc.selection import FrictionChoice, FrictionTrial, choose_friction
from jaxcslc.selection._friction import _best, _Judge
from jaxcslc.uncertainty import RelativeError
from tests import arms
from tests.conftest import run


TRUE = (("viscous", "dry", "offset"), ("viscous", "dry", "static"))


def arm() -> jc.Manipulator:
    return jc.examples.planar_arm()


def recording(
    network: jc.CSLC, laws: Sequence[Sequence[str]] = TRUE, noise: float = 0.02
) -> jc.Recording:
    """Motion at all speeds; by default a torque offset of joint 1, static friction of joint 2."""
    t = 0.01 * np.arange(1500)[:, None]
    rate, size = np.array([[2.0, 1.3], [3.1, 4.7]]), np.array([[0.9, 0.7], [0.3, 0.2]])
    q = np.sum([s * np.sin(r * t) for r, s in zip(rate, size, strict=True)], axis=0)
    qd = np.sum([s * r * np.cos(r * t) for r, s in zip(rate, size, strict=True)], axis=0)
    qdd = np.sum([-s * r**2 * np.sin(r * t) for r, s in zip(rate, size, strict=True)], axis=0)
    true = network.with_joint_friction(laws)
    if "static" in true.robot.friction_terms:
        true = true.with_static_slopes([10.0, 6.0])
    values = {"ko1": 0.5, "ks2": 0.8}
    k = np.array([values.get(name, 0.4) for name in true.names])
    rng = np.random.default_rng(0)
    torque = np.asarray(true.torque(k, q, qd, qdd)) + noise * rng.normal(size=q.shape)
    return jc.Recording(t[:, 0], np.asarray(q), torque)


@pytest.fixture(scope="module")
def choice() -> FrictionChoice:
    network = jc.derive(arm(), lengths="numeric")
    return choose_friction(
        network, recording(network), jc.Settings(), candidates=("offset", "static", "root")
    )


def test_each_joint_gets_its_terms(choice: FrictionChoice) -> None:
    assert choice.network.robot.friction_per_joint == TRUE


def test_it_says_what_each_was_worth(choice: FrictionChoice) -> None:
    first, second = choice.sentences
    assert first.startswith("friction of joint 1, held-out error with a term over that without: ")
    assert "offset -" in first and ", used" in first.split("offset")[1].split(";")[0]
    assert ", used" in second.split("static")[1].split(";")[0]
    worth = {(t.joint, t.kind): t.relative.change for t in choice.trials if t.used}
    assert worth[1, "offset"] < np.log(0.5) and worth[2, "static"] < np.log(0.7)


def test_nothing_is_added_to_a_model_that_is_right() -> None:
    network = jc.derive(arm(), lengths="numeric")
    t = 0.01 * np.arange(1000)[:, None]
    rate = np.array([2.0, 3.1])
    motion = np.sin(rate * t), rate * np.cos(rate * t), -(rate**2) * np.sin(rate * t)
    torque = np.asarray(network.torque(np.full(network.size, 0.3), *motion))
    torque = torque + 0.05 * np.random.default_rng(0).normal(size=torque.shape)
    exact = jc.Recording(t[:, 0], motion[0], torque)
    kept = choose_friction(network, exact, jc.Settings(), candidates=("offset", "root"))
    assert kept.network.robot.friction_per_joint == (("viscous", "dry"),) * 2
    assert not any(trial.used for trial in kept.trials)


def test_collinear_terms_are_not_tried() -> None:
    network = jc.derive(arm().with_friction("viscous", "asymmetric_dry"), lengths="numeric")
    result = choose_friction(
        network, recording(jc.derive(arm(), lengths="numeric")), candidates=("offset",)
    )
    assert result.trials == ()


class TestFrictionOfEachDirection:
    def test_is_chosen_with_its_offset(self) -> None:
        """One by one, viscous friction of each direction and an offset would stand in for one
        another."""
        network = jc.derive(arm(), lengths="numeric")
        t = 0.01 * np.arange(1500)[:, None]
        rate = np.array([2.0, 3.1])
        phase = rate * t + 0.4 * np.sin(0.7 * t)
        motion = np.sin(phase), np.gradient(np.sin(phase), 0.01, axis=0)
        motion += (np.gradient(motion[1], 0.01, axis=0),)
        true = network.with_joint_friction(
            [("dry", "asymmetric_viscous", "offset"), ("viscous", "dry")]
        )
        values = {"kvp1": 0.5, "kvn1": 0.2, "ko1": 0.2}
        k = np.array([values.get(name, 0.4) for name in true.names])
        torque = np.asarray(true.torque(k, *motion))
        torque = torque + 0.02 * np.random.default_rng(0).normal(size=torque.shape)
        candidates = ("offset", "asymmetric_viscous", "asymmetric_viscous and offset")
        choice = choose_friction(
            network,
            jc.Recording(t[:, 0], np.asarray(motion[0]), torque),
            jc.Settings(),
            candidates=candidates,
        )
        first, second = choice.network.robot.friction_per_joint
        assert set(first) == {"dry", "asymmetric_viscous", "offset"}
        assert set(second) == {"viscous", "dry"}

    def test_replaces_that_of_both(self) -> None:
        network = jc.derive(arm(), lengths="numeric")
        tried = choose_friction(
            network, recording(network), jc.Settings(), candidates=("asymmetric_viscous",)
        ).trials
        assert [trial.joint for trial in tried[:2]] == [1, 2]
        assert all(trial.possible for trial in tried)


def test_an_offset_that_gravity_explains_is_not_used() -> None:
    """In a range of 0.06 rad, sine and cosine of gravity are a constant and a line."""
    network = arms.pendulum()
    t = 0.01 * np.arange(1500)[:, None]
    motion = 0.03 * np.sin(2 * t) + 0.7, 0.06 * np.cos(2 * t), -0.12 * np.sin(2 * t)
    true = network.with_joint_friction([("viscous", "dry", "offset")])
    torque = np.asarray(true.torque(np.array([0.5, 0.3, -0.1, 0.2, 0.4, 0.5]), *motion))
    torque = torque + 0.02 * np.random.default_rng(0).normal(size=torque.shape)
    noisy = jc.Recording(t[:, 0], motion[0], torque)
    choice = choose_friction(network, noisy, jc.Settings(), candidates=("offset",))
    assert choice.network.names == network.names
    assert [trial.used for trial in choice.trials] == [False]
    assert _Judge(noisy, jc.Settings(), (), None, np.zeros(1)).unclear_offsets(true) == (1,)


def test_maximum_likelihood_has_static_friction() -> None:
    """Where there is dry friction: trials on smoothed motion do not show it."""
    network = jc.derive(arm().with_friction("viscous", joint=2), lengths="numeric")
    choice = FrictionChoice(network, ()).with_static_friction()
    assert choice.network.robot.friction_per_joint == (("viscous", "dry", "static"), ("viscous",))
    assert choice.sentences == (choice.note,)
    assert "'static' added, joint 1:" in str(choice)
    assert choice.with_static_friction() is choice


def test_the_command(tmp_path: Path) -> None:
    """What was tried is among the notes, and the report is of the chosen terms."""
    robot = tmp_path / "pendulum.toml"
    robot.write_text('name = "pendulum"\ngravity = [0, -9.81, 0]\n[[joint]]\n', encoding="utf-8")
    network = jc.derive(jc.load_robot(robot), lengths="numeric")
    true = network.with_joint_friction([("viscous", "dry", "offset")])
    t = 0.01 * np.arange(800)[:, None]
    q, qd, qdd = np.sin(2 * t), 2 * np.cos(2 * t), -4 * np.sin(2 * t)
    torque = np.asarray(true.torque(np.array([0.5, 0.3, -0.1, 0.2, 0.1, 0.4]), q, qd, qdd))
    torque = torque + 0.01 * np.random.default_rng(0).normal(size=t.shape)
    table = np.concatenate([t, q, torque], axis=1)
    header = "time,position_1,torque_1"
    np.savetxt(tmp_path / "train.csv", table, delimiter=",", header=header, comments="")
    (tmp_path / "settings.json").write_text("{}", encoding="utf-8")
    names = (str(tmp_path / name) for name in ("pendulum.toml", "train.csv", "settings.json", "o"))
    robot_file, train, settings, output = names
    options = ["--friction", "auto", "--settings", settings, "-o", output]
    result = run("identify", robot_file, train, *options)
    assert result.exit_code == 0, result.output
    assert "note: friction of joint 1, held-out error with a term over" in result.output
    assert "; pre-sliding " in result.output
    assert "ko1" in result.output


class TestJointFriction:
    def test_is_that_of_a_network_derived_so(self) -> None:
        network = jc.derive(arm(), lengths="numeric").with_joint_friction(TRUE)
        robot = arm()
        for joint, kinds in enumerate(TRUE, start=1):
            robot = robot.with_friction(*kinds, joint=joint)
        assert network.names == jc.derive(robot, lengths="numeric").names

    def test_another_number_of_joints(self) -> None:
        with pytest.raises(ValueError, match="2 joints' friction, got 3"):
            jc.derive(arm(), lengths="numeric").with_joint_friction([("dry",)] * 3)


class TestMotionThatDiffers:
    """Terms are judged on speeds, positions and recordings that were not fitted."""

    def test_a_term_that_is_worse_there_is_not_used(self) -> None:
        inside = RelativeError(-0.3, 0.02, 8)
        trials = [
            FrictionTrial(1, "root", inside, used=False, elsewhere=RelativeError(0.02, 0.01, 4)),
            FrictionTrial(1, "static", inside, used=False, elsewhere=RelativeError(-0.2, 0.01, 4)),
            FrictionTrial(2, "root", inside, used=False, elsewhere=RelativeError(0.02, 0.01, 4)),
        ]
        assert {joint: trial.kind for joint, trial in _best(trials, 0.01).items()} == {1: "static"}

    def test_each_half_is_predicted_by_the_other(self, choice: FrictionChoice) -> None:
        """Oracle: a constant that is fitted to slow motion is there in fast motion too."""
        (offset,) = [trial for trial in choice.trials if trial.used and trial.kind == "offset"]
        assert offset.elsewhere is not None
        assert offset.elsewhere.parts == 4 and offset.elsewhere.change < np.log(0.5)
        assert "% elsewhere)" in str(offset)

    @pytest.mark.parametrize(("sign", "used"), [(1.0, True), (-1.0, False)])
    def test_another_recording_must_agree(self, sign: float, used: bool) -> None:
        """A constant that changes its sign from run to run is no property of the arm."""
        network = jc.derive(arm(), lengths="numeric")
        first, second = recording(network), recording(network)
        other = (sign - 1.0) * np.array([0.5, 0.0])
        second = jc.Recording(second.time, second.position, second.torque + other)
        chosen = choose_friction(
            network, first, jc.Settings(), candidates=("offset",), others=[second]
        )
        assert ("offset" in chosen.network.friction_per_joint[0]) == used


class TestOffsets:
    """A constant torque of each joint, as the command tries it by default."""

    def test_where_there_is_one(self) -> None:
        network = jc.derive(arm(), lengths="numeric")
        swings = recording(network, (TRUE[0], ("viscous", "dry")))
        report = jc.identify(
            network, swings, settings=jc.Settings(), friction="offset", checks=False
        )
        first, second = report.network.friction_per_joint
        assert "offset" in first and "offset" not in second
        k = dict(zip(report.network.names, np.asarray(report.k).tolist(), strict=True))
        assert abs(k["ko1"] - 0.5) < 0.05
        assert report.friction is not None
        (note,) = report.friction.sentences
        assert note.startswith("friction terms added, held-out error with a term over that without")
        assert "joint 1 offset -" in note and "joint 2" not in note

    def test_where_there_is_none(self, rng: np.random.Generator) -> None:
        """The fit is that without any trial."""
        network = arms.pendulum("viscous", "dry")
        exact = jc.examples.swing_recording(network, [0.5, 0.3, -0.1, 0.2, 0.05])
        noisy = exact.torque + 0.02 * rng.normal(size=exact.torque.shape)
        swings = jc.Recording(exact.time, exact.position, noisy)
        fits = [
            jc.identify(network, swings, friction=friction, checks=False)
            for friction in ("offset", None)
        ]
        assert fits[0].network.names == fits[1].network.names
        assert np.array_equal(fits[0].k, fits[1].k)
        assert fits[0].friction is not None and fits[0].friction.sentences == ()

    @pytest.mark.parametrize("friction", ["offset", "auto"])
    def test_all_joints_have_one_where_the_file_has_masses(
        self, friction: Literal["offset", "auto"]
    ) -> None:
        link = LinkParameters(1.0, np.array([0.2, 0.1, 0.0]), 0.02 * np.eye(3))
        robot = dataclasses.replace(arm(), links=(link, link))
        network = jc.derive(robot, lengths="numeric")
        swings = recording(network, (TRUE[0], ("viscous", "dry")))
        report = jc.identify(
            network, swings, settings=jc.Settings(), friction=friction, checks=False
        )
        assert all("offset" in kinds for kinds in report.network.friction_per_joint)
        k = dict(zip(report.network.names, np.asarray(report.k).tolist(), strict=True))
        assert abs(k["ko1"] - 0.5) < 0.05 and abs(k["ko2"]) < 0.05

    def test_the_command_tries_it_unless_terms_are_named(self, tmp_path: Path) -> None:
        robot = tmp_path / "pendulum.toml"
        robot.write_text(
            'name = "pendulum"\ngravity = [0, -9.81, 0]\n[[joint]]\n', encoding="utf-8"
        )
        true = jc.derive(jc.load_robot(robot)).with_joint_friction([("viscous", "dry", "offset")])
        t = 0.01 * np.arange(800)[:, None]
        q, qd, qdd = np.sin(2 * t), 2 * np.cos(2 * t), -4 * np.sin(2 * t)
        torque = np.asarray(true.torque(np.array([0.5, 0.3, -0.1, 0.2, 0.1, 0.4]), q, qd, qdd))
        torque = torque + 0.01 * np.random.default_rng(0).normal(size=t.shape)
        table = np.concatenate([t, q, torque], axis=1)
        header = "time,position_1,torque_1"
        np.savetxt(tmp_path / "train.csv", table, delimiter=",", header=header, comments="")
        names = [str(robot), str(tmp_path / "train.csv")]
        found = run("identify", *names, "-o", str(tmp_path / "a"))
        assert found.exit_code == 0 and "ko1" in found.output
        named = ["--friction", "viscous,dry", "-o", str(tmp_path / "b")]
        given = run("identify", *names, *named)
        assert given.exit_code == 0 and "ko1" not in given.output
