"""Errors of a simulated SO-101 against a real one, on motions that were not fitted.

Of the public SAGE recordings (isaac-sim2real/sage, `output/real/so101/custom`), four motions are
fitted and twelve others simulated open loop. Errors are root mean squares of simulated minus
measured positions, first over a motion and then over motions. The robot is `jaxcslc example so101`,
whose file has the design's masses. Its hand may lean on the table at the height of its base: the
point that touches is the `gripper_frame_link` of the design.

The same drives are simulated without the table, and in plain MuJoCo with the table. The last row is
of MuJoCo's own servos (gain, damping, friction and armature per joint, one delay), fitted by
`scipy.optimize.least_squares` to simulated positions of the same four motions. It is not repeated.
"""

import argparse
import dataclasses
import sys
import tempfile
import time
from collections.abc import Mapping, Sequence
from pathlib import Path

import numpy as np

import jaxcslc as jc
from jaxcslc.servo import Table, identify_servo, load_servo_recordings, servo_report
from scripts.studies import command, stored


FITTED = ("multisine", "center_workspace", "inertia_coupling", "friction_gravity")
JUDGED = (
    *("actuator_bandwidth", "backlash_detection", "boundary_exploration", "diagonal_sweep"),
    *("frequency_sweep", "hover_positions", "large_amplitude", "random_waypoints"),
    *("single_joint_elbow", "staircase_motion", "static_holding", "velocity_ramp"),
)
NAMES = {
    "shoulder_pan": "Rotation",
    "shoulder_lift": "Pitch",
    "elbow_flex": "Elbow",
    "wrist_flex": "Wrist_Pitch",
    "wrist_roll": "Wrist_Roll",
    "gripper": "Jaw",
}
"""Names of the joints in the recordings."""
HAND, TIP = "gripper_link", (-0.0079, -0.0002, -0.0981)
"""Body that touches the table, and the point that does [m]: `gripper_frame_joint` of the design."""
OTHER = (
    "servos of MuJoCo, `scipy.optimize.least_squares`",
    *("21.5", "7", "27", "36", "11", "11", "12.5"),
)


def row(name: str, errors: Sequence[np.ndarray]) -> list[str]:
    """Return a row of the table: joints 1 to 5 together, and each joint [mrad]."""
    squares = np.mean(np.square(errors), axis=0)
    together = float(np.sqrt(np.mean(squares[:5])))
    return [name, f"{together:.1f}", *(f"{x:.1f}" for x in np.sqrt(squares))]


def study(options: argparse.Namespace) -> int:
    """Fit, simulate, and print the table."""
    with tempfile.TemporaryDirectory() as folder:
        robot = jc.load_robot(jc.examples.write_example("so101", folder).robot)
        columns = Path(folder) / "columns.toml"
        pairs = ", ".join(f'{ours} = "{theirs}"' for ours, theirs in NAMES.items())
        columns.write_text(f"joints = {{{pairs}}}\n", "utf-8")
        joints = list(robot.joint_names)
        recordings = {
            name: next(iter(load_servo_recordings(options.data / name, joints, columns).values()))
            for name in (*FITTED, *JUDGED)
        }
        assert robot.source is not None
        link = robot.source.links.index(HAND)
        x, y, z = (float(v) for v in (robot.source.placements[link] @ [*TIP, 1.0])[:3])
        training = {name: recordings[name] for name in FITTED}
        held_out = {name: recordings[name] for name in JUDGED}
        started = time.perf_counter()
        fit = identify_servo(robot, list(training.values()), table=Table(link, (x, y, z)))
        print(f"identified in {time.perf_counter() - started:.0f} s")
        report = servo_report(fit, training, held_out)
    through = dataclasses.replace(fit, table=None)

    def errors(positions: Mapping[str, np.ndarray]) -> list[np.ndarray]:
        return [
            1e3 * np.sqrt(np.mean((positions[name] - recording.position) ** 2, axis=0))
            for name, recording in held_out.items()
        ]

    rows = [
        row("identified drives", errors(report.simulated)),
        row("their MuJoCo model", errors(report.replayed)),
        row(
            "identified drives, without the table",
            errors({name: through.simulate(x) for name, x in held_out.items()}),
        ),
        list(OTHER),
    ]
    names = ["shoulder pan", "shoulder lift", "elbow", "wrist flex", "wrist roll", "gripper"]
    head = ["", "joints 1 to 5", *names]
    for line in (head, *rows):
        print(" | ".join(line))
    samples = np.array(report.errors(report.simulated))[:5]
    print(f"by samples: {1e3 * float(np.sqrt(np.mean(samples**2))):.1f} mrad at joints 1 to 5")
    stored.store(options, "servo_sage", "twelve held-out motions", {"joints": [head, *rows]})
    return 0


def main(arguments: Sequence[str] | None = None) -> int:
    """Run the study."""
    parser = command.new_parser(__doc__, "servo")
    command.add_store(parser)
    parser.add_argument(
        "--data",
        type=Path,
        default=Path(__file__).resolve().parents[4] / "shared" / "data" / "so101",
        help="folder of the recordings, a folder each",
    )
    options = command.parse(parser, arguments)
    return command.run(parser, lambda: study(options), seconds=120.0)


if __name__ == "__main__":
    sys.exit(main())
