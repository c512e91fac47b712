"""Excitation, measurement noise, and integration of many recordings side by side."""

import dataclasses
from collections.abc import Callable, Mapping, Sequence

import numpy as np
from jaxtyping import Float


Columns = dict[str, Float[np.ndarray, " samples"]]
"""A recording by the names of its columns, `time` among them."""

# Of the integrator: far below every measurement noise, so that its result counts as the truth.
_RELATIVE = 1e-10
_ABSOLUTE = 1e-12


def generator(seed: int, stream: str) -> np.random.Generator:
    """Random numbers of one purpose in one recording: streams do not depend on each other."""
    return np.random.default_rng([seed, *stream.encode()])


@dataclasses.dataclass(frozen=True)
class Multisine:
    """Sums of sines, one sum a recording.

    **Attributes**

    - `frequency`: (lines,) [Hz].
    - `amplitude`, `phase`: (recordings, lines).
    - `mean`: added to all.
    """

    frequency: Float[np.ndarray, " lines"]
    amplitude: Float[np.ndarray, "recordings lines"]
    phase: Float[np.ndarray, "recordings lines"]
    mean: float = 0.0

    @classmethod
    def random(
        cls,
        seeds: Sequence[int],
        stream: str,
        band: tuple[float, float],
        rms: float,
        *,
        lines: int = 8,
        mean: float = 0.0,
    ) -> "Multisine":
        """Return a signal of random phases; logarithmic steps from the lowest to the highest
        frequency [Hz].
        """
        frequency = np.geomspace(*band, lines)
        phase = [generator(seed, stream).uniform(0.0, 2.0 * np.pi, lines) for seed in seeds]
        amplitude = np.full((len(seeds), lines), rms * np.sqrt(2.0 / lines))
        return cls(frequency, amplitude, np.array(phase), mean)

    def __call__(self, t: float) -> Float[np.ndarray, " recordings"]:
        """The values of all recordings at a time [s]."""
        angle = 2.0 * np.pi * self.frequency * t + self.phase
        return self.mean + np.sum(self.amplitude * np.sin(angle), axis=1)

    def sampled(self, time: Float[np.ndarray, " samples"]) -> Float[np.ndarray, "samples _"]:
        """The values of all recordings at all times."""
        return np.stack([self(t) for t in time])


def integrate(
    derivative: Callable[[float, np.ndarray], np.ndarray],
    start: Float[np.ndarray, "states recordings"],
    time: Float[np.ndarray, " samples"],
) -> Float[np.ndarray, "samples states recordings"]:
    """Solves the same differential equation for many recordings by SciPy's DOP853.

    **Arguments**

    - `derivative`: of the states, (states, recordings), at a time and these states.
    - `start`: states at the first of the times.

    **Raises**

    - `RuntimeError`: the integrator gave up.
    """
    from scipy.integrate import solve_ivp

    shape = start.shape
    solution = solve_ivp(
        lambda t, y: derivative(t, y.reshape(shape)).ravel(),
        (time[0], time[-1]),
        start.ravel(),
        method="DOP853",
        t_eval=time,
        rtol=_RELATIVE,
        atol=_ABSOLUTE,
    )
    if not solution.success:
        raise RuntimeError(f"the integrator of the truth failed: {solution.message}")
    return np.moveaxis(solution.y, -1, 0).reshape(len(time), *shape)


def with_noise(columns: Columns, deviation: Mapping[str, float], seed: int) -> Columns:
    """A recording with white noise on its columns, of the same deviation in every sample."""
    return {
        name: values + deviation.get(name, 0.0) * generator(seed, name).normal(size=len(values))
        if deviation.get(name)
        else values
        for name, values in columns.items()
    }
