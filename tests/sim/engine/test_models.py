"""Models that are filled in against those that MuJoCo compiles from a machine's MJCF."""

import mujoco
import numpy as np
import pytest

import sim
from sim.engine._models import model_of
from sim.machine._drivetrain import friction_of


def compiled(machine: sim.Machine, step: float) -> mujoco.MjModel:
    friction = friction_of(machine)
    return mujoco.MjModel.from_xml_string(
        sim.mjcf(
            machine.robot,
            machine.links,
            viscous=friction.viscous.tolist(),
            breakaway=friction.static.tolist(),
            stiffness=machine.stiffness,
            backlash=machine.backlash,
            transmission_damping=machine.transmission_damping,
            time_step=step,
        )
    )


def arrays(model: mujoco.MjModel) -> dict[str, np.ndarray]:
    values = {name: getattr(model, name) for name in dir(model) if not name.startswith("_")}
    return {name: value for name, value in values.items() if isinstance(value, np.ndarray)}


@pytest.mark.parametrize("seed", [1, 2])
@pytest.mark.parametrize("disturbances", ["none", "usual", "all"])
def test_a_model_is_the_compiled_one(disturbances: str, seed: int) -> None:
    """All constants, bit for bit, whichever machine came first."""
    changed = {"none": sim.undisturbed, "usual": lambda x: x, "all": sim.disturbed}[disturbances]
    machine = changed(sim.specimen(sim.puma560(), seed))
    model, expected = model_of(machine, 2e-4), compiled(machine, 2e-4)
    assert model.stat.meaninertia == expected.stat.meaninertia
    for name, values in arrays(expected).items():
        np.testing.assert_array_equal(getattr(model, name), values, err_msg=name)
    for name in ("timestep", "integrator", "solver", "iterations", "tolerance"):
        assert getattr(model.opt, name) == getattr(expected.opt, name)
    np.testing.assert_array_equal(model.opt.gravity, expected.opt.gravity)
