"""Zero-phase Butterworth low-pass filters, of signals and of whole equations.

`zero_phase` filters signals, and `parallel_filter` filters regressor and torque alike, with
decimation. Both sides of an equation may be filtered, since it is linear in the coefficients.
"""

from functools import lru_cache
from typing import NamedTuple

import numpy as np
from jaxtyping import Bool, Float, Int


# Of a filter whose order is not stated, and of the filter of whole equations.
_ORDER = 4
# Periods of the cut-off after which less than 1e-5 is left of what a filter of fourth order has
# seen: its slowest poles fade by exp(-0.38 · 2π) in each. After twice as many, 1e-10 is left.
_REFLECTED_PERIODS = 5.0
_REMEMBERED_PERIODS = 2.0 * _REFLECTED_PERIODS
# The slowest cut-off, as a part of the sampling rate: rounding changes an eighth order by 2e-6.
_SLOWEST = 1e-6
# Samples that are filtered by one product, and samples kept of one: their windows overlap, so that
# fewer would read the signal more often and more would multiply more zeros.
_BLOCK, _TOGETHER = 64, 16


def zero_phase(
    signal: Float[np.ndarray, " samples *columns"],
    interval: float,
    *,
    cutoff: float,
    order: int = _ORDER,
) -> Float[np.ndarray, " samples *columns"]:
    """Run a Butterworth low-pass filter over a signal forwards and backwards.

    What `scipy.signal.sosfiltfilt` computes with the sections of `scipy.signal.butter`, whose
    import takes 0.36 s.

    **Arguments**

    - `signal`: sampled along its first axis, shape `(samples, ...)`.
    - `interval`: between samples [s].
    - `cutoff`: where the two passes together leave half of the amplitude [Hz].
    - `order`: of one pass.

    **Returns** the filtered signal, of the same shape, a linear function of the signal.

    **Raises** `ValueError`: a cut-off that is not from 1e-6 times to half the sampling rate, or
    fewer samples than the filter needs to start from.

    >>> import numpy as np
    >>> from jaxcslc.recordings import zero_phase
    >>> bool(np.allclose(zero_phase(np.ones((100, 2)), 0.01, cutoff=5.0), 1.0))
    True
    """
    _check(signal.shape[0], interval, cutoff, order)
    if not signal.size:
        return np.zeros(signal.shape)
    low_pass = _butterworth(order, cutoff * interval)
    x = np.asarray(signal, float).reshape(signal.shape[0], -1)
    # The record goes on by its own reflection in its end points for as long as the filter
    # remembers: scipy's default is a few samples, of which a slow filter leaves transients.
    padding = min(int(np.ceil(_REFLECTED_PERIODS / (cutoff * interval))), signal.shape[0] - 1)
    forwards = low_pass.run(_reflected(x.T, padding).T)
    both = low_pass.run(forwards[::-1])[::-1]
    return both[padding : padding + len(x)].reshape(signal.shape)


def _check(samples: int, interval: float, cutoff: float, order: int) -> None:
    rate = 1.0 / interval
    if not _SLOWEST * rate <= cutoff < 0.5 * rate:
        raise ValueError(
            f"cut-off is {cutoff} Hz; expected at least {_SLOWEST:g} times and less than half the"
            f" sampling rate of {rate:.6g} Hz"
        )
    fewest = 3 * (order + 1)
    if samples < fewest:
        raise ValueError(
            f"{samples} samples; expected {fewest} or more for a filter of order {order}"
        )


class _LowPass(NamedTuple):
    """A filter of blocks of samples, its state a vector that goes from block to block.

    - `steady`: the state that a constant signal of one leaves as it is.
    - `response`: what samples of a block do to its output; `of_state`: what the state does.
    - `gathered`: what samples of a block do to the state behind it; `kept`: what the state does.
    """

    steady: Float[np.ndarray, " states"]
    response: Float[np.ndarray, "block block"]
    of_state: Float[np.ndarray, "block states"]
    gathered: Float[np.ndarray, "states block"]
    kept: Float[np.ndarray, "states states"]

    def run(self, signal: Float[np.ndarray, "samples columns"]) -> np.ndarray:
        """Filter a signal, as if it had been constant before its first sample."""
        samples, columns = signal.shape
        blocks = -(-samples // _BLOCK)
        filled = np.zeros((blocks * _BLOCK, columns))
        filled[:samples] = signal
        together = filled.reshape(blocks, _BLOCK, columns)
        gathered = self.gathered @ together
        states = np.empty((blocks, len(self.steady), columns))
        state = self.steady[:, None] * signal[0]
        for block in range(blocks):
            states[block] = state
            state = self.kept @ state + gathered[block]
        output = self.response @ together
        output += self.of_state @ states
        return output.reshape(-1, columns)[:samples]


@lru_cache(maxsize=256)  # selection designs the same few filters for every candidate and fold
def _butterworth(order: int, cutoff: float) -> _LowPass:
    """Design a Butterworth low pass by the bilinear transformation (Oppenheim and Schafer, 7.1).

    - `cutoff`: as a part of the sampling rate.
    """
    a, b, c, d = np.zeros((0, 0)), np.zeros(0), np.zeros(0), 1.0
    # Analogue poles on the unit circle: conjugate pairs, and the real one of an odd order.
    angles = np.pi * (np.arange(order // 2) * 2 + 1) / (2 * order)
    pairs = [np.array([1j, -1j]) * np.exp(np.array([1j, -1j]) * angle) for angle in angles]
    for poles in [*pairs, np.array([-1.0])] if order % 2 else pairs:
        # Warped so that the cut-off stays where it is; then s = (z - 1) / (z + 1).
        warped = np.tan(np.pi * cutoff) * poles
        denominator = np.real(np.poly((1 + warped) / (1 - warped)))
        # The denominator at z = 1 as a product: its sum would lose half of its digits.
        at_rest = np.real(np.prod(-2 * warped / (1 - warped)))
        numerator = np.poly(-np.ones(len(poles))) * (at_rest / 2 ** len(poles))
        a, b, c, d = _followed_by(a, b, c, d, numerator, denominator)
    # Powers of `a`, from states and from an impulse.
    impulse, powers = [b], [np.eye(order)]
    for _ in range(_BLOCK):
        impulse.append(a @ impulse[-1])
        powers.append(a @ powers[-1])
    response = np.array([d, *(c @ state for state in impulse[: _BLOCK - 1])])
    lag = np.arange(_BLOCK)[:, None] - np.arange(_BLOCK)
    return _LowPass(
        steady=np.linalg.solve(np.eye(order) - a, b),
        response=np.where(lag >= 0, response[np.maximum(lag, 0)], 0.0),
        of_state=np.stack([c @ power for power in powers[:_BLOCK]]),
        gathered=np.stack(impulse[_BLOCK - 1 :: -1][:_BLOCK], axis=1),
        kept=powers[_BLOCK],
    )


def _followed_by(
    a: np.ndarray,
    b: np.ndarray,
    c: np.ndarray,
    d: float,
    numerator: np.ndarray,
    denominator: np.ndarray,
) -> tuple[np.ndarray, np.ndarray, np.ndarray, float]:
    """Put a section in transposed direct form behind the system x' = a x + b u, y = c x + d u."""
    size, new = len(b), len(denominator) - 1
    shift = np.eye(new, k=1)
    shift[:, 0] -= denominator[1:]
    enters = numerator[1:] - denominator[1:] * numerator[0]
    whole = np.zeros((size + new, size + new))
    whole[:size, :size], whole[size:, size:] = a, shift
    whole[size:, :size] = np.outer(enters, c)
    ends = np.concatenate([numerator[0] * c, np.eye(new)[0]])
    return whole, np.concatenate([b, enters * d]), ends, float(numerator[0] * d)


def decimated_low_pass(
    rows: Float[np.ndarray, "columns samples"],
    kept: Int[np.ndarray, " kept"],
    interval: float,
    *,
    cutoff: float,
) -> Float[np.ndarray, "columns kept"]:
    """Compute the values of `zero_phase` at some samples only, by matrix products.

    Decimation keeps one of some ten to hundred samples, and a filter that runs over the record
    computes all of them, twice. Its impulse response is symmetric and fades: each sample that is
    kept is a weighted sum of those around it.

    Signals go on by their reflection in their end points for as long as the filter remembers, as in
    `zero_phase`, and are constant beyond.

    **Arguments**

    - `rows`: signals, samples last.
    - `kept`: the samples to compute, in ascending order.
    - `interval`, `cutoff`: as of `zero_phase`, with its errors.

    **Returns** the filtered signals at these samples.

    >>> import numpy as np
    >>> from jaxcslc.recordings import zero_phase
    >>> signal, kept = np.random.default_rng(0).normal(size=(2, 2000)), np.arange(5, 2000, 20)
    >>> filtered = decimated_low_pass(signal, kept, 0.005, cutoff=5.0)
    >>> bool(np.allclose(filtered, zero_phase(signal.T, 0.005, cutoff=5.0).T[:, kept], atol=1e-5))
    True
    """
    _check(rows.shape[1], interval, cutoff, _ORDER)
    if not kept.size:
        return np.zeros((len(rows), 0))
    if _REMEMBERED_PERIODS / (cutoff * interval) > rows.shape[1]:
        # The impulse response would be longer than the record.
        return zero_phase(np.asarray(rows, float).T, interval, cutoff=cutoff).T[:, kept]
    weights = _impulse_response(cutoff * interval)
    reach = len(weights) // 2
    reflected = min(reach, rows.shape[1] - 1)
    extended = _reflected(np.asarray(rows, float), reflected)
    extended = np.pad(extended, ((0, 0), (reach - reflected,) * 2), mode="edge")
    step = int(np.gcd.reduce(np.diff(kept))) or 1
    count = (int(kept[-1]) - int(kept[0])) // step + 1
    # Row i of the product is the impulse response, `i * step` samples later.
    together = min(_TOGETHER, count)
    window = len(weights) + (together - 1) * step
    shifted = np.zeros((window, together))
    for i in range(together):
        shifted[i * step : i * step + len(weights), i] = weights
    result = np.empty((len(rows), count))
    # The window of a sample of the signal begins at the sample of this number of the extended one.
    for first in range(0, count, together):
        start = int(kept[0]) + first * step
        part = extended[:, start : start + window]
        result[:, first : first + together] = (part @ shifted[: part.shape[1]])[:, : count - first]
    return result if len(kept) == count else result[:, (kept - kept[0]) // step]


def _reflected(
    rows: Float[np.ndarray, "columns samples"], reach: int
) -> Float[np.ndarray, "columns longer"]:
    """Extend signals at both ends by their reflection in the end points."""
    return np.pad(rows, ((0, 0), (reach, reach)), mode="reflect", reflect_type="odd")


@lru_cache(maxsize=64)
def _impulse_response(cutoff: float) -> Float[np.ndarray, " lags"]:
    """Compute the impulse response of both passes, as far as the filter remembers, with sum 1.

    - `cutoff`: as a part of the sampling rate.
    """
    reach = max(int(np.ceil(_REMEMBERED_PERIODS / cutoff)), 3 * (_ORDER + 1))
    impulse = np.zeros(4 * reach + 1)
    impulse[2 * reach] = 1.0
    response = zero_phase(impulse, 1.0, cutoff=cutoff)[reach : 3 * reach + 1]
    response /= response.sum()
    response.setflags(write=False)
    return response


class FilteredEquations(NamedTuple):
    """Equations `regressor @ k = torque` of one joint, low-pass filtered on both sides, decimated.

    **Attributes**

    - `regressor`: shape `(equations, coefficients)`.
    - `torque`: shape `(equations,)` [N m or N].
    - `sample`: at which sample its filter is centred, shape `(equations,)`.
    """

    regressor: Float[np.ndarray, "equations coefficients"]
    torque: Float[np.ndarray, " equations"]
    sample: Int[np.ndarray, " equations"]


def decimation_for(cutoff: float, interval: float) -> int:
    """Return the decimation factor that suits a low-pass filter.

    Below its cut-off a record holds two independent values a period, and the residuals of
    samples `1 / (2 cutoff)` apart are as good as uncorrelated. Keeping more would gain nothing
    and make standard errors look smaller than they are. Aliasing does no harm: both sides of an
    equation alias alike, and it stays true.

    **Arguments**

    - `cutoff`: of the filter [Hz].
    - `interval`: between samples [s].

    **Returns** the whole number of samples nearest below `1 / (2 cutoff)`, and at least 1.

    >>> from jaxcslc.recordings import decimation_for
    >>> decimation_for(cutoff=15.0, interval=0.002)
    16
    """
    return max(1, int(np.floor(0.5 / (cutoff * interval) + 1e-9)))


def samples_kept(samples: int, cutoff: float, interval: float) -> Int[np.ndarray, " kept"]:
    """Return the samples that `decimation_for` keeps, both ends of a record treated alike."""
    decimation = decimation_for(cutoff, interval)
    return np.arange((samples - 1) % decimation // 2, samples, decimation)


# An equation is dropped of which less than this part of the filter lies on samples that count. The
# choice looks at the mask alone, never at the data.
_LEAST_WEIGHT = 0.05


def parallel_filter(
    columns: Float[np.ndarray, "coefficients samples"],
    torque: Float[np.ndarray, " samples"],
    mask: Bool[np.ndarray, " samples"],
    *,
    interval: float,
    cutoff: float,
    kept: Int[np.ndarray, " kept"] | None = None,
) -> FilteredEquations:
    """Filter every column of a joint's regressor and its torque alike, and decimate.

    The equation of a joint is linear in the coefficients at every instant, so any linear filter
    over time of all its terms makes another true equation. A low pass takes the noise above the
    motion out of both sides without the distortion that filtering one of them would bring
    (the 'parallel filtering' of Gautier, ICRA 1997, doi:10.1109/ROBOT.1997.606768).

    Samples that do not count are set to zero on both sides before: 0 = 0 is as true an equation,
    and what is left of the neighbours stays theirs.

    **Arguments**

    - `columns`: of the regressor, shape `(coefficients, samples)`.
    - `torque`: shape `(samples,)` [N m or N].
    - `mask`: which samples count, shape `(samples,)`.
    - `interval`: between the samples, uniform [s].
    - `cutoff`: of the filter [Hz]. A little above the fastest motion; below the pass band of
        the smoothing that gave the accelerations, or it has nothing left to do.
    - `kept`: the samples to keep; by default those of `decimation_for(cutoff, interval)`.

    **Returns** the equations that are left. There are none where nothing counts.

    **Raises** `ValueError`: a cut-off that the sampling rate does not allow.

    >>> import numpy as np
    >>> from jaxcslc.recordings import parallel_filter
    >>> time = np.arange(500) * 0.01
    >>> columns = np.stack([np.sin(time), np.cos(3 * time)])
    >>> torque, mask = np.array([2.0, -1.0]) @ columns, np.abs(np.sin(time)) > 0.1
    >>> equations = parallel_filter(columns, torque, mask, interval=0.01, cutoff=5.0)
    >>> np.linalg.lstsq(equations.regressor, equations.torque)[0].round(9).tolist()
    [2.0, -1.0]
    """
    if kept is None:
        kept = samples_kept(len(torque), cutoff, interval)
    # Torque and mask are filtered like columns of the regressor.
    sides = np.where(mask, np.vstack([columns, torque, mask]), 0.0)
    # Empty columns, of coefficients that have no part in this joint, are not worth a filter.
    present = np.any(sides, axis=1)
    filtered = np.zeros((len(sides), kept.size))
    filtered[present] = decimated_low_pass(sides[present], kept, interval, cutoff=cutoff)
    enough = filtered[-1] >= _LEAST_WEIGHT
    return FilteredEquations(filtered[:-2, enough].T, filtered[-2, enough], kept[enough])
