import dataclasses

import numpy as np
from jaxtyping import Float

from ...motion import Patterns
from ...network import AbstractLinearNetwork
from ..solver import Equations, Identification, LeastSquares, Unknowns, regressor_of


@dataclasses.dataclass(frozen=True, eq=False)
class RecordingEquations:
    """Equations of one recording, its offsets eliminated.

    - `equations`: in the network's coefficients.
    - `offset_rows`: for each joint the column of its offset, and the equations before it was
      eliminated; None without offsets.
    """

    equations: Equations
    offset_rows: tuple[tuple[np.ndarray, np.ndarray], ...] | None

    @classmethod
    def of(
        cls,
        network: AbstractLinearNetwork,
        patterns: Patterns,
        solver: LeastSquares,
        *,
        offsets: bool,
    ) -> "RecordingEquations":
        """Of patterns, with a constant torque of each joint eliminated if there are offsets.

        Least squares with a further column c for each joint has the coefficients of least squares
        of what is orthogonal to c (Frisch and Waugh 1933): no unknown has to be added.
        """
        if not offsets:
            return cls(solver.equations(network, patterns), None)
        plain = Unknowns.of(network)
        with_constant = Unknowns(
            (*plain.names, "offset"), tuple((*support, plain.size) for support in plain.support)
        )
        regressor = np.asarray(regressor_of(network, patterns))
        constant = np.ones((*regressor.shape[:2], 1))
        whole = Equations.of(
            with_constant,
            np.concatenate([regressor, constant], axis=2),
            np.asarray(patterns.torque),
            np.asarray(patterns.mask),
            time=np.asarray(patterns.time),
            cutoff=solver.cutoff,
        )
        pairs = tuple((rows[:, -2], np.delete(rows, -2, axis=1)) for rows in whole.rows)
        rows = tuple(
            kept - np.outer(column, column @ kept) / _square(column) for column, kept in pairs
        )
        return cls(Equations(plain, rows, whole.sample), pairs)

    def weighted(self, weights: Float[np.ndarray, " joints"]) -> Equations:
        """The equations of each joint times a weight."""
        pairs = zip(self.equations.rows, weights.tolist(), strict=True)
        rows = tuple(rows * weight for rows, weight in pairs)
        return Equations(self.equations.unknowns, rows, self.equations.sample)

    def rms(self, fit: Identification) -> Float[np.ndarray, " joints"]:
        """RMS residual of each joint under a fit; zero of joints without equations."""
        k = np.asarray(fit.k)
        pairs = zip(self.equations.rows, self.equations.unknowns.support, strict=True)
        residuals = [rows[:, -1] - rows[:, :-1] @ k[list(support)] for rows, support in pairs]
        squares = [float(np.mean(error**2)) if error.size else 0.0 for error in residuals]
        return np.sqrt(np.array(squares))

    def offsets(self, fit: Identification) -> Float[np.ndarray, " joints"]:
        """The constant torques that a fit leaves; zeros if none were eliminated."""
        k = np.asarray(fit.k)
        if self.offset_rows is None:
            return np.zeros(len(self.equations.rows))
        pairs = zip(self.offset_rows, self.equations.unknowns.support, strict=True)
        means = (
            column @ (rows[:, -1] - rows[:, :-1] @ k[list(support)]) / _square(column)
            for (column, rows), support in pairs
        )
        return np.array(list(means))


def _square(column: Float[np.ndarray, " rows"]) -> float:
    """The square of a column's norm, of nothing 1: what is divided by it is zero then."""
    return float(column @ column) or 1.0
