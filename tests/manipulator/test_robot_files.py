"""Robot files: what they say is what is read, and what is wrong in them is named."""

import dataclasses
import json
import re
from collections.abc import Callable
from importlib.resources import files
from pathlib import Path
from typing import Any

import jax
import numpy as np
import pytest

import jaxcslc
from jaxcslc import Manipulator, RobotError, load_robot
from jaxcslc.derivation import derive_algebra
from jaxcslc.manipulator import LinkInertia, LinkParameters


ARM = """
name = "arm"
about = "a turntable with a slide"
gravity = [0, 0, -9.81]
friction = ["viscous", "offset"]

[lengths]
a1 = 0.25

[links]
inertia = "principal"
motor_inertia = true

[[joint]]
d = 0.4
theta = 0.1
viscous = 1.5
[joint.link]
zero = ["rx", "ry"]
equal = [["Ixx", "Iyy"]]
mass = 2.0
centre_of_gravity = [0, 0, 0.1]
inertia_tensor = [0.2, 0.2, 0.1]
motor_inertia = 0.3

[[joint]]
kind = "P"
alpha = "-pi/2"
a = "a1"
viscous = 2.5
[joint.link]
inertia = "full"
motor = false
mass = 1.0
centre_of_gravity = [0.1, 0, 0]
inertia_tensor = [[0.1, 0.01, 0], [0.01, 0.2, 0], [0, 0, 0.3]]
"""


@pytest.fixture
def load(tmp_path: Path) -> Callable[[str], Manipulator]:
    """Writes a text to arm.toml and loads it."""

    def load(text: str) -> Manipulator:
        path = tmp_path / "arm.toml"
        path.write_text(text, encoding="utf-8")
        return load_robot(path)

    return load


def same_links(one: Manipulator, other: Manipulator) -> bool:
    pairs = zip(one.links or (), other.links or (), strict=True)
    return all(
        np.array_equal(a, b)
        for pair in pairs
        for a, b in zip(*(jax.tree.leaves(link) for link in pair), strict=True)
    )


def written(robot: Manipulator) -> str:
    """A robot as TOML. Strings, numbers and lists of JSON are those of TOML."""
    value = json.dumps
    lines = [f"name = {value(robot.name)}", f"gravity = {value(robot.gravity)}"]
    lines += [f"friction = {value(robot.friction)}", "[lengths]"]
    lines += [
        f"{length.symbol} = {value(length.value)}"
        for length in robot.named_lengths().values()
        if length.symbol and length.value is not None
    ]
    for i, (joint, inertia) in enumerate(zip(robot.joints, robot.inertia, strict=True)):
        lines += ["[[joint]]", f"kind = {value(joint.kind)}"]
        lines += [f"alpha = {value(joint.alpha)}", f"theta = {value(joint.theta)}"]
        lines += [f"a = {value(joint.a.symbol or joint.a.value)}"]
        lines += [f"d = {value(joint.d.symbol or joint.d.value)}"]
        lines += [f"viscous = {value(robot.viscous[i])}"] if robot.viscous else []
        lines += [f"dry = {value(robot.dry[i])}"] if robot.dry else []
        lines += ["[joint.link]", f"inertia = {value(inertia.form)}"]
        lines += [f"motor = {value(inertia.motor)}", f"zero = {value(inertia.zero)}"]
        lines += [f"equal = {value(inertia.equal)}"]
        if robot.links:
            link = robot.links[i]
            lines += [f"mass = {value(float(link.mass))}"]
            lines += [f"centre_of_gravity = {value(np.asarray(link.centre_of_gravity).tolist())}"]
            lines += [f"inertia_tensor = {value(np.asarray(link.inertia).tolist())}"]
            lines += [f"motor_inertia = {value(float(link.motor_inertia))}"]
    if robot.numbering:
        lines += ["[numbering]", f"source = {value(robot.numbering.source)}"]
        for part in ("mass", "velocity", "gravity"):
            sub = getattr(robot.numbering, part)
            lines += [f"[numbering.{part}]", f"inputs = {value(sub.inputs)}"]
            lines += [f"coefficients = {value(sub.coefficients)}"]
    return "\n".join(lines)


def test_every_key(load: Callable[[str], Manipulator]) -> None:
    robot = load(ARM)
    expected = dataclasses.replace(
        Manipulator.from_modified_dh(
            [(0, 0, 0.4, 0.1), ("-pi/2", "a1", 0, 0)],
            kinds="RP",
            inertia=[
                LinkInertia("principal", zero=("rx", "ry"), equal=(("Ixx", "Iyy"),)),
                LinkInertia("full", motor=False),
            ],
            friction=("viscous", "offset"),
            lengths={"a1": 0.25},
            name="arm",
        ),
        viscous=(1.5, 2.5),
        links=(
            LinkParameters(2.0, np.array([0, 0, 0.1]), np.diag([0.2, 0.2, 0.1]), 0.3),
            LinkParameters(
                1.0,
                np.array([0.1, 0, 0]),
                np.array([[0.1, 0.01, 0], [0.01, 0.2, 0], [0, 0, 0.3]]),
                0.0,
            ),
        ),
    )
    assert robot == expected
    assert same_links(robot, expected)
    assert (robot.viscous, robot.dry) == ((1.5, 2.5), None)


def test_what_may_be_left_out(load: Callable[[str], Manipulator]) -> None:
    assert load("[[joint]]\n[[joint]]\nalpha = 'pi/2'\n") == Manipulator.from_modified_dh(
        [(0, 0, 0, 0), ("pi/2", 0, 0, 0)], name="arm"
    )


def test_defaults_for_links_and_exceptions(load: Callable[[str], Manipulator]) -> None:
    text = "[links]\ninertia='principal'\nmotor_inertia=false\n[[joint]]\n[[joint]]\n[joint.link]\n"
    robot = load(text + "inertia='full'\nmotor=true\n")
    assert robot.inertia == (LinkInertia("principal", motor=False), LinkInertia("full", motor=True))


@pytest.mark.parametrize("name", ["puma560", "panda"])
def test_bundled_robots_are_ordinary_files(name: str, load: Callable[[str], Manipulator]) -> None:
    bundled: Manipulator = getattr(jaxcslc, name)()
    source = files("jaxcslc.manipulator") / "robots" / f"{name}.toml"
    assert load(source.read_text(encoding="utf-8")) == bundled


@pytest.mark.parametrize("robot", [jaxcslc.puma560(), jaxcslc.panda()], ids=["puma560", "panda"])
def test_written_and_read(robot: Manipulator, load: Callable[[str], Manipulator]) -> None:
    read = load(written(robot))
    assert read == robot
    assert same_links(read, robot)
    assert (read.viscous, read.dry) == (robot.viscous, robot.dry)


def test_a_path_may_be_a_string(tmp_path: Path) -> None:
    path = tmp_path / "arm.TOML"
    path.write_text("[[joint]]\n", encoding="utf-8")
    assert load_robot(str(path)).name == "arm"


def test_puma560s_values() -> None:
    """The figures of Armstrong, Khatib and Burdick, and of Leahy and Saridis, typed anew."""
    puma = jaxcslc.puma560()
    assert puma.links is not None
    assert puma.length_values() == {
        **{"d2": 0.2435, "a2": 0.4318, "d3": -0.0934, "a3": -0.0203, "d4": 0.4331}
    }
    assert [link.mass for link in puma.links] == [0, 17.4, 4.8, 0.82, 0.34, 0.09]
    assert [link.motor_inertia for link in puma.links] == [1.14, 4.71, 0.83, 0.2, 0.179, 0.193]
    assert puma.viscous == (4.0, 3.5, 3.5, 0.48, 0.55, 0.65)
    assert puma.dry == (5.355, 6.138, 3.519, 0.963, 0.801, 0.846)


def test_pandas_geometry() -> None:
    panda = jaxcslc.panda()
    assert panda.length_values() == {
        **{"d1": 0.333, "d3": 0.316, "a4": 0.0825, "a5": -0.0825, "d5": 0.384, "a7": 0.088}
    }
    assert panda.links is None
    assert panda.friction == ("viscous", "dry", "offset")


def document_examples() -> list[Any]:
    text = (Path(__file__).parents[2] / "docs" / "robots.md").read_text(encoding="utf-8")
    blocks = re.findall(r"^```toml\n(.*?)^```", text, flags=re.DOTALL | re.MULTILINE)
    return [pytest.param(block, id=f"block {i}") for i, block in enumerate(blocks, start=1)]


@pytest.mark.parametrize("block", document_examples())
def test_the_documents_examples_can_be_loaded(
    block: str, load: Callable[[str], Manipulator]
) -> None:
    assert derive_algebra(load(block), "symbolic").coefficients


def test_the_document_names_every_key() -> None:
    from jaxcslc.manipulator import _toml

    text = (Path(__file__).parents[2] / "docs" / "robots.md").read_text(encoding="utf-8")
    keys = _toml._ROBOT_KEYS | _toml._DEFAULT_KEYS | _toml._JOINT_KEYS | _toml._LINK_KEYS
    assert {key for key in keys if f"`{key}`" not in text} == set()


# Every message: what is replaced in ARM, by what, and what the one line says after the file.
MISTAKES = [
    ("name =", "nmae =", ": unknown key 'nmae'; expected some of about, coupled,"),
    ('inertia = "principal"\nm', "form = 1\nm", r", \[links\]: unknown key 'form'; expected some"),
    ('kind = "P"', 'knd = "P"', ", joint 2: unknown key 'knd'; expected some of a, alpha, b,"),
    ("mass = 2.0", "weight = 2", ", joint 1, link: unknown key 'weight'; expected some of centre"),
    ('kind = "P"', 'kind = "X"', r", joint 2, kind: expected 'R' \(revolute\) or 'P'.*got 'X'"),
    ('"-pi/2"', '"-pie"', ", joint 2, alpha: expected an angle in rad or a multiple.*got '-pie'"),
    ('"-pi/2"', "nan", ", joint 2, alpha: expected a finite angle, got nan"),
    ('"-pi/2"', "[1]", r", joint 2, alpha: expected an angle in rad.*got \[1\]"),
    ("theta = 0.1", "theta = true", ", joint 1, theta: expected an angle in rad.*got True"),
    ("d = 0.4", "d = inf", ", joint 1, d: expected a finite length in m or its name, got inf"),
    ("d = 0.4", "d = '4 cm'", ", joint 1, d: expected a length in m or the name.*got '4 cm'"),
    ("a1 = 0.25", "a1 = 'long'", r", \[lengths\], a1: expected a length in m, got 'long'"),
    (
        "a1 = 0.25",
        "a1 = inf",
        r", \[lengths\], a1: expected a finite length.* got inf",
    ),
    (
        "a1 = 0.25",
        "a1 = 0.0",
        r", \[lengths\], a1: expected a finite length.* got 0.0",
    ),
    ("a1 = 0.25", "a1 = 1\na2 = 1", r", \[lengths\]: 'a2' is not used by any joint"),
    ("a1 = 0.25", "'1a' = 1", r", \[lengths\]: expected a length in m or the name.*'1a'"),
    ("[lengths]\na1 = 0.25", "lengths = 3", r", \[lengths\]: expected a table, got 3"),
    ("[0, 0, -9.81]", "-9.81", ", gravity: expected three numbers in m/s², got -9.81"),
    ('["viscous", "offset"]', '"viscous"', ", friction: expected a list of strings, got 'viscous'"),
    ('["viscous", "offset"]', "[1]", r", friction: expected a list of strings, got \[1\]"),
    ("motor = false", "motor = 'no'", ", joint 2, link, motor: expected true or false, got 'no'"),
    ('inertia = "full"', 'inertia = "half"', ", joint 2, link: inertia form must be 'full' or"),
    ('["rx", "ry"]', '"rx"', ", joint 1, link, zero: expected a list of strings, got 'rx'"),
    ('["rx", "ry"]', '["Ixy"]', ", joint 1, link: zero entry 'Ixy' is unknown for a principal"),
    ('["rx", "ry"]', '["m"]', ", joint 1, link: a link of zero mass has no centre of gravity"),
    ('["rx", "ry"]', '["Ixx"]', r", joint 1, link: entries \('Ixx', 'Iyy'\) cannot be both equal"),
    ('[["Ixx", "Iyy"]]', '["Ixx"]', r", joint 1, link, equal: expected a list of pairs, got \['Ix"),
    ('[["Ixx", "Iyy"]]', '[["Ixx"]]', ", joint 1, link: equal entries must be two different"),
    ("mass = 2.0", "mass = -2.0", ", joint 1, link, mass: expected a mass of zero or more in kg"),
    ("mass = 2.0", "mass = 'two'", ", joint 1, link, mass: expected a finite number, got 'two'"),
    ("mass = 2.0", "mass = nan", ", joint 1, link, mass: expected a finite number, got nan"),
    (
        "mass = 2.0\n",
        "",
        ", joint 1, link: has centre_of_gravity, inertia_tensor, motor_inertia but no mass",
    ),
    ("inertia_tensor = [0.2, 0.2, 0.1]\n", "", ", joint 1, link: has .* but no inertia_tensor"),
    ("[0, 0, 0.1]", "[0, 0]", r", joint 1, link, centre_of_gravity: expected 3 finite numbers"),
    ("[0, 0, 0.1]", "[0, 0, nan]", ", joint 1, link, centre_of_gravity: expected 3 finite"),
    ("[0, 0, 0.1]", "['a', 0, 0]", ", joint 1, link, centre_of_gravity: expected 3 finite"),
    ("[0.2, 0.2, 0.1]", "[0.2, 0.2]", ", joint 1, link, inertia_tensor: expected 3 by 3 finite"),
    ("[0.2, 0.2, 0.1]", "0.2", ", joint 1, link, inertia_tensor: expected 3 by 3 finite numbers"),
    ("[0.01, 0.2, 0]", "[0, 0.2, 0]", ", joint 2, link, inertia_tensor: expected a symmetric"),
    (
        "motor_inertia = 0.3",
        "motor_inertia = 'x'",
        ", joint 1, link, motor_inertia: expected a fin",
    ),
    ("viscous = 1.5\n", "", ": viscous is given for 1 of 2 joints"),
    ("viscous = 1.5", "viscous = 1.5\ndry = 1", ": dry is given for 1 of 2 joints"),
    ("viscous = 1.5", "viscous = 'a'", ", joint 1, viscous: expected a finite number, got 'a'"),
    ("viscous = 1.5", "viscous = true", ", joint 1, viscous: expected a finite number, got True"),
    ("[joint.link]\nzero", "link = 3\nzeros", ", joint 1: unknown key"),
]


# Whole files, and what the one line says of them.
BROKEN = [
    ("", ": expected at least one"),
    ("joint = 3\n", ": expected at least one"),
    ("joint = [3]\n", ", joint 1: expected a table, got 3"),
    ("[[joint]]\nlink = 3\n", ", joint 1, link: expected a table, got 3"),
    ("[[joint]\n", ": not valid TOML: "),
    ("a = 1\na = 2\n", ": not valid TOML: "),
    (
        "[[joint]]\n[[joint]]\n[joint.link]\nmass = 1\ncentre_of_gravity = [0, 0, 0]\n"
        "inertia_tensor = [1, 1, 1]\n",
        ", joint 1, link: has no mass while other links have; give every link its parameters",
    ),
    ("numbering = 3\n[[joint]]\n", r", \[numbering\]: expected a table, got 3"),
    ("[numbering]\nmas = 1\n[[joint]]\n", r", \[numbering\]: unknown key 'mas'"),
    ("[numbering.mass]\ninput = 1\n[[joint]]\n", r", \[numbering\], mass: unknown key 'input'"),
    (
        "[numbering.mass]\ninputs = [1]\n[[joint]]\n",
        r", \[numbering\], mass, inputs: expected a list of strings, got \[1\]",
    ),
    (
        "[numbering.gravity]\ncoefficients = [['s2', 2, 1]]\n[[joint]]\n",
        r", \[numbering\], gravity, coefficients: expected entries \[input, \[row, column\]",
    ),
    (
        "[numbering.mass]\ncoefficients = [['s2', [1, 'x'], 1]]\n[[joint]]\n",
        r", \[numbering\], mass, coefficients: expected entries \[input, \[row, column\]",
    ),
]
# Said of the robot by its name and not of the file, or raised as another error.
NOT_OF_THE_FILE = [
    ("[0, 0, -9.81]", "[0, 0]", ".*gravity"),
    ("[0, 0, -9.81]", "[0, 0, nan]", ".*gravity"),
    ("[0, 0, -9.81]", "[0, 0, true]", ".*gravity"),
    ('["viscous", "offset"]', '["sticky"]', ".*'sticky'"),
    ('["viscous", "offset"]', '["dry", "dry"]', ".*twice"),
    ('"-pi/2"', '"pi/0"', ", joint 2, alpha"),
    ('inertia = "full"', "inertia = [1, 1, 1]", ", joint 2, link"),
]
# Contradictions that are read without an error.
UNSEEN = [
    # A centre of gravity away from where `zero` puts it.
    ("[0, 0, 0.1]", "[0.2, 0, 0.1]", ", joint 1, link"),
    # Moments that `equal` says are one, and moments that no body has.
    ("[0.2, 0.2, 0.1]", "[0.2, 0.3, 0.1]", ", joint 1, link"),
    ("[0.2, 0.2, 0.1]", "[-0.2, -0.2, 0.1]", ", joint 1, link"),
    # A motor inertia where the algebra has none, below zero, and without a mass.
    ("motor = false", "motor = false\nmotor_inertia = 0.4", ", joint 2, link"),
    ("motor_inertia = 0.3", "motor_inertia = -0.3", ", joint 1, link"),
    # Friction of a term that the model lacks, and friction that drives.
    ('["viscous", "offset"]', '["dry"]', ".*viscous"),
    ("viscous = 1.5", "viscous = -1.5", ", joint 1, viscous"),
]
LONELY_MOTOR = "[[joint]]\n[joint.link]\nmotor_inertia = 0.3\n"


def mistaken(original: str, replacement: str) -> str:
    assert ARM.count(original) >= 1
    return ARM.replace(original, replacement, 1)


@pytest.fixture(scope="module")
def refusals(
    outcomes: Callable[..., list[tuple[str, str]]], tmp_path_factory: pytest.TempPathFactory
) -> dict[str, tuple[str, str]]:
    """What loading each of the files above raises, by the file's text."""
    texts = [mistaken(*row[:2]) for row in MISTAKES + NOT_OF_THE_FILE + UNSEEN]
    texts += [LONELY_MOTOR, *(text for text, _ in BROKEN)]
    paths = [tmp_path_factory.mktemp("robot") / "arm.toml" for _ in texts]
    for path, text in zip(paths, texts, strict=True):
        path.write_text(text, encoding="utf-8")
    results = outcomes([("load_robot", {"path": str(path)}) for path in paths])
    return dict(zip(texts, results, strict=True))


def assert_refused(outcome: tuple[str, str], message: str) -> None:
    kind, text = outcome
    assert kind == "RobotError", text
    assert re.search(r"[/\\]arm\.toml" + message, text), text
    assert "\n" not in text


@pytest.mark.parametrize(("original", "replacement", "message"), MISTAKES)
def test_mistakes(
    refusals: dict[str, tuple[str, str]], original: str, replacement: str, message: str
) -> None:
    assert_refused(refusals[mistaken(original, replacement)], message)


@pytest.mark.parametrize(("text", "message"), BROKEN)
def test_broken_files(refusals: dict[str, tuple[str, str]], text: str, message: str) -> None:
    assert_refused(refusals[text], message)


@pytest.mark.parametrize(("original", "replacement", "message"), NOT_OF_THE_FILE)
def test_the_file_is_named(
    refusals: dict[str, tuple[str, str]], original: str, replacement: str, message: str
) -> None:
    assert_refused(refusals[mistaken(original, replacement)], message)


@pytest.mark.parametrize(("original", "replacement", "message"), UNSEEN)
def test_contradictions(
    refusals: dict[str, tuple[str, str]], original: str, replacement: str, message: str
) -> None:
    assert_refused(refusals[mistaken(original, replacement)], message)


def test_a_motor_inertia_without_a_mass(refusals: dict[str, tuple[str, str]]) -> None:
    assert_refused(refusals[LONELY_MOTOR], ", joint 1, link: has motor_inertia but no")


def test_files_that_cannot_be_read(tmp_path: Path) -> None:
    with pytest.raises(RobotError, match=r"nowhere\.toml: no such robot file"):
        load_robot(tmp_path / "nowhere.toml")
    with pytest.raises(RobotError, match=r"arm\.step: expected a robot file ending in \.toml"):
        load_robot(tmp_path / "arm.step")
    (tmp_path / "folder.toml").mkdir()
    with pytest.raises(RobotError, match=r"folder\.toml: cannot be read: "):
        load_robot(tmp_path / "folder.toml")
    (tmp_path / "latin.toml").write_bytes(b'name = "Pr\xfcfstand"\n[[joint]]\n')
    with pytest.raises(RobotError, match=r"latin\.toml: cannot be read: "):
        load_robot(tmp_path / "latin.toml")


NUMBERED = """
[lengths]
a1 = 0.5
[links]
motor_inertia = false
[[joint]]
[[joint]]
a = "a1"
[numbering]
source = "a sketch"
[numbering.mass]
inputs = ["1", "s1*s12", "c1*c12", "c1*s12", "s1*c12"]
coefficients = [["1", [1, 1], 1], ["1", [2, 2], 1], ["c1*c12", [1, 2], 1], ["c1*s12", [1, 2], 1]]
"""


def test_a_numbering_orders_and_scales(load: Callable[[str], Manipulator]) -> None:
    """A planar arm, by hand: gravity along the axes, so that the mass matrix is all there is."""
    algebra = derive_algebra(load(NUMBERED), "symbolic")
    assert [(c.name, c.expression) for c in algebra.coefficients] == [
        ("kM1", "Izz1 + Izz2 + a1^2*m2"),
        ("kM2", "Izz2"),
        ("kM3", "a1*m2*rx2"),
        ("kM4", "-a1*m2*ry2"),
    ]
    assert algebra.mass.labels == ("1", "s1*s12", "c1*c12", "c1*s12", "s1*c12")
    # M11 holds twice what M12 does.
    twice = load(NUMBERED.replace('["c1*s12", [1, 2], 1]', '["c1*s12", [1, 1], 1]'))
    assert derive_algebra(twice, "symbolic").coefficients[3].expression == "-2*a1*m2*ry2"


@pytest.mark.parametrize(
    ("original", "replacement", "message"),
    [
        ('"c1*c12", "c1*s12"', '"c1*c12"', r"\(a sketch\): input 'c1\*s12' of this robot is not"),
        ('"1", "s1*s12"', '"1", "c9", "s1*s12"', r"\(a sketch\): 'c9' is not an input"),
        ('"1", "s1*s12"', '"1", "1", "s1*s12"', r"\(a sketch\): '1' .* listed twice"),
        (', ["c1*s12", [1, 2], 1]', "", "lists 3 coefficients, the algebra has 4"),
        (
            '["c1*s12", [1, 2]',
            '["c1*s12", [2, 2]',
            "'c1.s12' to element .* does not define",
        ),
        (
            '["c1*s12", [1, 2]',
            '["c1*c12", [1, 1]',
            "'c1.c12' to element .* does not define",
        ),
    ],
)
def test_a_numbering_that_does_not_fit(
    load: Callable[[str], Manipulator], original: str, replacement: str, message: str
) -> None:
    assert original in NUMBERED
    robot = load(NUMBERED.replace(original, replacement, 1))

    def derived() -> Any:
        algebra = derive_algebra(robot, "symbolic")
        return algebra.mass

    with pytest.raises(RobotError, match=message):
        derived()
