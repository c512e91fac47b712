"""Pages and charts: what is escaped, what is drawn, and what the drawings keep of their data."""

import importlib.util
from html.parser import HTMLParser
from typing import Any

import numpy as np
import plotly.graph_objects
import pytest

from jaxcslc.report import (
    AbstractChart,
    ArmChart,
    Column,
    Curve,
    Ellipsoid,
    Grid,
    MatrixChart,
    Message,
    Page,
    Panel,
    PanelChart,
    Paragraph,
    Section,
    Table,
    render,
)
from jaxcslc.report._charts import envelope, intervals


NAME = "<b>&\"'</script>$x$"

LINE = Curve(NAME, (0.0, 1.0, 2.0), (1.0, float("nan"), 3.0), "measured")
CHARTS: list[AbstractChart] = [
    PanelChart((Panel(NAME, (LINE,), ((0.5, 1.0),)), Panel("low", (LINE,))), "time [s]", NAME),
    MatrixChart((NAME, "kv1"), ((1.0, -0.5), (-0.5, 1.0)), NAME),
    ArmChart(np.ones((1, 2, 3)), (Ellipsoid(NAME, np.zeros(3), np.eye(3)),), NAME),
]


class Reader(HTMLParser):
    """Tags, texts outside scripts and styles, and the JSON of charts."""

    def __init__(self, text: str):
        super().__init__()
        self.tags: list[tuple[str, dict[str, str | None]]] = []
        self.text: list[str] = []
        self._silent = False
        self.feed(text)

    def handle_starttag(self, tag: str, attrs: list[tuple[str, str | None]]) -> None:
        self.tags.append((tag, dict(attrs)))
        self._silent = tag in ("script", "style")

    def handle_endtag(self, tag: str) -> None:
        del tag
        self._silent = False

    def handle_data(self, data: str) -> None:
        if not self._silent and data.strip():
            self.text.append(data.strip())


def page_with(*blocks: Any) -> Page:
    messages = (Message(NAME, "bad"),)
    return Page(NAME, NAME, NAME, "bad", messages, (Section("A section", NAME, blocks),))


def test_names_are_texts_wherever_they_stand() -> None:
    table = Table((Column(NAME, explanation=NAME), Column("x")), ((NAME, 1.5),), NAME, NAME)
    reader = Reader(render(page_with(Paragraph(NAME), table, *CHARTS)))
    assert "b" not in {tag for tag, _ in reader.tags}
    # Title, heading, subtitle, headline, message, lead, paragraph, caption, column, cell, charts.
    assert reader.text.count(NAME) == 10 + len(CHARTS)
    outside = [
        value
        for _, attributes in reader.tags
        for name, value in attributes.items()
        if name in ("src", "href") and not (value or "").startswith(("data:", "#"))
    ]
    assert outside == []


def test_numbers_are_shown_short_and_sorted_whole() -> None:
    column = Column("value", digits=3)
    assert column.text(1234.567) == "1.23e+03" and float(column.order(1234.567)) == 1234.567
    assert column.text(float("nan")) == column.order(float("nan")) == ""
    assert Column("angle", decimals=2).text(-0.001) == "0.00"
    reader = Reader(render(page_with(Table((column,), ((1234.567,),)))))
    (cell,) = (attributes for tag, attributes in reader.tags if tag == "td")
    assert cell["data-order"] == "1234.567"


@pytest.mark.parametrize("chart", CHARTS, ids=lambda chart: type(chart).__name__)
def test_charts_are_valid_in_plotly(chart: AbstractChart) -> None:
    """plotly's schema knows every entry, and finds the numbers that went in."""
    described = chart.plotly_figure()
    figure = plotly.graph_objects.Figure(described)
    assert len(figure.data) == len(described["data"])
    assert figure.layout.height == chart.height
    assert "<b>" not in str(described)


@pytest.mark.parametrize(("size", "labelled"), [(50, 50), (62, 31), (120, 40)])
def test_labels_of_a_large_matrix_do_not_overlap(size: int, labelled: int) -> None:
    """Ten pixels each are left at 50; the names of all stand in what a pointer shows."""
    names = tuple(f"kB{i}" for i in range(size))
    chart = MatrixChart(names, np.eye(size).tolist(), "correlations")
    described = chart.plotly_figure()
    axis = described["layout"]["xaxis"]
    assert len(axis["tickvals"]) == labelled
    assert axis["ticktext"] == [names[i] for i in axis["tickvals"]]
    assert described["data"][0]["text"][1][2] == "kB1, kB2"


def test_a_page_without_plotly_has_its_tables_and_names_the_extra_once(
    monkeypatch: pytest.MonkeyPatch,
) -> None:
    def nothing(name: str) -> None:
        del name

    monkeypatch.setattr(importlib.util, "find_spec", nothing)
    table = Table((Column("joint"),), (("elbow",),))
    reader = Reader(text := render(page_with(table, Grid(tuple(CHARTS)))))
    assert sum("pip install 'jaxcslc[report]'" in line for line in reader.text) == 1
    assert "elbow" in reader.text and "figure" not in {tag for tag, _ in reader.tags}
    assert len(text) < 50_000


def test_only_a_page_with_charts_has_the_program_that_draws_them() -> None:
    """Pictures inside a grid count too; a page of tables says nothing of extras."""
    with_charts, without = render(page_with(Grid(tuple(CHARTS)))), render(page_with(Grid(())))
    assert len(with_charts) > 1_000_000 and with_charts.count('data-chart="chart-') == len(CHARTS)
    assert len(without) < 50_000 and "pip install" not in without


def test_panels_share_their_time_and_lie_below_each_other() -> None:
    layout = CHARTS[0].plotly_figure()["layout"]
    assert layout["xaxis2"]["matches"] == "x"
    upper, lower = layout["yaxis"]["domain"], layout["yaxis2"]["domain"]
    assert upper[1] == 1.0 and lower[0] == 0.0 and lower[1] < upper[0]


def test_envelope_keeps_extremes_and_gaps(rng: np.random.Generator) -> None:
    x, y = np.arange(5000.0), rng.normal(size=5000)
    y[2000:3000] = np.nan
    fewer_x, fewer_y = envelope(x, y, 200)
    assert len(fewer_x) <= 200 and np.all(np.diff(fewer_x) > 0)
    np.testing.assert_array_equal(fewer_y, y[fewer_x.astype(int)])
    assert np.nanmax(fewer_y) == np.nanmax(y) and np.nanmin(fewer_y) == np.nanmin(y)
    assert np.any(np.isnan(fewer_y[(fewer_x >= 2000) & (fewer_x < 3000)]))
    same_x, same_y = envelope(x, y, 5000)
    assert same_x is x and same_y is y
    with pytest.raises(ValueError, match="at least 2 points, got 1"):
        envelope(x, y, 1)


def test_intervals_cover_what_is_masked_and_no_other(rng: np.random.Generator) -> None:
    x, mask = np.arange(500.0), rng.random(500) < 0.3
    covered = np.zeros(500, bool)
    for start, end in intervals(x, mask):
        covered |= (x >= start) & (x <= end)
    np.testing.assert_array_equal(covered, mask)
    few = intervals(x, mask, most=7)
    assert len(few) == 7
    assert np.all(np.any([(x >= a) & (x <= b) for a, b in few], axis=0)[mask])
    assert intervals(x, np.zeros(500, bool)) == []


def test_an_ellipsoid_is_drawn_where_it_is() -> None:
    """Its surface satisfies the ellipsoid's equation."""
    angle = 0.4
    turn = np.array(
        [[np.cos(angle), -np.sin(angle), 0], [np.sin(angle), np.cos(angle), 0], [0, 0, 1]]
    )
    body = Ellipsoid("link", np.array([0.1, -0.2, 0.3]), turn * [0.3, 0.1, 0.05])
    inverse = np.linalg.inv(body.axes)
    points = body.surface().reshape(3, -1) - body.centre[:, None]
    np.testing.assert_allclose(np.linalg.norm(inverse @ points, axis=0), 1.0, rtol=1e-12)
