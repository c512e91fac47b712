"""Estimators by simulated motion: instrumental variables, and direct dynamics."""

import dataclasses

import numpy as np

from ..bodies import with_knowledge
from ..instruments import DirectDynamics, InstrumentalVariables
from ._estimator import AbstractEstimator, Fit, Judged
from ._least_squares import Regression
from ._problem import Problem


@dataclasses.dataclass(frozen=True)
class SimulatedMotion(AbstractEstimator):
    """Instruments from simulated motion, or torques alone with `DirectDynamics`.

    Of one recording, without possible bodies and systematic errors.

    - `method`: by settings of the problem, whatever its own.

    >>> import numpy as np, jaxcslc as jc
    >>> arm = jc.Manipulator.from_modified_dh([(0, 0, 0, 0)], gravity=(0, 0, -9.81))
    >>> network = jc.derive(arm.with_friction("viscous"), lengths="numeric")
    >>> t = np.arange(800)[:, None] * 0.005
    >>> torque = 0.5 * -4 * np.sin(2 * t) + 0.2 * 2 * np.cos(2 * t)
    >>> recording = jc.Recording(t[:, 0], np.sin(2 * t), torque)
    >>> estimator = SimulatedMotion(jc.InstrumentalVariables(iterations=5))
    >>> report = jc.identify(network, recording, settings=jc.Settings(), estimator=estimator)
    >>> np.round(report.k, 3).tolist()
    [0.5, 0.2]
    """

    method: InstrumentalVariables | DirectDynamics = dataclasses.field(
        default_factory=InstrumentalVariables
    )

    @property
    def supports(self) -> frozenset[str]:
        return frozenset()

    def fit(self, problem: Problem) -> Fit:
        instruments = isinstance(self.method, InstrumentalVariables)
        words = "instrumental variables" if instruments else "direct dynamics"
        problem.step(words)
        settings = problem.settings.with_options(torque_lag=0.0)
        method = dataclasses.replace(self.method, settings=settings)
        (recording,) = problem.on_time.values()
        result = method.fit(problem.network, recording, problem.start)
        warnings = [f"{words}: not converged after {result.steps} simulations"]
        tested = result.exogeneity
        return Fit(
            problem.network,
            result.fit,
            np.zeros(problem.network.joint_count),
            warnings=() if result.converged else tuple(warnings),
            notes=() if tested is None else (f"{words}: {tested}",),
        )

    def judged(self, problem: Problem) -> Judged:
        start = with_knowledge(Regression().fit(problem).identification, problem.known)
        return super().judged(dataclasses.replace(problem, start=start))
