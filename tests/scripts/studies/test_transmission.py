"""The tables of the study of compliant gears, from rows that are known."""

from collections.abc import Iterator
from pathlib import Path
from typing import Any

import numpy as np
import pytest

import jaxcslc as jc
from scripts.studies.likelihood import limits, transmission


def known_rows(
    machine: object, samples: int, seed: int, selected: bool
) -> Iterator[dict[str, Any]]:
    """Maximum likelihood has nine tenths of regression's error, and does not converge once."""
    del machine, samples, selected
    regression = 0.1 + 0.01 * seed
    last = transmission.LAST
    for name, part in (("true", 1.5), ("regression", 1.0), (last, 0.9)):
        yield {
            "estimator": name,
            "epsilon": part * regression,
            "inside": 40 + seed,
            "seconds": 2.0,
            "converged": not (name == last and seed == 1),
        }


def test_tables_and_resumption(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]
) -> None:
    calls: list[int] = []

    def counted(*arguments: Any) -> Iterator[dict[str, Any]]:
        calls.append(arguments[2])
        return known_rows(*arguments)

    monkeypatch.setattr(transmission, "rows_of", counted)
    assert transmission.main(["--seeds", "2", "-o", str(tmp_path)]) == 0
    assert transmission.main(["--seeds", "3", "-o", str(tmp_path)]) == 0
    assert calls == [0, 0, 1, 1, 2, 2]  # two machines
    printed = capsys.readouterr().out.split("PUMA B")[-1]
    (line,) = [line for line in printed.split("\n") if line.startswith("likelihood")]
    values = line.split("all terms")[1].split()
    assert values[:5] == ["0.0990", "0.0900", "0.1080", "0.900", "0.900"]
    assert values[5:] == ["41.0", "2", "of", "3", "2.0"]


def test_intervals_of_means_of_two_directions() -> None:
    pendulum = jc.examples.pendulum()
    plain = jc.derive(pendulum.with_friction("viscous"), lengths="numeric")
    both = jc.derive(pendulum.with_friction("asymmetric_viscous"), lengths="numeric")
    t = np.arange(200)[:, None] * 0.01
    q, qd, qdd = np.sin(2 * t), 2 * np.cos(2 * t), -4 * np.sin(2 * t)
    k = np.array([0.5, 0.3, -0.1, 0.3, 0.2])
    torque = np.asarray(both.torque(k, q, qd, qdd))
    torque = torque + 0.01 * np.random.default_rng(0).normal(size=t.shape)
    result = jc.MaximumLikelihood(torque_sampling="sampled").fit(
        both, jc.Recording(t[:, 0], q, torque)
    )
    interval = transmission.means_of_directions(plain, result.fit, None)
    low, high = np.asarray(result.fit.confidence_interval()).T
    # The others are as they were; the mean's middle is the mean of the two middles.
    np.testing.assert_allclose(interval[:3], np.stack([low, high], axis=1)[:3])
    np.testing.assert_allclose(interval[3].mean(), 0.25 * (low + high)[3:].sum())
    covariance = np.asarray(result.fit.covariance)[3:, 3:]
    ratio = np.ptp(interval[3]) / (high - low)[3]
    expected = np.sqrt(0.25 * covariance.sum() / covariance[0, 0])
    np.testing.assert_allclose(ratio, expected)


def test_epsilon_of_errors_is_that_of_compare() -> None:
    pendulum = jc.Manipulator.from_modified_dh([(0, 0, 0, 0)] * 2, gravity=(0, -9.81, 0))
    network = jc.derive(pendulum, lengths="numeric")
    rng = np.random.default_rng(1)
    t = np.arange(100) * 0.01
    mask = rng.random((100, 2)) < 0.5
    zeros = np.zeros((100, 2))
    torque = rng.normal(size=(100, 2))
    patterns = jc.Patterns(t, zeros, zeros, zeros, torque, np.ones_like(mask), mask)
    k = np.zeros(network.size)
    expected = float(np.asarray(jc.compare(network, patterns, {"fit": k}).epsilon)[0])
    np.testing.assert_allclose(limits.epsilon(torque, mask), expected)
