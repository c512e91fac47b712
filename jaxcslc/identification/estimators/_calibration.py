import dataclasses
from collections.abc import Iterable, Mapping
from types import MappingProxyType

import numpy as np

from ...motion import Recording, joined_patterns
from .._identify_one import without_lag
from ..likelihood import LikelihoodFit
from ..report import Report


def calibrated(recording: Recording, likelihood: LikelihoodFit) -> Recording:
    """A recording with torque as maximum likelihood says that it was.

    **Arguments**

    - `recording`: of n joints.
    - `likelihood`: whose lag and gains of torque hold; a fit without them leaves all as it is.

    **Returns** the recording, torques times gains and so much earlier.

    >>> import numpy as np, jaxcslc as jc
    >>> from jaxcslc.identification.estimators import calibrated
    >>> network = jc.derive(jc.Manipulator.from_modified_dh([(0, 0, 0, 0)]), lengths="numeric")
    >>> t = np.arange(200)[:, None] * 0.01
    >>> recording = jc.Recording(t[:, 0], np.sin(2 * t), -2.0 * np.sin(2 * t))
    >>> fit = jc.MaximumLikelihood(torque_sampling="sampled").fit(network, recording)
    >>> calibrated(recording, fit) is recording
    True
    """
    if not likelihood.unknowns:
        return recording
    late = without_lag(recording, likelihood.torque_lag)
    return dataclasses.replace(late, torque=np.asarray(late.torque) * likelihood.torque_gain)


def calibrated_report(
    report: Report,
    likelihood: LikelihoodFit,
    training: Iterable[Recording],
    validation: Iterable[Recording],
) -> Report:
    """A report of least squares of the same recordings, had their torques been right.

    **Arguments**

    - `report`: of least squares.
    - `likelihood`: with lag or gains of torque.
    - `training`, `validation`: recordings without the lag that the report's settings have.

    **Returns** the report with patterns and coefficients of calibrated torques; its errors and its
    uncertainty are those of before.
    """
    settings = report.settings.with_options(torque_lag=0.0)
    names: Mapping[str, Iterable[Recording]] = {"training": training, "validation": validation}
    patterns = {
        name: joined_patterns([settings.patterns(calibrated(x, likelihood)) for x in recordings])
        for name, recordings in names.items()
        if name in report.patterns
    }
    fit = settings.solver.fit(report.network, patterns["training"])
    return dataclasses.replace(report, patterns=MappingProxyType(patterns), fit=fit)
