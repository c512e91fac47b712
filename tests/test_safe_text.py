"""Names that a stranger chose, in what is printed and in CSV files."""

import csv
import io
import unicodedata
from pathlib import Path

import numpy as np
import pytest

import jaxcslc as jc
from jaxcslc._text_table import csv_line, printable
from jaxcslc.report import write_csv
from tests.conftest import run


HOSTILE = '=HYPERLINK("http://x"),\n\x1b]0;owned\x07\x1b[31m\u202eτ|!\''
ROBOT = """
name = {name}
gravity = [0, -9.81, 0]
[[joint]]
name = {name}
"""


def test_nothing_that_a_terminal_obeys_is_printed() -> None:
    """All control and format characters of Unicode, by its own table, but the end of a line."""
    text = "".join(map(chr, range(0x2100)))
    kept = printable(text)
    obeyed = {"Cc", "Zl", "Zp"}
    assert {c for c in kept if unicodedata.category(c) in obeyed} == {"\n"}
    assert not any(unicodedata.bidirectional(c) in {"LRE", "RLE", "LRO", "RLO"} for c in kept)
    assert printable("kΩ é\n") == "kΩ é\n"


@pytest.mark.parametrize("name", ["a,b", "a\nb", 'a"b', "=1+1", "+1", "@x", "-2+3|x!A1", "\t=1"])
def test_a_csv_reader_sees_one_cell_and_no_formula(name: str, tmp_path: Path) -> None:
    write_csv(tmp_path / "table.csv", [{"name": name, "value": -1.5}])
    text = (tmp_path / "table.csv").read_text(encoding="utf-8")
    header, row = csv.reader(io.StringIO(text, newline=""))
    assert header == ["name", "value"] and row[1] == "-1.5"
    assert row[0].removeprefix("'") == name and row[0][0] not in "=+@-\t"


def test_expressions_of_coefficients_are_as_they_were() -> None:
    assert csv_line(["-Iyy2 + Ixx2", "-3"]) == "-Iyy2 + Ixx2,-3"


def test_hostile_names_in_all_that_a_command_prints_and_writes(tmp_path: Path) -> None:
    robot, log = tmp_path / "arm.toml", tmp_path / "log.csv"
    escaped = "".join(f"\\u{ord(c):04x}" for c in HOSTILE)
    robot.write_text(ROBOT.format(name=f'"{escaped}"'), encoding="utf-8")
    network = jc.derive(jc.load_robot(robot), lengths="numeric")
    assert network.robot.joint_names == (HOSTILE,)
    t = np.arange(500)[:, None] * 0.01
    q, qd, qdd = np.sin(2 * t), 2 * np.cos(2 * t), -4 * np.sin(2 * t)
    torque = np.asarray(network.torque(np.ones(network.size), q, qd, qdd))
    jc.save_recording(jc.Recording(t[:, 0], q, torque), log)
    out = tmp_path / "results"
    for line in (
        ("identify", robot, log, "-o", out, "--no-check", "--no-systematic"),
        ("identify", robot, log, "-o", out, "--no-check", "--no-systematic", "--json"),
        ("derive", robot, "-o", tmp_path / "derived"),
        ("check", robot, log),
        ("identify", robot, tmp_path / HOSTILE.replace("/", ""), "-o", out),
    ):
        result = run(*line)
        assert result.exception is None, result.exception
        controls = {c for c in result.output if unicodedata.category(c) in {"Cc", "Cf"}}
        assert controls <= {"\n"}
    for path in (*out.glob("*.csv"), *(tmp_path / "derived").glob("*.csv")):
        with path.open(encoding="utf-8", newline="") as file:
            rows = list(csv.reader(file))
        assert len({len(row) for row in rows}) == 1, path
        assert not any(cell.startswith(("=", "+", "@")) for row in rows for cell in row), path
