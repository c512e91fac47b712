"""Smoothing methods, and their names in files of settings.

Central differences, Butterworth, and Savitzky and Golay; the thesis's own method is in `_splines`.
"""

import abc
import dataclasses
from collections.abc import Callable, Mapping
from functools import lru_cache
from typing import Any, TypeAlias, TypeVar

import equinox as eqx
import numpy as np
from jaxtyping import Float

from .._plain_data import check_field_types
from ._low_pass import zero_phase
from ._recording import Samples, Signals
from ._sampling import uniform_interval


Derivatives: TypeAlias = tuple[
    Signals,
    Signals,
    Signals,
]
"""Positions, velocities and accelerations, each of shape `(samples, joints)`."""


class AbstractSmoothing(eqx.Module):
    """Smooths and differentiates sampled positions.

    A subclass states everything that the rest of the package needs to know of it: how it
    smooths, how far it reaches and how it is described. `register_smoothing` gives it a name, so
    that settings with it can be saved and loaded.

    >>> import numpy as np, jaxcslc as jc
    >>> from jaxcslc.recordings import CentralDifferences, register_smoothing
    >>> @register_smoothing("moving_average")
    ... class MovingAverage(jc.recordings.AbstractSmoothing):
    ...     width: int = 5
    ...
    ...     def smooth(self, time, position):
    ...         return CentralDifferences().smooth(time, self.low_pass(time, position))
    ...
    ...     def low_pass(self, time, signal):
    ...         kernel = np.ones(self.width) / self.width
    ...         return np.stack([np.convolve(x, kernel, "same") for x in signal.T], axis=1)
    ...
    ...     def reach(self, interval, joints):
    ...         return self.width // 2 + 2
    ...
    ...     @property
    ...     def description(self):
    ...         return f"moving average of {self.width} samples"
    >>> print(jc.Preparation(MovingAverage(7), thresholds=0.1))
    moving average of 7 samples, velocities from positions, torque of 'sample', thresholds 0.1
    """

    @abc.abstractmethod
    def smooth(self, time: Samples, position: Signals) -> Derivatives:
        """Return positions, velocities and accelerations, each of shape `(samples, joints)`.

        **Arguments**

        - `time`: instants of the samples, shape `(samples,)` [s].
        - `position`: joint positions, shape `(samples, joints)` [rad or m].

        **Raises** `ValueError`: too few samples, or time that the method cannot use.
        """

    @abc.abstractmethod
    def low_pass(self, time: Samples, signal: Signals) -> Signals:
        """Smooth a signal that is no position, such as a torque, by the same filter."""

    @abc.abstractmethod
    def reach(self, interval: float, joints: int) -> int:
        """Return the number of samples to either side that a smoothed sample depends on.

        `Preparation` drops as many samples at both ends of a recording.

        **Arguments**

        - `interval`: between samples [s].
        - `joints`: how many joints there are.
        """

    def settled(self, position: Signals) -> "AbstractSmoothing":
        """Return the smoothing with numbers instead of what it estimates from positions.

        Another motion is then smoothed as this one is. A subclass that estimates nothing from
        positions inherits this method, which returns the smoothing itself.

        >>> import numpy as np
        >>> from jaxcslc.recordings import AveragedSplines, Butterworth
        >>> counts = np.round(1e4 * np.sin(np.arange(500.0) / 50.0))[:, None] / 1e4
        >>> round(AveragedSplines(9).settled(counts).tolerance[0], 5)
        0.00034
        >>> Butterworth(20.0).settled(counts)
        Butterworth(cutoff=20.0)
        """
        del position
        return self

    @property
    @abc.abstractmethod
    def description(self) -> str:
        """A phrase for people, as in "Butterworth at 20 Hz"."""


_Smoothing = TypeVar("_Smoothing", bound=type[AbstractSmoothing])
_REGISTERED: dict[str, type[AbstractSmoothing]] = {}


def register_smoothing(name: str) -> Callable[[_Smoothing], _Smoothing]:
    """Give a class of smoothing the name that stands for it in files of settings.

    The fields of the class are written beside the name: numbers, words, flags, None, or tuples of
    them.

    **Raises** `ValueError`: a name that another class has.

    >>> from jaxcslc.recordings import Butterworth, register_smoothing
    >>> register_smoothing("butterworth")(Butterworth) is Butterworth
    True
    """

    def register(smoothing: _Smoothing) -> _Smoothing:
        other = _REGISTERED.get(name)
        # A class that is defined again, as in a notebook, replaces its earlier self.
        if other is not None and other.__qualname__ != smoothing.__qualname__:
            raise ValueError(f"the smoothing {name!r} is {other.__qualname__}; expected a new name")
        _REGISTERED[name] = smoothing
        return smoothing

    return register


def smoothing_document(smoothing: AbstractSmoothing) -> dict[str, Any]:
    """Return a smoothing as plain data: its registered name as `"method"`, and its fields.

    **Raises** `ValueError`: a class that is not registered.

    >>> import jaxcslc as jc
    >>> from jaxcslc.recordings import smoothing_document
    >>> smoothing_document(jc.Butterworth(20.0))
    {'method': 'butterworth', 'cutoff': 20.0, 'order': 4}
    """
    for name, registered in _REGISTERED.items():
        if registered is type(smoothing):
            fields = (field.name for field in dataclasses.fields(smoothing))
            return {"method": name, **{field: getattr(smoothing, field) for field in fields}}
    raise ValueError(
        f"{type(smoothing).__name__} has no name in a file;"
        " expected a class decorated by jaxcslc.recordings.register_smoothing"
    )


def smoothing_from(document: Any) -> AbstractSmoothing:
    """Return a smoothing from what `smoothing_document` made, read from JSON or TOML.

    **Raises** `ValueError`: an unknown method or wrong fields.

    >>> from jaxcslc.recordings import smoothing_from
    >>> smoothing_from({"method": "averaged_splines", "spacing": [9, 17]}).spacing
    (9, 17)
    """
    method = document.get("method") if isinstance(document, Mapping) else None
    if not isinstance(method, str) or method not in _REGISTERED:
        raise ValueError(
            f"settings, smoothing: expected a method out of {', '.join(_REGISTERED)},"
            f" got {document!r}"
        )
    fields: dict[str, Any] = {
        str(name): tuple(value) if isinstance(value, list) else value
        for name, value in document.items()
        if name != "method"
    }
    check_field_types(_REGISTERED[method], fields, "settings, smoothing")
    try:
        return _REGISTERED[method](**fields)
    except TypeError as error:
        raise ValueError(f"settings, smoothing: {error}") from None


def without_rounding(position: Signals, derivatives: Derivatives) -> Derivatives:
    """Set velocity and acceleration of joints that never move to exactly zero.

    Smoothing leaves rounding of them, whose sign would be taken for a direction of motion.
    `position` is before smoothing, shape `(samples, joints)`.

    >>> import numpy as np
    >>> still, noise = np.full((3, 1), 0.3), np.full((3, 1), 1e-17)
    >>> bool(np.any(without_rounding(still, (still, noise, noise))[1]))
    False
    """
    q, qd, qdd = derivatives
    moves = np.ptp(position, axis=0) > 1e-12 * np.max(np.abs(position), axis=0)
    return q, np.where(moves, qd, 0.0), np.where(moves, qdd, 0.0)


@register_smoothing("central_differences")
class CentralDifferences(AbstractSmoothing):
    """Plain differences of neighbouring samples (thesis, Eqns 7.2-1 and 7.2-2).

    No smoothing at all: of positions in steps of d, the accelerations are in steps of
    d / (4 interval²). Here to be compared with, and for positions without noise.

    >>> import numpy as np
    >>> from jaxcslc.recordings import CentralDifferences
    >>> time = np.arange(7.0)
    >>> q, qd, qdd = CentralDifferences().smooth(time, (time**2)[:, None])
    >>> qd[3, 0], qdd[3, 0]
    (np.float64(6.0), np.float64(2.0))
    """

    def smooth(self, time: Samples, position: Signals) -> Derivatives:
        interval = uniform_interval(time)
        velocity = np.gradient(position, interval, axis=0, edge_order=2)
        return position, velocity, np.gradient(velocity, interval, axis=0, edge_order=2)

    def low_pass(self, time: Samples, signal: Signals) -> Signals:
        del time
        return signal

    def reach(self, interval: float, joints: int) -> int:
        del interval, joints
        return 2

    @property
    def description(self) -> str:
        return "central differences"


@register_smoothing("butterworth")
class Butterworth(AbstractSmoothing):
    """The field's usual way: a zero-phase Butterworth filter, then central differences.

    The filter runs over the record forwards and backwards, so it delays nothing and its
    magnitude counts twice: at the cut-off it passes half, not 0.71.

    Time must be uniform; see `resample`.

    **Attributes**

    - `cutoff`: of the filter [Hz].
    - `order`: of one of its two passes.

    >>> import numpy as np
    >>> from jaxcslc.recordings import Butterworth
    >>> time = np.arange(1000) * 0.002
    >>> position = 1e-4 * np.round(np.sin(2 * np.pi * time) / 1e-4)[:, None]
    >>> q, qd, qdd = Butterworth(cutoff=20.0).smooth(time, position)
    >>> error = qdd[:, 0] + (2 * np.pi) ** 2 * np.sin(2 * np.pi * time)
    >>> bool(np.max(np.abs(error[100:-100])) < 0.5)
    True
    """

    cutoff: float
    order: int = 4

    def __check_init__(self):
        if not self.cutoff > 0.0:
            raise ValueError(f"cut-off is {self.cutoff} Hz; expected more than 0")
        if self.order < 1:
            raise ValueError(f"filter order is {self.order}; expected 1 or more")

    def smooth(self, time: Samples, position: Signals) -> Derivatives:
        return CentralDifferences().smooth(time, self.low_pass(time, position))

    def low_pass(self, time: Samples, signal: Signals) -> Signals:
        return zero_phase(signal, uniform_interval(time), cutoff=self.cutoff, order=self.order)

    def reach(self, interval: float, joints: int) -> int:
        del joints
        return int(np.ceil(0.5 / (self.cutoff * interval)))

    @property
    def description(self) -> str:
        order = "" if self.order == 4 else f" of order {self.order}"
        return f"Butterworth{order} at {self.cutoff:g} Hz"


@register_smoothing("savitzky_golay")
class SavitzkyGolay(AbstractSmoothing):
    """Derivatives of polynomials fitted to the samples around each (Savitzky and Golay, 1964).

    A polynomial is fitted by least squares to a window that moves along the record; its value and
    derivatives in the middle are those of the sample there. Within half a window of an end of the
    record, they are those of the polynomial of the last whole window. As the window is symmetric,
    nothing is delayed.

    Its acceleration is that of the same polynomial: even orders and the odd ones above them give
    the same position in the middle, odd orders and the even ones below them the same velocity.

    Time must be uniform; see `resample`.

    **Attributes**

    - `window`: how many samples a polynomial is fitted to, an odd number.
    - `order`: of the polynomials, 2 or more and less than `window`.

    >>> import numpy as np
    >>> from jaxcslc.recordings import SavitzkyGolay
    >>> time = np.arange(1000) * 0.002
    >>> position = 1e-4 * np.round(np.sin(2 * np.pi * time) / 1e-4)[:, None]
    >>> q, qd, qdd = SavitzkyGolay(window=41).smooth(time, position)
    >>> error = qdd[:, 0] + (2 * np.pi) ** 2 * np.sin(2 * np.pi * time)
    >>> bool(np.max(np.abs(error[20:-20])) < 0.5)
    True
    """

    window: int
    order: int = 3

    def __check_init__(self):
        if self.window < 3 or self.window % 2 == 0:
            raise ValueError(f"window is {self.window} samples; expected an odd number from 3 on")
        if not 2 <= self.order < self.window:
            raise ValueError(
                f"polynomial order is {self.order}; expected at least 2, for there to be an "
                f"acceleration, and less than the window of {self.window} samples"
            )

    def smooth(self, time: Samples, position: Signals) -> Derivatives:
        q, qd, qdd = (self._filter(time, position, derivative) for derivative in range(3))
        return q, qd, qdd

    def low_pass(self, time: Samples, signal: Signals) -> Signals:
        return self._filter(time, signal, 0)

    def reach(self, interval: float, joints: int) -> int:
        del interval, joints
        return self.window // 2

    @property
    def description(self) -> str:
        return f"Savitzky-Golay of {self.window} samples and order {self.order}"

    def _filter(
        self,
        time: Samples,
        signal: Signals,
        derivative: int,
    ) -> Signals:
        interval = uniform_interval(time)
        if time.size < self.window:
            raise ValueError(
                f"{time.size} samples; expected {self.window} or more for a window of as many"
            )
        half = self.window // 2
        weights = _polynomial_weights(self.window, self.order, derivative) / interval**derivative
        filtered = np.empty(signal.shape)
        for smoothed, column in zip(filtered.T, signal.T, strict=True):
            smoothed[half:-half] = np.correlate(column, weights[half], mode="valid")
        filtered[:half] = weights[:half] @ signal[: self.window]
        filtered[-half:] = weights[-half:] @ signal[-self.window :]
        return filtered


@lru_cache(maxsize=64)
def _polynomial_weights(
    window: int, order: int, derivative: int
) -> Float[np.ndarray, "window window"]:
    """Return the weights of a window's samples for a derivative of the polynomial fitted to them.

    Row i gives the derivative at sample i; the interval between samples is 1.
    """
    from numpy.polynomial import legendre

    half = window // 2
    x = np.arange(-half, half + 1) / half
    basis, transform = np.linalg.qr(legendre.legvander(x, order))
    slopes = legendre.legder(np.eye(order + 1), derivative) / half**derivative
    values = legendre.legvander(x, len(slopes) - 1) @ slopes
    weights = values @ np.linalg.solve(transform, basis.T)
    weights.setflags(write=False)
    return weights
