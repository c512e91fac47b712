from collections.abc import Callable

import numpy as np

from ..motion import Recording
from ..network import CSLC
from ._offline import fit_payload
from ._problem import recording_named
from ._settings import Settings
from .report import PayloadReport, compare
from .selection import choose_settings
from .solver import Previous


def identify_payload(
    network: CSLC,
    loaded: Recording,
    unloaded: Recording | None = None,
    settings: Settings | None = None,
    *,
    previous: Previous | None = None,
    progress: Callable[[str], None] | None = None,
) -> PayloadReport:
    """Identifies a payload from a recording of the arm that carries it.

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
