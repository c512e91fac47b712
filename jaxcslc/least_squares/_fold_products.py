"""Coefficients of all folds but one from products of columns, where these are accurate enough.

A search for settings fits some thirty times eight folds, and compares what the fits predict. That
needs fewer digits than coefficients that are reported, which come from triangles (`_minimum`).
"""

from typing import NamedTuple

import numpy as np
from jaxtyping import Float, Int

from .._rank import rank_tolerance
from ._equations import Equations, samples_of
from ._factors import ROUNDINGS, Unknowns
from ._minimum import JointWeights, first_weights, weights_by_residual


# Largest squared condition number of weighted equations, columns of unit length. Rounding of
# products, 2e-16, changes the least determined combination of coefficients by 2e-6 then, and the
# torque that they predict by 2e-11.
_WORST = 1e10
# Squared residuals below this part of a joint's squared torque are lost in rounding of products.
_LEAST_RESIDUAL = 1e-10


class FoldProducts(NamedTuple):
    """Products of regressor columns and torque with each other: for each fold, of all others.

    They cost a fifth of the triangles of as many equations, and their sums next to nothing.

    - `products`: for each joint (folds, s + 1, s + 1), the torque last.
    - `counts`: (folds, n) equations of each joint.
    """

    unknowns: Unknowns
    products: tuple[Float[np.ndarray, "folds _ _"], ...]
    counts: Float[np.ndarray, "folds joints"]

    @classmethod
    def of(cls, equations: Equations, fold: Int[np.ndarray, " samples"]) -> "FoldProducts":
        """Multiply the columns of equations; columns that are no more than rounding are zero.

        - `fold`: the fold of each sample, from 0.
        """
        folds = int(np.max(fold)) + 1
        # Sums of the others: a difference to the sum of all would lose digits.
        others = (~np.eye(folds, dtype=bool)).astype(float)
        counts: list[np.ndarray] = []
        products: list[np.ndarray] = []
        for joint, (rows, sample) in enumerate(zip(equations.rows, equations.sample, strict=True)):
            parts = [rows[samples_of(fold[sample], number)] for number in range(folds)]
            counts.append(others @ [float(len(part)) for part in parts])
            summed = np.tensordot(others, np.stack([part.T @ part for part in parts]), 1)
            if equations.unknowns.rounding is not None:
                sizes = ROUNDINGS * np.array([*equations.unknowns.rounding[joint], 0.0])
                squares = np.diagonal(summed, axis1=1, axis2=2)
                more = squares > sizes**2 * counts[-1][:, None]
                summed = np.where(more[:, :, None] & more[:, None, :], summed, 0.0)
            products.append(summed)
        return cls(equations.unknowns, tuple(products), np.stack(counts, axis=-1))

    def coefficients(
        self, joint_weights: JointWeights, rcond: float | None
    ) -> Float[np.ndarray, "folds coefficients"] | None:
        """Return the fits to all folds but one; None where products are not accurate enough.

        - `joint_weights`, `rcond`: as of `LeastSquares`.
        """
        if not all(np.all(np.isfinite(of_joint)) for of_joint in self.products):
            return None
        tolerance = np.max(rank_tolerance(self.unknowns.size, self.counts.sum(axis=-1), rcond))
        worst = min(_WORST, tolerance**-2) if tolerance > 0.0 else _WORST
        weights = first_weights(self.unknowns, self.counts, joint_weights)
        errors = lambda weights: self._root_mean_squares(self._solved(weights, worst))
        scale = self.counts, self._torque_scale(), self.unknowns.joint_sizes
        try:
            if joint_weights == "residual":
                weights = weights_by_residual(errors, weights, *scale)
            k = self._solved(weights, worst)
        except np.linalg.LinAlgError:  # not determined, or not by products
            return None
        lost = self._squares(k) < _LEAST_RESIDUAL * self._torque_scale() ** 2 * self.counts
        return None if np.any(lost) else k

    def _torque_scale(self) -> Float[np.ndarray, "folds joints"]:
        """The root mean square torque of each joint's equations."""
        squares = np.stack([of_joint[:, -1, -1] for of_joint in self.products], axis=-1)
        return np.sqrt(squares / np.maximum(self.counts, 1.0))

    def _root_mean_squares(
        self, k: Float[np.ndarray, "folds coefficients"]
    ) -> Float[np.ndarray, "folds joints"]:
        """Each joint's root mean square torque error."""
        return np.sqrt(np.maximum(self._squares(k), 0.0) / np.maximum(self.counts, 1.0))

    def _squares(
        self, k: Float[np.ndarray, "folds coefficients"]
    ) -> Float[np.ndarray, "folds joints"]:
        """Sums of squared torque errors."""
        sums: list[np.ndarray] = []
        for support, of_joint in zip(self.unknowns.support, self.products, strict=True):
            sides = np.concatenate([k[:, list(support)], -np.ones((len(k), 1))], axis=1)
            sums.append(np.sum((of_joint @ sides[..., None])[..., 0] * sides, axis=-1))
        return np.stack(sums, axis=-1)

    def _solved(
        self, weights: Float[np.ndarray, "folds joints"], worst: float
    ) -> Float[np.ndarray, "folds coefficients"]:
        """Solve the normal equations, columns of unit length.

        **Raises** `LinAlgError` where their condition number is larger than `worst`.
        """
        size = self.unknowns.size
        total = np.zeros((len(weights), size + 1, size + 1))
        for joint, (support, of_joint) in enumerate(
            zip(self.unknowns.support, self.products, strict=True)
        ):
            at = np.array([*support, size])
            total[:, at[:, None], at] += weights[:, joint, None, None] ** 2 * of_joint
        lengths = np.sqrt(np.diagonal(total, axis1=1, axis2=2)[:, :size])
        if not np.all(lengths > 0.0):
            raise np.linalg.LinAlgError
        matrix = total[:, :size, :size] / lengths[:, :, None] / lengths[:, None, :]
        inverse = np.linalg.inv(matrix)
        # Frobenius norms bound the singular values.
        bound = np.linalg.norm(matrix, axis=(1, 2)) * np.linalg.norm(inverse, axis=(1, 2))
        if not np.all(bound < worst):
            raise np.linalg.LinAlgError
        return (inverse @ (total[:, :size, size:] / lengths[:, :, None]))[..., 0] / lengths
