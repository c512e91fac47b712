import numpy as np

from ..inertia import link_of, nearest_body
from ..motion import Patterns
from ..network import CSLC
from ._payload_fit import PayloadFit
from ._reidentification import reidentify
from .solver import Identification, LeastSquares, Previous


def fit_payload(
    network: CSLC,
    loaded: Patterns,
    unloaded: Patterns | None = None,
    previous: Previous | None = None,
    *,
    solver: LeastSquares | None = None,
    throw: bool = True,
) -> PayloadFit:
    """The ten inertial parameters of a payload from a recording of the loaded arm (thesis 8.2.4).

    A payload and the link that carries it are one rigid body: a recording of the loaded arm alone
    cannot tell them apart. What the arm weighs without it must come from elsewhere, so one of two
    more things is needed:

    - `unloaded`, a recording of the arm without it: the coefficients of both are fitted to both
      recordings together. Payload columns of the unloaded one are zero.
    - `previous`, an earlier identification of the arm, whose coefficients stay fixed
      (`reidentify(..., groups=("payload",))`). If it is an `Identification`, its uncertainty
      counts: the payload's covariance includes what errors of the arm's coefficients do to it.

    The payload is in the frame of the link that carries it, the last one unless the network says
    otherwise (`with_payload`). Friction that changes with the load, and an arm whose friction has
    changed since it was identified, are taken for payload as far as they look like one.

    **Arguments**

    - `network`: of the arm, with or without payload.
    - `loaded`, `unloaded`: patterns (samples, n).
    - `previous`: an `Identification` of the arm, or its coefficients, which then count as exact.
    - `solver`: options of the fit; the defaults of `LeastSquares` if None.
    - `throw`: as of `LeastSquares.fit`.

    **Returns** a `PayloadFit`. Runs on the host; with `unloaded` it keeps the equations of both
    recordings in memory.

    **Raises**

    - `ValueError`: unless one of `unloaded` and `previous` is passed; for another network's
      coefficients; or as `LeastSquares.fit`.
    - `RuntimeError`: as `LeastSquares.fit`.

    >>> import numpy as np, jaxcslc as jc
    >>> robot = jc.puma560()
    >>> network = jc.derive(robot)
    >>> arm = network.coefficients_from(robot.links, viscous=robot.viscous, dry=robot.dry)
    >>> body = jc.LinkParameters(1.5, np.array([0.02, 0.0, 0.1]), 2e-3 * np.eye(3))
    >>> carried = network.with_payload()
    >>> k = carried.coefficients_from(
    ...     robot.links, viscous=robot.viscous, dry=robot.dry, payload=body
    ... )
    >>> q, qd, qdd = np.random.default_rng(0).uniform(-2, 2, (3, 100, 6))
    >>> pairs = np.ones(q.shape, bool)
    >>> time, torque = 0.1 * np.arange(100), carried.torque(k, q, qd, qdd)
    >>> patterns = jc.Patterns(time, q, qd, qdd, torque, pairs, pairs)
    >>> fit = jc.fit_payload(network, patterns, previous=arm)
    >>> round(float(fit.mass), 6), np.round(fit.centre_of_gravity, 6).tolist()
    (1.5, [0.02, 0.0, 0.1])
    """
    if unloaded is not None and previous is not None:
        raise ValueError("fit_payload: got both unloaded and previous; expected one of them")
    if unloaded is None and previous is None:
        raise ValueError(
            "fit_payload: a loaded recording alone cannot tell payload and last link apart;"
            " expected one of unloaded and previous"
        )
    whole = network.with_payload() if network.payload is None else network
    solver = solver or LeastSquares()
    if previous is not None:
        fit = reidentify(whole, loaded, previous, groups=("payload",), solver=solver, throw=throw)
    else:
        assert unloaded is not None
        payload = whole.layout.indices("payload").tolist()
        alone = solver.equations(whole, unloaded).without(payload)
        both = solver.equations(whole, loaded).followed_by(alone, loaded.samples)
        fit = solver.fit_equations(both, loaded.samples + unloaded.samples, throw=throw)
    body = _possible(fit, whole.layout.payload)
    return PayloadFit(fit, None if body is None else link_of(body))


def _possible(fit: Identification, payload: slice) -> np.ndarray | None:
    covariance = np.asarray(fit.independent_covariance)[payload, payload]
    body = np.asarray(fit.k)[payload]
    if not (np.all(np.isfinite(covariance)) and np.all(np.isfinite(body))):
        return None
    return nearest_body(body, covariance, np.asarray(fit.undetermined)[:, payload])
