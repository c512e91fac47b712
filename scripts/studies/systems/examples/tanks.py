"""Two coupled tanks: a pump fills the first, which drains into the second (not mechanical).

The flow through an orifice is proportional to the root of the head (Torricelli). With the exponent
as an unknown constant, the equations are not linear in all constants; see `FREE_EXPONENT`.
"""

import dataclasses
from collections.abc import Sequence
from pathlib import Path

import numpy as np

import jaxcslc as jc
from jaxcslc.systems import load_system
from scripts.studies.systems.example import Example
from scripts.studies.systems.signals import Columns, Multisine, generator, integrate


AREAS = (0.0154, 0.0162)  # [m²]
CONNECTION, OUTLET = 2.3e-4, 2.0e-4  # flow per root of head [m^2.5/s]
EXPONENT = 0.5
_INTERVAL = 1.0  # [s]
_MEAN_FLOW = 9e-5  # [m³/s]


def simulate(seeds: Sequence[int], validation: bool) -> list[Columns]:
    """Volumes are integrated, and levels are read off them."""
    stream = "validation flow" if validation else "training flow"
    time = np.arange(0.0, 400.0 if validation else 2400.0, _INTERVAL)
    pump = Multisine.random(seeds, stream, (1 / 300, 1 / 50), 0.22 * _MEAN_FLOW, mean=_MEAN_FLOW)
    level = np.array([generator(seed, stream + " level").uniform(0.9, 1.2) for seed in seeds])
    area = np.array(AREAS)[:, None]

    def derivative(t: float, volume: np.ndarray) -> np.ndarray:
        first, second = volume / area
        through = CONNECTION * np.sign(first - second) * np.abs(first - second) ** EXPONENT
        return np.stack([pump(t) - through, through - OUTLET * second**EXPONENT])

    volume = integrate(derivative, area * np.array([[0.36], [0.2]]) * level, time)
    head, flow = volume / area, pump.sampled(time)
    return [
        {"time": time, "h1": head[:, 0, i], "h2": head[:, 1, i], "u": flow[:, i]}
        for i in range(len(seeds))
    ]


COUPLED_TANKS = Example(
    name="tanks",
    source="TOML; volumes by SciPy",
    description=lambda: load_system(Path(__file__).with_name("tanks.toml")),
    truth={"A1": AREAS[0], "A2": AREAS[1], "c12": CONNECTION, "c2": OUTLET},
    simulate=simulate,
    noise={"h1": 3e-4, "h2": 3e-4, "u": 3e-6},
    settings=jc.Settings(jc.Preparation(jc.SavitzkyGolay(41, 5)), jc.LeastSquares(cutoff=0.04)),
)

FREE_EXPONENT = dataclasses.replace(
    COUPLED_TANKS,
    name="tanks, free exponent",
    description=lambda: load_system(Path(__file__).with_name("tanks_free_exponent.toml")),
    truth={**COUPLED_TANKS.truth, "n": EXPONENT},
)
