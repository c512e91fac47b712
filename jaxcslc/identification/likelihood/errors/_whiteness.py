"""Whether residuals are white, by an information matrix test."""

import dataclasses

import numpy as np
import scipy
from jaxtyping import Bool, Float

from ...solver import CosineSums


# How often white residuals are taken for correlated ones: intervals of 95 % are then no less right.
_LEVEL = 0.05
# A fit that leaves less of the noise than this part has as good as no residuals.
_LEAST_LEFT = 0.05


@dataclasses.dataclass(frozen=True)
class Whiteness:
    """Whether the slow parts of scores are as large as those of white noise of the assumed levels.

    Scores are products of rows and residuals; what they sum up to is the error of a fit. Of white
    noise, cosine components of scores are independent, and their squares in units of the
    information add up to a chi-squared variable. Unlike correlations of residuals themselves, these
    have little to do with what positions take up of quick noise.

    **Attributes**

    - `components`: how many of the lowest were looked at.
    - `ratio`: of the sum of squares of all coefficients together to what white noise has.
    - `degrees_of_freedom`: of that sum.
    """

    components: int
    ratio: float
    degrees_of_freedom: float

    @classmethod
    def of(
        cls,
        sums: CosineSums,
        inverse: Float[np.ndarray, "border border"],
        gram: Float[np.ndarray, "border border"],
        components: int,
    ) -> "Whiteness":
        """Test a fit.

        **Arguments**

        - `sums`: of rows and scores, of so many `components`.
        - `inverse`: of the information, in units of the border's scale.
        - `gram`: variance of the sum of scores were residuals white, `RowSums.noise`.
        """
        values, grams = np.asarray(sums.sums), np.asarray(sums.grams)
        square = float(np.sum((values @ inverse) * values))
        # A fit takes a part off each component, the more the more it looks like columns.
        before = float(np.sum(inverse * np.asarray(sums.power)))
        bent = inverse @ grams
        taken = float(np.sum(bent * np.swapaxes(bent, 1, 2)))
        spread = inverse @ gram
        total = float(np.trace(spread))
        expected = components * total * max(1.0 - taken / before, _LEAST_LEFT)
        count = components * total**2 / float(np.sum(spread * spread.T))
        return cls(components, square / expected, count)

    def white(self) -> bool:
        """Return whether white noise explains all coefficients together."""
        return self.ratio <= _most(self.degrees_of_freedom)

    def exceeds(self, ratio: Float[np.ndarray, " border"]) -> Bool[np.ndarray, " border"]:
        """Return which variances of the sandwich over the bound's are more than chance."""
        return ratio > _most(float(self.components))


def _most(count: float) -> float:
    """Return the mean square of so many standard normal variables that is seldom exceeded."""
    return float(scipy.special.chdtri(count, _LEVEL) / count)
