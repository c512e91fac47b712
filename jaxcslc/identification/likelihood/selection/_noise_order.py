import dataclasses

import numpy as np
import scipy
from jaxtyping import Bool, Float

from .._levels import NoiseDraws
from .._problem import Problem
from ..search import Minimum
from ..torque import MOST_ORDER, TorqueRecord


# The difference of criteria that is evidence enough.
_STRONG = 10.0
# Frequencies of one band: the share of noise that residuals keep is that of a draw in its band.
_BAND = 24
# Residuals count as no larger than this, in robust standard deviations.
_OUTLIER = 4.0
# Logarithms of levels and inverse hyperbolic tangents of reflection coefficients are below these.
_FAR, _STEEP = 12.0, 2.5


@dataclasses.dataclass(frozen=True)
class NoiseOrders:
    """Orders of the autoregression of torque noise, compared after a fit for which it is white.

    Residuals at a minimum are noise less what positions take up of it. A draw of white noise,
    fitted alike, says which share g of the noise residuals keep at each frequency. For noise of
    spectrum S, where it was S₀ in the fit, and noise of positions whose power is c times that of
    the fit, periodograms of residuals have the mean

        g² S + c g (1 - g) S₀

    Whittle's likelihood (1953) of that is maximised over c and over level and coefficients of
    autoregressions of orders 0, 1, 2, joint by joint, and a coefficient costs the logarithm of the
    number of equations (Bayes's information criterion, Schwarz 1978). Equations average recorded
    torques: for each order, noise counts as it is or as such averages, whichever is more likely,
    so that white noise of torques that are held is white.

    Beside counts that are intervals, torque is nearly exact, and its noise is white.

    **Attributes**

    - `criterion`: (orders, n) of each joint, for orders from 0 on, over that of order 0.

    >>> import numpy as np
    >>> from jaxcslc.identification import NoiseOrders
    >>> orders = NoiseOrders(np.array([[0.0, 0.0], [7.0, -31.0], [14.0, -25.0]]))
    >>> orders.by_joint, orders.order
    ((0, 1), 1)
    """

    criterion: Float[np.ndarray, "orders joints"]

    @classmethod
    def of(cls, problem: Problem, minimum: Minimum) -> "NoiseOrders":
        """Of a minimum with white torque noise."""
        part = problem.readings.part
        if minimum.objective.intervals is not None:
            orders = np.arange(MOST_ORDER + 1.0)
            return cls(orders[:, None] * np.log(np.maximum(minimum.counted.sum(axis=0), 1)))
        draws = NoiseDraws.of(
            minimum.linear, minimum.factored, part, minimum.torque_noise, minimum.position_noise
        )
        level = minimum.torque_noise[part[1:-1]]
        least = np.min(problem.least_position_noise / minimum.position_noise, axis=0)
        spectra = averages_of(problem.readings.torque), np.array([1.0])
        columns = []
        for joint in range(level.shape[1]):
            counted = minimum.counted[:, joint]
            residual, kept, drawn = (
                values[:, joint] / level[:, joint]
                for values in (
                    minimum.linear.residuals.torque,
                    draws.by_torque.torque,
                    draws.torque * level,
                )
            )
            values = _criterion(residual, kept, drawn, counted, spectra, float(least[joint]) ** 2)
            columns.append(values)
        return cls(np.stack(columns, axis=1))

    @property
    def by_joint(self) -> tuple[int, ...]:
        """The order of each joint with the least criterion, if the evidence against white noise is
        very strong: a difference of 10 (Kass and Raftery 1995)."""
        strong = self.criterion.min(axis=0) < -_STRONG
        orders = np.where(strong, np.argmin(self.criterion, axis=0), 0)
        return tuple(int(order) for order in orders)

    @property
    def order(self) -> int:
        """The highest order that a joint supports."""
        return max(self.by_joint)


def averages_of(record: TorqueRecord) -> Float[np.ndarray, " lags"]:
    """Autocovariances of equations' torques, over their variance, were recorded ones white noise.

    From what one torque adds to each equation, in the middle of the longest recording; of those
    between two knots, together.
    """
    time = max(record.times, key=len)
    torque = np.zeros((len(time), record.every))
    torque[len(time) // 2 + np.arange(record.every), np.arange(record.every)] = 1.0
    shares = dataclasses.replace(record, times=(time,), torques=(torque,)).averaged()
    covariance = [np.sum(shares[lag:] * shares[: len(shares) - lag]) for lag in range(3)]
    return np.array(covariance) / covariance[0]


def _criterion(
    residual: Float[np.ndarray, " equations"],
    kept: Float[np.ndarray, " equations"],
    drawn: Float[np.ndarray, " equations"],
    counted: Bool[np.ndarray, " equations"],
    covariances: tuple[Float[np.ndarray, " _"], ...],
    least: float,
) -> Float[np.ndarray, " orders"]:
    """Of one joint.

    **Arguments**

    - `residual`: in standard deviations of the noise of the fit.
    - `kept`: what residuals keep of the noise that was `drawn`, in the same unit.
    - `counted`: equations that count.
    - `covariances`: of noise that is white before it is averaged, each from lag 0 on.
    - `least`: power of the noise of positions over that of the fit.
    """
    number = int(counted.sum())
    result = np.zeros(MOST_ORDER + 1)
    if number < 4 * _BAND:
        return result + np.arange(len(result))
    size = np.median(np.abs(residual[counted]))
    most = _OUTLIER * 1.4826 * max(float(size), 1e-300)
    length = len(counted)
    transform = lambda values: np.fft.rfft(np.where(counted, values, 0.0))[1:]
    power = np.abs(transform(np.clip(residual, -most, most))) ** 2 / number
    of_kept, of_drawn = transform(kept), transform(drawn)
    frequency = 2.0 * np.pi * np.arange(1, len(power) + 1) / length
    band = np.arange(len(power)) // _BAND
    sums = lambda values: np.bincount(band, values)
    share = sums((of_kept * of_drawn.conj()).real) / sums(np.abs(of_drawn) ** 2)
    share = np.clip(share, 1e-6, 1.0)[band]
    # Fewer equations than instants count: so many of the periodogram's values are independent.
    independent = number / length
    shapes = [
        np.maximum(1.0 + 2.0 * np.cos(np.outer(frequency, np.arange(1, len(c)))) @ c[1:], 1e-3)
        for c in covariances
    ]

    def value(unknowns: np.ndarray, shape: np.ndarray) -> float:
        level, reflections = np.exp(unknowns[0]), np.tanh(unknowns[2:])
        of_positions = least + np.exp(unknowns[1])
        coefficients = np.ones(1)
        for reflection in reflections:
            longer = np.append(coefficients, 0.0)
            coefficients = longer + reflection * longer[::-1]
        reply = np.exp(-1j * np.outer(frequency, np.arange(len(coefficients)))) @ coefficients
        noise = level * shape / np.abs(reply) ** 2
        mean = np.maximum(share**2 * noise + of_positions * share * (1.0 - share), 1e-9)
        return float(2.0 * independent * np.sum(np.log(mean) + power / mean))

    for order in range(MOST_ORDER + 1):
        bounds = [(-_FAR, _FAR)] * 2 + [(-_STEEP, _STEEP)] * order
        minima = [
            scipy.optimize.minimize(
                value, np.zeros(2 + order), args=(shape,), method="L-BFGS-B", bounds=bounds
            ).fun
            for shape in shapes
        ]
        result[order] = min(minima) + order * np.log(number)
    return result - result[0]
