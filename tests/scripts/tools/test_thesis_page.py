"""docs/thesis.md covers the whole thesis, leads somewhere everywhere, and agrees with the code."""

import re
from pathlib import Path

import pytest

from scripts.tools.thesis import page, references, results
from scripts.tools.thesis.entries import FOLDER, Entry, Thesis, read


ROOT = Path(__file__).parents[3]
ADVICE = "docs/thesis.md is out of date: run scripts/tools/thesis/page.py"

# What the thesis numbers, read off its text: equations and figures by section, counted from 1.
EQUATIONS = {
    **{"2.3": 28, "2.4": 8, "2.5": 7, "2.6": 2, "2.7": 2},
    **{"3.3": 2, "3.4": 9, "4.1": 6, "5.1": 6, "6.1": 6, "6.2": 7},
    **{"7.2": 2, "7.3": 3, "7.6": 1},
}
FIGURES = {
    **{"2.5": 3, "2.6": 4, "2.7": 1, "3.1": 1, "3.3": 5, "3.4": 1, "3.6": 1, "4.2": 1, "4.3": 1},
    **{"5.1": 6, "6.1": 1, "6.2": 1, "6.3": 5, "7.2": 2, "7.3": 2, "7.4": 2, "7.6": 4, "8.2": 2},
    **{"B.1": 2, "B.3": 2, "B.4": 2, "B.5": 2, "B.6": 2},
}
# Sections by chapter, and subsections by section; the thesis has no 2.2.
SECTIONS = {"1": 6, "2": 8, "3": 7, "4": 4, "5": 4, "6": 4, "7": 7, "8": 2, "B": 6, "C": 2}
SUBSECTIONS = {
    **{"2.3": 3, "2.5": 3, "2.6": 4, "2.7": 1, "3.2": 3, "3.3": 5, "3.4": 2, "3.6": 2, "5.1": 5},
    **{"5.2": 7, "6.3": 3, "7.2": 5, "7.4": 2, "8.1": 5, "8.2": 5, "B.1": 4, "B.2": 2, "B.3": 4},
    "C.1": 7,
}


@pytest.fixture(scope="module")
def thesis() -> Thesis:
    return read()


def numbered(counts: dict[str, int], separator: str) -> set[str]:
    return {f"{name}{separator}{i + 1}" for name, count in counts.items() for i in range(count)}


def single(entries: tuple[Entry, ...]) -> list[str]:
    return [number for entry in entries for number in entry.each_number]


def test_every_section_equation_and_figure_has_its_entry(thesis: Thesis) -> None:
    sections = numbered(SECTIONS, ".") - {"2.2"} | numbered(SUBSECTIONS, ".") | {"A"}
    assert set(single(thesis.sections)) == sections
    assert set(single(thesis.equations)) == numbered(EQUATIONS, "-")
    # Two figures are called 7.6-4.
    assert set(single(thesis.figures)) == numbered(FIGURES, "-") | {"7.6-4 (second)"}


def test_entries_stand_in_the_thesis_s_order(thesis: Thesis) -> None:
    for entries in (thesis.sections, thesis.equations, thesis.figures):
        keys = [tuple(re.findall(r"[A-Z]|\d+", number)) for number in single(entries)]
        order = [[(part.isalpha(), part.zfill(3)) for part in key] for key in keys]
        assert order == sorted(order)


def test_the_page_is_what_the_code_says(thesis: Thesis) -> None:
    """Every reference is resolved and every number computed on the way."""
    written = (ROOT / "docs" / "thesis.md").read_text(encoding="utf-8").splitlines()
    now = page.page(thesis).splitlines()
    for old, new in zip(written, now, strict=False):
        assert old == new, ADVICE
    assert len(written) == len(now), ADVICE


def test_every_quantity_s_place_exists(thesis: Thesis) -> None:
    known = {*single(thesis.sections), *single(thesis.equations), *single(thesis.figures)}
    for quantity in thesis.quantities:
        assert quantity.where.removeprefix("Fig. ") in known, quantity.what


def test_tables_of_studies_are_those_that_the_page_reads() -> None:
    expected = {
        f"{study}/{name}" for study, (_, names) in results.STUDIES.items() for name in names
    }
    files = results.FOLDER.rglob("*.csv")
    assert {path.relative_to(results.FOLDER).as_posix() for path in files} == expected


@pytest.mark.parametrize(
    ("reference", "expected"),
    [
        ("sim.training", "[`sim.training`](api/sim.md#sim.training)"),
        (
            "jaxcslc.network.CSLC.order",
            "[`CSLC.order`](api/network.md#jaxcslc.network.CSLC)",
        ),
        ("docs/robots.md", "[Robot files](robots.md)"),
        ("docs/simulator.md#the-plant", "[The plant](simulator.md#the-plant)"),
        ("README.md", "`README.md`"),
        ("notebooks/control.ipynb", "[`notebooks/control.ipynb`](../notebooks/control.ipynb)"),
    ],
)
def test_references_lead_somewhere(reference: str, expected: str) -> None:
    assert references.link(reference) == expected


@pytest.mark.parametrize(
    ("reference", "message"),
    [
        ("sim.trainings", "sim.trainings: no such public name"),
        ("jaxcslc.network.CSLC.orders", "jaxcslc.network.CSLC.orders: no such public name"),
        ("docs/nowhere.md", "docs/nowhere.md: no such file or public name"),
        ("docs/export.md#code", "docs/export.md#code: no such heading; expected one of export"),
        # A comment of an example is no heading.
        ("docs/networks.md#nodes-by-number", "no such heading"),
        ("README.md#install", "expected no anchor"),
    ],
)
def test_references_that_lead_nowhere_are_named(reference: str, message: str) -> None:
    with pytest.raises(ValueError, match=re.escape(message)):
        references.link(reference)


def test_mistakes_in_entries_are_named(tmp_path: Path) -> None:
    for path in FOLDER.glob("*.toml"):
        (tmp_path / path.name).write_bytes(path.read_bytes())
    equations = tmp_path / "equations.toml"
    text = equations.read_text(encoding="utf-8")
    for wrong, message in (
        ('numbers = "2.3-1"\nsays = "x"', "2.3-1: expected by, exposition or left_out"),
        ('numbers = "2.3-1"\nbuy = ["sim.training"]', "equation 2.3-1: .*buy"),
        ('numbers = "2.3-1 to 2.4-2"\nnote = "x"\nleft_out = "x"', "a range within one section"),
        ('numbers = "2.4-5"\nleft_out = "x"', "equations 2.4-5: listed more than once"),
    ):
        equations.write_text(f"[[equation]]\n{wrong}\n{text}", encoding="utf-8")
        with pytest.raises(ValueError, match=message):
            read(tmp_path)


def test_results_are_copied_from_a_study_s_folder(tmp_path: Path) -> None:
    copies, images = tmp_path / "copies", tmp_path / "images"
    with pytest.raises(ValueError, match="holds none of demo"):
        results.collect(tmp_path, copies, images)
    demo = tmp_path / "demo"
    demo.mkdir()
    names = (*results.STUDIES["demo"][1], *results.PICTURES["demo"])
    for name in names[1:]:
        (demo / name).write_text(name, encoding="utf-8")
    with pytest.raises(ValueError, match=rf"{names[0]}: no such file; expected that of make demo"):
        results.collect(tmp_path, copies, images)
    (demo / names[0]).write_text(names[0], encoding="utf-8")
    copied = results.collect(tmp_path, copies, images)
    assert [path.read_text(encoding="utf-8") for path in copied] == list(names)
    assert {path.name for path in images.iterdir()} == set(results.PICTURES["demo"])


@pytest.mark.parametrize("machine", ["a", "b"])
def test_speeds_of_static_friction_are_findings(machine: str) -> None:
    """A joint whose static friction was not seen has no speed on the page."""
    stored = results.rows("demo", f"thresholds_{machine}.csv")
    for row, shown in zip(stored, results.thresholds(machine), strict=True):
        seen = row["seen in residuals"] == "yes"
        assert shown == (float(row["from residuals [rad/s]"]) if seen else "not seen")
    assert "not seen" in results.thresholds(machine)


def test_sections_that_lack_a_part_are_not_counted_as_whole(thesis: Thesis) -> None:
    lacking = [entry.numbers for entry in thesis.sections if entry.by and entry.left_out]
    assert "3.1" in lacking  # reinforcement and unsupervised learning
    (row,) = re.findall(r"^\| sections \|(.+)\|$", page.page(thesis), re.MULTILINE)
    *_, in_all, whole, in_part, exposition, missing = map(int, row.split("|"))
    assert in_part == len(lacking)
    assert whole + in_part + exposition + missing == in_all == len(thesis.sections)
