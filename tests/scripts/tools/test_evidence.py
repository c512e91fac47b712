"""Evidence pages begin with what they found, and charts show the figures of their tables."""

import re
from pathlib import Path

import pytest
import yaml

from scripts.tools.evidence_charts import CHARTS, FOLDER, Chart, drawn
from scripts.tools.stored_figures import cell_of, numbers_of, stored, tables


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
    advice = "run python -m scripts.tools.evidence_charts"
    assert (FOLDER / f"{name}.svg").read_text("utf-8") == drawn(CHARTS[name]), advice


def test_bars_are_as_long_as_their_values() -> None:
    groups, series = (
        {"KR300": "KUKA KR300 | B", "TX40": "Stäubli TX40 | last third"},
        {"": "identify"},
    )
    picture = drawn(Chart("title", "real_robots.md # {group} | {series} | mean", groups, series))
    first, second = (float(x) for x in re.findall(r'width="([\d.]+)" height="11" fill', picture))
    values = [stored(f"real_robots.md # {group} | identify | mean")[0] for group in groups.values()]
    assert first / second == pytest.approx(values[0] / values[1], rel=0.01)


def test_cells_are_found_by_their_names() -> None:
    row = "KUKA KR300, B & mean of before and after"
    with pytest.raises(ValueError, match="no such cell"):
        cell_of("friction_evidence.md", "Joints at standstill", "motion", row, "9")
    assert numbers_of("−1.5 ± 0.2") == [-1.5, 0.2]
    with pytest.raises(ValueError, match="expected a number"):
        numbers_of("never")
    assert all(len(names) == len(row) for _, names, rows in tables("benchmarks.md") for row in rows)
    assert stored("demo/errors_a.csv | mean ε | Ar+LS")[0] > 1.0
    with pytest.raises(ValueError, match="no such figure"):
        stored("benchmark nothing")
