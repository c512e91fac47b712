"""Criteria that a design minimises, and the knowledge of coefficients before the motion."""

import dataclasses
from collections.abc import Sequence
from typing import Any, Literal, get_args

import jax
import jax.numpy as jnp
import numpy as np
from jaxtyping import Array, Float, Int

from ..bodies import information_rows
from ..least_squares import Identification
from ..network import CSLC
from ._information import Moments, Square, error_covariance
from ._task import BodyPrior


Criterion = Literal[
    "overall", "error", "worst", "torque", "bodies", "A", "D", "E", "condition", "scaled_condition"
]
CRITERIA: tuple[Criterion, ...] = get_args(Criterion)
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


def log_criterion(
    criterion: str,
    moments: Moments,
    prior: Any,
    wanted: Int[Array | np.ndarray, " wanted"],
    task: Any,
) -> Any:
    """The natural logarithm of what a design minimises, differentiable.

    Standard errors are those after the motion, with what was known before: every coefficient to
    about its own size, which keeps those that no motion determines from governing the sum.

    **Arguments**

    - `criterion`: one of `CRITERIA`; `EXPLANATIONS` says what they are.
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
    """(numbers,) of links' numbers after a motion, over those before.

    **Arguments**

    - `prior`: (p, p) information of coefficients, of `prior_information`; bodies bring their own in
      place of its weak one.
    """
    to, weak = bodies.to_coefficients, jnp.eye(prior.shape[0])
    of_bodies = lambda matrix: to.T @ matrix @ to
    known = of_bodies(prior - weak) + jnp.eye(to.shape[1])
    changes = Moments(of_bodies(moments.normal), of_bodies(moments.spread), moments.plain)
    covariance = error_covariance(changes, known)
    return jnp.sum((bodies.to_numbers @ covariance) * bodies.to_numbers, axis=1)


def wanted_indices(network: CSLC, names: Sequence[str] | None) -> Int[np.ndarray, " wanted"]:
    """Indices of coefficients by name, group or kind of term; of all if None.

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
            indices |= set(range(*layout.of(name).indices(layout.size)))
        elif name in layout.groups:
            indices |= {i for i, x in enumerate(layout.coefficients) if x.group == name}
        else:
            expected = ", ".join(dict.fromkeys((*layout.groups, *layout.kinds)))
            raise ValueError(
                f"{name!r} is no coefficient or group of {network.name!r}; expected names or some"
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
        """The coefficients of the robot's own links and friction; of robots whose file has no
        masses, no model."""
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

    def after(
        self, covariance: Square, k: Float[Array | np.ndarray, " coefficients"] | None = None
    ):
        """The knowledge once coefficients have a covariance (p, p), as a `Prediction` has it."""
        error = np.sqrt(np.maximum(np.diag(covariance), 0.0))
        unit = np.where(error > 0.0, error, 1.0)
        inverse = np.linalg.inv(covariance / np.outer(unit, unit)) / np.outer(unit, unit)
        return Knowledge(
            self.k if k is None else np.asarray(k, float), inverse, error, self.is_model
        )
