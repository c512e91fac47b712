import equinox as eqx
import jax
import numpy as np
from numpy.testing import assert_allclose

import jaxcslc as jc
from jaxcslc.report import predicted_torque, torque_errors


def random_patterns(network: jc.CSLC, rng: np.random.Generator, samples: int = 50) -> jc.Patterns:
    q, qd, qdd, torque = rng.normal(size=(4, samples, network.joint_count))
    return jc.Patterns(
        np.arange(float(samples)), q, qd, qdd, torque, rng.random(q.shape) < 0.7, qd > -1
    )


def test_error_table_against_a_literal_loop(
    puma: jc.CSLC, puma_k: jax.Array, rng: np.random.Generator
) -> None:
    """Section 7.5's words, pattern by pattern and joint by joint."""
    patterns = random_patterns(puma, rng)
    table = jc.compare(puma, patterns, {"true": puma_k, "none": 0 * puma_k})
    for row, k in enumerate((puma_k, 0 * puma_k)):
        torque = np.asarray(puma.torque(k, patterns.q, patterns.qd, patterns.qdd))
        moduli: list[list[float]] = [[] for _ in range(6)]
        costs = []
        for sample in range(patterns.samples):
            squares = []
            for joint in range(6):
                if patterns.mask[sample, joint]:
                    error = float(patterns.torque[sample, joint]) - torque[sample, joint]
                    moduli[joint].append(abs(error))
                    squares.append(error**2)
            if squares:
                costs.append(0.5 * np.sqrt(np.mean(squares)))
        assert_allclose(table.mean_modulus[row], [np.mean(m) for m in moduli], rtol=1e-12)
        rms = [np.sqrt(np.mean(np.square(m))) for m in moduli]
        assert_allclose(table.rms[row], rms, rtol=1e-12)
        assert_allclose(table.epsilon[row], np.mean(costs), rtol=1e-12)


def test_thesis_cost_of_one_pattern(puma: jc.CSLC, puma_k: jax.Array) -> None:
    """Half the root mean square over six joints: errors of 1 N m each cost 0.5 N m."""
    still, everything = np.zeros((1, 6)), np.ones((1, 6), bool)
    torque = np.asarray(puma.torque(puma_k, still, still, still)) + 1.0
    patterns = jc.Patterns(np.zeros(1), still, still, still, torque, everything, everything)
    assert_allclose(jc.compare(puma, patterns, {"k": puma_k}).epsilon, [0.5], rtol=1e-12)


def test_friction_regression_is_the_best_for_those_rigid_coefficients(
    puma: jc.CSLC, puma_k: jax.Array, rng: np.random.Generator
) -> None:
    """Eqn. 7.6-1: no other friction leaves a smaller sum of squares over the pairs that count."""
    patterns = random_patterns(puma, rng)
    best = jc.regress_friction(puma, patterns, puma_k)
    rigid, friction = puma.layout.inertial, puma.layout.friction
    assert_allclose(best[rigid], puma_k[rigid])

    def cost(k: jax.Array) -> float:
        kept = np.where(patterns.mask, torque_errors(puma, patterns, k), 0.0)
        return float(np.sum(kept**2))

    # The cost is quadratic, so that central differences are its derivatives but for rounding.
    for i in np.arange(puma.size)[friction]:
        ahead, behind = (cost(best.at[i].add(step)) for step in (0.1, -0.1))
        assert abs(ahead - behind) / 0.2 < 1e-9 * cost(best)
    for _ in range(5):
        assert cost(best.at[friction].add(0.1 * rng.normal(size=12))) > cost(best)


def test_under_jit(puma: jc.CSLC, puma_k: jax.Array, rng: np.random.Generator) -> None:
    patterns = random_patterns(puma, rng)
    jitted = eqx.filter_jit(lambda p, k: jc.compare(puma, p, {"k": k}).epsilon)
    assert_allclose(
        jitted(patterns, puma_k), jc.compare(puma, patterns, {"k": puma_k}).epsilon, rtol=1e-12
    )


def test_prints_the_thesis_table(
    puma: jc.CSLC, puma_k: jax.Array, rng: np.random.Generator
) -> None:
    table = jc.compare(puma, random_patterns(puma, rng), {"Ar+LS": puma_k, "CSLC": 0 * puma_k})
    lines = str(table).splitlines()
    assert lines[0].split() == ["[N", "m]", "Ar+LS", "CSLC"]
    assert [line.split("|")[1] for line in lines[1:7]] == [f"e{i}" for i in range(1, 7)]
    assert lines[7].startswith("mean ε")


def test_errors_are_measured_minus_predicted(
    puma: jc.CSLC, puma_k: jax.Array, rng: np.random.Generator
) -> None:
    patterns = random_patterns(puma, rng)
    expected = patterns.torque - np.asarray(predicted_torque(puma, patterns, puma_k))
    assert_allclose(torque_errors(puma, patterns, puma_k), expected)
