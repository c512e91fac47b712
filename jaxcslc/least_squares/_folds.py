"""Products of columns and torque by fold, for cross-validation without factorising again."""

from collections.abc import Iterable
from typing import Any, NamedTuple

import numpy as np
from jaxtyping import Float, Int

from ..recordings import Patterns
from ._compiled import HostColumns
from ._equations import Equations, samples_of
from ._factors import Unknowns
from ._minimum import Coefficients, weighted_minimum


# Largest squared condition number of weighted equations with columns of unit length that products
# are solved for. Rounding of products, 2e-16, changes the least determined combination of
# coefficients by 2e-6 then, and the torque that coefficients predict by 2e-11.
_WORST = 1e10
# Squared residuals below this part of a joint's squared torque are lost in rounding of products.
_LEAST_RESIDUAL = 1e-10


class FoldProducts(NamedTuple):
    """Products of regressor columns and torque, for each fold those of all others.

    Products cost a fifth of triangles of as many equations, and their sums next to nothing: a
    search for settings fits some hundred times, and compares what the fits predict, where the
    square of the condition number does not show. The coefficients of a final fit come from
    triangles.

    **Attributes**

    - `unknowns`: the coefficients.
    - `products`: for each joint (folds, s + 1, s + 1), the torque last.
    - `counts`: (folds, n) equations of each joint.
    """

    unknowns: Unknowns
    products: tuple[Float[np.ndarray, "folds _ _"], ...]
    counts: Float[np.ndarray, "folds joints"]

    @classmethod
    def of_columns(
        cls,
        unknowns: Unknowns,
        columns: HostColumns,
        patterns: Patterns,
        fold: Int[np.ndarray, " samples"],
    ) -> "FoldProducts":
        """Compute the products from the pairs of patterns that count, piece by piece.

        Pieces of columns stay in a core's cache.

        - `fold`: the fold of each sample, from 0.
        """
        folds = int(np.max(fold)) + 1
        torque, mask = np.asarray(patterns.torque), np.asarray(patterns.mask)
        indices = [samples_of(fold, number) for number in range(folds)]

        def product(joint_columns: np.ndarray, joint: int, rows: Any) -> np.ndarray:
            kept = np.flatnonzero(mask[rows, joint])
            sides = np.empty((len(joint_columns) + 1, kept.size))
            # Indices that exist need no check, which takes NumPy twice as long as to copy the rows.
            np.take(joint_columns[:, rows], kept, axis=1, out=sides[:-1], mode="clip")
            np.take(torque[rows, joint], kept, out=sides[-1], mode="clip")
            return sides @ sides.T

        products = (
            [product(joint_columns, joint, rows) for rows in indices]
            for joint, joint_columns in enumerate(columns)
        )
        counts = np.stack([np.count_nonzero(mask[rows], axis=0) for rows in indices])
        return cls._without_each_fold(unknowns, products, counts)

    @classmethod
    def of_equations(
        cls, equations: Equations, fold: Int[np.ndarray, " samples"]
    ) -> "FoldProducts":
        """Compute the products from equations, such as those of a parallel filter.

        - `fold`: the fold of each sample, from 0.
        """
        folds = int(np.max(fold)) + 1
        products: list[list[np.ndarray]] = []
        counts: list[np.ndarray] = []
        for rows, sample in zip(equations.rows, equations.sample, strict=True):
            of_rows = fold[sample]
            parts = [rows[samples_of(of_rows, number)] for number in range(folds)]
            products.append([part.T @ part for part in parts])
            counts.append(np.array([len(part) for part in parts]))
        return cls._without_each_fold(equations.unknowns, products, np.stack(counts, axis=-1))

    @classmethod
    def _without_each_fold(
        cls, unknowns: Unknowns, products: Iterable[list[np.ndarray]], counts: np.ndarray
    ) -> "FoldProducts":
        # Sums of the others: a difference to the sum of all would lose digits.
        others = (~np.eye(len(counts), dtype=bool)).astype(float)
        summed = (np.tensordot(others, np.stack(of_joint), 1) for of_joint in products)
        return cls(unknowns, tuple(summed), others @ counts)

    def coefficients(self, joint_weights: Any) -> Float[np.ndarray, "folds coefficients"] | None:
        """The coefficients fitted to all folds but one, for each one left out; None where products
        are not accurate enough for them.

        - `joint_weights`: those of `LeastSquares`.
        """
        if not all(np.all(np.isfinite(of_joint)) for of_joint in self.products):
            return None
        try:
            solution, weights = weighted_minimum(
                self.unknowns, self, joint_weights, lambda weights: Coefficients(self._k(weights))
            )
            return solution.k if self._accurate(weights, solution.k) else None
        except np.linalg.LinAlgError:  # singular, or as good as
            return None

    def root_mean_squares(
        self, unknowns: Unknowns, k: Float[np.ndarray, "folds coefficients"]
    ) -> Float[np.ndarray, "folds joints"]:
        """Root mean square torque error of each joint."""
        del unknowns
        return np.sqrt(np.maximum(self._squares(k), 0.0) / np.maximum(self.counts, 1.0))

    def _squares(self, k: Float[np.ndarray, "folds coefficients"]) -> np.ndarray:
        """Return the sums of squared torque errors, (folds, n)."""
        sums: list[np.ndarray] = []
        for support, products in zip(self.unknowns.support, self.products, strict=True):
            sides = np.concatenate([k[:, list(support)], -np.ones((len(k), 1))], axis=1)
            sums.append(np.sum((products @ sides[:, :, None])[:, :, 0] * sides, axis=1))
        return np.stack(sums, axis=-1)

    def _weighted(
        self, weights: Float[np.ndarray, "folds joints"]
    ) -> tuple[Float[np.ndarray, "folds p p"], Float[np.ndarray, "folds p"], np.ndarray]:
        """The normal equations, coefficients scaled to columns of unit length, and the lengths.

        **Raises** `LinAlgError` where a coefficient has no part in any equation.
        """
        size = self.unknowns.size
        total = np.zeros((len(weights), size + 1, size + 1))
        for joint, (support, products) in enumerate(
            zip(self.unknowns.support, self.products, strict=True)
        ):
            at = np.array([*support, size])
            total[:, at[:, None], at] += weights[:, joint, None, None] ** 2 * products
        lengths = np.sqrt(np.diagonal(total, axis1=1, axis2=2)[:, :size])
        if not np.all(lengths > 0.0):
            raise np.linalg.LinAlgError
        matrix = total[:, :size, :size] / lengths[:, :, None] / lengths[:, None, :]
        return matrix, total[:, :size, size] / lengths, lengths

    def _k(self, weights: Float[np.ndarray, "folds joints"]) -> np.ndarray:
        matrix, target, lengths = self._weighted(weights)
        return np.linalg.solve(matrix, target[..., None])[..., 0] / lengths

    def _accurate(self, weights: np.ndarray, k: np.ndarray) -> bool:
        if not np.all(np.isfinite(k)):
            return False
        matrix, _, _ = self._weighted(weights)
        # Frobenius norms bound the singular values.
        bound = np.linalg.norm(matrix, axis=(1, 2)) * np.linalg.norm(
            np.linalg.inv(matrix), axis=(1, 2)
        )
        torques = np.stack([products[:, -1, -1] for products in self.products], axis=-1)
        small = self._squares(k) < _LEAST_RESIDUAL * torques
        return bool(np.all(bound < _WORST)) and not np.any(small)
