"""The C code against Python, on robots of every kind; what it is, and what it refuses."""

import ctypes
import re
import shutil
import subprocess
from collections.abc import Callable
from pathlib import Path
from typing import Any

import jax.numpy as jnp
import numpy as np
import pytest
from jaxtyping import Float

import jaxcslc as jc
from jaxcslc.export import write_c
from tests import arms


Compiled = Callable[[jc.CCode], Callable[..., Float[np.ndarray, "..."]]]
_STATES = 5
# Sums of a few hundred products in another order.
_ROUNDING = 1e-12


_ALL_KINDS = arms.TREE.with_friction(
    "asymmetric_viscous", "asymmetric_dry", "static", "root", "spring"
)


def _agrees(network: jc.CSLC, k: Any, call: Any, rng: np.random.Generator) -> None:
    """All four functions at random states."""
    n, p = network.joint_count, network.size
    q, qd, qdd = rng.uniform(-2, 2, (3, _STATES, n))
    qd[0] = 0.0
    # Not compiled as a whole: robots share the programs of single operations.
    expected = (
        network.torque(k, q, qd, qdd),
        network.mass_matrix(k, q),
        network.gravity_term(k, q),
        network.regressor(q, qd, qdd),
    )
    largest = float(jnp.max(jnp.abs(expected[0])))
    for i in range(_STATES):
        computed = (
            call("torque", q[i], qd[i], qdd[i], size=n),
            call("mass_matrix", q[i], size=n * n).reshape(n, n),
            call("gravity", q[i], size=n),
            call("regressor", q[i], qd[i], qdd[i], size=n * p).reshape(n, p),
        )
        for actual, desired in zip(computed, expected, strict=True):
            np.testing.assert_allclose(actual, desired[i], rtol=_ROUNDING, atol=_ROUNDING * largest)


def test_puma560(puma: jc.CSLC, compiled: Compiled, rng: np.random.Generator) -> None:
    """Coefficients that were identified one by one belong to no body: the closed form."""
    k = rng.normal(size=puma.size)
    _agrees(puma, k, compiled(jc.c_code(puma, k)), rng)


def test_puma560_of_possible_links(
    puma: jc.CSLC, puma_k: Any, compiled: Compiled, rng: np.random.Generator
) -> None:
    """Those of links have less to compute."""
    code = jc.c_code(puma, puma_k)
    _agrees(puma, puma_k, compiled(code), rng)
    other = jc.c_code(puma, rng.normal(size=puma.size))
    assert code.operations["torque"] < 0.65 * other.operations["torque"] < 500


def test_panda(compiled: Compiled, rng: np.random.Generator) -> None:
    network = arms.panda()
    k = rng.normal(size=network.size)
    code = jc.c_code(network, k)
    _agrees(network, k, compiled(code), rng)
    assert code.operations["torque"] < 700
    # Sine and cosine once per angle in every function.
    for function in code.source.split("\nvoid ")[1:]:
        assert len(re.findall(r"sin\(", function)) == len(set(re.findall(r"sin\(.*?\)", function)))


@pytest.mark.parametrize(
    ("robot", "lengths"),
    [
        pytest.param(
            _ALL_KINDS.with_coupling((1, 3, 0.5)).with_static_slopes([1.0, 2.0, 3.0, 4.0]),
            "numeric",
            id="every kind, a coupling",
        ),
        pytest.param(
            arms.TREE.with_friction("viscous", "dry", "offset"), "symbolic", id="offsets, symbols"
        ),
    ],
)
def test_a_tree(
    robot: jc.Manipulator, lengths: Any, compiled: Compiled, rng: np.random.Generator
) -> None:
    """Branches, a prismatic joint, and every kind of friction; at rest too, where
    sgn(0) = 0 and nothing is divided by."""
    network = jc.derive(robot, lengths=lengths)
    k = rng.normal(size=network.size)
    _agrees(network, k, compiled(jc.c_code(network, k)), rng)


@pytest.mark.parametrize("lengths", ["symbolic", "numeric"])
def test_known_masses(lengths: Any, compiled: Compiled, rng: np.random.Generator) -> None:
    """Numbers of the algebra (thesis C.1.2), in closed form and by recursion."""
    robot = arms.TREE.with_known(2, mass=1.5, centre_of_gravity=(0.1, -0.2, 0.05)).with_known(
        3, centre_of_gravity=(0.3, 0.0, 0.1)
    )
    network = jc.derive(robot, lengths=lengths)
    k = rng.normal(size=network.size)
    for name, value in network.known_values.items():
        k[network.names.index(name)] = value
    _agrees(network, k, compiled(jc.c_code(network, k)), rng)


@pytest.mark.parametrize("kind", ["load", "directional_load"])
def test_friction_that_follows_the_load(
    kind: str, compiled: Compiled, rng: np.random.Generator
) -> None:
    network = arms.tree("dry", kind)
    k = rng.normal(size=network.size)
    network = network.with_load(k)
    _agrees(network, k, compiled(jc.c_code(network, k)), rng)


def test_what_is_unused_does_not_warn(compiled: Compiled) -> None:
    """A joint with an upright axis and no friction: torque sees neither position nor rate."""
    robot = jc.Manipulator.from_modified_dh([(0, 0, 0, 0)], friction=())
    network = jc.derive(robot, lengths="numeric")
    call = compiled(jc.c_code(network, np.array([2.0])))
    three = np.array([3.0])
    assert call("torque", three, three, three, size=1).tolist() == [6.0]
    assert call("gravity", three, size=1).tolist() == [0.0]


def test_the_text(puma: jc.CSLC, puma_k: Any) -> None:
    """Self-contained, and says what it is."""
    code = jc.c_code(puma, puma_k, name="arm")
    assert re.findall(r"#include (.*)", code.source) == ["<math.h>", '"arm.h"']
    for text in ("malloc", "static double x", "for (", "while"):
        assert text not in code.source
    for name in ("torque", "mass_matrix", "gravity", "regressor"):
        assert f"void arm_{name}(const double q[6]" in code.header
    assert "PUMA 560" in code.header and "revolute [rad, N m]" in code.header
    assert f"kM1  = {float(puma_k[0]):.17g} kg m^2" in code.source
    assert code.source.isascii() and max(map(len, code.source.splitlines())) < 250


def test_names_cannot_break_out_of_the_comment(compiled: Compiled) -> None:
    robot = jc.Manipulator.from_modified_dh(
        [(0, 0, 0, 0)], name='*/ int main; /* "Ünï" ??/ \\', friction=("viscous",)
    )
    network = jc.derive(robot, lengths="numeric")
    code = jc.c_code(network, np.ones(network.size))
    assert re.fullmatch(r"[a-z][a-z0-9_]*", code.name)
    assert compiled(code)("torque", *np.ones((3, 1)), size=1).tolist() == [2.0]


def test_names_leave_no_trigraph() -> None:
    """`??/` at the end of a line goes on with the next one, in comments as well."""
    robot = jc.Manipulator.from_modified_dh([(0, 0, 0, 0)], name="机械臂/ ????/", friction=())
    code = jc.c_code(jc.derive(robot, lengths="numeric"), np.ones(1))
    assert "??" not in code.header + code.source and "? ? ?/ ? ? ? ?/" in code.header


@pytest.mark.parametrize("name", ["", "2nd", "a b", "double", "a;b", "math"])
def test_names_that_c_does_not_have(puma: jc.CSLC, puma_k: Any, name: str) -> None:
    with pytest.raises(ValueError, match="expected a C identifier"):
        jc.c_code(puma, puma_k, name=name)


def test_coefficients_that_do_not_fit(puma: jc.CSLC) -> None:
    with pytest.raises(ValueError, match="expected 43 finite coefficients"):
        jc.c_code(puma, np.ones(3))
    with pytest.raises(ValueError, match="not all finite"):
        jc.c_code(puma, np.full(43, np.nan))


def test_constants_that_overflow() -> None:
    robot = jc.Manipulator.from_modified_dh([(0, 0, 0, 0), ("pi/2", 3, 0, 0)], friction=())
    network = jc.derive(robot, lengths="numeric")
    with pytest.raises(ValueError, match="torque: a constant overflows; expected coefficients"):
        jc.c_code(network, np.full(network.size, 1e308))


@pytest.mark.parametrize("kind", ["dry", "asymmetric_dry", "static", "asymmetric_viscous"])
def test_a_velocity_that_is_no_number(kind: str, compiled: Compiled) -> None:
    """It gives no torque, rather than one without friction."""
    network = arms.turntable(kind)
    k, still = np.ones(network.size), np.zeros(1)
    call = compiled(jc.c_code(network, k))
    assert np.isnan(call("torque", still, np.array([np.nan]), still, size=1)).all()
    for velocity in (np.inf, -np.inf, -0.0):
        qd = np.array([velocity])
        expected = network.torque(k, *np.array([[still], [qd], [still]]))[0]
        np.testing.assert_array_equal(call("torque", still, qd, still, size=1), expected)


@pytest.mark.parametrize("link", [None, 4])
def test_a_payload(
    link: int | None, puma: jc.CSLC, puma_k: Any, compiled: Compiled, rng: np.random.Generator
) -> None:
    """One body with its link; beside the closed form where coefficients belong to no bodies."""
    network = puma.with_payload(link)
    ten = rng.normal(size=10)
    code = jc.c_code(network, np.concatenate([puma_k, ten]))
    _agrees(network, jnp.concatenate([puma_k, ten]), compiled(code), rng)
    # A link of ten numbers in place of one of three, and no second recursion.
    assert code.operations["torque"] < jc.c_code(puma, puma_k).operations["torque"] + 80


def test_a_payload_beside_the_closed_form(
    puma: jc.CSLC, compiled: Compiled, rng: np.random.Generator
) -> None:
    network = puma.with_payload()
    k = rng.normal(size=network.size)
    _agrees(network, k, compiled(jc.c_code(network, k)), rng)


def test_a_payload_of_a_tree_with_every_kind_of_friction(
    compiled: Compiled, rng: np.random.Generator
) -> None:
    network = jc.derive(_ALL_KINDS.with_coupling((1, 3)), lengths="numeric").with_payload(2)
    k = rng.normal(size=network.size)
    _agrees(network, k, compiled(jc.c_code(network, k)), rng)


def test_the_tracking_loop_of_the_page(
    puma: jc.CSLC, puma_k: Any, tmp_path: Path, rng: np.random.Generator
) -> None:
    """Compiled as it stands: the model's torque at the desired motion, and that of the error."""
    if shutil.which("cc") is None:
        pytest.skip("no C compiler (cc) on this machine")
    page = (Path(__file__).parents[2] / "docs" / "export.md").read_text("utf-8")
    section = page.split("### Feed-forward in C and ROS 2")[1]
    (program, *_) = re.findall(r"^```c\n(.*?)^```", section, re.DOTALL | re.MULTILINE)
    (tmp_path / "track.c").write_text(program, encoding="ascii")
    write_c(jc.c_code(puma, puma_k, name="arm"), tmp_path / "arm.c")
    strict = ("-std=c99", "-Wall", "-Wextra", "-Werror", "-shared", "-fPIC")
    line = ["cc", *strict, "-o", "track.so", "track.c", "arm.c", "-lm"]
    done = subprocess.run(line, cwd=tmp_path, capture_output=True, text=True)
    assert done.returncode == 0, done.stderr
    track = ctypes.CDLL(str(tmp_path / "track.so")).track
    desired = rng.uniform(-1, 1, (3, 6))
    q, qd, kp, kd = rng.uniform(0, 1, (4, 6))
    tau = np.zeros(6)
    track(*(x.ctypes.data_as(ctypes.c_void_p) for x in (desired, q, qd, kp, kd, tau)))
    expected = np.asarray(puma.torque(puma_k, *desired))
    expected = expected + kp * (desired[0] - q) + kd * (desired[1] - qd)
    np.testing.assert_allclose(tau, expected, rtol=_ROUNDING, atol=_ROUNDING * abs(tau).max())
