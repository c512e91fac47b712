"""Files that are broken, contradictory or hostile: one line that names what, and no more."""

from pathlib import Path
from typing import Any

import mujoco
import pytest

import jaxcslc as jc
from jaxcslc.manipulator import parse_xml


INERTIA = '<inertia ixx="{}" iyy="{}" izz="{}" ixy="0" ixz="0" iyz="0"/>'


def link(name: str, mass: str = "1", moments: tuple[float, ...] = (0.1, 0.1, 0.1)) -> str:
    tensor = INERTIA.format(*moments)
    return f'<link name="{name}"><inertial><mass value="{mass}"/>{tensor}</inertial></link>'


def joint(name: str, parent: str, child: str, kind: str = "continuous", more: str = "") -> str:
    ends = f'<parent link="{parent}"/><child link="{child}"/>'
    return f'<joint name="{name}" type="{kind}">{ends}<axis xyz="0 1 0"/>{more}</joint>'


def urdf(*parts: str) -> str:
    return f'<robot name="r">{"".join(parts)}</robot>'


def mjcf(inside: str, more: str = "") -> str:
    return f"<mujoco><worldbody>{inside}</worldbody>{more}</mujoco>"


ARM = (link("a"), link("b"), joint("j", "a", "b"))
BODY = '<body name="{}"><joint name="{}" type="{}"/><geom size="0.1"/>{}</body>'

BILLION_LAUGHS = (
    '<?xml version="1.0"?><!DOCTYPE lolz [<!ENTITY a "ha"><!ENTITY b "&a;&a;&a;">]>'
    '<robot name="&b;"/>'
)
EXTERNAL = '<!DOCTYPE r [<!ENTITY x SYSTEM "file:///etc/passwd">]><robot name="&x;"/>'

REFUSED = {
    "not XML": ("<robot", "not valid XML: .*line 1"),
    "nothing": ("", "not valid XML"),
    "another root": ("<sdf/>", "expected <robot> .URDF. or <mujoco> .MJCF. at the top, got <sdf>"),
    "entities": (BILLION_LAUGHS, "document type declaration"),
    "external entity": (EXTERNAL, "document type declaration"),
    "deep": ("<robot>" + "<a>" * 1_000_000, "line 1: elements nest deeper than 256"),
    "wide": ("<robot>" + "<a/>" * 250_000, "more than 200000 elements"),
    "no joint": (urdf(link("a")), "has no joint that moves"),
    "nan": (
        urdf(link("a"), link("b", "nan"), ARM[2]),
        "line 1: value of mass is 'nan'; expected numbers",
    ),
    "huge origin": (
        urdf(*ARM[:2], joint("j", "a", "b", more='<origin xyz="1e300 0 0.1"/>')),
        r"line 1: xyz of origin is '1e300 0 0.1'; expected numbers up to 1e\+09",
    ),
    "infinite position": (
        mjcf('<body pos="inf 0 0"><joint/><geom size="0.1"/></body>'),
        "line 1: pos of body is 'inf 0 0'; expected numbers up to",
    ),
    "huge axis": (
        mjcf('<body><joint axis="0 0 1e300"/><geom size="0.1"/></body>'),
        "line 1: axis of joint is '0 0 1e300'; expected numbers up to",
    ),
    "word": (urdf(link("a"), link("b", "heavy"), ARM[2]), "heavy|mass|number"),
    "link twice": (urdf(*ARM, link("b")), "line 1: link 'b' is named twice, first on line 1"),
    "joint twice": (urdf(*ARM, link("c"), joint("j", "b", "c")), "joint 'j' is named twice"),
    "no name": (urdf("<link/>"), "a link has no name"),
    "unknown parent": (urdf(*ARM[:2], joint("j", "z", "b")), "joint 'j': its parent 'z' is no"),
    "unknown kind": (urdf(*ARM[:2], joint("j", "a", "b", "screw")), "expected a type out of"),
    "planar": (
        urdf(*ARM, link("c"), joint("k", "b", "c", "planar")),
        "joint 'k': is planar, and is carried by 'b'; only revolute",
    ),
    "only floating": (
        urdf(*ARM[:2], joint("j", "a", "b", "floating")),
        "has no joint that moves",
    ),
    "macros": (
        urdf(*ARM, '<xacro:include filename="hand.xacro"/>'),
        "line 1: <xacro:include> is for xacro; expected a URDF without macros, as `xacro FILE",
    ),
    "macros' values": (
        urdf(*ARM[:2], joint("j", "a", "b", more='<origin xyz="0 0 ${height}"/>')),
        "line 1: <origin> is for xacro",
    ),
    "two origins of a joint": (
        urdf(*ARM[:2], joint("j", "a", "b", more="<origin/><origin/>")),
        "joint 'j': has 2 elements <origin>; expected one",
    ),
    "mimics nobody": (
        urdf(*ARM, link("c"), joint("k", "b", "c", more='<mimic joint="x"/>')),
        "joint 'k' mimics 'x', which is no joint of this file",
    ),
    "mimics itself": (
        urdf(*ARM, link("c"), joint("k", "b", "c", more='<mimic joint="k"/>')),
        "joint 'k' mimics 'k', and so in the end itself",
    ),
    "too many joints": (
        mjcf(
            f'<replicate count="1001" offset="0 0 1">{BODY.format("b", "j", "hinge", "")}'
            "</replicate>"
        ),
        "has 1001 joints that move; expected at most 1000",
    ),
    "too many bodies": (
        mjcf(
            f'<replicate count="99"><replicate count="99">{BODY.format("b", "j", "hinge", "")}'
            "</replicate></replicate>"
        ),
        "line 1: more than 3000 bodies; no robot has so many",
    ),
    "a number as C reads it": (
        mjcf(f'<replicate count="+5000000 ">{BODY.format("b", "j", "hinge", "")}</replicate>'),
        "line 1: more than 200000 elements; no robot has so many",
    ),
    "a grid of bodies": (
        mjcf('<flexcomp name="f" type="grid" count="100 100 100" spacing="1 1 1"/>'),
        "line 1: more than 200000 elements; no robot has so many",
    ),
    "two parents": (
        urdf(*ARM, link("c"), joint("k", "a", "c"), joint("l", "b", "c")),
        "joint 'l': carries link 'c', which joint 'k' carries too: closed loops",
    ),
    "cycle": (urdf(*ARM, joint("back", "b", "a")), "its joints form a cycle"),
    "cycle beside": (
        urdf(*ARM, link("c"), link("d"), joint("k", "c", "d"), joint("l", "d", "c")),
        "joint '[kl]' is part of a cycle",
    ),
    "two trees": (urdf(*ARM, link("c")), "expected one tree, but no joint carries 'a' or 'c'"),
    "mimic": (
        urdf(*ARM, link("c"), joint("k", "b", "c", more='<mimic joint="j" multiplier="2"/>')),
        "joint 'k' mimics 'j'",
    ),
    "ball": (mjcf(BODY.format("b", "shoulder", "ball", "")), "joint 'shoulder' is a ball joint"),
    "free": (mjcf(BODY.format("b", "drone", "free", "")), "no joint that moves .body 'b' floats"),
    "free joint on a link": (
        mjcf(BODY.format("a", "j", "ball", BODY.format("b", "k", "hinge", ""))),
        "joint 'j' is a ball joint; .*fix it",
    ),
    "loop": (
        mjcf(
            BODY.format("a", "j", "hinge", BODY.format("b", "k", "hinge", "")),
            '<equality><connect body1="b" body2="world" anchor="0 0 0"/></equality>',
        ),
        "between 'b' and 'world' closes a loop",
    ),
    "MJCF twice": (mjcf(BODY.format("b", "j", "hinge", "") * 2), "repeated name"),
    "MJCF schema": (mjcf("<bodey/>"), "Schema violation"),
    "armature below zero": (
        mjcf('<body><joint name="j" armature="-1e300"/><geom size="0.1"/></body>'),
        r"joint 'j': armature is -1e\+300; expected 0 to 1e\+09",
    ),
    "damping that is not linear": (
        mjcf('<body><joint name="j" damping="1 2"/><geom size="0.1"/></body>'),
        "joint 'j': damping that is not linear",
    ),
}


def one_line(error: BaseException) -> str:
    message = str(error)
    assert "\n" not in message
    return message


@pytest.mark.parametrize("name", REFUSED)
def test_refused(tmp_path: Path, name: str) -> None:
    text, expected = REFUSED[name]
    path = tmp_path / ("arm.xml" if text.startswith("<mujoco") else "arm.urdf")
    path.write_text(text)
    with pytest.raises(jc.RobotError, match=expected) as caught:
        jc.load_robot(path)
    assert one_line(caught.value).startswith(str(path))


PARTS = [
    ({"base": "z"}, "base 'z' is not among its bodies: world, a, b"),
    ({"tip": "z"}, "tip 'z' is not among its bodies"),
    ({"base": "b", "tip": "a"}, "base 'b' is not between the world and tip 'a'"),
    ({"base": "b"}, "has no joint between base 'b' and tip None that moves"),
]


@pytest.mark.parametrize(("part", "expected"), PARTS)
def test_parts_that_are_not_there(tmp_path: Path, part: dict[str, Any], expected: str) -> None:
    path = tmp_path / "arm.urdf"
    path.write_text(urdf(*ARM))
    with pytest.raises(jc.RobotError, match=expected):
        jc.load_robot(path, **part)


@pytest.mark.parametrize(
    ("name", "expected"),
    [("none.urdf", "no such robot file"), ("arm.step", "ending in .toml, .urdf or .xml")],
)
def test_files_that_are_not_there(tmp_path: Path, name: str, expected: str) -> None:
    with pytest.raises(jc.RobotError, match=expected):
        jc.load_robot(tmp_path / name)


def test_joints_that_mimic_may_be_elsewhere(tmp_path: Path) -> None:
    path = tmp_path / "arm.urdf"
    path.write_text(REFUSED["mimic"][0])
    assert jc.load_robot(path, tip="b").joint_count == 1


NO_BODIES = {
    "negative mass": link("x", "-2"),
    "not finite": link("x", "inf"),
    "negative moment": link("x", moments=(0.1, -0.1, 0.1)),
    "triangle": link("x", moments=(0.1, 0.1, 0.3)),
    "products": link("x").replace('ixy="0"', 'ixy="0.5"'),
}


EXPECTED = {
    "negative mass": "expected a mass of zero or more in kg, got -2",
    "negative moment": "expected moments of inertia of zero or more in kg m², got principal",
    "triangle": "principal moments of inertia 0.1, 0.1, 0.3 kg m²",
}


def notes(robot: jc.Manipulator) -> tuple[str, ...]:
    assert robot.source is not None
    return robot.source.notes


@pytest.mark.parametrize("name", NO_BODIES)
def test_inertias_matter_where_they_move(tmp_path: Path, name: str) -> None:
    """One that no body has leaves a robot without link parameters, in a link or on it, with a note;
    but not in the base or elsewhere."""
    path = tmp_path / "arm.urdf"
    x = NO_BODIES[name]
    hand = (link("c"), joint("k", "b", "c"))
    path.write_text(urdf(*ARM, *hand, x, joint("fixed to c", "c", "x", "fixed")))
    parts: tuple[dict[str, Any], ...] = ({}, {"tip": "c"}, {"tip": "b"})
    for part in parts:  # x is fixed at zero on a moving link
        robot = jc.load_robot(path, **part)
        assert robot.links is None and robot.joint_count == (1 if part == {"tip": "b"} else 2)
        (note,) = notes(robot)
        assert f"{path}, body 'x': " in note and "no link parameters are taken" in note
        if expected := EXPECTED.get(name):
            assert expected in note
    path.write_text(urdf(*ARM, *hand, x, joint("beside", "a", "x")))
    known = [jc.load_robot(path, tip="c")]
    path.write_text(urdf(x, joint("before", "x", "a"), *ARM, *hand))
    known.append(jc.load_robot(path, base="a"))
    path.write_text(urdf(x, joint("on it", "x", "b"), link("b")))  # it is the base
    known.append(jc.load_robot(path))
    assert [robot.joint_count for robot in known] == [2, 2, 1]
    assert all(robot.links is not None and not notes(robot) for robot in known)


def test_damping_elsewhere_may_be_anything(tmp_path: Path) -> None:
    path = tmp_path / "arms.xml"
    strange = '<body name="a"><joint name="s" damping="1 2"/><geom size="0.1"/></body>'
    path.write_text(mjcf(strange + BODY.format("b", "j", "hinge", "")))
    assert jc.load_robot(path, tip="b").joint_count == 1


def test_rounding_of_nearly_nothing_is_none(tmp_path: Path) -> None:
    """As programs for drawing write links of next to no mass."""
    path = tmp_path / "arm.urdf"
    for moments in ((-1.35525e-20, 0.0, 1.35525e-20), (1e-16, 1e-16, 5e-16)):
        path.write_text(urdf(link("a"), link("b", "1e-9", moments), ARM[2]))
        assert jc.load_robot(path).joint_count == 1


LIMITS = '<limit lower="1" upper="1" effort="1" velocity="1"/>'  # equal: MuJoCo warns


def test_mujoco_s_warnings_go_nowhere(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch, capfd: pytest.CaptureFixture[str]
) -> None:
    """Neither to the terminal nor to a log file, and a handler that was set is kept."""
    path = tmp_path / "arm.urdf"
    here = tmp_path / "here"
    here.mkdir()
    monkeypatch.chdir(here)
    heard: list[str] = []
    mujoco.set_mju_user_warning(heard.append)
    try:
        path.write_text(urdf(*ARM[:2], joint("j", "a", "b", "revolute", LIMITS)))
        assert jc.load_robot(path).joint_count == 1
        path.write_text(REFUSED["word"][0])
        with pytest.raises(jc.RobotError):
            jc.load_robot(path)
        assert heard == []
        mujoco.MjSpec.from_string(urdf(*ARM[:2], joint("j", "a", "b", "revolute", LIMITS)))
        assert len(heard) == 1
    finally:
        mujoco.set_mju_user_warning(None)
    path.write_text(urdf(*ARM[:2], joint("j", "a", "b", "revolute", LIMITS)))
    assert jc.load_robot(path).joint_count == 1
    assert list(here.iterdir()) == []
    captured = capfd.readouterr()
    assert (captured.out, captured.err) == ("", "")


@pytest.mark.parametrize("name", ["my robot ü.URDF", "arm.Xml", "arm.mjcf", "arm.xml", "arm.urdf"])
def test_suffixes_do_not_matter(tmp_path: Path, name: str) -> None:
    path = tmp_path / name
    for text in (urdf(*ARM), mjcf(BODY.format("b", "j", "hinge", ""))):
        path.write_text(text)
        robot = jc.load_robot(path)
        assert robot.source is not None and robot.source.joints == ("j",)


@pytest.mark.parametrize("name", ["arm.xml", "arms & 'hands' ü.mjcf"])
def test_included_files_are_beside_their_file(tmp_path: Path, name: str) -> None:
    more = BODY.format("b", "j", "hinge", "")
    (tmp_path / "more.xml").write_text(f"<mujocoinclude>{more}</mujocoinclude>")
    path = tmp_path / name
    path.write_text(mjcf('<include file="more.xml"/>', '<option gravity="0 0 -1.6"/>'))
    robot = jc.load_robot(path)
    assert robot.kinds == "R"
    assert robot.gravity == (0.0, 0.0, -1.6)


INCLUDES = {
    "itself": (mjcf('<include file="arm.xml"/>'), "line 1: .*arm.xml includes itself"),
    "itself as a model": (
        mjcf("", '<asset><model name="a" file="arm.xml"/></asset>'),
        "line 1: .*arm.xml includes itself",
    ),
    "another that includes it": (mjcf('<include file="more.xml"/>'), "arm.xml includes itself"),
    "many copies of another": (
        mjcf('<replicate count="2000"><include file="two.xml"/></replicate>'),
        "two.xml, line 1: more than 3000 bodies",
    ),
}


@pytest.mark.parametrize("name", INCLUDES)
def test_included_files_are_as_little_trusted(tmp_path: Path, name: str) -> None:
    """MuJoCo ends the process at a model that includes itself."""
    text, message = INCLUDES[name]
    body = BODY.format("{0}", "j{0}", "hinge", "")
    two = "".join(body.format(name) for name in "ab")
    (tmp_path / "arm.xml").write_text(text)
    (tmp_path / "more.xml").write_text('<mujocoinclude><include file="arm.xml"/></mujocoinclude>')
    (tmp_path / "two.xml").write_text(f"<mujocoinclude>{two}</mujocoinclude>")
    with pytest.raises(jc.RobotError, match=message):
        jc.load_robot(tmp_path / "arm.xml")


def test_elements_know_where_they_stand() -> None:
    """What is written back into a file is put at these places."""
    text = b'<a x="1>2">\n <b/><!-- <b> --><b y="/>" />\n<c>t</c></a>'
    root = parse_xml(text, "x")
    spans = [text[e.start : e.end] for e in (root, *root.children)]
    assert spans == [text, b"<b/>", b'<b y="/>" />', b"<c>t</c>"]
    assert [e.line for e in root.children] == [2, 2, 3]


@pytest.mark.parametrize("command", ["derive", "identify"])
def test_the_command_ends_with_code_2(
    tmp_path: Path, capsys: pytest.CaptureFixture[str], command: str
) -> None:
    from jaxcslc.cli._app import run

    path = tmp_path / "arm.urdf"
    path.write_text(REFUSED["cycle"][0])
    arguments = [command, str(path)] + (["train.csv"] if command == "identify" else [])
    assert run(arguments, configure=False) == 2
    (line,) = capsys.readouterr().err.strip().splitlines()
    assert line.startswith(f"jaxcslc: {path}")


@pytest.mark.parametrize(
    "entry",
    ["a = -1e300", "d = 1e10", 'a = "a1"\n[lengths]\na1 = 1e200', "viscous = 1e100"],
)
def test_numbers_whose_products_overflow(entry: str, tmp_path: Path) -> None:
    path = tmp_path / "arm.toml"
    path.write_text(f"gravity = [0, 0, -9.81]\n[[joint]]\n[[joint]]\n{entry}\n")
    with pytest.raises(jc.RobotError, match="finite"):
        jc.load_robot(path)
