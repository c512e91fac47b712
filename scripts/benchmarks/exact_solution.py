"""Least-squares solutions of rows in float64 without rounding, to judge factorisations by."""

from collections.abc import Sequence

import flint
import numpy as np

import jaxcslc as jc


# Bits: products of rows with a condition number of 10^8 leave more than a hundred digits.
_PRECISION = 400


def exact_coefficients(network: jc.CSLC, motion: Sequence[np.ndarray]) -> np.ndarray:
    """The coefficients that minimise squares, (p,), by normal equations in numbers of 400 bits.

    Columns are those that the network computes in float64 by NumPy. One second for 10,000 patterns.

    **Arguments**

    - `motion`: q, qd, qdd (samples, m), torque (samples, n); what follows is not looked at.

    **Raises** `ZeroDivisionError` if the coefficients are not determined.
    """
    columns = network.columns(*(np.asarray(x).T for x in motion[:3]))
    p = network.size
    precision, flint.ctx.prec = flint.ctx.prec, _PRECISION
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
