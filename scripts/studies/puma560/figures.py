"""Figures of the experiment."""

import dataclasses
from collections.abc import Sequence
from typing import Any

import numpy as np
from matplotlib.figure import Figure
from scipy.interpolate import CubicSpline

import jaxcslc as jc
import sim
from jaxcslc.report import predicted_torque
from scripts.studies.motor.pictures import motor_curve_picture, motor_response_picture
from scripts.studies.puma560.applied_torque import applied_torque, applied_torque_picture
from scripts.studies.puma560.machine_pictures import friction_picture, hysteresis_picture
from scripts.studies.puma560.machines import CHOSEN, TRAINED, IdentifiedMachine
from scripts.studies.puma560.motion_pictures import (
    averaged_spline_picture,
    motion_picture,
    reversal_picture,
    spline_subsets_picture,
    torque_picture,
)
from scripts.studies.puma560.reversals import clean_turn, clearest_ramps
from scripts.studies.puma560.tables import curves
from scripts.studies.training.learning_pictures import training_curves_picture


CAPTIONS = {
    "2.5-1": "Friction of PUMA A's joint 1 by the three-part model (Eqn. 2.5-4), without its"
    " asymmetry.",
    "2.5-3": "Link against rotor of PUMA A's joint 4, swung by 8 mrad: backlash.",
    "7.2-1": "Response of the motor of PUMA A's joint 1: no demand of either trajectory comes near"
    " its limit of linearity.",
    "7.2-2": "Mean torque of PUMA A's joint 2 against the mass hung from the flange.",
    "7.2-2b": "The same on joint 3, the double-check of 7.2.3: link 3 oscillates about the"
    " horizontal, all other joints are locked.",
    "7.3-1": "Three cubic splines through three subsets of the readings of PUMA A's encoder 3.",
    "7.3-2": "Their average, and where the rotor truly was.",
    "7.4-1": "Demanded torque of PUMA A's joint 2 in the comparison trajectory, and what of it"
    " arrives behind the compliant gears: the rotor's inertia and friction take their part, and"
    " nothing is left of the steps. Encoders are read where the demand is updated.",
    "7.4-2": "Motion of PUMA A's joint 5 in the training trajectory.",
    "7.5": "Half the summed squared errors of the training patterns, epoch by epoch. A bout of"
    " PERAL is ten epochs, after two hundred of backpropagation. Dotted: the direct solve.",
    "7.6-1": "Measured and predicted torques of the comparison trajectory, PUMA A, with the errors"
    " of the predictions below.",
    "7.6-2": "The same, PUMA B.",
    "7.6-4": "A reversal of PUMA A in the training trajectory: of all joints' reversals, the one"
    " whose lower ramp of the error, on either side, is highest in units of dry friction. In the"
    " thesis it is one of joint 1, which here turns round three times and sticks at two of them."
    " The dashed line is the true static friction, which the model does not have: backlash and"
    " smoothing make its ramps steeper than they are.",
}
# As many measurements as in the thesis, as parts of the heaviest mass.
_PARTS = (0.0, 0.0, 0.0, *(number / 9 for number in range(1, 10)))
_QUICK_PARTS = (0.0, 0.5, 1.0)
# Heaviest masses by joint [kg]. Joint 2's asks as large a part of its greatest torque as the
# training trajectory does of any joint; joint 3's about the same part.
_HEAVIEST = {2: 7.6, 3: 10.0}


def torque_figure(network: jc.CSLC, puma: IdentifiedMachine) -> Figure:
    """Figs. 7.6-1 and 7.6-2."""
    patterns = puma.comparison_patterns
    models = {
        "Ar+LS": "published (Ar+LS)",
        "Ar+Rg": "published links, fitted friction (Ar+Rg)",
        TRAINED if TRAINED in puma.vectors else CHOSEN: "identified (CSLC)",
    }
    return torque_picture(
        np.asarray(patterns.time),
        patterns.torque,
        {
            words: predicted_torque(network, patterns, puma.vectors[model])
            for model, words in models.items()
        },
        patterns.mask,
        title=f"{puma.name}: torques of the comparison trajectory",
    )


def training_figure(machines: Sequence[IdentifiedMachine]) -> dict[str, Figure]:
    """Training curves of both machines; none of a quick run."""
    trained = {puma.name: puma.side_by_side for puma in machines if puma.side_by_side is not None}
    if not trained:
        return {}
    figure = training_curves_picture(
        {name: curves(part) for name, part in trained.items()},
        {name: float(part.solved_cost[0]) for name, part in trained.items()},
    )
    return {"7.5": figure}


# Samples about a reversal: those that splines are laid through, and the few that are drawn, where
# counts are coarse beside the motion. The first two are multiples of three, as the splines' knots.
_NEAR, _BEFORE, _BEHIND = 60, 6, 18


def spline_figures(puma: IdentifiedMachine) -> dict[str, Figure]:
    """Figs. 7.3-1 and 7.3-2, on joint 3's encoder where it turns round."""
    recording, truth = puma.training
    resolution = puma.machine.encoder_resolution[2]
    turn = clean_turn(truth.rotor_velocity[:, 2])
    near = slice(turn - _NEAR, turn + _NEAR)
    drawn = slice(turn - _BEFORE, turn + _BEHIND + 1)
    time = recording.time[near]
    counts = (recording.position[near, 2] - recording.position[turn, 2]) / resolution
    true = (truth.rotor_position[near, 2] - recording.position[turn, 2]) / resolution
    fine = np.linspace(recording.time[drawn][0], recording.time[drawn][-1], 400)
    splines = [CubicSpline(time[start::3], counts[start::3])(fine) for start in range(3)]
    ms = 1e3 * (fine - recording.time[turn])
    samples = 1e3 * (recording.time[drawn] - recording.time[turn])
    readings = counts[_NEAR - _BEFORE : _NEAR + _BEHIND + 1]
    return {
        "7.3-1": spline_subsets_picture(
            samples, readings, ms, splines, title=f"{puma.name}, joint 3: three splines"
        ),
        "7.3-2": averaged_spline_picture(
            samples,
            readings,
            ms,
            np.mean(splines, axis=0),
            CubicSpline(time, true)(fine),
            title=f"{puma.name}, joint 3: average of three splines",
        ),
    }


def reversal_figure(network: jc.CSLC, puma: IdentifiedMachine) -> Figure:
    """Fig. 7.6-4: the reversal whose ramps of the error are clearest, of the training trajectory.

    Smoothed narrowly: the spacing of the fit would smear the ramps.
    """
    recording, truth = puma.training
    machine = puma.machine
    everywhere = jc.prepare(
        recording, smoothing=jc.AveragedSplines(9), torque_alignment="mean", thresholds=0.0
    )
    qd, time = np.asarray(everywhere.qd), np.asarray(everywhere.time)
    measured = np.asarray(everywhere.torque)
    predicted = np.asarray(predicted_torque(network, everywhere, puma.vectors["CSLC"]))
    thresholds = sim.thesis_coefficients(puma.letter).insignificant_from
    ramps = clearest_ramps(qd, measured - predicted, thresholds, np.array(machine.dry))
    joint, turn = ramps.joint, ramps.sample
    near = slice(turn - 40, turn + 41)
    before, after = qd[turn, joint], qd[turn + 1, joint]
    reversal = float(time[turn] + (time[turn + 1] - time[turn]) * before / (before - after))
    rotor = truth.rotor_velocity[:, joint]
    changes = np.flatnonzero(np.diff(np.sign(rotor)))
    true_turn = float(truth.time[changes[np.argmin(np.abs(truth.time[changes] - reversal))]])
    excess = machine.static[joint] - machine.dry[joint]
    speed = np.interp(time[near], truth.time, rotor)
    static = np.sign(speed) * excess * np.exp(-np.abs(speed) / machine.static_velocity[joint])
    return reversal_picture(
        time[near],
        measured[near, joint],
        predicted[near, joint],
        reversal=reversal,
        true_reversal=true_turn,
        static=static,
        title=f"{puma.name}, joint {joint + 1}: a reversal in the training trajectory",
    )


def linearity_experiment(
    machine: sim.Machine, progress: Any = None, *, quick: bool = False
) -> tuple[sim.MotorLinearity, ...]:
    """Repeat the experiment of 7.2.3 on joint 2, and on joint 3 as the double-check.

    The tested link oscillates about the horizontal, while all other joints are locked.
    """
    return tuple(
        sim.motor_linearity(
            machine,
            joint=joint,
            masses=tuple(part * heaviest for part in (_QUICK_PARTS if quick else _PARTS)),
            swings=1,
            period=0.5 if quick else 2.0,
            # A wider oscillation would demand more than the motor is linear in.
            amplitude=0.005 if quick else 0.05,
            progress=progress,
        )
        for joint, heaviest in _HEAVIEST.items()
    )


def plant_figures(
    puma: IdentifiedMachine, responses: Sequence[sim.MotorLinearity]
) -> dict[str, Figure]:
    """Draw Figs. 2.5-1, 2.5-3, 7.2-1, 7.2-2, 7.4-1 and 7.4-2.

    - `responses`: of the machine's joint 2, then of joint 3.
    """
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
    return {
        "2.5-1": friction_picture(
            speed,
            friction,
            viscous=machine.viscous[0],
            dry=machine.dry[0],
            static=machine.static[0],
            title=f"{puma.name}, joint 1: friction",
        ),
        "2.5-3": hysteresis_picture(
            1e3 * loop.rotor_position[last, joint],
            1e3 * loop.position[last, joint],
            backlash=1e3 * machine.backlash[joint],
            title=f"{puma.name}, joint {joint + 1}: backlash",
        ),
        "7.2-1": motor_curve_picture(
            demand,
            response_torque,
            limit=machine.linear_torque[0],
            title=f"{puma.name}, joint 1: motor response",
        ),
        **{
            number: motor_response_picture(
                response.mass,
                response.torque,
                title=f"{puma.name}, joint {response.joint}: weights on the flange",
            )
            for number, response in zip(("7.2-2", "7.2-2b"), responses, strict=True)
        },
        "7.4-1": applied_torque_picture(
            applied_torque(machine), title=f"{puma.name}, joint 2: comparison trajectory"
        ),
        "7.4-2": motion_picture(
            truth.time,
            truth.rotor_position[:, 4],
            truth.rotor_velocity[:, 4],
            truth.rotor_acceleration[:, 4],
            title=f"{puma.name}, joint 5: training trajectory",
        ),
    }
