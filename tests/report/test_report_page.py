"""The page of a report shows the report's numbers, under any name; and two reports compared."""

import dataclasses
import html
import importlib.util
import json
from collections.abc import Iterable
from html.parser import HTMLParser
from pathlib import Path

import numpy as np
import pytest

import jaxcslc as jc
from jaxcslc.manipulator import LinkParameters, link_poses
from jaxcslc.report import AbstractBlock, Table, Value, compare_reports, fit_quality
from jaxcslc.report.sections._bodies import solid_ellipsoid


NAME, FIRST, SECOND = "<b>& arm", "<i>shoulder</i>", "elbow & $1"
ROBOT = f"""
name = "{NAME}"
gravity = [0, -9.81, 0]
[[joint]]
name = "{FIRST}"
[[joint]]
name = "{SECOND}"
a = 0.5
"""
TRUE = np.array([0.9, 0.5, 2.0, 0.1, 0.4, 0.2, 0.1])


class Tables(HTMLParser):
    """The rows of every table: what sorting reads, or else the text."""

    def __init__(self, text: str):
        super().__init__()
        self.tables: list[list[list[str]]] = []
        self.tags: set[str] = set()
        self.feed(text)

    def handle_starttag(self, tag: str, attrs: list[tuple[str, str | None]]) -> None:
        self.tags.add(tag)
        if tag == "table":
            self.tables.append([])
        elif tag == "tr":
            self.tables[-1].append([])
        elif tag == "td":
            self.tables[-1][-1].append(dict(attrs)["data-order"] or "")

    def rows_of(self, first: str) -> list[list[str]]:
        """All rows that begin with an entry."""
        return [row for table in self.tables for row in table if row and row[0] == first]


@pytest.fixture(scope="module")
def reports(tmp_path_factory: pytest.TempPathFactory) -> tuple[jc.Report, jc.Report]:
    """Of an arm, and of one with another inertia of its second link."""
    path = tmp_path_factory.mktemp("robot") / "arm.toml"
    path.write_text(ROBOT, encoding="utf-8")
    network = jc.derive(jc.load_robot(path), lengths="numeric")
    rng = np.random.default_rng(5)
    t = np.arange(600) * 0.01
    k = np.resize(TRUE, network.size)

    def recorded(k: np.ndarray, phase: float) -> jc.Recording:
        w = np.array([1.3, 2.1])
        angle = t[:, None] * w + phase
        motion = np.sin(angle), w * np.cos(angle), -(w**2) * np.sin(angle)
        torque = np.asarray(network.torque(k, *motion))
        return jc.Recording(t, motion[0], torque + 0.02 * rng.normal(size=torque.shape))

    changed = k.copy()
    changed[network.names.index("kv2")] += 0.5
    first, second = (
        jc.identify(
            network,
            recorded(vector, 0.0),
            recorded(vector, 0.7),
            jc.Settings(),
            systematic=False,
        )
        for vector in (k, changed)
    )
    return first, second


@pytest.fixture(scope="module")
def saved(reports: tuple[jc.Report, jc.Report], tmp_path_factory: pytest.TempPathFactory) -> Path:
    """A folder with both reports, as a and b."""
    folder = tmp_path_factory.mktemp("saved")
    for name, report in zip("ab", reports, strict=True):
        gap = jc.DataCheck((), (jc.Finding("gap", "", "A gap of 3 s", "lost rows", "again"),))
        checked = dataclasses.replace(report, data_check=gap)
        checked.save(folder / name, command="jaxcslc identify <x>")
    return folder


def test_page_has_the_numbers_of_the_report(
    reports: tuple[jc.Report, jc.Report], saved: Path
) -> None:
    report = reports[0]
    text = (saved / "a" / "index.html").read_text("utf-8")
    page = Tables(text)
    document = json.loads((saved / "a" / "identification.json").read_text("utf-8"))
    for row in report.rows():
        (shown,) = (cells for cells in page.rows_of(str(row["name"])) if len(cells) == 8)
        assert [float(entry) for entry in shown[1:4]] == [row["value"], row["low"], row["high"]]
        assert shown[4:6] == [row["unit"], row["verdict"]]
    for joint, name in enumerate((FIRST, SECOND)):
        rows = page.rows_of(name)
        for recording in ("training", "validation"):
            rms = document["torque_error_rms"][recording][joint]
            everything = document["torque_error_rms_all_samples"][recording][joint]
            quality = document["quality"][recording]
            assert quality["judged"]["rms"][joint] == pytest.approx(rms, rel=1e-9)
            assert quality["all"]["rms"][joint] == pytest.approx(everything, rel=1e-9)
            values = [quality[samples][key][joint] for samples in ("judged", "all")
                      for key in ("rms", "percent", "r_squared")]  # fmt: skip
            values.insert(1, quality["noise"][joint])
            assert [[float(entry) for entry in row[2:]] for row in rows
                    if len(row) == 9].count(values) == 1  # fmt: skip
    assert "A gap of 3 s." in text and "jaxcslc identify &lt;x&gt;" in text
    assert "&lt;b&gt;&amp; arm" in text and "b" not in page.tags and "i" not in page.tags
    assert len(text) < 8_000_000


def test_verdict_stands_first_and_is_that_of_the_numbers(
    reports: tuple[jc.Report, jc.Report], saved: Path
) -> None:
    text = (saved / "a" / "index.html").read_text("utf-8")
    start = text.index("<h1>")
    assert text.index('id="verdict"') < text.index("<table>")
    assert "of 11 coefficients well determined" in text[start:]
    headline, *messages = reports[0].verdict.splitlines()  # what the command prints
    assert headline.startswith("The identified model can be used")
    assert len(messages) >= 3 and all(line[4:] in html.unescape(text) for line in messages[:3])
    wrong = dataclasses.replace(
        reports[0], fit=dataclasses.replace(reports[0].fit, k=-reports[0].k)
    )
    page = wrong.page(charts=False)
    assert page.tone == "bad" and page.headline.startswith("Do not rely")
    assert any("check units, signs" in message.text for message in page.summary)


def test_quality_by_definition(rng: np.random.Generator) -> None:
    torque, predicted = rng.normal(size=(2, 50, 2))
    mask = rng.random((50, 2)) < 0.5
    mask[:, 1] = False
    patterns = jc.Patterns(np.arange(50.0), torque, torque, torque, torque, mask, mask)
    quality = fit_quality(patterns, predicted)
    error = (torque - predicted)[mask[:, 0], 0]
    values = torque[mask[:, 0], 0]
    judged = quality["judged"]
    assert judged["percent"][0] == pytest.approx(
        100 * np.linalg.norm(error) / np.linalg.norm(values)
    )
    assert judged["r_squared"][0] == pytest.approx(1 - np.mean(error**2) / np.var(values))
    assert np.isnan(judged["rms"][1]) and np.isfinite(quality["all"]["rms"][1])


def test_friction_is_what_other_terms_leave(reports: tuple[jc.Report, jc.Report]) -> None:
    """Without noise in the model, its points lie on viscous and dry friction's line."""
    report = reports[0]
    section = report.section("friction_points")
    assert section is not None
    points = section.data["friction_points"][1]["model"]
    viscous, dry = (float(report.k[report.network.names.index(name)]) for name in ("kv2", "kd2"))
    velocity = np.array(points["x"])
    np.testing.assert_allclose(
        points["y"], viscous * velocity + dry * np.sign(velocity), rtol=1e-3, atol=1e-4
    )


def column(blocks: Iterable[AbstractBlock], name: str, title: str) -> list[Value]:
    """A column of the table of a name."""
    (table,) = (x for x in blocks if isinstance(x, Table) and x.name == name)
    return [row[[x.title for x in table.columns].index(title)] for row in table.rows]


def test_values_of_the_file_stand_beside_the_identified_ones() -> None:
    """A pendulum of inertia m (l/2)² + I about its joint, and friction that its file states."""
    rod = LinkParameters(2.0, np.array([0.25, 0.0, 1e-30]), np.diag([1e-3, 0.02, 0.02]), 0.1)
    arm = jc.examples.pendulum().with_friction("viscous", "dry")
    arm = dataclasses.replace(arm, links=(rod,), viscous=(0.3,), dry=(0.5,))
    network = jc.derive(arm, lengths="numeric")
    k = network.coefficients_from(arm.links or (), viscous=arm.viscous, dry=arm.dry)
    recording = jc.examples.swing_recording(network, np.asarray(k).tolist(), samples=1000)
    report = jc.identify(network, recording, settings=jc.Settings(), possible="always")
    blocks = [block for section in report.page(charts=False).sections for block in section.blocks]
    names = column(blocks, "coefficients-table", "name")
    file = dict(zip(names, column(blocks, "coefficients-table", "file"), strict=True))
    assert file["kB1"] == pytest.approx(2.0 * 0.25**2 + 0.02 + 0.1)
    assert file["kB3"] == 0.0
    assert (file["kv1"], file["kd1"]) == (0.3, 0.5)
    assert column(blocks, "bodies", "mass, file [kg]") == [2.0]
    assert column(blocks, "bodies", "rz, file [m]") == [0.0]  # 1e-30 m is rounding
    assert column(blocks, "inertias", "Izz, file [kg m²]") == [0.02]
    assert column(blocks, "inertias", "motor inertia, file [kg m²]") == [0.1]


def test_a_missing_extra_changes_the_page_and_not_the_run(
    reports: tuple[jc.Report, jc.Report], tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    def nothing(name: str) -> None:
        del name

    monkeypatch.setattr(importlib.util, "find_spec", nothing)
    files = {path.name for path in reports[0].save(tmp_path)}
    assert "index.html" in files and not any(name.endswith(".png") for name in files)
    assert "pip install" in (tmp_path / "index.html").read_text("utf-8")


def test_bodies_are_drawn_where_they_are(reports: tuple[jc.Report, jc.Report]) -> None:
    """The ellipsoid's inertia is the body's, and frames are those of a planar arm."""
    axes = np.linalg.qr(np.random.default_rng(2).normal(size=(3, 3)))[0]
    half = np.array([0.3, 0.2, 0.1])
    tensor = axes @ np.diag((half @ half - half**2) * 2.0 / 5.0) @ axes.T
    centre, columns = solid_ellipsoid(LinkParameters(2.0, np.array([1.0, 2.0, 3.0]), tensor))
    np.testing.assert_allclose(columns @ columns.T, axes @ np.diag(half**2) @ axes.T, atol=1e-12)
    np.testing.assert_array_equal(centre, [1.0, 2.0, 3.0])
    report = reports[0]
    poses = link_poses(report.network.robot, np.array([0.3, 0.4]))
    np.testing.assert_allclose(poses[1][:3, 3], [0.5 * np.cos(0.3), 0.5 * np.sin(0.3), 0.0])
    bodies = jc.physical_parameters(report.network, report.fit)
    section = dataclasses.replace(report, bodies=bodies).section("possible")
    assert section is not None
    data = section.data["bodies"]
    assert [link["mass"] for link in data["links"]] == [float(link.mass) for link in bodies.links]
    assert len(data["arm"]["bodies"]) == 2


def test_charts_show_measured_and_predicted_torque(reports: tuple[jc.Report, jc.Report]) -> None:
    """Of a recording that needs no thinning, sample by sample, to the digits of a page."""
    report = reports[0]
    figure = report.torque_chart(SECOND)
    curves = {trace.name: np.array(trace.y, float) for trace in figure.data}
    expected = {
        "measured": np.asarray(report.patterns["validation"].torque)[:, 1],
        "predicted": report.predicted("validation")[:, 1],
    }
    for name, values in expected.items():
        np.testing.assert_allclose(curves[name], values, rtol=1e-4, atol=1e-6)
    assert report.torque_chart(2, "validation") == figure
    assert len(report.plot("training").data) == 2 * len(report.torque_chart(1, "training").data)
    for joint in (0, 3, "wrist"):
        with pytest.raises(ValueError, match="joint: expected 1 to 2 or a name"):
            report.torque_chart(joint)
    with pytest.raises(ValueError, match="recording: expected one of training, validation, got"):
        report.plot("tomorrow")


def test_a_report_describes_itself(reports: tuple[jc.Report, jc.Report]) -> None:
    report = reports[0]
    row = report["kv2"]
    assert repr(row) == (
        f"kv2 = {row['value']:.4g} N m s/rad, 95 % interval {row['low']:.4g} to {row['high']:.4g},"
        f" {row['verdict']}"
    )
    assert repr(report).endswith(report.verdict) and "Report of " in repr(report)
    assert "Replay of the validation recording" in repr(report).splitlines()[1]


def test_comparison_is_in_standard_errors_of_both(
    reports: tuple[jc.Report, jc.Report], saved: Path
) -> None:
    first, second = reports
    comparison = compare_reports(saved / "a", saved / "b" / "identification.json")
    difference = np.asarray(second.k - first.k)
    scale = np.hypot(first.fit.standard_error, second.fit.standard_error)
    np.testing.assert_allclose([row["difference"] for row in comparison.rows], difference)
    np.testing.assert_allclose(
        [row["standard_errors"] for row in comparison.rows], difference / scale
    )
    assert "kv2" in str(comparison).splitlines()[2] and "differ by more" in str(comparison)
    assert " more, errors and settings" not in str(comparison)  # all are printed
    many = dataclasses.replace(comparison, rows=comparison.rows * 3)
    left_out = len(many.rows) - 15
    assert str(many).splitlines()[-1].startswith(f"{left_out} more, errors and settings")
    assert compare_reports(saved / "a", saved / "a").page().tone == "good"
    comparison.save(saved / "comparison.html")
    page = Tables((saved / "comparison.html").read_text("utf-8"))
    (row,) = page.rows_of("kv2")
    assert float(row[3]) == pytest.approx(difference[first.network.names.index("kv2")])
    assert len(page.rows_of(FIRST)) == 4  # two recordings, judged and all samples


def test_what_cannot_be_compared_is_said(saved: Path, tmp_path: Path) -> None:
    document = json.loads((saved / "b" / "identification.json").read_text("utf-8"))
    document["expressions"][0] += " + m9"
    document["robot"] = "other"
    other = tmp_path / "other.json"
    other.write_text(json.dumps(document))
    comparison = compare_reports(saved / "a", other)
    assert comparison.rows[0]["difference"] is None and "stands for" in comparison.rows[0]["note"]
    assert "different robots" in str(comparison)
    for tables in document["quality"].values():
        tables["judged"]["rms"] = None  # as in a file that was edited
    other.write_text(json.dumps(document))
    errors = compare_reports(saved / "a", other).page().sections[1]
    assert "no errors of the same joints" in str(errors.blocks[0])
    document["names"] = [f"{name}x" for name in document["names"]]
    other.write_text(json.dumps(document))
    with pytest.raises(ValueError, match="no coefficient in common"):
        compare_reports(saved / "a", other)
    document["systematic_error"] = {"smoothing": [1.0]}
    other.write_text(json.dumps(document))
    with pytest.raises(ValueError, match="systematic_error, smoothing: expected"):
        compare_reports(other, saved / "a")
    with pytest.raises(ValueError, match="no such identification"):
        compare_reports(saved / "none", saved / "a")
