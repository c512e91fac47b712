"""Robot files with mistakes: one line names the file, the entry and what was expected."""

import re
from collections.abc import Callable
from pathlib import Path

import pytest

from jaxcslc import RobotError, load_robot
from tests.manipulator.conftest import ARM


# Every message: what is replaced in ARM, by what, and what the one line says after the file.
MISTAKES = [
    ("name =", "nmae =", ": unknown key 'nmae'; expected some of about, coupled,"),
    ('inertia = "principal"\nm', "form = 1\nm", r", \[links\]: unknown key 'form'; expected some"),
    ('kind = "P"', 'knd = "P"', ", joint 2: unknown key 'knd'; expected some of a, alpha, b,"),
    ("mass = 2.0", "weight = 2", ", joint 1, link: unknown key 'weight'; expected some of centre"),
    ('kind = "P"', 'kind = "X"', r", joint 2, kind: expected 'R' \(revolute\) or 'P'.*got 'X'"),
    ('"-pi/2"', '"-pie"', ", joint 2, alpha: expected an angle in rad or a multiple.*got '-pie'"),
    (
        '"-pi/2"',
        "-90",
        ", joint 2, alpha: -90 rad is more than two turns; expected .* not in degrees",
    ),
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
    ("viscous = 1.5", f"viscous = {10**400}", ", joint 1, viscous: expected a finite number"),
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
