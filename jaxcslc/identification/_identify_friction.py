"""Steps of `identify` that choose friction: terms joint by joint, and pre-sliding."""

import dataclasses
from collections.abc import Callable
from typing import NamedTuple

import numpy as np

from ..friction import PreSlidingFit, fit_pre_sliding, fit_slopes
from ..least_squares import LeastSquares
from ..network import CSLC, DIRECTIONAL_LOAD, LOAD
from ..recordings import Patterns
from ..selection import FRICTION_CANDIDATES, PRE_SLIDING, FrictionChoice, choose_friction
from ._estimator import Judged
from ._exclusions import LOAD_FRICTION, Request, excluded
from ._maximum_likelihood import within_memory
from ._problem import ChosenSettings, basic_settings, select_settings


# Joints of which pre-sliding is kept for nothing. Not divided by the number of kinds that are
# tried, as for terms: of 96 joints without it (simulated, encoders or Gaussian noise), none kept it
# at either level, since hardly any length fits better there; five of a Panda's seven would lose it.
_CHANCE = 0.05
_TOO_LONG = "the recording is too long to be fitted in one piece"


@dataclasses.dataclass(frozen=True)
class ChosenFriction:
    """Friction that is chosen by the data.

    - `request`: with the terms in its network and, with maximum likelihood, lengths of pre-sliding
      and static friction of joints without.
    - `settings`: that terms were judged by; None if the request has its own.
    - `terms`: joint by joint, and what each was worth.
    - `tried`: pre-sliding as it was tried before all fits; None if it was not.
    - `not_tried`: why it was not, in words; None if it is to be tried beside the fit.
    """

    request: Request
    settings: ChosenSettings | None
    terms: FrictionChoice
    tried: PreSlidingFit | None = None
    not_tried: str | None = None


class FrictionStates(NamedTuple):
    """Results on friction, for the report.

    - `terms`: that were tried; None if friction was not chosen.
    - `pre_sliding`: dry friction with states; None if none is used.
    - `notes`: one sentence each.
    """

    terms: FrictionChoice | None
    pre_sliding: PreSlidingFit | None
    notes: tuple[str, ...] = ()


def choose_friction_terms(request: Request, step: Callable[[str], None]) -> ChosenFriction:
    """Choose friction joint by joint, on the longest recording.

    Where maximum likelihood is fitted, lengths of pre-sliding are chosen now, for its fits have to
    know them.
    """
    longest = request.training[request.longest]
    unfit = excluded(request, LOAD_FRICTION)
    candidates = [
        kind for kind in FRICTION_CANDIDATES if not unfit or kind not in (LOAD, DIRECTIONAL_LOAD)
    ]
    chosen = select_settings(request, step) if request.settings is None else None
    terms = choose_friction(
        request.network,
        longest,
        basic_settings(request, chosen),
        candidates=candidates,
        progress=step,
    )
    request = dataclasses.replace(request, network=terms.network)
    tried, not_tried = None, excluded(request, PRE_SLIDING)
    if request.estimator in ("maximum-likelihood", "auto") and not_tried is None:
        if within_memory(terms.network, request.training, request.memory):
            settings = basic_settings(request, chosen).for_network(terms.network)
            patterns = settings.patterns(longest)
            network = terms.network
            if "static" in network.robot.friction_terms:
                network = fit_slopes(network, patterns, solver=settings.solver).network
            tried, not_tried = _tried(network, patterns, settings.solver, step)
        else:
            not_tried = _TOO_LONG
    if tried is not None:
        terms = terms.with_pre_sliding(tried)
        if tried.joint_names:
            options = dataclasses.replace(
                request.likelihood_options, lengths=tuple(tried.lengths.tolist())
            )
            request = dataclasses.replace(request, likelihood=options)
    if request.estimator == "maximum-likelihood":
        terms = terms.with_static_friction()
        request = dataclasses.replace(request, network=terms.network)
    if chosen is not None:
        chosen = chosen._replace(motion=None)
    return ChosenFriction(request, chosen, terms, tried, not_tried)


def friction_states(judged: Judged, chosen: ChosenFriction | None) -> FrictionStates:
    """Return what is reported of friction; with least squares alone, try pre-sliding now.

    It is tried beside the terms that were fitted, with their patterns, masks and settings.

    - `chosen`: None if friction was not chosen.
    """
    problem, states = judged.problem, judged.pre_sliding
    terms, notes = None if chosen is None else chosen.terms, ()
    if chosen is not None and chosen.tried is not None:
        tried = chosen.tried
        if states is not None:
            states = dataclasses.replace(
                states, relative=tried.relative, tried_lengths=tried.tried_lengths
            )
    elif chosen is not None:
        tried, not_tried = None, chosen.not_tried or (None if problem.part is None else _TOO_LONG)
        if not_tried is None:
            patterns = problem.patterns["training"]
            tried, not_tried = _tried(judged.fit.network, patterns, problem.solver, problem.step)
        if tried is None:
            notes = (f"{PRE_SLIDING} was not tried: {not_tried}",)
        else:
            terms = chosen.terms.with_pre_sliding(tried)
            states = tried if tried.joint_names else None
    if states is not None:
        notes = (*notes, _note_of(states, fitted=bool(judged.fit.lengths.any())))
    return FrictionStates(terms, states, notes)


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


def _note_of(states: PreSlidingFit, *, fitted: bool) -> str:
    """Describe where dry friction has states, and where it is a step."""
    joints = ", ".join(states.joint_names)
    if fitted:
        return (
            f"{PRE_SLIDING} of {joints}: a state along the motion, in the coefficients and errors"
            " of this report, simulated motion and C code; robot files have dry friction as a step"
        )
    return (
        f"{PRE_SLIDING} of {joints}: a state along the motion, in report.pre_sliding,"
        " identification.json, simulated motion and C code; all else, robot files included, has"
        " dry friction as a step"
    )
