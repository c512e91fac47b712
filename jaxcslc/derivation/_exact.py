"""Rational numbers for decimals, and rational points of the unit circle for angles."""

import math
from fractions import Fraction

from flint import fmpq


# Angles this close to a multiple of 90 degrees are taken as exactly that [rad].
_RIGHT_ANGLE_TOLERANCE = 1e-9
# A rational t = tan(angle / 2) of this denominator moves the angle by less than 1e-15 rad. (The
# nearest fraction of a *bounded* denominator does not: beside a simple fraction there is a gap.)
_TANGENT_DENOMINATOR = 2**52


def exact_number(value: float):
    """The rational that the shortest decimal of a float says: 0.4318 is 4318/10000.

    >>> exact_number(0.25)
    1/4
    """
    fraction = Fraction(repr(float(value)))
    return fmpq(fraction.numerator, fraction.denominator)


def exact_cos_sin(angle: float):
    """Cosine and sine of an angle [rad] as a rational point of the unit circle.

    Multiples of 90° are exact. Any other angle is replaced by the nearby one whose half has a
    rational tangent t: ((1 - t²) / (1 + t²), 2 t / (1 + t²)), so that cos² + sin² = 1 holds
    exactly and the algebra sees a true rotation; it differs from the given one by less than
    1e-15 rad.

    >>> exact_cos_sin(-math.pi / 2)
    (0, -1)
    """
    quarter_turns = round(angle / (math.pi / 2))
    if abs(angle - quarter_turns * (math.pi / 2)) < _RIGHT_ANGLE_TOLERANCE:
        cos, sin = ((1, 0), (0, 1), (-1, 0), (0, -1))[quarter_turns % 4]
        return fmpq(cos), fmpq(sin)
    remainder = angle - quarter_turns * (math.pi / 2)
    t = fmpq(round(math.tan(remainder / 2) * _TANGENT_DENOMINATOR), _TANGENT_DENOMINATOR)
    cos, sin = (1 - t * t) / (1 + t * t), 2 * t / (1 + t * t)
    for _ in range(quarter_turns % 4):
        cos, sin = -sin, cos
    return cos, sin
