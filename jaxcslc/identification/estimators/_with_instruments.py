import dataclasses
from collections.abc import Callable
from types import MappingProxyType

import numpy as np

from ...motion import Patterns, Recording
from .._held_out import HeldOut, held_out_error, judged_errors
from .._held_out_part import held_out_from
from .._identify_one import without_lag
from ..instruments import InstrumentalVariables
from ..prior import Prior, with_knowledge
from ..report import Report, compare, fit_warnings
from ..solver import Identification, torque_of


def with_instruments(
    report: Report,
    recording: Recording,
    *,
    prior: Prior | None,
    step: Callable[[str], None],
) -> Report:
    """A report of least squares with the coefficients of instrumental variables in their stead.

    Bodies are not fitted, and standard errors have no systematic part.

    **Arguments**

    - `report`: of least squares, by whose settings and from whose coefficients instruments start.
    - `recording`: that it is of.
    - `prior`, `step`: as of `identify`.

    **Returns** the report; a note says whether least squares is biased.

    **Raises** `ValueError`, `RuntimeError`: as `InstrumentalVariables.fit`.
    """
    network, settings = report.network, report.settings
    on_time = settings.with_options(torque_lag=0.0)
    recording = without_lag(recording, settings.preparation.torque_lag)
    known = {} if prior is None else prior.coefficient_values(network)

    def fitted(part: Recording, words: str) -> tuple[Identification, list[str]]:
        step(words)
        result = InstrumentalVariables(settings=on_time).fit(network, part, report.fit)
        ended = f"instrumental variables: not converged after {result.steps} simulations"
        sentences = [] if result.converged else [ended]
        return with_knowledge(result.fit, known), [str(result.exogeneity), *sentences]

    fit, (tested, *warnings) = fitted(recording, "instrumental variables")
    step("computing errors")
    errors = {
        name: compare(network, patterns, {"fit": fit.k})
        for name, patterns in report.patterns.items()
    }
    training = report.patterns["training"]
    held_out = _held_out(report, fit, recording, on_time.patterns(recording), fitted)
    smoothed = Recording(training.time, training.q, training.torque)
    warnings += [*held_out.warnings, *fit_warnings(network, smoothed, fit, errors["training"])]
    return dataclasses.replace(
        report,
        fit=fit,
        errors=MappingProxyType(errors),
        held_out=held_out,
        notes=(*report.notes, f"instrumental variables: {tested}"),
        warnings=tuple(warnings),
        systematic=None,
        bodies=None,
        possible=None,
    )


def _held_out(
    report: Report,
    fit: Identification,
    recording: Recording,
    patterns: Patterns,
    fitted: Callable[[Recording, str], tuple[Identification, list[str]]],
) -> HeldOut:
    """Errors on the validation recording, or on the last part of the training recording."""
    network, training = report.network, report.patterns["training"]
    if "validation" in report.patterns:
        return held_out_error(network, fit, training, report.patterns["validation"])
    start, end = float(recording.time[0]), float(recording.time[-1])
    split = held_out_from(recording)
    shorter, _ = fitted(recording.between(0.0, split - start), "judging instrumental variables")
    late = patterns.between(split, end)
    of_training, of_late = (
        (np.asarray(part.torque) - torque_of(network, part, k), np.asarray(part.mask))
        for part, k in ((training, fit.k), (late, shorter.k))
    )
    result = judged_errors(*of_training, *of_late, int(fit.rank))
    return dataclasses.replace(
        result,
        source="held-out stretch",
        units=network.output_units,
        names=network.output_names,
    )
