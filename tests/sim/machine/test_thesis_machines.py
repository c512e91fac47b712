"""The presets after the thesis's two machines."""

from collections.abc import Callable
from typing import Any

import mujoco
import numpy as np
import pytest

import sim
from jaxcslc import CSLC
from sim.machine._nearest_links import parameters_of
from sim.machine._thesis_machines import puma_a, puma_b, thesis_coefficients


MACHINES = {"A": puma_a, "B": puma_b}
names = pytest.mark.parametrize("name", ["A", "B"])


def links_of(machine: sim.Machine) -> Any:
    assert machine.robot.links is not None
    return machine.robot.links


@names
def test_the_figures_are_appendix_bs(name: str, appendix_b: dict[str, Any], puma: CSLC) -> None:
    printed, thesis = appendix_b["values"][f"puma_{name.lower()}"], thesis_coefficients(name)
    for ours, theirs in (
        ("mass", "kM"),
        ("mass_sensitivity", "kM_sensitivity"),
        ("gravity", "kG"),
        ("gravity_sensitivity", "kG_sensitivity"),
        ("viscous", "kv"),
        ("viscous_sensitivity", "kv_sensitivity"),
        ("viscous_regressed", "kv_regression"),
        ("dry", "kd"),
        ("dry_regressed", "kd_regression"),
        ("insignificant_from", "threshold"),
    ):
        np.testing.assert_array_equal(getattr(thesis, ours), printed[theirs])
    assert thesis.coefficients.shape == thesis.sensitivity.shape == (len(puma.names),)
    np.testing.assert_array_equal(thesis.coefficients[[26, 31, 42]], [
        printed["kG"][0], printed["kv"][0], printed["kd"][5]
    ])  # fmt: skip
    with pytest.raises(ValueError, match="read-only"):
        thesis.mass[0] = 1.0


def test_there_is_no_third_machine() -> None:
    with pytest.raises(sim.MachineError, match=r"no PUMA 'C'; expected 'A' or 'B'"):
        thesis_coefficients("C")


@names
def test_friction_is_as_printed_and_the_remainder_the_designs(name: str) -> None:
    machine, design, thesis = MACHINES[name](), sim.puma560(), thesis_coefficients(name)
    assert machine.viscous == tuple(thesis.viscous) and machine.dry == tuple(thesis.dry)
    np.testing.assert_allclose(machine.static, 1.25 * thesis.dry)
    np.testing.assert_allclose(machine.static_velocity, thesis.insignificant_from / 5)
    for field in ("encoder_resolution", "maximum_torque", "position_range", "time_step"):
        assert getattr(machine, field) == getattr(design, field)
    assert machine.robot.inertia == design.robot.inertia


@names
def test_mujoco_accepts_the_links_as_they_are(name: str) -> None:
    """Independent check: MuJoCo refuses moments that break the triangle inequality."""
    bodies = "".join(
        f'<body><joint/><inertial pos="0 0 0" mass="{float(link.mass) or 1.0!r}"'
        f' diaginertia="{" ".join(repr(float(x)) for x in np.diag(link.inertia))}"/></body>'
        for link in links_of(MACHINES[name]())  # link 1's mass is on its axis and does not matter
    )
    template = "<mujoco><compiler balanceinertia='false'/><worldbody>{}</worldbody></mujoco>"
    assert mujoco.MjModel.from_xml_string(template.format(bodies)).nbody == 7
    impossible = '<body><joint/><inertial pos="0 0 0" mass="1" diaginertia="1 1 2.1"/></body>'
    with pytest.raises(ValueError, match="inertia"):
        mujoco.MjModel.from_xml_string(template.format(impossible))


@names
def test_the_plants_model_takes_nothing_away(name: str) -> None:
    machine = MACHINES[name]()
    kept = sim.possible_links(machine.robot, links_of(machine))
    assert all(a is b for a, b in zip(kept, links_of(machine), strict=True))
    assert mujoco.MjModel.from_xml_string(sim.mjcf(machine.robot)).nv == 6


@names
def test_the_mass_matrix_is_positive_definite_everywhere(
    name: str, pinocchio_model: Callable[..., Any], rng: np.random.Generator
) -> None:
    """No less than the smallest motor inertia, which the rigid links only add to."""
    import pinocchio as pin

    machine = MACHINES[name]()
    model = pinocchio_model(machine.robot)
    data = model.createData()
    motors = np.array(model.armature)
    model.armature = np.zeros(6)
    low, high = np.array(machine.position_range).T
    for q in rng.uniform(low, high, (1000, 6)):
        upper = np.triu(pin.crba(model, data, q))
        rigid = upper + np.triu(upper, 1).T
        assert np.linalg.eigvalsh(rigid)[0] > -1e-12
        assert np.linalg.eigvalsh(rigid + np.diag(motors))[0] > 0.999 * motors.min()


@names
def test_the_network_is_exact(
    name: str, puma: CSLC, inverse_dynamics: Callable[..., Any], rng: np.random.Generator
) -> None:
    robot = MACHINES[name]().robot
    motion = rng.normal(size=(3, 50, 6)) * [[[3.0]], [[5.0]], [[20.0]]]
    expected = inverse_dynamics(robot)(*motion)
    result = puma.torque(puma.coefficients_from(links_of(MACHINES[name]())), *motion)
    np.testing.assert_allclose(result, expected, atol=1e-12 * np.abs(expected).max())


@names
def test_a_comfortable_machine_nearer_than_armstrongs(name: str, puma: CSLC) -> None:
    machine, design = MACHINES[name](), sim.puma560()
    at = parameters_of(sim.possible_links(design.robot, links_of(design)))
    result = parameters_of(links_of(machine))
    for column in (0, 7):
        assert (result[:, column] >= 0.499 * at[:, column]).all()
        assert (result[:, column] <= 2.001 * at[:, column]).all()
    assert np.abs(result - at)[:, 1:4].max() < 0.1001
    thesis = thesis_coefficients(name)

    def distance(of: sim.Machine) -> float:
        k = np.asarray(puma.coefficients_from(links_of(of)))
        return float(np.linalg.norm((thesis.sensitivity * (k - thesis.coefficients))[:31]))

    assert distance(machine) < 0.6 * distance(design)


@names
def test_what_a_motor_inertia_sets_is_as_printed(name: str, puma: CSLC) -> None:
    """kM6, kM11, kM16 and kM23 each contain a motor inertia that no other does."""
    with_motor = [puma.names.index(k) for k in ("kM6", "kM11", "kM16", "kM23")]
    k = np.asarray(puma.coefficients_from(links_of(MACHINES[name]())))
    np.testing.assert_allclose(
        k[with_motor], thesis_coefficients(name).coefficients[with_motor], rtol=1e-5
    )


def test_each_call_gives_the_same_links() -> None:
    assert puma_a().robot.links is puma_a().robot.links
    assert puma_a().robot != puma_b().robot
