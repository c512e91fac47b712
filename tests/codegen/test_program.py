"""Programs of NumPy's operations compute what the expressions mean, and what JAX's arrays give."""

from typing import Any

import jax
import numpy as np
import pytest
from hypothesis import given, settings, strategies as st

import jaxcslc as jc
from jaxcslc.codegen import Motion, Program, Value, _programs as program_module


# Sums of products of numbers of the order of ten, in another order.
ROUNDING = 1e-12

_LEAVES = st.one_of(st.sampled_from(["q", "qd", "qdd"]), st.integers(-2, 2).map(float))
_TREES = st.recursive(
    _LEAVES, lambda inner: st.tuples(st.sampled_from("+-*"), inner, inner), max_leaves=12
)


def built(motion: Motion, tree: Any) -> Value:
    if isinstance(tree, str):
        return getattr(motion, tree)[0]
    if isinstance(tree, float):
        return motion.graph.constant(tree)
    first, second = built(motion, tree[1]), built(motion, tree[2])
    return {"+": first + second, "-": first - second, "*": first * second}[tree[0]]


def meant(tree: Any, motion: dict[str, np.ndarray]) -> Any:
    if isinstance(tree, str):
        return motion[tree][0]
    if isinstance(tree, float):
        return np.full(motion["q"].shape[1], tree)
    first, second = meant(tree[1], motion), meant(tree[2], motion)
    return {"+": first + second, "-": first - second, "*": first * second}[tree[0]]


@settings(max_examples=100, deadline=None)
@given(st.lists(_TREES, min_size=1, max_size=6))
def test_registers_keep_what_is_still_read(trees: list[Any]) -> None:
    """Several outputs that share parts, are inputs, constants or each other: small integers, so
    that equality is exact."""
    motion = Motion(1)
    program = Program.of(motion, [built(motion, tree) for tree in trees])
    rows = {"q": np.array([[2.0, -1.0]]), "qd": np.array([[3.0, 0.0]])}
    rows["qdd"] = np.array([[-2.0, 5.0]])
    expected = np.stack([meant(tree, rows) for tree in trees])
    np.testing.assert_array_equal(program(**rows), expected)


@pytest.mark.parametrize("lengths", ["symbolic", "numeric"])
def test_columns_of_numpy_are_those_of_jax(
    lengths: Any, rng: np.random.Generator, monkeypatch: pytest.MonkeyPatch
) -> None:
    """Closed form and recursion, in several blocks and a part of one."""
    monkeypatch.setattr(program_module, "_BLOCK", 16)
    network = jc.derive(jc.puma560(), lengths=lengths)
    motion = rng.normal(size=(3, 6, 40))
    regressor = np.asarray(jax.jit(network.regressor)(*np.swapaxes(motion, 1, 2)))
    for joint, (support, rows) in enumerate(
        zip(network.support, network.columns(*motion), strict=True)
    ):
        expected = regressor[:, joint, list(support)].T
        np.testing.assert_allclose(np.asarray(rows), expected, atol=ROUNDING)


def test_the_precision_is_that_of_the_motion() -> None:
    motion = Motion(1)
    program = Program.of(motion, [motion.graph.apply("cos", motion.q[0]) * 3.0])
    q = np.ones((1, 3), np.float32)
    assert program(q, q, q).dtype == np.float32


def test_operations_reuse_registers() -> None:
    """A chain of any length needs one register between its inputs and its output."""
    motion = Motion(1)
    total = motion.q[0]
    for _ in range(50):
        total = total * total + motion.qd[0]
    program = Program.of(motion, [total])
    assert len(program.steps) == 100
    assert program.registers == 1 + 2 + 1
