"""Does dry friction yield before it slides, joint by joint, on real arms?

Both models have the robot's friction without static friction, and are fitted to motion through a
20 Hz Butterworth filter, slow pairs included. One of them has dry friction with a state along the
motion (`jaxcslc.identification.fit_pre_sliding`). Errors are root mean squares over all samples,
with states over those without [%]: on eighths of the fitted motion, each predicted by a fit to the
others, and on the motion that is judged. A joint whose held-out error falls by no more than chance
explains keeps the sign of velocity.
"""

import argparse
import dataclasses
from collections.abc import Sequence
from pathlib import Path

import jax
import numpy as np

import jaxcslc as jc
from jaxcslc.identification import fit_pre_sliding
from jaxcslc.identification.report import text_table
from scripts.studies import command
from scripts.studies.real_robots.arms import DATA, READERS, Arm, read
from scripts.studies.real_robots.load_friction import SETTINGS as MASKED, percent, rms


jax.config.update("jax_enable_x64", True)

SETTINGS = dataclasses.replace(
    MASKED, preparation=dataclasses.replace(MASKED.preparation, threshold_fraction=0.0)
)


def lines_of(name: str, arm: Arm) -> list[list[str]]:
    """Of the table: held-out errors, errors on the motion that is judged, and lengths."""
    network = jc.derive(arm.robot, lengths="numeric")
    kinds = [[kind for kind in laws if kind != "static"] for laws in arm.robot.friction_per_joint]
    network = network.with_joint_friction(kinds)
    patterns, solver = SETTINGS.patterns(arm.training), SETTINGS.solver
    result = fit_pre_sliding(network, patterns, solver=solver)
    plain = solver.fit(network, patterns)
    joints = range(1, network.joint_count + 1)
    relative = [result.relative.get(joint) for joint in joints]
    rows = [[name, "held out", *("none" if x is None else str(x) for x in relative)]]
    for test, recording in arm.tests.items():
        motion = SETTINGS.patterns(recording)
        states, torque = (motion.q, motion.qd, motion.qdd), np.asarray(motion.torque)
        without = rms(torque - np.asarray(network.torque(plain.k, *states)), motion)
        with_states = rms(torque - np.asarray(result.torque(*states)[0]), motion)
        rows.append([name, test, *percent(with_states / without)])
    lengths = (f"{1e3 * length:.2g}" if length else "none" for length in result.lengths)
    rows.append([name, "length [mrad]", *lengths])
    return rows


def study(options: argparse.Namespace) -> int:
    """Prints the table."""
    rows: list[list[str]] = []
    for name in command.progress(options.arms, desc="arms", unit="arm"):
        arm = read(name, options.data)
        if options.quick:
            part = 0.4 * float(np.ptp(arm.training.time))
            arm = arm._replace(training=arm.training.between(0.0, part))
        rows += lines_of(name, arm)
    joints = max(map(len, rows)) - 2
    rows = [row + [""] * (joints + 2 - len(row)) for row in rows]
    print(text_table(["arm", "motion", *(str(joint + 1) for joint in range(joints))], rows))
    return 0


def main(argv: Sequence[str] | None = None) -> int:
    parser = command.new_parser(__doc__, "pre_sliding")
    parser.add_argument("--arms", nargs="+", default=list(READERS), help=", ".join(READERS))
    parser.add_argument("--data", type=Path, default=DATA, help="folder of the recordings")
    options = command.parse(parser, argv, arms=["Stäubli TX40"])
    command.require_some_of(parser, "arm", options.arms, tuple(READERS))
    return command.run(parser, lambda: study(options), seconds=30.0 * len(options.arms))


if __name__ == "__main__":
    raise SystemExit(main())
