"""Expressions are computed once, and mean what was written."""

import math
from typing import Any

import jax
import jax.numpy as jnp
import numpy as np
import pytest
from hypothesis import given, settings, strategies as st

from jaxcslc.codegen import (
    Expressions,
    Motion,
    Program,
    Value,
    derivatives,
)
from jaxcslc.network import nested


def value(graph: Expressions, index: int, inputs: dict[str, float]) -> float:
    """A second interpreter."""
    operation = graph.operations[index]
    arguments = [value(graph, i, inputs) for i in operation.arguments]
    match operation.name:
        case "input":
            return inputs[operation.text]
        case "constant":
            return operation.number
        case "add":
            return arguments[0] + arguments[1]
        case "subtract":
            return arguments[0] - arguments[1]
        case "multiply":
            return arguments[0] * arguments[1]
        case "negate":
            return -arguments[0]
        case name:
            return float(getattr(math, name)(arguments[0]))


# A tree of sums, differences and products over two inputs and small numbers.
_LEAVES = st.one_of(st.sampled_from(["x", "y"]), st.integers(-2, 2).map(float))
_TREES = st.recursive(
    _LEAVES, lambda inner: st.tuples(st.sampled_from("+-*"), inner, inner), max_leaves=12
)


def built(graph: Expressions, tree: Any) -> Value:
    if isinstance(tree, str):
        return graph.input(tree)
    if isinstance(tree, float):
        return graph.constant(tree)
    first, second = built(graph, tree[1]), built(graph, tree[2])
    return {"+": first + second, "-": first - second, "*": first * second}[tree[0]]


def meant(tree: Any, inputs: dict[str, float]) -> float:
    if isinstance(tree, str):
        return inputs[tree]
    if isinstance(tree, float):
        return tree
    first, second = meant(tree[1], inputs), meant(tree[2], inputs)
    return {"+": first + second, "-": first - second, "*": first * second}[tree[0]]


@settings(max_examples=200, deadline=None)
@given(_TREES)
def test_simplifying_keeps_the_value(tree: Any) -> None:
    graph, inputs = Expressions(), {"x": 3.0, "y": 5.0}  # small integers: no rounding
    assert value(graph, built(graph, tree).index, inputs) == meant(tree, inputs)


@settings(max_examples=100, deadline=None)
@given(_TREES)
def test_nothing_trivial_is_left(tree: Any) -> None:
    """No operation with 0 or 1, none on two constants, no sign that another could take."""
    graph = Expressions()
    built(graph, tree)
    for operation in graph.operations:
        arguments = [graph.operations[i] for i in operation.arguments]
        constants = [a.number for a in arguments if a.name == "constant"]
        if operation.name in ("add", "subtract", "multiply"):
            assert len(constants) < 2 and 0.0 not in constants
            assert all(a.name != "negate" for a in arguments)
        if operation.name == "multiply":
            assert 1.0 not in constants
        if operation.name == "negate":
            assert arguments[0].name not in ("negate",)


def test_equal_expressions_are_one() -> None:
    graph = Expressions()
    x, y = graph.input("x"), graph.input("y")
    assert (x * y + 1).index == (1 + y * x).index
    assert (x - y).index == (-(y - x)).index
    assert ((x + y) - y).index == x.index and (x - (x - y)).index == y.index
    assert (2.0 * (x * 3.0)).index == (x * 6.0).index
    assert (x + x).index == (2 * x).index
    assert (0.0 * graph.apply("sin", x)).is_zero


def test_cost_counts_what_is_needed_once() -> None:
    graph = Expressions()
    x = graph.input("x")
    square = x * x
    assert graph.cost([square + 1, -square]) == 2


def test_nested_polynomials(rng: np.random.Generator) -> None:
    """Against the sum of monomials."""
    graph = Expressions()
    inputs = {"x": 0.7, "y": -1.3, "z": 0.4}
    variables = [graph.input(name) for name in inputs]
    polynomial = {
        tuple(int(p) for p in rng.integers(0, 4, 3)): float(rng.normal()) for _ in range(20)
    }
    expected = sum(
        factor * float(np.prod(np.array(list(inputs.values())) ** np.array(powers)))
        for powers, factor in polynomial.items()
    )
    result = value(graph, nested(graph, polynomial, variables).index, inputs)
    assert math.isclose(result, expected, rel_tol=1e-12)
    assert nested(graph, {}, variables).is_zero


@pytest.mark.parametrize("exponent", range(8))
@pytest.mark.parametrize("x", [-1.5, 2.0])
def test_whole_powers_and_quotients(exponent: int, x: float) -> None:
    graph = Expressions()
    result = graph.input("x") ** exponent / 4.0
    assert value(graph, result.index, {"x": x}) == pytest.approx(x**exponent / 4.0)
    assert graph.cost([result]) <= 6  # repeated squaring


def test_what_c_code_cannot_compute_is_named() -> None:
    x = Expressions().input("x")
    with pytest.raises(TypeError, match=r"whole powers from 0 on only, got 0\.5"):
        x**0.5  # pyright: ignore
    with pytest.raises(TypeError, match="divides by numbers only"):
        x / x  # pyright: ignore


@pytest.mark.parametrize("x", [0.7, -0.4])
def test_derivatives_are_those_of_jax(x: float) -> None:
    motion = Motion(1)
    graph, variable = motion.graph, motion.q[0]

    def of_graph(name: str) -> Value:
        inner = variable * variable + 0.5 if name in ("sqrt", "reciprocal") else variable - 0.1
        return graph.apply(name, inner) * variable - graph.apply(name, inner * 2.0)

    def of_jax(name: str, x: jax.Array) -> jax.Array:
        functions = {
            "fabs": jnp.abs,
            "positive": lambda x: jnp.maximum(x, 0.0),
            "negative": lambda x: jnp.minimum(x, 0.0),
        }
        function = functions.get(name) or getattr(jnp, name)
        inner = x * x + 0.5 if name in ("sqrt", "reciprocal") else x - 0.1
        return function(inner) * x - function(inner * 2.0)

    names = ["sin", "cos", "exp", "tanh", "sqrt", "reciprocal", "fabs"]
    names += ["sign", "positive", "negative"]
    slopes = derivatives([of_graph(name) for name in names], variable)
    at = np.array([[x]])
    obtained = Program.of(motion, slopes)(at, 0.0 * at, 0.0 * at)
    expected = [jax.grad(lambda x, name=name: of_jax(name, x))(x) for name in names]
    np.testing.assert_allclose(obtained[:, 0], expected, atol=1e-12)
