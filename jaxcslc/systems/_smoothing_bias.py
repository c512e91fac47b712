"""Change of coefficients by smoothing, seen on motion that is smoothed once more."""

import dataclasses
from typing import TYPE_CHECKING, Any

import equinox as eqx
import numpy as np
import scipy
from jaxtyping import Array, Float

from ..least_squares import Identification, LeastSquares, Settings, WeightedEquations
from ..recordings import Derivatives, Patterns, Preparation, away_from_reversals


if TYPE_CHECKING:
    from ._network import SystemNetwork
    from ._system import System


# Filters and splines ring at the ends for a few times what they reach: at once what they reach, the
# rate of a sine that splines smoothed was off by 6 %.
REACHES = 3


@dataclasses.dataclass(frozen=True)
class SmoothedAgain:
    """Motion that went through the smoothing of its recording, and goes through it once more.

    What smoothing takes out of motion that is smooth already is nearly what it took out of the
    true motion (Tukey's twicing): smoothing S leaves S x of x, so that S S x - S x is the bias
    S x - x smoothed, and differs from it by (S - 1)² x only.

    Each derivative is sent through by itself: velocities and accelerations are integrated, exactly,
    as cubic splines, and smoothing differentiates the integrals. Positions that were smoothed have
    noise left which only the smoothing's own derivatives suppress: exact derivatives of them would
    be mostly noise.

    **Attributes**

    - `system`: whose states are smoothed.
    - `preparation`: of the recording.
    - `time`: of the samples, (samples,) [s].
    """

    system: "System"
    preparation: Preparation
    time: Float[np.ndarray, " samples"]

    def __call__(self, motion: Derivatives) -> Derivatives:
        """Motion of all variables, (samples, v) each, smoothed once more."""
        again = tuple(np.array(x) for x in motion)
        q, qd, qdd = again
        states, smoothing = self.system.states, self.preparation.smoothing
        before = [x[:, states] for x in again]
        highest = max(self.system.network.highest)
        q[:, states] = smoothing.smooth(self.time, before[0])[0]
        if highest > 0:
            qd[:, states] = smoothing.smooth(self.time, self._integral(before, 1))[1]
        if highest > 1:
            qdd[:, states] = smoothing.smooth(self.time, self._integral(before, 2))[2]
        self._measured_again(before, qd, qdd)
        inputs = self.system.inputs
        if inputs and self.preparation.smooth_torque:
            q[:, inputs] = smoothing.low_pass(self.time, q[:, inputs])
        return q, qd, qdd

    def _integral(
        self, before: list[Float[np.ndarray, "samples states"]], order: int
    ) -> Float[np.ndarray, "samples states"]:
        """Positions that have the derivatives of an order; polynomials, which smoothing does not
        change, bring them near the positions themselves."""
        spline = scipy.interpolate.CubicSpline(self.time, before[order])
        position = spline.antiderivative(order)(self.time)
        powers = ((self.time - self.time[0]) / np.ptp(self.time))[:, None] ** np.arange(order)
        return position + powers @ np.linalg.lstsq(powers, before[0] - position, rcond=None)[0]

    def _measured_again(
        self,
        before: list[Float[np.ndarray, "samples states"]],
        qd: Float[np.ndarray, "samples variables"],
        qdd: Float[np.ndarray, "samples variables"],
    ) -> None:
        """Derivatives that were measured, as `system_derivatives` treats them."""
        low_pass = self.preparation.smoothing.low_pass
        variables = [self.system.variables[i] for i in self.system.states]
        if any(variable.rate for variable in variables):
            speed = low_pass(self.time, before[1])
            spline = scipy.interpolate.CubicSpline(self.time, before[2])
            integral = low_pass(self.time, spline.antiderivative(1)(self.time))
            for number, (i, variable) in enumerate(zip(self.system.states, variables, strict=True)):
                if variable.rate:
                    qd[:, i] = speed[:, number]
                    qdd[:, i] = np.gradient(integral[:, number], self.time, edge_order=2)
        if any(variable.second_rate for variable in variables):
            acceleration = low_pass(self.time, before[2])
            for number, (i, variable) in enumerate(zip(self.system.states, variables, strict=True)):
                if variable.second_rate:
                    qdd[:, i] = acceleration[:, number]


def motion_of(patterns: Patterns) -> Derivatives:
    """The motion of patterns as NumPy's arrays."""
    return np.asarray(patterns.q), np.asarray(patterns.qd), np.asarray(patterns.qdd)


def with_motion(network: "SystemNetwork", patterns: Patterns, motion: Derivatives) -> Patterns:
    """Return the samples with another motion, and the known sides that go with it."""
    q, qd, qdd = motion
    known = np.asarray(_known(network, q, qd, qdd))
    return dataclasses.replace(patterns, q=q, qd=qd, qdd=qdd, torque=known)


@eqx.filter_jit
def _known(network: "SystemNetwork", q: Any, qd: Any, qdd: Any) -> Array:
    return network.known(q, qd, qdd)


@dataclasses.dataclass(frozen=True)
class SmoothingBias:
    """Change of the coefficients of a fit by smoothing.

    Seen on the samples that smoothing once more says something of: not those at the ends, where the
    motion that comes in is that of windows cut short; nor those within twice the margin that a
    preparation keeps from reversals, over which jumps spread that the fit does not see.

    **Attributes**

    - `again`: smooths once more.
    - `patterns`: of the fit, with a mask that leaves these samples in.
    - `problem`: their equations, with weights.
    - `solver`: of the fit.
    """

    again: SmoothedAgain
    patterns: Patterns
    problem: WeightedEquations
    solver: LeastSquares

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
                values = system.evaluate(arguments, *motion_of(patterns))
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
        again = SmoothedAgain(system, settings.preparation, np.asarray(patterns.time, float))
        return cls(again, inner, problem, settings.solver)

    def solution(self, motion: Derivatives) -> Float[np.ndarray, " coefficients"]:
        """Coefficients that fit another motion of these samples."""
        patterns = with_motion(self.again.system.network, self.patterns, motion)
        return self.problem.solution(self.solver.equations(self.again.system.network, patterns)).k

    def estimate(
        self,
    ) -> tuple[Float[np.ndarray, " coefficients"], Float[np.ndarray, " coefficients"]]:
        """The difference of the coefficients of motion smoothed twice and once; and by how much it
        differs from that of three times and twice: as much as it may be off itself."""
        once = motion_of(self.patterns)
        twice = self.again(once)
        first, second, third = map(self.solution, (once, twice, self.again(twice)))
        return second - first, (second - first) - (third - second)
