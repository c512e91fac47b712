"""Trials of the training trajectory until each joint sweeps most of its range (7.4.1).

The thesis adjusts the amplitudes of the training torques between successive trials. Here amplitudes
and the start of both simulated PUMA 560s are adjusted at random: a trial is kept if it comes nearer
to all of these, on both machines.

- Each joint sweeps `SWEPT` of its range or more.
- No demand exceeds `LINEAR` of the torque at which the joint's motor is no longer linear.
- No joint comes nearer than `MARGIN` to an end of its range, where it would be repelled.

`sim.adjusted_training` is from several searches of this kind, the last with a margin of 0.01 rad.
Without `--trials`, the table says what it sweeps.

    python -m scripts.studies.puma560.trials
    python -m scripts.studies.puma560.trials --trials 600
"""

import argparse
from collections.abc import Sequence
from typing import Any

import numpy as np
from jaxtyping import Float

import sim
from jaxcslc.report import all_or_nothing, write_csv
from scripts.studies import command
from scripts.studies.puma560.machines import machines
from scripts.studies.tables import rows_table


SWEPT = 0.6  # of each joint's range: its majority (7.4.1)
LINEAR = 0.9  # of the limit of linearity
MARGIN = 0.1  # rad, two widths of the repulsion from the ends of the ranges
# Weights of the part of a range not swept, of the part of a limit exceeded, and of a missing
# margin [1/rad]; a choice.
_WEIGHTS = (3.0, 2.0, 2.0)
_PERIOD = (4.1, 2.7, 1.7, 1.1, 0.7, 1.3)  # s
_FIRST_AMPLITUDE = (-25.0, -13.0, 14.0, -8.0, 10.0, -10.0)  # N m
_FIRST_START = (0.0, -1.5, 1.3, 0.2, 0.15, 0.0)  # rad
_STEP = 0.3  # of an amplitude, in parts of it; of a start, 1.5 times as much in rad
_SMALLER = 0.97  # a step's factor after a trial that is not kept
_ADJUSTED_AT_ONCE = 0.3  # share of the numbers that a trial changes

Reached = dict[str, Float[np.ndarray, " joints"]]


def reached(machine: sim.Machine, trajectory: sim.Trajectory, seed: int = 1) -> Reached | None:
    """Return what a trial reaches on a machine, by column of the table.

    **Returns** None if a joint leaves its range.
    """
    try:
        recording = sim.simulate(machine, trajectory, seed=seed).recording
    except sim.SimulationError:
        return None
    q = recording.position
    low, high = np.array(machine.position_range).T
    return {
        "swept part of the range [%]": 100 * np.ptp(q, axis=0) / (high - low),
        "greatest demand [N m]": np.max(np.abs(recording.torque), axis=0),
        "part of the limit of linearity [%]": 100
        * np.max(np.abs(recording.torque), axis=0)
        / np.array(machine.linear_torque),
        "distance from the ends of the range [rad]": np.min(np.minimum(q - low, high - q), axis=0),
    }


def shortfall(trial: Reached | None) -> float:
    """Return how far a trial is from what is wanted: 0 if it has all of it."""
    if trial is None:
        return float("inf")
    swept, _, demand, distance = trial.values()
    swept_weight, demand_weight, margin_weight = _WEIGHTS
    return float(
        swept_weight * np.sum(np.maximum(SWEPT - swept / 100, 0.0))
        + demand_weight * np.sum(np.maximum(demand / 100 - LINEAR, 0.0))
        + margin_weight * np.sum(np.maximum(MARGIN - distance, 0.0))
    )


def adjusted(options: argparse.Namespace) -> sim.Trajectory:
    """Return the best of some trials, whose numbers are printed whenever one is kept."""
    rng = np.random.default_rng(options.seed)
    both = list(machines().values())

    def tried(numbers: np.ndarray) -> tuple[float, sim.Trajectory]:
        trajectory = sim.training(
            amplitude=tuple(numbers[:6].tolist()),
            period=_PERIOD,
            start=tuple(numbers[6:].tolist()),
        )
        return sum(shortfall(reached(machine, trajectory)) for machine in both), trajectory

    best = np.array([*_FIRST_AMPLITUDE, *_FIRST_START])
    least, trajectory = tried(best)
    step = _STEP
    for _ in command.progress(range(options.trials), desc="trials", unit="trial"):
        if least == 0.0:
            break
        change = step * rng.standard_normal(12) * (rng.random(12) < _ADJUSTED_AT_ONCE)
        numbers = np.concatenate([best[:6] * np.exp(change[:6]), best[6:] + 1.5 * change[6:]])
        missing, other = tried(numbers)
        if missing < least:
            best, least, trajectory = numbers, missing, other
            print(f"short by {least:.3f}: {best.round(2).tolist()}", flush=True)
        else:
            step *= _SMALLER
    return trajectory


def sweep_rows(trajectory: sim.Trajectory) -> list[dict[str, Any]]:
    """Return a row for each joint of both machines."""
    rows: list[dict[str, Any]] = []
    for name, machine in machines().items():
        trial = reached(machine, trajectory)
        if trial is None:
            rows.append({"machine": name, "joint": "leaves its range"})
            continue
        for joint in range(machine.joint_count):
            columns = {column: float(values[joint]) for column, values in trial.items()}
            rows.append({"machine": name, "joint": joint + 1, **columns})
    return rows


def study(options: argparse.Namespace) -> int:
    """Adjust the trajectory, or take the library's; print and write the table."""
    trajectory = adjusted(options) if options.trials else sim.adjusted_training()
    rows = sweep_rows(trajectory)
    print(rows_table(rows))
    with all_or_nothing(options.output) as folder:
        write_csv(folder / "sweeps.csv", rows)
    print(f"wrote {options.output}")
    return 0


def main(argv: Sequence[str] | None = None) -> int:
    parser = command.new_parser(__doc__, "trials")
    parser.add_argument("--trials", type=int, default=0, help="how many; 0 for the library's own")
    parser.add_argument("--seed", type=int, default=0, help="of the changes")
    options = command.parse(parser, argv, trials=2)
    command.require_least(parser, options, trials=0, seed=0)
    return command.run(parser, lambda: study(options), None, seconds=5.0 + 2.0 * options.trials)


if __name__ == "__main__":
    raise SystemExit(main())
