"""The project file: what `init` decides, and what commands take from it."""

import csv
import json
import tomllib
from pathlib import Path

import numpy as np
import pytest

import jaxcslc as jc
from jaxcslc.cli._app import command_named
from jaxcslc.recordings import guessed_mapping
from tests.conftest import run


# Two joints and a gripper's finger that no log has.
ARM = """<robot name="arm"><link name="floor"/>
{bodies}
<link name="finger"><inertial><origin xyz="0.1 0 0"/><mass value="0.1"/>
<inertia ixx="1e-4" iyy="1e-4" izz="1e-4" ixy="0" ixz="0" iyz="0"/></inertial></link>
<joint name="grip" type="prismatic"><parent link="forearm"/><child link="finger"/>
<origin xyz="0.5 0 0"/><axis xyz="1 0 0"/><limit lower="0" upper="0.05" effort="9" velocity="1"/>
</joint></robot>"""
BODY = """<link name="{name}"><inertial><origin xyz="0.3 0 0"/><mass value="2"/>
<inertia ixx="0.1" iyy="0.1" izz="0.1" ixy="0" ixz="0" iyz="0"/></inertial></link>
<joint name="{joint}" type="revolute"><parent link="{parent}"/><child link="{name}"/>
<origin xyz="{x} 0 0"/><axis xyz="0 1 0"/>
<limit lower="-3" upper="3" velocity="5" effort="60"/></joint>"""


@pytest.fixture
def folder(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> Path:
    """A folder to work in, with the arm and a log of another program: degrees and milliseconds."""
    monkeypatch.chdir(tmp_path)
    bodies = BODY.format(name="upper", joint="shoulder", parent="floor", x=0)
    bodies += BODY.format(name="forearm", joint="elbow", parent="upper", x=0.6)
    Path("arm.urdf").write_text(ARM.format(bodies=bodies))
    network = jc.derive(jc.load_robot("arm.urdf", fix=["grip"]), lengths="numeric")
    t = np.arange(4000) * 0.002
    w = np.array([3.0, 4.1])
    angle = t[:, None] * w
    q, qd, qdd = np.sin(angle), w * np.cos(angle), -(w**2) * np.sin(angle)
    k = network.coefficients_from(network.robot.links or (), viscous=[0.5, 0.3], dry=[0.4, 0.2])
    torque = np.asarray(network.torque(np.asarray(k), q, qd, qdd))
    torque = torque + 0.02 * np.random.default_rng(1).normal(size=q.shape)
    with open("log.csv", "w", newline="") as file:
        writer = csv.writer(file)
        stems = ("set_pos_{}_deg", "act_pos_{}_deg", "act_trq_{}")
        writer.writerow(["stamp_ms", "mode", *(s.format(i) for s in stems for i in (1, 2))])
        degrees = np.rad2deg(q)
        for i in range(len(t)):
            writer.writerow([1e3 * t[i], "run", *degrees[i], *degrees[i], *torque[i]])
    return tmp_path


def test_init_decides_and_commands_need_no_more(folder: Path) -> None:
    result = run("init", "arm.urdf", "log.csv")
    assert result.exit_code == 0, result.output
    for text in (
        "columns:    time is stamp_ms in ms (columns.time)",
        "columns:    position is act_pos_1_deg, act_pos_2_deg in deg (columns.position)",
        "fixed:      grip: not in the log (fix)",
        "joints:     shoulder, elbow",
        "samples:    4000 in 7.998 s, 500 Hz",
        "friction:   viscous, dry; identify adds torque offsets that help",
        "wrote jaxcslc.toml",
    ):
        assert text in result.output
    assert "wrong" not in result.output
    document = tomllib.loads(Path("jaxcslc.toml").read_text("utf-8"))
    assert document == {
        "robot": "arm.urdf",
        "fix": ["grip"],
        "columns": {
            "time": {"columns": "stamp_ms", "unit": "ms"},
            "position": {"columns": ["act_pos_1_deg", "act_pos_2_deg"], "unit": "deg"},
            "torque": {"columns": ["act_trq_1", "act_trq_2"]},
        },
    }
    clean = run("check", "log.csv")
    assert clean.exit_code == 0 and "nothing looks wrong" in clean.output
    assert clean.output.startswith(
        "With jaxcslc.toml, this is: jaxcslc check arm.urdf log.csv --fix grip"
        " --columns 'jaxcslc.toml#columns'\n"
    )
    mapped = jc.load_recording("log.csv", ("shoulder", "elbow"), columns="jaxcslc.toml")
    assert mapped.samples == 4000
    identified = run("identify", "log.csv", "--no-systematic", "-o", "results")
    assert identified.exit_code == 0, identified.output
    page = Path("results/index.html").read_text("utf-8")
    assert "jaxcslc identify arm.urdf log.csv" in page and "jaxcslc.toml#columns" in page
    for words in (("export", "results"), ("excite", "--duration", "-1"), ("payload", "log.csv")):
        assert "missing ROBOT" not in run(*words).output
    refused = run("init", "arm.urdf", "log.csv")
    assert refused.exit_code == 2 and "jaxcslc.toml: exists already" in refused.stderr
    assert run("init", "arm.urdf", "log.csv", "--overwrite", "--quiet").output == ""


def test_init_corrects_what_the_check_finds(folder: Path) -> None:
    """The second joint counts the other way round, and times are in milliseconds."""
    table = list(csv.reader(Path("log.csv").read_text().splitlines()))
    rows = [["time", *(f"{x}_{i}" for x in ("position", "torque") for i in (1, 2))]]
    for row in table[1:]:
        q, torque = np.deg2rad([float(x) for x in row[4:6]]), [float(x) for x in row[6:]]
        rows.append([row[0], str(q[0]), str(-q[1]), str(torque[0]), str(-torque[1])])
    with Path("log.csv").open("w", newline="") as file:
        csv.writer(file).writerows(rows)
    result = run("init", "arm.urdf", "log.csv", "--json")
    assert result.exit_code == 0, result.output
    columns = json.loads(result.stdout)["columns"]
    assert columns["time"] == {"unit": "ms"}
    assert columns["position"]["sign"] == columns["torque"]["sign"] == [1, -1]
    assert run("check", "log.csv").exit_code == 0


def test_init_takes_columns_of_any_names(folder: Path) -> None:
    """Names that say nothing: a file says what they are, and the project file holds it."""
    lines = Path("log.csv").read_text().splitlines()
    Path("odd.csv").write_text("\n".join(["a,b,c,d,e_shoulder,e_elbow,f1,f2", *lines[1:]]))
    refused = run("init", "arm.urdf", "odd.csv")
    assert refused.exit_code == 2 and "its columns are a, b, c, d, e_shoulder" in refused.stderr
    Path("names.toml").write_text(
        '[time]\ncolumns = "a"\nunit = "ms"\n[torque]\ncolumns = "f{number}"\n'
        '[position]\ncolumns = "e_{joint}"\nunit = "deg"\n'
    )
    result = run("init", "arm.urdf", "odd.csv", "--columns", "names.toml")
    assert result.exit_code == 0, result.output
    assert "columns:    as names.toml says (columns)" in result.output
    assert "fixed:      grip: not in the log (fix)" in result.output
    written = tomllib.loads(Path("jaxcslc.toml").read_text())
    assert written["columns"]["position"] == {"columns": "e_{joint}", "unit": "deg"}
    assert run("check", "odd.csv").exit_code == 0


def test_init_takes_files_without_a_header_line(folder: Path) -> None:
    """Values tell columns: milliseconds, degrees, and a commanded position that nobody needs."""
    rows = list(csv.reader(Path("log.csv").read_text().splitlines()))[1:]
    lines = (",".join([row[0], *row[4:]]) for row in rows)
    Path("bare.csv").write_text("\n".join(lines))
    result = run("init", "arm.urdf", "bare.csv", "--fix", "grip")
    assert result.exit_code == 0, result.output
    (assumed,) = (line for line in result.output.splitlines() if "assumed" in line)
    assert "column 2 to column 3 lie within the joints' limits in deg" in assumed
    assert "wrong" not in result.output
    columns = tomllib.loads(Path("jaxcslc.toml").read_text("utf-8"))["columns"]
    assert columns["position"] == {"columns": ["column 2", "column 3"], "unit": "deg"}
    assert columns["torque"] == {"columns": ["column 4", "column 5"]}
    assert run("check", "bare.csv").exit_code == 0


def test_files_that_say_too_little_are_refused(folder: Path) -> None:
    Path("odd.csv").write_text("a,b\n" + "".join(f"{i},{i}\n" for i in range(9)))
    result = run("init", "arm.urdf", "odd.csv")
    assert result.exit_code == 2 and "odd.csv: its columns are a, b. " in result.stderr
    assert "expected 3 columns of each" in result.stderr
    assert 'position.columns = ["q1", "q2"]' in result.stderr and "--columns" in result.stderr
    three = [f"{x}_{i}" for x in ("position", "torque") for i in (1, 2, 3, 4)]
    lines = (",".join([f"{i / 10}", *[str(i)] * 8]) for i in range(9))
    Path("more.csv").write_text("\n".join([",".join(["time", *three]), *lines]))
    result = run("init", "arm.urdf", "more.csv")
    assert result.exit_code == 2 and "has 4 joints, arm.urdf has 3" in result.stderr
    assert not Path("jaxcslc.toml").exists()


def test_columns_are_guessed_by_words() -> None:
    names = ["t", "elbow.q", "base.q", "elbow.amps", "base.amps", "elbow.target_q", "base.target_q"]
    joints = ("base", "elbow")
    mapping = guessed_mapping(names, joints)
    assert mapping is not None
    assert mapping["joints"] == ["base", "elbow"]
    assert mapping["position"] == {"columns": ["base.q", "elbow.q"]}
    amps = ["base.amps", "elbow.amps"]
    assert mapping["torque"] == {"columns": amps, "unit": "A", "constant": 1.0}
    zero = guessed_mapping(["ts", "time_us", "actualQ[0]", "actualQ[1]", "Tau0", "Tau1"], ())
    assert zero is not None
    assert zero["time"] == {"columns": "time_us", "unit": "us"}
    assert zero["position"] == {"columns": ["actualQ[0]", "actualQ[1]"]}
    plain = guessed_mapping(["time", "joint_1", "joint_1_temp", "tau_1"], ())
    assert plain is not None and plain["position"] == {"columns": ["joint_1"]}
    assert guessed_mapping(["time", "pos_1", "pos_2"], ()) is None
    short = guessed_mapping(["t", "base_pos", "elbow_pos", "base_eff", "elbow_eff"], joints)
    assert short is not None
    assert short["torque"] == {"columns": ["base_eff", "elbow_eff"]}
    bare = guessed_mapping(["t", "base", "elbow", "base_torque", "elbow_torque"], joints)
    assert bare is not None and bare["joints"] == list(joints)
    assert bare["position"] == {"columns": ["base", "elbow"]}


class TestProject:
    """`Command.context`: where values come from."""

    def test_options_of_the_command_line_win(self, folder: Path) -> None:
        Path("jaxcslc.toml").write_text(
            'robot = "arm.urdf"\nfriction = ["viscous", "dry"]\ndecimate = 5\nfix = "grip"\n'
            "coupled = [[1, 2]]\nbetween = [0, 8.5]\ndrop_stale = true\n"
        )
        context = command_named("identify").context(["log.csv", "--decimate", "2"])
        assert context.values["decimate"] == 2 and context.values["friction"] == "viscous,dry"
        assert context.values["coupled"] == ["1,2"] and context.values["between"] == "0,8.5"
        assert context.text() == (
            "jaxcslc identify arm.urdf log.csv --fix grip --friction viscous,dry --coupled 1,2"
            " --between 0,8.5 --decimate 2 --drop-stale"
        )
        again = command_named("identify").context(["log.csv", "--no-drop-stale"])
        assert again.values["drop_stale"] is False

    def test_a_command_about_another_robot_does_not_use_it(
        self, folder: Path, capsys: pytest.CaptureFixture[str]
    ) -> None:
        Path("jaxcslc.toml").write_text('robot = "arm.urdf"\nfix = ["grip"]\n')
        context = command_named("derive").context(["panda"])
        assert context.values["fix"] is None and context.values["robot"] == "panda"
        assert "jaxcslc.toml is about arm.urdf; not used for panda" in capsys.readouterr().err
        assert command_named("derive").context(["arm.urdf"]).values["fix"] == ["grip"]
        Path("jaxcslc.toml").unlink()
        missing = run("identify", "log.csv").stderr
        assert "log.csv: expected a robot first" in missing and "in jaxcslc.toml" in missing
        assert run("compare", "a", "b").stderr.startswith("jaxcslc: a: no such")

    @pytest.mark.parametrize(
        ("text", "message"),
        [
            ('robto = "arm.urdf"', "jaxcslc.toml: unknown entry 'robto'; expected robot, "),
            ("decimate = 0", "jaxcslc.toml, decimate: expected a whole number from 1 on, got '0'"),
            ("decimate = 1.5", "jaxcslc.toml, decimate: expected a whole number from 1 on"),
            ('torque = "made"', "jaxcslc.toml, torque: expected measured, commanded, got 'made'"),
            ("despike = 1", "jaxcslc.toml, despike: expected true or false, got 1"),
            ("base = true", "jaxcslc.toml, base: expected a text, a number or a list, got True"),
            ("[settings]\na = 1", "jaxcslc.toml, settings: expected a text"),
            ("robot = [", "jaxcslc.toml: not valid TOML"),
            ('friction = ["sticky"]', "--friction: unknown friction term 'sticky'"),
            ("[columns.torque]\nunit = 'm'", "jaxcslc.toml#columns, [torque], unit: expected"),
        ],
    )
    def test_wrong_entries_are_one_line(self, text: str, message: str, folder: Path) -> None:
        Path("jaxcslc.toml").write_text(text)
        result = run("check", "arm.urdf", "log.csv", "--fix", "grip")
        assert result.exit_code == 2
        (line,) = result.stderr.strip().splitlines()
        assert line.startswith(f"jaxcslc: {message}")
