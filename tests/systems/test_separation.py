"""Separation of unknown constants from known variables: minimal, exact, and named."""

from functools import cache

import numpy as np
import pytest
import sympy as sp
from sympy.physics.mechanics import dynamicsymbols

from jaxcslc._rank import numerical_rank
from jaxcslc.systems import Constant, DescriptionError, System, Variable


x, y, z, theta = dynamicsymbols("x y z theta")
a, b, c, d = sp.symbols("a b c d")


def system(*equations: sp.Expr | sp.Eq, constants: tuple[Constant, ...] = ()) -> System:
    """Equations in x, y, z, theta and those of a, b, c, d that occur."""
    text = sp.Tuple(*equations)
    described = {constant.symbol for constant in constants}
    others = [Constant(s) for s in (a, b, c, d) if text.has(s) and s not in described]
    variables = tuple(Variable(v) for v in (x, y, z, theta) if text.has(v))
    named = {str(number): equation for number, equation in enumerate(equations, 1)}
    return System("test", named, variables, (*constants, *others))


def expressions(described: System) -> list[str]:
    return [coefficient.expression for coefficient in described.separation.coefficients]


def affine_rank(described: System, rng: np.random.Generator) -> int:
    """How many coefficients the equations need: the rank of what they say of many constants.

    An oracle that knows nothing of polynomials: the unknown side at random states for random
    constants, less that for the first constants. Where an equation has no unknown denominator.
    """
    symbols = described.symbols
    motion = list(symbols.motion.values())
    constants = [symbols.constants[constant.name] for constant in described.unknown]
    residuals = [left - right for left, right in described.numeric.values()]
    function = sp.lambdify([*motion, *constants], residuals, modules="numpy")
    size = 30
    states = rng.uniform(-2.0, 2.0, (len(motion), size, 1))
    values = rng.uniform(0.5, 1.5, (len(constants), 1, size))
    rows = np.concatenate([np.broadcast_to(r, (size, size)) for r in function(*states, *values)])
    return numerical_rank(rows - rows[:, :1])


EQUATIONS = {
    "pendulum": (sp.Eq(y, a * theta.diff().diff() + b * sp.sin(theta) + c * theta.diff()),),
    "shared": (sp.Eq(x, a * b * y + (a + c) * z), sp.Eq(z, 2 * a * b * x.diff() + c * y)),
    "dependent": (sp.Eq(x, (a + b) * y), sp.Eq(y, (a - b) * z), sp.Eq(z, a * x + b * x.diff())),
    "pythagoras": (sp.Eq(x, a * sp.cos(theta) ** 2 + b * sp.sin(theta) ** 2 + c),),
    "double angle": (sp.Eq(x, a * sp.sin(2 * theta) + b * sp.sin(theta) * sp.cos(theta)),),
    "phase": (sp.Eq(x, a * sp.sin(theta + b) + c * sp.cos(theta)),),
    "sum of angles": (sp.Eq(x, a * sp.cos(theta + z) + b * sp.sin(z) * sp.sin(theta)),),
    "modulus": (sp.Eq(x, a * sp.Abs(y) + b * sp.sign(y) + c * y * sp.sign(y)),),
    "greater": (sp.Eq(x, a * sp.Max(y, z) + b * sp.Min(y, z) + c * (y + z)),),
    "root": (sp.Eq(x, a * sp.sqrt(y**2 + 1) + b * (y**2 + 1) ** sp.Rational(3, 2)),),
    "exponential": (sp.Eq(x, a * sp.exp(y + b) + c * sp.exp(2 * y)),),
    "constants below": (sp.Eq(x, y / a + z * b / a + c),),
    "ratio": (sp.Eq(x, a / (a + b) * y + b / (a + b) * z),),
    "variables below": (sp.Eq(x, (a * y + b) / (1 + y**2) + a * y**2 / (1 + y**2)),),
    "pieces": (sp.Eq(x, sp.Piecewise((a * y, y > 0), (b * y, True)) + c * sp.Abs(y)),),
    "known part": (sp.Eq(x, (a + 2) * y + (3 - a) * z),),
    "numbers": (sp.Eq(x, 0.5 * a * y + 1.25 * b * y + a * z * 0.1 + 0.25 * b * z),),
}


@cache
def example(name: str) -> System:
    return system(*EQUATIONS[name])


@pytest.mark.parametrize("name", EQUATIONS)
def test_as_few_coefficients_as_the_equations_need(name: str, rng: np.random.Generator) -> None:
    described = example(name)
    separation = described.separation
    assert len(separation.coefficients) == affine_rank(described, rng)


@pytest.mark.parametrize("name", EQUATIONS)
def test_separated_sides_are_the_equation(name: str, rng: np.random.Generator) -> None:
    described = example(name)
    separation = described.separation
    constants = {constant.name: float(rng.uniform(0.5, 1.5)) for constant in described.unknown}
    k = separation.values(constants)
    motion = list(described.symbols.motion.values())
    states = rng.uniform(-2.0, 2.0, (len(motion), 8))
    known = {described.symbols.constants[n]: value for n, value in constants.items()}
    expected = sp.lambdify(
        motion, [(left - right).subs(known) for left, right in described.numeric.values()], "numpy"
    )(*states)
    separated = [
        side - sum(float(value) * entry for value, entry in zip(k, row, strict=True))
        for side, row in zip(separation.known, separation.regressor, strict=True)
    ]
    np.testing.assert_allclose(
        np.stack([np.broadcast_to(r, 8) for r in sp.lambdify(motion, separated, "numpy")(*states)]),
        np.stack([np.broadcast_to(r, 8) for r in expected]),
        rtol=1e-12,
        atol=1e-12,
    )


def test_coefficients_are_named_and_carry_units_and_signs() -> None:
    described = system(
        sp.Eq(y, a * b * x.diff().diff() + c * x.diff() - d * x),
        constants=(
            Constant(a, "kg", sign="positive"),
            Constant(b, "m", sign="positive"),
            Constant(c, "N s/m"),
            Constant(d, "N/m", sign="negative"),
        ),
    )
    rows = {
        row.name: (row.expression, row.unit, row.positive)
        for row in described.separation.coefficients
    }
    assert rows == {
        "k1": ("-d", "N/m", True),
        "k2": ("a*b", "kg m", True),
        "c": ("c", "N s/m", False),
    }


def test_constants_that_cannot_be_told_apart_are_named() -> None:
    described = system(
        sp.Eq(x, a * b * y + c * z + (d - d) * y + d * sp.Integer(0) + d * z - d * z)
    )
    verdicts = {row.constant: row.verdict for row in described.separation.identifiability}
    assert verdicts == {
        "a": "only in combinations",
        "b": "only in combinations",
        "c": "alone",
    }


def test_a_constant_that_cancels_is_named() -> None:
    described = system(sp.Eq(x + d * sp.sin(theta) ** 2, a * y + d - d * sp.cos(theta) ** 2))
    assert expressions(described) == ["a"]
    assert "constant 'd': not at all, it cancels from every equation" in str(described)


FAULTS = {
    "unknown name 'w'; expected a variable": lambda: system(sp.Eq(x, a * y + sp.Symbol("w"))),
    "not polynomial in the constant b, in sin": lambda: system(sp.Eq(x, a * sp.sin(b * y))),
    "not polynomial in the constant a, in y**a": lambda: system(sp.Eq(x, y**a)),
    "any multiple of a solution is one": lambda: system(sp.Eq(0, a * y + b * x)),
    "constant 'd' is in no equation": lambda: system(sp.Eq(x, a * y), constants=(Constant(d),)),
    "derivative 3 of 'y'": lambda: system(sp.Eq(x, a * y.diff().diff().diff())),
    "is always true": lambda: system(sp.Eq(x, x), constants=()),
    "no equation depends on an unknown constant": lambda: system(
        sp.Eq(x, a * y), constants=(Constant(a, value=1.0),)
    ),
}


@pytest.mark.parametrize("message", FAULTS)
def test_bad_input_is_one_clear_line(message: str) -> None:
    with pytest.raises(DescriptionError) as error:
        _ = FAULTS[message]().network
    assert message in str(error.value)
    assert "\n" not in str(error.value)
