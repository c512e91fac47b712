"""Derivatives of all joints' simulated positions with respect to all joints' unknowns.

A parameter of one joint moves the others too, by the inertia and the gravity that couple them.
Joints are simulated one by one, which costs a fiftieth of the whole arm: each under the loads that
the changed motion of the others gives, to first order, twice around (waveform relaxation;
Lelarasmee, 1982). Read with `_search` and `_intervals`.

Friction and play make positions rough: a small change of a parameter moves them by some tenths of a
milliradian at random. Differences are taken over steps that move a joint by several times as much.
Otherwise the roughness counts as information: a search stops short, with intervals too narrow.
"""

import math
from collections.abc import Sequence
from concurrent.futures import ThreadPoolExecutor
from dataclasses import dataclass

import numpy as np
from jaxtyping import Float

from ..manipulator import Manipulator
from ._search import NAMES, JointProblem
from ._simulation import JointLoads, inverse_dynamics, simulate_joint


MASS_STEP = 0.1
"""Change of the logarithm of the masses' scale, for derivatives."""
_MOVE = 0.002  # rad RMS, by which a step moves a joint: several times the roughness
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
    lengths: Sequence[np.ndarray],
) -> list[Float[np.ndarray, "samples all"]]:
    """Return for each joint the derivatives with respect to all unknowns, and the masses' scale.

    - `couplings`: of each recording, the joints moving as simulated.
    - `has_scale`: whether the scale is an unknown; its derivatives are zero otherwise.
    - `lengths`: steps of differences, of each joint's unknowns.
    """
    ends = np.cumsum([0, *[len(x) for x in unknowns]])
    size = int(ends[-1]) + 1
    steps = np.append(
        np.concatenate([problem.steps for problem in problems]),
        MASS_STEP,
    )
    # Zero positions, which change angles at unchanged readings.
    zeros = np.zeros((len(problems), size))
    for i, problem in enumerate(problems):
        if "offset" in problem.names:
            zeros[i, ends[i] + problem.names.index("offset")] = 1.0

    def alone(i: int) -> tuple[np.ndarray, np.ndarray]:
        problem, x = problems[i], unknowns[i]
        residuals, own = problem.linearised(x, lengths[i], masses)
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
                    push += couplings[n].mass[:, i, j, None] * accelerations(
                        other[part], motion.time
                    )
            loads = motion.loads(masses)
            before = residuals[part] + motion.position
            torques = np.abs(weight) + np.abs(push)
            pushed_by = _MOVE * row[0, NAMES.index("gain")]
            for k in np.flatnonzero(steps * np.max(torques, axis=0) > least):
                # Loads are linear in the unknown's change, which therefore may be any.
                change = pushed_by / math.sqrt(float(np.mean(torques[:, k] ** 2)))
                torque = loads.torque.copy()
                torque[:, 0] += change * weight[:, k]
                torque[:, 3] += change * push[:, k]
                pushed = simulate_joint(
                    JointLoads(torque, loads.inertia),
                    row,
                    motion.time,
                    motion.command,
                    motion.start,
                    longest_step=problems[i].longest_step,
                )[0]
                J[part, k] += (pushed - before) / change
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


def lengths_of_steps(
    problems: Sequence[JointProblem], derivatives: Sequence[Float[np.ndarray, "samples all"]]
) -> list[Float[np.ndarray, " unknowns"]]:
    """Return steps of differences that move each joint by `_MOVE`, as derivatives tell.

    They are at least those of `UNKNOWNS`, and at most the deviations of the prior.
    """
    lengths: list[np.ndarray] = []
    start = 0
    for problem, J in zip(problems, derivatives, strict=True):
        own = J[:, start : start + len(problem.names)]
        sizes = np.sqrt(np.mean(own**2, axis=0))
        wanted = _MOVE / np.maximum(sizes, 1e-12)
        lengths.append(np.clip(wanted, problem.steps, problem.deviations))
        start += len(problem.names)
    return lengths


def accelerations(
    positions: Float[np.ndarray, "samples all"], time: Float[np.ndarray, " samples"]
) -> Float[np.ndarray, "samples all"]:
    """Return second differences of positions; zeros at the ends."""
    interval = float(np.median(np.diff(time)))
    found = np.zeros_like(positions)
    found[1:-1] = np.diff(positions, 2, axis=0) / interval**2
    return found
