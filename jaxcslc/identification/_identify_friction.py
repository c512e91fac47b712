import dataclasses
from collections.abc import Callable, Mapping

import numpy as np

from ..motion import Recording
from ..network import CSLC
from ..network.terms import DIRECTIONAL_LOAD, LOAD
from ._settings import Settings
from .estimators import EstimatorChoice
from .friction import fit_pre_sliding
from .prior import Prior
from .report import Report
from .selection import FRICTION_CANDIDATES, PRE_SLIDING, FrictionChoice, choose_friction


# Joints of which pre-sliding is kept for nothing. Not divided by the number of kinds that are
# tried, as for terms: of 96 joints without it (simulated, encoders or Gaussian noise), none kept it
# at either level, since hardly any length fits better there; five of a Panda's seven would lose it.
_CHANCE = 0.05


def friction_choice(
    network: CSLC,
    training: Mapping[str, Recording],
    settings: Settings | None,
    *,
    estimator: EstimatorChoice,
    horizon: bool,
    step: Callable[[str], None],
) -> FrictionChoice:
    """Friction terms that `identify` fits, joint by joint, chosen on the longest recording.

    With maximum likelihood, static friction too.
    """
    longest = max(training.values(), key=lambda recording: recording.samples)
    # What `identify` fits by other ways than one least-squares fit knows no friction of the load.
    plain = estimator == "least-squares" and not horizon and len(training) == 1
    candidates = [
        kind for kind in FRICTION_CANDIDATES if plain or kind not in (LOAD, DIRECTIONAL_LOAD)
    ]
    choice = choose_friction(network, longest, settings, candidates=candidates, progress=step)
    return choice.with_static_friction() if estimator == "maximum-likelihood" else choice


def with_friction_choice(
    report: Report,
    choice: FrictionChoice,
    *,
    estimator: EstimatorChoice,
    prior: Prior | None,
    step: Callable[[str], None],
) -> Report:
    """The report with what was tried of friction, pre-sliding included.

    Pre-sliding is tried beside the report's terms, with its patterns, masks and settings. Its
    lengths are judged over all samples: masks leave out the slow ones, which say most of them.
    """
    reason = _not_tried(report, estimator, prior)
    if reason is not None:
        return _without(report, choice, reason)
    step(f"trying friction: {PRE_SLIDING}")
    patterns, solver = report.patterns["training"], report.settings.solver
    try:
        everything = np.ones(np.shape(patterns.mask), bool)
        fit = fit_pre_sliding(
            report.network, patterns, solver=solver, judged=everything, chance=_CHANCE
        )
    except (ValueError, RuntimeError) as error:  # too little motion is left in some stretch
        return _without(report, choice, str(error))
    friction = choice.with_pre_sliding(fit)
    if not fit.joint_names:
        return dataclasses.replace(report, friction=friction)
    note = (
        f"{PRE_SLIDING} of {', '.join(fit.joint_names)}: a state along the motion, in"
        " report.pre_sliding, identification.json, simulated motion and C code; all else, robot"
        " files included, has dry friction as a step"
    )
    return dataclasses.replace(
        report, friction=friction, pre_sliding=fit, notes=(*report.notes, note)
    )


def _without(report: Report, choice: FrictionChoice, reason: str) -> Report:
    note = f"{PRE_SLIDING} was not tried: {reason}"
    return dataclasses.replace(report, friction=choice, notes=(*report.notes, note))


def _not_tried(report: Report, estimator: EstimatorChoice, prior: Prior | None) -> str | None:
    """Why pre-sliding is not tried, if it is not."""
    reasons = {
        "several recordings are fitted together": report.several is not None,
        f"it is for the estimator 'least-squares', not {estimator!r}": estimator != "least-squares",
        "the recording is too long to be fitted in one piece": report.judged_part is not None,
        "coefficients are known beforehand": prior is not None,
        "friction follows the load": bool(report.network.load_terms),
        "no joint has friction of kind 'dry'": not any(
            "dry" in kinds for kinds in report.network.friction_per_joint
        ),
    }
    return next((reason for reason, applies in reasons.items() if applies), None)
