from collections.abc import Callable, Sequence

import numpy as np

from .._problem import Problem
from ..search import Minimum, search
from ._choice import TransmissionChoice, chosen_minimum
from ._search_start import SearchStart
from ._staged_search import transmission_search


def apart_minimum(
    problem: Problem,
    start: SearchStart,
    joints: Sequence[int],
    progress: Callable[[str], None],
    *,
    optional: bool,
) -> tuple[Minimum | None, TransmissionChoice | None]:
    """The minimum of rotors and links that move apart, if these are to.

    **Arguments**

    - `problem`, `start`: with rigid gears and white torque noise.
    - `joints`: whose links move apart, from 1; all of them if there are none.
    - `optional`: whether the likelihood chooses.

    **Returns** the minimum, None where it supports rigid gears; and the choice if there was one.

    **Raises** `ValueError` for joints that the robot does not have.
    """
    n = problem.joints
    if any(not 1 <= joint <= n for joint in joints) or len(set(joints)) < len(joints):
        raise ValueError(
            f"transmission: expected different joints from 1 to {n}, got {tuple(joints)}"
        )
    links = [joint - 1 for joint in joints] or list(range(n))
    if not optional:
        return transmission_search(problem, start, links, progress), None
    rigid = search(problem, *start, progress, noise_coefficients=np.zeros((0, n)))
    minimum, choice = chosen_minimum(problem, start, rigid, links, progress)
    return (minimum if choice.supported else None), choice


def check_transmission(
    joints: Sequence[int],
    unknowns: Sequence[str],
    *,
    possible: bool,
    noise_order: int | str,
    lengths: Sequence[float],
) -> None:
    """**Raises** `ValueError` for what is not combined with links that move apart."""
    if not joints and "transmission" not in unknowns:
        return
    asked = {
        "torque_gains": "torque_gains" in unknowns,
        "possible": possible,
        "noise_order": noise_order not in (0, "auto"),
        "lengths": any(lengths),
    }
    for name, excluded in asked.items():
        if excluded:
            raise ValueError(f"transmission: not with {name}")
