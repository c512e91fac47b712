"""Fixtures shared by the tests.

What is slow to make and never changed by a test (a derived network, a simulated recording) belongs
here as a fixture of session scope, so that each worker makes it once. Import the packages inside
the fixture, not at the top: collecting tests then stays quick.
"""

import json
import zlib
from collections.abc import Callable
from pathlib import Path
from typing import TYPE_CHECKING, Any

import numpy as np
import pytest


if TYPE_CHECKING:
    import jax

    from jaxcslc import CSLC
    from jaxcslc.manipulator import LinkParameters
    from scripts.tools.invoke import Result


def pytest_runtest_setup(item: pytest.Item) -> None:
    if item.get_closest_marker("gpu") is None:
        return
    from jaxcslc.codegen import kernels_run

    if not kernels_run():
        pytest.skip("gpu: there is no NVIDIA GPU with matrix units for float64")


def run(*arguments: str | Path) -> "Result":
    """Runs the command `jaxcslc` with these arguments."""
    from scripts.tools.invoke import invoke

    return invoke(*arguments)


@pytest.fixture
def rng(request: pytest.FixtureRequest) -> np.random.Generator:
    """Random numbers that are the test's own: the same in every run and in any order of tests."""
    return np.random.default_rng(zlib.crc32(request.node.nodeid.encode()))


@pytest.fixture(scope="session")
def appendix_b() -> dict[str, Any]:
    """Appendix B of the thesis as data; indices are from one, as printed."""
    path = Path(__file__).parent / "data" / "appendix_b.json"
    return json.loads(path.read_text(encoding="utf-8"))


@pytest.fixture(scope="session")
def random_links() -> "Callable[..., tuple[LinkParameters, ...]]":
    """Draws links that can exist: each is eight point masses, and a motor.

    A tensor that is drawn entry by entry would break the inequalities that every rigid body
    obeys. `principal` drops the off-diagonal elements at the centre of gravity, which leaves a
    possible body.
    """

    def draw(
        rng: np.random.Generator, joints: int, *, motors: bool = True, principal: bool = False
    ) -> "tuple[LinkParameters, ...]":
        from jaxcslc.manipulator import LinkParameters

        links: list[LinkParameters] = []
        for _ in range(joints):
            masses = rng.uniform(0.1, 1.0, 8)
            points = rng.uniform(-0.3, 0.3, (8, 3))
            centre = masses @ points / np.sum(masses)
            arms = points - centre
            second = (masses[:, None] * arms).T @ arms
            tensor = np.trace(second) * np.eye(3) - second
            tensor = np.diag(np.diag(tensor)) if principal else (tensor + tensor.T) / 2
            motor = float(rng.uniform(0.05, 0.5)) if motors else 0.0
            links.append(LinkParameters(float(np.sum(masses)), centre, tensor, motor))
        return tuple(links)

    return draw


@pytest.fixture(scope="session")
def exciting_motion() -> tuple[np.ndarray, np.ndarray, np.ndarray]:
    """3,000 random states of six joints: every coefficient shows in them."""
    rng = np.random.default_rng(7)
    q, qd, qdd = rng.uniform(-2.0, 2.0, (3, 3000, 6))
    return q, qd, qdd


@pytest.fixture(scope="session")
def puma() -> "CSLC":
    """The PUMA 560's network with the thesis's 43 coefficients."""
    import jaxcslc as jc

    return jc.derive(jc.puma560())


@pytest.fixture(scope="session")
def puma_k(puma: "CSLC") -> "jax.Array":
    """Armstrong's coefficients with Leahy and Saridis's friction, (43,)."""
    robot = puma.robot
    assert robot.links is not None
    return puma.coefficients_from(robot.links, viscous=robot.viscous, dry=robot.dry)
