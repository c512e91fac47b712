"""The estimators `InstrumentalVariables` (IDIM-IV) and `DirectDynamics` (DIDIM).

Both run the loop of `_simulation_fit`.
"""

import dataclasses
from collections.abc import Callable

from ..least_squares import Identification, Settings
from ..network import CSLC
from ..recordings import Recording
from ._projected_equations import projected_fit
from ._simulated_motion import AbstractSimulatedMotion, ControlledMotion, CorrectedMotion
from ._simulation_fit import (
    ExogeneityTest,
    Simulated,
    SimulationFit,
    both_masks,
    exogeneity_test,
    fit_by_simulation,
)


@dataclasses.dataclass(frozen=True)
class InstrumentalVariables:
    """Identification by instruments from simulated motion: IDIM-IV.

    Noise of positions is in the regressor X and, through it, in the residual: least squares is
    biased, the more the less is smoothed. The regressor Z of motion that was simulated with the
    identified model is nearly that of the true motion, and independent of the noise:

        Zᵀ W² (torque - X k) = 0

    has no such bias. Each solution is simulated in turn (Janot, Vandanjon and Gautier, 'A generic
    instrumental variable approach for industrial robot identification', IEEE Transactions on
    Control Systems Technology 22, 2014). Noise that changes signs of velocities remains: slow pairs
    are left out, as of least squares.

    **Attributes**

    - `motion`: how the arm is simulated: `ControlledMotion` where controller and reference of the
      recording are known, `CorrectedMotion` otherwise.
    - `settings`: by which X is prepared, and its fit; None for the defaults of `Settings`.
    - `iterations`: simulations at most.

    **Raises** `ValueError`: no iterations.

    >>> import numpy as np, jaxcslc as jc
    >>> arm = jc.Manipulator.from_modified_dh([(0, 0, 0, 0)], gravity=(0, 0, -9.81))
    >>> network = jc.derive(arm.with_friction("viscous"), lengths="numeric")
    >>> t = np.arange(2000)[:, None] * 0.005
    >>> torque = 0.5 * -4 * np.sin(2 * t) + 0.2 * 2 * np.cos(2 * t)
    >>> noise = 2e-4 * np.random.default_rng(0).standard_normal(t.shape)
    >>> recording = jc.Recording(t[:, 0], np.sin(2 * t) + noise, torque)
    >>> rough = jc.Settings(jc.Preparation(jc.recordings.CentralDifferences()))
    >>> result = jc.InstrumentalVariables(settings=rough).fit(network, recording)
    >>> np.round(result.k, 2).tolist(), round(float(result.least_squares.k[0]), 2)
    ([0.5, 0.2], 0.12)
    >>> result.exogeneity.p_value < 1e-6
    True
    """

    motion: AbstractSimulatedMotion = dataclasses.field(default_factory=CorrectedMotion)
    settings: Settings | None = None
    iterations: int = 10

    def __post_init__(self) -> None:
        check_iterations(self.iterations)

    def fit(
        self,
        network: CSLC,
        recording: Recording,
        start: Identification | None = None,
        progress: Callable[[str], None] | None = None,
    ) -> SimulationFit:
        """The coefficients of a recording, and a test of whether least squares has a bias.

        **Arguments**

        - `network`: n joints, p coefficients, with its slopes of static friction; without a
          payload.
        - `recording`: sampled uniformly.
        - `start`: coefficients of the first simulation; by default those of least squares. Where
          they are of no body that can exist, those of the nearest bodies are simulated.
        - `progress`: is called with a few words at each stage.

        **Returns** a `SimulationFit`; look at `converged` and `exogeneity`.

        **Raises**

        - `ValueError`: recording and network differ in joints, the network has a payload, times
          that are not uniform, a loss other than squares, or as `AbstractSimulatedMotion.simulate`.
        - `RuntimeError`: a fit that fails, or simulated motion that leaves the recorded one.
        """
        settings = (self.settings or Settings()).for_network(network)

        def solve(motion: Simulated) -> tuple[Identification, ExogeneityTest]:
            measured, simulated = both_masks(motion)
            solver = settings.solver
            equations, instruments = (
                solver.equations(network, patterns) for patterns in (measured, simulated)
            )
            result = projected_fit(equations, instruments, solver, measured.samples)
            return result.fit, exogeneity_test(equations, result)

        return fit_by_simulation(
            network, recording, self.motion, settings, start, self.iterations, solve, progress
        )


def check_iterations(iterations: int) -> None:
    """**Raises** `ValueError` for fewer than one."""
    if iterations < 1:
        raise ValueError(f"iterations is {iterations}; expected 1 or more")


@dataclasses.dataclass(frozen=True)
class DirectDynamics:
    """Identification from torques alone, by simulated motion: DIDIM.

    The simulated arm follows the reference of the recording under its controller; its torque is
    compared with the recorded one. Because the controller makes simulated motion nearly independent
    of the coefficients, the derivative of that torque is nearly the regressor Z of simulated
    motion, and Gauss and Newton's step is an ordinary regression

        min ‖W (torque - Z k)‖

    Each solution is simulated in turn (Gautier, Janot and Vandanjon, 'A new closed-loop output
    error method for parameter identification of robot dynamics', IEEE Transactions on Control
    Systems Technology 21, 2013). No recorded position is used, but for the first simulation and to
    see that the simulated arm follows. With a controller or reference that is not the recording's,
    Z is of another motion than the torques, and the fit is biased.

    **Attributes**

    - `motion`: controller and reference of the recording.
    - `settings`: alignment of torques, masks and fit; None for the defaults of `Settings`.
    - `iterations`: simulations at most.

    **Raises** `ValueError`: no iterations.

    >>> import numpy as np, jaxcslc as jc
    >>> from jaxcslc.control import PID, Reference
    >>> arm = jc.Manipulator.from_modified_dh([(0, 0, 0, 0)], gravity=(0, 0, -9.81))
    >>> network = jc.derive(arm.with_friction("viscous"), lengths="numeric")
    >>> t = np.arange(1000)[:, None] * 0.002
    >>> desired = Reference(0.5 - 0.5 * np.cos(4 * t), 2 * np.sin(4 * t), 8 * np.cos(4 * t))
    >>> pid = PID(1, position_gain=200.0, velocity_gain=20.0)
    >>> motion = jc.instruments.ControlledMotion(pid, desired)
    >>> true = np.array([0.5, 0.2])
    >>> start = jc.Recording(t[:, 0], desired.q, desired.q)
    >>> q, qd, qdd = motion.simulate(network, true, start, jc.Settings())
    >>> recording = jc.Recording(t[:, 0], q, 0.5 * qdd + 0.2 * qd)
    >>> result = jc.DirectDynamics(motion).fit(network, recording)
    >>> np.round(result.k, 2).tolist()
    [0.5, 0.2]
    """

    motion: ControlledMotion
    settings: Settings | None = None
    iterations: int = 10

    def __post_init__(self) -> None:
        check_iterations(self.iterations)

    def fit(
        self,
        network: CSLC,
        recording: Recording,
        start: Identification | None = None,
        progress: Callable[[str], None] | None = None,
    ) -> SimulationFit:
        """The coefficients of a recording's torques.

        **Arguments**, **Raises**: as of `InstrumentalVariables.fit`.

        **Returns** a `SimulationFit` without a test.
        """
        settings = (self.settings or Settings()).for_network(network)

        def solve(motion: Simulated) -> tuple[Identification, None]:
            return settings.fit(network, motion.simulated), None

        return fit_by_simulation(
            network, recording, self.motion, settings, start, self.iterations, solve, progress
        )
