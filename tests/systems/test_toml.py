"""System files, formulas and SymPy's mechanics describe the same systems as Python does."""

import re
from pathlib import Path
from typing import Any

import pytest
import sympy as sp
from sympy.physics.mechanics import (
    KanesMethod,
    LagrangesMethod,
    Particle,
    Point,
    ReferenceFrame,
    dynamicsymbols,
)

from jaxcslc.systems import (
    Constant,
    DescriptionError,
    System,
    Variable,
    lagrange_equations,
    load_system,
    mechanics_equations,
    parse_equation,
)
from jaxcslc.systems._description import parse_unit, unit_product, unit_text
from tests.conftest import run
from tests.systems.conftest import CART


theta, torque = dynamicsymbols("theta torque")
m, l, b, g = sp.symbols("m l b g")
PENDULUM: dict[str, Any] = {
    "variables": (Variable(theta, "rad"), Variable(torque, "N m")),
    "constants": (Constant(m), Constant(l), Constant(b), Constant(g, value=9.81)),
}
BY_HAND = sp.Eq(
    torque, m * l**2 * theta.diff().diff() + b * theta.diff() + m * g * l * sp.sin(theta)
)


def pendulum(kind: str) -> System:
    """A pendulum, derived in one of four ways."""
    if kind == "equation":
        return System("pendulum", {"theta": BY_HAND}, *PENDULUM.values())
    energy = m * l**2 * theta.diff() ** 2 / 2 + m * g * l * sp.cos(theta)
    if kind == "lagrangian":
        dissipation = b * theta.diff() ** 2 / 2
        forces = {theta: torque}
        equations = lagrange_equations(energy, [theta], forces, dissipation)
        return System("pendulum", equations, **PENDULUM)
    frame, origin = ReferenceFrame("N"), Point("O")
    origin.set_vel(frame, 0)
    rotated = frame.orientnew("B", "Axis", (theta, frame.z))
    force = torque - b * theta.diff()
    if kind == "LagrangesMethod":
        method = LagrangesMethod(energy, [theta], [(rotated, force * frame.z)], frame=frame)
        method.form_lagranges_equations()
        return System("pendulum", mechanics_equations(method), **PENDULUM)
    omega = dynamicsymbols("omega")
    rotated.set_ang_vel(frame, omega * frame.z)
    bob = origin.locatenew("P", -l * rotated.y)
    bob.v2pt_theory(origin, frame, rotated)
    loads = [(bob, -m * g * frame.y), (rotated, (torque - b * omega) * frame.z)]
    method = KanesMethod(frame, [theta], [omega], [theta.diff() - omega])
    method.kanes_equations([Particle("bob", bob, m)], loads)
    return System("pendulum", mechanics_equations(method), **PENDULUM)


@pytest.mark.parametrize("kind", ["lagrangian", "LagrangesMethod", "KanesMethod"])
def test_every_way_of_deriving_gives_the_same_equation(kind: str) -> None:
    expected, system = pendulum("equation").separation, pendulum(kind).separation
    assert [c.expression for c in system.coefficients] == [
        c.expression for c in expected.coefficients
    ]
    for one, other in zip(expected.regressor[0], system.regressor[0], strict=True):
        assert sp.simplify(one - other) == 0
    assert system.known == expected.known


FORMULAS = {
    "F = m*ddot(x) + k*x": "m*Derivative(x(t), (t, 2)) + k*x(t)",
    "F = m*dot(x)^2 - -k": "m*Derivative(x(t), t)**2 + k",
    "F = m*sin(pi*x)/2": "m*sin(pi*x(t))/2",
    "F = m*abs(x) + k*sqrt(x)": "m*Abs(x(t)) + k*sqrt(x(t))",
    "F = where(x >= 0, m, k)*x": "Piecewise((m, x(t) >= 0), (k, True))*x(t)",
    "F = m*max(x, 0, k)": "m*Max(0, x(t), k)",
    "F = 0.1*m*exp(-x)": "m*exp(-x(t))/10",
}


@pytest.mark.parametrize("text", FORMULAS)
def test_formulas_are_read(text: str) -> None:
    x, force = dynamicsymbols("x F")
    t = dynamicsymbols._t
    names = {"x": x.func, "t": t, **dict(zip("mk", sp.symbols("m k"), strict=True))}
    expected = sp.sympify(FORMULAS[text], locals=names)
    equation = parse_equation(text, ["x", "F"], ["m", "k"])
    assert equation.lhs == force
    assert sp.simplify(equation.rhs - expected) == 0


WRONG_FORMULAS = {
    "F = m*sen(x)": "unknown function 'sen'; expected one of dot, ddot, sin",
    "F = m*y": "unknown name 'y'; expected a variable (F, x) or a constant (k, m)",
    "F = m*": "cannot read 'm*'",
    "F = m = k": "expected left = right",
    "F = dot(m*x)": "dot of 'm * x'; expected the name of a variable",
    "F = sin(x, x)": "sin of 2 arguments",
    "F = x.real": "cannot read 'x.real'",
    "F = __import__('os')": "cannot read \"'os'\"",
    "F = m*(x > 1)": "comparison 'x > 1' in 'm*(x > 1)'; expected it in where(...)",
    "F = where(pi/0 < x, m, b)": "cannot compare 'pi / 0 < x' in",
    "F = where(sqrt(0-1) < 2, m, b)": "cannot compare 'sqrt(0 - 1) < 2' in",
    "F = where((x > 1) < 2, m, b)": "comparison 'x > 1' in",
    "F = 1e400*m": "cannot read '1e309'",
    "F = where(x, m, k)": "expected a comparison first",
    "F = 9**9**9*k": "'9**9**9*k' is too large when it is multiplied out",
    "F = ((9**300)**300)**300*k": "is too large when it is multiplied out",
    "F = (m + k + x)**500": "'(m + k + x)**500' is too large when it is multiplied out",
    "F = " + "*".join(["(m + k)"] * 30): "is too large when it is multiplied out",
    "F = x**1e9": "is too large when it is multiplied out",
    "F = 1" + "0" * 6000: "Exceeds the limit",
    "F = " + "-" * 9000 + "x": "cannot read",
    "F = " + "-" * 100_000 + "x": "has 100001 characters; expected 10000 at most",
}


@pytest.mark.parametrize("text", WRONG_FORMULAS)
def test_wrong_formulas_are_named(text: str) -> None:
    with pytest.raises(DescriptionError, match=re.escape(WRONG_FORMULAS[text])):
        parse_equation(text, ["x", "F"], ["m", "k"])


WRONG_FILES = {
    "equations missing": (CART.replace("[equations]", "[others]"), "unknown entry 'others'"),
    "equation of a wrong name": (
        CART.replace("damping*dot(x)", "drag*dot(x)"),
        "equation 'rail': unknown name 'drag'; expected a variable (force, x) or a constant",
    ),
    "constant in a function": (
        CART.replace("sign(dot(x))", "tanh(dot(x)/damping)"),
        "equation 'rail': not polynomial in the constant damping, in tanh(dot(x)/damping): give a"
        " value, or bounds to search it within",
    ),
    "constant in no equation": (
        CART.replace("[equations]", "drag = {}\n[equations]"),
        "constant 'drag' is in no equation",
    ),
    "variable in no equation": (
        CART.replace("[constants]", "speed = {}\n[constants]"),
        "variable 'speed' is in no equation",
    ),
    "name": (CART.replace("dry", "lambda"), "name 'lambda': expected letters"),
    "unit": (CART.replace('"kg"', '"k(g)"'), "constant 'mass': unit 'k(g)': cannot read 'k(g)'"),
    "value": (
        CART.replace('unit = "kg"', 'value = "2"'),
        "'mass': value is '2'; expected a number",
    ),
    "entry": (CART.replace('unit = "kg"', "mass = 1"), "'mass': unknown entry 'mass'"),
    "sign": (CART.replace('"positive"', '"plus"'), "constant 'mass': sign is 'plus'"),
    "bounds": (
        CART.replace('unit = "kg"', "bounds = [2.0, 1.0]"),
        "constant 'mass': bounds are [2.0, 1.0]; expected two finite numbers, the lower first",
    ),
    "TOML": (CART + "[", "not valid TOML"),
    "unit of no equation": (CART + 'belt = "N"\n', "units: no equation 'belt'"),
}


@pytest.mark.parametrize("name", WRONG_FILES)
def test_wrong_files_end_in_one_line(name: str, tmp_path: Path) -> None:
    text, message = WRONG_FILES[name]
    path = tmp_path / "cart.toml"
    path.write_text(text, encoding="utf-8")
    with pytest.raises(DescriptionError) as error:
        _ = load_system(path).network
    assert message in str(error.value)
    assert "\n" not in str(error.value)


def test_a_wrong_file_ends_the_command_with_its_name(tmp_path: Path) -> None:
    path = tmp_path / "cart.toml"
    path.write_text(WRONG_FILES["equation of a wrong name"][0], encoding="utf-8")
    result = run("derive", path)
    assert result.exit_code == 2
    assert result.stderr.startswith(f"jaxcslc: {path}: equation 'rail': unknown name 'drag'")


@pytest.mark.parametrize("text", ["kg m²", "N m s/rad", "1/s²", "m³/s", "kg/m/s", ""])
def test_units_are_read_and_printed(text: str) -> None:
    assert unit_text(parse_unit(text)) == text


def test_units_of_products() -> None:
    assert unit_product([("kg", 1), ("m", 2), ("1/s", 2)]) == "kg m²/s²"
    assert unit_product([("N m/rad", 1), ("rad", 1), ("m", -1)]) == "N"
