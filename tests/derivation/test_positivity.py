"""Positive by construction (thesis 5.2.3): true of every possible body."""

from collections.abc import Callable
from typing import Any

import numpy as np
import pytest
import sympy

import jaxcslc
from jaxcslc.derivation import Algebra, derive_algebra
from jaxcslc.manipulator import LinkParameters, Manipulator


BODIES = 20_000


@pytest.fixture(scope="module")
def algebra() -> Algebra:
    return derive_algebra(jaxcslc.puma560(), "symbolic")


def bodies(rng: np.random.Generator) -> dict[str, np.ndarray]:
    """Values of every symbol of Appendix B for random possible PUMAs of random lengths.

    Principal moments obey the triangle inequality: every moment is a sum of two second moments.
    Bodies, lengths and motors have independent sizes, over two decades, or one would hide the
    others.
    """

    def sizes(*shape: int) -> np.ndarray:
        return 10.0 ** rng.uniform(-2, 0, (*shape, BODIES))

    values: dict[str, np.ndarray] = {}
    for i in range(1, 7):
        values |= {f"m{i}": sizes(), f"Im{i}": sizes()}
        for axis in "xyz":
            values[f"r{axis}{i}"] = sizes() * rng.choice([-1, 1], BODIES)
        x, y, z = sizes(3) ** 2
        values |= {f"Ixx{i}": y + z, f"Iyy{i}": x + z, f"Izz{i}": x + y}
    values["Iyy6"] = values["Ixx6"]
    for name in ("a2", "a3", "d2", "d3", "d4"):
        values[name] = sizes() * rng.choice([-1, 1], BODIES)
    values["g"] = np.full(BODIES, 9.81)
    return values


def evaluate(expression: str, values: dict[str, np.ndarray]) -> np.ndarray:
    symbolic: Any = sympy.parse_expr(expression.replace("^", "**"))
    names = sorted(str(symbol) for symbol in symbolic.free_symbols)
    return np.asarray(sympy.lambdify(names, symbolic)(*(values[name] for name in names)))


def test_those_of_the_thesis_are_found(algebra: Algebra, appendix_b: dict[str, Any]) -> None:
    positive = {coefficient.name for coefficient in algebra.coefficients if coefficient.positive}
    assert set(appendix_b["positive_by_construction"]) == {"kM4", "kM6", "kM9", "kM11"}
    # The thesis names sums of moments; complete squares such as m4 (rz4 + d4)² are found too.
    assert positive == {
        *("kM4", "kM6", "kM9", "kM11"),
        *("kM13", "kM16", "kM22", "kM23", "kM25", "kM26"),
    }


def test_exactly_those_are_positive_for_every_body(
    algebra: Algebra, rng: np.random.Generator
) -> None:
    values = bodies(rng)
    always = {
        coefficient.name
        for coefficient in algebra.coefficients
        if np.all(evaluate(coefficient.expression, values) > 0)
    }
    assert always == {
        coefficient.name for coefficient in algebra.coefficients if coefficient.positive
    }


@pytest.mark.parametrize("form", ["full", "principal"])
@pytest.mark.parametrize("lengths", ["symbolic", "numeric"])
@pytest.mark.parametrize("kinds", ["RRR", "PRR", "RPR"])
def test_holds_for_other_arms(
    rng: np.random.Generator,
    random_links: Callable[..., tuple[LinkParameters, ...]],
    form: Any,
    lengths: Any,
    kinds: str,
) -> None:
    rows = [("pi/2", 0.3, -0.2, 0.0), ("-pi/2", -0.4, 0.1, 0.3), (0.0, 0.5, 0.2, 0.0)]
    robot = Manipulator.from_modified_dh(rows, kinds=kinds, inertia=form, friction=())
    network = jaxcslc.derive(robot, lengths=lengths)
    positive = [coefficient.positive for coefficient in network.coefficients]
    assert any(positive)
    for _ in range(50):
        links = random_links(rng, 3, principal=form == "principal")
        k = np.asarray(network.coefficients_from(links))
        assert np.all(k[positive] > 0)
