"""Motion on which torque is to be predicted, and links of the robot's file as a prior."""

from typing import Any, NamedTuple

import numpy as np
from jaxtyping import Float

from ..bodies import balls, body_map, body_of_pseudo_inertia, prior_of, pseudo_inertia
from ..network import CSLC
from ..recordings import Preparation, Recording
from ._families import Parameters, Times
from ._feasibility import DenseCheck
from ._information import MotionInformation, regressor_of


_TASKS, _TASK_STRIDE = 40, 5  # random motions on which torques matter, samples apart


def random_parameters(
    check: DenseCheck,
    pose: Float[np.ndarray, " joints"],
    rng: np.random.Generator,
    spread: float | None = None,
) -> Parameters:
    """A random motion about a pose that keeps limits of positions and derivatives, by nine tenths.

    **Arguments**

    - `check`: of limits, with the family of the motion.
    - `pose`: (n,) positions [rad or m].
    - `rng`: what it is drawn from.
    - `spread`: of its start about the pose, as a part of the ranges; a tenth if None.

    **Returns** the family's parameters, (parameters, n).

    >>> import numpy as np, jaxcslc as jc
    >>> from jaxcslc.excitation import BSplines, DenseCheck, Limits, random_parameters
    >>> arm = jc.Manipulator.from_modified_dh([(0, 0, 0, 0)], gravity=(0, 0, -9.81))
    >>> limits = Limits.of(arm, {"position": [-1, 1], "velocity": 2})
    >>> family = BSplines(5.0, 10)
    >>> check = DenseCheck(jc.derive(arm, lengths="numeric"), None, limits, family)
    >>> parameters = random_parameters(check, np.zeros(1), np.random.default_rng(0))
    >>> q, qd, _ = family.motion(parameters, np.linspace(0.0, 5.0, 200))
    >>> bool(np.max(np.abs(q)) <= 1.0), bool(np.max(np.abs(qd)) <= 2.0)
    (True, True)
    """
    limits, family = check.limits, check.family
    half = (limits.high - limits.low) / 2
    parameters = half * rng.normal(0.0, 0.7, (family.size, len(half)))
    shift = (0.1 if spread is None else spread) * half * rng.uniform(-1.0, 1.0, len(half))
    parameters[0] = np.clip(pose + shift, limits.low + 0.1 * half, limits.high - 0.1 * half)
    if spread == 0.0:
        parameters[0] = pose
    return check.within_kinematic_limits(parameters, 0.9)


def random_products(
    information: MotionInformation,
    check: DenseCheck,
    k: Float[np.ndarray, " coefficients"] | None,
    time: Times,
    rng: np.random.Generator,
) -> Float[np.ndarray, "_ _"]:
    """Mean squared torque, over the noise's, of errors of coefficients, in states of random motions
    all over the ranges: those whose torques keep the limits.

    **Arguments**

    - `check`: of limits, with the family of the motions.
    - `k`: (p,) the model of torques; None if there is none.
    - `time`: of the motions.
    """
    limits, family = check.limits, check.family
    half = (limits.high - limits.low) / 2
    motions = [
        family.motion(random_parameters(check, limits.middle + half * pose, rng), time)
        for pose in rng.uniform(-0.8, 0.8, (_TASKS, len(half)))
    ]
    states = (np.concatenate(x)[::_TASK_STRIDE] for x in zip(*motions, strict=True))
    regressor = regressor_of(information.network, *states)
    if k is not None:
        within = np.all(np.abs(regressor @ k) <= limits.usable_torque, axis=1)
        regressor = regressor[within | (not within.any())]
    return _products(information, regressor)


def task_products(information: MotionInformation, task: Any) -> Float[np.ndarray, "_ _"]:
    """Mean squared torque, over the noise's, of errors of coefficients on a motion."""
    if isinstance(task, Recording):
        task = Preparation().derivatives(task)
    return _products(information, regressor_of(information.network, *task))


def _products(
    information: MotionInformation, regressor: Float[np.ndarray, "samples joints coefficients"]
) -> Float[np.ndarray, "_ _"]:
    deviation = information.noise.torque_deviation(information.network.joint_count)
    rows = regressor * information.size / deviation[:, None]
    rows = rows.reshape(-1, information.network.size)
    return rows.T @ rows / len(regressor)


class BodyPrior(NamedTuple):
    """Links as the robot's file has them, uncertain by about themselves.

    A body's pseudo-inertia is J = L (1 + X) Lᵀ, with L Lᵀ that of the file, X symmetric, and
    independent standard deviations of 1 (of diagonal entries √2): changes of mass, centre and
    inertia count by the body's own size, whatever the axes. Motor inertias and friction are
    uncertain by their sizes.

    **Attributes**

    - `to_coefficients`: (p, unknowns), of unit changes, in units of the coefficients' sizes.
    - `to_numbers`: (numbers, unknowns), of what each coefficient depends on: m, m c, and the
      inertia about the frame's origin, in units of their prior standard deviations.
    """

    to_coefficients: Any
    to_numbers: Any


def body_prior(network: CSLC, size: Float[np.ndarray, " coefficients"]) -> BodyPrior:
    """Make the prior of the links of the robot's file.

    **Raises**

    - `ValueError`: the file has no masses.
    """
    robot = network.robot
    if robot.links is None:
        raise ValueError(
            f"criterion 'bodies': the file of {robot.name!r} has no masses; expected links' masses,"
            " centres and inertias, or another criterion"
        )
    of_bodies, of_motors = body_map(network.algebra)
    inertial, links, numbers = of_bodies.shape
    changes = np.zeros((links, numbers, links, numbers))
    mass = float(np.mean([float(link.mass) for link in robot.links])) or 1.0
    # Links that the file has without mass, or flat, borrow what they lack.
    prior = prior_of(robot, robot.links, balls(robot, mass), np.zeros((links, numbers)))
    for link, body in enumerate(prior.bodies):
        changes[link, :, link] = _body_changes(body)
    others = np.eye(network.size)[:, inertial:]
    inertias = np.zeros((network.size, links))
    bodies = np.zeros((network.size, links * numbers))
    bodies[:inertial] = np.einsum("clk,lkx->cx", of_bodies, changes.reshape(links, numbers, -1))
    inertias[:inertial] = of_motors * prior.motor_scales
    to_coefficients = np.hstack([bodies / size[:, None], inertias / size[:, None], others])
    seen = np.any(of_bodies != 0.0, axis=0).ravel()
    rows = changes.reshape(links * numbers, -1)[seen]
    rows /= np.linalg.norm(rows, axis=1, keepdims=True)
    unknowns = to_coefficients.shape[1]
    return BodyPrior(to_coefficients, np.pad(rows, ((0, 0), (0, unknowns - rows.shape[1]))))


def _body_changes(body: Float[np.ndarray, "10"]) -> Float[np.ndarray, "10 10"]:
    """Return derivatives of the ten numbers by a pseudo-inertia in its own units."""
    root = np.linalg.cholesky(pseudo_inertia(body))
    columns: list[np.ndarray] = []
    for i in range(4):
        for j in range(i + 1):
            unit = np.zeros((4, 4))
            unit[i, j] = unit[j, i] = 1.0 if i != j else np.sqrt(2.0)
            columns.append(body_of_pseudo_inertia(root @ unit @ root.T))
    return np.stack(columns, axis=1)
