"""Robots made in Python: what rows mean, what variants keep, what is an error."""

import dataclasses
import math
import re
from collections.abc import Callable
from typing import Any

import hypothesis
import jax
import jax.numpy as jnp
import numpy as np
import pytest
from hypothesis import strategies as st

import jaxcslc
from jaxcslc.manipulator import (
    Joint,
    Length,
    LinkInertia,
    Manipulator,
    RobotError,
    joint_lines,
    link_poses,
)


ROWS = [(0, 0, "d1", 0), ("-pi/2", 0.3, 0, "pi")]


def test_rows_become_joints() -> None:
    robot = Manipulator.from_modified_dh(ROWS, kinds="RP", lengths={"d1": 0.4}, name="arm")
    assert robot.joints == (
        Joint("R", 0.0, Length(0.0), Length(0.4, "d1"), 0.0),
        Joint("P", -math.pi / 2, Length(0.3), Length(0.0), math.pi),
    )
    assert (robot.name, robot.kinds, robot.joint_count) == ("arm", "RP", 2)
    assert robot.gravity == (0.0, 0.0, -9.81)
    assert robot.friction == ("viscous", "dry")
    assert robot.links is robot.viscous is robot.dry is robot.numbering is None


def test_defaults() -> None:
    robot = Manipulator.from_modified_dh(ROWS)
    assert robot.kinds == "RR"
    assert robot.inertia == (LinkInertia("full", motor=True),) * 2
    # A length without a value is a symbol: nobody has measured it yet.
    assert robot.joints[0].d == Length(None, "d1")


def test_inertia_for_all_links_or_for_each() -> None:
    round_link = LinkInertia("principal", zero=("rx", "ry"), equal=(("Ixx", "Iyy"),), motor=False)
    alike = Manipulator.from_modified_dh(ROWS, inertia="principal", motor_inertia=False)
    assert alike.inertia == (LinkInertia("principal", motor=False),) * 2
    assert Manipulator.from_modified_dh(ROWS, inertia=round_link).inertia == (round_link,) * 2
    mixed = Manipulator.from_modified_dh(ROWS, inertia=["full", round_link])
    assert mixed.inertia == (LinkInertia("full"), round_link)


@pytest.mark.parametrize(
    ("text", "angle"),
    [
        ("pi", math.pi),
        ("-pi/2", -math.pi / 2),
        ("+pi/4", math.pi / 4),
        ("3*pi/4", 3 * math.pi / 4),
        ("2pi", 2 * math.pi),
        (" - 0.5 * pi / 3 ", -math.pi / 6),
        ("0.25", 0.25),
        ("-1e-3", -1e-3),
        (2, 2.0),
        (-0.3, -0.3),
    ],
)
def test_angles_in_words(text: Any, angle: float) -> None:
    robot = Manipulator.from_modified_dh([(text, 0, 0, text)])
    assert robot.joints[0].alpha == robot.joints[0].theta == pytest.approx(angle, rel=1e-15)


@hypothesis.given(st.integers(-12, 12).filter(bool), st.integers(1, 12))
def test_multiples_of_pi(factor: int, divisor: int) -> None:
    sign = "-" if factor < 0 else ""
    robot = Manipulator.from_modified_dh([(f"{sign}{abs(factor)}*pi/{divisor}", 0, 0, 0)])
    assert robot.joints[0].alpha == pytest.approx(factor * math.pi / divisor, rel=1e-15)


def test_variants_keep_the_rest() -> None:
    puma = jaxcslc.puma560()
    tilted = puma.with_gravity((1, 0, -9))
    assert tilted.gravity == (1.0, 0.0, -9.0)
    # Appendix B's gravity coefficients are those of gravity along z; its others stay.
    assert tilted.numbering is not None and puma.numbering is not None
    assert tilted.numbering.mass == puma.numbering.mass
    assert tilted.numbering.gravity.inputs == ()
    back = dataclasses.replace(tilted, gravity=puma.gravity, numbering=puma.numbering)
    assert back == puma
    assert tilted.links is puma.links
    frictionless = puma.with_friction()
    assert frictionless.friction == ()
    assert dataclasses.replace(frictionless, friction=puma.friction) == puma
    full = puma.with_inertia("full", motor_inertia=False)
    assert full.inertia == (LinkInertia("full", motor=False),) * 6
    assert full.joints == puma.joints
    # Appendix B numbers the coefficients of the principal-axis substitution only.
    assert full.numbering is None


def test_lengths_are_named_by_their_joint() -> None:
    robot = Manipulator.from_modified_dh(
        [(0, 0, 0.5, 0), (0, 0.1, 0, 0), (0, "upper", -0.2, 0)], lengths={"upper": 0.7}
    )
    assert robot.length_values() == {"d1": 0.5, "a1": 0.1, "upper": 0.7, "d3": -0.2}
    assert list(robot.named_lengths()) == list(robot.length_values())


def test_robots_are_values() -> None:
    one, other = (Manipulator.from_modified_dh(ROWS) for _ in range(2))
    assert one == other and hash(one) == hash(other)
    assert one != one.with_gravity((0, 0, 0))
    with pytest.raises(dataclasses.FrozenInstanceError):
        one.name = "another"  # type: ignore[misc]


def changed(row: int, entry: int, value: object) -> list[Any]:
    rows: list[list[object]] = [list(row) for row in ROWS]
    rows[row][entry] = value
    return rows


# Arguments besides name="arm", and what the one line says.
REFUSED: list[tuple[dict[str, Any], str]] = [
    ({"rows": []}, "robot 'arm' has no joints"),
    ({"rows": [[0, 0, 0]]}, r"joint 1: expected \(alpha, a, d, theta\) or .*got \(0, 0, 0\)"),
    ({"rows": ROWS, "kinds": "R"}, "kinds must be one R or P for each of 2 rows, got 'R'"),
    ({"rows": ROWS, "kinds": "RX"}, "kinds must be one R or P for each of 2 rows, got 'RX'"),
    ({"rows": changed(1, 0, "pie")}, "'arm', joint 2, alpha: expected an angle.*got 'pie'"),
    ({"rows": changed(1, 0, True)}, "'arm', joint 2, alpha: expected an angle.*got True"),
    ({"rows": changed(0, 3, math.nan)}, "'arm', joint 1, theta: expected a finite angle, got nan"),
    ({"rows": changed(0, 3, "inf")}, "'arm', joint 1, theta: expected a finite angle, got 'inf'"),
    ({"rows": changed(1, 1, "2a")}, "'arm', joint 2, a: expected a length in m or.*'2a'"),
    ({"rows": changed(1, 1, "-a2")}, "'arm', joint 2, a: expected a length in m or.*'-a2'"),
    ({"rows": changed(0, 2, math.inf)}, "'arm', joint 1, d: expected a finite length.*inf"),
    ({"rows": changed(0, 2, True)}, "'arm', joint 1, d: expected a finite length.*True"),
    ({"rows": changed(0, 2, None)}, "'arm', joint 1, d: expected a finite length.*None"),
    ({"rows": ROWS, "gravity": [0, 0]}, "robot 'arm': gravity must be three numbers in m/s²"),
    ({"rows": ROWS, "gravity": [0, 0, "down"]}, "robot 'arm': gravity must be three numbers"),
    ({"rows": ROWS, "gravity": [0, 0, math.nan]}, "robot 'arm': gravity must be at most"),
    ({"rows": ROWS, "gravity": [1e300, 0, 0]}, "robot 'arm': gravity must be at most 10000 m/s²"),
    ({"rows": ROWS, "friction": ["dry", "dry"]}, "robot 'arm': a friction term is listed twice"),
    ({"rows": ROWS, "friction": ["slip"]}, "robot 'arm': unknown friction term 'slip'; expected"),
    ({"rows": ROWS, "inertia": ["full"]}, "robot 'arm': expected 2 entries of inertia, one a j"),
]
CONTRADICTORY: list[tuple[dict[str, Any], str]] = [
    ({"form": "half"}, "inertia form must be 'full' or 'principal', got 'half'"),
    ({"zero": ["rw"]}, "zero entry 'rw' is unknown for a full inertia; expected one of m rx"),
    ({"form": "principal", "zero": ["Ixy"]}, "zero entry 'Ixy' is unknown for a principal"),
    ({"equal": [["Ixx", "Ixx"]]}, "equal entries must be two different moments"),
    ({"equal": [["Ixx"]]}, "equal entries must be two different moments"),
    ({"equal": [["Ixx", "rx"]]}, "equal entries must be two different moments"),
    (
        {"zero": ["Ixx"], "equal": [["Ixx", "Iyy"]]},
        r"entries \('Ixx', 'Iyy'\) cannot be both equal and zero",
    ),
    ({"form": "principal", "zero": ["m"]}, "a link of zero mass has no centre of gravity"),
]
# Other messages, or no error.
TO_REFUSE: list[tuple[dict[str, Any], str]] = [
    ({"rows": changed(0, 0, "pi/0")}, "joint 1, alpha"),  # ZeroDivisionError
    # Values of named lengths are not looked at, as those of a file are.
    ({"rows": ROWS, "lengths": {"d1": math.nan}}, "d1"),
    ({"rows": ROWS, "lengths": {"d1": "long"}}, "d1"),
    ({"rows": ROWS, "lengths": {"d1": 0.0}}, "d1"),
    ({"rows": ROWS, "lengths": {"d1": 0.1, "d7": 0.2}}, "d7"),
    ({"rows": ROWS, "gravity": [0, 0, True]}, "gravity"),
]


@pytest.fixture(scope="module")
def refusals(outcomes: Callable[..., list[tuple[str, str]]]) -> dict[str, tuple[str, str]]:
    cases = [("from_modified_dh", {"name": "arm"} | case) for case, _ in REFUSED + TO_REFUSE]
    cases += [("LinkInertia", case) for case, _ in CONTRADICTORY]
    arguments = [case for case, _ in REFUSED + TO_REFUSE + CONTRADICTORY]
    return dict(zip(map(str, arguments), outcomes(cases), strict=True))


@pytest.mark.parametrize(("arguments", "message"), REFUSED + CONTRADICTORY, ids=str)
def test_refused(
    refusals: dict[str, tuple[str, str]], arguments: dict[str, Any], message: str
) -> None:
    kind, text = refusals[str(arguments)]
    assert kind == "RobotError"
    assert re.search(message, text), text
    assert "\n" not in text


@pytest.mark.parametrize(("arguments", "message"), TO_REFUSE, ids=str)
def test_to_be_refused(
    refusals: dict[str, tuple[str, str]], arguments: dict[str, Any], message: str
) -> None:
    kind, text = refusals[str(arguments)]
    assert kind == "RobotError"
    assert re.search(message, text), text


@pytest.mark.parametrize("field", ["links", "viscous", "dry"])
def test_one_entry_a_joint(field: str) -> None:
    with pytest.raises(RobotError, match=f"expected 7 entries of {field}, one a joint, got 0"):
        dataclasses.replace(jaxcslc.panda(), **{field: ()})


def test_three_equal_moments() -> None:
    """A homogeneous sphere: either it is written with one moment, or it is an error."""
    from jaxcslc.derivation import derive_algebra

    sphere = LinkInertia(
        "principal", zero=("rx", "ry", "rz"), equal=(("Ixx", "Iyy"), ("Iyy", "Izz")), motor=False
    )
    robot = Manipulator.from_modified_dh([(0, 0, 0, 0)], inertia=sphere)
    moments = {t.factors for t in derive_algebra(robot, "numeric").terms if t.factors != ("m",)}
    assert moments == {("Ixx",)}


def test_lines_of_many_poses_follow_the_table_of_joints() -> None:
    """A tree: both arms of a T; in NumPy, and in JAX under `jit`."""
    rows = [(0, 0, 0, 0), (0, 0.5, 0, 0), (0, 0.3, 0, 0)]
    robot = jaxcslc.Manipulator.from_modified_dh(rows, parents=[0, 1, 1])
    q = np.array([[0.0, 0.0, 0.0], [np.pi / 2, 1.0, 2.0]])
    lines = joint_lines(robot, q)
    expected = [[[0, 0, 0], [0, 0, 0]], [[0, 0, 0], [0, 0.5, 0]], [[0, 0, 0], [0, 0.3, 0]]]
    np.testing.assert_allclose(lines[1], expected, atol=1e-12)
    traced = jax.jit(lambda q: link_poses(robot, q))(jnp.asarray(q))
    np.testing.assert_allclose(traced[..., :3, 3], lines[..., 1, :], atol=1e-12)


def test_a_robot_shows_joints_limits_and_bodies() -> None:
    text, page = str(jaxcslc.puma560()), jaxcslc.puma560()._repr_html_()
    for shown in (text, page):
        assert all(word in shown for word in ("joint 6", "revolute", "17.4", "0, 0, 0.032"))
    assert len(text.splitlines()) == 8
    assert page.count("<tr>") == 7
    named = dataclasses.replace(jaxcslc.puma560(), name="<script>")
    assert "<script>" not in named._repr_html_()


def test_a_plot_has_a_line_per_joint() -> None:
    figure = jaxcslc.puma560().plot(np.zeros(6))
    x = np.array(figure.data[0].x).reshape(6, 3)
    assert np.isnan(x[:, 2]).all()
    np.testing.assert_allclose(x[2], [0.0, 0.4318, np.nan])
