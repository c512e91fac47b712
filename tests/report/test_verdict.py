"""Verdicts of whole reports: sensor noise is no error of the model, a wrong recording is one."""

import dataclasses
from types import SimpleNamespace
from typing import Any

import numpy as np
import pytest

import jaxcslc as jc
from jaxcslc.report.sections._coefficient_table import CoefficientSection


# White noise of the torque, as a part of its RMS: more than an error that calls for care.
NOISE = 0.15


@pytest.fixture(scope="module")
def network() -> jc.CSLC:
    return jc.derive(jc.examples.pendulum(), lengths="numeric")


def recorded(network: jc.CSLC, noise: float) -> jc.Recording:
    swing = jc.examples.swing_recording(network, [0.5, 0.3, -0.1, 0.2, 0.05], samples=2000)
    size = np.sqrt(np.mean(swing.torque**2, axis=0))
    scatter = noise * size * np.random.default_rng(0).standard_normal(swing.torque.shape)
    return dataclasses.replace(swing, torque=swing.torque + scatter)


def test_sensor_noise_is_no_error(network: jc.CSLC) -> None:
    report = jc.identify(network, recorded(network, NOISE), settings=jc.Settings())
    quality = report.section("quality")
    held_out = report.section("held_out")
    assert quality is not None and held_out is not None
    noise = quality.data["quality"]["training"]["noise"][0]
    rms = quality.data["quality"]["training"]["judged"]["rms"][0]
    assert noise == pytest.approx(rms, rel=0.1)  # nothing but noise is left
    for section in (quality, held_out):
        assert {message.tone for message in section.messages(report)} == {"good"}


def test_a_wrong_recording_is_not_to_be_relied_on(network: jc.CSLC) -> None:
    right = recorded(network, 0.01)
    wrong = dataclasses.replace(right, position=np.degrees(right.position))
    report = jc.identify(network, wrong, settings=jc.Settings())
    assert report.page(charts=False).tone == "bad"
    assert "The recording is wrong: positions are in degrees." in report.verdict


@pytest.mark.parametrize(
    ("others", "tone"),
    [
        ({"from the file": 9}, "good"),
        ({"indistinguishable from zero": 9}, "good"),
        ({"poorly determined": 2, "systematic error": 1}, "good"),
        ({"poorly determined": 2, "systematic error": 2}, "caution"),
        ({"not determined": 1}, "caution"),
    ],
)
def test_what_the_file_knows_is_not_in_doubt(others: dict[str, int], tone: str) -> None:
    """The verdict of coefficients, four of which are well determined."""
    kinds = {"well determined": 4, **others}
    rows = [{"verdict": kind, "positive": False} for kind, n in kinds.items() for _ in range(n)]
    report: Any = SimpleNamespace(rows=lambda: rows, systematic=None)
    (message,) = CoefficientSection(dict).messages(report)
    assert message.tone == tone
