"""Systematic errors of coefficients, and intervals that include them (thesis 7.2).

`_systematic_problem` estimates them.
"""

import dataclasses
from collections.abc import Mapping, Sequence

import numpy as np
import scipy
from jaxtyping import Bool, Float

from ..least_squares import Equations, Identification, Unknowns
from ..network import CSLC


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


@dataclasses.dataclass(frozen=True)
class SystematicError:
    """Errors of a fit that are the same in every recording of a motion: no residual shows them.

    **Attributes**

    - `parts`: by cause, the size of each coefficient's error, (p,), 0 or more; see
      `systematic_error`.

    >>> import numpy as np
    >>> from jaxcslc.uncertainty import SystematicError
    >>> error = SystematicError({"smoothing": np.array([3.0]), "torque offset": np.array([4.0])})
    >>> error.total.tolist(), error.main_cause(0)
    ([5.0], 'torque offset')
    """

    parts: Mapping[str, Float[np.ndarray, " coefficients"]]

    @property
    def total(self) -> Float[np.ndarray, " coefficients"]:
        """The root of the sum of the squares of all parts, (p,)."""
        return np.sqrt(np.sum([part**2 for part in self.parts.values()], axis=0))

    def without(self, indices: Sequence[int]) -> "SystematicError":
        """Remove the errors of some coefficients, such as fixed ones."""
        free = np.ones(len(self.total), bool)
        free[list(indices)] = False
        return SystematicError({cause: part * free for cause, part in self.parts.items()})

    def main_cause(self, index: int) -> str:
        """The cause of the largest part of a coefficient's error."""
        return max(self.parts, key=lambda cause: float(self.parts[cause][index]))


def standard_uncertainty(
    fit: Identification, systematic: SystematicError | None
) -> Float[np.ndarray, " coefficients"]:
    """Standard error and systematic error of each coefficient together, (p,), in its unit.

    The root of the sum of their squares, as the Guide to the Expression of Uncertainty in
    Measurement (JCGM 100:2008, 5.1) combines uncertainties of independent causes.

    **Arguments**

    - `fit`: p coefficients.
    - `systematic`: of the fit; the standard error alone if None.

    >>> import numpy as np, jaxcslc as jc
    >>> from jaxcslc.uncertainty import SystematicError, standard_uncertainty
    >>> pendulum = jc.Manipulator.from_modified_dh([(0, 0, 0, 0)], gravity=(0, 0, -9.81))
    >>> network = jc.derive(pendulum.with_friction(), lengths="numeric")
    >>> t = np.linspace(0, 5, 500)[:, None]
    >>> motion, pairs = (np.sin(t), np.cos(t), -np.sin(t)), np.ones(t.shape, bool)
    >>> torque = -0.5 * np.sin(t) + 0.01 * np.random.default_rng(0).normal(size=t.shape)
    >>> fit = jc.LeastSquares().fit(network, jc.Patterns(t[:, 0], *motion, torque, pairs, pairs))
    >>> systematic = SystematicError({"smoothing": np.array([0.003])})
    >>> np.round(standard_uncertainty(fit, systematic), 4).tolist()
    [0.0031]
    """
    error = np.asarray(fit.standard_error)
    return error if systematic is None else np.sqrt(error**2 + systematic.total**2)


def uncertainty_interval(
    fit: Identification, systematic: SystematicError | None = None, level: float = 0.95
) -> Float[np.ndarray, "coefficients 2"]:
    """Lower and upper end of each coefficient's interval, systematic error included, (p, 2).

    Without a systematic error the intervals of `Identification.confidence_interval`; with one,
    wider by the factor by which `standard_uncertainty` exceeds the standard error.

    **Arguments**

    - `fit`: p coefficients.
    - `systematic`: of the fit.
    - `level`: as of `Identification.confidence_interval`.

    **Raises**

    - `ValueError`: a level that is not between 0 and 1.

    >>> import numpy as np, jaxcslc as jc
    >>> from jaxcslc.uncertainty import SystematicError, uncertainty_interval
    >>> arm = jc.Manipulator.from_modified_dh([(0, 0, 0, 0)], gravity=(0, 0, -9.81))
    >>> network = jc.derive(arm, lengths="numeric")
    >>> t = np.linspace(0, 5, 500)[:, None]
    >>> motion, pairs = (np.sin(t), np.cos(t), -np.sin(t)), np.ones(t.shape, bool)
    >>> torque = np.asarray(network.torque(np.array([0.5, 2.0, 1.0]), *motion))
    >>> fit = jc.LeastSquares().fit(network, jc.Patterns(t[:, 0], *motion, torque, pairs, pairs))
    >>> shifted = SystematicError({"smoothing": np.array([0.01, 0.0, 0.0])})
    >>> bool(np.diff(uncertainty_interval(fit, shifted)[0])[0] > 0.02)
    True
    """
    interval = fit.confidence_interval(level)
    if systematic is None:
        return interval
    quantile = float(scipy.special.stdtrit(float(fit.degrees_of_freedom), 0.5 + 0.5 * level))
    half = quantile * standard_uncertainty(fit, systematic)
    k = np.asarray(fit.k)
    return np.stack([k - half, k + half], axis=-1)
