"""Candidates of settings that `choose_settings` chooses among."""

import dataclasses
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
    static_fractions,
    uniform_interval,
)
from ._search import SearchAxis


# Each family covers pass bands from about 2 to 50 Hz at 2 ms, in steps of about √2.
_SPACINGS = (5, 7, 9, 13, 17, 25, 35, 49, 69, 97, 137)
_SMOOTHING_CUTOFFS = (45.0, 32.0, 22.0, 16.0, 11.0, 8.0, 5.6, 4.0, 2.8, 2.0)
_WINDOWS = (9, 13, 17, 25, 35, 49, 69, 97, 137, 193)
_CUTOFFS = (30.0, 15.0, 8.0, 4.0)
_THRESHOLD_FRACTIONS = (0.01, DEFAULT_THRESHOLD_FRACTION, 0.1)


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
        """The default candidates without those that a recording or a network cannot use.

        Filters need uniform time and a sampling rate well above their cut-off; splines need some
        twenty knots, windows twenty times their length. Joints with a term of static friction
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
            cutoffs=(None, *(f for f in _CUTOFFS if 4.0 * f < rate)),
        )

    def keeping(self, settings: Settings) -> "Candidates":
        """The candidates with masks, weights and filter as in settings.

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
        """The smoothings, an axis of the search for each family."""
        return tuple(
            SearchAxis(
                tuple(family),
                lambda settings: settings.preparation.smoothing,
                lambda settings, smoothing: settings.with_options(smoothing=smoothing),
            )
            for _, family in groupby(self.smoothings, key=type)
        )

    def options(self) -> tuple[SearchAxis, ...]:
        """All other options, an axis of the search each."""

        def of_preparation(name: str, values: tuple[Any, ...]) -> SearchAxis:
            return SearchAxis(
                values,
                lambda settings: getattr(settings.preparation, name),
                lambda settings, value: settings.with_options(**{name: value}),
            )

        def of_solver(name: str, values: tuple[Any, ...]) -> SearchAxis:
            return SearchAxis(
                values,
                lambda settings: getattr(settings.solver, name),
                lambda settings, value: settings.with_options(**{name: value}),
            )

        return (
            of_preparation("velocity", self.velocities),
            of_preparation("torque_alignment", self.torque_alignments),
            of_preparation("torque_lag", self.torque_lags),
            of_preparation("threshold_fraction", self.threshold_fractions),
            of_solver("cutoff", self.cutoffs),
            of_solver("joint_weights", self.joint_weights),
        )
