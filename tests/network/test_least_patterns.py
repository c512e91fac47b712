"""The least number of patterns that determine all coefficients, against ranks of random ones.

For the PUMA 560 the thesis says 28 (5.2.5): that is what joint 2 needs alone.
"""

import itertools
from functools import cache

import jax
import numpy as np
import pytest
import sympy
from jaxtyping import Float
from sympy.physics.mechanics import dynamicsymbols

import jaxcslc as jc
from jaxcslc import CSLC, Manipulator
from jaxcslc.network import AbstractLinearNetwork
from jaxcslc.systems import Constant, System, Variable
from tests import arms


RTOL = 1e-10  # ranks are of columns of unit length; the smallest singular values are above 1e-5


def rows_of(
    network: AbstractLinearNetwork, patterns: int, rng: np.random.Generator
) -> Float[np.ndarray, "patterns outputs coefficients"]:
    """The regressor of random motion, as JAX computes it."""
    motion = rng.uniform(-3.0, 3.0, (3, patterns, network.motion_count))
    return np.asarray(network.regressor(*motion))


def rank(rows: Float[np.ndarray, "patterns outputs coefficients"]) -> int:
    matrix = rows.reshape(-1, rows.shape[-1])
    lengths = np.linalg.norm(matrix, axis=0)
    return int(np.linalg.matrix_rank(matrix / np.where(lengths > 0, lengths, 1.0), rtol=RTOL))


def brute_force(network: AbstractLinearNetwork, rng: np.random.Generator) -> int:
    """One pattern after the other until the rank is that of many, the best of ten motions."""
    best = network.size + 1
    for _ in range(10):
        rows = rows_of(network, 2 * network.size, rng)
        ranks = [rank(rows[:n]) for n in range(1, len(rows) + 1)]
        if ranks[-1] == network.size:
            best = min(best, 1 + ranks.index(network.size))
    return best


def test_puma560_needs_8_patterns(puma: CSLC, rng: np.random.Generator) -> None:
    assert puma.order == 28 and puma.least_patterns == 8
    rows = rows_of(puma, 28, rng)
    assert rank(rows[:7]) == 39 and rank(rows[:8]) == puma.size == 43


def test_joint_2_alone_needs_the_order(puma: CSLC, rng: np.random.Generator) -> None:
    rows = rows_of(puma, 28, rng)[:, 1:2, list(puma.support[1])]
    assert rank(rows[:27]) == 27 and rank(rows) == 28


@pytest.mark.parametrize("lengths", ["symbolic", "numeric"])
def test_rank_by_sets_of_joints(lengths: str, rng: np.random.Generator) -> None:
    """N patterns of joints S give at most N |S| rows, and the others at most what they depend on.

    The least sum over all S bounds the rank, and random motion attains it: seven patterns of a
    PUMA 560 lack four because joint 6 depends on four coefficients alone, of which it cannot
    use seven.
    """
    network = jc.derive(jc.puma560(), lengths=lengths)  # type: ignore[arg-type]
    rows, joints = rows_of(network, 2 * network.size, rng), range(6)

    @cache
    def dependent(others: tuple[int, ...]) -> int:
        return rank(rows[:, list(others)]) if others else 0

    for n in range(1, network.least_patterns + 2):
        bound = min(
            n * count + dependent(others)
            for count in range(7)
            for others in itertools.combinations(joints, 6 - count)
        )
        assert rank(rows[:n]) == bound
        assert (bound == network.size) == (n >= network.least_patterns)


@pytest.mark.parametrize("joints", [1, 2, 3, 4])
def test_planar_arms(joints: int, rng: np.random.Generator) -> None:
    rows = [(0.0, 0.0 if i == 0 else 0.4, 0.0, 0.0) for i in range(joints)]
    arm = Manipulator.from_modified_dh(rows, gravity=(0.0, -9.81, 0.0))
    network = jc.derive(arm, lengths="numeric")
    assert network.least_patterns == brute_force(network, rng)
    assert -(-network.size // joints) <= network.least_patterns <= network.order


@pytest.mark.parametrize("kinds", ["PR", "RP", "RPR", "PRP"])
def test_prismatic_joints(kinds: str, rng: np.random.Generator) -> None:
    rows = [(0.5 * np.pi * (i % 2), 0.3 * (i > 0), 0.1, 0.0) for i in range(len(kinds))]
    arm = Manipulator.from_modified_dh(rows, kinds=kinds, gravity=(0.0, 0.0, -9.81))
    network = jc.derive(arm, lengths="numeric")
    assert network.least_patterns == brute_force(network, rng)


def test_without_shared_coefficients_it_is_the_order(rng: np.random.Generator) -> None:
    """Three orthogonal slides without gravity: a mass and two of friction each."""
    rows = [(0.0, 0.0, 0.0, 0.0), (np.pi / 2, 0.0, 0.0, np.pi / 2), (np.pi / 2, 0.0, 0.0, 0.0)]
    slides = Manipulator.from_modified_dh(rows, kinds="PPP", gravity=(0.0, 0.0, 0.0))
    network = jc.derive(slides, lengths="numeric")
    owners = [sum(j in row for row in network.support) for j in range(network.size)]
    assert owners == [1] * 9
    assert network.least_patterns == network.order == brute_force(network, rng) == 3


def test_both_directions_count(rng: np.random.Generator) -> None:
    """Friction of either direction: patterns of one direction alone determine half of it."""
    network = arms.pendulum("asymmetric_viscous", "asymmetric_dry")
    assert network.least_patterns == network.order == network.size == 7
    q, qd, qdd = rng.uniform(0.2, 3.0, (3, 40, 1))
    assert rank(np.asarray(network.regressor(q, qd, qdd))) == 5


def test_dependent_coefficients(puma: CSLC, rng: np.random.Generator) -> None:
    """A payload cannot be told from the link, apart from what symmetry excludes of the link."""
    network = jc.derive(jc.puma560(), lengths="numeric").with_payload()
    assert network.size == 46
    rows = rows_of(network, 46, rng)
    assert rank(rows) == rank(rows[: network.least_patterns]) == 42
    assert rank(rows[: network.least_patterns - 1]) < 42


def two_carts(*, coupled: bool) -> System:
    """Carts whose friction is a law of both, or of each."""
    x, y, u, v = dynamicsymbols("x y u v")
    a, b, c = sympy.symbols("a b c")
    second = a if coupled else c
    equations = {
        "first": sympy.Eq(u, a * x.diff() + b * sympy.log(x) * x.diff().diff()),
        "second": sympy.Eq(v, second * y.diff()),
    }
    constants = [Constant(a), Constant(b), *([] if coupled else [Constant(c)])]
    return System("carts", equations, tuple(map(Variable, (x, y, u, v))), tuple(constants))


@pytest.mark.parametrize(("coupled", "size", "least"), [(True, 2, 1), (False, 3, 2)])
def test_systems(coupled: bool, size: int, least: int) -> None:
    """One pattern determines two coefficients if the second equation gives the first's.

    The logarithm is not real at half of all random motions.
    """
    network = two_carts(coupled=coupled).network
    assert (network.size, network.order, network.least_patterns) == (size, 2, least)


def test_functions_that_are_nowhere_finite() -> None:
    x, u = dynamicsymbols("x u")
    a = sympy.Symbol("a")
    equation = sympy.Eq(u, a * sympy.log(-1 - x**2))
    network = System("nowhere", {"e": equation}, (Variable(x), Variable(u)), (Constant(a),))
    with pytest.raises(ValueError, match="not finite at random motions"):
        _ = network.network.least_patterns


def test_float32_of_networks_that_numpy_does_not_compute() -> None:
    network = two_carts(coupled=True).network
    with jax.enable_x64(False), pytest.raises(ValueError, match="needs float64"):
        _ = network.least_patterns


def test_float32_of_robots() -> None:
    """Columns of robots are NumPy's."""
    with jax.enable_x64(False):
        assert arms.pendulum().least_patterns == 5
