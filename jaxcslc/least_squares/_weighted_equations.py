"""Equations with the weights that their fit ended with, in which changes are linear."""

import dataclasses
from collections.abc import Sequence
from itertools import pairwise

import jax.numpy as jnp
import numpy as np
from jaxtyping import Float, Int

from .._rank import pseudo_inverse
from ._equations import Equations
from ._factors import JointFactors, Unknowns
from ._least_squares import LeastSquares
from ._losses import Loss, robust_scale, weight
from ._minimum import Solution, minimum, residual_weights


@dataclasses.dataclass(frozen=True)
class WeightedEquations:
    """The equations of a fit with the weights that it ended with: what errors of it are linear in.

    **Attributes**

    - `equations`: as of `LeastSquares.equations`.
    - `weights`: of joints, (n,).
    - `roots`: for each joint, the roots of its equations' weights under a robust loss.
    - `rcond`: of `LeastSquares`.
    """

    equations: Equations
    weights: Float[np.ndarray, " joints"]
    roots: tuple[Float[np.ndarray, " _"], ...]
    rcond: float | None

    @classmethod
    def of(
        cls, equations: Equations, k: Float[np.ndarray, " unknowns"], solver: LeastSquares
    ) -> "WeightedEquations":
        """Weight equations as in their fit, which ended with `k`."""
        errors = equations.errors(k)
        roots = tuple(_robust_roots(error, solver.loss) for error in errors)
        counts = np.array([float(len(error)) for error in errors])
        if solver.joint_weights == "residual":
            squares = [np.sum((r * e) ** 2) for r, e in zip(roots, errors, strict=True)]
            weights = residual_weights(np.sqrt(squares / np.maximum(counts, 1.0)), counts)
        elif isinstance(solver.joint_weights, str):
            weights = np.ones(len(errors))
        else:
            weights = np.asarray(solver.joint_weights, float)
        return cls(equations, np.asarray(weights), roots, solver.rcond)

    def solution(self, equations: Equations) -> Solution:
        """The minimum of other equations of the same pairs, with the same weights."""
        return self.minimum(equations.unknowns, equations.times(self.roots).factors())

    def factors_of_folds(
        self, equations: Equations, fold: Int[np.ndarray, " samples"]
    ) -> JointFactors:
        """Return the factors of other equations of the same pairs, each fold by itself.

        - `fold`: the fold of each sample, from 0.
        """
        return equations.times(self.roots).factors_of_folds(fold, int(fold[-1]) + 1)

    def minimum(self, unknowns: Unknowns, factors: JointFactors) -> Solution:
        """The minimum of factorised equations, joints weighted as here."""
        return minimum(unknowns, factors, self.weights, self.rcond)

    def shifts(
        self, torques: Sequence[Float[np.ndarray, "_ changes"]]
    ) -> Float[np.ndarray, "unknowns changes"]:
        """Return the changes of the unknowns when changes are added to the torques.

        - `torques`: for each joint (equations, changes).
        """
        last = max((int(sample[-1]) for sample in self.equations.sample if sample.size), default=0)
        return self.shifts_of_stretches(torques, np.array([0, last + 1]))[0]

    def shifts_of_stretches(
        self, torques: Sequence[Float[np.ndarray, "_ changes"]], edges: Int[np.ndarray, " edges"]
    ) -> Float[np.ndarray, "stretches unknowns changes"]:
        """Return the part of `shifts` due to the equations in each stretch of the recording.

        - `edges`: samples that stretches begin with, and the one after the last.
        """
        unknowns = self.equations.unknowns
        scores = np.zeros((len(edges) - 1, unknowns.size, torques[0].shape[1]))
        for support, rows, sample, size, root, columns in zip(
            unknowns.support,
            self.equations.rows,
            self.equations.sample,
            self.weights,
            self.roots,
            torques,
            strict=True,
        ):
            weighted = ((size * root) ** 2)[:, None] * rows[:, :-1]
            bounds = pairwise(np.searchsorted(sample, edges))
            for score, (start, stop) in zip(scores, bounds, strict=True):
                score[list(support)] += weighted[start:stop].T @ columns[start:stop]
        return np.asarray(self.solution(self.equations).inverse_gram) @ scores


def changes_of(
    stacked: Float[np.ndarray, "rows columns"], size: int
) -> Float[np.ndarray, "unknowns further"]:
    """Return the changes of the first unknowns per unit of each further unknown that is left out.

    - `stacked`: the columns of the unknowns, of the further ones, and the torque.
    """
    return pseudo_inverse(stacked[:, :size]) @ stacked[:, size:-1]


def _robust_roots(error: Float[np.ndarray, " equations"], loss: Loss) -> Float[np.ndarray, " _"]:
    """The roots of the weights that a joint's equations have in a fit that leaves these errors."""
    if loss == "squared" or not error.size:
        return np.ones(len(error))
    column = jnp.asarray(error)[:, None]
    scale = float(robust_scale(column, jnp.ones_like(column))[0])
    return np.sqrt(np.asarray(weight(loss, column[:, 0] / (scale or 1.0))))
