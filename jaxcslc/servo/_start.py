"""Start of the search: the regression of command minus position on the motion of the whole arm.

With delayed command c, reading r, velocity v and acceleration a, a joint that slides has

    c - r = load / K + (D / K) v + (J / K) a + (C / K) sign(v) + (k / K) |load| sign(v)

which is linear in the ratios. Loads depend on the zero positions of all joints and on the scale of
the masses: these are found around it (variable projection; Golub and Pereyra, 1973). A joint's own
motion cannot tell its zero position from those of its neighbours.
"""

import math
from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
import scipy
from jaxtyping import Bool, Float

from ..manipulator import LinkParameters, Manipulator
from ._recording import ServoRecording
from ._search import MOVING, UNKNOWNS
from ._simulation import inverse_dynamics, with_payload


_DELAYS = np.arange(0.0, 0.121, 0.01)  # s, that are tried
_MOST_SAMPLES = 6000  # of all recordings together; more cost time, and tell the start little
CORRELATION = 50.0
"""Samples that carry the information of one, before residuals say."""
_ROUNDS = 2  # choices of delays, each before least squares
_TOLERANCE = 1e-4  # of the sum of squares: the search goes on from there
_FEWEST = 20  # samples that slide; with fewer a joint starts from the table


@dataclass(frozen=True)
class Start:
    """Start of the search.

    **Attributes**

    - `offsets`: zero positions [rad].
    - `masses`: scale of the links' masses.
    - `found`: values of other unknowns by name, for each joint.
    """

    offsets: Float[np.ndarray, " joints"]
    masses: float
    found: list[dict[str, float]]


@dataclass(frozen=True, eq=False)
class Regression:
    """Command minus position of all recordings, and what it depends on.

    **Attributes**

    - `robot`: the arm; `carried`: the arm with each recording's payload, or None.
    - `parts`: position, velocity and acceleration of each recording's samples.
    - `errors`: command minus position for each of the delays that are tried, likewise.
    - `known`: gains of the joints that are known; NaN for the others.
    """

    robot: Manipulator
    carried: tuple[Manipulator | None, ...]
    parts: tuple[tuple[Float[np.ndarray, "samples joints"], ...], ...]
    errors: Float[np.ndarray, "delays all joints"]
    known: Float[np.ndarray, " joints"]

    @classmethod
    def of(
        cls,
        robot: Manipulator,
        recordings: Sequence[ServoRecording],
        payloads: Sequence[LinkParameters | None],
        smooth: Sequence[tuple[Float[np.ndarray, "samples joints"], ...]],
        known: Float[np.ndarray, " joints"],
    ) -> "Regression":
        """Take every so many samples of the recordings."""
        stride = max(1, sum(x.samples for x in recordings) // _MOST_SAMPLES)
        errors = np.stack(
            [
                np.concatenate(
                    [_late(x, delay)[::stride] - x.position[::stride] for x in recordings]
                )
                for delay in _DELAYS
            ]
        )
        return cls(
            robot,
            tuple(None if x is None else with_payload(robot, x) for x in payloads),
            tuple(
                (np.ascontiguousarray(x.position[::stride]), *_strided(motion[1:], stride))
                for x, motion in zip(recordings, smooth, strict=True)
            ),
            errors,
            known,
        )

    @property
    def velocity(self) -> Float[np.ndarray, "all joints"]:
        return np.concatenate([v for _, v, _ in self.parts])

    @property
    def acceleration(self) -> Float[np.ndarray, "all joints"]:
        return np.concatenate([a for _, _, a in self.parts])

    @property
    def sliding(self) -> Bool[np.ndarray, "all joints"]:
        return np.abs(self.velocity) > MOVING

    def loads(
        self, offsets: Float[np.ndarray, " joints"], masses: float
    ) -> Float[np.ndarray, "all joints"]:
        """Return torques of the links and the payload."""
        loads: list[np.ndarray] = []
        for (q, v, a), carried in zip(self.parts, self.carried, strict=True):
            arm = inverse_dynamics(self.robot, q - offsets, v, a)[0]
            load = masses * arm
            if carried is not None:
                load += inverse_dynamics(carried, q - offsets, v, a)[0] - arm
            loads.append(load)
        return np.concatenate(loads)

    def joint(
        self, i: int, load: Float[np.ndarray, " all"], delay: int
    ) -> tuple[Float[np.ndarray, "5"], Float[np.ndarray, " sliding"]]:
        """Return a joint's five ratios, none of them negative, and what they leave."""
        sliding = self.sliding[:, i]
        v, load = self.velocity[sliding, i], load[sliding]
        sign, error = np.sign(v), self.errors[delay, sliding, i]
        columns = [load, v, self.acceleration[sliding, i], sign, np.abs(load) * sign]
        A = np.stack(columns, axis=1)
        scale = np.maximum(np.sqrt(np.mean(A**2, axis=0)), 1e-12)
        ratios = np.zeros(5)
        first = 0
        if not math.isnan(self.known[i]):
            first, ratios[0] = 1, 1.0 / self.known[i]
            error = error - ratios[0] * load
        values, _ = scipy.optimize.nnls(A[:, first:] / scale[first:], error)
        ratios[first:] = values / scale[first:]
        return ratios, error - A[:, first:] @ ratios[first:]

    def start(
        self,
        offsets: Float[np.ndarray, " joints"],
        free: Bool[np.ndarray, " unknowns"],
        mass_error: float,
    ) -> Start:
        """Return the least squares.

        - `offsets`: zero positions to begin with.
        - `free`: which of them, and of the masses' scale, are sought.
        - `mass_error`: prior standard error of the scale.
        """
        joints = [i for i in range(len(offsets)) if np.sum(self.sliding[:, i]) >= _FEWEST]
        z = np.append(offsets, 0.0)
        deviations = np.append(np.full(len(offsets), UNKNOWNS["offset"].deviation), mass_error)
        delays: dict[int, int] = {}
        for _ in range(_ROUNDS):
            load = self.loads(z[:-1], math.exp(z[-1]))
            sizes: dict[int, float] = {}
            for i in joints:
                rests = [np.mean(self.joint(i, load[:, i], d)[1] ** 2) for d in range(len(_DELAYS))]
                delays[i] = int(np.argmin(rests))
                sizes[i] = max(math.sqrt(min(rests) * CORRELATION), 1e-9)
            z = self._moved(z, free, deviations, delays, sizes)
        load = self.loads(z[:-1], math.exp(z[-1]))
        found: list[dict[str, float]] = [{} for _ in offsets]
        for i, delay in delays.items():
            inverse, damping, armature, coulomb, load_friction = self.joint(i, load[:, i], delay)[0]
            found[i] = {
                "delay": float(_DELAYS[delay]),
                "damping": float(damping),
                "armature": float(armature),
                "coulomb": float(coulomb),
            }
            if inverse > 0.0:
                found[i]["gain"] = -math.log(inverse)
                found[i]["load_friction"] = float(load_friction / inverse)
        return Start(z[:-1], math.exp(z[-1]), found)

    def _moved(
        self,
        z: Float[np.ndarray, " unknowns"],
        free: Bool[np.ndarray, " unknowns"],
        deviations: Float[np.ndarray, " unknowns"],
        delays: dict[int, int],
        sizes: dict[int, float],
    ) -> Float[np.ndarray, " unknowns"]:
        """Return the unknowns of least squares, the others as they are."""
        if not free.any() or not delays:
            return z
        moved = z.copy()

        def residuals(values: Float[np.ndarray, " free"]) -> np.ndarray:
            moved[free] = values
            load = self.loads(moved[:-1], math.exp(moved[-1]))
            rests = [self.joint(i, load[:, i], d)[1] / sizes[i] for i, d in delays.items()]
            return np.concatenate([*rests, values / deviations[free]])

        found = scipy.optimize.least_squares(
            residuals, z[free], x_scale=deviations[free], ftol=_TOLERANCE
        )
        moved[free] = found.x
        return moved


def _late(recording: ServoRecording, delay: float) -> Float[np.ndarray, "samples joints"]:
    time = recording.time
    return np.stack([np.interp(time - delay, time, x) for x in recording.command.T], axis=1)


def _strided(arrays: Sequence[np.ndarray], stride: int) -> tuple[np.ndarray, ...]:
    return tuple(np.ascontiguousarray(x[::stride]) for x in arrays)


def starting_point(
    names: tuple[str, ...], found: dict[str, float]
) -> Float[np.ndarray, " unknowns"]:
    """Return values of the unknowns: the regression's, within bounds, or the table's."""
    x: list[float] = []
    for name in names:
        unknown = UNKNOWNS[name]
        value = found.get(name, unknown.start)
        if unknown.form == "log":
            x.append(min(max(value, unknown.centre - 2.0), unknown.centre + 4.0))
        elif unknown.form == "signed":
            x.append(value)
        else:
            x.append(min(max(value, 0.2 * unknown.start), 2.0 * unknown.deviation))
    return np.array(x)
