"""A fixed sample of the fuzzer's cases, and the fuzzer's own judgement."""

import os
import random
import sys
from pathlib import Path
from typing import Any

import pytest

from scripts.tools import invoke
from scripts.tools.fuzz import cases, verdict
from scripts.tools.fuzz.mutations import mutated_bytes, mutated_document, mutated_text
from scripts.tools.fuzz.templates import ROBOTS, write_inputs


# Kinds that neither fit nor compile, a few milliseconds a case.
QUICK = ("robot", "system", "formula")
NUMBERS = range(150)


@pytest.fixture(scope="module")
def templates(tmp_path_factory: pytest.TempPathFactory) -> Path:
    folder = tmp_path_factory.mktemp("templates")
    write_inputs(folder)
    return folder


def test_a_sample_ends_in_a_result_or_one_line(templates: Path, tmp_path: Path) -> None:
    """Robots and systems: the other kinds fit, and take minutes with `scripts.tools.fuzz.run`."""
    numbers = [number for number in NUMBERS if cases.kind_of(number) in QUICK]
    rows = [verdict.run_case(number, templates, tmp_path / "case") for number in numbers]
    assert [row for row in rows if row["fault"]] == []
    assert {row["code"] for row in rows} == {0, 2} and len(rows) > 40


def test_a_case_follows_from_its_number(templates: Path, tmp_path: Path) -> None:
    number = next(number for number in NUMBERS if cases.kind_of(number) == "robot")
    made: list[tuple[list[str], list[bytes]]] = []
    for repeat in range(2):
        folder = tmp_path / str(repeat)
        folder.mkdir()
        example = cases.case(number, templates, folder)
        arguments = [text.replace(str(folder), "") for text in example.lines[0]]
        made.append((arguments, [path.read_bytes() for path in sorted(folder.rglob("*.*"))]))
    assert made[0] == made[1]


def test_mutations_change_files(templates: Path) -> None:
    draw = random.Random(0)
    for name in ROBOTS:
        text = (templates / name).read_text("utf-8")
        assert any(mutated_text(text, draw) != text.encode() for _ in range(3))
        assert any(mutated_bytes(text.encode(), draw) != text.encode() for _ in range(3))
    document = {"a": [1, {"b": 2.5}], "c": None}
    mutated = [mutated_document(document, draw) for _ in range(20)]
    assert document == {"a": [1, {"b": 2.5}], "c": None}
    assert sum(other != document for other in mutated) > 10


FAULTS = {
    "raise ZeroDivisionError('oh')": "traceback: ZeroDivisionError: oh",
    "sys.exit(3)": "exit code 3",
    "print('part'); print('jaxcslc: x', file=sys.stderr); sys.exit(2)": "printed before it failed",
    "print('a\\nb', file=sys.stderr); sys.exit(2)": "expected one line",
    "open('new', 'w').close(); print('jaxcslc: x', file=sys.stderr); sys.exit(2)": "left new",
    "open('.new', 'w').close()": "left .new",
    "print('hm', file=sys.stderr)": "standard error has",
    "print('rms nan N m')": "printed nan",
    "print('joint \\x1b[2J')": "printed what a terminal obeys",
    "Path('out.csv').write_text('a,b\\n1,inf\\n')": "wrote inf into out.csv",
    "Path('out.json').write_text('{\"a\": NaN}')": "wrote NaN into out.json",
    "bytearray(650 << 20)": "took 6",
    "os.write(2, b'oh')": "a library printed 'oh'",
    "print('fine')": None,
    "print('jaxcslc: x', file=sys.stderr); sys.exit(2)": None,
}


@pytest.mark.parametrize("program", FAULTS)
def test_what_is_wrong_is_seen(
    program: str, templates: Path, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    def command(*_: Any, **__: Any) -> int:
        exec(program, {"sys": sys, "os": os, "Path": Path})
        return 0

    monkeypatch.setattr(invoke, "run", command)
    monkeypatch.setattr(verdict, "MOST_MEMORY", 500 << 20)  # less than the machine may have
    monkeypatch.setattr(verdict, "case", lambda number, *_: cases.Case(number, "robot", [[]]))
    fault = verdict.run_case(0, templates, tmp_path / "case")["fault"]
    expected = FAULTS[program] or str(None)
    assert expected in str(fault)
