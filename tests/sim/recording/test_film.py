"""What is to be seen: rods from joint to joint, loads where they are picked up and put down."""

import os
import subprocess
import sys
from collections.abc import Callable
from pathlib import Path
from typing import Any

import numpy as np
import pytest

import sim
from jaxcslc.manipulator import LinkParameters
from sim.recording._film import holding


BALL = LinkParameters(2.0, np.array([0.0, 0.0, 0.1]), 0.001 * np.eye(3))


def test_a_scene_is_where_the_kinematics_say(
    pinocchio_model: Callable[..., Any], rng: np.random.Generator
):
    import pinocchio as pin

    machine = sim.disturbed(sim.puma560())
    scene = sim.Scene.of(machine, (sim.Load(0.0, BALL),))
    model = pinocchio_model(machine.robot)
    data = model.createData()
    q, carrier = rng.normal(size=(2, 6))
    scene.update(q, [carrier])
    pin.forwardKinematics(model, data, q)
    origins = np.stack([data.oMi[i].translation for i in range(1, 7)])
    np.testing.assert_allclose(scene.data.xpos[1:7], origins, atol=1e-12)
    pin.forwardKinematics(model, data, carrier)
    np.testing.assert_allclose(
        scene.data.mocap_pos[0], data.oMi[6].act(np.array([0.0, 0.0, 0.1])), atol=1e-12
    )
    assert not scene.carried[0]
    scene.update(q, [q])
    assert scene.carried[0]


def test_a_load_waits_and_stays():
    time, position = 0.1 * np.arange(10), np.arange(10.0)[:, None]

    def positions(*times: float) -> list[float]:
        return holding(sim.Load(times[0], BALL, *times[1:]), time, position)[:, 0].tolist()

    assert positions(0.3, 0.6) == [3, 3, 3, 3, 4, 5, 6, 6, 6, 6]
    assert positions(0.3) == [3, 3, 3, 3, 4, 5, 6, 7, 8, 9]
    assert positions(5.0) == [9.0] * 10


def test_a_film_has_its_pictures(tmp_path: Path):
    """In a separate process, where OpenGL can be selected; skipped where there is none."""
    av = pytest.importorskip("av")
    pytest.importorskip("PIL")
    program = f"""
import sys
import numpy as np
import sim
from jaxcslc.manipulator import LinkParameters
ball = LinkParameters(2.0, np.array([0.0, 0.0, 0.1]), 0.001 * np.eye(3))
_, truth = sim.simulate(sim.puma560(), sim.training(samples=60))
try:
    sim.film({str(tmp_path / "arm.mp4")!r}, sim.puma560(), [truth, truth], titles=["a", "b"],
             loads=(sim.Load(0.05, ball),), caption=lambda number, sample: f"{{number}} {{sample}}",
             size=(160, 120))
except sim.MachineError as error:
    sys.exit(str(error))
"""
    done = subprocess.run(
        [sys.executable, "-c", program],
        env=os.environ | {"MUJOCO_GL": "egl"},
        capture_output=True,
        text=True,
        check=False,
    )
    if done.returncode and "GL" in done.stderr:
        pytest.skip(done.stderr.strip().splitlines()[-1])
    assert done.returncode == 0, done.stderr
    with av.open(str(tmp_path / "arm.mp4")) as container:
        pictures = [frame.to_ndarray(format="rgb24") for frame in container.decode(video=0)]
    assert len(pictures) == 3  # at 0, 0.04 and 0.08 s
    assert pictures[0].shape[1] == 320 and pictures[0].shape[0] > 120
    # The arm is not white, the text is dark, and both halves show the same arm.
    scene = pictures[0][:120].astype(float)
    assert scene.std() > 20
    assert np.abs(scene[:, :160] - scene[:, 160:]).mean() < 5  # of 255, but for the compression
    assert pictures[0][120:].min() < 100


def test_films_that_cannot_be_made_are_refused(tmp_path: Path):
    _, truth = sim.simulate(sim.puma560(), sim.training(samples=5))
    cases: list[tuple[str, Any, dict[str, Any], str]] = [
        ("arm.avi", truth, {}, r"arm\.avi; expected a name that ends in \.mp4"),
        ("arm.mp4", [], {}, "expected one or more motions"),
        ("arm.mp4", truth, {"titles": ["a", "b"]}, "2 titles for 1 motions"),
        ("arm.mp4", truth, {"size": (101, 100)}, "expected even numbers of pixels"),
    ]
    for name, truths, options, message in cases:
        with pytest.raises(sim.MachineError, match=message):
            sim.film(tmp_path / name, sim.puma560(), truths, **options)


def test_a_film_needs_pyav(tmp_path: Path, monkeypatch: pytest.MonkeyPatch):
    _, truth = sim.simulate(sim.puma560(), sim.training(samples=5))
    monkeypatch.setitem(sys.modules, "av", None)
    with pytest.raises(ImportError, match=r"av is not installed: pip install 'jaxcslc\[film\]'"):
        sim.film(tmp_path / "arm.mp4", sim.puma560(), truth)
