"""Equations in which a shaft of two joints turns."""

import dataclasses

import numpy as np

from ....network.terms import CoupledTerm
from .._problem import Problem
from .._signs import dilated
from ._state import MARGINS, SIGN_STEPS, State


def with_common_shafts(problem: Problem, state: State, number: int) -> tuple[State, bool]:
    """Without equations in which a common shaft of two joints turns, and whether they are those of
    before.

    Dry friction of a shaft that two joints turn together has the sign of a sum of their velocities,
    which no sign of a single joint holds while a step is judged. Where the shaft turns, the sum of
    squares jumps with noise of positions. Linear equations do not know of that, and damping grows
    without an end (a Stäubli TX40, which begins at rest: 12 were promised, and a thirtieth of that
    step lost 10).

    As of other reversals, more is left out in the first steps; later no equation comes back.
    """
    terms = problem.equations.network.terms
    pairs = [
        pair
        for term in terms
        if isinstance(term, CoupledTerm) and term.kind == "coupled_dry"
        for pair in term.pairs
    ]
    if not pairs:
        return state, True
    mask = np.zeros_like(state.undecided)
    margin = MARGINS[number] if number < len(MARGINS) else 0
    for pair in pairs:
        joints = [pair.first - 1, pair.second - 1]
        sign = np.sign(np.diff(state.point.q[:, joints] @ [1.0, float(pair.ratio)]))
        mask[:, joints] |= dilated((sign[1:] * sign[:-1] <= 0.0)[:, None], margin)
    if number >= SIGN_STEPS:
        mask |= state.undecided
    same = np.array_equal(mask, state.undecided)
    return dataclasses.replace(state, undecided=mask), same
