import numpy as np
from jaxtyping import Float


def encoder_resolution(
    position: Float[np.ndarray, "samples joints"],
) -> Float[np.ndarray, " joints"]:
    """Estimates the counts that recorded positions are made of, joint by joint.

    An encoder's readings are integer multiples of one step (thesis, Section 7.2.5). The smallest
    step between any two readings shows it, provided that the other small steps are multiples of
    it; otherwise the readings lie on no grid.

    **Arguments:**

    - `position`: joint positions, shape `(samples, joints)` [rad or m].

    **Returns:**

    The width of a count, shape `(joints,)` [rad or m]; 0 for a joint that shows no grid: a
    position that was not quantised, or that never changes.

    ```python
    >>> import numpy as np
    >>> from jaxcslc.motion import encoder_resolution
    >>> time = np.linspace(0.0, 3.0, 1000)
    >>> smooth = np.stack([np.sin(time), np.cos(time)], axis=1)
    >>> counts = np.array([1e-4, 2e-4])
    >>> encoder_resolution(counts * np.round(smooth / counts)).round(9).tolist()
    [0.0001, 0.0002]
    >>> encoder_resolution(smooth).tolist()
    [0.0, 0.0]

    ```
    """
    return np.array([_smallest_step(column) for column in position.T])


def noise_level(position: Float[np.ndarray, "samples joints"]) -> Float[np.ndarray, " joints"]:
    r"""Estimates how far recorded positions scatter about a smooth motion, joint by joint.

    Third differences of a motion that is smooth on the scale of a few samples are all noise,
    $\sqrt{20}$ times that of the positions. Their median absolute value disregards the few that
    straddle a jump. Quantisation adds a step's $1/\sqrt{12}$, the least there can be.

    **Arguments:**

    - `position`: joint positions, shape `(samples, joints)` [rad or m], four samples or more,
        at roughly even intervals.

    **Returns:**

    The standard deviation of the noise, shape `(joints,)` [rad or m].

    ```python
    >>> import numpy as np
    >>> from jaxcslc.motion import noise_level
    >>> time = np.linspace(0.0, 3.0, 1000)[:, None]
    >>> quantised = 1e-4 * np.round(np.sin(time) / 1e-4)
    >>> bool(1e-4 < noise_level(quantised)[0] * 12**0.5 < 1.2e-4)
    True

    ```
    """
    scatter = np.median(np.abs(np.diff(position, n=3, axis=0)), axis=0)
    # 0.6745 is the median absolute value of a normal variable of unit deviation.
    scatter = scatter / (0.6745 * np.sqrt(20.0))
    return np.maximum(scatter, encoder_resolution(position) / np.sqrt(12.0))


def _smallest_step(values: Float[np.ndarray, " samples"]) -> float:
    levels = np.unique(values)
    steps = np.diff(levels)
    # Equal counts may differ by rounding of their conversion to radians.
    steps = steps[steps > 1e-9 * np.max(np.abs(levels), initial=0.0)]
    if steps.size == 0:
        return 0.0
    smallest = np.min(steps)
    # Far larger steps would tell the count more exactly than it deserves: an error of the
    # smallest would grow to a whole count there.
    multiples = steps[steps < 8.5 * smallest] / smallest
    nearest = np.round(multiples)
    on_grid = np.abs(multiples - nearest) < 0.05
    # Without a grid, a tenth of the steps would pass that test by chance.
    if multiples.size < 2 or np.mean(on_grid) < 0.9:
        return 0.0
    return float(smallest * np.median(multiples[on_grid] / nearest[on_grid]))
