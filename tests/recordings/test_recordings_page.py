"""Every example of docs/recordings.md runs as it stands, in an empty folder."""

import re
import tomllib
from pathlib import Path

import pytest

from jaxcslc.recordings import ColumnMapping


PAGE = (Path(__file__).parents[2] / "docs" / "recordings.md").read_text("utf-8")


def test_python(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]
) -> None:
    printed: list[str] = []
    for i, example in enumerate(re.findall(r"```python\n(.*?)```", PAGE, re.DOTALL)):
        folder = tmp_path / str(i)
        folder.mkdir()
        monkeypatch.chdir(folder)
        exec(compile(example, "docs/recordings.md", "exec"), {})
        printed.append(capsys.readouterr().out)
    named, table, mapped, arrays, universal, franka, bag, measured = printed
    assert named == "('shoulder', 'elbow') [1.571 0.   ]\n"
    assert table == "0 64\n64 36\n"
    assert mapped == "[0. 1. 2. 3. 4. 5.]\n"
    assert arrays == "('shoulder', 'elbow')\n"
    assert "which the controller computes from its own model" in universal
    assert franka == "[0.    0.001 0.002 0.003 0.004 0.005]\n"
    assert measured == ""
    assert "[2. 1.] ('joints that are not read: gripper',)" in bag


def test_toml() -> None:
    mappings = [
        ColumnMapping.of(tomllib.loads(example))
        for example in re.findall(r"```toml\n(.*?)```", PAGE, re.DOTALL)
    ]
    assert [mapping.quantities["torque"].units for mapping in mappings] == [("A",), ("A",)]
