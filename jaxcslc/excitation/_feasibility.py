"""Use of limits by a motion at all times, and the scaling of a motion until it keeps them."""

import bisect
import dataclasses
from collections.abc import Callable
from typing import Any

import numpy as np
from jaxtyping import Float

from ..network import CSLC
from ._families import AbstractFamily, Parameters, sample_times
from ._information import motion_torques
from ._limits import QUANTITIES, Joints, Limits


# Friction terms that do not jump where a joint reverses.
_SMOOTH = ("viscous", "quadratic", "offset")
# Scales that a motion may have: known to 1e-4.
_SCALES = np.arange(1, 2**14) / 2**14
# Of a limit: so little is left of it at the end, for rounding.
_ROUNDING = 1e-9


@dataclasses.dataclass(frozen=True, eq=False)
class Use:
    """Use of each limit by a motion, between samples included: 1 is all of it.

    **Attributes**

    - `joints`: by name of the limit, (n,).
    - `distance`: least distance of bodies less the clearance [m]; None where none is kept.
    - `nearest`: which bodies these are.
    - `names`: of the joints; by their numbers if empty.

    >>> import numpy as np
    >>> from jaxcslc.excitation import Use
    >>> use = Use({"velocity": np.array([0.5, 0.9]), "torque": np.array([0.7, 0.2])})
    >>> use.feasible, use.worst
    (True, 'velocity of joint 2 (90 % of its limit)')
    """

    joints: dict[str, Joints]
    distance: float | None = None
    nearest: str = ""
    names: tuple[str, ...] = ()

    @property
    def feasible(self) -> bool:
        """True if all limits are kept."""
        within = all(np.all(values <= 1.0 - _ROUNDING) for values in self.joints.values())
        return within and (self.distance is None or self.distance >= 0.0)

    @property
    def worst(self) -> str:
        """The limit of which most is used, in words."""
        if self.distance is not None and self.distance < 0.0:
            return f"clearance of {self.nearest} ({-1e3 * self.distance:.3g} mm short)"
        name, values = max(self.joints.items(), key=lambda item: float(item[1].max()))
        joint = int(values.argmax())
        return f"{name} of {self._name(joint)} ({100 * values[joint]:.4g} % of its limit)"

    def margins(self) -> list[dict[str, Any]]:
        """Return one row per limit: the part that is left at the joint that uses most."""
        rows: list[dict[str, Any]] = [
            {"limit": name, "joint": int(x.argmax()) + 1, "margin": float(1.0 - x.max())}
            for name, x in self.joints.items()
        ]
        if self.distance is not None:
            rows.append(
                {"limit": f"clearance, {self.nearest}", "joint": 0, "margin": self.distance}
            )
        return rows

    def __str__(self) -> str:
        parts = [
            f"{row['limit']} {100 * row['margin']:.2g} % ({self._name(row['joint'] - 1)})"
            for row in self.margins()
            if row["joint"]
        ]
        if self.distance is not None:
            parts.append(f"{self.nearest} {1e3 * self.distance:.3g} mm beyond the clearance")
        return "margins: " + ", ".join(parts)

    def _name(self, joint: int) -> str:
        """Return the name of a joint, from 0."""
        return self.names[joint] if self.names else f"joint {joint + 1}"


def without_jumps(
    network: CSLC, k: Float[np.ndarray, " coefficients"]
) -> Float[np.ndarray, " coefficients"]:
    """Return coefficients (p,) with zeros for friction that jumps where a joint reverses."""
    layout, smooth = network.layout, np.array(k, float)
    for kind in layout.kinds:
        part = layout.term_slice(kind)
        friction = np.isin(np.arange(layout.size)[part], layout.friction).any()
        if friction and kind not in _SMOOTH:
            smooth[part] = 0.0
    return smooth


class DenseCheck:
    """Check that a motion keeps all limits, at all times.

    Positions and derivatives are sampled, and what a derivative of higher order allows between
    samples is added; that is a bound, not an estimate. Torque is the prior model's; between
    samples, half the largest second difference of what does not jump is added, and friction that
    reverses there has both signs.

    >>> import numpy as np, jaxcslc as jc
    >>> from jaxcslc.excitation import BSplines, DenseCheck, Limits
    >>> network = jc.derive(jc.examples.turntable(), lengths="numeric")
    >>> limits = Limits.of(network.robot, {"position": [-1, 1], "velocity": 2, "torque": 5})
    >>> family = BSplines(2.0, 4)
    >>> check = DenseCheck(network, np.array([0.5, 0.1, 0.1]), limits, family)
    >>> use = check.use(np.linspace(0.0, 1.2, family.size)[:, None])
    >>> use.feasible, use.worst.partition(" (")[0]
    (False, 'position of joint 1')
    """

    def __init__(
        self,
        network: CSLC,
        k: Float[np.ndarray, " coefficients"] | None,
        limits: Limits,
        family: AbstractFamily,
        *,
        rate: float = 500.0,
        distance: Callable[[AbstractFamily, Parameters], tuple[float, str]] | None = None,
    ) -> None:
        """**Arguments**

        - `k`: (p,) the prior model; None to check no torques.
        - `rate`: of the samples [Hz].
        - `distance`: least distance of bodies less the clearance [m] of a motion, and which.
        """
        self.family, self.limits, self._network = family, limits, network
        self._time = sample_times(family.duration, rate)
        self._interval = float(self._time[1])
        self._basis = [family.basis(self._time, order) for order in range(4)]
        self._distance = distance
        self._models: Float[np.ndarray, "2 coefficients"] | None = None
        if k is not None:
            self._models = np.stack([np.asarray(k, float), without_jumps(network, k)])

    def use(self, parameters: Parameters, *, bodies: bool = True) -> Use:
        """Compute how much of each limit a motion uses; `bodies`: look for collisions too."""
        parameters = np.asarray(parameters, float)
        joints: dict[str, Joints] = {}
        derivatives = [basis @ parameters for basis in self._basis]
        for order, name in enumerate(QUANTITIES):
            middle, half = self.limits.symmetric(order)
            reached = np.abs(derivatives[order] - middle).max(0)
            reached += self.family.between_samples(parameters, order, self._interval)
            if order:  # the family's bound holds at all times, and may be the smaller
                reached = np.minimum(reached, self.family.bound(parameters, order))
            joints[name] = reached / half
        if self._models is not None:
            joints |= self._torques(self._models, derivatives)
        names = self._network.output_names
        if self._distance is None or not bodies:
            return Use(joints, names=names)
        return Use(joints, *self._distance(self.family, parameters), names)

    def _torques(
        self, models: Float[np.ndarray, "2 coefficients"], derivatives: list[np.ndarray]
    ) -> dict[str, Joints]:
        torque, smooth = motion_torques(self._network, models, *derivatives[:3])
        second = np.abs(np.diff(smooth, 2, axis=0)).max(0) / 2
        largest = np.abs(torque)
        # Where friction reverses between two samples, it has both signs at one instant.
        jump = torque - smooth
        flips = np.sign(jump[1:]) != np.sign(jump[:-1])
        beside = np.zeros(jump.shape, bool)
        beside[1:] |= flips
        beside[:-1] |= flips
        friction = np.abs(jump)
        friction[1:] = np.maximum(friction[1:], np.abs(jump[:-1]))
        friction[:-1] = np.maximum(friction[:-1], np.abs(jump[1:]))
        largest = np.where(beside, np.abs(smooth) + friction, largest)
        uses = {"torque": (largest.max(0) + second) / self.limits.usable_torque}
        if np.isfinite(self.limits.power).any():
            power = (largest + second) * np.abs(derivatives[1])
            uses["power"] = power.max(0) / self.limits.usable_power
        return uses

    def scaled(
        self, parameters: Parameters, home: Float[np.ndarray, " joints"] | None = None
    ) -> tuple[Parameters, Use, float]:
        """Return the largest motion about the same start that keeps all limits.

        - `home`: (joints,) pose in which the arm may rest. The motion is shrunk towards it where
          the arm may not rest in the motion's own start.

        **Returns** its parameters, how much of the limits it uses, and by which factor it was
        shrunk.

        **Raises**

        - `ValueError`: resting at the start exceeds a limit; names it.
        """
        use = self.use(parameters)
        if use.feasible:
            return parameters, use, 1.0
        resting = self.family.scaled(parameters, 0.0)
        at_rest = self.use(resting)
        if not at_rest.feasible and home is not None:
            resting[0] = home
            at_rest = self.use(resting)
        if not at_rest.feasible:
            raise ValueError(
                f"no motion from this start keeps the limits: at rest there, {at_rest.worst}"
            )
        best = resting, at_rest, 0.0

        def too_large(factor: float) -> bool:
            nonlocal best
            trial = resting + factor * (parameters - resting)
            use = self.use(trial, bodies=False)
            if use.feasible and self._distance is not None:
                use = self.use(trial)
            if use.feasible:
                best = trial, use, factor
            return not use.feasible

        bisect.bisect_left(_SCALES, True, key=too_large)
        return best

    def within_kinematic_limits(self, parameters: Parameters, part: float = 1.0) -> Parameters:
        """Shrink each joint's motion until it keeps a part of its kinematic limits.

        These are linear in the parameters.
        """
        parameters = np.array(parameters, float)
        start = parameters[0].copy()
        derivatives = [basis @ parameters for basis in self._basis]
        factor = np.ones(len(start))
        for order in range(4):
            middle, half = self.limits.symmetric(order)
            at_start = start if order == 0 else 0.0
            change = derivatives[order] - at_start
            for sign in (1.0, -1.0):
                largest = (sign * change).max(0)
                room = part * half - sign * (at_start - middle)
                factor = np.minimum(factor, np.where(largest > 0, room / largest.clip(1e-12), 1.0))
        parameters[1:] *= np.clip(factor, 0.0, 1.0)
        return parameters
