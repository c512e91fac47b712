"""Equations for a second pass: residuals, and sums multiplied by cosines of time.

`_standard_errors` makes covariances of correlated errors of these sums.
"""

import abc
from concurrent.futures import ThreadPoolExecutor
from operator import itemgetter
from types import ModuleType
from typing import Any, NamedTuple

import equinox as eqx
import jax
import jax.numpy as jnp
import numpy as np
from jaxtyping import Array, Float

from .._environment import array_namespace, core_count
from ..network import AbstractLinearNetwork
from ._equations import Equations
from ._factors import JointFactors, Unknowns, factorise, join_rows
from ._minimum import Numbers


# Half a block in the phase of the highest cosine [rad], and powers of the time within a block that
# a cosine is interpolated by: to 5e-7.
_HALF_BLOCK = 0.25
_POWERS = 5
# Blocks of fewer instants cost more than products of all pairs of columns.
FEWEST_INSTANTS = 16
# Blocks whose moments are in memory at once.
_TOGETHER = 50


def blocks_for(components: int) -> int:
    """Return the number of blocks of a recording for so many cosine components."""
    return int(np.ceil(components * np.pi / (2.0 * _HALF_BLOCK)))


def cosine_grams(
    rows: Float[np.ndarray, "instants columns"],
    weight: Float[np.ndarray, " instants"],
    phase: Float[np.ndarray, " instants"],
    components: int,
) -> Float[np.ndarray, "components columns columns"]:
    r"""Products of weighted columns with each other, times a cosine of time, summed over time.

    $\sqrt 2 \sum_t \cos(c \pi \varphi_t)\, w_t\, r_t r_t^T$ for $c = 1, 2, \dots$ Within a block
    of time in which the highest cosine hardly turns, all of them are polynomials of time: a few
    moments of the block's products serve all components. That takes a third of the
    multiplications of all components one by one, and no memory for products of pairs of columns.

    **Arguments**

    - `rows`, `weight`: of each instant.
    - `phase`: the time of an instant over the length of the recording, ascending.
    - `components`: how many cosines.

    >>> import numpy as np
    >>> rng, phase = np.random.default_rng(0), (np.arange(2000) + 0.5) / 2000
    >>> rows, weight = rng.normal(size=(2000, 3)), rng.uniform(size=2000)
    >>> third = (np.sqrt(2.0) * np.cos(3 * np.pi * phase) * weight * rows.T) @ rows
    >>> bool(np.allclose(cosine_grams(rows, weight, phase, 8)[2], third, atol=1e-4))
    True
    """
    size, count = rows.shape[1], blocks_for(components)
    edges = np.searchsorted(phase, np.arange(count + 1) / count)
    edges[0], edges[-1] = 0, len(phase)
    centres = (np.arange(count) + 0.5) / count
    shares = _shares(components, centres)
    within = 2.0 * count * (phase - np.repeat(centres, np.diff(edges)))
    powers = weight * np.vander(within, _POWERS, increasing=True).T
    result = np.zeros((components, size * size))
    for first in range(0, count, _TOGETHER):
        some = slice(first, min(first + _TOGETHER, count))
        moments = np.empty((some.stop - first, _POWERS * size, size))
        for moment, start, stop in zip(
            moments, edges[some], edges[first + 1 : some.stop + 1], strict=True
        ):
            block = rows[start:stop]
            scaled = powers[:, None, start:stop] * block.T
            np.matmul(scaled.reshape(_POWERS * size, -1), block, out=moment)
        result += shares[:, some].reshape(components, -1) @ moments.reshape(-1, size * size)
    return result.reshape(components, size, size)


def _shares(
    components: int, centres: Float[np.ndarray, " blocks"]
) -> Float[np.ndarray, "components blocks powers"]:
    """Polynomials of the time in a block, from -1 to 1, that are the cosines there, times √2."""
    turns = np.pi * np.arange(1, components + 1)
    # Interpolated at Chebyshev's nodes.
    nodes = np.cos(np.pi * (np.arange(_POWERS) + 0.5) / _POWERS)
    inverse = np.linalg.inv(np.vander(nodes, increasing=True))
    angle = turns[:, None] * nodes / (2.0 * len(centres))
    middle = turns[:, None, None] * centres[:, None]
    cosines = np.cos(middle) * np.cos(angle)[:, None] - np.sin(middle) * np.sin(angle)[:, None]
    return np.sqrt(2.0) * cosines @ inverse.T


# Patterns that are expanded into regressor rows at once, as in `factorise`.
_BLOCK = 2048
# And by NumPy, whose products of a block are in memory all at once.
_HOST_BLOCK = 512
# Equations that are kept are filled up to a multiple of this, so that fits share a compiled
# function.
_STEP = 256


class AbstractRows(eqx.Module):
    """The equations of a fit, for a second pass: one of each joint at each instant.

    **Attributes**

    - `counts`: (instants, n) 1 for an equation that takes part, 0 for one that does not.
    - `torque`: (instants, n), the right-hand sides [N m or N].
    - `phase`: (instants,), the time of an instant over the length of the recording.
    """

    counts: eqx.AbstractVar[Float[Numbers, "instants joints"]]
    torque: eqx.AbstractVar[Float[Numbers, "instants joints"]]
    phase: eqx.AbstractVar[Float[Numbers, " instants"]]

    @property
    @abc.abstractmethod
    def unknowns(self) -> Unknowns:
        """The coefficients of the equations."""

    @abc.abstractmethod
    def factors(self, weight: Float[Array, "instants joints"]) -> JointFactors:
        """Return the factors of the equations that take part, both sides multiplied by `weight`."""

    @abc.abstractmethod
    def predicted(self, k: Float[Numbers, " coefficients"]) -> Float[Numbers, "instants joints"]:
        """The right-hand sides that `k` predicts."""

    @abc.abstractmethod
    def cosine_sums(
        self,
        residual: Float[Numbers, "instants joints"],
        weights: Float[Numbers, " joints"],
        used: Float[Numbers, " components"],
    ) -> "CosineSums":
        """A further pass over all rows.

        - `residual`: weighted, what multiplies each row in `CosineSums.sums`.
        - `weights`: of joints.
        - `used`: 1 for the cosine components that take part, the lowest ones.
        """


class CosineSums(NamedTuple):
    """Sums over all instants, each multiplied by a cosine of a number of half periods.

    - `sums`: (components, p), of the regressor rows times the weighted residuals.
    - `grams`: (components, p, p), of the outer products of weighted rows with themselves.
    - `power`: (p, p), the same times the sum of the squares of the cosines that take part.
    """

    sums: Float[Numbers, "components coefficients"]
    grams: Float[Numbers, "components coefficients coefficients"]
    power: Float[Numbers, "coefficients coefficients"]

    @classmethod
    def empty(cls, xp: ModuleType, size: int, components: int) -> "CosineSums":
        """Return the sums over no instants."""
        return cls(
            xp.zeros((components, size)),
            xp.zeros((components, size, size)),
            xp.zeros((size, size)),
        )

    def plus(
        self,
        support: tuple[int, ...],
        rows: Float[Numbers, "_ instants"],
        residual: Float[Numbers, " instants"],
        weight: Float[Numbers, " instants"],
        phase: Float[Numbers, " instants"],
        used: Float[Numbers, " components"],
    ) -> "CosineSums":
        """Add further rows of one joint, as columns of its support."""
        xp = array_namespace(rows)
        indices = np.array(support, dtype=int)
        number = xp.arange(1, len(used) + 1)
        cosines = used[:, None] * np.sqrt(2.0)
        cosines = cosines * xp.cos(np.pi * number[:, None] * phase[None, :])
        square = xp.sum(cosines**2, axis=0)
        both = (indices[:, None], indices[None, :])
        # Products are symmetric: those of each pair of rows, once for all components.
        first, second = np.triu_indices(len(indices))
        pair = np.empty((len(indices), len(indices)), int)
        pair[first, second] = pair[second, first] = np.arange(len(first))
        products = (rows * weight[None, :])[first] * rows[second]
        return CosineSums(
            _added(self.sums, (slice(None), indices), (cosines * residual[None, :]) @ rows.T),
            _added(self.grams, (slice(None), *both), (cosines @ products.T)[:, pair]),
            _added(self.power, both, (products @ square)[pair]),
        )


def _added(total: Any, index: tuple[Any, ...], change: Any) -> Any:
    """`total` with a change added at an index that names nothing twice."""
    if not isinstance(total, np.ndarray):
        return total.at[index].add(change)
    total = total.copy()
    total[index] += change
    return total


class PatternRows(AbstractRows):
    """Equations as recorded: their regressor is computed block by block in each pass."""

    network: AbstractLinearNetwork
    q: Float[Array, "instants motion"]
    qd: Float[Array, "instants motion"]
    qdd: Float[Array, "instants motion"]
    torque: Float[Array, "instants joints"]
    counts: Float[Array, "instants joints"]
    phase: Float[Array, " instants"]

    @property
    def unknowns(self) -> Unknowns:
        return Unknowns.of(self.network)

    def factors(self, weight: Float[Array, "instants joints"]) -> JointFactors:
        motion = (self.q, self.qd, self.qdd)
        return factorise(self.network, *motion, self.torque, self.counts * weight)

    def predicted(self, k: Float[Array, " coefficients"]) -> Float[Array, "instants joints"]:
        support = self.network.support

        def step(none: None, block: tuple[Array, ...]) -> tuple[None, Array]:
            columns = self.network.columns(*block)
            torque = [
                k[np.array(indices, dtype=int)] @ rows
                for indices, rows in zip(support, columns, strict=True)
            ]
            return none, jnp.stack(torque)

        _, predicted = jax.lax.scan(step, None, self._blocked(self.q, self.qd, self.qdd))
        return jnp.swapaxes(predicted, 1, 2).reshape(-1, len(support))[: len(self.q)]

    def cosine_sums(
        self,
        residual: Float[Array, "instants joints"],
        weights: Float[Array, " joints"],
        used: Float[Array, " components"],
    ) -> CosineSums:
        support = self.network.support

        def step(sums: CosineSums, block: tuple[Array, ...]) -> tuple[CosineSums, None]:
            q, qd, qdd, residual, weight, phase = block
            columns = self.network.columns(q, qd, qdd)
            for joint, (indices, rows) in enumerate(zip(support, columns, strict=True)):
                sums = sums.plus(indices, rows, residual[joint], weight[joint], phase[0], used)
            return sums, None

        weight = self.counts * weights[None, :] ** 2
        blocks = self._blocked(self.q, self.qd, self.qdd, residual, weight, self.phase[:, None])
        return jax.lax.scan(step, CosineSums.empty(jnp, self.network.size, len(used)), blocks)[0]

    def _blocked(self, *arrays: Float[Array, "instants _"]) -> tuple[Array, ...]:
        """(instants, joints) to (blocks, joints, size), zeros behind the end."""
        instants = len(self.q)
        size = min(_BLOCK, instants)
        blocks = -(-instants // size)
        widths = ((0, blocks * size - instants), (0, 0))
        return tuple(
            jnp.swapaxes(jnp.pad(x, widths).reshape(blocks, size, -1), 1, 2) for x in arrays
        )


_KeptBlock = tuple[tuple[Any, ...], Any, Any, Any]


class KeptRows(AbstractRows):
    """Equations that are few enough to be kept, such as a parallel filter has made.

    As NumPy's arrays, whose errors are computed on the host, or as JAX's.
    """

    columns: tuple[Float[Numbers, "instants _"], ...]
    torque: Float[Numbers, "instants joints"]
    counts: Float[Numbers, "instants joints"]
    phase: Float[Numbers, " instants"]
    of: Unknowns = eqx.field(static=True)

    @classmethod
    def from_equations(cls, equations: Equations, samples: int) -> "KeptRows":
        """Equations of a recording of so many samples, instants of several joints joined.

        NumPy's arrays.
        """
        kept, indices = equations.instants()
        instants = max(1, -(-len(kept) // _STEP)) * _STEP
        if instants > 16 * _STEP:  # as `filled_up` does
            instants = 1 << (instants - 1).bit_length()
        n = len(equations.rows)
        torque, counts = np.zeros((2, instants, n))
        columns: list[np.ndarray] = []
        for joint, (rows, at) in enumerate(zip(equations.rows, indices, strict=True)):
            filled = np.zeros((instants, rows.shape[1] - 1))
            filled[at], torque[at, joint], counts[at, joint] = rows[:, :-1], rows[:, -1], 1.0
            columns.append(filled)
        phase = np.zeros(instants)
        phase[: len(kept)] = (kept + 0.5) / samples
        return cls(
            columns=tuple(columns),
            torque=torque,
            counts=counts,
            phase=phase,
            of=equations.unknowns,
        )

    @property
    def unknowns(self) -> Unknowns:
        return self.of

    def factors(self, weight: Float[Array, "instants joints"]) -> JointFactors:
        triangles: list[Array] = []
        for joint, columns in enumerate(self.columns):
            rows = jnp.concatenate([columns, self.torque[:, joint, None]], axis=1)
            rows = rows * (self.counts * weight)[:, joint, None]
            size = rows.shape[1]
            triangles.append(join_rows(jnp.zeros((size, size)), rows.T))
        return JointFactors(tuple(triangles), jnp.sum(self.counts * weight != 0, axis=0) * 1.0)

    def predicted(self, k: Float[Numbers, " coefficients"]) -> Float[Numbers, "instants joints"]:
        torque = [
            rows @ k[np.array(indices, dtype=int)]
            for indices, rows in zip(self.of.support, self.columns, strict=True)
        ]
        return array_namespace(*torque).stack(torque, axis=1)

    def cosine_sums(
        self,
        residual: Float[Numbers, "instants joints"],
        weights: Float[Numbers, " joints"],
        used: Float[Numbers, " components"],
    ) -> CosineSums:
        def plus(sums: CosineSums, block: _KeptBlock) -> tuple[CosineSums, None]:
            columns, residual, weight, phase = block
            for j, (indices, rows) in enumerate(zip(self.of.support, columns, strict=True)):
                sums = sums.plus(indices, rows.T, residual[:, j], weight[:, j], phase, used)
            return sums, None

        xp = array_namespace(residual, weights, used, *self.columns)
        sums = empty = CosineSums.empty(xp, self.of.size, len(used))
        whole = (self.columns, residual, self.counts * weights[None, :] ** 2, self.phase)
        instants = len(self.phase)
        if xp is np and len(self.counts) >= FEWEST_INSTANTS * blocks_for(len(used)):
            return self._long_cosine_sums(residual, whole[2], used)
        if xp is np:
            for start in range(0, instants, _HOST_BLOCK):
                part = itemgetter(slice(start, start + _HOST_BLOCK))
                sums, _ = plus(sums, jax.tree.map(part, whole))
            return sums
        if instants <= 2 * _BLOCK or instants % _BLOCK:
            return plus(empty, whole)[0]
        # Block by block: there are as many products of rows and cosines as components.
        blocks = jax.tree.map(lambda x: x.reshape(-1, _BLOCK, *x.shape[1:]), whole)
        return jax.lax.scan(plus, empty, blocks)[0]

    def _long_cosine_sums(
        self,
        residual: Float[np.ndarray, "instants joints"],
        weight: Float[np.ndarray, "instants joints"],
        used: Float[np.ndarray, " components"],
    ) -> CosineSums:
        """`cosine_sums` of many instants on the host, all components used.

        - `weight`: of rows, squared.
        """
        # Zeros behind the end are no part of the recording.
        end = int(np.flatnonzero(np.any(self.counts > 0.0, axis=1))[-1]) + 1
        phase, components = self.phase[:end], len(used)
        number = np.arange(1, components + 1)
        cosines = np.sqrt(2.0) * np.cos(np.pi * number[:, None] * phase)
        square = np.sum(cosines**2, axis=0)

        def of_joint(joint: int) -> CosineSums:
            rows, weights = self.columns[joint][:end], weight[:end, joint]
            return CosineSums(
                (cosines * residual[:end, joint]) @ rows,
                cosine_grams(rows, weights, phase, components),
                ((weights * square)[:, None] * rows).T @ rows,
            )

        sums, grams, power = CosineSums.empty(np, self.of.size, components)
        joints = len(self.columns)
        # Of one joint each, as matrix products leave the interpreter to other threads.
        with ThreadPoolExecutor(min(core_count(), joints)) as pool:
            parts = zip(self.of.support, pool.map(of_joint, range(joints)), strict=True)
            for support, part in parts:
                at = np.array(support, dtype=int)
                sums[:, at] += part.sums
                grams[:, at[:, None], at] += part.grams
                power[at[:, None], at] += part.power
        return CosineSums(sums, grams, power)
