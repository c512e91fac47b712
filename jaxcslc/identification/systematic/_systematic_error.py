import dataclasses
from collections.abc import Mapping, Sequence

import numpy as np
import scipy
from jaxtyping import Float

from ..solver import Identification


@dataclasses.dataclass(frozen=True)
class SystematicError:
    """Errors of a fit that are the same in every recording of a motion: no residual shows them.

    **Attributes**

    - `parts`: by cause, the size of each coefficient's error, (p,), 0 or more; see
      `systematic_error`.

    >>> import numpy as np
    >>> from jaxcslc.identification import SystematicError
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
        """The same without the errors of some coefficients, such as fixed ones."""
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
    >>> from jaxcslc.identification import SystematicError, standard_uncertainty
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
    >>> from jaxcslc.identification import SystematicError, uncertainty_interval
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
