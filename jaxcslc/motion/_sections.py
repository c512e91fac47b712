import equinox as eqx
import numpy as np
import scipy
from jaxtyping import Float


class Reversal(eqx.Module):
    """Where a joint turns round.

    **Attributes**

    - `time`: the instant of zero velocity, in general between two samples [s].
    - `position`: the joint's position there [rad or m].
    - `direction`: of the motion that follows, 1 or -1.

    >>> from jaxcslc.motion import Reversal
    >>> Reversal(time=0.25, position=1.0, direction=-1).direction
    -1
    """

    time: float
    position: float
    direction: int


def find_reversals(
    time: Float[np.ndarray, " samples"],
    position: Float[np.ndarray, " samples"],
    *,
    tolerance: float,
    window: int,
) -> tuple[Reversal, ...]:
    r"""Finds where a joint turns round, to a fraction of a sample.

    The sections between are those that the thesis smooths separately (Section 7.3). Taken
    literally, 'monotone between sample points' would break a record at every count that
    flickers, so a turn is one that the joint has come back from by more than a tolerance.

    The instant matters: an error of $\delta$ leaves a step of $\ddot q\,\delta$ in the velocity.
    It is the one for which two cubics that leave it with zero velocity, one to either side and
    each with an acceleration of its own, fit the samples around it best. The middle of the
    highest count is cruder: where friction makes the acceleration jump, the joint is longer on
    that count on one side than on the other. (On simulated PUMA 560 recordings, fitting the
    instant cut the acceleration error near reversals to between a half and a fifth.)

    **Arguments**

    - `time`: instants of the samples, shape `(samples,)` [s].
    - `position`: of one joint, shape `(samples,)` [rad or m].
    - `tolerance`: how far a joint must come back for a turn to be one [rad or m]; a few counts
        of the encoder, or a few standard deviations of the noise.
    - `window`: how many samples on either side the cubics are fitted to, at the most.

    **Returns**

    The reversals in order of time, their directions alternating.

    >>> import numpy as np
    >>> from jaxcslc.motion import find_reversals
    >>> time = np.arange(1000) * 0.002
    >>> counts = 1e-4 * np.round(np.sin(np.pi * time) / 1e-4)
    >>> turns = find_reversals(time, counts, tolerance=3e-4, window=25)
    >>> [(round(turn.time, 3), turn.direction) for turn in turns]
    [(0.5, -1), (1.5, 1)]
    """
    turns = _turns(position, tolerance)
    reversals: list[Reversal] = []
    for number, (turn, direction) in enumerate(turns):
        # Cubics fitted across a neighbouring reversal would be fitted to another motion.
        start = 0 if number == 0 else turns[number - 1][0]
        end = time.size - 1 if number + 1 == len(turns) else turns[number + 1][0]
        instant, extreme = _fitted(
            time[start : end + 1], position[start : end + 1], turn - start, tolerance, window
        )
        if not time[0] < instant < time[-1]:
            continue
        if not reversals or instant > reversals[-1].time:
            reversals.append(Reversal(instant, extreme, direction))
        else:
            # Both turns were fitted to the same instant: there is nothing between them.
            reversals.pop()
    return tuple(reversals)


def _turns(position: Float[np.ndarray, " samples"], tolerance: float) -> list[tuple[int, int]]:
    """Extremes that the position retreats from by more than the tolerance, with what follows."""
    turns: list[tuple[int, int]] = []
    values = position.tolist()
    direction = highest = lowest = 0
    for sample, value in enumerate(values):
        if value > values[highest]:
            highest = sample
        if value < values[lowest]:
            lowest = sample
        if direction >= 0 and values[highest] - value > tolerance:
            if direction > 0:
                turns.append((highest, -1))
            direction, lowest = -1, sample
        elif direction <= 0 and value - values[lowest] > tolerance:
            if direction < 0:
                turns.append((lowest, 1))
            direction, highest = 1, sample
    return turns


def _fitted(
    time: Float[np.ndarray, " samples"],
    position: Float[np.ndarray, " samples"],
    turn: int,
    tolerance: float,
    window: int,
) -> tuple[float, float]:
    extreme = position[turn]
    beyond = np.flatnonzero(np.abs(position - extreme) > tolerance)
    first = int(np.max(beyond[beyond < turn], initial=-1)) + 1
    last = int(np.min(beyond[beyond > turn], initial=time.size)) - 1
    if last - first > 2 * window:
        # At rest between the two motions: any instant of it will do.
        at_rest = position[first : last + 1]
        return float(0.5 * (time[first] + time[last])), float(np.median(at_rest))

    low, high = max(first - window, 0), min(last + window + 1, time.size)
    # The search's tolerance grows with its argument: counted from here, time stamps since 1970 are
    # as good as any.
    origin = time[low]
    near, values = time[low:high] - origin, position[low:high]
    scale = near[-1]

    def fit(instant: float) -> tuple[float, float]:
        ahead = (near - instant) / scale
        before, after = np.minimum(ahead, 0.0), np.maximum(ahead, 0.0)
        design = np.stack(
            [np.ones_like(ahead), before**2, before**3, after**2, after**3],
            axis=1,
        )
        coefficients, *_ = np.linalg.lstsq(design, values - extreme, rcond=None)
        misfit = design @ coefficients - (values - extreme)
        return float(misfit @ misfit), float(coefficients[0])

    best = scipy.optimize.minimize_scalar(
        lambda instant: fit(instant)[0],
        bounds=(time[first] - origin, time[last] - origin) if first < last else (0.0, scale),
        method="bounded",
        options={"xatol": 1e-3 * scale / near.size},
    )
    return float(origin + best.x), extreme + fit(float(best.x))[1]
