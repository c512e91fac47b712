import equinox as eqx
import jax
import jax.numpy as jnp
import numpy as np
from jaxtyping import Array, Float

from ...network import CSLC


# Patterns that are expanded into regressor rows at once: their intermediates fit a core's cache.
_BLOCK = 2048
# Rows that are factorised at once, and cells of the matrix that they make. LAPACK libraries spread
# larger factorisations over threads that then wait for each other: on two cores OpenBLAS took
# 0.1 s for 2,048 x 29, and 0.6 ms for eight of 256 x 29.
_ROWS = 256
_CELLS = 7000


class JointFactors(eqx.Module):
    """What a least-squares fit needs to know of any number of patterns: one triangle a joint.

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

    triangles: tuple[Float[Array, "*batch _ _"], ...]
    counts: Float[Array, "*batch joints"]

    @classmethod
    def empty(cls, network: CSLC) -> "JointFactors":
        """The factors of no patterns."""
        sizes = [len(support) + 1 for support in network.support]
        return cls(tuple(jnp.zeros((size, size)) for size in sizes), jnp.zeros(network.joint_count))

    def joined(self, other: "JointFactors") -> "JointFactors":
        """The factors of both sets of patterns together."""
        return JointFactors(
            tuple(
                jnp.linalg.qr(jnp.concatenate([mine, theirs]), mode="r")
                for mine, theirs in zip(self.triangles, other.triangles, strict=True)
            ),
            self.counts + other.counts,
        )

    def stacked(self, network: CSLC, weights: Float[Array, " joints"]) -> Float[Array, "_ columns"]:
        """All triangles in the columns of all coefficients, joints scaled by their weights."""
        rows: list[Array] = []
        for joint, (support, triangle) in enumerate(
            zip(network.support, self.triangles, strict=True)
        ):
            place = np.array([*support, network.size])
            wide = jnp.zeros((triangle.shape[0], network.size + 1), triangle.dtype)
            rows.append(weights[joint] * wide.at[:, place].set(triangle))
        return jnp.concatenate(rows)

    def residual_norms(
        self, network: CSLC, k: Float[Array, " coefficients"]
    ) -> Float[Array, " joints"]:
        """Root of the sum of squared torque errors of each joint, without seeing them again."""
        norms: list[Array] = []
        for support, triangle in zip(network.support, self.triangles, strict=True):
            own = jnp.concatenate([k[np.array(support, dtype=int)], -jnp.ones(1, k.dtype)])
            norms.append(jnp.linalg.norm(triangle @ own))
        return jnp.stack(norms)


def factorise(
    network: CSLC,
    q: Float[Array, "samples joints"],
    qd: Float[Array, "samples joints"],
    qdd: Float[Array, "samples joints"],
    torque: Float[Array, "samples joints"],
    weight: Float[Array, "samples joints"],
    *,
    factors: JointFactors | None = None,
) -> JointFactors:
    """The factors of patterns, joined to those of earlier ones (thesis 4.1-4, 8.2.3).

    `weight` multiplies both sides of each joint's equation: 0 leaves a pair out, 1 takes it.
    Pure, and its memory beyond the arguments is one block of patterns.
    """
    samples, n = q.shape
    size = min(_BLOCK, -(-samples // _ROWS) * _ROWS)
    blocks = -(-samples // size)
    padding = blocks * size - samples

    def blocked(x: Array) -> Array:
        """(samples, joints) to (blocks, joints, size), zeros behind the end."""
        x = jnp.pad(x, ((0, padding), (0, 0)))
        return jnp.swapaxes(x.reshape(blocks, size, n), 1, 2)

    def step(
        triangles: tuple[Array, ...], block: tuple[Array, ...]
    ) -> tuple[tuple[Array, ...], None]:
        q, qd, qdd, torque, weight = block
        joined = tuple(
            join_rows(triangle, jnp.concatenate([rows, torque[j][None]]) * weight[j][None])
            for j, (triangle, rows) in enumerate(
                zip(triangles, network.columns(q, qd, qdd), strict=True)
            )
        )
        return joined, None

    start = JointFactors.empty(network) if factors is None else factors
    triangles, _ = jax.lax.scan(
        step, start.triangles, tuple(blocked(x) for x in (q, qd, qdd, torque, weight))
    )
    return JointFactors(triangles, start.counts + jnp.sum(weight != 0, axis=0))


def join_rows(triangle: Float[Array, "s s"], rows: Float[Array, "s samples"]) -> Array:
    """The triangle of a triangle above further rows, given as columns, some at a time."""
    columns, at_once = rows.shape[0], _ROWS
    while at_once > 32 and (at_once + columns) * columns > _CELLS:
        at_once //= 2
    pieces = jnp.swapaxes(rows.reshape(columns, -1, at_once), 0, 1)

    def step(triangle: Array, piece: Array) -> tuple[Array, None]:
        return jnp.linalg.qr(jnp.concatenate([triangle, piece.T]), mode="r"), None

    return jax.lax.scan(step, triangle, pieces)[0]
