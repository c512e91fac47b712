"""Lorenz's oscillator: chaotic, so that a simulation leaves any recording after a while."""

from collections.abc import Sequence
from pathlib import Path

import numpy as np

import jaxcslc as jc
from jaxcslc.systems import load_system
from scripts.studies.systems.example import Example
from scripts.studies.systems.signals import Columns, generator, integrate


SIGMA, RHO, BETA = 10.0, 28.0, 8.0 / 3.0
_INTERVAL = 0.005
_TRANSIENT = 10.0  # left out: the way to the attractor


def simulate(seeds: Sequence[int], validation: bool) -> list[Columns]:
    """Simulate from random points near the attractor, without input."""
    stream = "validation start" if validation else "training start"
    start = np.array([generator(seed, stream).uniform(5.0, 15.0, 3) for seed in seeds]).T
    time = np.arange(0.0, 15.0 if validation else 30.0, _INTERVAL)

    def derivative(t: float, state: np.ndarray) -> np.ndarray:
        del t
        x, y, z = state
        return np.stack([SIGMA * (y - x), x * (RHO - z) - y, x * y - BETA * z])

    begin = integrate(derivative, start, np.array([0.0, _TRANSIENT]))[-1]
    state = integrate(derivative, begin, time)
    return [
        {"time": time, "x": state[:, 0, i], "y": state[:, 1, i], "z": state[:, 2, i]}
        for i in range(len(seeds))
    ]


LORENZ = Example(
    name="lorenz",
    source="TOML; SciPy",
    description=lambda: load_system(Path(__file__).with_name("lorenz.toml")),
    truth={"sigma": SIGMA, "rho": RHO, "beta": BETA},
    simulate=simulate,
    noise={"x": 0.02, "y": 0.02, "z": 0.02},
    settings=jc.Settings(jc.Preparation(jc.SavitzkyGolay(21, 5)), jc.LeastSquares()),
)
