from collections.abc import Collection

import equinox as eqx
import jax.numpy as jnp
import numpy as np
from jaxtyping import Array, Bool, Float, Int

from ...motion import Patterns, parallel_filter, uniform_interval
from ...network import CSLC
from ._compiled import regressor_of
from ._factors import JointFactors
from ._triangle import triangle_of


class Equations(eqx.Module):
    """Equations of a recording in the columns of each joint, and where in it they belong.

    **Attributes**

    - `rows`: for each joint (rows, s + 1), its s coefficients' columns and the torque.
    - `sample`: for each joint, the sample that each row belongs to.
    """

    rows: tuple[Float[np.ndarray, "_ _"], ...]
    sample: tuple[Int[np.ndarray, " _"], ...]

    @classmethod
    def of(
        cls,
        network: CSLC,
        regressor: Float[np.ndarray, "samples joints coefficients"],
        torque: Float[np.ndarray, "samples joints"],
        mask: Bool[np.ndarray, "samples joints"],
        *,
        time: Float[np.ndarray, " samples"],
        cutoff: float | None,
    ) -> "Equations":
        """The equations of the pairs that count, or those that a parallel filter makes of them."""
        if cutoff is None:
            samples = [np.flatnonzero(column) for column in mask.T]
            rows = [
                np.concatenate(
                    [regressor[own, joint][:, list(support)], torque[own, joint, None]], axis=1
                )
                for joint, (support, own) in enumerate(zip(network.support, samples, strict=True))
            ]
            return cls(tuple(rows), tuple(samples))
        filtered = parallel_filter(
            regressor, torque, mask, interval=uniform_interval(time), cutoff=cutoff
        )
        joints = [filtered.joint == joint for joint in range(network.joint_count)]
        rows = [
            np.concatenate(
                [filtered.regressor[own][:, list(support)], filtered.torque[own, None]], axis=1
            )
            for support, own in zip(network.support, joints, strict=True)
        ]
        return cls(tuple(rows), tuple(filtered.sample[own] for own in joints))

    def without(self, network: CSLC, places: Collection[int]) -> "Equations":
        """The same with nothing that depends on these coefficients."""
        kept = [[*(place not in places for place in own), True] for own in network.support]
        rows = (rows * np.array(own) for rows, own in zip(self.rows, kept, strict=True))
        return Equations(tuple(rows), self.sample)

    def followed_by(self, other: "Equations", after: int) -> "Equations":
        """Both sets, the other's recording so many samples later."""
        return Equations(
            tuple(np.concatenate(rows) for rows in zip(self.rows, other.rows, strict=True)),
            tuple(
                np.concatenate([mine, after + theirs])
                for mine, theirs in zip(self.sample, other.sample, strict=True)
            ),
        )

    def factors(self) -> JointFactors:
        """The factors of all equations."""
        return JointFactors(
            tuple(jnp.asarray(_triangles([rows])[0]) for rows in self.rows),
            jnp.array([float(len(rows)) for rows in self.rows]),
        )

    def factors_of_folds(self, fold: Int[np.ndarray, " samples"], folds: int) -> JointFactors:
        """The factors of each fold by itself, all arrays with a leading axis of folds."""
        triangles: list[Array] = []
        counts: list[np.ndarray] = []
        for rows, sample in zip(self.rows, self.sample, strict=True):
            parts = [rows[fold[sample] == number] for number in range(folds)]
            triangles.append(jnp.asarray(_triangles(parts)))
            counts.append(np.array([float(len(part)) for part in parts]))
        return JointFactors(tuple(triangles), jnp.asarray(np.stack(counts, axis=-1)))


def equations_of(
    network: CSLC,
    patterns: Patterns,
    cutoff: float | None,
    regressor: Float[np.ndarray, "samples joints coefficients"] | None = None,
) -> Equations:
    """One a pair that counts, or those that a parallel filter makes of them; on the host."""
    return Equations.of(
        network,
        np.asarray(regressor_of(network, patterns)) if regressor is None else regressor,
        np.asarray(patterns.torque),
        np.asarray(patterns.mask),
        time=np.asarray(patterns.time),
        cutoff=cutoff,
    )


def _triangles(parts: list[Float[np.ndarray, "_ columns"]]) -> Float[np.ndarray, "parts s s"]:
    """The triangle of each part."""
    padded = np.zeros((len(parts), max(len(part) for part in parts), parts[0].shape[1]))
    for place, part in zip(padded, parts, strict=True):
        place[: len(part)] = part
    return triangle_of(padded)
