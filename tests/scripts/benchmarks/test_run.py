"""The benchmarks' command: groups, stored figures, merging, the page."""

from collections.abc import Iterator
from importlib.util import find_spec
from pathlib import Path

import pytest

from scripts.benchmarks import run
from scripts.benchmarks.groups import GROUPS, Group
from scripts.benchmarks.metrics import Metric
from scripts.benchmarks.stored import page as page_module, results


def figures() -> Iterator[Metric]:
    yield Metric("stream.rate", 3.0, "million patterns/s", "higher", target=2.5)
    yield Metric("stream.seconds", 12.3456789, "s", "lower", target=5.0)
    yield Metric("forward.rate", 5.3149999, "million patterns/s", "higher")  # stored as 5.315
    yield Metric("stream.of_copy", 0.25, "1", "higher")


@pytest.fixture
def stored(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> Path:
    """Two groups of one module's figures, and a folder for what is stored."""
    toy = Group("toy", "What it measures.")
    monkeypatch.setattr(Group, "metrics", lambda self: figures())
    for name in ("direct solve", "control"):
        monkeypatch.setitem(GROUPS, name, toy)
    monkeypatch.setattr(run, "PAGE", tmp_path / "benchmarks.md")
    path = tmp_path / "results.json"
    monkeypatch.setattr(run, "load", lambda file=path: results.load(file))
    monkeypatch.setattr(run, "save", lambda x, file=path: results.save(x, file))
    return tmp_path


def test_a_group_that_is_not_run_keeps_its_figures(stored: Path) -> None:
    other = results.Measurement("control", "other machine", "2020-01-01", tuple(figures()))
    results.save([other], stored / "results.json")
    assert run.main(["--groups", "direct solve", "--update"]) == 0
    kept, new = sorted(results.load(stored / "results.json"), key=lambda x: x.date)
    assert (kept.group, kept.machine, kept.date) == ("control", "other machine", "2020-01-01")
    assert (new.group, new.machine) == ("direct solve", results.this_machine())
    assert [metric.value for metric in new.metrics] == [3.0, 12.346, 5.315, 0.25]
    text = (stored / "benchmarks.md").read_text(encoding="utf-8")
    assert "other machine; 2020-01-01:" in text
    assert "| `stream.rate` | **3** | million patterns/s | higher | 2.5 |" in text
    assert "| `stream.seconds` | 12.3 | s | lower | 5 |" in text
    assert text == page_module.page(results.load(stored / "results.json"))


def test_figures_of_another_machine_are_merged(stored: Path) -> None:
    old = results.Measurement("control", "one H200", "2020-01-01", ())
    results.save([old], stored / "results.json")
    results.save(
        [results.Measurement("control", "one H200", "2020-02-01", tuple(figures()))],
        stored / "there.json",
    )
    assert run.main(["--merge", str(stored / "there.json")]) == 0
    (entry,) = results.load(stored / "results.json")
    assert (entry.date, len(entry.metrics)) == ("2020-02-01", 4)
    (stored / "there.json").write_text('[{"row": 1}]')
    with pytest.raises(ValueError, match="expected measurements"):
        run.main(["--merge", str(stored / "there.json")])


def test_worse_figures_are_counted(stored: Path, capsys: pytest.CaptureFixture[str]) -> None:
    run.main(["--groups", "control", "--update"])
    assert run.main(["--groups", "control", "--gate"]) == 0
    (entry,) = results.load(stored / "results.json")
    better = Metric("stream.rate", 6.0, "million patterns/s", "higher")
    results.save(
        [results.Measurement(entry.group, entry.machine, entry.date, (better,))],
        stored / "results.json",
    )
    assert run.main(["--groups", "control", "--gate"]) == 1
    assert "-50.0%!" in capsys.readouterr().out


def test_the_committed_page_is_that_of_the_committed_figures() -> None:
    assert page_module.PAGE.read_text(encoding="utf-8") == page_module.page(results.load())


def test_groups_name_modules() -> None:
    for group in GROUPS.values():
        assert find_spec(f"scripts.benchmarks.{group.module}") is not None
