"""Coefficients are as few as equations need: in every worked example, and in random systems.

Needed are as many as the rank of what the equations say at random states for random constants,
which knows nothing of separation.
"""

import numpy as np
import pytest

from scripts.studies.systems.example import Example
from scripts.studies.systems.minimal_sets import (
    EXAMPLES,
    example_system,
    random_system,
    ranks_of,
)


@pytest.mark.parametrize("example", EXAMPLES, ids=lambda example: example.name)
def test_sets_of_examples_are_minimal(example: Example, rng: np.random.Generator) -> None:
    assert ranks_of(example_system(example), rng, example.truth).agree


def test_sets_of_random_systems_are_minimal(rng: np.random.Generator) -> None:
    """Four of the hundred that the script draws."""
    for _ in range(4):
        assert ranks_of(random_system(rng), rng).agree
