"""Identification of a payload from patterns (`fit_payload`) or recordings (`identify_payload`)."""

from collections.abc import Callable

import numpy as np

from ..bodies import link_of, nearest_body
from ..identification import recording_named
from ..least_squares import Identification, LeastSquares, Previous, Settings, reidentify
from ..network import CSLC
from ..recordings import Patterns, Recording
from ..report import compare
from ..selection import choose_settings
from ._fit import PayloadFit
from ._report import PayloadReport


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


def identify_payload(
    network: CSLC,
    loaded: Recording,
    unloaded: Recording | None = None,
    settings: Settings | None = None,
    *,
    previous: Previous | None = None,
    progress: Callable[[str], None] | None = None,
) -> PayloadReport:
    """Identify a payload from a recording of the arm that carries it.

    `jaxcslc payload` prints and saves the report that this function returns.

    **Arguments**

    - `network`: of the arm, with or without a payload's coefficients.
    - `loaded`: the recording with the payload.
    - `unloaded`: a recording without it: the arm's coefficients are then fitted to both recordings.
    - `settings`: of preparation and fit; by default those that `choose_settings` finds for the
      loaded recording.
    - `previous`: an identification of the arm, or its coefficients, which are fixed at them. Give
      one of `unloaded` and `previous`.
    - `progress`: is called with a few words at the start of each step.

    **Returns** a `PayloadReport`.

    **Raises**

    - `ValueError`: both or none of `unloaded` and `previous`; a recording that cannot be used, with
      its name, loaded or unloaded; or as `fit_payload`.
    - `RuntimeError`: as `fit_payload`.

    >>> import numpy as np, jaxcslc as jc
    >>> robot = jc.puma560()
    >>> network, friction = jc.derive(robot).with_payload(), {"viscous": robot.viscous}
    >>> body = jc.LinkParameters(1.5, np.array([0.02, 0.0, 0.1]), 2e-3 * np.eye(3))
    >>> k = network.coefficients_from(robot.links, payload=body, **friction)
    >>> t, rate = np.arange(500)[:, None] * 0.01, np.arange(1.0, 7.0)
    >>> q, qd, qdd = np.sin(rate * t), rate * np.cos(rate * t), -(rate**2) * np.sin(rate * t)
    >>> recording = jc.Recording(t[:, 0], q, np.asarray(network.torque(k, q, qd, qdd)))
    >>> report = jc.identify_payload(network, recording, settings=jc.Settings(), previous=k)
    >>> round(float(report.fit.mass), 2)
    1.5
    """
    step = progress or (lambda words: None)
    network = network.with_payload() if network.payload is None else network
    with recording_named("loaded recording"):
        if settings is None:
            step("choosing settings")
            settings = choose_settings(network, loaded).settings
        settings = settings.for_network(network)
        step("preparing patterns")
        patterns = settings.patterns(loaded)
    arm = None
    if unloaded is not None:
        with recording_named("unloaded recording"):
            arm = settings.patterns(unloaded)
    step("fitting coefficients")
    fit = fit_payload(network, patterns, arm, previous=previous, solver=settings.solver)
    step("computing errors")
    k = np.asarray(fit.fit.k)
    without = k.copy()
    without[network.layout.payload] = 0.0
    vectors = {"with": k, "without": without}
    return PayloadReport(network, settings, fit, patterns, compare(network, patterns, vectors))
