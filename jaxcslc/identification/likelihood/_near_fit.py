import dataclasses

import numpy as np

from ._likelihood_fit import LikelihoodFit
from ._point import Point


def point_near(point: Point, fit: LikelihoodFit) -> Point:
    """A point with the values of a fit that is near.

    **Raises** `ValueError` if the fit's positions are at other samples than the point's.
    """
    if fit.position.shape != point.q.shape or fit.offset.shape != point.offset.shape:
        raise ValueError(
            f"start: its positions are {fit.position.shape} of {len(fit.offset)} recordings;"
            f" expected {point.q.shape} of {len(point.offset)}"
        )
    slopes = np.log(fit.slopes) if fit.network.static_slopes is not None else point.slopes
    values = point.with_values(k=np.asarray(fit.k), slopes=slopes, offset=fit.offset)
    return dataclasses.replace(values, q=fit.position)
