"""The study of servo arms at toy size, and its arms against the laws of its own description."""

from pathlib import Path

import numpy as np
import pytest

from jaxcslc.servo import check_servos, identify_servo
from scripts.studies.servo import legs
from scripts.studies.servo.arms import LINKS, TICK, Servos, new_command, recorded, robot
from scripts.studies.servo.cases import CASES, LEVEL, UPRIGHT
from scripts.studies.servo.study import main


def servos(joints: int, rng: np.random.Generator) -> Servos:
    return Servos.drawn(joints, rng)


def test_the_arm_holds_within_its_dead_zone_and_friction(rng: np.random.Generator) -> None:
    """At rest the servo's torque and gravity differ by friction at most."""
    one = servos(1, rng).without("play", "offset")
    command = np.zeros((200, 1))
    rest = recorded(LEVEL, one, command, tick=0.0).position[-1, 0]
    load = 0.3 * 9.81 * (0.15 * np.cos(rest) + 0.01 * np.sin(rest))
    push = one.gain[0] * np.sign(-rest) * max(abs(rest) - one.dead_zone[0], 0.0)
    friction = one.coulomb[0] + one.static[0] + one.load_friction[0] * load
    assert rest > 0.0, "an axis along y turns the link down for positive angles"
    assert abs(push + load) <= 1.02 * friction


def test_readings_are_those_of_an_encoder_with_an_offset(rng: np.random.Generator) -> None:
    one = servos(1, rng)
    command = new_command(1, 4.0, rng)
    exact = recorded(UPRIGHT, one, command, tick=0.0).position
    read = recorded(UPRIGHT, one, command).position
    np.testing.assert_allclose(read / TICK, np.round(read / TICK), atol=1e-9)
    assert np.abs(read - exact).max() <= 0.5 * TICK + 1e-12


@pytest.mark.parametrize("name", LINKS)
def test_robots_have_the_masses_of_the_links(name: str) -> None:
    links = robot(LINKS[name], 1.1).links
    assert links is not None
    assert [float(x.mass) for x in links] == pytest.approx([1.1 * x[2] for x in LINKS[name]])


@pytest.mark.parametrize(("base", "named"), [("stand", False), ("rope", True)])
def test_a_base_that_moves_is_named(base: str, named: bool) -> None:
    """Legs in the air with known gains; on a stand their parameters are found."""
    rng = np.random.default_rng(5)
    drives = legs.Drives.drawn(rng)
    recording = legs.recorded(drives, legs.command_of(6.0, rng), base)
    known = {"gain": legs.GAIN, "damping": legs.DAMPING}
    names = ("delay", "offset", "armature", "coulomb", "viscous")
    robot = legs.robot()
    assert [x.kind for x in check_servos(robot, recording, known)] == named * ["base"]
    fit = identify_servo(robot, recording, known=known, estimated=names)
    assert any(note.startswith("The base moves") for note in fit.notes) == named
    assert not any("damping" in pair.parameters for pair in fit.confounded)
    if not named:
        for i, drive in enumerate(fit.drives):
            assert drive.armature == pytest.approx(drives.armature[i], abs=0.0015)
            assert drive.coulomb == pytest.approx(drives.coulomb[i], rel=0.05)


def test_a_case_is_named() -> None:
    found, remedy = CASES["gain of a joint about a vertical axis"]()
    assert found
    assert "known mass" in remedy


def test_main_at_toy_size(tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    options = ["--seeds", "1", "--arms", "so101", "--duration", "5", "-o", str(tmp_path)]
    assert main(options) == 0
    out = capsys.readouterr().out
    assert "coverage" in out
    assert "new motion" in out
    assert main(options) == 0, "finished rows are taken from the file"
    assert (tmp_path / "rows.jsonl").read_text().count("\n") == 1
