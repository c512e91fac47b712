"""Systems and recordings that several tests share."""

from typing import TYPE_CHECKING

import numpy as np
import pytest


if TYPE_CHECKING:
    from jaxcslc.systems import System, SystemRecording


CART = """
name = "cart"
[variables]
x = { unit = "m" }
force = { unit = "N" }
[constants]
mass = { unit = "kg", sign = "positive" }
damping = { unit = "N s/m" }
dry = { unit = "N" }
[equations]
rail = "force = mass*ddot(x) + damping*dot(x) + dry*sign(dot(x))"
[units]
rail = "N"
"""
TRUE_CART = {"mass": 2.0, "damping": 0.5, "dry": 0.3}
SAMPLES, INTERVAL = 600, 0.01


def cart_motion(phase: float) -> "SystemRecording":
    """A cart that is pushed so that it moves on a sum of sines, known in closed form."""
    from jaxcslc.systems import SystemRecording

    time = np.arange(SAMPLES) * INTERVAL
    x, xd, xdd = np.zeros((3, SAMPLES))
    for size, speed in ((0.5, 2.0), (0.2, 5.0)):
        angle = speed * time + phase
        x += size * np.sin(angle)
        xd += size * speed * np.cos(angle)
        xdd -= size * speed**2 * np.sin(angle)
    force = TRUE_CART["mass"] * xdd + TRUE_CART["damping"] * xd + TRUE_CART["dry"] * np.sign(xd)
    return SystemRecording(time, {"x": x, "force": force})


@pytest.fixture(scope="session")
def cart(tmp_path_factory: pytest.TempPathFactory) -> "System":
    """A cart with viscous and dry friction, from its file."""
    from jaxcslc.systems import load_system

    path = tmp_path_factory.mktemp("systems") / "cart.toml"
    path.write_text(CART, encoding="utf-8")
    return load_system(path)
