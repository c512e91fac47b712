from collections.abc import Sequence

import numpy as np
from jaxtyping import Bool, Float

from ...network import CSLC
from ..solver import Equations, Unknowns


# Parts of a joint's greatest torque from which a motor may give less than is demanded.
_BENDS = (0.5, 0.75)
# Static friction decays over the threshold of the masks, or at least over this part of top speed.
_LEAST_DECAY = 0.01
# Friction terms that make a missing term part of the network.
_OFFSET_TERMS = ("offset", "asymmetric_dry")

Columns = list[Float[np.ndarray, "_ _"]]


def missing_terms(
    network: CSLC,
    qd: Float[np.ndarray, "samples joints"],
    torque: Float[np.ndarray, "samples joints"],
    mask: Bool[np.ndarray, "samples joints"],
    thresholds: Float[np.ndarray, " joints"],
) -> dict[str, Columns]:
    """Terms that manipulators often have and a network may lack (thesis, Section 7.2).

    - `"torque offset"`: a constant torque, as of friction that depends on the direction or of
      tilted base axes.
    - `"static friction"`: sgn(qd) exp(-|qd| / threshold), what remains of it beyond the masks.
    - `"motor saturation"`: torque beyond a half and beyond three quarters of a joint's greatest,
      as of motors that then give less than is demanded (7.2.3).

    **Arguments**

    - `network`: n joints. Joints that have a term of the kind are left out.
    - `qd`: velocities.
    - `torque`: that the network predicts. (With the measured torque, its noise would be on both
      sides of the equations.)
    - `mask`: pairs of joint and sample that are fitted.
    - `thresholds`: of the friction masks, (n,) [rad/s or m/s].

    **Returns** by name, the inputs of the term at each joint: (samples, number of inputs).

    >>> import numpy as np, jaxcslc as jc
    >>> network = jc.derive(jc.puma560())
    >>> motion, pairs = np.ones((4, 6)), np.ones((4, 6), bool)
    >>> terms = missing_terms(network, motion, motion, pairs, 0.1 * np.ones(6))
    >>> {name: columns[0].shape[1] for name, columns in terms.items()}
    {'torque offset': 1, 'static friction': 1, 'motor saturation': 2}
    """
    top = np.max(np.abs(np.where(mask, qd, 0.0)), axis=0)
    decay = np.maximum(thresholds, _LEAST_DECAY * top)
    decay = np.where(decay > 0.0, decay, 1.0)  # of joints that do not move
    greatest = np.max(np.abs(np.where(mask, torque, 0.0)), axis=0)
    none = np.zeros((len(qd), 0))
    terms: dict[str, Columns] = {"torque offset": [], "static friction": [], "motor saturation": []}
    for joint, friction in enumerate(network.friction_per_joint):
        v, tau = qd[:, joint], torque[:, joint]
        has_offset = any(kind in friction for kind in _OFFSET_TERMS)
        terms["torque offset"].append(none if has_offset else np.ones((len(qd), 1)))
        remaining = np.sign(v) * np.exp(-np.abs(v) / decay[joint])
        terms["static friction"].append(none if "static" in friction else remaining[:, None])
        beyond = [np.maximum(np.abs(tau) - part * greatest[joint], 0.0) for part in _BENDS]
        terms["motor saturation"].append(np.sign(tau)[:, None] * np.stack(beyond, axis=1))
    return terms


def part_of(
    equations: Equations, free: Sequence[int], k: Float[np.ndarray, " coefficients"]
) -> Equations:
    """The equations of some unknowns, the torque of the others at `k` taken off.

    **Arguments**

    - `free`: indices of the unknowns that remain, ascending.
    """
    names = tuple(equations.unknowns.names[index] for index in free)
    position = {index: number for number, index in enumerate(free)}
    support: list[tuple[int, ...]] = []
    rows: list[np.ndarray] = []
    for old, joint_rows in zip(equations.unknowns.support, equations.rows, strict=True):
        kept = np.array([index in position for index in old], bool)
        fixed = np.array([index for index in old if index not in position], int)
        target = joint_rows[:, -1] - joint_rows[:, :-1][:, ~kept] @ k[fixed]
        rows.append(np.column_stack([joint_rows[:, :-1][:, kept], target]))
        support.append(tuple(position[index] for index in old if index in position))
    return Equations(Unknowns(names, tuple(support)), tuple(rows), equations.sample)
