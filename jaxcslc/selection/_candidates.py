"""Candidates of settings that `choose_settings` chooses among, and the search along them."""

import dataclasses
from collections.abc import Callable, Sequence
from itertools import groupby
from typing import Any, Literal

from ..least_squares import Settings, static_friction_joints
from ..network import CSLC
from ..recordings import (
    DEFAULT_THRESHOLD_FRACTION,
    AbstractSmoothing,
    AveragedSplines,
    Butterworth,
    Recording,
    SavitzkyGolay,
    TorqueAlignment,
    VelocitySource,
    samples_kept,
    static_fractions,
    uniform_interval,
)


# The search goes over all options this often at most; two rounds are the rule.
_ROUNDS = 4
# Axes with no more values than this are tried in full, longer ones climbed along.
_ALL = 5
# Rounding alone, as between weights of a single joint, is no improvement.
_LEAST_GAIN = 1e-6
# Another family of smoothings must lower the score by a fifth. On simulated arms with white noise
# of 1e-4 rad, a Butterworth filter lowered the score of slow motion by 5 and 14 %, by smoother
# predictions, while the torque errors on faster motion rose to three times those of splines.
_FAMILY_GAIN = 0.2


@dataclasses.dataclass(frozen=True)
class SearchAxis:
    """Option of `Preparation` or `LeastSquares`, and the values that a search tries, in order."""

    option: str
    values: tuple[Any, ...]

    def value_of(self, settings: Settings) -> Any:
        """Read the option off settings."""
        owner = settings.preparation if hasattr(settings.preparation, self.option) else None
        return getattr(settings.solver if owner is None else owner, self.option)

    def replaced(self, settings: Settings, value: Any) -> Settings:
        """Return settings with another value of the option."""
        return settings.with_options(**{self.option: value})

    def middle(self) -> Any:
        """The value in the middle."""
        return self.values[len(self.values) // 2]

    def index(self, settings: Settings) -> int | None:
        """Return the position of settings on the axis, None if they are elsewhere."""
        value = self.value_of(settings)
        return self.values.index(value) if value in self.values else None


@dataclasses.dataclass
class CoordinateSearch:
    """Looks for the settings of the least score, one axis after the other.

    - `scored`: computes the scores of several settings; the least wins.
    - `scores`: all that were computed, each once.
    """

    scored: Callable[[Sequence[Settings]], Sequence[float]]
    scores: dict[Settings, float] = dataclasses.field(default_factory=dict)

    def run(
        self, start: Settings, families: Sequence[SearchAxis], options: Sequence[SearchAxis]
    ) -> Settings:
        """Return the settings of the least score within their family of smoothings.

        The family of smoothings that `start` belongs to is searched together with all options,
        round after round until nothing improves. Then each other family is climbed along with
        the options as they are; if one lowers the score by a fifth, the rounds go on with it.
        """
        best = start
        # Where each family did best, to climb on from there.
        starts = [family.middle() for family in families]
        for _ in range(_ROUNDS):
            current = family_of(families, best)
            best = self._rounds(best, (families[current], *options))
            for number, family in enumerate(families):
                if number != current:
                    other = self._along(family, family.replaced(best, starts[number]))
                    starts[number] = family.value_of(other)
                    best = self._better(best, [other], _FAMILY_GAIN)
            if family_of(families, best) == current:
                break
        return best

    def _rounds(self, best: Settings, axes: Sequence[SearchAxis]) -> Settings:
        for _ in range(_ROUNDS):
            before = best
            for axis in axes:
                best = self._along(axis, best)
            if best == before:
                break
        return best

    def _along(self, axis: SearchAxis, best: Settings) -> Settings:
        """The best settings that are reached along one axis."""
        values, size = axis.values, len(axis.values)
        if size <= _ALL:
            return self._better(best, [axis.replaced(best, value) for value in values])
        for step in (2, 1):
            while True:
                index = axis.index(best)
                assert index is not None
                beside = [i for i in (index - step, index + step) if 0 <= i < size]
                better = self._better(best, [axis.replaced(best, values[i]) for i in beside])
                if better == best:
                    break
                best = better
        return best

    def _better(
        self, best: Settings, others: Sequence[Settings], gain: float = _LEAST_GAIN
    ) -> Settings:
        """The best of some settings; `best` itself if none lowers its score by so large a part."""
        missing = [some for some in dict.fromkeys((*others, best)) if some not in self.scores]
        self.scores |= zip(missing, self.scored(missing), strict=True)
        better = min(others, key=self.scores.__getitem__, default=best)
        improved = self.scores[better] < (1.0 - gain) * self.scores[best]
        return better if improved else best


def family_of(families: Sequence[SearchAxis], settings: Settings) -> int:
    """The number of the family that settings belong to."""
    return next(i for i, family in enumerate(families) if family.index(settings) is not None)


# Each family covers pass bands from about 2 to 50 Hz at 2 ms, in steps of about √2.
_SPACINGS = (5, 7, 9, 13, 17, 25, 35, 49, 69, 97, 137)
_SMOOTHING_CUTOFFS = (45.0, 32.0, 22.0, 16.0, 11.0, 8.0, 5.6, 4.0, 2.8, 2.0)
_WINDOWS = (9, 13, 17, 25, 35, 49, 69, 97, 137, 193)
_CUTOFFS = (30.0, 15.0, 8.0, 4.0)
# Equations a coefficient that a filter leaves at least. As many as coefficients would follow any
# torque.
_EQUATIONS = 3
_THRESHOLD_FRACTIONS = (0.01, DEFAULT_THRESHOLD_FRACTION, 0.1)


def _kept(samples: int, cutoff: float, rate: float) -> int:
    """The number of samples that a parallel filter keeps; 0 without a rate."""
    return len(samples_kept(samples, cutoff, 1.0 / rate)) if rate else 0


@dataclasses.dataclass(frozen=True)
class Candidates:
    """The settings that `choose_settings` chooses among, a tuple for each option.

    Every combination is a candidate. Except for the torque alignments, each tuple is in order:
    the search climbs along it from neighbour to neighbour. Steps of about √2 in a spacing and of
    2 in a cut-off are as fine as a recording can distinguish. The first of the torque alignments
    is the convention that is kept where the recording does not show another one.

    **Attributes**

    - `smoothings`: one or more families, one behind the other: neighbours of one class are a
      family, in order of its strength. The search begins with the first family; another one must
      lower the score by a fifth.
    - `velocities`, `torque_alignments`, `torque_lags`, `threshold_fractions`: as of
      `Preparation`.
    - `cutoffs`, `joint_weights`: as of `LeastSquares`.

    **Raises**

    - `ValueError`: an empty tuple.

    >>> import jaxcslc as jc
    >>> jc.Candidates(smoothings=(jc.Butterworth(10.0), jc.Butterworth(20.0))).cutoffs
    (None, 30.0, 15.0, 8.0, 4.0)
    """

    smoothings: tuple[AbstractSmoothing, ...] = (
        *(AveragedSplines(spacing) for spacing in _SPACINGS),
        *(Butterworth(cutoff) for cutoff in _SMOOTHING_CUTOFFS),
        *(SavitzkyGolay(window) for window in _WINDOWS),
    )
    velocities: tuple[VelocitySource, ...] = ("position",)
    torque_alignments: tuple[TorqueAlignment, ...] = ("mean", "sample", "previous")
    torque_lags: tuple[float, ...] = (0.0,)
    threshold_fractions: tuple[float | tuple[float, ...], ...] = _THRESHOLD_FRACTIONS
    cutoffs: tuple[float | None, ...] = (None, *_CUTOFFS)
    joint_weights: tuple[Literal["equal", "residual"], ...] = ("residual", "equal")

    def __post_init__(self) -> None:
        for field in dataclasses.fields(self):
            if not getattr(self, field.name):
                raise ValueError(f"no candidates for {field.name}; expected one or more")

    @classmethod
    def suited_to(cls, recording: Recording, network: CSLC | None = None) -> "Candidates":
        """Return the default candidates without those that a recording or a network cannot use.

        Filters need uniform time and a sampling rate well above their cut-off, and leave three
        equations a coefficient at least; splines need some twenty knots, windows twenty times
        their length. Joints with a term of static friction
        keep their slow pairs (see `Preparation.with_static_friction`). By convention, torques that
        were measured (`Recording.torque_measured`) belong to their samples; of demands, which a
        drive holds, the mean of the two that meet at a sample does.

        **Arguments**

        - `recording`: with velocities, they are tried.
        - `network`: by default one without static friction.

        **Returns**

        The candidates.
        """
        try:
            rate = 1.0 / uniform_interval(recording.time)
        except ValueError:
            rate = 0.0
        spacings = [j for j in _SPACINGS if 20 * j <= recording.samples]
        cutoffs = [f for f in _SMOOTHING_CUTOFFS if 4.0 * f < rate < f * recording.samples / 20]
        windows = [w for w in _WINDOWS if rate and 20 * w <= recording.samples]
        static = (False,) if network is None else static_friction_joints(network)
        kept = {f: recording.joints * _kept(recording.samples, f, rate) for f in _CUTOFFS}
        least = 0 if network is None else _EQUATIONS * network.size
        return cls(
            smoothings=(
                *(AveragedSplines(j) for j in spacings or _SPACINGS[:1]),
                *map(Butterworth, cutoffs),
                *map(SavitzkyGolay, windows),
            ),
            velocities=("position",) if recording.velocity is None else ("position", "recorded"),
            torque_alignments=("sample", "mean", "previous")
            if recording.torque_measured
            else ("mean", "sample", "previous"),
            threshold_fractions=tuple(
                static_fractions(fraction, static) for fraction in _THRESHOLD_FRACTIONS
            ),
            cutoffs=(None, *(f for f in _CUTOFFS if 4.0 * f < rate and kept[f] >= least)),
        )

    def keeping(self, settings: Settings) -> "Candidates":
        """Return the candidates with masks, weights and filter as in settings.

        For another recording, sampled in another way than that which the settings were chosen
        on: what is left to choose is how to smooth and to align it.

        **Arguments**

        - `settings`: chosen on another recording.

        **Returns**

        The candidates.
        """
        preparation, solver = settings.preparation, settings.solver
        fraction = preparation.threshold_fraction
        return dataclasses.replace(
            self,
            torque_lags=(preparation.torque_lag,),
            threshold_fractions=self.threshold_fractions if fraction is None else (fraction,),
            cutoffs=(solver.cutoff,) if solver.cutoff in self.cutoffs else (None,),
            joint_weights=(solver.joint_weights,),
        )

    def start(self) -> Settings:
        """Return the start of the search: a narrow smoothing of the first family, no filter."""
        first = self.families()[0].values
        return Settings().with_options(
            smoothing=first[min(3, len(first) // 2)],
            velocity=self.velocities[0],
            torque_alignment=self.torque_alignments[0],
            torque_lag=self.torque_lags[len(self.torque_lags) // 2],
            threshold_fraction=self.threshold_fractions[len(self.threshold_fractions) // 2],
            cutoff=self.cutoffs[0],
            joint_weights=self.joint_weights[0],
        )

    def families(self) -> tuple[SearchAxis, ...]:
        """Return the smoothings, an axis of the search for each family."""
        return tuple(
            SearchAxis("smoothing", tuple(family))
            for _, family in groupby(self.smoothings, key=type)
        )

    def options(self) -> tuple[SearchAxis, ...]:
        """Return the other options, an axis of the search each."""
        return (
            SearchAxis("velocity", self.velocities),
            SearchAxis("torque_alignment", self.torque_alignments),
            SearchAxis("torque_lag", self.torque_lags),
            SearchAxis("threshold_fraction", self.threshold_fractions),
            SearchAxis("cutoff", self.cutoffs),
            SearchAxis("joint_weights", self.joint_weights),
        )
