from collections.abc import Sequence

import numpy as np
from jaxtyping import Float

from ._sampling import noise_level
from ._splines import AveragedSplines


def left_out_error(
    time: Float[np.ndarray, " samples"],
    position: Float[np.ndarray, "samples joints"],
    smoothing: AveragedSplines,
) -> Float[np.ndarray, " joints"]:
    r"""How well averaged splines predict each sample from all the others, joint by joint.

    Of the j splines, one runs through a sample and j - 1 do not. Their mean is the
    average with that sample left out, and it misses the sample by $j / (j - 1)$ times the
    residual: exact leave-one-out cross-validation of the positions for the price of one
    smoothing.

    (Near the ends of a section, where the shared end point knows all samples around it, this
    holds only nearly.)

    **Arguments**

    - `time`: instants of the samples, shape `(samples,)` [s].
    - `position`: joint positions, shape `(samples, joints)` [rad or m].
    - `smoothing`: with a spacing of 2 or more.

    **Returns**

    The root mean square of the errors, shape `(joints,)` [rad or m].

    **Raises**

    - `ValueError`: a spacing of 1, of which no spline would be left.

    >>> import numpy as np
    >>> from jaxcslc.motion import AveragedSplines, left_out_error
    >>> time = np.arange(1000) * 0.002
    >>> position = 1e-4 * np.round(np.sin(2 * np.pi * time) / 1e-4)[:, None]
    >>> error = left_out_error(time, position, AveragedSplines(17))
    >>> bool(0.9 < error[0] / (1e-4 / 12**0.5) < 1.1)
    True
    """
    spacings = np.array(smoothing.spacings(position.shape[1]), dtype=np.float64)
    if np.any(spacings < 2):
        raise ValueError(f"spacing is {smoothing.spacing}; expected 2 samples or more to leave out")
    q, _, _ = smoothing.smooth(time, position)
    residual = np.sqrt(np.mean((position - q) ** 2, axis=0))
    return residual * spacings / (spacings - 1.0)


def choose_spacing(
    time: Float[np.ndarray, " samples"],
    position: Float[np.ndarray, "samples joints"],
    *,
    candidates: Sequence[int] = (5, 7, 9, 11, 13, 15, 17, 21, 25, 29, 35, 41),
    slack: float = 0.01,
    sections: bool = True,
    resolution: float | Float[np.ndarray, " joints"] = 0.0,
) -> tuple[int, ...]:
    r"""Chooses the spacing of averaged splines for each joint, from positions and resolution alone.

    The left-out error falls slowly with the spacing while there is noise to average, and rises
    steeply once the motion itself is smoothed away. Accelerations suffer more from noise than
    positions do, so what is best for them is the widest spacing that takes next to nothing from
    the motion.

    *Next to nothing* is measured by the encoder's resolution. With $e_j$ the left-out error of
    spacing j and σ the deviation of the noise, at least a count's $1/\sqrt{12}$, the choice is the
    widest candidate with

    $e_j^2 \le \min_i e_i^2 + 2\,\text{slack}\,\sigma^2$,

    so what it takes from the motion beyond the best candidate is less than a seventh of σ (for
    the default slack), 0.04 counts where there is no noise but quantisation. Where no candidate
    comes near the noise, as in a motion of steps, that is stricter than an equal part of the
    error would be.

    (On simulated recordings of the PUMA 560, 10 seeds, the accelerations of the choice had 1.0 to
    1.4 times the RMS error of the best spacing for each joint away from velocity reversals, 1.0 to
    1.5 times at them: `scripts/studies/smoothing/study.py`.)

    **Arguments**

    - `time`: instants of the samples, shape `(samples,)` [s].
    - `position`: joint positions, shape `(samples, joints)` [rad or m].
    - `candidates`: spacings to choose from, each of 2 or more [samples].
    - `slack`: how much more left-out error than the least the choice may have, as part of the
        noise.
    - `sections`: as of `AveragedSplines`.
    - `resolution`: of the encoders, where known, of all joints or of each [rad or m]: the noise
        is at least theirs. By default it is what `noise_level` sees in the readings, their
        counts included.

    **Returns**

    One spacing for each joint.

    **Raises**

    - `ValueError`: no candidates, one below 2, or a negative resolution.

    >>> import numpy as np
    >>> from jaxcslc.motion import choose_spacing
    >>> time = np.arange(1000) * 0.002
    >>> motion = np.stack([np.sin(2 * np.pi * time), np.sin(6 * np.pi * time)], axis=1)
    >>> slow, fast = choose_spacing(time, 1e-4 * np.round(motion / 1e-4))
    >>> slow > fast
    True
    """
    if not candidates:
        raise ValueError("no candidate spacings; expected one or more")
    if not np.all(np.asarray(resolution) >= 0.0):
        raise ValueError(f"encoder resolution is {resolution}; expected 0 or more")
    errors = np.stack(
        [
            left_out_error(time, position, AveragedSplines(spacing, sections))
            for spacing in candidates
        ]
    )
    noise = np.maximum(noise_level(position), np.asarray(resolution) / np.sqrt(12.0))
    good = errors**2 <= np.min(errors, axis=0) ** 2 + 2.0 * slack * noise**2
    return tuple(int(np.max(np.asarray(candidates)[column])) for column in good.T)
