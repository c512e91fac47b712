"""Joints that follow others, from a recording to a report, a robot file and C code."""

import dataclasses
import shutil
from collections.abc import Callable
from pathlib import Path

import numpy as np
import pandas as pd
import pytest
from jaxtyping import Float

import jaxcslc as jc
from jaxcslc.export import read_motor_inertias
from tests.conftest import run


HAND = Path(__file__).parents[1] / "data" / "hand.urdf"
NAMES = ("shoulder", "left", "right", "end")
Compiler = Callable[[jc.CCode], Callable[..., Float[np.ndarray, " values"]]]


@pytest.fixture(scope="module")
def coupled() -> jc.CSLC:
    return jc.derive(jc.load_robot(HAND, mimic="couple"), lengths="numeric")


@pytest.fixture(scope="module")
def k(coupled: jc.CSLC) -> Float[np.ndarray, " coefficients"]:
    links = coupled.robot.links or ()
    viscous, dry = [0.3, 0.2, 0.0, 0.0], [0.1, 0.4, 0.0, 0.0]
    return np.asarray(coupled.coefficients_from(links, viscous=viscous, dry=dry))


def test_c_code_is_of_the_independent_joints(
    coupled: jc.CSLC, k: Float[np.ndarray, " _"], rng: np.random.Generator, compiled: Compiler
) -> None:
    call = compiled(jc.c_code(coupled, k))
    q, qd, qdd = rng.uniform(-2, 2, (3, 2))
    expected = {
        "torque": ((q, qd, qdd), coupled.torque(k, q, qd, qdd)),
        "mass_matrix": ((q,), coupled.mass_matrix(k, q)),
        "gravity": ((q,), coupled.gravity_term(k, q)),
        "regressor": ((q, qd, qdd), coupled.regressor(q, qd, qdd)),
    }
    for name, (inputs, values) in expected.items():
        output = call(name, *inputs, size=values.size)
        np.testing.assert_allclose(output, np.ravel(values), atol=1e-10)


def _recorded(network: jc.CSLC, k: Float[np.ndarray, " _"], seed: int) -> pd.DataFrame:
    """Motion of all joints, and torque of those that have one, as a robot would log them."""
    rng = np.random.default_rng(seed)
    t = 0.01 * np.arange(1200)
    frequency, phase = 2 * np.pi * rng.uniform(0.3, 1.2, (2, 4)), rng.uniform(0, 6, (2, 4))
    angle = frequency * t[:, None, None] + phase
    motion = [
        (0.4 * frequency**order * f(angle)).sum(axis=2)
        for order, f in enumerate((np.sin, np.cos, lambda x: -np.sin(x)))
    ]
    torque = np.asarray(network.torque(k, *motion)) + 0.02 * rng.normal(size=(len(t), 2))
    positions = network.positions_of_all_joints(motion[0])
    columns = {f"position_{name}": x for name, x in zip(NAMES, positions.T, strict=True)}
    columns |= {f"torque_{name}": np.zeros(len(t)) for name in NAMES}
    columns |= {"torque_shoulder": torque[:, 0], "torque_left": torque[:, 1]}
    return pd.DataFrame({"time": t, **columns})


def test_from_a_recording_to_a_report_and_a_file(
    coupled: jc.CSLC, k: Float[np.ndarray, " _"], tmp_path: Path
) -> None:
    """Columns of followers are compared with the law; a file that is written keeps its mimics."""
    arm, log, out = tmp_path / "hand.urdf", tmp_path / "log.csv", tmp_path / "out"
    shutil.copy(HAND, arm)
    settings = tmp_path / "settings.json"
    settings.write_text(
        '{"smoothing": {"method": "butterworth", "cutoff": 15.0}, "torque_alignment": "sample"}'
    )
    table = _recorded(coupled, k, 1)
    table.to_csv(log, index=False)
    line = [arm, log, "--mimic", "couple"]
    done = run("identify", *line, "--settings", settings, "--possible", "always", "-o", out)
    assert done.exit_code == 0, done.output
    assert "3 right (follows left)" in done.output
    assert "mimic joint" not in done.output and "tame motion" not in done.output
    assert "joints that are not read: right, end" in done.output

    written = tmp_path / "written.urdf"
    done = run("export", arm, out, "--mimic", "couple", "-o", written)
    assert done.exit_code == 0, done.output
    assert written.read_text().count("<mimic") == 2
    again = jc.load_robot(written, mimic="couple")
    network = jc.derive(again, lengths="numeric")
    motors = read_motor_inertias(tmp_path / "written.motors.toml")
    links = [
        dataclasses.replace(link, motor_inertia=motors[name])
        for link, name in zip(again.links or (), NAMES, strict=True)
    ]
    identified = network.coefficients_from(links, viscous=again.viscous, dry=again.dry)
    motion = np.random.default_rng(3).uniform(-1, 1, (3, 50, 2))
    torque = np.asarray(coupled.torque(k, *motion))
    difference = np.asarray(network.torque(identified, *motion)) - torque
    assert np.std(difference) < 0.02 * np.std(torque)

    table["position_end"] += 0.2 * np.sin(table["time"])
    table.to_csv(log, index=False)
    done = run("check", *line)
    assert done.exit_code == 1 and "mimic joint, end: it is up to 0.2 rad or m off" in done.output
    done = run("check", arm, log, "--mimic", "move")
    assert done.exit_code == 2 and "--mimic: expected fix, couple, got 'move'" in done.output


def test_a_motion_is_designed_for_the_independent_joints(tmp_path: Path) -> None:
    limits, motion = tmp_path / "limits.toml", tmp_path / "motion.csv"
    text = "[joints]\nposition = [-1.0, 1.0]\nvelocity = 3.0\ntorque = [40.0, 20.0]\n"
    # Fingers that follow move too.
    limits.write_text(f"{text}[surroundings]\nradius = 0.02\n")
    line = ["excite", HAND, "--mimic", "couple", "--limits", limits, "-o", motion]
    search = ["--duration", "1", "--rate", "40", "--starts", "1", "--family", "fourier"]
    done = run(*line, *search)
    assert done.exit_code == 0, done.output
    assert motion.read_text().startswith("time,position_shoulder,position_left,velocity_shoulder")
    assert "capsules of 20 mm radius stand for all links" in done.output
