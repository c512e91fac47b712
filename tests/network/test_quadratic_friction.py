"""Quadratic friction, qd |qd|, against NumPy: in a robot file, torque, a fit and C code."""

import ctypes
import shutil
import subprocess
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from numpy.testing import assert_allclose

import jaxcslc as jc


ROBOT = """
name = "two joints"
gravity = [0, 0, -9.81]
friction = ["viscous", "dry", "quadratic"]

[[joint]]
d = 0.4
[[joint]]
alpha = "pi/2"
friction = ["viscous", "dry"]
[[joint]]
a = 0.4
"""
KQ = np.array([0.7, 0.0, -0.2])  # joint 2 has none


@pytest.fixture(scope="module")
def network(tmp_path_factory: pytest.TempPathFactory) -> jc.CSLC:
    path = tmp_path_factory.mktemp("robot") / "arm.toml"
    path.write_text(ROBOT)
    return jc.derive(jc.load_robot(path), lengths="numeric")


@pytest.fixture
def motion(rng: np.random.Generator) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
    q, qd, qdd = rng.uniform(-2, 2, (3, 200, 3))
    qd[0] = 0.0
    return q, qd, qdd


def coefficients(network: jc.CSLC, *, quadratic: np.ndarray = KQ) -> np.ndarray:
    links = [jc.LinkParameters(2.0, np.array([0.1, 0.05, 0.2]), 0.05 * np.eye(3), 0.1)] * 3
    friction: Any = {"viscous": [1.0, 0.8, 0.5], "dry": [2.0, 1.5, 0.3], "quadratic": quadratic}
    return np.asarray(network.coefficients_from(links, **friction))


def test_names_and_units(network: jc.CSLC) -> None:
    (kq1, kq3) = (network.coefficients[i] for i in network.layout.indices("quadratic"))
    assert (kq1.name, kq3.name) == ("kq1", "kq3")
    assert kq1.unit == "N m (s/rad)^2" and not kq1.positive
    assert kq1.expression == "friction of joint 1 with the square of its speed"


def test_torque_is_the_formula(
    network: jc.CSLC, motion: tuple[np.ndarray, np.ndarray, np.ndarray]
) -> None:
    with_it, without = (coefficients(network, quadratic=kq) for kq in (KQ, 0 * KQ))
    added = np.asarray(network.torque(with_it, *motion)) - network.torque(without, *motion)
    qd = motion[1]
    assert_allclose(added, KQ * np.square(qd) * np.where(qd < 0, -1.0, 1.0), atol=1e-12)


def test_a_fit_finds_it(
    network: jc.CSLC, motion: tuple[np.ndarray, np.ndarray, np.ndarray]
) -> None:
    k = coefficients(network)
    pairs = np.ones(motion[0].shape, bool)
    torque = np.asarray(network.torque(k, *motion))
    patterns = jc.Patterns(np.arange(200) * 0.01, *motion, torque, pairs, pairs)
    fit = jc.LeastSquares().fit(network, patterns)
    assert_allclose(fit.k, k, atol=1e-9)
    assert np.all(np.asarray(fit.determined))


@pytest.mark.skipif(shutil.which("cc") is None, reason="no C compiler")
def test_c_code_computes_it(
    network: jc.CSLC, motion: tuple[np.ndarray, np.ndarray, np.ndarray], tmp_path: Path
) -> None:
    k = coefficients(network)
    (tmp_path / "arm.c").write_text(jc.c_code(network, k, name="arm").source)
    (tmp_path / "arm.h").write_text(jc.c_code(network, k, name="arm").header)
    library = tmp_path / "arm.so"
    subprocess.run(
        ["cc", "-O1", "-shared", "-fPIC", str(tmp_path / "arm.c"), "-o", str(library), "-lm"],
        check=True,
    )
    arm_torque = ctypes.CDLL(str(library)).arm_torque
    torque = np.zeros_like(motion[0])
    pointer = ctypes.POINTER(ctypes.c_double)
    for row, *state in zip(torque, *motion, strict=True):
        arm_torque(*(np.ascontiguousarray(x).ctypes.data_as(pointer) for x in (*state, row)))
    assert_allclose(torque, network.torque(k, *motion), rtol=1e-11, atol=1e-11)
