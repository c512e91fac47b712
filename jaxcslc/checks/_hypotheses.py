"""Hypotheses about a recording's columns: signs, order and units, and their correction.

`_motion_findings` scores them with `_evidence`.
"""

import dataclasses
from collections.abc import Iterator, Sequence
from itertools import combinations
from typing import Any

import numpy as np
from jaxtyping import Float, Int

from ..least_squares import HostColumns, LeastSquares
from ..recordings import Patterns, Recording
from ._evidence import Evidence


# Motion in degrees covers more than this.
_LEAST_DEGREES = 5.0
# Friction drives a joint if it feeds this part of its torque's power into the motion, and more than
# so many standard errors: joints that move alike share friction in any proportion.
_DRIVING_POWER, _SIGNIFICANT = 0.02, 3.0
# What a joint that its own friction drives adds to that mean.
_DRIVEN = 0.3


@dataclasses.dataclass(frozen=True)
class Hypothesis:
    """Fault that a recording may have, and how its patterns are without it.

    **Attributes**

    - `kind`, `joints`, `cause`, `remedy`: of the finding; joints count from 0.
    - `change`: makes a right recording of the wrong one.
    """

    kind: str
    joints: tuple[int, ...]
    cause: str
    remedy: str
    change: "Change"


def objective(evidence: Evidence, patterns: Patterns) -> float:
    """The score of patterns, plus what joints add whose friction drives them."""
    columns = evidence.columns(patterns)
    count = len(_driven_joints(evidence, patterns, columns))
    return evidence.score(patterns, columns) + _DRIVEN * count


def driven_joints(evidence: Evidence, patterns: Patterns) -> list[int]:
    """Joints, from 0, whose friction feeds power into the motion, which no friction does."""
    return _driven_joints(evidence, patterns, evidence.columns(patterns))


def _driven_joints(evidence: Evidence, patterns: Patterns, columns: HostColumns) -> list[int]:
    network = evidence.network
    kinds = network.friction_per_joint
    qd, torque = np.asarray(patterns.qd), np.asarray(patterns.torque)
    mask = np.asarray(patterns.mask)
    # Power is linear in the coefficients, and so has a standard error.
    power_rows = np.zeros((network.joint_count, network.size))
    speed = np.where(mask, qd, 0.0)
    for joint, (support, rows) in enumerate(zip(network.support, columns, strict=True)):
        power_rows[joint, list(support)] = rows @ speed[:, joint]
    power_rows[:, network.layout.inertial] = 0.0
    size = np.sqrt(
        np.where(mask, qd**2, 0.0).sum(axis=0) * np.where(mask, torque**2, 0.0).sum(axis=0)
    )
    power = power_rows @ evidence.coefficients(patterns, columns)
    suspects = [j for j in np.flatnonzero(power < -_DRIVING_POWER * size).tolist() if kinds[j]]
    if not suspects:
        return []
    fit = LeastSquares().fit(network, patterns, throw=False)
    covariance = np.asarray(fit.covariance)
    variance = np.einsum("jp,pq,jq->j", power_rows, covariance, power_rows)
    return [j for j in suspects if power[j] < -_SIGNIFICANT * np.sqrt(variance[j])]


def sign_and_order(joints: int, names: Sequence[str]) -> Iterator[Hypothesis]:
    """Signs of positions and torques of single joints, and pairs of joints swapped."""
    for joint in range(joints):
        signs = np.ones(joints)
        signs[joint] = -1.0
        for what, changes in (
            ("position", {"motion_factors": signs}),
            ("torque", {"torque_factors": signs}),
            ("position and torque", {"motion_factors": signs, "torque_factors": signs}),
        ):
            yield Hypothesis(
                "sign",
                (joint,),
                f"the {what} of {names[joint]} counts the other way round than the robot file has"
                " it",
                " and ".join(
                    f"[{quantity}] sign = {_listed(signs)}" for quantity in what.split(" and ")
                )
                + " in the mapping of --columns",
                Change(**changes),
            )
    for first, second in combinations(range(joints), 2):
        order = np.arange(joints)
        order[[first, second]] = second, first
        pair = f"{names[first]} and {names[second]}"
        for what, changes in (
            ("positions and torques", {"motion_order": order, "torque_order": order}),
            ("positions", {"motion_order": order}),
            ("torques", {"torque_order": order}),
        ):
            yield Hypothesis(
                "swapped joints",
                (first, second),
                f"the {what} of {pair} are swapped",
                f"[{what.removesuffix('s')}] columns in the robot's order, in the mapping of"
                " --columns"
                if " and " not in what
                else f"joints = {_listed(np.array(names)[order])} in the mapping of --columns",
                Change(**changes),
            )


def _listed(values: np.ndarray) -> str:
    """An array of TOML."""
    items = values.tolist()
    return f"[{', '.join(f'{x:g}' if isinstance(x, float) else f'{x!r}' for x in items)}]"


def angle_units(
    kinds: str, names: Sequence[str], extent: Float[np.ndarray, " joints"]
) -> Iterator[Hypothesis]:
    """Angles in degrees, of all revolute joints or of one; none that would be hardly any motion.

    - `extent`: of each joint's positions as recorded.
    """
    revolute = np.array([kind == "R" for kind in kinds])
    wide = np.flatnonzero(revolute & (extent > _LEAST_DEGREES)).tolist()
    groups = [tuple(np.flatnonzero(revolute).tolist())] if wide else []
    groups += [(joint,) for joint in wide if revolute.sum() > 1]
    for joints in groups:
        factors = np.ones(len(kinds))
        factors[list(joints)] = np.pi / 180.0
        whole = len(joints) == int(revolute.sum())
        whose = "positions are" if whole else f"the position of {names[joints[0]]} is"
        yield Hypothesis(
            "angle unit",
            () if whole else joints,
            f"{whose} in degrees",
            '[position] unit = "deg" in the mapping of --columns'
            if whole
            else f"name its column with its unit, as in q_{names[joints[0]]} [deg]",
            Change(motion_factors=factors),
        )


@dataclasses.dataclass(frozen=True, eq=False)
class Change:
    """Columns of positions and torques in another order, and multiplied by factors.

    **Attributes**

    - `motion_order`, `torque_order`: (n,) which column becomes each joint's; None for the same.
    - `motion_factors`, `torque_factors`: (n,) of the columns in their new order.
    """

    motion_order: Int[np.ndarray, " joints"] | None = None
    torque_order: Int[np.ndarray, " joints"] | None = None
    motion_factors: Float[np.ndarray, " joints"] | float = 1.0
    torque_factors: Float[np.ndarray, " joints"] | float = 1.0

    def motion(self, values: Any) -> np.ndarray:
        """Positions, velocities or accelerations, changed."""
        return _ordered(values, self.motion_order) * self.motion_factors

    def torque(self, values: Any) -> np.ndarray:
        """Torques, changed."""
        return _ordered(values, self.torque_order) * self.torque_factors

    def patterns(self, patterns: Patterns) -> Patterns:
        """Patterns of the changed recording."""
        return Patterns(
            patterns.time,
            self.motion(patterns.q),
            self.motion(patterns.qd),
            self.motion(patterns.qdd),
            self.torque(patterns.torque),
            self.valid(patterns.backlash_mask),
            _ordered(patterns.friction_mask, self.motion_order),
        )

    def valid(self, mask: Any) -> np.ndarray:
        """Return the mask in the new order: True where both columns of a joint are measured."""
        return _ordered(mask, self.motion_order) & _ordered(mask, self.torque_order)

    def recording(self, recording: Recording) -> Recording:
        """The changed recording, without velocities and accelerations."""
        return Recording(
            recording.time, self.motion(recording.position), self.torque(recording.torque)
        )


def _ordered(values: Any, order: Int[np.ndarray, " joints"] | None) -> np.ndarray:
    values = np.asarray(values)
    return values if order is None else values[:, order]
