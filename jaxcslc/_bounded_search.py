"""Minimum of many functions of one variable at once, each within bounds."""

from collections.abc import Callable

import numpy as np
from jaxtyping import Float, Int


_GOLDEN = 0.5 * (3.0 - np.sqrt(5.0))
# A minimum shows in a function's values to the root of their rounding.
_ROUNDING = np.sqrt(2.2e-16)
# Sections shrink by two fifths at least, every other step: more would be a function of NaN.
_STEPS = 500

Lanes = Float[np.ndarray, " functions"]


def bounded_minima(
    function: Callable[[Lanes, Int[np.ndarray, " functions"]], Lanes],
    low: Lanes,
    high: Lanes,
    tolerance: Lanes,
) -> Lanes:
    """Find minima of functions of one variable within bounds, by parabolas and golden sections.

    Brent's method (Algorithms for Minimization without Derivatives, 1973, chapter 5) with the steps
    of `scipy.optimize.minimize_scalar(method="bounded")`, for many functions at once: a call for
    each took ten times as long as their arithmetic. `scipy.optimize.elementwise.find_minimum`
    takes two to four times as long (30 reversals of a recording: 5 to 10 ms instead of 2.4), and
    needs points about each minimum.

    **Arguments**

    - `function`: values at some points, of the functions with these indices.
    - `low`, `high`: bounds of each function's variable.
    - `tolerance`: of each minimum, absolute.

    **Returns** the variables.

    >>> import numpy as np
    >>> centres, ones = np.array([0.3, 0.7]), np.ones(2)
    >>> parabolas = lambda x, functions: (x - centres[functions]) ** 2
    >>> bounded_minima(parabolas, 0.0 * ones, ones, 1e-9 * ones).round(6).tolist()
    [0.3, 0.7]
    """
    a, b = low.copy(), high.copy()
    # The best point, the second best, and what that was before.
    best = a + _GOLDEN * (b - a)
    second, third = best.copy(), best.copy()
    f_best = function(best, np.arange(best.size))
    f_second, f_third = f_best.copy(), f_best.copy()
    step, step_before = np.zeros_like(best), np.zeros_like(best)
    for _ in range(_STEPS):
        middle = 0.5 * (a + b)
        least = _ROUNDING * np.abs(best) + tolerance / 3.0
        running = np.flatnonzero(np.abs(best - middle) > 2.0 * least - 0.5 * (b - a))
        if not running.size:
            break
        i = running
        # The parabola through the three points, unless it leads out of the bounds or its steps do
        # not halve.
        r = (best - second)[i] * (f_best - f_third)[i]
        q = (best - third)[i] * (f_best - f_second)[i]
        p = (best - third)[i] * q - (best - second)[i] * r
        q = 2.0 * (q - r)
        p, q = np.where(q > 0.0, -p, p), np.abs(q)
        tried = np.abs(step_before[i]) > least[i]
        parabolic = tried & (np.abs(p) < np.abs(0.5 * q * step_before[i]))
        parabolic &= (p > q * (a - best)[i]) & (p < q * (b - best)[i])
        towards = np.where(best[i] >= middle[i], (a - best)[i], (b - best)[i])
        change = np.divide(p, q, out=_GOLDEN * towards, where=parabolic)
        x = best[i] + change
        near_end = parabolic & (np.minimum(x - a[i], b[i] - x) < 2.0 * least[i])
        inwards = np.where(middle[i] >= best[i], least[i], -least[i])
        change = np.where(near_end, inwards, change)
        step_before[i] = np.where(parabolic, step[i], towards)
        step[i] = change
        x = best[i] + np.where(change >= 0.0, 1.0, -1.0) * np.maximum(np.abs(change), least[i])
        f = function(x, i)

        better, ahead = f <= f_best[i], x >= best[i]
        # The bound that gives way: on the far side of the worse of the two points.
        worse = np.where(better, best[i], x)
        a[i] = np.where(better == ahead, worse, a[i])
        b[i] = np.where(better == ahead, b[i], worse)
        to_second = ~better & ((f <= f_second[i]) | (second[i] == best[i]))
        to_third = ~better & ~to_second
        to_third &= (f <= f_third[i]) | (third[i] == best[i]) | (third[i] == second[i])
        moved = better | to_second
        third[i] = np.where(moved, second[i], np.where(to_third, x, third[i]))
        f_third[i] = np.where(moved, f_second[i], np.where(to_third, f, f_third[i]))
        second[i] = np.where(better, best[i], np.where(to_second, x, second[i]))
        f_second[i] = np.where(better, f_best[i], np.where(to_second, f, f_second[i]))
        best[i], f_best[i] = np.where(better, x, best[i]), np.where(better, f, f_best[i])
    return best
