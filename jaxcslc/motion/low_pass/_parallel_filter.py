import equinox as eqx
import numpy as np
from jaxtyping import Bool, Float, Int

from ._decimated_low_pass import decimated_low_pass


class FilteredEquations(eqx.Module):
    """Equations `regressor @ k = torque`, filtered alike on both sides and decimated.

    **Attributes**

    - `regressor`: shape `(equations, coefficients)`.
    - `torque`: shape `(equations,)` [N m or N].
    - `joint`: which joint each equation is of, counted from 0, shape `(equations,)`.
    - `sample`: at which sample its filter is centred, shape `(equations,)`.
    - `weight`: how much of its filter lay on pairs that count, shape `(equations,)`; near 1
        where all did.

    >>> import numpy as np
    >>> from jaxcslc.motion import parallel_filter
    >>> regressor = np.ones((200, 1, 1))
    >>> equations = parallel_filter(
    ...     regressor, 3 * np.ones((200, 1)), np.ones((200, 1), bool), interval=0.01, cutoff=5.0
    ... )
    >>> equations.torque.shape, equations.torque[0].round(9)
    ((20,), np.float64(3.0))
    """

    regressor: Float[np.ndarray, "equations coefficients"]
    torque: Float[np.ndarray, " equations"]
    joint: Int[np.ndarray, " equations"]
    sample: Int[np.ndarray, " equations"]
    weight: Float[np.ndarray, " equations"]


def decimation_for(cutoff: float, interval: float) -> int:
    """Every how many samples to keep what a low-pass filter has left.

    Below its cut-off a record holds two independent values a period, and the residuals of
    samples `1 / (2 cutoff)` apart are as good as uncorrelated. Keeping more would gain nothing
    and make standard errors look smaller than they are. Aliasing does no harm: both sides of an
    equation alias alike, and it stays true.

    **Arguments**

    - `cutoff`: of the filter [Hz].
    - `interval`: between samples [s].

    **Returns**

    The whole number of samples nearest below `1 / (2 cutoff)`, and at least 1.

    >>> from jaxcslc.motion import decimation_for
    >>> decimation_for(cutoff=15.0, interval=0.002)
    16
    """
    return max(1, int(np.floor(0.5 / (cutoff * interval) + 1e-9)))


def parallel_filter(
    regressor: Float[np.ndarray, "samples joints coefficients"],
    torque: Float[np.ndarray, "samples joints"],
    mask: Bool[np.ndarray, "samples joints"],
    *,
    interval: float,
    cutoff: float,
    order: int = 4,
    decimation: int | None = None,
    kept: Int[np.ndarray, " kept"] | None = None,
    least_weight: float = 0.05,
) -> FilteredEquations:
    """Filters every column of the regressor and the torque alike, and decimates.

    The equation of a joint is linear in the coefficients at every instant, so any linear filter
    over time of all its terms makes another true equation. A low pass takes the noise above the
    motion out of both sides without the distortion that filtering one of them would bring
    (the 'parallel filtering' of Gautier, ICRA 1997, doi:10.1109/ROBOT.1997.606768).

    Pairs of joint and sample that do not count are set to zero on both sides before: 0 = 0 is as
    true an equation, and what is left of the neighbours stays theirs.

    **Arguments**

    - `regressor`: shape `(samples, joints, coefficients)`.
    - `torque`: shape `(samples, joints)` [N m or N].
    - `mask`: which pairs count, shape `(samples, joints)`.
    - `interval`: between the samples, uniform [s].
    - `cutoff`: of the filter [Hz]. A little above the fastest motion; below the pass band of
        the smoothing that gave the accelerations, or it has nothing left to do.
    - `order`: of one of the filter's two passes.
    - `decimation`: keep every so many samples; by default `decimation_for(cutoff, interval)`.
    - `kept`: the samples to keep, in place of every so many.
    - `least_weight`: drop an equation of which less than this part of the filter lay on pairs
        that count. The choice looks at the mask alone, never at the data.

    **Returns**

    The equations that are left, joint by joint. There are none where nothing counts.

    **Raises**

    - `ValueError`: a decimation below 1, or a cut-off that the sampling rate does not allow.

    >>> import numpy as np
    >>> from jaxcslc.motion import parallel_filter
    >>> time = np.arange(500) * 0.01
    >>> regressor = np.stack([np.sin(time), np.cos(3 * time)], axis=1)[:, None, :]
    >>> torque = regressor @ np.array([2.0, -1.0])
    >>> mask = np.abs(np.sin(time))[:, None] > 0.1
    >>> equations = parallel_filter(regressor, torque, mask, interval=0.01, cutoff=5.0)
    >>> np.linalg.lstsq(equations.regressor, equations.torque)[0].round(9).tolist()
    [2.0, -1.0]
    """
    if decimation is None:
        decimation = decimation_for(cutoff, interval)
    if decimation < 1:
        raise ValueError(f"decimation is {decimation}; expected 1 or more samples")
    samples, joints, coefficients = regressor.shape
    # Start in the middle of the first stretch, so that the two ends are treated alike.
    every = np.arange((samples - 1) % decimation // 2, samples, decimation)
    kept = every if kept is None else kept

    regressors: list[Float[np.ndarray, "rows coefficients"]] = []
    columns: list[tuple[np.ndarray, int, np.ndarray, np.ndarray]] = []
    for joint in range(joints):
        valid = mask[:, joint]
        # Torque and mask are filtered like columns of the regressor.
        sides = np.zeros((coefficients + 2, samples))
        np.copyto(sides[:-2], regressor[:, joint].T, where=valid)
        np.copyto(sides[-2], torque[:, joint], where=valid)
        sides[-1] = valid
        # Empty columns, of coefficients that have no part in this joint, are not worth a filter.
        present = np.flatnonzero(np.any(sides, axis=1))
        sides = sides if present.size == len(sides) else sides[present]
        filtered = np.zeros((coefficients + 2, kept.size))
        filtered[present] = decimated_low_pass(sides, kept, interval, cutoff=cutoff, order=order)
        enough = filtered[-1] >= least_weight
        remaining = filtered[:, enough]
        regressors.append(remaining[:-2].T)
        columns.append((remaining[-2], joint, kept[enough], remaining[-1]))
    return FilteredEquations(
        regressor=np.concatenate(regressors),
        torque=np.concatenate([rows for rows, *_ in columns]),
        joint=np.concatenate([np.full(rows.size, joint) for rows, joint, *_ in columns]),
        sample=np.concatenate([sample for *_, sample, _ in columns]),
        weight=np.concatenate([weight for *_, weight in columns]),
    )
