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
from tests.manipulator.conftest import ARM


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
    from jaxcslc.manipulator.files import _toml

    text = (Path(__file__).parents[2] / "docs" / "robots.md").read_text(encoding="utf-8")
    keys = _toml._ROBOT_KEYS | _toml._DEFAULT_KEYS | _toml._JOINT_KEYS | _toml._LINK_KEYS
    assert {key for key in keys if f"`{key}`" not in text} == set()


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
