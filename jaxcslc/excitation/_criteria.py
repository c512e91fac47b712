"""Criteria that a design minimises: their goal, prior knowledge and the motion to predict.

A criterion makes one number of a motion's `Moments` (`_information`), given what is known before
(`Knowledge`) and what the motion is for (`Goal`).
"""

import dataclasses
from collections.abc import Sequence
from typing import Any, Literal, NamedTuple, get_args

import jax
import jax.numpy as jnp
import numpy as np
from jaxtyping import Array, Float, Int

from ..bodies import (
    balls,
    body_map,
    body_of_pseudo_inertia,
    information_rows,
    prior_of,
    pseudo_inertia,
)
from ..least_squares import Identification
from ..network import CSLC
from ..recordings import Preparation, Recording
from ._families import Parameters, Times
from ._feasibility import DenseCheck
from ._information import Moments, MotionInformation, Square, error_covariance, motion_regressor


Criterion = Literal[
    "overall", "error", "worst", "torque", "bodies", "A", "D", "E", "condition", "scaled_condition"
]
CRITERIA: tuple[Criterion, ...] = get_args(Criterion)
"""Names of the criteria that a design can minimise."""
ON_TASK = ("overall", "torque")  # criteria that a task enters
EXPLANATIONS: dict[str, str] = {
    "overall": "geometric mean of standard error over size and of torque errors on the task",
    "error": "mean standard error over size",
    "worst": "largest standard error over size, as a norm of eighth order",
    "A": "root mean square standard error over size",
    "D": "geometric mean of the principal standard errors over size",
    "E": "largest principal standard error over size",
    "torque": "standard deviation of torque predicted on the task, over the noise",
    "bodies": "root mean square error of links' numbers over what the file's bodies leave open",
    "condition": "condition number of the regressor in SI units",
    "scaled_condition": "condition number of the regressor with columns of unit length",
}
"""Meaning of each criterion, in words."""


@dataclasses.dataclass(frozen=True, eq=False)
class Goal:
    """Goal of a design: criterion, coefficients that matter, and a task.

    **Attributes**

    - `criterion`: one of `CRITERIA`; `EXPLANATIONS` says what they are.
    - `wanted`: names, groups or kinds of coefficients that matter; all if None.
    - `task`: motion on which torques are to be predicted, a recording or (`q`, `qd`, `qdd`), for
      the criteria `"overall"` and `"torque"`; random motions within the limits if None.

    **Raises**

    - `ValueError`: another criterion, or a task for a criterion without one.

    >>> from jaxcslc.excitation import Goal
    >>> Goal("worst", wanted=["viscous", "dry"]).task is None
    True
    """

    criterion: str = "overall"
    wanted: Sequence[str] | None = None
    task: Recording | tuple[Any, Any, Any] | None = None

    def __post_init__(self) -> None:
        if self.criterion not in CRITERIA:
            raise ValueError(f"criterion: expected {', '.join(CRITERIA)}, got {self.criterion!r}")
        if self.task is not None and self.criterion not in ON_TASK:
            raise ValueError(
                f"criterion {self.criterion!r} has no task; expected {' or '.join(ON_TASK)}, or no"
                " task"
            )


_TASKS, _TASK_STRIDE = 40, 5  # random motions on which torques matter, samples apart


def random_parameters(
    check: DenseCheck,
    pose: Float[np.ndarray, " joints"],
    rng: np.random.Generator,
    spread: float | None = None,
) -> Parameters:
    """Return a random motion about a pose, within nine tenths of the kinematic limits.

    **Arguments**

    - `check`: of limits, with the family of the motion.
    - `pose`: (n,) positions [rad or m].
    - `rng`: what it is drawn from.
    - `spread`: of its start about the pose, as a part of the ranges; a tenth if None.

    **Returns** the family's parameters, (parameters, n).

    >>> import numpy as np, jaxcslc as jc
    >>> from jaxcslc.excitation import BSplines, DenseCheck, Limits, random_parameters
    >>> network = jc.derive(jc.examples.turntable(), lengths="numeric")
    >>> limits = Limits.of(network.robot, {"position": [-1, 1], "velocity": 2})
    >>> family = BSplines(5.0, 10)
    >>> check = DenseCheck(network, None, limits, family)
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
    """Return the mean squared torque, over the noise's, of coefficients' errors in random motions.

    Their poses are all over the ranges. Where there is a model `k` of torques, those states count
    whose torques keep the limits.
    """
    limits, family = check.limits, check.family
    half = (limits.high - limits.low) / 2
    motions = [
        family.motion(random_parameters(check, limits.middle + half * pose, rng), time)
        for pose in rng.uniform(-0.8, 0.8, (_TASKS, len(half)))
    ]
    states = (np.concatenate(x)[::_TASK_STRIDE] for x in zip(*motions, strict=True))
    regressor = motion_regressor(information.network, *states)
    if k is not None:
        within = np.all(np.abs(regressor @ k) <= limits.usable_torque, axis=1)
        regressor = regressor[within | (not within.any())]
    return _products(information, regressor)


def task_products(information: MotionInformation, task: Any) -> Float[np.ndarray, "_ _"]:
    """Return the mean squared torque, over the noise's, of coefficients' errors on a motion."""
    if isinstance(task, Recording):
        task = Preparation().derivatives(task)
    return _products(information, motion_regressor(information.network, *task))


def _products(
    information: MotionInformation, regressor: Float[np.ndarray, "samples joints coefficients"]
) -> Float[np.ndarray, "_ _"]:
    deviation = information.noise.torque_deviation(information.network.joint_count)
    rows = regressor * information.size / deviation[:, None]
    rows = rows.reshape(-1, information.network.size)
    return rows.T @ rows / len(regressor)


class BodyPrior(NamedTuple):
    """Links of the robot's file as prior knowledge, uncertain by about their own size.

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


def log_criterion(
    criterion: str,
    moments: Moments,
    prior: Any,
    wanted: Int[Array | np.ndarray, " wanted"],
    task: Any,
) -> Any:
    """Return the natural logarithm of what a design minimises, differentiably.

    Standard errors are those after the motion, with prior information. Every coefficient is known
    to about its own size before: those that no motion determines would else govern the sum.

    **Arguments**

    - `criterion`: as of `Goal`.
    - `moments`: of the motion.
    - `prior`: (p, p) information before it, in units of the coefficients' sizes.
    - `wanted`: indices of the coefficients that matter; others may have any error.
    - `task`: (p, p) mean squared torque of coefficients' errors, in the same units, for those of
      `ON_TASK`; of `"bodies"`, their `BodyPrior`.
    """
    if criterion in ("condition", "scaled_condition"):
        products = moments.plain[jnp.ix_(wanted, wanted)]
        if criterion == "scaled_condition":
            length = jnp.sqrt(jnp.diagonal(products)) + 1e-12
            products = products / (length[:, None] * length[None])
        values = jnp.linalg.eigvalsh(products)
        least = values[-1] * 1e-14
        return 0.5 * (jnp.log(values[-1]) - jnp.log(jnp.maximum(values[0], least)))
    if criterion == "bodies":
        return 0.5 * jnp.log(jnp.mean(body_variances(moments, prior, task)))
    part = error_covariance(moments, prior)[jnp.ix_(wanted, wanted)]
    variance = jnp.maximum(jnp.diagonal(part), 1e-30)
    mean_error = jnp.log(jnp.mean(jnp.sqrt(variance)))
    if criterion == "error":
        return mean_error
    if criterion in ON_TASK:
        of_torque = 0.5 * jnp.log(jnp.sum(part * task[jnp.ix_(wanted, wanted)]))
        # A product: whatever one of both could reach, and in which unit, does not matter.
        return of_torque if criterion == "torque" else 0.5 * (mean_error + of_torque)
    if criterion == "worst":
        return 0.125 * jax.scipy.special.logsumexp(4.0 * jnp.log(variance))
    if criterion == "A":
        return 0.5 * jnp.log(jnp.mean(variance))
    if criterion == "D":
        unit = jnp.sqrt(variance)
        return 0.5 * jnp.mean(
            jnp.log(jnp.maximum(jnp.linalg.eigvalsh(part / (unit[:, None] * unit[None])), 1e-30))
        ) + jnp.mean(jnp.log(unit))
    return 0.5 * jnp.log(jnp.linalg.eigvalsh(part)[-1])


def body_variances(moments: Moments, prior: Any, bodies: BodyPrior) -> Any:
    """Return the variances of links' numbers after a motion, over those before, (numbers,).

    `prior` is of `prior_information`; bodies bring their own instead of its weak one.
    """
    to, weak = bodies.to_coefficients, jnp.eye(prior.shape[0])
    of_bodies = lambda matrix: to.T @ matrix @ to
    known = of_bodies(prior - weak) + jnp.eye(to.shape[1])
    changes = Moments(of_bodies(moments.normal), of_bodies(moments.spread), moments.plain)
    covariance = error_covariance(changes, known)
    return jnp.sum((bodies.to_numbers @ covariance) * bodies.to_numbers, axis=1)


def wanted_indices(network: CSLC, names: Sequence[str] | None) -> Int[np.ndarray, " wanted"]:
    """Return the indices of coefficients by name, group or kind of term; of all if None.

    **Raises**

    - `ValueError`: a name that is none of these.

    >>> import jaxcslc as jc
    >>> wanted_indices(jc.derive(jc.puma560()), ["viscous", "kd5"]).tolist()
    [31, 32, 33, 34, 35, 36, 41]
    """
    if names is None:
        return np.arange(network.size)
    indices: set[int] = set()
    layout = network.layout
    for name in names:
        if name in layout.names:
            indices.add(layout.names.index(name))
        elif name in layout.kinds:
            indices |= set(range(*layout.term_slice(name).indices(layout.size)))
        elif name in layout.groups:
            indices |= {i for i, x in enumerate(layout.coefficients) if x.group == name}
        else:
            expected = ", ".join(dict.fromkeys((*layout.groups, *layout.kinds)))
            raise ValueError(
                f"{network.name!r} has no coefficient or group {name!r}; expected names or some"
                f" of {expected}"
            )
    return np.array(sorted(indices), int)


def prior_information(
    size: Float[np.ndarray, " coefficients"],
    information: Square | None,
    weak: float = 1.0,
) -> Square:
    """Compute the information before a motion, in units of coefficients' sizes.

    It is the information of earlier recordings, and each coefficient to about `weak` times its
    size.
    """
    total = np.eye(len(size)) / weak**2
    if information is not None:
        total = total + information * np.outer(size, size)
    return total


@dataclasses.dataclass(frozen=True, eq=False)
class Knowledge:
    """Knowledge of a robot's coefficients before a motion is designed.

    **Attributes**

    - `k`: (p,) coefficients: sizes, and the model by which torques are foreseen.
    - `information`: (p, p) the inverse of their covariance, 0 where nothing is known; None if
      nothing is known of any.
    - `standard_error`: (p,) of `k`; infinite where nothing is known.
    - `is_model`: whether `k` is a model of the robot; False where sizes alone are guessed.

    >>> import jaxcslc as jc
    >>> from jaxcslc.excitation import Knowledge
    >>> knowledge = Knowledge.of_robot(jc.derive(jc.puma560()))
    >>> knowledge.is_model, knowledge.information
    (True, None)
    """

    k: Float[np.ndarray, " coefficients"]
    information: Square | None
    standard_error: Float[np.ndarray, " coefficients"]
    is_model: bool = True

    @classmethod
    def of_robot(cls, network: CSLC) -> "Knowledge":
        """Return the coefficients of the file's links and friction; no model without masses."""
        robot = network.robot
        unknown = np.full(network.size, np.inf)
        if robot.links is None:
            return cls(np.zeros(network.size), None, unknown, is_model=False)
        values = {"viscous": robot.viscous, "dry": robot.dry}
        friction: dict[str, Any] = {
            kind: value
            for kind, value in values.items()
            if value is not None and kind in network.layout.kinds
        }
        k = np.asarray(network.coefficients_from(robot.links, **friction))
        return cls(k, None, unknown)

    @classmethod
    def of_fit(cls, network: CSLC, fit: Identification) -> "Knowledge":
        """Make the knowledge that an earlier identification of the same network gives.

        **Raises**

        - `ValueError`: it is of another network.
        """
        if fit.names != network.names:
            raise ValueError(
                f"prior identification: has coefficients {fit.names[0]} to {fit.names[-1]};"
                f" {network.name!r} has {network.names[0]} to {network.names[-1]}"
            )
        k = np.asarray(fit.k, float)
        rows = information_rows(fit, k)
        # Correlations are those for independent errors, standard errors those that the fit reports.
        independent = np.diag(np.asarray(fit.independent_covariance))
        variance = np.diag(np.asarray(fit.covariance))
        counted = (independent > 0.0) & (variance > 0.0)
        ratio = np.divide(variance, independent, out=np.ones_like(variance), where=counted)
        rows = rows / np.sqrt(ratio)
        return cls(k, rows.T @ rows, np.asarray(fit.standard_error))

    def with_payload(self, network: CSLC, mass: float) -> "Knowledge":
        """Return the knowledge with a payload of which only an approximate mass is known.

        The mass serves to foresee torques, and is no prior.

        **Arguments**

        - `network`: with a payload, `network.with_payload()`.
        - `mass`: of the payload, a point at the origin of the frame that carries it [kg].

        **Raises**

        - `ValueError`: the network has no payload or other coefficients beside it; a negative mass.

        >>> import jaxcslc as jc
        >>> from jaxcslc.excitation import Knowledge
        >>> network = jc.derive(jc.puma560())
        >>> loaded = network.with_payload()
        >>> knowledge = Knowledge.of_robot(network).with_payload(loaded, 2.0)
        >>> dict(zip(loaded.names, knowledge.k.tolist()))["pm"]
        2.0
        """
        layout = network.layout
        added = layout.size - len(self.k)
        if layout.payload != slice(len(self.k), layout.size) or not added:
            raise ValueError(
                f"payload: expected a network with {len(self.k)} coefficients and a payload's ten,"
                f" got {layout.size} coefficients"
            )
        if not 0.0 <= mass < np.inf:
            raise ValueError(f"payload: mass is {mass}; expected 0 kg or more")
        k = np.pad(self.k, (0, added))
        k[layout.names.index("pm")] = mass
        information = None if self.information is None else np.pad(self.information, (0, added))
        error = np.pad(self.standard_error, (0, added), constant_values=np.inf)
        return Knowledge(k, information, error, self.is_model)
