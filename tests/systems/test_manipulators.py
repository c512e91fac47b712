"""A manipulator written by hand as a system has the coefficients and torques of `derive`.

Its Lagrangian is written in SymPy, link by link from rotation matrices, and shares no code with
`jaxcslc.derivation` but what chooses the simplest forms.
"""

from collections.abc import Sequence
from functools import cache
from typing import Any

import numpy as np
import pytest
import sympy as sp
from sympy.physics.mechanics import dynamicsymbols

import jaxcslc as jc
from jaxcslc.systems import Constant, System, Variable


# Modified Denavit-Hartenberg rows: alpha as multiples of 90°, a, d. The arms' own gravity.
PLANAR_3R = ((0, "0", "0"), (0, "a1", "0"), (0, "a2", "0"))
PUMA_560 = ((0, "0", "0"), (-1, "0", "d2"), (0, "a2", "d3"))
ARMS = {"planar 3R": (PLANAR_3R, 1), "PUMA 560": (PUMA_560, 2)}  # and the axis of gravity
VALUES = {"a1": 0.4, "a2": 0.4318, "d2": 0.2435, "d3": -0.0934, "g": 9.81}
# What two evaluations of a sum of some fifty products differ by, relative to the largest.
ROUNDING = 1e-13


def lagrangian(rows: Sequence[tuple[int, str, str]], gravity: sp.Matrix) -> tuple[Any, list[Any]]:
    """Kinetic less potential energy, principal inertia at centres of gravity, and coordinates.

    Angles of consecutive parallel axes are written as their sum, as in c23.
    """
    q = [dynamicsymbols(f"q{i}") for i in range(1, len(rows) + 1)]
    base, angle = sp.eye(3), sp.Integer(0)  # of the axes that are parallel, and the turn about them
    orientation, origin = sp.eye(3), sp.zeros(3, 1)
    energy = sp.Integer(0)
    for i, ((quarter_turns, a, d), joint) in enumerate(zip(rows, q, strict=True), start=1):
        ca, sa = ((1, 0), (0, 1), (-1, 0), (0, -1))[quarter_turns % 4]
        tilt = sp.Matrix([[1, 0, 0], [0, ca, -sa], [0, sa, ca]])
        shift = sp.Matrix([sp.Symbol(a) if a != "0" else 0, 0, 0])
        along = tilt * sp.Matrix([0, 0, sp.Symbol(d) if d != "0" else 0])
        origin = origin + orientation * (shift + along)
        if quarter_turns:
            base, angle = orientation * tilt, sp.Integer(0)
        angle = angle + joint
        orientation = base * turn(angle)
        spin = orientation.T * orientation.diff(dynamicsymbols._t)
        omega = sp.Matrix([spin[2, 1], spin[0, 2], spin[1, 0]])  # in the link's frame
        mass, motor = sp.Symbol(f"m{i}"), sp.Symbol(f"Im{i}")
        centre = sp.Matrix(sp.symbols(f"rx{i} ry{i} rz{i}"))
        inertia = sp.diag(*sp.symbols(f"Ixx{i} Iyy{i} Izz{i}"))
        position = origin + orientation * centre
        velocity = position.diff(dynamicsymbols._t)
        energy += mass * velocity.dot(velocity) / 2 + omega.dot(inertia * omega) / 2
        energy += motor * joint.diff() ** 2 / 2 + mass * gravity.dot(position)
    return energy, q


def turn(angle: Any) -> sp.Matrix:
    c, s = sp.cos(angle), sp.sin(angle)
    return sp.Matrix([[c, -s, 0], [s, c, 0], [0, 0, 1]])


def written_by_hand(rows: Sequence[tuple[int, str, str]], axis: int) -> System:
    """The arm as a system of unknown lengths, gravity against axis `axis`."""
    down = sp.zeros(3, 1)
    down[axis] = -sp.Symbol("g")
    energy, q = lagrangian(rows, down)
    torques = [dynamicsymbols(f"tau{i}") for i in range(1, len(rows) + 1)]
    kv, kd = (sp.symbols([f"{kind}{i}" for i in range(1, len(q) + 1)]) for kind in ("kv", "kd"))
    friction = [
        tau - v * angle.diff() - d * sp.sign(angle.diff())
        for tau, v, d, angle in zip(torques, kv, kd, q, strict=True)
    ]
    # `lagrange_equations` keeps what is measured on the left: friction is moved to the right.
    equations = {}
    for angle, tau, force in zip(q, torques, friction, strict=True):
        inertia = energy.diff(angle.diff()).diff(dynamicsymbols._t) - energy.diff(angle)
        equations[str(angle.func)] = sp.Eq(tau, inertia + tau - force, evaluate=False)
    names = sorted(
        {s for equation in equations.values() for s in equation.free_symbols} - {dynamicsymbols._t},
        key=str,
    )
    constants = tuple(map(Constant, names))
    return System("arm", equations, tuple(map(Variable, (*q, *torques))), constants)


def derived(rows: Sequence[tuple[int, str, str]], axis: int, lengths: Any) -> jc.CSLC:
    used = {name: VALUES[name] for row in rows for name in row[1:] if name != "0"}
    gravity = tuple(-VALUES["g"] if index == axis else 0.0 for index in range(3))
    robot = jc.Manipulator.from_modified_dh(
        [(np.pi / 2 * t, a if a != "0" else 0, d if d != "0" else 0, 0) for t, a, d in rows],
        gravity=gravity,
        inertia="principal",
        lengths=used,
    )
    return jc.derive(robot, lengths=lengths)


@cache
def symbolic(name: str) -> System:
    return written_by_hand(*ARMS[name])


@cache
def both(name: str, lengths: str) -> tuple[System, jc.CSLC]:
    system = symbolic(name)
    if lengths == "numeric":
        used = {constant.name for constant in system.constants}
        system = system.with_values({k: v for k, v in VALUES.items() if k in used})
    return system, derived(*ARMS[name], lengths)


def link_values(rng: np.random.Generator, joints: int) -> dict[str, float]:
    names = ("m", "rx", "ry", "rz", "Ixx", "Iyy", "Izz", "Im", "kv", "kd")
    return {
        f"{name}{i}": float(rng.uniform(0.2, 1.0)) for name in names for i in range(1, joints + 1)
    }


def network_values(network: jc.CSLC, values: dict[str, float]) -> np.ndarray:
    links = [
        jc.LinkParameters(
            values[f"m{i}"],
            np.array([values[f"r{axis}{i}"] for axis in "xyz"]),
            np.diag([values[f"I{axis}{axis}{i}"] for axis in "xyz"]),
            values[f"Im{i}"],
        )
        for i in range(1, network.joint_count + 1)
    ]
    friction: dict[str, Any] = {
        kind: [values[f"{symbol}{i}"] for i in range(1, network.joint_count + 1)]
        for kind, symbol in (("viscous", "kv"), ("dry", "kd"))
    }
    return np.asarray(network.coefficients_from(links, **friction))


CASES = [("planar 3R", "symbolic"), ("PUMA 560", "symbolic"), ("PUMA 560", "numeric")]


@pytest.mark.parametrize(("name", "lengths"), CASES)
def test_torque_is_that_of_derive(name: str, lengths: str, rng: np.random.Generator) -> None:
    system, network = both(name, lengths)
    values = VALUES | link_values(rng, 3)
    q, qd, qdd = rng.uniform(-2.0, 2.0, (3, 20, 3))
    motion = [np.concatenate([x, np.zeros_like(x)], axis=1) for x in (q, qd, qdd)]
    torque = system.network.torque(system.separation.values(values), *motion)
    expected = np.asarray(network.torque(network_values(network, values), q, qd, qdd))
    np.testing.assert_allclose(torque, expected, atol=ROUNDING * np.abs(expected).max())


@pytest.mark.parametrize(("name", "lengths"), CASES)
def test_coefficients_are_those_of_derive(
    name: str, lengths: str, rng: np.random.Generator
) -> None:
    """As many, spanning the same combinations of link parameters."""
    system, network = both(name, lengths)
    assert system.network.size == network.size
    draws = [VALUES | link_values(rng, 3) for _ in range(3 * network.size)]
    ours = np.array([system.separation.values(values) for values in draws])
    theirs = np.array([network_values(network, values) for values in draws])
    change, *_ = np.linalg.lstsq(theirs, ours)
    np.testing.assert_allclose(theirs @ change, ours, atol=1e-10)


@pytest.mark.parametrize("name", ["planar 3R", "PUMA 560"])
def test_each_symbolic_coefficient_is_one_of_derive(name: str) -> None:
    system, network = both(name, "symbolic")
    ours = [coefficient.expression for coefficient in system.separation.coefficients]
    friction = network.layout.indices("viscous", "dry")
    theirs = [network.coefficients[i].expression for i in range(network.size) if i not in friction]
    with_friction = {sp.Symbol(f"{kind}{i}") for kind in ("kv", "kd") for i in (1, 2, 3)}
    assert {up_to_a_multiple(text) for text in ours} == {
        *map(up_to_a_multiple, theirs),
        *with_friction,
    }


def up_to_a_multiple(text: str) -> Any:
    """An expression as a polynomial whose first coefficient is 1."""
    expression = sp.sympify(text.replace("^", "**"))
    return sp.Poly(expression, *sorted(expression.free_symbols, key=str)).monic().as_expr()


@pytest.mark.parametrize("name", ["planar 3R", "PUMA 560"])
def test_order_is_that_of_derive(name: str) -> None:
    system, network = both(name, "symbolic")
    assert system.network.order_per_joint == network.order_per_joint
