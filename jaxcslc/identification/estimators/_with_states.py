import dataclasses
from collections.abc import Sequence

import numpy as np
from jaxtyping import Float

from ...motion import Patterns
from ..friction import PreSlidingFit, along_motion, checked_lengths
from ..report import Report
from ..solver import Identification


def with_states(report: Report, lengths: Sequence[float]) -> Report:
    """A report of least squares with a fit whose dry friction yields over known lengths.

    **Arguments**

    - `report`: of least squares.
    - `lengths`: (n,) of pre-sliding [rad or m]; or none.

    **Returns** the report, with `pre_sliding` if there are any: a free fit to its patterns.

    **Raises** `ValueError` for lengths that are not n or of joints without dry friction.
    """
    if not any(lengths):
        return report
    values = checked_lengths(report.network, lengths)
    fit = fit_along(report, report.patterns["training"], values)
    return dataclasses.replace(
        report, pre_sliding=PreSlidingFit(report.network, fit, values, {}, values)
    )


def fit_along(
    report: Report, patterns: Patterns, lengths: Float[np.ndarray, " joints"]
) -> Identification:
    """The fit of least squares to patterns, dry friction with its states along their motion.

    **Arguments**

    - `report`: whose network and solver it is of.
    - `patterns`: of one motion, or of several one after the other.
    - `lengths`: (n,) of pre-sliding [rad or m]; 0 where dry friction follows the sign of velocity.
    """
    network = along_motion(report.network, patterns, lengths)
    return report.settings.solver.fit(network, patterns)
