"""Base class of smoothing methods, and their names in files of settings.

Methods are in `_splines` and `_filters`.
"""

import abc
import dataclasses
from collections.abc import Callable, Mapping
from typing import Any, TypeAlias, TypeVar

import equinox as eqx
import numpy as np
from jaxtyping import Float

from .._field_types import check_field_types


Derivatives: TypeAlias = tuple[
    Float[np.ndarray, "samples joints"],
    Float[np.ndarray, "samples joints"],
    Float[np.ndarray, "samples joints"],
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
    def smooth(
        self, time: Float[np.ndarray, " samples"], position: Float[np.ndarray, "samples joints"]
    ) -> Derivatives:
        """Smooth and differentiate positions.

        **Arguments**

        - `time`: instants of the samples, shape `(samples,)` [s].
        - `position`: joint positions, shape `(samples, joints)` [rad or m].

        **Returns**

        `q`, `qd`, `qdd`, each of shape `(samples, joints)`.

        **Raises**

        - `ValueError`: too few samples, or time that the method cannot use.
        """

    @abc.abstractmethod
    def low_pass(
        self, time: Float[np.ndarray, " samples"], signal: Float[np.ndarray, "samples joints"]
    ) -> Float[np.ndarray, "samples joints"]:
        """Smooth a signal that is no position, such as a torque, by the same filter.

        **Arguments**

        - `time`: instants of the samples, shape `(samples,)` [s].
        - `signal`: shape `(samples, joints)`.

        **Returns**

        The smoothed signal, shape `(samples, joints)`.
        """

    @abc.abstractmethod
    def reach(self, interval: float, joints: int) -> int:
        """The number of samples to either side that a smoothed sample depends on.

        `Preparation` drops as many samples at both ends of a recording.

        **Arguments**

        - `interval`: between samples [s].
        - `joints`: how many joints there are.

        **Returns**

        The number of samples, 0 or more.
        """

    def settled(self, position: Float[np.ndarray, "samples joints"]) -> "AbstractSmoothing":
        """Return the smoothing with numbers instead of what it estimates from positions.

        Another motion is then smoothed as this one is. A subclass that estimates nothing from
        positions inherits this method, which returns the smoothing itself.

        **Arguments**

        - `position`: joint positions, shape `(samples, joints)` [rad or m].

        **Returns**

        A smoothing that smooths these positions alike.

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

    **Arguments**

    - `name`: as in `"butterworth"`.

    **Returns**

    A decorator of the class.

    **Raises**

    - `ValueError`: a name that another class has.

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
    """A smoothing as plain data, to be written and read again.

    **Arguments**

    - `smoothing`: of a registered class.

    **Returns**

    Its registered name as `"method"`, and its fields.

    **Raises**

    - `ValueError`: a class that is not registered.

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
    """A smoothing from what `smoothing_document` made, read from JSON or TOML.

    **Arguments**

    - `document`: a mapping.

    **Returns**

    The smoothing.

    **Raises**

    - `ValueError`: an unknown method or wrong fields.

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


def without_rounding(
    position: Float[np.ndarray, "samples joints"], derivatives: Derivatives
) -> Derivatives:
    """Set velocity and acceleration of joints that never move to exactly zero.

    Smoothing leaves rounding of them, whose sign would be taken for a direction of motion.

    **Arguments**

    - `position`: before smoothing, shape `(samples, joints)`.
    - `derivatives`: positions, velocities and accelerations.

    **Returns**

    The derivatives.

    >>> import numpy as np
    >>> still, noise = np.full((3, 1), 0.3), np.full((3, 1), 1e-17)
    >>> bool(np.any(without_rounding(still, (still, noise, noise))[1]))
    False
    """
    q, qd, qdd = derivatives
    moves = np.ptp(position, axis=0) > 1e-12 * np.max(np.abs(position), axis=0)
    return q, np.where(moves, qd, 0.0), np.where(moves, qdd, 0.0)
