import math
from collections.abc import Iterator, Mapping
from typing import TYPE_CHECKING

import numpy as np
from jaxtyping import Float

from ._recording import SystemRecording


if TYPE_CHECKING:
    from ._system import System


# Of the divided differences that noise is seen in: motion of a period of 20 samples is a thousandth
# of its amplitude in them, 15 of them an interval of 7 samples.
_ORDER = 6
# Median modulus of a normal distribution of unit deviation.
_MEDIAN = 0.6744897501960817


def measurement_noise(system: "System", recording: SystemRecording) -> dict[str, float]:
    """Standard deviation of the white noise in each column of a recording.

    From divided differences of sixth order, scaled so that white noise keeps its variance: a
    polynomial of fifth order, and so next to all motion that is sampled well, is not in them. The
    median of their modulus is taken, which steps of an input and other rare events do not raise; or
    their root mean square where more than half are zero, as of an encoder at rest.

    **Arguments**

    - `system`: whose columns are meant.
    - `recording`: of these columns.

    **Returns** by name of the column, in its unit; 0 for recordings of seven samples or fewer.

    **Raises** `RecordingError` for a column that is missing.

    >>> import numpy as np, sympy
    >>> from sympy.physics.mechanics import dynamicsymbols
    >>> from jaxcslc.systems import Constant, System, SystemRecording, Variable, measurement_noise
    >>> level, inflow = dynamicsymbols("level inflow")
    >>> area = sympy.Symbol("area")
    >>> equations = {"volume": sympy.Eq(inflow, area * level.diff())}
    >>> tank = System("tank", equations, (Variable(level), Variable(inflow)), (Constant(area),))
    >>> time = np.arange(4000) * 0.1
    >>> noise = 0.01 * np.random.default_rng(0).normal(size=4000)
    >>> recording = SystemRecording(time, {"level": np.sin(time) + noise, "inflow": np.cos(time)})
    >>> {name: round(float(value), 3) for name, value in measurement_noise(tank, recording).items()}
    {'level': 0.01, 'inflow': 0.0}
    """
    weights = _difference_weights(recording.time)
    return {name: _deviation(weights, recording.column(name)) for name in system.column_names}


def with_simulated_noise(
    recording: SystemRecording, noise: Mapping[str, float], draws: int, seed: int
) -> Iterator[SystemRecording]:
    """The recording with further white noise on its columns, another in each draw.

    - `noise`: standard deviations, by column.
    """
    generator = np.random.default_rng(seed)
    for _ in range(draws):
        yield SystemRecording(
            recording.time,
            {
                name: values + noise[name] * generator.normal(size=recording.samples)
                if noise.get(name)
                else values
                for name, values in recording.columns.items()
            },
        )


def check_noise(system: "System", noise: Mapping[str, float]) -> None:
    """**Raises** `ValueError` for noise of no column, and for values that are no deviations."""
    for name, value in noise.items():
        if name not in system.column_names:
            raise ValueError(
                f"noise: no column {name!r}; expected some of {', '.join(system.column_names)}"
            )
        if not 0.0 <= value < math.inf:
            raise ValueError(f"noise: {name} is {value}; expected 0 or more")


def _difference_weights(
    time: Float[np.ndarray, " samples"],
) -> Float[np.ndarray, "differences points"]:
    """What the samples of each difference are multiplied by, rows of unit length."""
    if len(time) <= _ORDER:
        return np.zeros((0, _ORDER + 1))
    points = np.lib.stride_tricks.sliding_window_view(time, _ORDER + 1)
    apart = (points[:, :, None] - points[:, None, :]) / np.median(np.diff(time))
    weights = 1.0 / np.prod(np.where(np.eye(_ORDER + 1, dtype=bool), 1.0, apart), axis=2)
    return weights / np.linalg.norm(weights, axis=1, keepdims=True)


def _deviation(
    weights: Float[np.ndarray, "differences points"], values: Float[np.ndarray, " samples"]
) -> float:
    if not len(weights):
        return 0.0
    points = np.lib.stride_tricks.sliding_window_view(values, _ORDER + 1)
    differences = np.sum(weights * points, axis=1)
    typical = float(np.median(np.abs(differences))) / _MEDIAN
    return typical or float(np.sqrt(np.mean(differences**2)))
