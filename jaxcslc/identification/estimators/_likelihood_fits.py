import contextlib
import dataclasses
from collections.abc import Callable, Generator, Iterable, Mapping, Sequence
from typing import Any, NamedTuple

from ..._processes import can_fork, function_beside
from ...motion import Recording
from ...network import CSLC
from .._held_out_part import FEWEST_SAMPLES
from .._identify_one import without_lag
from .._settings import Settings
from ..likelihood import LeftOut, LikelihoodFit, MaximumLikelihood
from ..solver import Identification, computed_on_host


class LikelihoodFits(NamedTuple):
    """Fits of maximum likelihood: to `whole` recordings, and to what is `before` the part of each
    that is held out; None where none is."""

    whole: LikelihoodFit
    before: LikelihoodFit | None


def estimator_for(options: MaximumLikelihood, settings: Settings) -> MaximumLikelihood:
    """The estimator with torques and a start as settings have them."""
    sampled = settings.preparation.torque_alignment == "sample"
    return dataclasses.replace(
        options,
        torque_sampling="sampled" if sampled else "held",
        settings=settings.with_options(torque_lag=0.0),
    )


def on_time(settings: Settings, recordings: Iterable[Recording]) -> list[Recording]:
    """Recordings with torques as early as settings say."""
    lag = settings.preparation.torque_lag
    return [without_lag(recording, lag) for recording in recordings]


def fit_before(
    estimator: MaximumLikelihood,
    network: CSLC,
    recordings: Sequence[Recording],
    whole: LikelihoodFit,
    step: Callable[[str], None],
) -> LikelihoodFit:
    """The fit to what is before the parts that are held out: near the fit to everything, whose
    noise levels it has."""
    left_out = LeftOut.of(recordings, whole.every)
    assert left_out is not None  # callers look at the number of samples
    return estimator.fit(network, left_out.early, whole.at(left_out.rows), step)


class FitsBeside:
    """Fits of maximum likelihood in a process beside this one, while least squares are fitted.

    They begin with settings, which both estimators have: `begin`, once; `result` waits for them.
    """

    def __init__(
        self, network: CSLC, function: Callable[[Settings], Callable[[], list[Any]]]
    ) -> None:
        self._network, self._function = network, function
        self._result: Callable[[], list[Any]] | None = None

    def begin(self, settings: Settings) -> None:
        """Begins with the fits."""
        self._result = self._function(settings)

    def result(self) -> LikelihoodFits:
        """**Raises** what the fits have raised, as `MaximumLikelihood.fit`."""
        assert self._result is not None
        whole, before = (_with_network(self._network, fields) for fields in self._result())
        assert whole is not None
        return LikelihoodFits(whole, before)


@contextlib.contextmanager
def fits_beside(
    network: CSLC,
    training: Mapping[str, Recording],
    options: MaximumLikelihood,
    *,
    held_out: bool,
    allowed: bool,
) -> Generator[FitsBeside | None]:
    """Fits that need nothing but settings; None where they are not possible beside this process.

    With static friction alone: a fit without it starts from least squares.

    **Arguments**

    - `training`: by name.
    - `held_out`: whether a part of each is held out; `allowed`: False is never.
    """
    recordings = list(training.values())
    independent = "static" in network.robot.friction_terms and can_fork()
    if not (allowed and independent and computed_on_host(network, recordings[0].position)):
        yield None
        return
    held_out &= min(recording.samples for recording in recordings) >= FEWEST_SAMPLES

    def fitted(settings: Settings) -> list[Any]:
        estimator, late = estimator_for(options, settings), on_time(settings, recordings)
        whole = estimator.fit(network, late)
        quiet: Callable[[str], None] = lambda words: None
        before = fit_before(estimator, network, late, whole, quiet) if held_out else None
        return [_without_network(whole), _without_network(before)]

    with function_beside(fitted) as begin:
        yield FitsBeside(network, begin)


def _without_network(fit: LikelihoodFit | None) -> dict[str, Any] | None:
    """What another process can be sent: a network holds functions, which cannot be pickled."""
    if fit is None:
        return None
    return {name: value for name, value in vars(fit).items() if name != "network"}


def _with_network(network: CSLC, fields: dict[str, Any] | None) -> LikelihoodFit | None:
    """A fit of a network with static friction."""
    if fields is None:
        return None
    return LikelihoodFit(network=network.with_static_slopes(fields["slopes"]), **fields)


def start_of(network: CSLC, least_squares: Identification) -> Identification | None:
    """The fit to start from: regression with static friction starts from other slopes."""
    return None if "static" in network.robot.friction_terms else least_squares
