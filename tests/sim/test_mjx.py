"""The plant under MJX does what C MuJoCo's does; short, since compiling for a CPU takes long."""

import dataclasses
from collections.abc import Iterator

import jax
import numpy as np
import pytest

import sim


@pytest.fixture(autouse=True)
def optimised() -> Iterator[None]:
    """Compiles with every optimisation: MJX runs three times as long without."""
    jax.config.update("jax_disable_most_optimizations", False)
    yield
    jax.config.update("jax_disable_most_optimizations", True)


def test_mjx_records_what_mujoco_records():
    """Machines that differ, gears and every disturbance, quantised feedback included."""
    machines = [
        sim.disturbed(machine) for machine in (sim.puma560(), sim.specimen(sim.puma560(), 1))
    ]
    trajectory = dataclasses.replace(sim.comparison(), samples=25)
    jobs = [sim.Job(machine, trajectory, seed) for seed, machine in enumerate(machines)]
    for one, other in zip(sim.record(jobs, backend="mjx"), sim.record(jobs), strict=True):
        np.testing.assert_allclose(one.recording.position, other.recording.position, atol=1e-12)
        np.testing.assert_allclose(one.recording.torque, other.recording.torque, atol=1e-9)
        for field in dataclasses.fields(one.truth):
            values, expected = (
                np.asarray(getattr(truth, field.name), float) for truth in (one.truth, other.truth)
            )
            scale = max(float(np.abs(expected).max()), 1.0)
            np.testing.assert_allclose(values, expected, atol=1e-7 * scale, err_msg=field.name)


def test_mjx_needs_64_bits():
    with jax.enable_x64(False), pytest.raises(sim.MachineError, match="64-bit mode is off"):
        sim.record([sim.Job(sim.puma560(), sim.training(samples=2))], backend="mjx")
