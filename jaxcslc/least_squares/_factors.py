"""Triangular factors of equations, one triangle per joint, and how they are joined.

`triangle_of` is the dense route, of NumPy's arrays or of what JAX traces. Read with `_minimum`.
"""

import dataclasses
from collections.abc import Sequence
from concurrent.futures import ThreadPoolExecutor
from typing import Any, NamedTuple

import jax
import jax.numpy as jnp
import numpy as np
from jaxtyping import Array, Float

from .._environment import array_namespace, core_count
from ..network import AbstractLinearNetwork


# Entries of a matrix that is factorised at once. LAPACK libraries spread larger ones over threads
# that wait for each other: on two cores OpenBLAS took 0.1 s for 2,048 x 29, and 0.6 ms for eight of
# 256 x 29.
_CELLS = 7000
# Entries of equations whose joints are worth threads of their own.
_FEWEST_OF_THREADS = 1 << 20
# How many times what rounding makes of a column counts as zero: ten are those of a sum of a hundred
# terms.
ROUNDINGS = 10.0
# Triangles that are stacked and factorised at once.
_JOINED = 8


@dataclasses.dataclass(frozen=True)
class Unknowns:
    """The coefficients that equations are solved for.

    **Attributes**

    - `names`: of the p coefficients.
    - `support`: for each joint, the indices of those that its equations depend on, ascending.
    - `rounding`: for each joint, what rounding alone makes of the columns of its support, as a root
      mean square; None where it need not be known.
    """

    names: tuple[str, ...]
    support: tuple[tuple[int, ...], ...]
    rounding: tuple[tuple[float, ...], ...] | None = None

    @classmethod
    def of(cls, network: AbstractLinearNetwork) -> "Unknowns":
        """Return the unknowns of a network."""
        return cls(network.names, network.support)

    @property
    def size(self) -> int:
        """Number of coefficients, p."""
        return len(self.names)

    @property
    def joint_sizes(self) -> Float[np.ndarray, " joints"]:
        """Numbers of coefficients that the equations of each joint depend on."""
        return np.array([float(len(support)) for support in self.support])

    def with_further(self, counts: Sequence[int]) -> "Unknowns":
        """Append unknowns that only one joint's equations depend on.

        - `counts`: of each joint.
        """
        ends = np.cumsum([self.size, *counts]).tolist()
        return Unknowns(
            (*self.names, *(f"input {number + 1}" for number in range(sum(counts)))),
            tuple(
                (*support, *range(start, end))
                for support, start, end in zip(self.support, ends, ends[1:], strict=False)
            ),
            None
            if self.rounding is None
            else tuple(
                (*sizes, *(0.0,) * count)
                for sizes, count in zip(self.rounding, counts, strict=True)
            ),
        )

    def with_larger_rounding(self, other: "Unknowns") -> "Unknowns":
        """Return the unknowns with the rounding of either motion, whichever is larger."""
        if self.rounding is None or other.rounding is None:
            return dataclasses.replace(self, rounding=self.rounding or other.rounding)
        pairs = zip(self.rounding, other.rounding, strict=True)
        larger = tuple(tuple(map(max, mine, theirs)) for mine, theirs in pairs)
        return dataclasses.replace(self, rounding=larger)


class JointFactors(NamedTuple):
    """Triangular factors of a least-squares fit: one triangle per joint for any number of patterns.

    Joint j's equations, regressor columns beside torque, are Q_j [R_j c_j; 0 r_j] with
    orthogonal Q_j. Stacking triangles and factorising again joins two sets of patterns, so the
    memory does not grow with the recording. Keeping joints apart leaves their weights free until
    the end, and costs a fifth of factorising all columns for every joint.

    **Attributes**

    - `triangles`: for each joint (s + 1, s + 1), s its number of coefficients; the last column
      is the torque's.
    - `counts`: (n,) equations of each joint.

    Both may have leading axes, as for the folds of a cross-validation.
    """

    triangles: tuple[Float[Array | np.ndarray, "*batch _ _"], ...]
    counts: Float[Array | np.ndarray, "*batch joints"]

    @classmethod
    def from_rows(
        cls,
        rows: tuple[Float[Array | np.ndarray, "*batch _ _"], ...],
        counts: Float[Array | np.ndarray, "*batch joints"],
    ) -> "JointFactors":
        """Factorise equations, for each joint (..., rows, s + 1).

        On the host, joints with many equations are factorised in parallel.
        """
        few = sum(joint_rows.size for joint_rows in rows) < _FEWEST_OF_THREADS
        if few or array_namespace(*rows) is jnp:
            return cls(tuple(map(triangle_of, rows)), counts)
        with ThreadPoolExecutor(min(core_count(), len(rows))) as pool:
            return cls(tuple(pool.map(triangle_of, rows)), counts)

    def joined_folds(self) -> "JointFactors":
        """Return the factors of all folds together; NumPy's arrays, folds first."""
        rows = (triangle.reshape(-1, triangle.shape[-1]) for triangle in self.triangles)
        return JointFactors.from_rows(tuple(map(np.asarray, rows)), np.sum(self.counts, axis=0))

    def stacked(
        self, unknowns: Unknowns, weights: Float[Array | np.ndarray, "*batch joints"]
    ) -> Float[Array | np.ndarray, "*batch _ columns"]:
        """Return all triangles in the columns of all coefficients, joints scaled by weights.

        Columns that are no more than rounding are zero.
        """
        xp = array_namespace(self.counts)
        rows: list[Any] = []
        for joint, (support, triangle) in enumerate(
            zip(unknowns.support, self.triangles, strict=True)
        ):
            if unknowns.rounding is not None:
                # The triangle without a column is that of the equations without it.
                sizes = ROUNDINGS * np.array([*unknowns.rounding[joint], 0.0])
                least = sizes * xp.sqrt(self.counts[..., joint, None])
                more = xp.linalg.norm(triangle, axis=-2) > least
                triangle = xp.where(more[..., None, :], triangle, 0.0)
            # Where in the triangle, with a column of zeros behind, each coefficient's column is.
            column = np.full(unknowns.size + 1, len(support) + 1)
            column[[*support, unknowns.size]] = np.arange(len(support) + 1)
            wide = xp.concatenate([triangle, xp.zeros_like(triangle[..., :1])], axis=-1)
            rows.append(weights[..., joint, None, None] * wide[..., column])
        return xp.concatenate(rows, axis=-2)

    def root_mean_squares(
        self, unknowns: Unknowns, k: Float[Array | np.ndarray, "*batch coefficients"]
    ) -> Float[Array | np.ndarray, "*batch joints"]:
        """Return each joint's root mean square torque error, without seeing the patterns again."""
        xp = array_namespace(self.counts)
        norms: list[Any] = []
        for support, triangle in zip(unknowns.support, self.triangles, strict=True):
            coefficients = k[..., np.array(support, dtype=int)]
            error = (triangle[..., :-1] @ coefficients[..., None])[..., 0] - triangle[..., -1]
            norms.append(xp.linalg.norm(error, axis=-1))
        return xp.stack(norms, axis=-1) / xp.sqrt(xp.maximum(self.counts, 1.0))

    def torque_scale(self) -> Float[Array | np.ndarray, "*batch joints"]:
        """Return the root mean square torque of each joint's equations."""
        xp = array_namespace(self.counts)
        norms = [xp.linalg.norm(triangle[..., -1], axis=-1) for triangle in self.triangles]
        return xp.stack(norms, axis=-1) / xp.sqrt(xp.maximum(self.counts, 1.0))


def joined_factors(parts: Sequence[JointFactors]) -> JointFactors:
    """Return the factors of several sets of patterns together; on the host, in a tree of joins.

    **Raises** `ValueError` if there are none.
    """
    if not parts:
        raise ValueError("there are no factors to join")
    parts = [jax.tree.map(np.asarray, part) for part in parts]
    while len(parts) > 1:
        groups = [parts[start : start + _JOINED] for start in range(0, len(parts), _JOINED)]
        parts = [
            JointFactors.from_rows(
                tuple(
                    np.concatenate(triangles)
                    for triangles in zip(*(part.triangles for part in group), strict=True)
                ),
                np.sum([part.counts for part in group], axis=0),
            )
            for group in groups
        ]
    return parts[0]


def triangle_of(
    rows: Float[Array | np.ndarray, "*batch rows columns"],
) -> Any:
    """Return the triangle R of a QR factorisation, (..., columns, columns), signs arbitrary.

    Rows are taken as many at a time as a core can factorise alone, and their triangles stacked
    and factorised in turn. Fewer rows than columns are filled up with zeros.

    >>> import numpy as np
    >>> rows = np.random.default_rng(0).normal(size=(5000, 3))
    >>> triangle = triangle_of(rows)
    >>> bool(np.allclose(triangle.T @ triangle, rows.T @ rows))
    True
    """
    *batch, _, columns = rows.shape
    at_once = max(2 * columns, _CELLS // columns)
    while rows.shape[-2] > at_once:
        pieces = -(-rows.shape[-2] // at_once)
        length = -(-rows.shape[-2] // pieces)  # of equal length: few zeros behind the end
        filled = _filled(rows, pieces * length)
        triangles = _upper(filled.reshape(*batch, pieces, length, columns))
        rows = triangles.reshape(*batch, pieces * columns, columns)
    return _upper(_filled(rows, max(rows.shape[-2], columns)))


def _upper(rows: Any) -> Any:
    if array_namespace(rows) is np:
        return np.linalg.qr(rows, mode="r")
    upper = _upper_of_one
    for _ in rows.shape[:-2]:
        upper = jax.vmap(upper)
    return upper(rows)


@jax.custom_batching.sequential_vmap
def _upper_of_one(rows: Any) -> Any:
    """Return the triangle of one matrix under JAX, of a batch one after the other.

    On a CPU, JAX 0.10 shares a batch out among the threads that run the program. Where there are as
    many factorisations as threads, each waits for another one for ever: on two cores, three
    recordings of 3,000 samples under `jax.vmap` hung in most runs.
    """
    return jnp.linalg.qr(rows, mode="r")


def _filled(rows: Any, count: int) -> Any:
    """Zero rows behind the end."""
    if rows.shape[-2] == count:
        return rows
    widths = [(0, 0)] * (rows.ndim - 2) + [(0, count - rows.shape[-2]), (0, 0)]
    return array_namespace(rows).pad(rows, widths)
