"""Sections of a report, written to a file and read back, show what they showed."""

import dataclasses
import json
from collections.abc import Callable
from pathlib import Path

import numpy as np
import pytest

import jaxcslc as jc
from jaxcslc._plain_data import record_document
from jaxcslc.bodies import Known, Prior
from jaxcslc.friction import fit_pre_sliding
from jaxcslc.instruments import prediction_error
from jaxcslc.manipulator import LinkParameters
from jaxcslc.report import SECTIONS, AbstractSection


ARM = """
name = "arm"
gravity = [0, -9.81, 0]
friction = ["viscous", "dry"]
[[joint]]
name = "shoulder"
[[joint]]
name = "elbow"
a = 0.5
"""
SAMPLES = 600
NOISE = 0.02  # [N m]


@pytest.fixture(scope="module")
def arm(tmp_path_factory: pytest.TempPathFactory) -> jc.Manipulator:
    path = tmp_path_factory.mktemp("robot") / "arm.toml"
    path.write_text(ARM, encoding="utf-8")
    return jc.load_robot(path)


def swing(network: jc.CSLC, seed: int) -> jc.Recording:
    """Motion of every joint of a network whose coefficients are 1, 0.9 and so on."""
    rng = np.random.default_rng(seed)
    t = 0.01 * np.arange(SAMPLES)
    w = np.array([1.3, 2.1])[: network.joint_count]
    angle = t[:, None] * w + rng.uniform(0.0, 2.0, len(w))
    motion = np.sin(angle), w * np.cos(angle), -(w**2) * np.sin(angle)
    k = np.linspace(1.0, 0.2, network.size)
    torque = np.asarray(network.torque(k, *motion))
    return jc.Recording(t, motion[0], torque + NOISE * rng.normal(size=torque.shape))


def everything(arm: jc.Manipulator) -> jc.Report:
    """Both estimators, bodies, a prior, friction that was tried, simulation, findings."""
    network = jc.derive(arm, lengths="numeric")
    training, validation = swing(network, 0), swing(network, 1)
    report = jc.identify(
        network,
        training,
        validation,
        estimator="auto",
        friction="auto",
        possible="always",
        prior=Prior({"kv1": Known(0.5, 0.1)}, {"2": {"mass": Known(low=0.1)}}),
    )
    horizon = prediction_error(network, {"fit": report.k}, validation, report.settings)
    gap = jc.DataCheck((), (jc.Finding("gap", "", "no samples", "lost rows", "record again"),))
    part = "the first minute"
    return dataclasses.replace(report, horizon=horizon, data_check=gap, judged_part=part)


def coupled(arm: jc.Manipulator) -> jc.Report:
    """Joints that share a motor."""
    network = jc.derive(arm.with_coupling((1, 2, -1.0)), lengths="numeric")
    return jc.identify(network, swing(network, 0), settings=jc.Settings(), possible="never")


def several(arm: jc.Manipulator) -> jc.Report:
    network = jc.derive(arm, lengths="numeric")
    recordings = {name: swing(network, seed) for seed, name in enumerate(("morning", "evening"))}
    return jc.identify(network, recordings, settings=jc.Settings(), offsets=True, possible="never")


def refitted(arm: jc.Manipulator) -> jc.Report:
    network = jc.derive(arm, lengths="numeric")
    report = jc.identify(network, swing(network, 0), settings=jc.Settings(), possible="never")
    return jc.identify(
        network, swing(network, 1), settings=jc.Settings(), previous=report.fit, groups=["dry"]
    )


def static(arm: jc.Manipulator) -> jc.Report:
    robot = arm.with_friction("viscous", "dry", "static")
    network = jc.derive(robot, lengths="numeric").with_static_slopes([5.0, 5.0])
    return jc.identify(network, swing(network, 0), settings=jc.Settings(), possible="never")


def yielding(arm: jc.Manipulator) -> jc.Report:
    network = jc.derive(arm, lengths="numeric")
    report = jc.identify(network, swing(network, 0), settings=jc.Settings(), possible="never")
    fit = fit_pre_sliding(network, report.patterns["training"])
    return dataclasses.replace(report, pre_sliding=fit)


def undetermined(arm: jc.Manipulator) -> jc.Report:
    """An elbow that stands still: infinite standard errors, intervals and condition."""
    network = jc.derive(arm, lengths="numeric")
    moving = swing(network, 0)
    position = moving.position.copy()
    position[:, 1] = 0.3
    recording = dataclasses.replace(moving, position=position)
    return jc.identify(network, recording, settings=jc.Settings(), possible="never", checks=False)


def of_file(arm: jc.Manipulator) -> jc.Report:
    """A robot whose file has masses and inertias."""
    rod = LinkParameters(1.0, np.array([0.25, 0.0, 0.0]), 0.02 * np.eye(3))
    network = jc.derive(dataclasses.replace(arm, links=(rod, rod)), lengths="numeric")
    return jc.identify(network, swing(network, 0), settings=jc.Settings(), possible="never")


def shown(section: AbstractSection, report: jc.Report, charts: bool) -> str:
    """A section's parts of the page with everything in them; charts do not compare themselves."""
    return json.dumps([record_document(part) for part in section.blocks(report, charts)])


# Sections that reports have: all of them, and these in addition.
ALWAYS = (
    *("coefficients", "command", "curves", "errors", "friction_points", "model", "quality"),
    *("recorded", "settings", "states", "systematic", "warnings"),
)
CASES: dict[Callable[[jc.Manipulator], jc.Report], tuple[str, ...]] = {
    everything: (
        "estimators",
        "excitation",
        "friction",
        "held_out",
        "horizon",
        "possible",
        "prior",
    ),
    coupled: ("excitation", "held_out"),
    several: ("several",),
    refitted: ("groups",),
    static: ("slopes",),
    yielding: ("pre_sliding",),
    undetermined: ("excitation",),
    of_file: ("file_prior",),
}


@pytest.fixture(scope="module", params=CASES, ids=lambda case: case.__name__)
def report(request: pytest.FixtureRequest, arm: jc.Manipulator) -> jc.Report:
    case: Callable[[jc.Manipulator], jc.Report] = request.param
    made = case(arm)
    have = {type(section).name for section in made.sections if section.data}
    assert {*ALWAYS, *CASES[case]} <= have
    return made


def test_sections_are_read_back(report: jc.Report) -> None:
    for section in report.sections:
        again = type(section).from_document(json.loads(json.dumps(section.data)))
        assert again is not None
        assert again.data == section.data
        assert list(again.text(report)) == list(section.text(report))
        assert list(again.messages(report)) == list(section.messages(report))
        for charts in (True, False):
            assert shown(again, report, charts) == shown(section, report, charts)
        assert again.tables(report) == section.tables(report)


def test_reports_are_read_back(report: jc.Report, tmp_path: Path) -> None:
    files = report.save(tmp_path / "first", command="jaxcslc identify arm.toml log.csv")
    saved = jc.load_report(tmp_path / "first")
    assert str(saved) == str(report) and saved.verdict == report.verdict
    assert saved.names == report.names and saved.settings == report.settings
    np.testing.assert_array_equal(saved.k, report.k)
    np.testing.assert_array_equal(saved.covariance, report.covariance)
    np.testing.assert_array_equal(saved.standard_errors, report.standard_errors)
    np.testing.assert_array_equal(saved.sample(5), report.sample(5))
    np.testing.assert_array_equal(saved.presliding_distance, report.presliding_distance)
    assert saved.network.robot == report.network.robot
    assert saved.network.names == report.network.names and saved.rows() == report.rows()
    assert saved[report.names[0]] == report.rows()[0]
    saved.save(tmp_path / "again")
    written = {path.name for path in (tmp_path / "again").iterdir()} - {".jaxcslc"}
    assert "charts.json" in written
    assert {path.name for path in files} - written == {f"torque_{n}.csv" for n in report.patterns}
    for name in written:
        first, second = ((tmp_path / folder / name).read_text() for folder in ("first", "again"))
        assert first == second, name


def test_results_are_read_back(report: jc.Report, tmp_path: Path) -> None:
    report.save(tmp_path, pictures=False)
    saved = jc.load_report(tmp_path)
    assert tuple(saved.errors) == tuple(report.errors)
    for name, table in report.errors.items():
        np.testing.assert_array_equal(saved.errors[name].rms, table.rms)
        assert str(saved.errors[name]) == str(table)
    for name in ("warnings", "notes", "groups", "prior", "judged_part"):
        assert getattr(saved, name) == getattr(report, name), name
    for name in ("excitation", "held_out", "systematic", "horizon", "pre_sliding"):
        assert (getattr(saved, name) is None) == (getattr(report, name) is None), name
    if report.systematic is not None:
        np.testing.assert_array_equal(saved.systematic.total, report.systematic.total)
    if report.pre_sliding is not None:
        np.testing.assert_array_equal(
            saved.pre_sliding.presliding_distance, report.pre_sliding.presliding_distance
        )
        np.testing.assert_array_equal(saved.pre_sliding.fit.k, report.pre_sliding.fit.k)
    if report.estimators is not None:
        with pytest.raises(AttributeError, match="section\\('estimators'\\)"):
            saved.estimators  # noqa: B018


def test_every_section_is_among_them() -> None:
    cases = (name for names in CASES.values() for name in names)
    assert {*ALWAYS, *cases} == {section.name for section in SECTIONS}


def test_what_no_section_has_is_an_error(arm: jc.Manipulator) -> None:
    report = refitted(arm)
    with pytest.raises(TypeError, match="no section has a result 'energy'"):
        dataclasses.replace(report, energy=1.0)
    with pytest.raises(AttributeError, match="'energy'"):
        report.energy  # noqa: B018
    with pytest.raises(KeyError, match="kx9: expected a coefficient"):
        report["kx9"]
