"""The recursion over rationals is the tables, exactly."""

import random
from typing import Any

import pytest
from flint import fmpq

import jaxcslc as jc
from jaxcslc.derivation import Algebra, NewtonEuler, ProductTable, derive_algebra, link_frames
from jaxcslc.derivation._chain import compose, exact_cos_sin, exact_number
from tests import arms


_ROBOTS = [
    pytest.param(arms.MIXED, id="parallel axes"),
    pytest.param(arms.TREE, id="a tree"),
    pytest.param(jc.puma560(), id="PUMA 560"),
]


class _State:
    """Rational motion of a robot: cosines and sines are a rational point of the unit circle."""

    def __init__(self, algebra: Algebra) -> None:
        draw = random.Random(0)

        def number() -> fmpq:
            return fmpq(draw.randrange(-40, 40), draw.randrange(1, 20))

        robot = algebra.robot
        self.qd = [number() for _ in robot.joints]
        self.qdd = [number() for _ in robot.joints]
        self.q: list[Any] = []  # cosine and sine, or the position of a prismatic joint
        for kind in robot.kinds:
            t = number()
            half = (1 - t * t) / (1 + t * t), 2 * t / (1 + t * t)
            self.q.append(half if kind == "R" else t)

    def recursion(self, algebra: Algebra) -> NewtonEuler:
        robot = algebra.robot
        lengths = {
            letter: [exact_number(getattr(joint, letter).value or 0.0) for joint in robot.joints]
            for letter in "adb"
        }
        rotations: list[Any] = []
        for i, joint in enumerate(robot.joints):
            constant = exact_cos_sin(joint.theta)
            rotations.append(compose(constant, self.q[i]) if joint.kind == "R" else constant)
            if joint.kind == "P":
                lengths["d"][i] += self.q[i]
        frames = link_frames(algebra.chain, rotations=rotations, **lengths)
        x, y, z = (exact_number(g) for g in robot.gravity)
        return NewtonEuler(frames, (x, y, z))

    def variables(self, algebra: Algebra) -> list[Any]:
        """Of the tables: cosine and sine of every running sum of angles, prismatic positions."""
        variables: list[Any] = []
        for angle in algebra.chain.angles:
            total: Any = (fmpq(1), fmpq(0))
            for joint, sign in angle.terms:
                total = compose(total, self.q[joint], sign)
            variables += total
        return variables + [
            q for q, kind in zip(self.q, algebra.robot.kinds, strict=True) if kind == "P"
        ]


def _sums(table: ProductTable, variables: list[Any]) -> dict[tuple[int, ...], dict[int, Any]]:
    """For every element of a table, what multiplies each coefficient."""
    sums: dict[tuple[int, ...], dict[int, Any]] = {}
    for link in table.links:
        value = fmpq(1)
        for variable, power in zip(variables, table.inputs[link.input], strict=True):
            value *= variable**power
        element = sums.setdefault(table.columns[link.column], {})
        for index, multiple in link.weights:
            factor = fmpq(multiple.numerator, multiple.denominator)
            element[index] = element.get(index, 0) + factor * value
    return sums


def _table_regressor(algebra: Algebra, state: _State) -> list[list[Any]]:
    variables, qd, qdd = state.variables(algebra), state.qd, state.qdd
    rows: list[list[Any]] = [[0] * len(algebra.coefficients) for _ in qd]
    for (j, m), element in _sums(algebra.mass, variables).items():
        for index, value in element.items():
            rows[j][index] += value * qdd[m]
            if j != m:
                rows[m][index] += value * qdd[j]
    for (i, j, m), element in _sums(algebra.velocity, variables).items():
        for index, value in element.items():
            rows[i][index] += value * qd[j] * qd[m] * (1 if j == m else 2)
    for (j,), element in _sums(algebra.gravity, variables).items():
        for index, value in element.items():
            rows[j][index] += value
    return rows


@pytest.mark.parametrize("robot", _ROBOTS)
def test_columns_are_those_of_the_tables(robot: jc.Manipulator) -> None:
    """Every base parameter's column of the regressor, with no rounding anywhere."""
    algebra = derive_algebra(robot, "numeric")
    state = _State(algebra)
    units = algebra.unit_inertias
    bodies = [(unit.link, unit.body) for unit in units]
    rows = state.recursion(algebra).columns(bodies, state.qd, state.qdd)
    for column, unit in enumerate(units):
        rows[unit.link][column] += unit.motor * state.qdd[unit.link]
    assert rows == _table_regressor(algebra, state)


@pytest.mark.parametrize("robot", _ROBOTS)
def test_the_parts_agree(robot: jc.Manipulator) -> None:
    """Torque is M qdd + its value at qdd = 0, and gravity's is that at rest, for any bodies."""
    algebra = derive_algebra(robot, "numeric")
    state, draw = _State(algebra), random.Random(1)
    recursion, n = state.recursion(algebra), robot.joint_count
    bodies = [[fmpq(draw.randrange(-9, 9), 7) for _ in range(10)] for _ in range(n)]
    motors = [fmpq(draw.randrange(9), 5) for _ in range(n)]
    still = [0] * n
    mass = recursion.mass_matrix(bodies, motors)
    assert mass == [list(column) for column in zip(*mass, strict=True)]
    bias = recursion.torque(bodies, motors, state.qd, still)
    moved = [
        sum(x * y for x, y in zip(row, state.qdd, strict=True)) + offset
        for row, offset in zip(mass, bias, strict=True)
    ]
    assert recursion.torque(bodies, motors, state.qd, state.qdd) == moved
