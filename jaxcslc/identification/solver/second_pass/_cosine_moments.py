import numpy as np
from jaxtyping import Float


# Half a block in the phase of the highest cosine [rad], and powers of the time within a block that
# a cosine is interpolated by: to 5e-7.
_HALF_BLOCK = 0.25
_POWERS = 5
# Blocks of fewer instants cost more than products of all pairs of columns.
FEWEST_INSTANTS = 16
# Blocks whose moments are in memory at once.
_TOGETHER = 50


def blocks_for(components: int) -> int:
    """How many blocks a recording is cut into for so many cosine components."""
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
