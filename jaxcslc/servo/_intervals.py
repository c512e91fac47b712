"""Covariance of what a search of servo drives found, and 95 % intervals of the parameters.

Residuals of a simulation are correlated over seconds, since friction holds a joint where it is. The
covariance therefore is a jackknife over blocks of seconds, which count as independent: the scatter
of estimates, each without one block (one step of Gauss and Newton; Miller, 1974). Few blocks
determine many unknowns here, so that the sandwich estimate was too small: a block's residuals are
smaller than its errors, since the fit follows them. A part of the residuals is taken as an error
of the model that all blocks share.
"""

import dataclasses
import itertools
import math
from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
from jaxtyping import Float
from scipy.special import stdtrit

from ._drive import DRIVE_UNITS
from ._identifiability import ConfoundedParameters
from ._search import NAMES, JointProblem


BLOCK = 2.0
"""Shortest blocks of residuals that count as independent [s]."""
_BLOCKS = 100  # as many at most
_DETERMINED = 0.5  # part of the prior's deviation up to which an error counts as the recordings'
# Part of the residuals, beyond the encoders' rounding, that counts as an error of the model which
# repeats in all blocks, so that their scatter does not show it. A heuristic: a base that gives way
# falsifies armatures of legs by as much (scripts/studies/servo).
_REPEATED = 0.3
_EXACT = 1e-6  # relative error of masses that count as exact


@dataclass(frozen=True)
class ServoParameter:
    """Estimate of one parameter of a drive, with its 95 % interval.

    **Attributes**

    - `joint`: index of the joint, from 0.
    - `name`: of the parameter, as of `ServoDrive`; `"coulomb/gain"` and the like where only the
      ratio is determined.
    - `value`, `error`: estimate and standard error; the error is infinite if the recordings do not
      determine the parameter.
    - `low`, `high`: ends of the 95 % interval.
    - `unit`: of all four.

    >>> from jaxcslc.servo import ServoParameter
    >>> ServoParameter(0, "delay", 0.04, 0.001, 0.038, 0.042, "s").is_determined
    True
    """

    joint: int
    name: str
    value: float
    error: float
    low: float
    high: float
    unit: str

    @property
    def is_determined(self) -> bool:
        """True if the recordings determine the parameter."""
        return math.isfinite(self.error)


@dataclass(frozen=True, eq=False)
class Stack:
    """Unknowns of all joints, one after the other, and then the logarithm of the masses' scale.

    **Attributes**

    - `gradient`: of half the cost.
    - `information`: its second derivatives (Gauss and Newton), priors included.
    - `covariance`: of the unknowns.
    - `blocks`: number of blocks of residuals.
    - `has_scale`: whether the recordings and not the masses' prior alone determine the scale.
    """

    gradient: Float[np.ndarray, " unknowns"]
    information: Float[np.ndarray, "unknowns unknowns"]
    covariance: Float[np.ndarray, "unknowns unknowns"]
    blocks: int
    has_scale: bool

    @classmethod
    def of(
        cls,
        problems: Sequence[JointProblem],
        unknowns: Sequence[np.ndarray],
        misfits: Sequence[np.ndarray],
        derivatives: Sequence[np.ndarray],
        masses: float,
        mass_error: float,
        has_scale: bool,
    ) -> "Stack":
        """Linearise the problems of all joints.

        - `misfits`: residuals of each joint in a simulation of the whole arm.
        - `derivatives`: of those residuals with respect to all unknowns.
        - `mass_error`: prior standard error of the masses' scale.
        """
        ends = np.cumsum([0, *[len(x) for x in unknowns]])
        size = int(ends[-1]) + 1
        slices = _slices(problems[0])
        prior, gradient = np.zeros(size), np.zeros(size)
        repeated = np.zeros((size, size))
        # Of each block of seconds: information, and half the gradient of the cost.
        parts = np.zeros((len(slices), size, size))
        scores = np.zeros((len(slices), size))
        for i, (problem, x, J) in enumerate(zip(problems, unknowns, derivatives, strict=True)):
            prior[ends[i] : ends[i + 1]] = problem.deviations**-2.0
            gradient[ends[i] : ends[i + 1]] += problem.prior(x[None])[0] / problem.deviations
            misfit = misfits[i]
            gradient += problem.weight * (J.T @ misfit)
            for block, information, score in zip(slices, parts, scores, strict=True):
                information += problem.weight * (J[block].T @ J[block])
                score += problem.weight * (J[block].T @ misfit[block])
            # J' e e' J for an error e that lies in the span of J, evenly in all its directions.
            rounding = len(misfit) * problem.known[NAMES.index("encoder_step")] ** 2 / 12.0
            excess = max(float(misfit @ misfit) - rounding, 0.0)
            energy = _REPEATED**2 * excess / len(x)
            repeated += problem.weight**2 * energy * (J.T @ J)
        # A scale without error is no unknown: a very small error keeps the matrices regular.
        prior[-1] = max(mass_error, _EXACT) ** -2.0
        gradient[-1] += prior[-1] * math.log(masses)
        total = np.diag(prior) + np.sum(parts, axis=0)
        inverse = np.linalg.inv(total)
        without = np.array(
            [np.linalg.solve(total - x, score) for x, score in zip(parts, scores, strict=True)]
        )
        scatter = (1.0 - 1.0 / len(slices)) * without.T @ without
        # Friction makes the cost rough, which ends the search: the step that is left is an error.
        left = inverse @ gradient
        shared = inverse @ (repeated + np.diag(prior)) @ inverse
        return cls(gradient, total, scatter + shared + np.outer(left, left), len(slices), has_scale)

    def with_confounded(
        self,
        problems: Sequence[JointProblem],
        pair: ConfoundedParameters,
        covariance: Float[np.ndarray, "pair pair"],
    ) -> "Stack":
        """Return a copy with the covariance of two confounded parameters on top.

        Derivatives of such parameters differ by little more than the roughness of differences,
        which counts as information about them.
        """
        names = problems[pair.joint].names
        start = sum(len(problem.names) for problem in problems[: pair.joint])
        kept = [k for k, name in enumerate(pair.parameters) if name in names]
        at = [start + names.index(pair.parameters[k]) for k in kept]
        total = self.covariance.copy()
        total[np.ix_(at, at)] += covariance[np.ix_(kept, kept)]
        return dataclasses.replace(self, covariance=total)

    def step(
        self, low: Float[np.ndarray, " unknowns"], damping: float
    ) -> Float[np.ndarray, " unknowns"]:
        """Return the step of Levenberg and Marquardt.

        - `low`: step that takes each unknown to its lower bound.
        """
        free = (low < 0.0) | (self.gradient < 0.0)
        step = np.zeros_like(self.gradient)
        A = self.information[np.ix_(free, free)]
        step[free] = -np.linalg.solve(A + damping * np.diag(np.diag(A)), self.gradient[free])
        return np.maximum(step, low)

    def parameters(
        self,
        problems: Sequence[JointProblem],
        unknowns: Sequence[np.ndarray],
        rows: Float[np.ndarray, "joints fields"],
        vague_gain: Sequence[bool],
        ratios_only: bool,
    ) -> tuple[
        list[ServoParameter], Float[np.ndarray, "parameters parameters"], list[tuple[int, str]]
    ]:
        """Return the estimates, their covariance, and those that are not determined.

        Torques of a joint whose gain is not determined are reported as ratios to it.
        """
        size = len(self.covariance)
        spread = np.sqrt(np.diag(self.covariance))
        found: list[tuple[int, str, float, bool]] = []
        derivatives: list[np.ndarray] = []
        at = 0
        gain_index = NAMES.index("gain")
        for joint, (problem, x) in enumerate(zip(problems, unknowns, strict=True)):
            gain = float(rows[joint, gain_index])
            as_ratio = ratios_only or vague_gain[joint]
            gain_at = at + problem.names.index("gain") if "gain" in problem.names else None
            for k, (name, unknown) in enumerate(zip(problem.names, problem.unknowns, strict=True)):
                derivative, value = np.zeros(size), float(x[k])
                label = name
                if unknown.form == "log":
                    value = math.exp(value)
                    derivative[at + k] = value
                else:
                    derivative[at + k] = 1.0
                if unknown.form == "ratio" and as_ratio:
                    label = f"{name}/gain"
                elif unknown.form == "ratio":
                    value *= gain
                    derivative[at + k] = gain
                    if gain_at is not None:
                        derivative[gain_at] = value
                torque = name == "gain" or unknown.form == "ratio"
                if torque and gain_at is not None and not self.has_scale and not as_ratio:
                    derivative[-1] = value
                sure = spread[at + k] < _DETERMINED * problem.deviations[k]
                found.append((joint, label, value, sure and not (name == "gain" and as_ratio)))
                derivatives.append(derivative)
            at += len(x)
        T = np.array(derivatives)
        covariance = T @ self.covariance @ T.T
        quantile = float(stdtrit(max(self.blocks - 1, 1), 0.975))
        parameters: list[ServoParameter] = []
        for (joint, name, value, sure), variance in zip(found, np.diag(covariance), strict=True):
            error = math.sqrt(max(variance, 0.0)) if sure else math.inf
            low, high = value - quantile * error, value + quantile * error
            if name == "gain" and sure:
                low, high = (value * math.exp(x * quantile * error / value) for x in (-1.0, 1.0))
            if name != "offset":
                low = max(low, 0.0)
            parameters.append(ServoParameter(joint, name, value, error, low, high, unit_of(name)))
        refused = [
            (joint, name.removesuffix("/gain")) for joint, name, _, sure in found if not sure
        ]
        return parameters, covariance, refused


def unit_of(name: str) -> str:
    """Return the unit of a parameter, or of its ratio to the gain."""
    ratio, _, over = name.partition("/")
    if not over:
        return DRIVE_UNITS[name]
    return {
        "damping": "s",
        "viscous": "s",
        "integral": "1/s",
        "armature": "s²",
    }.get(ratio, "rad")


def information_per_sample(
    residuals: Float[np.ndarray, " samples"], problem: JointProblem
) -> float:
    """Return the residuals' variance times the number of samples that count as one [rad²]."""
    parts = _slices(problem)
    sums = np.array([np.sum(residuals[part]) for part in parts])
    lengths = np.array([part.stop - part.start for part in parts])
    variance = float(np.mean(residuals**2))
    floor = max(variance, 1e-12)
    return max(float(np.sum(sums**2) / np.sum(lengths)), floor)


def _slices(problem: JointProblem) -> list[slice]:
    total = sum(float(motion.time[-1] - motion.time[0]) for motion in problem.motions)
    block = max(BLOCK, total / _BLOCKS)
    slices: list[slice] = []
    start = 0
    for motion in problem.motions:
        duration = float(motion.time[-1] - motion.time[0])
        count = max(1, round(duration / block))
        edges = start + np.linspace(0, motion.time.size, count + 1).astype(int)
        slices += [slice(int(a), int(b)) for a, b in itertools.pairwise(edges)]
        start += motion.time.size
    return slices
