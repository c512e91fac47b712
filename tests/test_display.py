"""Results as notebooks and a console show them: representations, and charts of plotly."""

import dataclasses
from typing import Any

import jax
import numpy as np
import pytest

import jaxcslc as jc
from jaxcslc.manipulator import LinkParameters
from jaxcslc.servo import (
    ServoDrive,
    ServoFit,
    ServoParameter,
    ServoRecording,
    servo_report,
    simulate,
)
from tests import arms


@pytest.fixture(scope="module")
def recording() -> jc.Recording:
    recording = jc.examples.swing_recording(arms.planar_arm(), [0.3] * 11, samples=500)
    return dataclasses.replace(recording, joint_names=("shoulder", "<elbow>"))


def test_a_recording_says_what_it_is(recording: jc.Recording) -> None:
    assert repr(recording) == "Recording(500 samples of 2 joints, 4.99 s, 100 Hz)"
    shown = recording._repr_html_()
    assert "500 samples" in shown
    assert "<td>shoulder</td>" in shown
    assert "<td>&lt;elbow&gt;</td>" in shown


def test_patterns_say_what_is_fitted(recording: jc.Recording) -> None:
    patterns = jc.Settings().patterns(recording)
    share = 100 * np.mean(patterns.mask)
    assert repr(patterns).endswith(f"of 2 joints, {share:.3g} % of the pairs fitted)")
    assert patterns._repr_html_().count("<tr>") == 3
    seen: list[str] = []
    jax.eval_shape(lambda x: seen.append(repr(x)), patterns)
    assert seen == [f"Patterns(of shape {patterns.torque.shape})"]
    assert "Patterns(" in repr(jax.tree.map(lambda _: None, patterns))


def test_a_fit_shows_its_coefficients() -> None:
    network = arms.turntable()
    fit = jc.LeastSquares().fit(network, jc.examples.swing(network, [0.5, 0.2, 0.05]))
    shown = fit._repr_html_()
    assert "rank 3" in shown
    assert shown.count("<tr>") == 1 + len(network.names)
    assert "<td>kv1</td><td>0.2</td>" in shown


def test_a_network_shows_joints_and_coefficients() -> None:
    network = arms.planar_arm()
    shown = network._repr_html_()
    assert shown.count("<tr>") == 2 + network.joint_count + network.size
    assert "<td>kB1</td><td>kg m²</td>" in shown
    assert "*" not in shown  # of expressions in code


def test_counts_of_one_are_singular() -> None:
    network = jc.derive(jc.examples.pendulum())
    assert repr(network).startswith("CSLC(robot: 1 joint, 5 coefficients:")
    assert "1 joint R," in repr(network.robot)
    recording = jc.examples.swing_recording(network, [0.5, 0.3, -0.1, 0.2, 0.05], samples=50)
    assert "50 samples of 1 joint," in repr(recording)


def test_settings_say_what_they_do() -> None:
    settings = jc.Settings()
    assert repr(settings) == f"Settings({settings})"


def test_bodies_are_shown_in_a_table() -> None:
    network = jc.derive(jc.examples.pendulum())
    recording = jc.examples.swing_recording(network, [0.5, 0.3, -0.1, 0.2, 0.05])
    possible = jc.identify(network, recording, settings=jc.Settings()).possible
    header = "<th>body</th><th>mass</th><th>rx</th>"
    assert header in possible.parameters._repr_html_()
    assert header in possible._repr_html_()
    assert repr(possible).startswith("PossibleFit(unconstrained coefficients used; held-out error")


def test_a_payload_is_shown_in_a_table() -> None:
    network = jc.derive(jc.puma560()).with_payload()
    k = np.ones(network.size)
    recording = jc.examples.swing_recording(network, k, samples=500)
    report = jc.identify_payload(network, recording, settings=jc.Settings(), previous=k)
    assert report.fit._repr_html_().count("<tr>") == 11
    assert report._repr_html_().count("<tr>") == 11 + 1 + 6
    assert repr(report).startswith("PayloadReport of PUMA 560. PayloadFit(")


def test_servos_are_shown_in_a_table_and_on_a_page() -> None:
    rod = LinkParameters(0.5, np.array([0.2, 0.0, 0.0]), 0.002 * np.eye(3))
    arm = dataclasses.replace(jc.examples.pendulum(), links=(rod,))
    drive, time = ServoDrive(12.0, 0.8, delay=0.02, armature=0.02), np.arange(100) * 0.02
    command = np.sin(3.0 * time)[:, None]
    position = simulate(arm, [drive], time, command, [0.0])
    parameters = (
        ServoParameter(0, "delay", 0.02, 0.001, 0.018, 0.022, "s"),
        ServoParameter(0, "coulomb", 0.1, np.inf, -np.inf, np.inf, "N m"),
    )
    fit = ServoFit(arm, (drive,), parameters, np.zeros((2, 2)), "torque")
    assert repr(fit) == "ServoFit(robot: 1 servo, 1 of 2 parameters determined; torques determined)"
    assert "<td>delay</td><td>0.02</td><td>s</td><td>0.018</td><td>0.022</td>" in fit._repr_html_()
    report = servo_report(fit, {"sine": ServoRecording(time, position, command)})
    assert repr(report).startswith("ServoReport of robot. Simulated positions are ")
    assert "Servos of robot" in report._repr_html_()
    assert "Measured and simulated positions over time" not in report._repr_html_()


def test_a_recording_is_drawn(recording: jc.Recording) -> None:
    figure = recording.plot()
    assert [curve.name for curve in figure.data] == ["shoulder", "<elbow>"] * 2
    np.testing.assert_array_equal(figure.data[3].y, recording.torque[:, 1])
    with_velocity = dataclasses.replace(recording, velocity=recording.position)
    assert len(with_velocity.plot().data) == 6


def test_a_long_recording_is_drawn_by_some_thousand_points() -> None:
    time = np.arange(100_001) * 0.001
    column = np.sin(time)[:, None]
    (curve, _) = jc.Recording(time, column, column).plot().data
    assert 2000 < len(curve.x) <= 4000


def test_a_check_is_shown_and_drawn(recording: jc.Recording) -> None:
    page = jc.check(arms.planar_arm(), [recording, recording], ["a", "b & c"])
    assert repr(page).startswith("DataCheck(recordings: 2; ")
    assert "b &amp; c: 500 samples" in page._repr_html_()
    assert all(found.kind in page._repr_html_() for found in page.findings)
    figure = page.plot()
    assert [bar.name for bar in figure.data] == ["a", "b & c"] * 3
    low, length = figure.data[0].base, figure.data[0].y
    np.testing.assert_allclose(low, recording.position.min(axis=0))
    np.testing.assert_allclose(np.add(low, length), recording.position.max(axis=0))


def test_a_missing_extra_is_named(recording: jc.Recording, monkeypatch: pytest.MonkeyPatch) -> None:
    def missing(name: str, *_: Any) -> Any:
        raise ModuleNotFoundError(name=name)

    monkeypatch.setattr("importlib.import_module", missing)
    with pytest.raises(ImportError, match=r"pip install 'jaxcslc\[report\]'"):
        recording.plot()
