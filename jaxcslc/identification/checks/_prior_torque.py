import dataclasses

import numpy as np
from jaxtyping import Float

from ...motion import Patterns
from ...network import CSLC
from ..solver import Equations, HostColumns, LeastSquares, Unknowns, torque_by


# A joint follows the file's torque well from this part of the variance on.
WELL = 0.5


@dataclasses.dataclass(frozen=True)
class PriorFit:
    """How recorded torques follow those of the masses in the robot's file.

    Joint by joint, torque is a factor times the file's torque, plus friction and an offset.

    **Attributes**

    - `factor`: (n,) of each joint; 1 where file and recording agree.
    - `explained`: (n,) part of the variance that friction leaves and the file's torque explains.
    - `size`: (n,) root mean square of the file's torque, over that of the recorded torque.
    """

    factor: Float[np.ndarray, " joints"]
    explained: Float[np.ndarray, " joints"]
    size: Float[np.ndarray, " joints"]

    @property
    def common_factor(self) -> float:
        """Median factor of the joints that the file's torque explains well; NaN without any."""
        well = self.explained > WELL
        return float(np.median(self.factor[well])) if well.any() else np.nan

    @property
    def factors(self) -> Float[np.ndarray, " joints"]:
        """(n,) factors of the joints that the file's torque explains well, the common one of
        the others."""
        return np.where(self.explained > WELL, self.factor, self.common_factor)


def prior_fit(network: CSLC, patterns: Patterns, columns: HostColumns) -> PriorFit | None:
    """Compares recorded torque with that of the file's masses; None if the file has none.

    **Arguments**

    - `network`: n joints.
    - `patterns`: of n joints.
    - `columns`: of the regressor of their motion.
    """
    robot = network.robot
    if robot.links is None or not any(float(link.mass) for link in robot.links):
        return None
    k = np.asarray(network.coefficients_from(robot.links))
    expected = torque_by(network.support, columns, k)
    qd, mask = np.asarray(patterns.qd), np.asarray(patterns.mask)
    terms = np.stack([expected, qd, np.sign(qd), np.ones_like(qd)], axis=0)
    with_file, factor = _errors(patterns, terms, mask)
    without_file, _ = _errors(patterns, terms[1:], mask)
    counts = np.maximum(mask.sum(axis=0), 1)
    sizes = [
        np.sqrt(np.where(mask, values**2, 0.0).sum(axis=0) / counts)
        for values in (expected, np.asarray(patterns.torque))
    ]
    # Of a torque that was not recorded nothing is left to explain, and nothing is explained.
    recorded = without_file > 0.0
    explained = (
        1.0 - (np.where(recorded, with_file, 1.0) / np.where(recorded, without_file, 1.0)) ** 2
    )
    return PriorFit(factor, explained, sizes[0] / np.maximum(sizes[1], 1e-300))


def _errors(
    patterns: Patterns, terms: Float[np.ndarray, "terms samples joints"], mask: np.ndarray
) -> tuple[np.ndarray, np.ndarray]:
    """Root mean square errors of joints with coefficients of their own, and the first of these."""
    count, samples, joints = terms.shape
    unknowns = Unknowns(
        tuple(f"{joint} {term}" for joint in range(joints) for term in range(count)),
        tuple(tuple(range(joint * count, (joint + 1) * count)) for joint in range(joints)),
    )
    equations = Equations.of_columns(
        unknowns,
        tuple(np.moveaxis(terms, -1, 0)),
        np.asarray(patterns.torque),
        mask,
        time=np.asarray(patterns.time),
        cutoff=None,
    )
    solver = LeastSquares(errors="independent", joint_weights="equal")
    fit = solver.fit_equations(equations, samples, throw=False)
    return np.asarray(fit.torque_error), np.asarray(fit.k)[::count]
