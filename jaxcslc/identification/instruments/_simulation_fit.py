import dataclasses
from collections.abc import Callable
from typing import NamedTuple

import equinox as eqx
import jax.numpy as jnp
import numpy as np
from jaxtyping import Array, Float

from ..._environment import require_float64
from ...motion import Patterns, Recording
from ...network import CSLC
from .._settings import Settings
from ..possible import fixed_bodies, physical_parameters
from ..solver import Identification
from ._exogeneity import ExogeneityTest
from ._simulated_motion import AbstractSimulatedMotion, simulated_derivatives


# Fits that change by less than this part of their standard errors are the same.
_SAME = 0.05
# Without noise there is no error to compare with.
_ROUNDING = 1e-6


class SimulationFit(eqx.Module):
    """Coefficients from torques and simulated motion.

    **Attributes**

    - `network`: as it was; `fit`: its coefficients.
    - `least_squares`: the regression on measured motion that the first simulation is of.
    - `exogeneity`: the test of whether that regression is biased; None where there is none.
    - `distance`: (n,) root mean square of simulated minus recorded positions [rad or m].
    - `steps`: simulations; `converged`: whether the last one changed nothing beyond a twentieth of
      a standard error.

    >>> import numpy as np, jaxcslc as jc
    >>> arm = jc.Manipulator.from_modified_dh([(0, 0, 0, 0)], gravity=(0, 0, -9.81))
    >>> network = jc.derive(arm.with_friction("viscous"), lengths="numeric")
    >>> t = np.arange(800)[:, None] * 0.005
    >>> torque = 0.5 * -4 * np.sin(2 * t) + 0.2 * 2 * np.cos(2 * t)
    >>> recording = jc.Recording(t[:, 0], np.sin(2 * t), torque)
    >>> result = jc.InstrumentalVariables().fit(network, recording)
    >>> result.converged, result.fit.names, np.round(result.k, 3).tolist()
    (True, ('kB1', 'kv1'), [0.5, 0.2])
    """

    network: CSLC
    fit: Identification
    least_squares: Identification
    exogeneity: ExogeneityTest | None
    distance: Float[np.ndarray, " joints"]
    steps: int = eqx.field(static=True)
    converged: bool = eqx.field(static=True)

    @property
    def k(self) -> Float[Array, " coefficients"]:
        """The coefficients, (p,)."""
        return self.fit.k

    def __repr__(self) -> str:
        ended = "converged" if self.converged else "did not converge"
        tested = "" if self.exogeneity is None else f"; {self.exogeneity}"
        return f"SimulationFit({ended} after {self.steps} simulations{tested}; {self.fit})"


class Simulated(NamedTuple):
    """Motion under some coefficients, beside the measured motion of the same samples.

    - `measured`: patterns of the recording; `simulated`: those of the simulation.
    - `distance`: (n,) root mean square of their positions' difference.
    """

    measured: Patterns
    simulated: Patterns
    distance: Float[np.ndarray, " joints"]


def fit_by_simulation(
    network: CSLC,
    recording: Recording,
    motion: AbstractSimulatedMotion,
    settings: Settings,
    start: Identification | None,
    iterations: int,
    solve: Callable[[Simulated], tuple[Identification, ExogeneityTest | None]],
    progress: Callable[[str], None] | None,
) -> SimulationFit:
    """Simulates and solves in turn until coefficients do not change beyond their errors.

    - `solve`: from motion to coefficients.
    - the others: as of `InstrumentalVariables.fit`.

    **Raises** as `InstrumentalVariables.fit`.
    """
    require_float64()
    _check(network, recording, settings)
    report = progress or (lambda words: None)
    measured = settings.patterns(recording)
    report("regression on measured motion")
    least_squares = settings.fit(network, measured)
    fit, exogeneity = least_squares if start is None else start, None
    distance, converged, steps = np.zeros(network.joint_count), False, 0
    while steps < iterations and not converged:
        steps += 1
        report(f"simulation {steps}")
        k = _possible(network, fit, measured)
        derivatives = simulated_derivatives(motion, network, k, recording, settings)
        patterns = settings.preparation.patterns(recording, derivatives)
        distance = np.sqrt(np.mean((derivatives[0] - recording.position) ** 2, axis=0))
        before = np.asarray(fit.k)
        fit, exogeneity = solve(Simulated(measured, patterns, distance))
        error = np.asarray(fit.standard_error)
        known = np.isfinite(error) & (error > 0.0)
        change = np.abs(np.asarray(fit.k) - before)
        converged = bool(np.all((change <= _SAME * error + _ROUNDING * np.abs(before))[known]))
    return SimulationFit(network, fit, least_squares, exogeneity, distance, steps, converged)


def _possible(network: CSLC, fit: Identification, measured: Patterns) -> np.ndarray:
    """Coefficients to simulate by: those of a fit, or of the nearest bodies that can exist, where
    the fit's mass matrix is that of no body somewhere along the motion."""
    mass = np.asarray(network.mass_matrix(fit.k, jnp.asarray(measured.q)))
    if np.all(np.linalg.eigvalsh(mass)[:, 0] > 0.0):
        return np.asarray(fit.k)
    return np.asarray(physical_parameters(network, fit, fixed=fixed_bodies(network.robot)).k)


def _check(network: CSLC, recording: Recording, settings: Settings) -> None:
    """**Raises** `ValueError` as `InstrumentalVariables.fit`."""
    if network.payload is not None:
        raise ValueError(f"{network.name!r} has a payload; expected a network without one")
    if recording.position.shape[1] != network.joint_count:
        raise ValueError(
            f"the recording has {recording.position.shape[1]} joints; expected"
            f" {network.joint_count}, those of {network.name!r}"
        )
    if settings.solver.loss != "squared":
        raise ValueError(
            f"loss is {settings.solver.loss!r}; expected 'squared': instruments have no other"
        )


def both_masks(simulated: Simulated) -> tuple[Patterns, Patterns]:
    """Measured and simulated patterns, with the pairs that count in both."""
    mask = np.asarray(simulated.measured.mask) & np.asarray(simulated.simulated.mask)
    measured, of_simulation = (
        dataclasses.replace(patterns, backlash_mask=mask, friction_mask=mask)
        for patterns in (simulated.measured, simulated.simulated)
    )
    return measured, of_simulation
