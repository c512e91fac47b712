import dataclasses
from collections.abc import Callable

from ...motion import Recording
from ...network import CSLC
from .._settings import Settings
from ..solver import Identification
from ._exogeneity import ExogeneityTest, exogeneity_test
from ._projected_equations import projected_fit
from ._simulated_motion import AbstractSimulatedMotion, CorrectedMotion
from ._simulation_fit import Simulated, SimulationFit, both_masks, fit_by_simulation


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
    >>> rough = jc.Settings(jc.Preparation(jc.motion.CentralDifferences()))
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
