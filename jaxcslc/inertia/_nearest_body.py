from dataclasses import dataclass

import numpy as np
from jaxtyping import Float

from .._rank import numerical_rank
from ._bodies import body_of_pseudo_inertia, principal_body, pseudo_inertia
from ._coefficient_metric import whitening
from ._semidefinite import semidefinite_least_squares


# Of aluminium [kg/m³]: how large the ball is that a body of unknown shape is compared with.
_DENSITY = 2700.0
_LIGHTEST = 1e-3  # kg
# Farthest centre of the ball from the frame's origin [m]: an estimate of first moments without mass
# has none.
_FARTHEST = 1.0
# Sizes of typical numbers of a body [kg m², kg m, kg].
_SIZES = np.array([0.1] * 6 + [0.3] * 3 + [1.0])
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
    ball = _ball(body, covariance, undetermined)
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
    body: Float[np.ndarray, "10"],
    covariance: Float[np.ndarray, "10 10"],
    undetermined: Float[np.ndarray, "rows 10"],
) -> Float[np.ndarray, "10"]:
    """A ball around the estimate's centre, of its mass or the mass's error, whichever is more.

    Without what is not determined, or has an error larger than any body: there the estimate is
    arbitrary, and a centre may be kilometres away. The ball is as heavy as its first moments need
    it to be within 1 m.
    """
    error = np.sqrt(np.maximum(np.diag(covariance), 0.0)) / _SIZES
    scaled = body / _SIZES / (1.0 + error**2)
    open_ = undetermined[np.linalg.norm(undetermined, axis=1) > 0] / _SIZES
    if open_.size:
        basis = np.linalg.svd(open_, full_matrices=False)[2][: numerical_rank(open_.T)]
        scaled = scaled - basis.T @ (basis @ scaled)
    moment = _SIZES[6:9] * scaled[6:9]
    mass = max(
        float(_SIZES[9] * scaled[9]),
        float(_SIZES[9] * min(error[9], 1.0)),
        float(np.linalg.norm(moment)) / _FARTHEST,
        _LIGHTEST,
    )
    radius = (3.0 * mass / (4.0 * np.pi * _DENSITY)) ** (1.0 / 3.0)
    return principal_body(mass, moment / mass, np.full(3, mass * radius**2 / 5.0))
