from collections.abc import Mapping
from typing import Any

import equinox as eqx
import jax
import jax.numpy as jnp
import numpy as np
from jaxtyping import Array, Bool, Float

from ...motion import Patterns
from ...network import CSLC
from ..solver import filled_up
from ._text import text_table


class ErrorTable(eqx.Module):
    """Torque errors of several coefficient vectors on the same patterns (Fig. 7.6-3).

    **Attributes**

    - `names`: of the vectors.
    - `mean_modulus`: (vectors, n), mean |error| of each joint over the pairs that count [N m].
    - `rms`: (vectors, n), root mean square of the same [N m].
    - `epsilon`: (vectors,), mean error cost: half the root mean square over the joints of one
      pattern's errors, averaged over patterns (7.5) [N m]. Of a pattern in which some joint does
      not count, the others'.

    Prints itself as the thesis's table; `rows()` has the same as data.

    - `unit`: of it all; of a robot with joints of both kinds, N m or N joint by joint.

    >>> import jax.numpy as jnp, jaxcslc as jc
    >>> one = jnp.array([[0.25]])
    >>> print(jc.ErrorTable(("fit",), mean_modulus=one, rms=one, epsilon=jnp.array([0.125])))
    [N m]       fit
    mean |e1|  0.25
    mean ε     0.125
    """

    names: tuple[str, ...] = eqx.field(static=True)
    mean_modulus: Float[Array, "vectors joints"]
    rms: Float[Array, "vectors joints"]
    epsilon: Float[Array, " vectors"]
    unit: str = eqx.field(static=True, default="N m")

    def rows(self) -> list[dict[str, float | str]]:
        """One row a joint and one for ε, one column a coefficient vector."""
        rows: list[dict[str, float | str]] = []
        for joint in range(self.mean_modulus.shape[1]):
            values = np.asarray(self.mean_modulus[:, joint]).tolist()
            rows.append({"": f"mean |e{joint + 1}|", **dict(zip(self.names, values, strict=True))})
        mean = np.asarray(self.epsilon).tolist()
        rows.append({"": "mean ε", **dict(zip(self.names, mean, strict=True))})
        return rows

    def to_pandas(self) -> Any:
        """`rows()` as a `pandas.DataFrame`, a column for each coefficient vector [N m]."""
        import pandas

        rows = self.rows()
        return pandas.DataFrame(
            {name: [row[name] for row in rows] for name in self.names},
            index=pandas.Index([row[""] for row in rows], name="error"),
        )

    def __str__(self) -> str:
        return text_table(
            [f"[{self.unit}]", *self.names],
            [[str(row[""]), *(f"{row[name]:.4g}" for name in self.names)] for row in self.rows()],
        )


def compare(
    network: CSLC, patterns: Patterns, vectors: Mapping[str, Float[Array | np.ndarray, " k"]]
) -> ErrorTable:
    """How well each of several coefficient vectors predicts the torque of the same patterns.

    **Arguments**

    - `network`: n joints, p coefficients.
    - `patterns`: motion and torque; pairs outside `patterns.mask` are left out.
    - `vectors`: (p,) coefficients by name.

    **Returns** an `ErrorTable`.

    >>> import numpy as np, jaxcslc as jc
    >>> robot = jc.puma560()
    >>> network = jc.derive(robot)
    >>> k = network.coefficients_from(robot.links, viscous=robot.viscous, dry=robot.dry)
    >>> still, all_pairs = np.zeros((10, 6)), np.ones((10, 6), bool)
    >>> patterns = jc.Patterns(
    ...     np.arange(10.0), still, still, still, network.torque(k, still, still, still),
    ...     all_pairs, all_pairs,
    ... )
    >>> float(jc.compare(network, patterns, {"true": k}).epsilon[0])
    0.0
    """
    names = tuple(vectors)
    mean_modulus, rms, epsilon = _figures(
        jnp.stack([torque_errors(network, patterns, vectors[name]) for name in names]),
        jnp.asarray(patterns.mask),
    )
    kinds = set(network.robot.kinds)
    unit = "N m or N" if len(kinds) > 1 else {"R": "N m", "P": "N"}[kinds.pop()]
    return ErrorTable(names, mean_modulus, rms, epsilon, unit)


@jax.jit
def _figures(
    errors: Float[Array, "vectors samples joints"], mask: Bool[Array, "samples joints"]
) -> tuple[
    Float[Array, "vectors joints"], Float[Array, "vectors joints"], Float[Array, " vectors"]
]:
    counts = jnp.broadcast_to(mask, errors.shape)
    kept = jnp.where(counts, errors, 0.0)
    per_joint = jnp.maximum(jnp.sum(counts, axis=1), 1)
    per_pattern = jnp.sum(counts, axis=2)
    cost = 0.5 * jnp.sqrt(jnp.sum(kept**2, axis=2) / jnp.maximum(per_pattern, 1))
    some = per_pattern > 0
    return (
        jnp.sum(jnp.abs(kept), axis=1) / per_joint,
        jnp.sqrt(jnp.sum(kept**2, axis=1) / per_joint),
        jnp.sum(jnp.where(some, cost, 0.0), axis=1) / jnp.maximum(jnp.sum(some, axis=1), 1),
    )


def torque_errors(
    network: CSLC, patterns: Patterns, k: Float[Array | np.ndarray, " k"]
) -> Float[Array, "samples joints"]:
    """Measured minus predicted torque of every pair (samples, n) [N m]."""
    return jnp.asarray(patterns.torque) - predicted_torque(network, patterns, k)


def predicted_torque(
    network: CSLC, patterns: Patterns, k: Float[Array | np.ndarray, " k"]
) -> Float[Array, "samples joints"]:
    """The network's torque for the patterns' motion (samples, n) [N m]."""
    motion = (patterns.q, patterns.qd, patterns.qdd)
    torque = _torque(network, jnp.asarray(k), *(jnp.asarray(filled_up(x)) for x in motion))
    return torque[: patterns.q.shape[0]]


@eqx.filter_jit
def _torque(network: CSLC, k: Array, q: Array, qd: Array, qdd: Array) -> Array:
    return network.torque(k, q, qd, qdd)
