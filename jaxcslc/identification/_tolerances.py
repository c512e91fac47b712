"""Systematic errors by faults that stay possible, of the fit that a report has."""

import numpy as np

from ..bodies import ChosenPrior, FilePrior
from ..least_squares import Fixed, Identification
from ..network import CSLC
from ..uncertainty import Estimate, SystematicError, possible_faults
from ._problem import Problem


# Singular values of scaled covariances that count: coefficients of one body may be proportional.
_ROUNDING = 1e-10


def with_possible_faults(
    problem: Problem,
    network: CSLC,
    fit: Identification,
    systematic: SystematicError | None,
    unconstrained: Identification,
    file: ChosenPrior | None,
) -> SystematicError | None:
    """Add the errors by faults within tolerances to a fit's systematic error, if there is one.

    - `network`, `fit`: that the report has.
    - `unconstrained`: without the prior of the robot's `file`.
    """
    if systematic is None:
        return None
    k, groups = np.asarray(fit.k), problem.request.groups
    free = np.asarray(fit.determined).copy()
    free[[i for i, entry in problem.known.items() if entry.fixed]] = False
    if groups is not None:
        fitted = np.zeros(network.size, bool)
        fitted[list(Fixed.except_for(network, k, groups).free)] = True
        free &= fitted
    scale, follow = Estimate(), None
    if file is not None:
        scale = torque_scale(file.prior, unconstrained)
        follow = file.prior.data_share(unconstrained)
    faults = possible_faults(
        network, problem.patterns["training"], k, free, scale=scale, follow=follow
    )
    parts = {cause: np.where(free, part, 0.0) for cause, part in faults.parts.items()}
    return SystematicError({**systematic.parts, **parts}, faults.within)


def torque_scale(prior: FilePrior, fit: Identification) -> Estimate:
    """Return what a robot's file says of the factor of all torques, less 1.

    A fit's inertial coefficients are the file's times the factor, within the errors of both
    (generalised least squares).

    - `fit`: without the prior.
    """
    known = np.flatnonzero(prior.inertial & np.asarray(fit.determined))
    covariance = (np.asarray(fit.covariance) + prior.covariance)[np.ix_(known, known)]
    sizes = np.sqrt(np.maximum(np.diag(covariance), np.finfo(float).tiny))
    inverse = np.linalg.pinv(covariance / np.outer(sizes, sizes), _ROUNDING, hermitian=True)
    file, fitted = prior.mean[known] / sizes, np.asarray(fit.k)[known] / sizes
    information = float(file @ inverse @ file)
    if not information > 0.0:
        return Estimate()
    return Estimate(float(file @ inverse @ fitted) / information - 1.0, information**-0.5)
