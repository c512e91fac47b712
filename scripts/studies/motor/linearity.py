"""Does a motor deliver the demanded torque? The experiment of 7.2.3, on two simulated machines.

The thesis tests joint 2, and joint 3 as a double-check (`--joint 3 --limit 25`): the tested link
oscillates about the horizontal, while all other joints are locked.

One PUMA 560 whose motors are linear, and one whose limit of linearity lies within the experiment's
range. On the first the heaviest weight's measurement lies on the line through the others, as in
Fig. 7.2-2; on the second it lies above.
"""

import argparse
import dataclasses
import math
from collections.abc import Sequence
from pathlib import Path

import numpy as np

import jaxcslc as jc
import sim
from jaxcslc.report import all_or_nothing, write_csv
from scripts.studies import command
from scripts.studies.figures import save_picture
from scripts.studies.motor.pictures import motor_curve_picture, motor_response_picture
from scripts.studies.rows import Rows, made_of


jc.enable_x64()

# The thesis's datum for all other motors.
_JOINT = 2
_OPTIONS = ("joint", "limit", "masses", "period", "swings", "seed")


def limited(machine: sim.Machine, limit: float, joint: int = _JOINT) -> sim.Machine:
    """Return a machine with a limit of linearity of one joint [N m], and of all others in
    proportion to their greatest torques (7.2.3)."""
    share = limit / machine.maximum_torque[joint - 1]
    return dataclasses.replace(
        machine, linear_torque=tuple(share * most for most in machine.maximum_torque)
    )


def measured(name: str, machine: sim.Machine, options: argparse.Namespace) -> sim.MotorLinearity:
    """The measurements of one machine, from the file of finished ones or made now."""
    numbers = {key: getattr(options, key) for key in _OPTIONS}
    finished = Rows(options.output / "rows.jsonl", ("machine",), made_of(numbers, [Path(__file__)]))
    if (name,) not in finished:
        result = sim.motor_linearity(
            machine,
            **{key: numbers[key] for key in _OPTIONS if key != "limit"},
            progress=lambda masses: command.progress(masses, desc=f"{name} machine", unit="weight"),
        )
        pairs = {"mass": result.mass.tolist(), "torque": result.torque.tolist()}
        finished.add({"machine": name, **pairs})
    row = finished[(name,)]
    return sim.MotorLinearity.of(options.joint, np.array(row["mass"]), np.array(row["torque"]))


def table(result: sim.MotorLinearity) -> str:
    """Measurements beside the line through all but the heaviest."""
    lines = ["mass [kg]  mean torque [N m]  above the line [N m]"]
    for mass, torque, residual in zip(result.mass, result.torque, result.residual, strict=True):
        lines.append(f"{mass:9.2f}  {torque:17.3f}  {residual:20.3f}")
    lines.append(
        f"line through all but the heaviest: {result.intercept:.3f} N m"
        f" + {result.slope:.4f} N m/kg, scatter {result.scatter:.3f} N m"
    )
    lines.append(f"the heaviest lies {result.excess:+.3f} N m from it")
    return "\n".join(lines)


def rows(result: sim.MotorLinearity) -> list[dict[str, float]]:
    """A row for each measurement."""
    return [
        {"mass": float(mass), "mean_torque": float(torque), "above_line": float(residual)}
        for mass, torque, residual in zip(result.mass, result.torque, result.residual, strict=True)
    ]


def study(options: argparse.Namespace) -> int:
    """Measures both machines, prints the tables and writes tables and pictures."""
    machines = {
        "linear": sim.puma560(),
        "limited": limited(sim.puma560(), options.limit, options.joint),
    }
    results = {name: measured(name, machine, options) for name, machine in machines.items()}
    for name, result in results.items():
        limit = machines[name].linear_torque[options.joint - 1]
        limit_text = "none" if math.isinf(limit) else f"{limit:g} N m"
        print(f"\n{name} machine, limit of linearity of joint {options.joint}: {limit_text}")
        print(table(result))
    with all_or_nothing(options.output) as folder:
        for name, result in results.items():
            write_csv(folder / f"{name}.csv", rows(result))
            figure = motor_response_picture(
                result.mass,
                result.torque,
                title=f"PUMA 560, joint {options.joint}, {name} machine: weights on the flange",
            )
            save_picture(figure, folder / f"{name}.png")
        drives = sim.Drives.of(machines["limited"])
        demanded = np.linspace(0.0, drives.most, 200)
        figure = motor_curve_picture(
            demanded[:, options.joint - 1],
            drives.torque(demanded)[:, options.joint - 1],
            limit=options.limit,
            title=f"PUMA 560, joint {options.joint}, limited machine: motor response",
        )
        save_picture(figure, folder / "motor_curve.png")
    print(f"\nwrote tables and pictures into {options.output}")
    return 0


def main(argv: Sequence[str] | None = None) -> int:
    parser = command.new_parser(__doc__, "motor_linearity")
    parser.add_argument("--seed", type=int, default=1, help="of encoders and starts")
    parser.add_argument("--joint", type=int, choices=(2, 3), default=_JOINT, help="that is tested")
    parser.add_argument(
        "--limit", type=float, default=70.0, help="of linearity of that joint, second machine [N m]"
    )
    parser.add_argument(
        "--masses",
        type=float,
        nargs="+",
        default=[0, 0, 0, 0.5, 1, 1.5, 2, 2.5, 3, 3.5, 4, 4.5],
        help="suspended weights, one for each measurement [kg]",
    )
    parser.add_argument("--period", type=float, default=2.0, help="of an oscillation [s]")
    parser.add_argument("--swings", type=int, default=3, help="whole oscillations averaged")
    options = command.parse(parser, argv, masses=[0, 1.5, 4.5], swings=1, period=1.0)
    moved = len(options.masses) * (options.swings + 1) * options.period
    return command.run(
        parser,
        lambda: study(options),
        options.output / "rows.jsonl",
        seconds=10.0 + 0.2 * moved,
    )


if __name__ == "__main__":
    raise SystemExit(main())
