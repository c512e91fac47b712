"""A block that is added from outside: wind, a constant torque of one joint that no term has."""

import dataclasses
from collections.abc import Sequence

import numpy as np
from jaxtyping import Float
from numpy.testing import assert_allclose

import jaxcslc as jc
from jaxcslc.likelihood import (
    AbstractEquations,
    EquationPoint,
    JointColumns,
    LikelihoodProblem,
    Linearisation,
    SearchStart,
    border_errors,
    search,
)
from tests import arms


WIND = "wind"
SAMPLES, NOISE = 400, 1e-3  # of torque [N m]


@dataclasses.dataclass(frozen=True)
class WindEquations(AbstractEquations):
    """Equations of motion with a constant torque of the last joint, the last of their laws."""

    still: AbstractEquations

    @property
    def network(self) -> jc.CSLC:  # pyright: ignore[reportIncompatibleVariableOverride]
        return self.still.network

    @property
    def intervals(self) -> Float[np.ndarray, " intervals"]:  # pyright: ignore[reportIncompatibleVariableOverride]
        return self.still.intervals

    def torque(self, at: EquationPoint) -> np.ndarray:
        torque = np.array(self.still.torque(at._replace(laws=at.laws[:-1])))
        torque[:, -1] += at.laws[-1]
        return torque

    def linearised(self, at: EquationPoint) -> Linearisation:
        still = self.still.linearised(at._replace(laws=at.laws[:-1]))
        columns = np.pad(still.by_coefficient.dense, ((0, 0), (0, 0), (0, 1)))
        columns[:, -1, -1] = 1.0
        return still._replace(torque=self.torque(at), by_coefficient=JointColumns.of(columns))


def with_wind(
    problem: LikelihoodProblem, start: SearchStart
) -> tuple[LikelihoodProblem, SearchStart]:
    """Add wind of about 0.1 N m, of which nothing is known beforehand."""
    none = np.zeros(1)
    wide = problem.with_unknowns(WIND, np.array([0.1]), none, none, none - np.inf)
    wide = dataclasses.replace(wide, equations=WindEquations(problem.equations))
    border = wide.layout.inserted(start.point.border, WIND, none)
    point = dataclasses.replace(start.point, border=border, layout=wide.layout)
    return wide, start._replace(point=point)


def fitted(network: jc.CSLC, recordings: Sequence[jc.Recording]) -> tuple[np.ndarray, float, float]:
    """Coefficients, wind, and its standard error."""
    estimator = jc.MaximumLikelihood(torque_sampling="sampled")
    problem, start = with_wind(*estimator.start(network, recordings, None, 1))
    minimum = search(problem, *start, lambda words: None)
    assert minimum.converged
    point, errors = minimum.point, border_errors(minimum, "independent")
    return point.k, point.values(WIND).item(), errors.error[point.layout.part(WIND)].item()


def test_wind_is_found_beside_coefficients(rng: np.random.Generator) -> None:
    network, k, wind = arms.pendulum("viscous"), np.array([0.5, 0.3, -0.1, 0.2]), 0.7
    exact = jc.examples.swing_recording(network, k.tolist(), samples=SAMPLES)
    noise = NOISE * rng.normal(size=exact.torque.shape)
    recording = dataclasses.replace(exact, torque=exact.torque + wind + noise)
    found, torque, error = fitted(network, [recording])
    assert abs(torque - wind) < 4.0 * error < 0.01
    assert_allclose(found, k, atol=0.01)
    # Without the block, coefficients have to make up for it.
    still = jc.MaximumLikelihood(torque_sampling="sampled").fit(network, recording)
    assert np.max(np.abs(np.asarray(still.k) - k)) > 0.1
