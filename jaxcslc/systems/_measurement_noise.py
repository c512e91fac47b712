"""White measurement noise of a recording's columns: its level, and simulated draws."""

import math
from collections.abc import Iterator, Mapping
from typing import TYPE_CHECKING

import numpy as np

from ..recordings import sixth_differences
from ._recording import SystemRecording


if TYPE_CHECKING:
    from ._system import System


# The relative standard error of the noise of a column is this over the root of its samples: 0.034
# to 0.036 of 2,400 and 0.020 to 0.023 of 6,000 white samples. (A mean square would have 1.26, but
# is spoilt by events that are rare among the differences.)
_LEVEL_ERROR = 1.76


def measurement_noise(system: "System", recording: SystemRecording) -> dict[str, float]:
    """Standard deviation of the white noise in each column of a recording.

    From `jaxcslc.recordings.sixth_differences`: the median of their modulus, which steps of an
    input and other rare events do not raise; or their root mean square where more than half are
    zero, as of an encoder at rest. (`jaxcslc.recordings.noise_level` takes values on a grid for
    readings of an encoder, which here may be an input of a few levels.)

    **Arguments**

    - `system`: whose columns are meant.
    - `recording`: of these columns.

    **Returns** by name of the column, in its unit; 0 for recordings of six samples or fewer.

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
    columns = np.stack([recording.column(name) for name in system.column_names], axis=1)
    differences = sixth_differences(columns, recording.time)
    if not len(differences):
        return dict.fromkeys(system.column_names, 0.0)
    # 0.6745 is the median modulus of a normal variable of unit deviation.
    typical = np.median(np.abs(differences), axis=0) / 0.6745
    levels = np.where(typical > 0.0, typical, np.sqrt(np.mean(differences**2, axis=0)))
    return dict(zip(system.column_names, levels.tolist(), strict=True))


def level_error(samples: int) -> float:
    """Relative standard error of `measurement_noise` for white noise."""
    return _LEVEL_ERROR / math.sqrt(samples)


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
