import dataclasses
from typing import Literal

from ..motion import (
    AbstractSmoothing,
    AveragedSplines,
    Recording,
    TorqueAlignment,
    uniform_interval,
)


_SPACINGS = (5, 7, 9, 13, 17, 25, 35, 49, 69, 97, 137)
_CUTOFFS = (30.0, 15.0, 8.0, 4.0)


@dataclasses.dataclass(frozen=True)
class Candidates:
    """The settings that `choose_settings` chooses among, a tuple for each kind.

    Every combination is a candidate. Except for the torque alignments, each tuple is in order:
    the search climbs along it from neighbour to neighbour. Steps of about √2 in a spacing and of
    2 in a cut-off are as fine as a recording can tell apart.

    **Attributes** are named after those of `Settings`.

    **Raises**

    - `ValueError`: an empty tuple.

    >>> import jaxcslc as jc
    >>> jc.Candidates(smoothings=(jc.Butterworth(10.0), jc.Butterworth(20.0))).cutoffs
    (None, 30.0, 15.0, 8.0, 4.0)
    """

    smoothings: tuple[AbstractSmoothing, ...] = tuple(AveragedSplines(j) for j in _SPACINGS)
    torque_alignments: tuple[TorqueAlignment, ...] = ("sample", "mean", "previous")
    torque_lags: tuple[float, ...] = (0.0,)
    threshold_fractions: tuple[float, ...] = (0.01, 0.03, 0.1)
    cutoffs: tuple[float | None, ...] = (None, *_CUTOFFS)
    joint_weights: tuple[Literal["equal", "residual"], ...] = ("residual", "equal")

    def __post_init__(self) -> None:
        for field in dataclasses.fields(self):
            if not getattr(self, field.name):
                raise ValueError(f"no candidates for {field.name}; expected one or more")

    @classmethod
    def suited_to(cls, recording: Recording) -> "Candidates":
        """The default candidates without those that a recording cannot use.

        A filter needs uniform time and a sampling rate well above its cut-off; splines need some
        twenty knots.
        """
        try:
            rate = 1.0 / uniform_interval(recording.time)
        except ValueError:
            rate = 0.0
        spacings = [j for j in _SPACINGS if 20 * j <= recording.samples]
        return cls(
            smoothings=tuple(AveragedSplines(j) for j in spacings or _SPACINGS[:1]),
            cutoffs=(None, *(f for f in _CUTOFFS if 4.0 * f < rate)),
        )
