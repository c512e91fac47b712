import abc
from typing import NamedTuple

import equinox as eqx
import jax
import jax.numpy as jnp
import numpy as np
from jaxtyping import Array, Float

from ...network import CSLC
from ._equations import Equations
from ._factors import JointFactors, factorise, join_rows


# Patterns that are expanded into regressor rows at once, as in `factorise`.
_BLOCK = 2048
# Equations that are kept are filled up to a multiple of this, so that fits share a compiled
# function.
_STEP = 256


class AbstractRows(eqx.Module):
    """The equations of a fit, to go over again: one a joint at each instant.

    **Attributes**

    - `counts`: (instants, n) 1 where an equation counts, 0 where it does not.
    - `torque`: (instants, n), the right-hand sides [N m or N].
    - `phase`: (instants,), when an instant is, as a part of the recording's length.
    """

    counts: eqx.AbstractVar[Float[Array, "instants joints"]]
    torque: eqx.AbstractVar[Float[Array, "instants joints"]]
    phase: eqx.AbstractVar[Float[Array, " instants"]]

    @abc.abstractmethod
    def factors(self, network: CSLC, weight: Float[Array, "instants joints"]) -> JointFactors:
        """Of the equations that count, both sides multiplied by `weight`."""

    @abc.abstractmethod
    def predicted(
        self, network: CSLC, k: Float[Array, " coefficients"]
    ) -> Float[Array, "instants joints"]:
        """The right-hand sides that `k` gives."""

    @abc.abstractmethod
    def waves(
        self,
        network: CSLC,
        pull: Float[Array, "instants joints"],
        weights: Float[Array, " joints"],
        used: Float[Array, " waves"],
    ) -> "Waves":
        """Goes over all rows once more; `pull` is what each is multiplied by in `Waves.sums`,
        `weights` are those of joints, `used` is 1 for the waves that count, the first ones."""


class Waves(NamedTuple):
    """Sums over all instants, each multiplied by a cosine of a number of half periods.

    - `sums`: (waves, p), of the regressor's rows times what pulls at them.
    - `grams`: (waves, p, p), of the outer products of weighted rows with themselves.
    - `power`: (p, p), the same times the squares of all cosines that count, added up.
    """

    sums: Float[Array, "waves coefficients"]
    grams: Float[Array, "waves coefficients coefficients"]
    power: Float[Array, "coefficients coefficients"]

    @classmethod
    def none(cls, size: int, waves: int) -> "Waves":
        """Of no instants."""
        return cls(
            jnp.zeros((waves, size)), jnp.zeros((waves, size, size)), jnp.zeros((size, size))
        )

    def plus(
        self,
        support: tuple[int, ...],
        rows: Float[Array, "_ instants"],
        pull: Float[Array, " instants"],
        weight: Float[Array, " instants"],
        phase: Float[Array, " instants"],
        used: Float[Array, " waves"],
    ) -> "Waves":
        """With further rows, of one joint, given as columns of its support."""
        own = np.array(support, dtype=int)
        number = jnp.arange(1, len(used) + 1)
        shapes = used[:, None] * jnp.sqrt(2.0)
        shapes = shapes * jnp.cos(jnp.pi * number[:, None] * phase[None, :])
        heavy = rows * weight[None, :]
        square = jnp.sum(shapes**2, axis=0)
        return Waves(
            self.sums.at[:, own].add((shapes * pull[None, :]) @ rows.T),
            self.grams.at[:, own[:, None], own[None, :]].add(
                (shapes[:, None, :] * heavy[None]) @ rows.T
            ),
            self.power.at[own[:, None], own[None, :]].add((heavy * square[None, :]) @ rows.T),
        )


class PatternRows(AbstractRows):
    """Equations as recorded: their regressor is computed block by block, whenever it is asked."""

    q: Float[Array, "instants joints"]
    qd: Float[Array, "instants joints"]
    qdd: Float[Array, "instants joints"]
    torque: Float[Array, "instants joints"]
    counts: Float[Array, "instants joints"]
    phase: Float[Array, " instants"]

    def factors(self, network: CSLC, weight: Float[Array, "instants joints"]) -> JointFactors:
        return factorise(network, self.q, self.qd, self.qdd, self.torque, self.counts * weight)

    def predicted(
        self, network: CSLC, k: Float[Array, " coefficients"]
    ) -> Float[Array, "instants joints"]:
        def step(none: None, block: tuple[Array, ...]) -> tuple[None, Array]:
            columns = network.columns(*block)
            own = [
                k[np.array(support, dtype=int)] @ rows
                for support, rows in zip(network.support, columns, strict=True)
            ]
            return none, jnp.stack(own)

        _, predicted = jax.lax.scan(step, None, self._blocked(self.q, self.qd, self.qdd))
        return jnp.swapaxes(predicted, 1, 2).reshape(-1, len(network.support))[: len(self.q)]

    def waves(
        self,
        network: CSLC,
        pull: Float[Array, "instants joints"],
        weights: Float[Array, " joints"],
        used: Float[Array, " waves"],
    ) -> Waves:
        def step(waves: Waves, block: tuple[Array, ...]) -> tuple[Waves, None]:
            q, qd, qdd, pull, weight, phase = block
            columns = network.columns(q, qd, qdd)
            for joint, (support, rows) in enumerate(zip(network.support, columns, strict=True)):
                waves = waves.plus(support, rows, pull[joint], weight[joint], phase[0], used)
            return waves, None

        weight = self.counts * weights[None, :] ** 2
        blocks = self._blocked(self.q, self.qd, self.qdd, pull, weight, self.phase[:, None])
        return jax.lax.scan(step, Waves.none(network.size, len(used)), blocks)[0]

    def _blocked(self, *arrays: Float[Array, "instants _"]) -> tuple[Array, ...]:
        """(instants, joints) to (blocks, joints, size), zeros behind the end."""
        instants = len(self.q)
        size = min(_BLOCK, instants)
        blocks = -(-instants // size)
        widths = ((0, blocks * size - instants), (0, 0))
        return tuple(
            jnp.swapaxes(jnp.pad(x, widths).reshape(blocks, size, -1), 1, 2) for x in arrays
        )


class KeptRows(AbstractRows):
    """Equations that are few enough to be kept, such as a parallel filter has made."""

    columns: tuple[Float[Array, "instants _"], ...]
    torque: Float[Array, "instants joints"]
    counts: Float[Array, "instants joints"]
    phase: Float[Array, " instants"]

    @classmethod
    def of(cls, equations: Equations, samples: int) -> "KeptRows":
        """Equations of a recording of so many samples, instants of several joints joined."""
        kept = np.unique(np.concatenate(equations.sample))
        instants = max(1, -(-len(kept) // _STEP)) * _STEP
        if instants > 16 * _STEP:  # as `filled_up` does
            instants = 1 << (instants - 1).bit_length()
        n = len(equations.rows)
        torque, counts = np.zeros((2, instants, n))
        columns: list[Array] = []
        for joint, (rows, sample) in enumerate(zip(equations.rows, equations.sample, strict=True)):
            at = np.searchsorted(kept, sample)
            own = np.zeros((instants, rows.shape[1] - 1))
            own[at], torque[at, joint], counts[at, joint] = rows[:, :-1], rows[:, -1], 1.0
            columns.append(jnp.asarray(own))
        phase = np.zeros(instants)
        phase[: len(kept)] = (kept + 0.5) / samples
        return cls(
            columns=tuple(columns),
            torque=jnp.asarray(torque),
            counts=jnp.asarray(counts),
            phase=jnp.asarray(phase),
        )

    def factors(self, network: CSLC, weight: Float[Array, "instants joints"]) -> JointFactors:
        del network
        triangles: list[Array] = []
        for joint, own in enumerate(self.columns):
            rows = jnp.concatenate([own, self.torque[:, joint, None]], axis=1)
            rows = rows * (self.counts * weight)[:, joint, None]
            size = rows.shape[1]
            triangles.append(join_rows(jnp.zeros((size, size)), rows.T))
        return JointFactors(tuple(triangles), jnp.sum(self.counts * weight != 0, axis=0) * 1.0)

    def predicted(
        self, network: CSLC, k: Float[Array, " coefficients"]
    ) -> Float[Array, "instants joints"]:
        own = [
            rows @ k[np.array(support, dtype=int)]
            for support, rows in zip(network.support, self.columns, strict=True)
        ]
        return jnp.stack(own, axis=1)

    def waves(
        self,
        network: CSLC,
        pull: Float[Array, "instants joints"],
        weights: Float[Array, " joints"],
        used: Float[Array, " waves"],
    ) -> Waves:
        waves = Waves.none(network.size, len(used))
        weight = self.counts * weights[None, :] ** 2
        for joint, (support, rows) in enumerate(zip(network.support, self.columns, strict=True)):
            waves = waves.plus(support, rows.T, pull[:, joint], weight[:, joint], self.phase, used)
        return waves
