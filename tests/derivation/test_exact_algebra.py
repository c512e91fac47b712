"""The arithmetic under the tables: angles, polynomials, Jacobians, names."""

import dataclasses
import math
from collections.abc import Callable, Sequence
from fractions import Fraction
from typing import Any

import hypothesis
import numpy as np
import pytest
from hypothesis import strategies as st
from sympy import QQ
from sympy.polys.rings import ring as sympy_ring

import jaxcslc
from jaxcslc.derivation import Chain, PositionRing, derive_algebra, link_twists
from jaxcslc.derivation._chain import exact_cos_sin, exact_number
from jaxcslc.derivation._polynomials import SparsePolynomial
from jaxcslc.manipulator import LinkInertia, Manipulator, RobotError
from tests import arms


QUARTERS = [(1, 0), (0, 1), (-1, 0), (0, -1)]


@pytest.mark.parametrize("quarters", range(-9, 10))
def test_right_angles_are_exact(quarters: int) -> None:
    assert exact_cos_sin(quarters * math.pi / 2) == QUARTERS[quarters % 4]


@hypothesis.given(st.floats(-20, 20).map(lambda x: math.copysign(max(abs(x), 1e-3), x)))
def test_other_angles_are_near_rational_rotations(angle: float) -> None:
    cos, sin = exact_cos_sin(angle)
    assert cos * cos + sin * sin == 1  # in rationals, so exactly
    # Where the tangent of half the angle is itself nearly simple, 1e-14 is missed: see below.
    assert math.hypot(float(cos) - math.cos(angle), float(sin) - math.sin(angle)) < 1e-9


@pytest.mark.parametrize(
    "angle",
    [1e-7, 4e-8, 2 * math.atan(0.5) + 1e-8, math.pi / 2 - 2e-8, 2 * math.atan(1 / 3) + 5e-9],
)
def test_angles_beside_simple_ones_are_as_near(angle: float) -> None:
    cos, sin = exact_cos_sin(angle)
    assert math.hypot(float(cos) - math.cos(angle), float(sin) - math.sin(angle)) < 1e-14


@hypothesis.given(st.floats(allow_nan=False, allow_infinity=False))
def test_numbers_are_their_shortest_decimal(value: float) -> None:
    exact = exact_number(value)
    assert float(Fraction(int(exact.numerator), int(exact.denominator))) == value


def test_numbers_are_what_was_typed() -> None:
    assert exact_number(0.4318) == QQ(4318, 10000)
    assert exact_number(-0.1) + exact_number(0.3) == QQ(2, 10)


def test_parallel_axes_share_their_angle() -> None:
    chain = Chain.from_robot(arms.MIXED)
    assert [angle.label for angle in chain.angles] == ["1", "1-2", "4", "4-5"]
    assert [angle.terms for angle in chain.angles] == [
        *(((0, 1),), ((0, 1), (1, -1)), ((3, 1),), ((3, 1), (4, -1)))
    ]
    assert PositionRing(chain, ("d1",)).variables == (
        *("c1", "s1", "c1-2", "s1-2", "c4", "s4", "c4-5", "s4-5", "q3"),
    )


def test_a_quarter_turn_ends_the_group_of_parallel_axes() -> None:
    chain = Chain.from_robot(jaxcslc.puma560())
    assert [angle.label for angle in chain.angles] == ["1", "2", "23", "4", "5", "6"]


def test_names_of_ten_and_more_joints() -> None:
    rows = [(0, 0, 0, 0) if i % 2 else ("pi/2", 0.1, 0, 0) for i in range(12)]
    chain = Chain.from_robot(Manipulator.from_modified_dh(rows))
    assert [angle.label for angle in chain.angles][-4:] == ["9", "9_10", "11", "11_12"]


def test_names_of_angles_are_unique() -> None:
    rows = [(0, 0, 0, 0), (0, 0.3, 0, 0), *[("pi/2", 0, 0.1, 0)] * 10]
    variables = PositionRing(Chain.from_robot(Manipulator.from_modified_dh(rows)), ()).variables
    assert len(set(variables)) == len(variables)


def values(ring: PositionRing, q: np.ndarray) -> list[Any]:
    """Numbers for the ring's variables, by the meaning that the chain gives them."""
    angles = [sum(sign * q[joint] for joint, sign in angle.terms) for angle in ring.chain.angles]
    pairs = [function(angle) for angle in angles for function in (np.cos, np.sin)]
    return pairs + [q[i] for i, link in enumerate(ring.chain.links) if link.prismatic]


def evaluate(polynomial: dict[tuple[int, ...], dict[Any, Any]], at: list[Any]) -> Any:
    """Value of {monomial: {(): rational}}."""
    return sum(
        float(form[()]) * math.prod(x**power for x, power in zip(at, monomial, strict=True))
        for monomial, form in polynomial.items()
    )


def random_polynomial(ring: PositionRing, rng: np.random.Generator) -> Any:
    variables = [*ring.cosines, *ring.sines, *(ring.joint_variable(2),)]
    total: Any = 0
    for _ in range(6):
        powers = rng.integers(0, 3, len(variables))
        term: Any = QQ(int(rng.integers(1, 9)), int(rng.integers(1, 9)))
        for variable, power in zip(variables, powers, strict=True):
            term = term * variable ** int(power)
        total = total + term
    return total


def test_sparse_polynomials_are_sympys() -> None:
    """Same terms in the same order, which names of coefficients depend on."""
    _, *theirs = sympy_ring("x, y, z", QQ)
    ours = [SparsePolynomial.generator(index, 3) for index in range(3)]

    def built(generators: list[Any]) -> list[Any]:
        x, y, z = generators
        half = QQ(1, 2)
        one = (half * x + y * z - 3) * (x * x - y) + 2
        other = 1 - (z + x) * (z - x) - one * y
        return [one, other, one * other - other * one, one - other, -one * half, one * 0]

    for polynomial, expected in zip(built(ours), built(theirs), strict=True):
        assert list(polynomial.items()) == list(expected.items())
        assert (polynomial == 0) == (expected == 0)


def test_normal_form_is_the_same_function(rng: np.random.Generator) -> None:
    ring = PositionRing(Chain.from_robot(arms.MIXED), ())
    angles = range(len(ring.chain.angles))
    for _ in range(10):
        polynomial = random_polynomial(ring, rng)
        normal = ring.normal_form(polynomial)
        assert all(monomial[2 * i + 1] <= 1 for monomial in normal for i in angles)
        at = values(ring, rng.uniform(-3, 3, 5))
        before = evaluate({m: {(): v} for m, v in polynomial.items()}, at)
        after = evaluate({m: {(): v} for m, v in normal.items()}, at)
        np.testing.assert_allclose(after, before, rtol=1e-11, atol=1e-11)
        assert ring.normal_form(normal) == normal


def test_equal_functions_are_equal_polynomials() -> None:
    ring = PositionRing(Chain.from_robot(arms.MIXED), ())
    c, s = ring.cosines[1], ring.sines[1]
    assert ring.normal_form((c + s) ** 2 - (1 + 2 * c * s)) == 0
    assert ring.normal_form(s**4) == ring.normal_form((1 - c**2) ** 2)


@pytest.mark.parametrize("joint", range(5))
def test_derivative(rng: np.random.Generator, joint: int) -> None:
    ring = PositionRing(Chain.from_robot(arms.MIXED), ())
    q = rng.uniform(-3, 3, 5)
    step = np.zeros(5, complex)
    step[joint] = 1e-30j  # a complex step has no subtraction, and so no rounding to speak of
    for _ in range(5):
        normal = ring.normal_form(random_polynomial(ring, rng))
        polynomial = {monomial: {(): value} for monomial, value in normal.items()}
        derivative = ring.derivative(polynomial, joint)
        expected = evaluate(polynomial, values(ring, q + step)).imag / 1e-30
        np.testing.assert_allclose(
            evaluate(derivative, values(ring, q)), expected, rtol=1e-11, atol=1e-11
        )
        assert all(monomial[2 * i + 1] <= 1 for monomial in derivative for i in range(4))


def test_labels_and_their_reading() -> None:
    algebra = derive_algebra(jaxcslc.puma560(), "symbolic")
    for table in (algebra.mass, algebra.velocity, algebra.gravity):
        for monomial, label in zip(table.inputs, table.labels, strict=True):
            assert algebra.ring.label(monomial) == label
            assert algebra.ring.parse(label) == monomial
            backwards = "*".join(reversed(label.split("*")))
            assert algebra.ring.parse(backwards) == monomial
    assert algebra.ring.parse("c9") is None
    assert algebra.ring.parse("c2^x") is None


def running_sum(terms: Sequence[tuple[int, int]], pairs: Sequence[tuple[Any, Any]]) -> Any:
    """Cosine and sine of a signed sum of angles, from theirs."""
    c, s = QQ(1), QQ(0)
    for joint, sign in terms:
        cos, sin = pairs[joint]
        c, s = c * cos - s * sign * sin, s * cos + c * sign * sin
    return c, s


@pytest.mark.parametrize(
    "robot", [arms.MIXED, jaxcslc.puma560(), jaxcslc.panda()], ids=lambda r: r.kinds
)
def test_jacobians_are_pinocchios(
    rng: np.random.Generator, pinocchio_chain: Callable[[Manipulator], Any], robot: Manipulator
) -> None:
    import pinocchio as pin

    model, chain = pinocchio_chain(robot), Chain.from_robot(robot)
    data = model.createData()
    q = rng.integers(-30, 30, robot.joint_count) / 16  # rationals, so that both see the same
    # Rotations of rational tangent, near q; prismatic positions are q itself.
    pairs = [exact_cos_sin(float(angle)) for angle in q]
    turns = [
        math.atan2(float(sin), float(cos)) if joint.kind == "R" else float(x)
        for joint, x, (cos, sin) in zip(robot.joints, q, pairs, strict=True)
    ]
    cosines, sines = zip(*(running_sum(angle.terms, pairs) for angle in chain.angles), strict=True)
    twists = link_twists(
        chain,
        cosines=cosines,
        sines=sines,
        a=[exact_number(joint.a.value or 0.0) for joint in robot.joints],
        d=[
            exact_number(joint.d.value or 0.0)
            + (exact_number(float(x)) if joint.kind == "P" else 0)
            for joint, x in zip(robot.joints, q, strict=True)
        ],
        b=[0] * len(robot.joints),
        gravity=tuple(exact_number(g) for g in robot.gravity),  # type: ignore[arg-type]
    )

    def floats(rows: Any) -> np.ndarray:
        return np.array([[float(x) for x in row] for row in rows])

    pin.computeJointJacobians(model, data, np.array(turns))
    for i, twist in enumerate(twists):
        jacobian = pin.getJointJacobian(model, data, i + 1, pin.ReferenceFrame.LOCAL)[:, : i + 1]
        np.testing.assert_allclose(floats(twist.linear).T, jacobian[:3], atol=1e-13)
        np.testing.assert_allclose(floats(twist.angular).T, jacobian[3:], atol=1e-13)
        gravity = data.oMi[i + 1].rotation.T @ np.array(robot.gravity)
        np.testing.assert_allclose(floats([twist.gravity])[0], gravity, atol=1e-13)


def test_lengths_keep_their_values_apart() -> None:
    robot = Manipulator.from_modified_dh(
        [(0, 0, 0.1, 0), ("pi/2", "a1", 0, 0)], lengths={"a1": 0.5}
    )
    assert robot.length_values() == {"d1": 0.1, "a1": 0.5}


def test_a_name_given_to_another_length_is_refused_or_kept_apart() -> None:
    rows = [(0, 0, 0, 0), ("pi/2", 0.5, 0, 0), ("pi/2", 0, "a1", 0)]
    try:
        robot = Manipulator.from_modified_dh(rows, lengths={"a1": 0.3})
    except RobotError:
        return
    assert sorted(robot.length_values().values()) == [0.3, 0.5]


def test_a_length_with_the_name_of_gravity_is_refused() -> None:
    robot = Manipulator.from_modified_dh(
        [(0, 0, 0, 0), ("pi/2", "g", 0, 0), (0, 0.2, 0, 0)], lengths={"g": 0.5}
    )
    with pytest.raises(RobotError, match="'g'"):
        derive_algebra(robot, "symbolic")


def test_a_length_with_the_name_of_a_variable_is_refused() -> None:
    robot = Manipulator.from_modified_dh([(0, 0, 0, 0), ("pi/2", "c1", 0, 0)], name="arm")
    with pytest.raises(RobotError, match="robot 'arm': length 'c1'"):
        derive_algebra(robot, "symbolic")


def test_numeric_lengths_need_values() -> None:
    robot = Manipulator.from_modified_dh([(0, 0, 0, 0), ("pi/2", "a1", 0, 0)], name="arm")
    assert derive_algebra(robot, "symbolic").coefficients
    with pytest.raises(RobotError, match="robot 'arm': length 'a1' has no value"):
        derive_algebra(robot, "numeric")


def test_units_of_a_prismatic_joint() -> None:
    slide = Manipulator.from_modified_dh([("pi/2", 0, 0, 0)], kinds="P")
    ((expression, unit),) = (
        (coefficient.expression, coefficient.unit)
        for coefficient in derive_algebra(slide, "numeric").coefficients
    )
    assert (expression, unit) == ("m1 + Im1", "kg")


def test_a_link_without_inertia_has_no_terms() -> None:
    massless = LinkInertia(
        "full",
        zero=("m", "rx", "ry", "rz", "Ixx", "Iyy", "Izz", "Ixy", "Ixz", "Iyz"),
        motor=False,
    )
    robot = Manipulator.from_modified_dh(
        [(0, 0, 0, 0), ("pi/2", 0.3, 0, 0)], inertia=[massless, "full"]
    )
    for lengths in ("symbolic", "numeric"):
        terms = derive_algebra(robot, lengths).terms
        assert {term.link for term in terms} == {1}
    alone = Manipulator.from_modified_dh([(0, 0, 0, 0)], inertia=massless)
    assert derive_algebra(alone, "numeric").coefficients == ()


def test_the_robot_that_is_handed_back_is_the_one_that_was_given(
    rng: np.random.Generator, random_links: Callable[..., Any]
) -> None:
    first = dataclasses.replace(jaxcslc.panda(), links=random_links(rng, 7))
    second = dataclasses.replace(jaxcslc.panda(), links=random_links(rng, 7))
    derive_algebra(first, "numeric")
    assert derive_algebra(second, "numeric").robot.links is second.links
