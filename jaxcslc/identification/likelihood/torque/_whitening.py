import dataclasses

import numpy as np
import scipy
from jaxtyping import Bool, Float

from ..band import JointColumns


# With a longer filter, one equation would hold two reversals of a joint.
MOST_ORDER = 2
# Reflection coefficients are at most this: noise of longer memory is an offset of the recording.
_MOST = 0.98
# An impulse has faded after so many equations.
_LONG = 2000
# Residuals count as no larger than this, in robust standard deviations.
_OUTLIER = 4.0


@dataclasses.dataclass(frozen=True)
class Whitening:
    """The filter that turns torque residuals of each joint into white noise.

    Residuals r are autoregressive, r(t) + a₁ r(t-1) + ... = w(t), with w white. What a model lacks,
    as the vibration of a transmission, has a spectrum of its own; in w all frequencies count by how
    large residuals are there.

    **Attributes**

    - `coefficients`: (order, n): a₁ and following of each joint; zeros leave residuals as they are.

    >>> import numpy as np
    >>> whitening = Whitening(np.array([[-0.5]]))
    >>> whitening.applied(np.array([[1.0], [0.5], [0.25]]))[:, 0].tolist()
    [1.0, 0.0, 0.0]
    >>> whitening.removed(np.array([[1.0], [0.0], [0.0]]))[:, 0].tolist()
    [1.0, 0.5, 0.25]
    """

    coefficients: Float[np.ndarray, "order joints"]

    @property
    def order(self) -> int:
        """How many earlier residuals count."""
        return len(self.coefficients)

    @property
    def drifting(self) -> tuple[int, ...]:
        """Joints, from 1, whose noise has a memory as long as any that is allowed.

        >>> Whitening(np.array([[-0.6, -0.98, -1.6], [0.0, 0.0, 0.9]])).drifting
        (2,)
        """
        least = (1.0 - 1e-6) * _MOST
        a = np.vstack([self.coefficients, np.zeros_like(self.coefficients[:1])])[:MOST_ORDER]
        if len(a) < MOST_ORDER:
            return ()
        reflections = np.stack([a[0] / (1.0 + a[1]), a[1]])
        return tuple(
            int(joint) + 1 for joint in np.flatnonzero(np.any(abs(reflections) > least, 0))
        )

    def applied(
        self, values: Float[np.ndarray, "equations joints *columns"]
    ) -> Float[np.ndarray, "equations joints *columns"]:
        """Values of all equations, filtered in time; before the first there are zeros."""
        result = values
        for lag, row in enumerate(self.coefficients, start=1):
            if lag == 1:
                result = values.copy()
            result[lag:] += row.reshape(-1, *(1,) * (values.ndim - 2)) * values[:-lag]
        return result

    def of_columns(self, derivatives: JointColumns) -> JointColumns:
        """Derivatives of filtered values."""
        of_entry = Whitening(self.coefficients[:, derivatives.joints])
        return dataclasses.replace(derivatives, values=of_entry.applied(derivatives.values))

    def removed(
        self, white: Float[np.ndarray, "equations joints"]
    ) -> Float[np.ndarray, "equations joints"]:
        """The values whose filtered ones these are."""
        if not self.order:
            return white
        columns = [
            scipy.signal.lfilter([1.0], np.append(1.0, row), values)
            for row, values in zip(self.coefficients.T, white.T, strict=True)
        ]
        return np.stack(columns, axis=1)

    @property
    def deviation(self) -> Float[np.ndarray, " joints"]:
        """(n,) standard deviation of residuals whose filtered ones have one of 1.

        >>> import numpy as np
        >>> Whitening(np.array([[-0.6]])).deviation.round(3).tolist()
        [1.25]
        """
        impulse = np.zeros((_LONG, self.coefficients.shape[1]))
        impulse[0] = 1.0
        return np.sqrt(np.sum(self.removed(impulse) ** 2, axis=0))

    def stencil(
        self, by_position: Float[np.ndarray, "equations joints three"]
    ) -> Float[np.ndarray, "equations joints positions"]:
        """Derivatives by the positions at `order` samples before the three of an equation, too."""
        n, order = by_position.shape[1], self.order
        if not order:
            return by_position
        result = np.zeros((*by_position.shape[:2], (order + 3) * n))
        result[:, :, order * n :] = by_position
        for lag, row in enumerate(self.coefficients, start=1):
            columns = slice((order - lag) * n, (order - lag + 3) * n)
            result[lag:, :, columns] += row[:, None] * by_position[:-lag]
        return result

    def by_turn(
        self, derivatives: Float[np.ndarray, "three reversals"], joints: np.ndarray
    ) -> Float[np.ndarray, "rows reversals"]:
        """Of equations from the one before a reversal's to `order` after the next one's."""
        result = np.zeros((3 + self.order, derivatives.shape[1]))
        result[:3] = derivatives
        for lag, row in enumerate(self.coefficients, start=1):
            result[lag : lag + 3] += row[joints] * derivatives
        return result

    def variance(
        self, extra: Float[np.ndarray, "equations joints"]
    ) -> Float[np.ndarray, "equations joints"]:
        """Of filtered values, where some values have a variance beside that of their noise."""
        result = extra.copy()
        for lag, row in enumerate(self.coefficients, start=1):
            result[lag:] += row**2 * extra[:-lag]
        return result

    def touched(
        self, mask: Bool[np.ndarray, "equations joints"]
    ) -> Bool[np.ndarray, "equations joints"]:
        """Filtered values that a masked one, or one before the first, is in."""
        result = mask.copy()
        for lag in range(1, self.order + 1):
            result[lag:] |= mask[:-lag]
            result[:lag] = True
        return result

    @classmethod
    def fitted(
        cls,
        covariance: Float[np.ndarray, "lags joints"],
    ) -> "Whitening":
        """The filter of noise with these autocovariances, at lags from 0 on (Levinson, Durbin)."""
        order = len(covariance) - 1
        result = np.zeros((order, covariance.shape[1]))
        for joint, of_lag in enumerate(covariance.T):
            a, error = np.ones(1), float(of_lag[0])
            for lag in range(1, order + 1):
                reflection = -float(a @ of_lag[lag:0:-1]) / error if error > 0.0 else 0.0
                reflection = float(np.clip(reflection, -_MOST, _MOST))
                longer = np.append(a, 0.0)
                a = longer + reflection * longer[::-1]
                error *= 1.0 - reflection**2
            result[:, joint] = a[1:]
        return cls(result)


def autocovariance(
    values: Float[np.ndarray, "equations joints"],
    counted: Bool[np.ndarray, "equations joints"],
    lags: int,
) -> Float[np.ndarray, "lags joints"]:
    """Mean products of counted values with those so many equations before; outliers are cut."""
    size = np.where(counted, np.abs(values), np.nan)
    some = counted.any(axis=0)
    middle = np.zeros(values.shape[1])
    middle[some] = np.nanmedian(size[:, some], axis=0)
    most = _OUTLIER * 1.4826 * np.maximum(middle, 1e-300)
    cut = np.where(counted, np.clip(values, -most, most), 0.0)
    result = np.zeros((lags + 1, values.shape[1]))
    for lag in range(lags + 1):
        pairs = counted[lag:] & counted[: len(counted) - lag]
        products = cut[lag:] * cut[: len(cut) - lag]
        result[lag] = products.sum(axis=0) / np.maximum(pairs.sum(axis=0), 1)
    return result
