"""The tables of the study of compliant gears, from rows that are known."""

from collections.abc import Iterator
from pathlib import Path
from typing import Any

import pytest

from scripts.studies.likelihood import transmission


def known_rows(machine: object, samples: int, seed: int) -> Iterator[dict[str, Any]]:
    """Maximum likelihood has nine tenths of regression's error, and does not converge once."""
    del machine, samples
    regression = 0.1 + 0.01 * seed
    last = "likelihood, every 3, order 1"
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
    values = line.split("order 1")[1].split()
    assert values[:5] == ["0.0990", "0.0900", "0.1080", "0.900", "0.900"]
    assert values[5:] == ["41.0", "2", "of", "3", "2.0"]
