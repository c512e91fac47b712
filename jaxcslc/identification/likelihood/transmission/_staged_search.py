import dataclasses
from collections.abc import Callable, Sequence

import numpy as np

from .._problem import Problem, SearchStart
from ..search import Minimum, search
from ._first_gears import first_gears
from ._parameters import TransmissionParameters
from ._widened import with_transmission


# Which of compliance, lag, play and inertia of rotors are free, for how many steps at most.
_STAGES = (((True, True, True, False), 12), ((True, True, True, True), 60))


def transmission_search(
    problem: Problem,
    start: SearchStart,
    joints: Sequence[int],
    progress: Callable[[str], None],
) -> Minimum:
    """The most likely rotors and links that move apart.

    From rigid gears, a search may end with ever stiffer ones: phases of vibrations change by more
    than a radian on the way to the right stiffness. So it starts from gears that explain smoothed
    motion (`first_gears`). Stiffness, damping and play are free at first, then rotors' inertias.

    **Arguments** of a problem with rigid gears, as of `search`, and

    - `joints`: whose links move apart from their rotors, from 1.

    **Returns** the minimum of rotors and links apart.

    **Raises** `ValueError` for joints that the robot does not have.
    """
    n = problem.joints
    if any(not 1 <= joint <= n for joint in joints) or len(set(joints)) < len(joints):
        raise ValueError(
            f"transmission: expected different joints from 1 to {n}, got {tuple(joints)}"
        )
    links = [joint - 1 for joint in joints]
    progress("maximum likelihood: gears of smoothed motion")
    first = first_gears(problem, start.point.k, links)
    wide, start = with_transmission(problem, start, links, first)
    minimum: Minimum | None = None
    for free, most_steps in _STAGES:
        minimum = search(_with_free(wide, free), *start, progress, most_steps=most_steps)
        start = SearchStart(minimum.point, minimum.torque_noise, minimum.position_noise)
    assert minimum is not None
    return minimum


def _with_free(problem: Problem, free: Sequence[bool]) -> Problem:
    """With some of the parameters of all gears fixed."""
    mask = np.ones(len(problem.scale), bool)
    mask[problem.transmission_indices] = np.repeat(
        np.array(free), len(problem.transmission_indices) // len(TransmissionParameters._fields)
    )
    return dataclasses.replace(problem, scale=np.where(mask, problem.scale, 0.0))
