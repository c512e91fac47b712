"""Elastic gears as an added block: unknowns, links as further positions, equations about them."""

import dataclasses
from collections.abc import Callable, Sequence

import numpy as np
from jaxtyping import Float

from .._blocks import ConstantBlock, Normal
from .._point import Point, Step
from .._problem import Problem, SearchStart
from ..search import Minimum, search
from ._elastic_equations import ElasticEquations
from ._first_gears import FirstGears, first_gears, smoothed_windup
from ._parameters import TransmissionParameters
from ._transmission import Transmission


# Which of compliance, lag, play and inertia of rotors are free, for how many steps at most.
_STAGES = (((True, True, True, False), 12), ((True, True, True, True), 60))
# Least compliance and inertia of a rotor beside those at first, and the standard deviation
# beforehand of the latter.
_LEAST, _ROTOR = 1e-3, 1.0
# Standard deviation of a link's position beforehand [rad or m]: none that says anything, but at an
# end of a recording, where few equations are.
_UNREAD = 1e3
GEARS, LINKS = "gears", "links"


@dataclasses.dataclass(frozen=True)
class LinkBlock(ConstantBlock):
    """Positions of links, which nothing reads: about 0, within as much as a joint may ever turn.

    - `joints`: n; links are the columns behind them.
    """

    joints: int
    weight: Float[np.ndarray, "samples links"]

    def residuals(self, point: Point) -> Float[np.ndarray, "samples links"]:
        """Return minus positions."""
        return -point.q[:, self.joints :]

    def changes(self, step: Step) -> Float[np.ndarray, "samples links"]:
        """Return changes with positions."""
        return step.position[:, self.joints :]

    def add_gradient(self, force: Float[np.ndarray, "samples links"], total: Step) -> None:
        """Add the gradient by positions."""
        total.position[:, self.joints :] += force

    def add_squares(self, weight: Float[np.ndarray, "samples links"], normal: Normal) -> None:
        """Add squares of positions."""
        normal.equations.band[normal.order.position[:, self.joints :], 0] += weight


def with_gears(
    problem: Problem, start: SearchStart, links: Sequence[int], first: FirstGears
) -> tuple[Problem, SearchStart]:
    """Return a problem of rigid gears with elastic ones, which have no play at first.

    **Arguments**

    - `links`: which move apart from their rotors, from 0.
    - `first`: gears to start from.
    """
    readings, point, index = problem.readings, start.point, np.array(links)
    network, inertia = problem.equations.network, first.rotor_inertia
    friction = np.zeros(network.size, bool)
    friction[network.layout.friction] = True
    zeros = np.zeros(len(links))
    parameters = TransmissionParameters(first.compliance, first.lag, zeros, inertia)
    size = np.std(readings.torque.averaged[:, index], axis=0)
    wide = problem.with_unknowns(
        GEARS,
        parameters._replace(play=first.compliance * size).values,
        TransmissionParameters(zeros, zeros, zeros, inertia).values,
        TransmissionParameters(zeros, zeros, zeros, (_ROTOR * inertia) ** -2.0).values,
        TransmissionParameters(
            _LEAST * first.compliance, zeros, zeros - np.inf, _LEAST * inertia
        ).values,
    )
    width = np.max(start.position_noise, axis=0)[index]
    unread = np.full((len(point.q), len(links)), _UNREAD**-2.0)
    wide = dataclasses.replace(
        wide,
        equations=ElasticEquations(problem.equations, index, readings.time, friction, width),
        added={**problem.added, LINKS: LinkBlock(problem.joints, unread)},
    )
    border = wide.layout.inserted(point.border, GEARS, parameters.values)
    q = np.concatenate([point.q, point.q[:, index] - first.windup], axis=1)
    apart = dataclasses.replace(point, border=border, layout=wide.layout, q=q)
    k = np.where(problem.scale[: network.size] > 0.0, first.k, point.k)
    return wide, start._replace(point=apart.with_values(k=k))


def near_transmission(
    problem: Problem, start: SearchStart, gears: Transmission
) -> tuple[Problem, SearchStart]:
    """Return the same with gears that are known, and links where these have them.

    **Arguments** as of `with_gears`, and

    - `gears`: with positions of links at the point's samples, or at others.
    """
    links, point = [joint - 1 for joint in gears.joints], start.point
    if len(gears.link_position) == len(point.q):
        windup = point.q[:, links] - gears.link_position
    else:
        windup = smoothed_windup(problem, point.k, gears)
    first = FirstGears(gears.compliance, gears.lag, gears.rotor_inertia, point.k, windup)
    wide, apart = with_gears(problem, start, links, first)
    return wide, apart._replace(point=apart.point.with_values(gears=gears.parameters))


def transmission_search(
    problem: Problem,
    start: SearchStart,
    joints: Sequence[int],
    progress: Callable[[str], None],
) -> Minimum:
    """Search for the most likely rotors and links that move apart.

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
    wide, start = with_gears(problem, start, links, first_gears(problem, start.point.k, links))
    minimum: Minimum | None = None
    for free, most_steps in _STAGES:
        scale, part = wide.scale.copy(), wide.layout.part(GEARS)
        scale[part] *= np.repeat(np.array(free, float), len(links))
        stage = dataclasses.replace(wide, scale=scale)
        minimum = search(stage, *start, progress, most_steps=most_steps)
        start = SearchStart(minimum.point, minimum.torque_noise, minimum.position_noise)
    assert minimum is not None
    return minimum
