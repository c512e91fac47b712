from collections.abc import Sequence

import flint
import jax
import jax.numpy as jnp
import numpy as np
import pytest

import jaxcslc as jc


Motion = tuple[np.ndarray, np.ndarray, np.ndarray]


@pytest.fixture(scope="session")
def exciting_motion() -> Motion:
    """3,000 random states of six joints: every coefficient shows in them."""
    rng = np.random.default_rng(7)
    q, qd, qdd = rng.uniform(-2.0, 2.0, (3, 3000, 6))
    return q, qd, qdd


ORDINARY = jc.LeastSquares(joint_weights="equal", errors="independent")


def patterns_of(
    network: jc.CSLC, k: jax.Array, motion: Motion, noise: np.ndarray | float = 0.0
) -> jc.Patterns:
    """Patterns whose torque is the network's own, plus `noise`; every pair counts."""
    q, qd, qdd = motion
    torque = np.asarray(network.torque(k, q, qd, qdd)) + noise
    everything = np.ones(q.shape, bool)
    return jc.Patterns(0.01 * np.arange(len(q)), q, qd, qdd, torque, everything, everything)


def exact_coefficients(network: jc.CSLC, motion: Sequence[np.ndarray]) -> np.ndarray:
    """The least-squares solution of rows in float64, by normal equations in numbers of 400 bits.

    - `motion`: q, qd, qdd, torque, and what follows them, which is not looked at.
    """
    columns = network.columns(*(jnp.asarray(x.T) for x in motion[:3]))
    p = network.size
    precision, flint.ctx.prec = flint.ctx.prec, 400
    try:
        gram = [[flint.arb(0)] * (p + 1) for _ in range(p + 1)]
        for support, entries, torque in zip(network.support, columns, motion[3].T, strict=True):
            rows = np.concatenate([np.asarray(entries), torque[None]]).tolist()
            matrix = flint.arb_mat(rows)
            product = matrix * matrix.transpose()
            for i, row in enumerate([*support, p]):
                for j, column in enumerate([*support, p]):
                    gram[row][column] = gram[row][column] + product[i, j]
        normal = flint.arb_mat([row[:p] for row in gram[:p]])
        solution = normal.solve(flint.arb_mat([[row[p]] for row in gram[:p]]))
        return np.array([float(solution[i, 0].mid()) for i in range(p)])
    finally:
        flint.ctx.prec = precision
