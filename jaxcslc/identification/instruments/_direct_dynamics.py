import dataclasses
from collections.abc import Callable

from ...motion import Recording
from ...network import CSLC
from .._settings import Settings
from ..solver import Identification
from ._instrumental_variables import check_iterations
from ._simulated_motion import ControlledMotion
from ._simulation_fit import Simulated, SimulationFit, fit_by_simulation


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
    >>> motion = jc.identification.ControlledMotion(pid, desired)
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
