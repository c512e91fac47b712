"""The tests check annotations of shape at run time: each function's first calls in a
file, those with arguments of other types and shapes, and some of many."""

import importlib
import sys
from collections.abc import Iterator
from pathlib import Path
from types import ModuleType

import numpy as np
import pytest
from jaxtyping import TypeCheckError, install_import_hook

from jaxcslc.bodies import pseudo_inertia
from sim.trajectory._paths import Oscillation


def test_a_wrong_shape_is_an_error() -> None:
    with pytest.raises(TypeCheckError, match="body"):
        pseudo_inertia(np.zeros(11))
    with pytest.raises(TypeCheckError, match="amplitude"):
        Oscillation(np.zeros(2), np.zeros(3), period=1.0)


def test_also_after_many_right_calls() -> None:
    for _ in range(200):
        pseudo_inertia(np.zeros(10))
    with pytest.raises(TypeCheckError, match="body"):
        for _ in range(100):
            pseudo_inertia(np.zeros(11))


def test_also_arguments_of_another_shape_after_right_calls() -> None:
    for _ in range(10):
        pseudo_inertia(np.zeros(10))
    with pytest.raises(TypeCheckError, match="body"):
        pseudo_inertia(np.zeros(11))


_MODULE = """
import dataclasses
from collections.abc import Callable, Iterator

import numpy as np
from jaxtyping import Float


def scaled(factor: float) -> "Callable[[np.ndarray], np.ndarray]":
    def scale(x: Float[np.ndarray, " n"], *, times: int = 1) -> Float[np.ndarray, " n"]:
        return factor * x if times else x[1:]

    return scale


def nested(x: np.ndarray, depth: int) -> float:
    def inner(x: Float[np.ndarray, " n"]) -> float:
        return float(x.sum()) + (nested(x[:-1], depth - 1) if depth else 0.0)

    return inner(x)


def counted(count: int) -> Iterator[int]:
    def count_up(start: int) -> Iterator[int]:
        yield from range(start, start + count)

    return count_up(5)


def kind(expected: type) -> "Callable[[object], object]":
    def same(x: expected) -> expected:
        return x

    return same


@dataclasses.dataclass(frozen=True)
class Pair:
    a: Float[np.ndarray, " n"]
    b: Float[np.ndarray, " n"]
"""


@pytest.fixture
def checked(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> Iterator[ModuleType]:
    """A module whose annotations are checked as the library's are."""
    (tmp_path / "checked_functions.py").write_text(_MODULE)
    monkeypatch.syspath_prepend(tmp_path)
    with install_import_hook("checked_functions", "beartype.beartype"):
        yield importlib.import_module("checked_functions")
    del sys.modules["checked_functions"]


def test_local_functions_share_their_checks_and_nothing_else(checked: ModuleType) -> None:
    double, triple = checked.scaled(2.0), checked.scaled(3.0)
    np.testing.assert_array_equal(double(np.ones(3)), [2.0, 2.0, 2.0])
    np.testing.assert_array_equal(triple(np.ones(2)), [3.0, 3.0])
    for scale in (double, triple):
        with pytest.raises(TypeCheckError, match="parameters"):
            scale(np.ones((2, 2)))
        np.testing.assert_array_equal(scale(np.zeros(1)), [0.0])
    with pytest.raises(TypeCheckError, match="return value"):
        checked.scaled(1.0)(np.ones(4), times=0)
    with pytest.raises(TypeError, match="argument"):
        double()
    assert checked.nested(np.ones(4), 3) == 4.0 + 3.0 + 2.0 + 1.0
    assert list(checked.counted(3)) == [5, 6, 7] and list(checked.counted(1)) == [5]


def test_local_functions_with_one_code_keep_their_annotations(checked: ModuleType) -> None:
    assert checked.kind(int)(1) == 1
    assert checked.kind(str)("a") == "a"
    with pytest.raises(TypeCheckError):
        checked.kind(str)(1)


def test_fields_are_checked_and_later_those_of_another_shape(checked: ModuleType) -> None:
    for _ in range(10):
        checked.Pair(np.zeros(2), np.zeros(2))
    with pytest.raises(TypeCheckError, match="b"):
        checked.Pair(np.zeros(2), np.zeros(3))
