"""Each disturbance of Section 7.2 alone: what it changes, by how much, and what it leaves alone."""

import dataclasses

import numpy as np
import pytest

import sim


def test_without_disturbances_the_machine_is_the_network(performed: object):
    """Recorded motion satisfies the network with true coefficients (issue: 1e-6 of the torque)."""
    import jaxcslc as jc

    machine = sim.undisturbed(sim.puma560())
    network = jc.derive(machine.robot)
    k = network.coefficients_from(machine.links, viscous=machine.viscous, dry=machine.dry)
    for trajectory in (sim.training(samples=800), sim.comparison()):
        recording, truth = sim.simulate(machine, trajectory)
        np.testing.assert_array_equal(recording.position, truth.position)
        torque = network.torque(k, truth.position, truth.velocity, truth.acceleration)
        # A joint at rest, or stopped within the next step, is held by less than dry friction.
        slides = np.abs(truth.velocity) > 1.01 * machine.time_step * np.abs(truth.acceleration)
        slides &= np.abs(truth.velocity) > 1e-4
        error = np.abs(np.asarray(torque) - recording.torque)
        assert error[slides].max() < 1e-6 * np.abs(recording.torque).max()
        assert slides.mean() > 0.9


@pytest.mark.parametrize("name", sim.DISTURBANCES)
def test_a_disturbance_alone_changes_the_recording(name: str):
    trajectory = sim.training(samples=150)
    quiet, loud = sim.undisturbed(sim.puma560()), sim.disturbed(sim.puma560(), name)
    one, other = (sim.simulate(machine, trajectory, seed=2) for machine in (quiet, loud))
    moved = np.abs(one.recording.position - other.recording.position).max(axis=0)
    assert np.all(moved[: 3 if name == "motor linearity" else 6] > 0), moved
    changed = {
        field.name
        for field in dataclasses.fields(loud)
        if field.name != "robot" and getattr(loud, field.name) != getattr(quiet, field.name)
    }
    assert changed <= set(sim.DISTURBANCES[name])


def test_all_are_on_by_default():
    machine = sim.disturbed(sim.puma560())
    for name, fields in sim.DISTURBANCES.items():
        for field in fields:
            if name != "backlash" or field == "backlash":
                assert getattr(machine, field) == fields[field], (name, field)


def test_a_machine_keeps_its_own_static_friction():
    machine = dataclasses.replace(sim.puma560(), static=(9.0,) * 6, static_velocity=(0.1,) * 6)
    assert sim.disturbed(machine, "static friction").static == (9.0,) * 6
    assert sim.disturbed(machine, "static friction").static_velocity == (0.1,) * 6
    assert sim.disturbed(machine, "quantisation").static == machine.dry
    plain = dataclasses.replace(machine, static=machine.dry)
    np.testing.assert_allclose(
        sim.disturbed(plain, "static friction").static, 1.25 * np.array(machine.dry)
    )


def test_tilted_axes_are_wrong_by_the_predicted_amount():
    """Torque error of a network of principal axes, and none of one of full tensors."""
    import jaxcslc as jc

    machine = sim.disturbed(sim.puma560(), "tilted axes")
    full = jc.Manipulator.from_modified_dh(
        [
            (joint.alpha, joint.a.value or 0.0, joint.d.value or 0.0, joint.theta)
            for joint in machine.robot.joints
        ],
        gravity=machine.robot.gravity,
        inertia="full",
    )
    network = jc.derive(full, lengths="numeric")
    k = network.coefficients_from(machine.links, viscous=machine.viscous, dry=machine.dry)
    _, truth = sim.simulate(machine, sim.training(samples=400))
    torque = network.torque(k, truth.position, truth.velocity, truth.acceleration)
    slides = np.abs(truth.velocity) > 0.01
    np.testing.assert_allclose(np.asarray(torque)[slides], truth.torque[slides], atol=1e-9)
    principal = jc.derive(machine.robot)
    k = principal.coefficients_from(machine.links, viscous=machine.viscous, dry=machine.dry)
    torque = principal.torque(k, truth.position, truth.velocity, truth.acceleration)
    missing = np.abs(np.asarray(torque) - truth.torque)[slides].max()
    assert 0.01 < missing < 1.0
    straight = sim.possible_links(machine.robot, machine.robot.links or ())
    for link, before in zip(machine.links, straight, strict=True):
        np.testing.assert_allclose(
            np.linalg.eigvalsh(link.inertia), np.sort(np.diag(before.inertia)), atol=1e-15
        )


def test_unknown_names_and_other_arms_are_refused():
    with pytest.raises(sim.MachineError, match="unknown disturbance 'rust'; expected some of"):
        sim.disturbed(sim.puma560(), "rust")
