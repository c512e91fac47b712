import dataclasses
from collections.abc import Callable, Sequence

import numpy as np

from .._problem import Problem
from ..search import Minimum, search
from ._first_gears import first_gears
from ._parameters import TransmissionParameters
from ._search_start import SearchStart
from ._transmission_equations import TransmissionEquations
from ._widened import with_transmission


# Which of compliance, lag, play, inertia of rotors and shares of friction are free, for how many
# steps at most, and so many times the speed within which friction of links changes its direction.
_STAGES = (
    ((True, True, True, False, False, True), 12, 100.0),
    ((True, True, True, True, False, True), 12, 30.0),
    ((True, True, True, True, True, True), 60, 1.0),
)


def transmission_search(
    problem: Problem,
    start: SearchStart,
    links: Sequence[int],
    progress: Callable[[str], None],
) -> Minimum:
    """The most likely rotors and links that move apart.

    From rigid gears, a search may end with ever stiffer ones: phases of vibrations change by more
    than a radian on the way to the right stiffness. So it starts from gears that explain smoothed
    motion (`first_gears`). Stiffness, damping, play and shares of dry friction are free at first,
    with links that turn and stick smoothly, then rotors' inertias. Shares of viscous friction come
    last: beside wrong gears, they and damping make up for one another.

    **Arguments** of a problem with rigid gears, as of `search`, and

    - `links`: which move apart from their rotors, from 0.

    **Returns** the minimum of rotors and links apart.
    """
    progress("maximum likelihood: gears of smoothed motion")
    first = first_gears(problem, start.point.k, links)
    wide, start = with_transmission(problem, start, links, first)
    minimum: Minimum | None = None
    for free, most_steps, factor in _STAGES:
        stage = _with_speed(_with_free(wide, free), factor)
        minimum = search(stage, *start, progress, most_steps=most_steps)
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


def _with_speed(problem: Problem, factor: float) -> Problem:
    """With another speed within which friction of links changes its direction."""
    equations = problem.equations
    assert isinstance(equations, TransmissionEquations)
    return dataclasses.replace(
        problem, equations=dataclasses.replace(equations, speed=factor * equations.speed)
    )
