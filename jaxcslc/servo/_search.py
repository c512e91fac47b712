"""Least squares of simulated positions for one joint: its unknowns, and the search for them.

Torques of a drive are sought as ratios to its gain, which the motion determines much better than
the gain itself. Read with `_simulation`, whose C code simulates all trial values side by side.
"""

import math
from dataclasses import dataclass

import numpy as np
from jaxtyping import Float

from ._drive import DRIVE_UNITS, TORQUES
from ._simulation import JointLoads, simulate_joint


NAMES = tuple(DRIVE_UNITS)
"""Parameters of a drive, in the order of C."""

MOVING = 0.02
"""Velocity below which friction may hold a joint [rad/s]."""
_DAMPINGS = 10.0 ** np.arange(-2.0, 4.0)  # of Levenberg and Marquardt, tried side by side
_LARGEST = 1.0  # change of an unknown in an iteration, in prior deviations
# Where 0 is no value: a motor without inertia has no motion within the play of its gear [s²].
_LEAST = {"armature": 1e-6}
# The search ends after so many iterations that lower the cost by less than this part, each of
# which halves the steps of the derivatives: friction makes the cost rough.
_LITTLE, STALLED = 1e-3, 2


@dataclass(frozen=True)
class Unknown:
    """An unknown of the search: how a parameter of the drive follows from it.

    **Attributes**

    - `form`: `"log"`: the parameter's logarithm; `"ratio"`: the parameter over the gain;
      `"plain"`: the parameter; `"signed"`: likewise, of either sign.
    - `start`: where nothing better is known.
    - `step`: of central differences. It moves joints by about 1 mrad: friction makes positions
      rough, and smaller steps would differentiate that.
    - `centre`, `deviation`: of the prior, which is weak: what drives of any size may have.
    """

    form: str
    start: float
    step: float
    centre: float
    deviation: float

    def size(self, value: float) -> float:
        """Return the size of an unknown, of which errors are parts."""
        return 1.0 if self.form == "log" else max(abs(value), self.deviation / 10.0)


UNKNOWNS = {
    "gain": Unknown("log", math.log(10.0), 0.03, math.log(10.0), 3.0),
    "damping": Unknown("ratio", 0.05, 0.002, 0.0, 0.3),
    "integral": Unknown("ratio", 0.1, 0.05, 0.0, 2.0),
    "lead": Unknown("plain", 0.1, 0.03, 0.0, 1.0),
    "delay": Unknown("plain", 0.01, 0.002, 0.0, 0.2),
    "dead_zone": Unknown("plain", 0.002, 0.0005, 0.0, 0.01),
    "torque_limit": Unknown("ratio", 0.2, 0.01, 0.2, 0.2),
    "offset": Unknown("signed", 0.0, 0.03, 0.0, 0.15),
    "armature": Unknown("ratio", 0.002, 0.0002, 0.0, 0.005),
    "coulomb": Unknown("ratio", 0.01, 0.0005, 0.0, 0.1),
    "viscous": Unknown("ratio", 0.02, 0.002, 0.0, 0.3),
    "static": Unknown("ratio", 0.005, 0.0005, 0.0, 0.02),
    "stribeck": Unknown("log", math.log(0.05), 0.05, math.log(0.05), 0.7),
    "load_friction": Unknown("plain", 0.1, 0.02, 0.0, 0.5),
    "play": Unknown("plain", 0.004, 0.0005, 0.0, 0.02),
}
"""Unknowns by the parameter that they stand for [rad, s, and powers of them]."""


@dataclass(frozen=True)
class JointMotion:
    """One joint's part of a recording, and the loads that its other joints' motion gives.

    **Attributes**

    - `start`: reading and velocity at the first sample.
    - `arm`: loads of the arm's own links; `payload`: of what it carries, or None.
    """

    time: Float[np.ndarray, " samples"]
    command: Float[np.ndarray, " samples"]
    position: Float[np.ndarray, " samples"]
    start: Float[np.ndarray, "2"]
    arm: JointLoads
    payload: JointLoads | None = None

    def loads(self, masses: float) -> JointLoads:
        """Return the loads of links with so many times the file's masses."""
        arm = self.arm.scaled(masses)
        if self.payload is None:
            return arm
        return JointLoads(arm.torque + self.payload.torque, arm.inertia + self.payload.inertia)


@dataclass(frozen=True)
class JointProblem:
    """Unknowns of a joint, and the residuals of its simulated positions.

    **Attributes**

    - `names`: of the unknowns.
    - `known`: the drive's other parameters, in the order of `NAMES`.
    - `motions`: the joint's part of the recordings.
    - `weight`: of a squared residual [1/rad²]: one over the variance of the residuals times the
      number of neighbouring samples that carry the information of one.
    - `longest_step`: of the simulation [s].
    - `gain_prior`: centre and deviation of the gain's logarithm.
    """

    names: tuple[str, ...]
    known: Float[np.ndarray, " parameters"]
    motions: tuple[JointMotion, ...]
    weight: float
    longest_step: float
    gain_prior: tuple[float, float] = (UNKNOWNS["gain"].centre, UNKNOWNS["gain"].deviation)

    @property
    def unknowns(self) -> list[Unknown]:
        return [UNKNOWNS[name] for name in self.names]

    @property
    def low(self) -> Float[np.ndarray, " unknowns"]:
        """Lower bounds."""
        return np.array(
            [
                -np.inf if x.form in ("log", "signed") else _LEAST.get(name, 0.0)
                for name, x in zip(self.names, self.unknowns, strict=True)
            ]
        )

    @property
    def steps(self) -> Float[np.ndarray, " unknowns"]:
        """Steps of differences."""
        return np.array([unknown.step for unknown in self.unknowns])

    @property
    def centres(self) -> Float[np.ndarray, " unknowns"]:
        """Centres of the prior."""
        return np.array(
            [self.gain_prior[0] if name == "gain" else UNKNOWNS[name].centre for name in self.names]
        )

    @property
    def deviations(self) -> Float[np.ndarray, " unknowns"]:
        """Deviations of the prior."""
        return np.array(
            [
                self.gain_prior[1] if name == "gain" else UNKNOWNS[name].deviation
                for name in self.names
            ]
        )

    def rows(self, x: Float[np.ndarray, "sets unknowns"]) -> Float[np.ndarray, "sets parameters"]:
        """Return the drives' parameters for values of the unknowns."""
        rows = np.tile(self.known, (len(x), 1))
        for unknown, name, values in zip(self.unknowns, self.names, x.T, strict=True):
            rows[:, NAMES.index(name)] = np.exp(values) if unknown.form == "log" else values
        for unknown, name in zip(self.unknowns, self.names, strict=True):
            if unknown.form == "ratio":
                rows[:, NAMES.index(name)] *= rows[:, NAMES.index("gain")]
        return rows

    def unknowns_of(self, row: Float[np.ndarray, " parameters"]) -> Float[np.ndarray, " unknowns"]:
        """Return the unknowns that stand for a drive's parameters; starts for infinite limits."""
        gain = row[NAMES.index("gain")]
        values: list[float] = []
        for name, unknown in zip(self.names, self.unknowns, strict=True):
            value = float(row[NAMES.index(name)])
            if math.isinf(value):
                values.append(unknown.start)
            elif unknown.form == "log":
                values.append(math.log(value))
            else:
                values.append(value / gain if unknown.form == "ratio" else value)
        return np.array(values)

    def load(self, x: Float[np.ndarray, " unknowns"], masses: float) -> float:
        """Return the root mean square of the torque of the links at the measured positions."""
        offset = self.rows(x[None])[0, NAMES.index("offset")]
        squares = [
            np.square(motion.loads(masses).torque_at(motion.position - offset))
            for motion in self.motions
        ]
        return float(np.sqrt(np.mean(np.concatenate(squares))))

    def residuals(
        self, x: Float[np.ndarray, "sets unknowns"], masses: float = 1.0
    ) -> Float[np.ndarray, "sets samples"]:
        """Return simulated minus measured positions [rad], all motions joined."""
        rows = self.rows(x)
        return np.concatenate(
            [
                simulate_joint(
                    motion.loads(masses),
                    rows,
                    motion.time,
                    motion.command,
                    motion.start,
                    longest_step=self.longest_step,
                )
                - motion.position
                for motion in self.motions
            ],
            axis=1,
        )

    def prior(self, x: Float[np.ndarray, "sets unknowns"]) -> Float[np.ndarray, "sets unknowns"]:
        """Return the prior's residuals."""
        return (x - self.centres) / self.deviations

    def cost(
        self, x: Float[np.ndarray, "sets unknowns"], masses: float = 1.0
    ) -> Float[np.ndarray, " sets"]:
        """Return twice the negative logarithm of the posterior density, a constant aside."""
        squares = np.sum(self.residuals(x, masses) ** 2, axis=1)
        return self.weight * squares + np.sum(self.prior(x) ** 2, axis=1)

    def linearised(
        self,
        x: Float[np.ndarray, " unknowns"],
        steps: Float[np.ndarray, " unknowns"],
        masses: float = 1.0,
    ) -> tuple[Float[np.ndarray, " samples"], Float[np.ndarray, "samples unknowns"]]:
        """Return the residuals and their derivatives by central differences."""
        above = x + np.diag(steps)
        below = np.maximum(x - np.diag(steps), self.low)
        residuals = self.residuals(np.vstack([x, above, below]), masses)
        k = len(x)
        widths = np.diag(above) - np.diag(below)
        return residuals[0], ((residuals[1 : k + 1] - residuals[k + 1 :]) / widths[:, None]).T

    def information(
        self, x: Float[np.ndarray, " unknowns"], masses: float = 1.0
    ) -> Float[np.ndarray, "unknowns unknowns"]:
        """Return half the second derivatives of the cost (Gauss and Newton)."""
        _, J = self.linearised(x, self.steps, masses)
        return self.weight * (J.T @ J) + np.diag(self.deviations**-2.0)

    def minimum(
        self, x: Float[np.ndarray, " unknowns"], iterations: int, masses: float = 1.0
    ) -> Float[np.ndarray, " unknowns"]:
        """Return the least cost's unknowns (Levenberg and Marquardt, within bounds).

        `scipy.optimize.least_squares` (dogleg) takes two thirds of the time for all joints. On two
        motions of a real SO-101, whose friction makes the cost rough, positions of held-out motions
        were 14.7 mrad off with it instead of 14.3.
        """
        deviations = self.deviations
        low, shrink, stalled = self.low, 1.0, 0
        damping = 1e-2
        cost = self.cost(x[None], masses)[0]
        for _ in range(iterations):
            residuals, J = self.linearised(x, shrink * self.steps, masses)
            gradient = self.weight * (J.T @ residuals) + self.prior(x[None])[0] / deviations
            H = self.weight * (J.T @ J) + np.diag(deviations**-2.0)
            free = (x > low) | (gradient < 0.0)
            trials: list[np.ndarray] = []
            for factor in damping * _DAMPINGS:
                step = np.zeros_like(x)
                A = H[np.ix_(free, free)]
                step[free] = -np.linalg.solve(A + factor * np.diag(np.diag(A)), gradient[free])
                step = np.clip(step, -_LARGEST * deviations, _LARGEST * deviations)
                trials.append(np.maximum(x + step, low))
            costs = self.cost(np.array(trials), masses)
            best = int(np.argmin(costs))
            if costs[best] < cost:
                stalled = 0 if costs[best] < (1.0 - _LITTLE) * cost else stalled + 1
                x, cost = trials[best], costs[best]
                damping = min(max(damping * _DAMPINGS[best], 1e-5), 1e2)
            else:
                stalled += 1
                damping *= 3.0
            if stalled:
                shrink *= 0.5
            if stalled > STALLED:
                break
        return x


assert {name for name, unknown in UNKNOWNS.items() if unknown.form == "ratio"} <= set(TORQUES)
