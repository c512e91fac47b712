"""Two sets of references are compared by their numbers; words, keys and files must be equal."""

import copy
import json
from pathlib import Path
from typing import Any

import pytest

from scripts.tools.references.__main__ import main
from scripts.tools.references.commands import DIRECT, SEARCHED, Limits
from scripts.tools.references.findings import Findings


DOCUMENT: dict[str, Any] = {
    "version": 1,
    "k": [650.0, 0.02],
    "standard_error": [10.0, 1e-3],
    "covariance": [[100.0, 1e-9], [1e-9, 1e-6]],
    "settings": {"method": "butterworth", "cutoff": 12.0, "order": 4},
    "used": True,
    "series": [[1.0, 1e-13], [2.0, None]],
    "warnings": ["joint 4: RMS 43.2 N m"],
}


def differences(limits: Limits = DIRECT, **changed: Any) -> Findings:
    """What differs where these keys have other values."""
    findings = Findings(limits)
    findings.documents(DOCUMENT, {**copy.deepcopy(DOCUMENT), **changed}, "x.json")
    return findings


def test_coefficients_differ_in_standard_errors() -> None:
    findings = differences(k=[650.0 * (1 + 1e-6), 0.02])
    assert findings.errors == pytest.approx(6.5e-5)
    assert findings.relative == 0
    assert findings.different[0].startswith("x.json.k[0]")
    assert not differences(SEARCHED, k=[650.0 * (1 + 1e-6), 0.02]).different
    assert not differences(k=[650.0 + 1e-9, 0.02]).different


@pytest.mark.parametrize(
    "changed",
    [
        {"standard_error": [10.0, 1.001e-3]},
        {"settings": {"method": "splines", "cutoff": 12.0, "order": 4}},
        {"settings": {"method": "butterworth", "cutoff": 12.0}},
        {"settings": {"method": "butterworth", "cutoff": 12.0, "order": 5}},
        {"used": False},
        {"used": None},
        {"k": [650.0]},
        {"series": [[1.0, 1e-13], [2.0, 0.0]]},
        {"series": [[1.0, 1e-13], [2.1, None]]},
        {"warnings": []},
        {"warnings": ["joint 5: RMS 43.2 N m"]},
        {"warnings": ["joint 4: RMS 43.5 N m"]},
    ],
)
def test_what_differs_is_seen(changed: dict[str, Any]) -> None:
    assert differences(**changed).different


@pytest.mark.parametrize(
    "changed",
    [
        {},
        {"version": 2},
        {"covariance": [[100.0, 1.5e-9], [1.5e-9, 1e-6]]},  # a small correlation
        {"series": [[1.0, 2e-13], [2.0, None]]},  # nearly zero
        {"warnings": ["joint 4: RMS 43.3 N m"]},  # the last digit
    ],
)
def test_what_does_not_matter_is_let_pass(changed: dict[str, Any]) -> None:
    assert not differences(**changed).different


def test_new_keys_are_listed() -> None:
    findings = differences(more=1)
    assert findings.new == ["x.json.more"]
    assert not findings.different


def test_tables_and_texts() -> None:
    table = "name,value,standard_error\nkv1,0.5,0.01\nkd1,2,0.01\n"
    findings = Findings(DIRECT)
    findings.tables(table, table.replace("0.5", "0.501"), "x.csv")
    assert findings.errors == pytest.approx(0.1)
    findings = Findings(DIRECT)
    findings.tables(table, table.replace("kd1", "kd2"), "x.csv")
    findings.texts("k[0] = 1.5;\n", "k[0] = 1.5000001;\n", "x.c")
    findings.texts("9.99 of 205\n", "10 of 204.9\n", "x.txt")  # of three and four digits
    findings.texts("a  1.25\n", "a 1.26\n", "x.txt")  # the last digit, and a narrower column
    assert [entry.partition(": ")[0] for entry in findings.different] == ["x.csv.name:3"]
    findings.texts("k[0] = 1.50000000;\n", "k[0] = 1.50001;\n", "x.c")
    findings.texts("12 of 86\n", "13 of 86\n", "x.txt")
    assert len(findings.different) == 3


def test_sets_of_references(tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    for name in ("old", "new"):
        (tmp_path / name / "puma_a").mkdir(parents=True)
        (tmp_path / name / "puma_a" / "x.json").write_text(json.dumps(DOCUMENT))
    command = ["compare", str(tmp_path / "old"), str(tmp_path / "new")]
    assert main(command) == 0
    (tmp_path / "new" / "puma_a" / "x.json").write_text(json.dumps({**DOCUMENT, "used": False}))
    assert main(command) == 1
    assert "x.json.used: False in place of True" in capsys.readouterr().out
    assert main([*command, "--ignore", "puma_a/x.json.used"]) == 0
    (tmp_path / "new" / "puma_a" / "x.json").unlink()
    assert main(command) == 1
