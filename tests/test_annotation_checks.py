"""The tests check annotations of shape at run time: each function's first calls, and some later."""

import numpy as np
import pytest
from jaxtyping import TypeCheckError

from jaxcslc.inertia import pseudo_inertia
from sim import Oscillation


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
