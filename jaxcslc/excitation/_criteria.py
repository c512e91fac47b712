from collections.abc import Sequence
from typing import Any, Literal, get_args

import jax
import jax.numpy as jnp
import numpy as np
from jaxtyping import Array, Float, Int

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
    """What is known before a motion, in units of coefficients' sizes: earlier recordings'
    information, and each coefficient to about `weak` times its size."""
    total = np.eye(len(size)) / weak**2
    if information is not None:
        total = total + information * np.outer(size, size)
    return total
