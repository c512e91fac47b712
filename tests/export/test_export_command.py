"""`jaxcslc export`: what it takes for an identification of a robot, and where it writes."""

import json
import math
import re
from collections.abc import Callable
from pathlib import Path
from typing import Any

import numpy as np
import pytest

import jaxcslc as jc
from jaxcslc.export import export_robot
from jaxcslc.report import load_report
from scripts.tools.invoke import Result, invoke


ARM = """gravity = [0, -9.81, 0]
[[joint]]
[[joint]]
a = 0.4
"""
URDF = """<robot name="arm">
  <link name="floor"/>
  <link name="upper"><inertial><origin xyz="0.1 0 0"/><mass value="2"/>
    <inertia ixx="0.1" iyy="0.2" izz="0.2" ixy="0" ixz="0" iyz="0"/></inertial></link>
  <link name="fore"><inertial><origin xyz="0.1 0 0"/><mass value="1"/>
    <inertia ixx="0.1" iyy="0.2" izz="0.2" ixy="0" ixz="0" iyz="0"/></inertial></link>
  <joint name="shoulder" type="continuous"><parent link="floor"/><child link="upper"/>
    <axis xyz="0 1 0"/></joint>
  <joint name="elbow" type="continuous"><parent link="upper"/><child link="fore"/>
    <origin xyz="0.3 0 0"/><axis xyz="0 1 0"/></joint>
</robot>
"""


def run(*arguments: str | Path) -> Result:
    return invoke("export", *arguments)


def identification(network: jc.CSLC, path: Path, **changes: Any) -> Path:
    """What `identify` writes of a fit to random states, as far as `export` reads it."""
    rng = np.random.default_rng(1)
    q, qd, qdd = rng.uniform(-2, 2, (3, 60, network.joint_count))
    robot = network.robot
    links = [jc.LinkParameters(1.0, np.array([0.1, 0.0, 0.0]), 0.1 * np.eye(3), 0.01)] * 2
    k = np.asarray(network.coefficients_from(robot.links or links))
    k = k + 0.3 * (k == 0)
    torque = np.asarray(network.torque(k, q, qd, qdd)) + 0.01 * rng.normal(size=q.shape)
    every = np.ones(q.shape, bool)
    fit = jc.LeastSquares(joint_weights="equal", errors="independent").fit(
        network, jc.Patterns(np.arange(60.0), q, qd, qdd, torque, every, every)
    )
    fit.save(path)
    document = json.loads(path.read_text()) | {
        "robot": robot.name,
        "lengths": "numeric",
        "friction": list(robot.friction),
        "coupled": [list(pair) for pair in robot.coupled],
        "expressions": [coefficient.expression for coefficient in network.coefficients],
    }
    document |= changes
    path.write_text(json.dumps({k: v for k, v in document.items() if v is not None}))
    return path


@pytest.fixture
def arm(tmp_path: Path) -> Path:
    (tmp_path / "arm.toml").write_text(ARM)
    return tmp_path / "arm.toml"


def check_error(result: Result, *texts: str) -> None:
    assert result.exit_code == 2, result.output
    (line,) = result.stderr.strip().splitlines()
    for text in texts:
        assert text in line
    assert "RuntimeWarning" not in line


def derived(path: Path) -> jc.CSLC:
    return jc.derive(jc.load_robot(path), lengths="numeric")


def test_another_geometry_is_check_error(arm: Path, tmp_path: Path) -> None:
    """Names and their number agree; a length does not."""
    path = identification(derived(arm), tmp_path / "fit.json")
    other = tmp_path / "other.toml"
    other.write_text(ARM.replace("0.4", "0.5"))
    result = run(other, path, "-o", tmp_path / "out.toml")
    check_error(result, "expected an identification of this robot")
    pairs = zip(derived(arm).coefficients, derived(other).coefficients, strict=True)
    first = next((a, b) for a, b in pairs if a.expression != b.expression)
    check_error(result, first[0].name, first[0].expression, first[1].expression)
    assert not (tmp_path / "out.toml").exists()


def test_a_result_not_to_rely_on_is_refused(arm: Path, tmp_path: Path) -> None:
    """Torques of the wrong sign fit as well, and would write a robot of negative mass."""
    network = derived(arm)
    positive = [coefficient.name for coefficient in network.coefficients if coefficient.positive]
    path = identification(network, tmp_path / "fit.json", model={"positive": positive})
    document = json.loads(path.read_text())
    path.write_text(json.dumps(document | {"k": [-value for value in document["k"]]}))
    check_error(run(arm, path, "-o", tmp_path / "out.toml"), "not to rely on it", "--force")
    check_error(run(arm, path, "--c", "-o", tmp_path / "out.c"), "not to rely on it", "--force")
    assert {file.name for file in tmp_path.iterdir()} == {"arm.toml", "fit.json"}
    assert run(arm, path, "--c", "-o", tmp_path / "out.c", "--force").exit_code == 0


def test_an_older_file_goes_by_name(arm: Path, tmp_path: Path) -> None:
    older: dict[str, Any] = {"expressions": None, "coupled": None, "friction": None}
    path = identification(derived(arm), tmp_path / "fit.json", **older)
    result = run(arm, path, "-o", tmp_path / "out.toml")
    assert result.exit_code == 0, result.output
    path = identification(derived(arm), tmp_path / "fit.json", **older, robot="leg")
    check_error(run(arm, path, "-o", tmp_path / "out.toml"), "'leg'", "'arm'", "of this robot")


def test_other_couplings_are_check_error(tmp_path: Path) -> None:
    arm = tmp_path / "arm.toml"
    arm.write_text(f"coupled = [[1, 2]]\n{ARM}")
    path = identification(derived(arm), tmp_path / "fit.json", coupled=[[1, 2, -1.0]])
    check_error(run(arm, path, "-o", tmp_path / "out.toml"), "[[1, 2, -1.0]]", "[[1, 2, 1.0]]")


def test_friction_that_the_file_has_no_words_for(tmp_path: Path) -> None:
    """An identification with options of friction is of this robot still."""
    arm = tmp_path / "arm.urdf"
    arm.write_text(URDF)
    robot = jc.load_robot(arm).with_friction("viscous", "dry", "offset").with_coupling((1, 2))
    network = jc.derive(robot, lengths="numeric")
    path = identification(network, tmp_path / "fit.json")
    result = run(arm, path, "-o", tmp_path / "new" / "out.urdf")
    assert result.exit_code == 0, result.output
    assert "the file has no entry for ko1, ko2, kcm1_2, kcv1_2, kcd1_2: omitted" in result.output
    result = run(arm, path, "--c", "-o", tmp_path / "code" / "out.c")
    assert result.exit_code == 0, result.output
    assert "void arm_torque" in (tmp_path / "code" / "out.h").read_text()
    path = identification(network, tmp_path / "fit.json", friction=["sticky"])
    check_error(run(arm, path), "fit.json", "unknown friction term 'sticky'")


def test_the_robots_own_file(arm: Path, tmp_path: Path) -> None:
    path = identification(derived(arm), tmp_path / "fit.json")
    for overwrite in ((), ("--overwrite",)):
        own = tmp_path / "." / "arm.toml"
        check_error(run(arm, path, "-o", own, *overwrite), "arm.toml: is read")
        assert arm.read_text() == ARM
    other = tmp_path / "other.toml"
    result = run(arm, path, "-o", other)
    assert result.exit_code == 0, result.output
    assert "mass = " in other.read_text()
    assert run(arm, path, "-o", other).exit_code == 0
    other.write_text(other.read_text() + "# mine\n")
    check_error(run(arm, path, "-o", other), "other.toml: was changed since jaxcslc wrote it")
    assert run(arm, path, "-o", other, "--overwrite").exit_code == 0
    columns = re.split(r"(?<=\]) +", result.output.splitlines()[2].strip())
    assert columns == [
        *("mass [kg]", "rx [m]", "ry [m]", "rz [m]"),
        *(f"I{axes} [kg m²]" for axes in ("xx", "yy", "zz", "xy", "xz", "yz")),
        "motor_inertia [kg m²]",
    ]


def _first(document: dict[str, Any], name: str, value: Any) -> None:
    document[name][0] = value


@pytest.mark.parametrize(
    ("change", "message"),
    [
        (lambda document: _first(document, "k", 1e300), "expected finite coefficients"),
        (lambda document: _first(document, "k", -1e13), "expected finite coefficients"),
        (lambda document: _first(document, "k", None), "expected finite coefficients"),
        (lambda document: _first(document, "k", 10**400), "too large"),
        (
            lambda document: _first(document, "covariance", [1e300] * len(document["k"])),
            "covariance",
        ),
        (lambda document: document.update(expressions=["m1"]), "expressions"),
        (lambda document: document.update(degrees_of_freedom=-0.1), "expected 0 or more"),
        (lambda document: document.update(units=[math.nan]), "units: expected texts, got nan"),
        (lambda document: document.update(friction="dry"), "friction: expected a list"),
        (lambda document: document.update(coupled=[3]), "fit.json"),
        (lambda document: document.update(lengths=[["a1"]]), "lengths: expected a text or a list"),
    ],
)
@pytest.mark.parametrize("extra", [(), ("--c",)])
def test_numbers_of_no_robot(
    change: Callable[[dict[str, Any]], None],
    message: str,
    extra: tuple[str, ...],
    arm: Path,
    tmp_path: Path,
) -> None:
    path = identification(derived(arm), tmp_path / "fit.json")
    document = json.loads(path.read_text())
    change(document)
    path.write_text(json.dumps(document))
    check_error(run(arm, path, *extra), "fit.json", message)


def test_a_folder_that_is_a_file(arm: Path, tmp_path: Path) -> None:
    path = identification(derived(arm), tmp_path / "fit.json")
    for name, extra in (("out.toml", ()), ("out.c", ("--c",))):
        check_error(run(arm, path, "-o", path / name, *extra), "fit.json")


@pytest.fixture(scope="module")
def weak(tmp_path_factory: pytest.TempPathFactory) -> tuple[jc.Report, Path]:
    """An arm of whose joints one moves a little: the file decides most of its bodies.

    The arm is 20 % heavier than its file says, and its elbow's torque has an offset.
    """
    folder = tmp_path_factory.mktemp("weak")
    slender = URDF.replace('"0.1" iyy="0.2" izz="0.2"', '"0.005" iyy="0.01" izz="0.01"')
    (folder / "arm.urdf").write_text(slender)
    robot = jc.load_robot(folder / "arm.urdf")
    assert robot.links is not None
    heavier = [
        jc.LinkParameters(1.2 * link.mass, link.centre_of_gravity, 1.2 * link.inertia, 0.1)
        for link in robot.links
    ]
    network = jc.derive(robot.with_friction("viscous", "dry", "offset"), lengths="numeric")
    zeros = np.zeros(2)
    k = network.coefficients_from(
        heavier, viscous=zeros + 0.2, dry=zeros + 0.3, offset=np.array([0.0, 0.2])
    )
    rng = np.random.default_rng(4)
    time = np.arange(1000) / 200
    q = np.stack([0.3 * np.sin(3 * time), 0.2 * np.sin(2 * time + 1)], axis=1)
    qd = np.stack([0.9 * np.cos(3 * time), 0.4 * np.cos(2 * time + 1)], axis=1)
    qdd = np.stack([-2.7 * np.sin(3 * time), -0.8 * np.sin(2 * time + 1)], axis=1)
    torque = np.asarray(network.torque(k, q, qd, qdd)) + 0.02 * rng.normal(size=q.shape)
    recording = jc.Recording(time, q, torque)
    report = jc.identify(network, recording, checks=False, progress=False)
    report.save(folder / "result")
    return report, folder


def _masses(path: Path) -> list[float]:
    links = jc.load_robot(path).links
    assert links is not None
    return [float(link.mass) for link in links]


class TestBodies:
    """Exported bodies are those of the report."""

    def test_they_are_those_of_the_page(self, weak: tuple[jc.Report, Path]) -> None:
        report, folder = weak
        out = folder / "out.urdf"
        result = run(folder / "arm.urdf", folder / "result", "-o", out, "--force")
        assert result.exit_code == 0, result.output
        page = [float(link.mass) for link in report.bodies.links]
        np.testing.assert_allclose(_masses(out), page, rtol=1e-10)

    def test_a_loaded_report_has_the_same(self, weak: tuple[jc.Report, Path]) -> None:
        report, folder = weak
        network, paths = report.network, [folder / f"{name}.urdf" for name in ("memory", "loaded")]
        for some, path in zip((report, load_report(folder / "result")), paths, strict=True):
            export_robot(network, some.fit, path, bodies=some.bodies, file_weight=some.file_prior)
        assert paths[0].read_text() == paths[1].read_text()

    def test_where_they_are_determined_they_are_the_identified_ones(
        self, weak: tuple[jc.Report, Path]
    ) -> None:
        report, _ = weak
        identified = np.asarray(report.possible.free.k)
        change = np.abs(report.bodies.k - identified) / report.standard_errors
        decided = report.file_prior.share < 0.5
        assert 0 < np.sum(decided) < len(decided)
        assert np.max(change[decided]) < 0.1

    def test_the_file_counts_once(self, weak: tuple[jc.Report, Path]) -> None:
        """Bodies that are computed from the coefficients, which contain the file, are the same."""
        report, folder = weak
        path, weight = folder / "anew.urdf", report.file_prior
        export = export_robot(report.network, report.fit, path, file_weight=weight)
        masses = [float(link.mass) for link in export.parameters.links]
        page = [float(link.mass) for link in report.bodies.links]
        np.testing.assert_allclose(masses, page, rtol=1e-2)

    def test_links_absorb_motor_inertias(self, weak: tuple[jc.Report, Path]) -> None:
        report, folder = weak
        path = folder / "absorbed.urdf"
        export = export_robot(report.network, report.fit, path, bodies=report.bodies, motors=False)
        assert all(float(link.motor_inertia) > 0.0 for link in report.bodies.links)
        assert not any(float(link.motor_inertia) for link in export.parameters.links)

    def test_masses_are_no_further_from_the_truth_than_those_of_the_file(
        self, weak: tuple[jc.Report, Path]
    ) -> None:
        report, folder = weak
        file = np.array(_masses(folder / "arm.urdf"))
        found = np.array([float(link.mass) for link in report.bodies.links])
        assert np.all(np.abs(found - 1.2 * file) <= np.abs(0.2 * file) * 1.001)
