"""Fixtures of the trainings' tests."""

from typing import NamedTuple

import numpy as np
import pytest

from jaxcslc.training import (
    AdaptiveNetwork,
    Examples,
    examples,
    fully_connected,
)


class Problem(NamedTuple):
    network: AdaptiveNetwork
    training_set: Examples
    start: np.ndarray


@pytest.fixture
def line(rng: np.random.Generator) -> Problem:
    """A linear combiner, three inputs and a bias to one node, and noise."""
    network = fully_connected([3, 1], "linear combiner")
    x = rng.normal(size=(20, 3))
    t = x @ [[1.0], [-2.0], [0.5]] + 0.3 + 0.1 * rng.normal(size=(20, 1))
    return Problem(network, examples(network, x, t), np.array([0.1, -0.1, 0.2, 0.1]))
