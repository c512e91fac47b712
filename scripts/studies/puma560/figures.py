"""Figures of the experiment."""

import dataclasses
from typing import Any

import numpy as np
from matplotlib.figure import Figure
from scipy.interpolate import CubicSpline

import jaxcslc as jc
import sim
from jaxcslc.identification import predicted_torque
from jaxcslc.plotting import torque_picture
from scripts.studies.motor.pictures import motor_curve_picture, motor_response_picture
from scripts.studies.puma560.machine_pictures import friction_picture, hysteresis_picture
from scripts.studies.puma560.machines import IdentifiedMachine
from scripts.studies.puma560.motion_pictures import (
    averaged_spline_picture,
    motion_picture,
    reversal_picture,
    spline_subsets_picture,
)


CAPTIONS = {
    "2.5-1": "Friction of PUMA A's joint 1 by the three-part model (Eqn. 2.5-4).",
    "2.5-3": "Link against rotor of PUMA A's joint 4, swung by 8 mrad: backlash.",
    "7.2-1": "Response of the motor of joint 1 beyond its limit of linearity.",
    "7.2-2": "Mean torque of joint 2 against the mass hung from the flange.",
    "7.3-1": "Three cubic splines through three subsets of joint 3's encoder readings.",
    "7.3-2": "Their average, and where the rotor truly was.",
    "7.4-2": "Motion of joint 5 in the training trajectory.",
    "7.6-1": "Measured and predicted torques of the comparison trajectory, PUMA A.",
    "7.6-2": "The same, PUMA B.",
    "7.6-4": "Joint 1 of PUMA A where its velocity changes sign in the training trajectory.",
}
_QUICK_LINEARITY = {"masses": (0.0, 2.0, 4.5), "swings": 1, "period": 1.0}


def torque_figure(network: jc.CSLC, puma: IdentifiedMachine) -> Figure:
    """Figs. 7.6-1 and 7.6-2."""
    return torque_picture(
        np.asarray(puma.comparison_patterns.time),
        np.asarray(puma.comparison_patterns.torque),
        {
            model: np.asarray(
                predicted_torque(network, puma.comparison_patterns, puma.vectors[model])
            )
            for model in ("Ar+LS", "Ar+Rg", "CSLC")
        },
        title=f"{puma.name}: torques of the comparison trajectory",
        units=("N m",) * 6,
        mask=puma.comparison_patterns.mask,
    )


def clean_turn(velocity: np.ndarray) -> int:
    """The sample before the quickest reversal of a joint's velocity: one that does not stick."""
    turns = np.flatnonzero(np.diff(np.sign(velocity)))
    turns = turns[(turns > 100) & (turns < velocity.size - 100)]
    quickness = np.minimum(np.abs(velocity[turns - 20]), np.abs(velocity[turns + 20]))
    return int(turns[np.argmax(quickness)])


def spline_figures(puma: IdentifiedMachine) -> dict[str, Figure]:
    """Figs. 7.3-1 and 7.3-2, on joint 3's encoder where it turns round."""
    recording, truth = puma.training
    resolution = puma.machine.encoder_resolution[2]
    turn = clean_turn(truth.rotor_velocity[:, 2])
    near = slice(turn - 60, turn + 60)
    drawn = slice(turn - 18, turn + 19)
    time = recording.time[near]
    counts = (recording.position[near, 2] - recording.position[turn, 2]) / resolution
    true = (truth.rotor_position[near, 2] - recording.position[turn, 2]) / resolution
    fine = np.linspace(recording.time[drawn][0], recording.time[drawn][-1], 400)
    splines = [CubicSpline(time[start::3], counts[start::3])(fine) for start in range(3)]
    ms = 1e3 * (fine - recording.time[turn])
    samples = 1e3 * (recording.time[drawn] - recording.time[turn])
    readings = counts[42:79]
    return {
        "7.3-1": spline_subsets_picture(samples, readings, ms, splines),
        "7.3-2": averaged_spline_picture(
            samples, readings, ms, np.mean(splines, axis=0), CubicSpline(time, true)(fine)
        ),
    }


def reversal_figure(network: jc.CSLC, puma: IdentifiedMachine) -> Figure:
    """Fig. 7.6-4: joint 1's torque where its velocity changes sign in the training trajectory."""
    recording, truth = puma.training
    everywhere = jc.prepare(
        recording, smoothing=jc.AveragedSplines(17), torque_alignment="mean", thresholds=0.0
    )
    q1d, time = np.asarray(everywhere.qd[:, 0]), np.asarray(everywhere.time)
    turn = clean_turn(q1d)
    near = slice(max(turn - 40, 0), turn + 40)
    before, after = q1d[turn], q1d[turn + 1]
    reversal = float(time[turn] + (time[turn + 1] - time[turn]) * before / (before - after))
    changes = np.flatnonzero(np.diff(np.sign(truth.velocity[:, 0])))
    true_turn = float(truth.time[changes[np.argmin(np.abs(truth.time[changes] - reversal))]])
    predicted = np.asarray(predicted_torque(network, everywhere, puma.vectors["CSLC"]))
    return reversal_picture(
        time[near],
        np.asarray(everywhere.torque)[near, 0],
        predicted[near, 0],
        reversal=reversal,
        true_reversal=true_turn,
    )


def plant_figures(puma: IdentifiedMachine, progress: Any, *, quick: bool) -> dict[str, Figure]:
    """Figs. 2.5-1, 2.5-3, 7.2-1, 7.2-2 and 7.4-2."""
    machine, truth = puma.machine, puma.training.truth
    joint = 3  # the fourth: the wrist's dead band is the widest
    speed = np.concatenate([np.linspace(-1.0, -1e-6, 400), np.linspace(1e-6, 1.0, 400)])
    columns = np.tile(speed[:, None], (1, 6))
    friction = sim.Friction.of(dataclasses.replace(machine, asymmetry=())).torque(columns)[:, 0]
    still = np.array([0.0, 0.0, np.pi / 2, 0.0, 0.0, 0.0])
    small = 8e-3 * (np.arange(6) == joint)  # a loop is as wide as the dead band
    wobble = sim.Trajectory(
        "wobble",
        still - small,
        sim.comparison().controller,
        1501,
        path=sim.Oscillation(still, small, 1.0),
    )
    quiet = dataclasses.replace(machine, encoder_resolution=(0.0,) * 6)
    loop = sim.simulate(quiet, wobble).truth
    last = slice(1000, None)
    demand = np.linspace(0.0, 1.2 * machine.maximum_torque[0], 400)
    drives = sim.Drives.of(machine)
    response_torque = drives.torque(np.tile(demand[:, None], (1, 6)))[:, 0]
    linear = dataclasses.replace(sim.puma560(), linear_torque=())
    options: dict[str, Any] = _QUICK_LINEARITY if quick else {}
    response = sim.motor_linearity(linear, progress=progress, **options)
    return {
        "2.5-1": friction_picture(
            speed,
            friction,
            viscous=machine.viscous[0],
            dry=machine.dry[0],
            static=machine.static[0],
        ),
        "2.5-3": hysteresis_picture(
            1e3 * loop.rotor_position[last, joint],
            1e3 * loop.position[last, joint],
            backlash=1e3 * machine.backlash[joint],
        ),
        "7.2-1": motor_curve_picture(demand, response_torque, limit=machine.linear_torque[0]),
        "7.2-2": motor_response_picture(response.mass, response.torque),
        "7.4-2": motion_picture(
            truth.time,
            truth.rotor_position[:, 4],
            truth.rotor_velocity[:, 4],
            truth.rotor_acceleration[:, 4],
        ),
    }
