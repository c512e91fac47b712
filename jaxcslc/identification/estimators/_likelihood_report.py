import dataclasses
from types import MappingProxyType
from typing import NamedTuple

import jax.numpy as jnp
import numpy as np
from jaxtyping import Bool, Float

from ...motion import Patterns, Recording
from .._held_out import HeldOut, Source, judged_errors
from ..friction import PreSlidingFit, SlopeFit, along_motion
from ..likelihood import LikelihoodFit
from ..possible import PossibleFit
from ..report import Report, compare, degree_of_excitation, fit_warnings
from ..solver import Identification, torque_of


class JudgedErrors(NamedTuple):
    """Torque errors of maximum likelihood on motion that was not fitted.

    - `error`: [N m or N]; `mask`: which of them count.
    - `source`: of the motion.
    """

    error: Float[np.ndarray, "samples joints"]
    mask: Bool[np.ndarray, "samples joints"]
    source: Source


def likelihood_report(
    report: Report,
    likelihood: LikelihoodFit,
    fit: Identification,
    bodies: PossibleFit | None,
    judged: JudgedErrors,
) -> Report:
    """A report of least squares with the numbers of maximum likelihood.

    **Arguments**

    - `report`: of least squares, whose patterns errors are computed on.
    - `likelihood`: of the same recordings.
    - `fit`: the coefficients to report: `likelihood.fit`, or those of `bodies`.
    - `bodies`: possible bodies beside them, or None.
    - `judged`: what fits that have not seen it make of motion that was left out.
    """
    network, lengths = likelihood.network, likelihood.lengths
    vectors = {} if bodies is None else bodies.other_coefficients
    errors = {
        name: compare(along_motion(network, patterns, lengths), patterns, {"fit": fit.k, **vectors})
        for name, patterns in report.patterns.items()
    }
    held_out = _held_out(report, likelihood, fit, judged)
    joined = report.patterns["training"]
    recording = Recording(joined.time, joined.q, joined.torque)
    warnings = [*held_out.warnings]
    if not likelihood.converged:
        warnings.append(
            f"maximum likelihood: not converged after {likelihood.steps} steps; coefficients"
            " may be off by more than their intervals"
        )
    noise = likelihood.noise_excitation
    if noise is not None and noise.excessive:
        warnings.append(
            f"maximum likelihood, {noise.line}: the motion hardly shows this coefficient. Likely"
            " cause: slow motion, or a single sine a joint. Remedy: faster or richer motion"
            " (jaxcslc excite), or --estimator least-squares"
        )
    warnings += fit_warnings(network, recording, fit, errors["training"])
    excitation = report.excitation
    if excitation is not None and network.names != report.network.names:
        # Regression leaves static friction out where slopes cannot be fitted to smooth motion.
        excitation = degree_of_excitation(network, joined)
    systematic = None if report.systematic is None else likelihood.systematic
    if systematic is not None:
        fixed = np.flatnonzero(np.asarray(fit.standard_error) == 0.0)
        systematic = systematic.without(fixed.tolist())
    return dataclasses.replace(
        report,
        excitation=excitation,
        network=network,
        fit=fit,
        errors=MappingProxyType(errors),
        held_out=held_out,
        slopes=_slopes(likelihood),
        systematic=systematic,
        warnings=tuple(warnings),
        bodies=None if bodies is None else bodies.parameters,
        possible=bodies,
        pre_sliding=(PreSlidingFit(network, fit, lengths, {}, lengths) if lengths.any() else None),
    )


def _held_out(
    report: Report, likelihood: LikelihoodFit, fit: Identification, judged: JudgedErrors
) -> HeldOut:
    network = likelihood.network

    def left(patterns: Patterns) -> Float[np.ndarray, "samples joints"]:
        of_motion = along_motion(network, patterns, likelihood.lengths)
        return np.asarray(patterns.torque) - torque_of(of_motion, patterns, fit.k)

    training = report.patterns["training"]
    error, mask = judged.error, judged.mask
    if judged.source == "validation":
        validation = report.patterns["validation"]
        error, mask = left(validation), np.asarray(validation.mask)
    result = judged_errors(left(training), np.asarray(training.mask), error, mask, int(fit.rank))
    return dataclasses.replace(
        result, source=judged.source, units=network.output_units, names=network.output_names
    )


def _slopes(likelihood: LikelihoodFit) -> SlopeFit | None:
    """Slopes of static friction as least squares reports them; None without static friction."""
    network = likelihood.network
    if network.static_slopes is None:
        return None
    return SlopeFit(
        network,
        likelihood.fit,
        jnp.asarray(likelihood.slopes),
        jnp.asarray(likelihood.slope_error),
        jnp.asarray(likelihood.steps),
        jnp.asarray(likelihood.converged),
    )
