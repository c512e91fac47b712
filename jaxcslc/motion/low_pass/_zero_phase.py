from functools import lru_cache
from typing import NamedTuple

import numpy as np
from jaxtyping import Float


# After so many periods of its cut-off, less than 1e-5 is left of what a filter of fourth order
# has seen: its slowest poles fade by exp(-0.38 · 2π) in each.
_MEMORY = 5.0
# Samples that are filtered by one product.
_BLOCK = 64


def zero_phase(
    signal: Float[np.ndarray, " samples *columns"],
    interval: float,
    *,
    cutoff: float,
    order: int = 4,
) -> Float[np.ndarray, " samples *columns"]:
    """Runs a Butterworth low-pass filter over a signal forwards and backwards.

    What `scipy.signal.sosfiltfilt` computes with the sections of `scipy.signal.butter`, whose
    import alone takes twice as long as the choice of settings for a short recording.

    **Arguments**

    - `signal`: sampled along its first axis, shape `(samples, ...)`.
    - `interval`: between samples [s].
    - `cutoff`: where the two passes together leave half of the amplitude [Hz].
    - `order`: of one pass.

    **Returns**

    The filtered signal, of the same shape. A linear function of the signal.

    **Raises**

    - `ValueError`: a cut-off that is not between 0 and half the sampling rate, or fewer samples
        than the filter needs to start from.

    >>> import numpy as np
    >>> from jaxcslc.motion import zero_phase
    >>> bool(np.allclose(zero_phase(np.ones((100, 2)), 0.01, cutoff=5.0), 1.0))
    True
    """
    check_low_pass(signal.shape[0], interval, cutoff, order)
    if not signal.size:
        return np.zeros(signal.shape)
    low_pass = _butterworth(order, cutoff * interval)
    x = np.asarray(signal, float).reshape(signal.shape[0], -1)
    # The record goes on by its own reflection in its end points for as long as the filter
    # remembers: scipy's default is a few samples, of which a slow filter leaves transients.
    padding = min(int(np.ceil(_MEMORY / (cutoff * interval))), signal.shape[0] - 1)
    before, after = 2 * x[0] - x[padding:0:-1], 2 * x[-1] - x[-2 : -(padding + 2) : -1]
    forwards = low_pass.run(np.concatenate([before, x, after]))
    both = low_pass.run(forwards[::-1])[::-1]
    return both[padding : padding + len(x)].reshape(signal.shape)


def check_low_pass(samples: int, interval: float, cutoff: float, order: int) -> None:
    """**Raises** `ValueError` for a cut-off that is not between 0 and half the sampling rate, and
    for fewer samples than the filter needs to start from."""
    if not 0.0 < cutoff < 0.5 / interval:
        raise ValueError(
            f"cut-off is {cutoff} Hz; expected more than 0 and less than half the sampling rate "
            f"of {1.0 / interval:.6g} Hz"
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
        """The signal filtered, as if it had been constant before its first sample."""
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
    """A Butterworth low pass by the bilinear transformation (Oppenheim and Schafer, 7.1).

    - `cutoff`: as a part of the sampling rate.
    """
    a, b, c, d = np.zeros((0, 0)), np.zeros(0), np.zeros(0), 1.0
    for poles in _analogue_poles(order):
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


def _analogue_poles(order: int) -> list[np.ndarray]:
    """On the unit circle, a conjugate pair or the real one each."""
    angles = np.pi * (np.arange(order // 2) * 2 + 1) / (2 * order)
    pairs = [np.array([1j, -1j]) * np.exp(np.array([1j, -1j]) * angle) for angle in angles]
    return [*pairs, np.array([-1.0])] if order % 2 else pairs


def _followed_by(
    a: np.ndarray,
    b: np.ndarray,
    c: np.ndarray,
    d: float,
    numerator: np.ndarray,
    denominator: np.ndarray,
) -> tuple[np.ndarray, np.ndarray, np.ndarray, float]:
    """x' = a x + b u, y = c x + d u with a section in transposed direct form behind."""
    size, new = len(b), len(denominator) - 1
    shift = np.eye(new, k=1)
    shift[:, 0] -= denominator[1:]
    enters = numerator[1:] - denominator[1:] * numerator[0]
    whole = np.zeros((size + new, size + new))
    whole[:size, :size], whole[size:, size:] = a, shift
    whole[size:, :size] = np.outer(enters, c)
    ends = np.concatenate([numerator[0] * c, np.eye(new)[0]])
    return whole, np.concatenate([b, enters * d]), ends, float(numerator[0] * d)
