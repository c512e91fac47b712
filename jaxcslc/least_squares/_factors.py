"""Triangular factors of equations, one triangle per joint, and how they are joined.

Memory does not grow with the recording (thesis 4.1-4, 8.2.3). Read with `_minimum`.
"""

import dataclasses
from collections.abc import Sequence
from concurrent.futures import ThreadPoolExecutor
from typing import Any

import equinox as eqx
import jax
import jax.numpy as jnp
import numpy as np
from jaxtyping import Array, Float

from .._environment import core_count
from ..network import AbstractLinearNetwork


# Patterns that are expanded into regressor rows at once: their intermediates fit a core's cache.
_BLOCK = 2048
# Rows that are factorised at once, and cells of the matrix that they make. LAPACK libraries spread
# larger factorisations over threads that then wait for each other: on two cores OpenBLAS took
# 0.1 s for 2,048 x 29, and 0.6 ms for eight of 256 x 29; 56 matrices of 256 x 54 took 0.21 s, and
# the same rows as 112 of 128 x 54 took 0.01 s.
_ROWS = 256
_CELLS = 7000
# Entries of equations whose joints are worth threads of their own.
_FEWEST_OF_THREADS = 1 << 20
# Triangles that are stacked and factorised at once.
_JOINED = 8


@dataclasses.dataclass(frozen=True)
class Unknowns:
    """The coefficients that equations are solved for.

    **Attributes**

    - `names`: of the p coefficients.
    - `support`: for each joint, the indices of those that its equations depend on, ascending.
    """

    names: tuple[str, ...]
    support: tuple[tuple[int, ...], ...]

    @classmethod
    def of(cls, network: AbstractLinearNetwork) -> "Unknowns":
        """Return the unknowns of a network."""
        return cls(network.names, network.support)

    @property
    def size(self) -> int:
        """Number of coefficients, p."""
        return len(self.names)

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
        )


class JointFactors(eqx.Module):
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
    def empty(cls, network: AbstractLinearNetwork) -> "JointFactors":
        """The factors of no patterns."""
        sizes = [len(support) + 1 for support in network.support]
        return cls(tuple(jnp.zeros((size, size)) for size in sizes), jnp.zeros(network.joint_count))

    @classmethod
    def of_rows(
        cls,
        rows: tuple[Float[np.ndarray, "*batch _ _"], ...],
        counts: Float[np.ndarray, "*batch joints"],
    ) -> "JointFactors":
        """Factorise equations on the host, for each joint (..., rows, s + 1).

        Joints with many equations are factorised in parallel.
        """
        if sum(joint_rows.size for joint_rows in rows) < _FEWEST_OF_THREADS:
            return cls(tuple(map(triangle_of, rows)), counts)
        with ThreadPoolExecutor(min(core_count(), len(rows))) as pool:
            return cls(tuple(pool.map(triangle_of, rows)), counts)

    def joined(self, other: "JointFactors") -> "JointFactors":
        """The factors of both sets of patterns together."""
        return JointFactors(
            tuple(
                jnp.linalg.qr(jnp.concatenate([mine, theirs]), mode="r")
                for mine, theirs in zip(self.triangles, other.triangles, strict=True)
            ),
            self.counts + other.counts,
        )

    def joined_folds(self) -> "JointFactors":
        """The factors of all folds together, of NumPy's arrays with a leading axis of folds."""
        rows = (triangle.reshape(-1, triangle.shape[-1]) for triangle in self.triangles)
        return JointFactors.of_rows(tuple(map(np.asarray, rows)), np.sum(self.counts, axis=0))

    def stacked(
        self, unknowns: Unknowns, weights: Float[Array | np.ndarray, "*batch joints"]
    ) -> Float[Array | np.ndarray, "*batch _ columns"]:
        """All triangles in the columns of all coefficients, joints scaled by their weights."""
        xp = np if isinstance(self.counts, np.ndarray) else jnp
        rows: list[Any] = []
        for joint, (support, triangle) in enumerate(
            zip(unknowns.support, self.triangles, strict=True)
        ):
            # Where in the triangle, with a column of zeros behind, each coefficient's column is.
            column = np.full(unknowns.size + 1, len(support) + 1)
            column[[*support, unknowns.size]] = np.arange(len(support) + 1)
            wide = xp.concatenate([triangle, xp.zeros_like(triangle[..., :1])], axis=-1)
            rows.append(weights[..., joint, None, None] * wide[..., column])
        return xp.concatenate(rows, axis=-2)

    def root_mean_squares(
        self, unknowns: Unknowns, k: Float[Array | np.ndarray, "*batch coefficients"]
    ) -> Float[Array | np.ndarray, "*batch joints"]:
        """Root mean square torque error of each joint, without seeing the patterns again."""
        xp = np if isinstance(self.counts, np.ndarray) else jnp
        norms: list[Any] = []
        for support, triangle in zip(unknowns.support, self.triangles, strict=True):
            coefficients = k[..., np.array(support, dtype=int)]
            error = (triangle[..., :-1] @ coefficients[..., None])[..., 0] - triangle[..., -1]
            norms.append(xp.linalg.norm(error, axis=-1))
        return xp.stack(norms, axis=-1) / xp.sqrt(xp.maximum(self.counts, 1.0))


def factorise(
    network: AbstractLinearNetwork,
    q: Float[Array, "samples motion"],
    qd: Float[Array, "samples motion"],
    qdd: Float[Array, "samples motion"],
    torque: Float[Array, "samples joints"],
    weight: Float[Array, "samples joints"],
    *,
    factors: JointFactors | None = None,
) -> JointFactors:
    """The factors of patterns, joined to those of earlier ones (thesis 4.1-4, 8.2.3).

    `weight` multiplies both sides of each joint's equation: 0 leaves a pair out, 1 takes it.
    Pure, and its memory beyond the arguments is one block of patterns.
    """
    samples = len(q)
    size = min(_BLOCK, -(-samples // _ROWS) * _ROWS)
    blocks = -(-samples // size)
    padding = blocks * size - samples

    def blocked(x: Array) -> Array:
        """(samples, columns) to (blocks, columns, size), zeros behind the end."""
        x = jnp.pad(x, ((0, padding), (0, 0)))
        return jnp.swapaxes(x.reshape(blocks, size, x.shape[1]), 1, 2)

    def step(
        triangles: tuple[Array, ...], block: tuple[Array, ...]
    ) -> tuple[tuple[Array, ...], None]:
        joined = tuple(
            join_rows(triangle, rows)
            for triangle, rows in zip(triangles, weighted_rows(network, *block), strict=True)
        )
        return joined, None

    start = JointFactors.empty(network) if factors is None else factors
    triangles, _ = jax.lax.scan(
        step,
        tuple(map(jnp.asarray, start.triangles)),
        tuple(blocked(x) for x in (q, qd, qdd, torque, weight)),
    )
    return JointFactors(triangles, start.counts + jnp.sum(weight != 0, axis=0))


def weighted_rows(
    network: AbstractLinearNetwork,
    q: Float[Array, "motion samples"],
    qd: Float[Array, "motion samples"],
    qdd: Float[Array, "motion samples"],
    torque: Float[Array, "joints samples"],
    weight: Float[Array, "joints samples"],
) -> tuple[Float[Array, "_ samples"], ...]:
    """Return each joint's regressor columns and torque, (s + 1, samples), weighted."""
    return tuple(
        jnp.concatenate([rows, torque[j][None]]) * weight[j][None]
        for j, rows in enumerate(network.columns(q, qd, qdd))
    )


def joined_factors(parts: Sequence[JointFactors]) -> JointFactors:
    """The factors of several sets of patterns together; on the host, in a tree of joins.

    **Raises** `ValueError` if there are none.
    """
    if not parts:
        raise ValueError("there are no factors to join")
    parts = [jax.tree.map(np.asarray, part) for part in parts]
    while len(parts) > 1:
        groups = [parts[start : start + _JOINED] for start in range(0, len(parts), _JOINED)]
        parts = [
            JointFactors.of_rows(
                tuple(
                    np.concatenate(triangles)
                    for triangles in zip(*(part.triangles for part in group), strict=True)
                ),
                np.sum([part.counts for part in group], axis=0),
            )
            for group in groups
        ]
    return parts[0]


def join_rows(triangle: Float[Array, "s s"], rows: Float[Array, "s samples"]) -> Array:
    """The triangle of a triangle above further rows, given as columns, some at a time."""
    columns, at_once = rows.shape[0], _ROWS
    while at_once > 32 and (at_once + columns) * columns > _CELLS:
        at_once //= 2
    pieces = jnp.swapaxes(rows.reshape(columns, -1, at_once), 0, 1)

    def step(triangle: Array, piece: Array) -> tuple[Array, None]:
        return jnp.linalg.qr(jnp.concatenate([triangle, piece.T]), mode="r"), None

    return jax.lax.scan(step, triangle, pieces)[0]


def triangle_of(rows: Float[np.ndarray, "*batch rows columns"]) -> Float[np.ndarray, "..."]:
    """The triangle R of an orthogonal factorisation, (..., columns, columns), signs arbitrary.

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


def _upper(rows: np.ndarray) -> np.ndarray:
    triangle: Any = np.linalg.qr(rows, mode="r")  # the stub promises Q as well
    return triangle


def _filled(rows: np.ndarray, count: int) -> np.ndarray:
    """Zero rows behind the end."""
    if rows.shape[-2] == count:
        return rows
    widths = [(0, 0)] * (rows.ndim - 2) + [(0, count - rows.shape[-2]), (0, 0)]
    return np.pad(rows, widths)
