"""Evidence pages begin with what they found, and charts show the figures of their tables."""

import re
from pathlib import Path

import pytest
import yaml

from scripts.studies.stored import RESULTS, Results, filled, load, save
from scripts.tools.evidence import CHARTS, FOLDER, Chart, drawn, solve_accuracy
from scripts.tools.stored_figures import cell_named, numbers_of, stored


DOCS = Path(__file__).parents[3] / "docs"


def evidence_pages() -> list[str]:
    """Pages that the site lists as evidence; a comparison of features has no figures."""
    text = (DOCS.parent / "mkdocs.yml").read_text("utf-8")
    nav = yaml.safe_load(text[text.index("\nnav:") :])["nav"]
    (pages,) = (entry["Evidence"] for entry in nav if "Evidence" in entry)
    listed = [page for page in pages if page != "comparison.md"]
    return [*listed, "experiment.md", "puma_a_b.md", "thesis.md", "ultrasound.md"]


@pytest.mark.parametrize("page", evidence_pages())
def test_begins_with_a_summary_and_a_chart(page: str) -> None:
    text = (DOCS / page).read_text("utf-8")
    match = re.match(r"# .+\n\n((?:- .+\n(?:  .+\n)*){2,4})\n!\[.+\]\((images/.+)\)\n", text)
    assert match is not None, "expected a title, two to four points and a chart"
    assert (DOCS / match[2]).is_file()


@pytest.mark.parametrize("name", CHARTS)
def test_a_chart_is_what_its_tables_say(name: str) -> None:
    advice = "run python -m scripts.tools.evidence"
    assert (FOLDER / f"{name}.svg").read_text("utf-8") == drawn(CHARTS[name]), advice


def test_bars_are_as_long_as_their_values() -> None:
    groups, series = (
        {"KR300": "KUKA KR300, B", "TX40": "Stäubli TX40, last third"},
        {"": "identify"},
    )
    picture = drawn(Chart("title", "real_robots/{group} | {series} | mean", groups, series))
    first, second = (float(x) for x in re.findall(r'width="([\d.]+)" height="11" fill', picture))
    values = [stored(f"real_robots/{group} | identify | mean")[0] for group in groups.values()]
    assert first / second == pytest.approx(values[0] / values[1], rel=0.01)


def test_cells_are_found_by_their_names() -> None:
    row = "rests/errors | KUKA KR300 & B & by the sign of velocity"
    assert cell_named(f"{row} | 2") == "15.7"
    with pytest.raises(ValueError, match="no such cell"):
        cell_named(f"{row} | 9")
    with pytest.raises(ValueError, match="no such table; rests has errors"):
        cell_named("rests/nothing | row | column")
    with pytest.raises(ValueError, match="nothing: there are no such results"):
        cell_named("nothing/errors | row | column")
    assert numbers_of("−1.5 ± 0.2") == [-1.5, 0.2]
    with pytest.raises(ValueError, match="expected a number"):
        numbers_of("never")
    assert stored("demo/errors_a.csv | mean ε | Ar+LS")[0] > 1.0
    assert stored("puma_a_b.md # Effect on the torque | PUMA | A | all")[0] > 0.0
    with pytest.raises(ValueError, match="no such figure"):
        stored("benchmark nothing")


def tables_on_pages() -> list[str]:
    return [
        name
        for page in sorted(DOCS.glob("*.md"))
        for name in re.findall(r"<!-- table: (.+) -->", page.read_text("utf-8"))
    ]


@pytest.mark.parametrize("page", evidence_pages())
def test_a_page_has_its_stored_tables(page: str) -> None:
    text = (DOCS / page).read_text("utf-8")
    assert text == filled(text), "run python -m scripts.tools.evidence"


@pytest.mark.parametrize("run", sorted(path.stem for path in RESULTS.glob("*.json")))
def test_the_program_of_stored_results_exists(run: str) -> None:
    """Or its commit is named."""
    results = load(run)
    program = re.search(r"python -m (scripts[\w.]+)", results.command)
    if program is not None and "at commit" not in results.sample:
        assert (DOCS.parent / f"{program[1].replace('.', '/')}.py").is_file(), results.command


def test_each_stored_table_is_on_a_page_once() -> None:
    stored_tables = [
        f"{path.stem}/{name}" for path in RESULTS.glob("*.json") for name in load(path.stem).tables
    ]
    assert sorted(tables_on_pages()) == sorted(stored_tables)


# Tables that define something and have no results, by their heads; and pages that programs write.
_DEFINITIONS = {
    "estimators.md": ["| | unknowns | needs | its weakness |"],
    "generalisation.md": ["| | |"],
    "systems_evidence.md": ["| system | described by | simulated by |"],
    "ultrasound.md": [
        "| | | reason |",
        "| from | law | source |",
        "| kind | random dimensions | characteristic |",
        "| input | quantity | middle ± half width |",
    ],
}
_WRITTEN_WHOLE = {"benchmarks.md", "experiment.md", "puma_a_b.md", "thesis.md"}


@pytest.mark.parametrize("page", sorted(set(evidence_pages()) - _WRITTEN_WHOLE))
def test_no_table_of_results_is_typed(page: str) -> None:
    text = (DOCS / page).read_text("utf-8")
    typed = re.sub(r"<!-- table: (?:.*\n)*?<!-- end -->", "", text)
    heads = re.findall(r"(?:^|\n\n)(\|.+\|)\n\|-", typed)
    assert heads == _DEFINITIONS.get(page, [])


def test_the_accuracy_of_solves_is_that_of_the_stored_benchmark() -> None:
    assert load("solve_accuracy") == solve_accuracy()


def test_what_is_stored_is_what_a_page_shows(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setattr("scripts.studies.stored.RESULTS", tmp_path)
    results = Results("python -m x", "2026-11-28", "one seed", {"t": [["a|b", ""], ["1", "2"]]})
    save("run", results)
    assert load("run") == results
    page = "text\n<!-- table: run/t -->\nold\n<!-- end -->\nmore\n"
    now = filled(page)
    assert "\n\n| a\\|b | |\n|---|---|\n| 1 | 2 |\n\n*Measured 2026-11-28, one seed*: `" in now
    assert now.startswith("text\n") and now.endswith("<!-- end -->\nmore\n")
    assert "old" not in now and filled(now) == now
    with pytest.raises(ValueError, match="has no end"):
        filled("<!-- table: run/t -->\n")
    with pytest.raises(ValueError, match="rows of one length"):
        save("run", Results("", "", "", {"t": [["a"], ["1", "2"]]}))
