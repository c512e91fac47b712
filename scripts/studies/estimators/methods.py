"""Ways from a recording to coefficients with intervals, under the same settings."""

import time
from collections.abc import Iterator
from typing import NamedTuple

import numpy as np
from jaxtyping import Float

import jaxcslc as jc
from jaxcslc.identification import uncertainty_interval
from scripts.studies.estimators.recordings import Experiment


NAMES = (
    "least squares",
    "least squares, systematic errors",
    "instruments, known controller",
    "instruments, observer",
    "direct dynamics",
    "maximum likelihood",
)


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


def estimates(network: jc.CSLC, experiment: Experiment) -> Iterator[Estimate]:
    """All methods, one after the other; settings are chosen once, by cross-validation.

    Masks, alignment and parallel filter are those of least squares: instruments do not need the
    filter, but standard errors rest on residuals that are not far from white.
    """
    recording = experiment.recording
    settings = jc.choose_settings(network, recording).settings
    start = time.process_time()
    fit = settings.fit(network, settings.patterns(recording))
    yield _of_fit(NAMES[0], fit, time.process_time() - start)
    start = time.process_time()
    report = jc.identify(network, recording, settings=settings, checks=False, possible="never")
    interval = uncertainty_interval(report.fit, report.systematic)
    k = np.asarray(report.fit.k)
    yield Estimate(NAMES[1], k, np.asarray(interval), time.process_time() - start)
    for name, estimator in (
        (NAMES[2], jc.InstrumentalVariables(experiment.loop, settings)),
        (NAMES[3], jc.InstrumentalVariables(settings=settings)),
        (NAMES[4], jc.DirectDynamics(experiment.loop, settings)),
    ):
        start = time.process_time()
        simulated = estimator.fit(network, recording)
        seconds = time.process_time() - start
        test = simulated.exogeneity
        estimate = _of_fit(name, simulated.fit, seconds)
        yield estimate._replace(p_value=None if test is None else test.p_value)
    start = time.process_time()
    sampled = settings.preparation.torque_alignment == "sample"
    likely = jc.MaximumLikelihood("sampled" if sampled else "held", settings)
    result = likely.fit(network, recording)
    yield _of_fit(NAMES[5], result.fit, time.process_time() - start)


def _of_fit(name: str, fit: jc.Identification, seconds: float) -> Estimate:
    return Estimate(name, np.asarray(fit.k), np.asarray(fit.confidence_interval()), seconds)
