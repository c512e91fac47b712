"""The control benchmark: every figure is there, and C's torque is Python's."""

import shutil

import pytest

from scripts.benchmarks import control


def test_figures(capsys: pytest.CaptureFixture[str]) -> None:
    if shutil.which("cc") is None:
        pytest.skip("no C compiler")
    metrics = list(control.metrics(calls=10, robots=("puma560",), samples=30))
    names = [metric.name for metric in metrics]
    assert names == [
        "puma560.step",
        "puma560.step_with_payload",
        "puma560.payload_update",
        "puma560.guarded_step",
        "puma560.step_in_c",
    ]
    assert all(metric.value > 0 and metric.unit == "us" for metric in metrics)
    with pytest.raises(SystemExit):
        control.main(["--calls", "0"])
    assert "--calls is 0; expected 1 or more" in capsys.readouterr().err
