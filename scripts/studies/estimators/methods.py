"""Ways from a recording to coefficients with intervals."""

import time
from collections.abc import Callable, Collection, Iterator
from typing import NamedTuple, Protocol

import numpy as np
from jaxtyping import Float

import jaxcslc as jc
from jaxcslc.instruments import SimulationFit
from jaxcslc.likelihood import LikelihoodFit
from jaxcslc.uncertainty import uncertainty_interval
from scripts.studies.estimators.recordings import Experiment


class Estimate(NamedTuple):
    """What a method makes of a recording.

    - `method`: of `NAMES`.
    - `k`: (p,) coefficients; `interval`: (p, 2), of 95 %.
    - `seconds`: of the processor, the choice of settings apart.
    - `p_value`: of the test whether least squares is biased; None where there is none.
    """

    method: str
    k: Float[np.ndarray, " coefficients"]
    interval: Float[np.ndarray, "coefficients 2"]
    seconds: float
    p_value: float | None = None


class _Estimator(Protocol):
    def fit(
        self, network: jc.CSLC, recording: jc.Recording, start: jc.Identification | None = None
    ) -> LikelihoodFit | SimulationFit: ...


# The estimators beside least squares, of a recording's experiment and settings.
_ESTIMATORS: dict[str, Callable[[Experiment, jc.Settings], _Estimator]] = {
    "instruments, known controller": lambda made, settings: jc.InstrumentalVariables(
        made.loop, settings
    ),
    "instruments, observer": lambda _, settings: jc.InstrumentalVariables(settings=settings),
    "direct dynamics, known controller": lambda made, settings: jc.DirectDynamics(
        made.loop, settings
    ),
    "maximum likelihood": lambda _, settings: jc.MaximumLikelihood(
        "sampled" if settings.preparation.torque_alignment == "sample" else "held", settings
    ),
}
_ORDINARY, _SYSTEMATIC = "least squares", "least squares, with systematic errors"
ROUGH = ", hardly smoothed"
# As little smoothing as there is: nobody has chosen it for the recording.
HARDLY_SMOOTHED = jc.Settings(
    jc.Preparation(smoothing=jc.AveragedSplines(3), torque_alignment="mean")
)
# Of the first simulation then: the arm that least squares makes of noise does not follow.
_FIRST = jc.Settings(jc.Preparation(torque_alignment="mean"))
NAMES = (
    _ORDINARY,
    _SYSTEMATIC,
    *_ESTIMATORS,
    _ORDINARY + ROUGH,
    "instruments, known controller" + ROUGH,
    "instruments, observer" + ROUGH,
)


def estimates(
    network: jc.CSLC, experiment: Experiment, methods: Collection[str]
) -> Iterator[Estimate]:
    """Return those of some methods, one after the other.

    Settings are chosen once, by cross-validation. Masks, alignment and parallel filter are those of
    least squares for all: instruments do not need the filter, but standard errors rest on
    residuals that are not far from white.
    """
    recording, settings = experiment.recording, None
    for name in (name for name in NAMES if name in methods):
        rough = name.endswith(ROUGH)
        if settings is None and not rough:
            settings = jc.choose_settings(network, recording).settings
        of_method = HARDLY_SMOOTHED if rough or settings is None else settings
        start, p_value = time.process_time(), None
        if name == _SYSTEMATIC:
            report = jc.identify(
                network, recording, settings=of_method, checks=False, possible="never"
            )
            fit, interval = report.fit, uncertainty_interval(report.fit, report.systematic)
        elif name.startswith(_ORDINARY):
            fit = of_method.fit(network, of_method.patterns(recording))
            interval = fit.confidence_interval()
        else:
            estimator = _ESTIMATORS[name.removesuffix(ROUGH)](experiment, of_method)
            first = _FIRST.fit(network, _FIRST.patterns(recording)) if rough else None
            result = estimator.fit(network, recording, first)
            fit, interval = result.fit, result.fit.confidence_interval()
            test = result.exogeneity if isinstance(result, SimulationFit) else None
            p_value = None if test is None else test.p_value
        seconds = time.process_time() - start
        yield Estimate(name, np.asarray(fit.k), np.asarray(interval), seconds, p_value)
