import dataclasses
from collections.abc import Callable, Mapping
from typing import Any

import numpy as np

from ..motion import Patterns, Recording
from ..network import CSLC
from ..network.terms import DIRECTIONAL_LOAD, LOAD
from ._settings import Settings
from .estimators import EstimatorChoice, within_memory
from .friction import PreSlidingFit, fit_pre_sliding, fit_slopes
from .likelihood import MaximumLikelihood
from .prior import Prior
from .report import Report
from .selection import (
    FRICTION_CANDIDATES,
    PRE_SLIDING,
    FrictionChoice,
    choose_friction,
    choose_settings,
)
from .solver import LeastSquares


# Joints of which pre-sliding is kept for nothing. Not divided by the number of kinds that are
# tried, as for terms: of 96 joints without it (simulated, encoders or Gaussian noise), none kept it
# at either level, since hardly any length fits better there; five of a Panda's seven would lose it.
_CHANCE = 0.05
_TOO_LONG = "the recording is too long to be fitted in one piece"


@dataclasses.dataclass(frozen=True)
class ChosenFriction:
    """What `identify` fits of friction where it is chosen by the data.

    - `terms`: joint by joint, and what each was worth.
    - `likelihood`: the options of maximum likelihood, with lengths of pre-sliding where they were
      chosen; None if nothing is said of them.
    - `tried`: pre-sliding as it was tried before all fits; None if it was not.
    - `not_tried`: why it was not, in words; None if it is to be tried beside the fit.
    """

    terms: FrictionChoice
    likelihood: MaximumLikelihood | None
    tried: PreSlidingFit | None = None
    not_tried: str | None = None

    def of_report(self, report: Report, step: Callable[[str], None]) -> Report:
        """The report with what was tried of friction.

        With least squares alone, pre-sliding is tried now: beside the report's terms, with its
        patterns, masks and settings.
        """
        terms, not_tried = self.terms, self.not_tried or _too_long(report)
        tried = self.tried
        if tried is not None:
            states = report.pre_sliding
            if states is not None:
                states = dataclasses.replace(
                    states, relative=tried.relative, tried_lengths=tried.tried_lengths
                )
            return dataclasses.replace(report, friction=terms, pre_sliding=states)
        if not_tried is None:
            solver = report.settings.solver
            tried, not_tried = _tried(report.network, report.patterns["training"], solver, step)
        if tried is None:
            note = f"{PRE_SLIDING} was not tried: {not_tried}"
            return dataclasses.replace(report, friction=terms, notes=(*report.notes, note))
        terms = terms.with_pre_sliding(tried)
        states = tried if tried.joint_names else None
        return dataclasses.replace(report, friction=terms, pre_sliding=states)


def choose_friction_terms(
    network: CSLC,
    training: Mapping[str, Recording],
    settings: Settings | None,
    *,
    estimator: EstimatorChoice,
    likelihood: MaximumLikelihood | None,
    prior: Prior | None,
    options: Mapping[str, Any],
    memory: float,
    horizon: bool,
    step: Callable[[str], None],
) -> ChosenFriction:
    """Friction that `identify` fits, joint by joint, chosen on the longest recording.

    With maximum likelihood, lengths of pre-sliding too, which its fits have to know, and static
    friction of joints without. Arguments as of `identify`.
    """
    longest = max(training.values(), key=lambda recording: recording.samples)
    # What `identify` fits by other ways than one least-squares fit knows no friction of the load.
    plain = estimator == "least-squares" and not horizon and len(training) == 1
    candidates = [
        kind for kind in FRICTION_CANDIDATES if plain or kind not in (LOAD, DIRECTIONAL_LOAD)
    ]
    if settings is None:
        step("choosing settings")
        settings = choose_settings(network, longest).settings
    terms = choose_friction(network, longest, settings, candidates=candidates, progress=step)
    tried, not_tried = None, _not_tried(terms.network, training, estimator, likelihood, prior)
    of_likelihood = estimator in ("maximum-likelihood", "auto")
    if of_likelihood and not_tried is None:
        if within_memory(terms.network, training, memory):
            suited = settings.with_options(**options).for_network(terms.network)
            tried, not_tried = _tried_before(terms.network, longest, suited, step)
        else:
            not_tried = _TOO_LONG
    if tried is not None:
        terms = terms.with_pre_sliding(tried)
        if tried.joint_names:
            lengths = tuple(tried.lengths.tolist())
            likelihood = dataclasses.replace(likelihood or MaximumLikelihood(), lengths=lengths)
    if estimator == "maximum-likelihood":
        terms = terms.with_static_friction()
    return ChosenFriction(terms, likelihood, tried, not_tried)


def _tried_before(
    network: CSLC, recording: Recording, settings: Settings, step: Callable[[str], None]
) -> tuple[PreSlidingFit | None, str | None]:
    """As `_tried`, with slopes of static friction of a fit without states."""
    patterns = settings.patterns(recording)
    if "static" in network.robot.friction_terms:
        network = fit_slopes(network, patterns, solver=settings.solver).network
    return _tried(network, patterns, settings.solver, step)


def _tried(
    network: CSLC, patterns: Patterns, solver: LeastSquares, step: Callable[[str], None]
) -> tuple[PreSlidingFit | None, str | None]:
    """Pre-sliding, or why it could not be tried.

    Its lengths are judged over all samples: masks leave out the slow ones, which say most of them.
    """
    step(f"trying friction: {PRE_SLIDING}")
    everything = np.ones(np.shape(patterns.mask), bool)
    try:
        return fit_pre_sliding(
            network, patterns, solver=solver, judged=everything, chance=_CHANCE
        ), None
    except (ValueError, RuntimeError) as error:  # too little motion is left in some stretch
        return None, str(error)


def _too_long(report: Report) -> str | None:
    return None if report.judged_part is None else _TOO_LONG


def _not_tried(
    network: CSLC,
    training: Mapping[str, Recording],
    estimator: EstimatorChoice,
    likelihood: MaximumLikelihood | None,
    prior: Prior | None,
) -> str | None:
    """Why pre-sliding is not tried, if it is not."""
    options = likelihood or MaximumLikelihood()
    reasons = {
        "several recordings are fitted together": len(training) > 1,
        f"it is not for the estimator {estimator!r}": estimator == "instrumental-variables",
        "its lengths are given": bool(options.lengths),
        "it is not for gears that give way": bool(options.transmission),
        "coefficients are known beforehand": prior is not None or options.prior is not None,
        "friction follows the load": bool(network.load_terms),
        "no joint has friction of kind 'dry'": not any(
            "dry" in kinds for kinds in network.friction_per_joint
        ),
    }
    return next((reason for reason, applies in reasons.items() if applies), None)
