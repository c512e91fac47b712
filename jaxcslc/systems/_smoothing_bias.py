"""Change of coefficients by smoothing, seen on motion that is smoothed once more."""

import dataclasses
from typing import TYPE_CHECKING, Any

import equinox as eqx
import numpy as np
import scipy
from jaxtyping import Array, Float

from ..least_squares import Identification, Settings, WeightedEquations
from ..recordings import Patterns, away_from_reversals


if TYPE_CHECKING:
    from ._network import SystemNetwork
    from ._system import System


# Filters and splines ring at the ends for a few times what they reach: at once what they reach, the
# rate of a sine that splines smoothed was off by 6 %.
REACHES = 3


Motion = Float[np.ndarray, "3 samples variables"]
"""Values, first and second derivatives of all variables."""


def stacked_motion(patterns: Patterns) -> Motion:
    """Return the motion of patterns as one array of NumPy's."""
    return np.stack([np.asarray(x) for x in (patterns.q, patterns.qd, patterns.qdd)])


def with_motion(network: "SystemNetwork", patterns: Patterns, motion: Motion) -> Patterns:
    """Return the samples with another motion, and the known sides that go with it."""
    q, qd, qdd = motion
    known = np.asarray(_known(network, q, qd, qdd))
    return dataclasses.replace(patterns, q=q, qd=qd, qdd=qdd, torque=known)


@eqx.filter_jit
def _known(network: "SystemNetwork", q: Any, qd: Any, qdd: Any) -> Array:
    return network.known(q, qd, qdd)


@dataclasses.dataclass(frozen=True)
class SmoothingBias:
    """Change of the coefficients of a fit by smoothing, seen on motion that is smoothed once more.

    What smoothing takes out of motion that is smooth already is nearly what it took out of the
    true motion (Tukey's twicing): smoothing S leaves S x of x, so that S S x - S x is the bias
    S x - x smoothed, and differs from it by (S - 1)² x only.

    Samples count that smoothing once more says something of: not those at the ends, where the
    motion that comes in is that of windows cut short; nor those within twice the margin that a
    preparation keeps from reversals, over which jumps spread that the fit does not see.

    **Attributes**

    - `system`, `settings`: whose states were smoothed, and how.
    - `patterns`: of the fit, with a mask that leaves these samples in.
    - `problem`: their equations, with weights.
    """

    system: "System"
    settings: Settings
    patterns: Patterns
    problem: WeightedEquations

    @classmethod
    def of(
        cls,
        system: "System",
        settings: Settings,
        patterns: Patterns,
        fit: Identification,
        reach: int,
    ) -> "SmoothingBias | None":
        """Return the bias of a fit.

        It is None for a system without states, and where the samples do not determine what the fit
        determines.

        - `reach`: of the smoothing, in samples.
        """
        if not system.states:
            return None
        sample = np.arange(patterns.samples)
        ends = REACHES * reach
        mask = (sample >= ends) & (sample < patterns.samples - ends)
        margin = 2 * settings.preparation.reversal_margin
        for arguments in system.signs if margin else ():
            if arguments:
                values = system.evaluate(arguments, *stacked_motion(patterns))
                mask &= np.all(away_from_reversals(values, margin), axis=1)
        inner = dataclasses.replace(
            patterns, friction_mask=np.asarray(patterns.friction_mask) & mask[:, None]
        )
        if not np.all(np.any(np.asarray(inner.mask), axis=0)):
            return None
        equations = settings.solver.equations(system.network, inner)
        problem = WeightedEquations.of(equations, np.asarray(fit.k), settings.solver)
        determined = np.asarray(problem.solution(equations).determined)
        if np.any(np.asarray(fit.determined) & ~determined):
            return None
        return cls(system, settings, inner, problem)

    def again(self, motion: Motion) -> Motion:
        """Return motion of all samples smoothed once more.

        Each derivative is sent through by itself: velocities and accelerations are integrated,
        exactly, as cubic splines, and smoothing differentiates the integrals. Positions that were
        smoothed have noise left which only the smoothing's own derivatives suppress: exact
        derivatives of them would be mostly noise.
        """
        preparation = self.settings.preparation
        time, smoothing = np.asarray(self.patterns.time, float), preparation.smoothing
        states, inputs = list(self.system.states), self.system.inputs
        again, before = motion.copy(), motion[:, :, states]
        for order in range(max(self.system.network.highest) + 1):
            position = _integral(time, before, order)
            again[order][:, states] = smoothing.smooth(time, position)[order]
        # Derivatives that were measured are treated as by `system_derivatives`.
        variables = [self.system.variables[i] for i in states]
        rates = np.array([variable.rate is not None for variable in variables])
        second = np.array([variable.second_rate is not None for variable in variables])
        at = np.array(states)
        if np.any(rates):
            speed = smoothing.low_pass(time, before[1])
            integral = scipy.interpolate.CubicSpline(time, before[2]).antiderivative(1)(time)
            slope = np.gradient(smoothing.low_pass(time, integral), time, axis=0, edge_order=2)
            again[1][:, at[rates]], again[2][:, at[rates]] = speed[:, rates], slope[:, rates]
        if np.any(second):
            again[2][:, at[second]] = smoothing.low_pass(time, before[2])[:, second]
        if inputs and preparation.smooth_torque:
            again[0][:, inputs] = smoothing.low_pass(time, motion[0][:, inputs])
        return again

    def solution(self, motion: Motion) -> Float[np.ndarray, " coefficients"]:
        """Return the coefficients that fit another motion of the samples."""
        patterns = with_motion(self.system.network, self.patterns, motion)
        equations = self.settings.solver.equations(self.system.network, patterns)
        return self.problem.solution(equations).k

    def estimate(
        self,
    ) -> tuple[Float[np.ndarray, " coefficients"], Float[np.ndarray, " coefficients"]]:
        """Return the bias, and by how much it may be off.

        The bias is the difference of the coefficients of motion smoothed twice and once. It may be
        off by as much as it differs from that of three times and twice.
        """
        once = stacked_motion(self.patterns)
        twice = self.again(once)
        first, second, third = map(self.solution, (once, twice, self.again(twice)))
        return second - first, (second - first) - (third - second)


def _integral(
    time: Float[np.ndarray, " samples"], motion: Motion, order: int
) -> Float[np.ndarray, "samples variables"]:
    """Return positions whose derivatives of an order are those of a motion.

    Polynomials, which smoothing does not change, bring them near the motion's positions.
    """
    if order == 0:
        return motion[0]
    spline = scipy.interpolate.CubicSpline(time, motion[order])
    position = spline.antiderivative(order)(time)
    powers = ((time - time[0]) / np.ptp(time))[:, None] ** np.arange(order)
    return position + powers @ np.linalg.lstsq(powers, motion[0] - position, rcond=None)[0]
