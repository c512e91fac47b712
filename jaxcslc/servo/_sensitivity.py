"""Derivatives of all joints' simulated positions with respect to all joints' unknowns.

A parameter of one joint moves the others too, by the inertia and the gravity that couple them.
Joints are simulated one by one, which costs a fiftieth of the whole arm: each under the loads that
the changed motion of the others gives, to first order, twice around (waveform relaxation;
Lelarasmee, 1982). Read with `_search` and `_intervals`.
"""

import math
from collections.abc import Sequence
from concurrent.futures import ThreadPoolExecutor
from dataclasses import dataclass

import numpy as np
from jaxtyping import Float

from ..manipulator import Manipulator
from ._search import NAMES, JointMotion, JointProblem
from ._simulation import JointLoads, inverse_dynamics, simulate_joint


MASS_STEP = 0.02
"""Change of the logarithm of the masses' scale, for derivatives."""
_ANGLE_STEP = 1e-3  # rad, for derivatives of loads: gravity is a sine
_SWEEPS = 2
_LEAST_PUSH = 1e-5  # rad, by which a load must move a servo to count: 1 % of what steps move


@dataclass(frozen=True)
class Coupling:
    """Derivatives of all joints' loads in a recording, with respect to the joints' motion.

    **Attributes**

    - `mass`: with respect to accelerations [kg m²].
    - `stiffness`: with respect to positions [N m/rad].
    """

    mass: Float[np.ndarray, "samples joints joints"]
    stiffness: Float[np.ndarray, "samples joints joints"]

    @classmethod
    def of(
        cls,
        robot: Manipulator,
        position: Float[np.ndarray, "samples joints"],
        velocity: Float[np.ndarray, "samples joints"],
        acceleration: Float[np.ndarray, "samples joints"],
    ) -> "Coupling":
        """Return the derivatives of a robot that moves like this."""
        torque, mass = inverse_dynamics(robot, position, velocity, acceleration)
        columns: list[np.ndarray] = []
        for step in _ANGLE_STEP * np.eye(position.shape[1]):
            moved = inverse_dynamics(robot, position + step, velocity, acceleration)[0]
            columns.append((moved - torque) / _ANGLE_STEP)
        return cls(mass, np.stack(columns, axis=2))


def sensitivities(
    problems: Sequence[JointProblem],
    unknowns: Sequence[np.ndarray],
    couplings: Sequence[Coupling],
    masses: float,
    has_scale: bool,
    shrink: float,
) -> list[Float[np.ndarray, "samples all"]]:
    """Return for each joint the derivatives with respect to all unknowns, and the masses' scale.

    - `couplings`: of each recording, the joints moving as simulated.
    - `has_scale`: whether the scale is an unknown; its derivatives are zero otherwise.
    - `shrink`: part of the unknowns' steps that differences take.
    """
    ends = np.cumsum([0, *[len(x) for x in unknowns]])
    size = int(ends[-1]) + 1
    steps = np.append(
        shrink * np.concatenate([[u.step for u in problem.unknowns] for problem in problems]),
        MASS_STEP,
    )
    # Zero positions, which change angles at unchanged readings.
    zeros = np.zeros((len(problems), size))
    for i, problem in enumerate(problems):
        if "offset" in problem.names:
            zeros[i, ends[i] + problem.names.index("offset")] = 1.0

    def alone(i: int) -> tuple[np.ndarray, np.ndarray]:
        problem, x = problems[i], unknowns[i]
        residuals, own = problem.linearised(x, shrink, masses)
        J = np.zeros((len(residuals), size))
        J[:, ends[i] : ends[i + 1]] = own
        if has_scale:
            up, down = (
                problem.residuals(x[None], masses * math.exp(step))[0]
                for step in (MASS_STEP, -MASS_STEP)
            )
            J[:, -1] = (up - down) / (2.0 * MASS_STEP)
        return residuals, J

    def together(i: int) -> np.ndarray:
        residuals, direct = first[i]
        J = direct.copy()
        start = 0
        row = problems[i].rows(unknowns[i][None])
        least = _LEAST_PUSH * row[0, NAMES.index("gain")]
        for n, motion in enumerate(problems[i].motions):
            part = slice(start, start + motion.time.size)
            # As columns of `JointLoads`: friction feels the load, and not accelerations.
            weight, push = np.zeros((2, motion.time.size, size))
            for j, other in enumerate(J_before):
                if j != i:
                    weight += couplings[n].stiffness[:, i, j, None] * (other[part] - zeros[j])
                    push += couplings[n].mass[:, i, j, None] * _accelerations(other[part], motion)
            loads = motion.loads(masses)
            before = residuals[part] + motion.position
            largest = np.max(np.abs(weight * steps) + np.abs(push * steps), axis=0)
            for k in np.flatnonzero(largest > least):
                torque = loads.torque.copy()
                torque[:, 0] += steps[k] * weight[:, k]
                torque[:, 3] += steps[k] * push[:, k]
                pushed = simulate_joint(
                    JointLoads(torque, loads.inertia),
                    row,
                    motion.time,
                    motion.command,
                    motion.start,
                    longest_step=problems[i].longest_step,
                )[0]
                J[part, k] += (pushed - before) / steps[k]
            start = part.stop
        return J

    everyone = range(len(problems))
    # C code runs without Python's lock.
    with ThreadPoolExecutor() as pool:
        first = list(pool.map(alone, everyone))
        J_before = [J for _, J in first]
        for _ in range(_SWEEPS if len(problems) > 1 else 0):
            J_before = list(pool.map(together, everyone))
    return J_before


def _accelerations(
    positions: Float[np.ndarray, "samples all"], motion: JointMotion
) -> Float[np.ndarray, "samples all"]:
    interval = float(np.median(np.diff(motion.time)))
    found = np.zeros_like(positions)
    found[1:-1] = np.diff(positions, 2, axis=0) / interval**2
    return found
