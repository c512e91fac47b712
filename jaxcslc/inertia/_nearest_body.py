from dataclasses import dataclass

import numpy as np
from jaxtyping import Float

from ._bodies import body_of_pseudo_inertia, principal_body, pseudo_inertia
from ._coefficient_metric import whitening
from ._semidefinite import semidefinite_least_squares


# Of aluminium [kg/m³]: how large the ball is that a body of unknown shape is compared with.
_DENSITY = 2700.0
_LIGHTEST = 1e-3  # kg
# Standard errors that a change by the whole ball counts: it decides what the data leave open.
_WEIGHT = 1e-3


@dataclass(frozen=True, eq=False)
class _Estimate:
    k: Float[np.ndarray, "10"]
    covariance: Float[np.ndarray, "10 10"]
    undetermined: Float[np.ndarray, "rows 10"]


def nearest_body(
    body: Float[np.ndarray, "10"],
    covariance: Float[np.ndarray, "10 10"],
    undetermined: Float[np.ndarray, "rows 10"] | None = None,
    *,
    least: float = 1e-3,
) -> Float[np.ndarray, "10"] | None:
    """The body that can exist nearest to an estimate of its ten numbers (`BODY`).

    The semidefinite programme of `physical_parameters` for one body: nearest in standard errors
    of `covariance`, on the combinations that are determined; along the `undetermined` ones,
    nearest to an aluminium ball of the estimate's mass around its centre. An estimate that can
    exist is its own answer, but for rounding.

    **Arguments**

    - `body`, `covariance`: the estimate, and how uncertain it is.
    - `undetermined`: combinations that the data do not determine; none if omitted.
    - `least`: the body holds at least this part of such a ball (eigenvalues of its
      pseudo-inertia, in units of the ball's).

    **Returns**

    - Ten numbers of the body; None if the solver fails.

    **Raises**

    - `ImportError`: without the conic solver, where the estimate cannot exist.

    >>> import numpy as np
    >>> body = nearest_body(np.array([-0.1, 1, 1, 0, 0, 0, 0.5, 0, 0, 2.0]), np.eye(10))
    >>> bool(np.all(np.linalg.eigvalsh(pseudo_inertia(body)) > 0))
    True
    """
    if undetermined is None:
        undetermined = np.zeros((0, 10))
    ball = _ball(body, covariance)
    unit = in_units_of(ball)
    estimate = _Estimate(body, covariance, undetermined)
    white = whitening(estimate, np.linalg.norm(unit, axis=1))
    solution, _ = semidefinite_least_squares(
        np.concatenate([white @ unit, _WEIGHT * np.eye(16)]),
        np.concatenate([white @ body, _WEIGHT * np.eye(4).ravel()]),
        np.zeros((0, 16)),
        np.zeros(0),
        bodies=1,
        bounded=np.zeros(0),
        least=least,
    )
    return None if solution is None else unit @ solution


def in_units_of(body: Float[np.ndarray, "10"]) -> Float[np.ndarray, "10 16"]:
    """From the entries of J̃ to the ten numbers of J = L J̃ Lᵀ, with L Lᵀ those of `body`."""
    scale = np.linalg.cholesky(pseudo_inertia(body))
    columns: list[np.ndarray] = []
    for entry in np.eye(16):
        matrix = scale @ entry.reshape(4, 4) @ scale.T
        columns.append(body_of_pseudo_inertia((matrix + matrix.T) / 2))
    return np.stack(columns, axis=1)


def _ball(
    body: Float[np.ndarray, "10"], covariance: Float[np.ndarray, "10 10"]
) -> Float[np.ndarray, "10"]:
    """A ball around the estimate's centre, of its mass or the mass's error, whichever is more."""
    mass = max(float(body[9]), float(np.sqrt(max(covariance[9, 9], 0.0))), _LIGHTEST)
    radius = (3.0 * mass / (4.0 * np.pi * _DENSITY)) ** (1.0 / 3.0)
    return principal_body(mass, body[6:9] / mass, np.full(3, mass * radius**2 / 5.0))
