"""Find reversals of joints, and compare the zero-points of smoothed velocities with the true ones.

Section 7.6 says of all reversals identified that the zero-point of the smoothed velocity lies in
the same sampling interval as the true one, which the ramps of static friction show. Here the
simulator knows the rotors' velocities. A joint that rests has a zero-point from the beginning of
the rest to its end. The rows are the zero-points of smoothed velocities of all joints and seeds:

- **at crossings**, **at rests**: the nearest true zero-point is a crossing without a rest, or a
  rest.
- **same interval**: a sampling interval contains both zero-points, or parts of both.
- **within one interval**: the zero-points are at most one sampling interval apart.
- **recordings**: the range of the latter share from recording to recording.

    python -m scripts.studies.puma560.reversals --seeds 16
"""

import argparse
from collections.abc import Iterable, Sequence
from typing import Any, NamedTuple

import numpy as np
from jaxtyping import Bool, Float

import jaxcslc as jc
import sim
from jaxcslc.report import all_or_nothing, write_csv, write_json
from scripts.studies import command
from scripts.studies.tables import rows_table


MACHINES = {"A": sim.puma_a, "B": sim.puma_b}
# A rotor up to this speed rests [rad/s]. One that turns round at 0.1 rad/s² or more is so slow for
# no longer than one sampling interval of 2 ms.
RESTING = 1e-4
# Samples on either side of a reversal that are looked at.
_REACH = 80
# The fewest samples of a ramp, and beside it, that its height is taken from.
_FEWEST = 3


def clean_turn(velocity: Float[np.ndarray, " samples"]) -> int:
    """The sample before the quickest reversal of a joint's velocity: one that does not stick."""
    turns = np.flatnonzero(np.diff(np.sign(velocity)))
    turns = turns[(turns > 100) & (turns < velocity.size - 100)]
    quickness = np.minimum(np.abs(velocity[turns - 20]), np.abs(velocity[turns + 20]))
    return int(turns[np.argmax(quickness)])


class Ramps(NamedTuple):
    """A reversal and the ramps of the error on either side of it (7.6).

    - `joint`: from 0; `sample`: the last one before the reversal.
    - `before`, `after`: heights, positive if the error is along the motion: by how much the mean
      error of speeds below half the threshold exceeds that of speeds from one to three times
      the threshold, as part of dry friction.
    """

    joint: int
    sample: int
    before: float
    after: float

    @property
    def lower(self) -> float:
        """The height of the lower ramp."""
        return min(self.before, self.after)


def clearest_ramps(
    qd: Float[np.ndarray, "samples joints"],
    error: Float[np.ndarray, "samples joints"],
    thresholds: Float[np.ndarray, " joints"],
    dry: Float[np.ndarray, " joints"],
) -> Ramps:
    """The reversal whose lower ramp is highest, among those of all joints.

    A joint that sticks or turns back before it has left the ramp shows none.

    **Arguments**

    - `qd`: estimated velocities, and `error`: measured less predicted torque, of every sample.
    - `thresholds`: speeds below which static friction is significant [rad/s].
    - `dry`: dry friction, in whose units ramps of different joints are compared [N m].

    **Raises**

    - `ValueError`: no reversal has ramps on both sides.
    """
    reversals: list[Ramps] = []
    for joint in range(qd.shape[1]):
        velocity, column = qd[:, joint], error[:, joint]
        for turn in np.flatnonzero(np.diff(np.sign(velocity))):
            if not _REACH <= turn < len(qd) - _REACH:
                continue
            earlier = slice(turn, turn - _REACH, -1)
            later = slice(turn + 1, turn + 1 + _REACH)
            heights = [
                _height(velocity[side], column[side], float(thresholds[joint]))
                for side in (earlier, later)
            ]
            before, after = (float(height / dry[joint]) for height in heights)
            if np.isfinite(before) and np.isfinite(after):
                reversals.append(Ramps(joint, int(turn), before, after))
    if not reversals:
        raise ValueError("no reversal has ramps on both sides; expected a joint that turns round")
    return max(reversals, key=lambda ramps: ramps.lower)


def _height(
    velocity: Float[np.ndarray, " samples"], error: Float[np.ndarray, " samples"], threshold: float
) -> float:
    """The height of a ramp, from the reversal outwards; NaN where there is none."""
    direction, speed = np.sign(velocity[0]), np.abs(velocity)
    same_way = np.logical_and.accumulate(np.sign(velocity) == direction)
    ramp = same_way & np.logical_and.accumulate(speed < threshold / 2)
    beside = same_way & (speed > threshold) & (speed < 3 * threshold)
    if min(ramp.sum(), beside.sum()) < _FEWEST:
        return np.nan
    along = direction * error
    return float(along[ramp].mean() - along[beside].mean())


def zero_points(
    time: Float[np.ndarray, " samples"],
    velocity: Float[np.ndarray, " samples"],
    resting: float = 0.0,
) -> Float[np.ndarray, "points 2"]:
    """Return when a velocity is zero: from and to, which are equal unless the joint rests [s].

    **Arguments**

    - `resting`: the speed up to which a joint rests [rad/s].
    """
    moving = np.abs(velocity) > resting
    turns = np.flatnonzero(moving[:-1] & moving[1:] & (np.diff(np.sign(velocity)) != 0))
    part = velocity[turns] / (velocity[turns] - velocity[turns + 1])
    crossings = time[turns] + part * (time[turns + 1] - time[turns])
    changes = np.diff(np.concatenate([[1], moving, [1]]))
    first, last = time[np.flatnonzero(changes < 0)], time[np.flatnonzero(changes > 0) - 1]
    points = np.stack([np.append(crossings, first), np.append(crossings, last)], axis=1)
    return points[np.argsort(points[:, 0])]


class ZeroPoints(NamedTuple):
    """Zero-points of smoothed velocities, each next to the nearest true one.

    - `distance`: between them [sampling intervals].
    - `same_interval`: whether a sampling interval contains both.
    - `rests`: whether the true one is a rest.
    """

    distance: Float[np.ndarray, " points"]
    same_interval: Bool[np.ndarray, " points"]
    rests: Bool[np.ndarray, " points"]

    @classmethod
    def joined(cls, parts: Iterable["ZeroPoints"]) -> "ZeroPoints":
        """Return the zero-points of several joints or recordings."""
        return cls(*(np.concatenate(fields) for fields in zip(*parts, strict=True)))


def compared_zero_points(
    estimated: Float[np.ndarray, "points 2"],
    true: Float[np.ndarray, "true_points 2"],
    interval: float,
) -> ZeroPoints:
    """Return how far each estimated zero-point is from the nearest true one.

    **Arguments**

    - `estimated`, `true`: from and to, of one joint, from the first sample's time on [s].
    - `interval`: between samples [s].

    **Raises**

    - `ValueError`: no true zero-point.
    """
    if not len(true):
        raise ValueError("the joint's true velocity is never zero; expected a zero-point")
    gaps = np.maximum(true[:, 0] - estimated[:, [1]], estimated[:, [0]] - true[:, 1])
    nearest = np.argmin(gaps, axis=1)
    partners, rows = true[nearest], np.arange(len(estimated))
    # Sampling intervals by number, those that a zero-point begins and ends in.
    began = np.floor(np.maximum(estimated[:, 0], partners[:, 0]) / interval)
    ended = np.floor(np.minimum(estimated[:, 1], partners[:, 1]) / interval)
    distance = np.maximum(gaps[rows, nearest], 0.0) / interval
    return ZeroPoints(distance, began <= ended, partners[:, 1] > partners[:, 0])


def zero_points_of(performed: sim.SimulatedRecording, spacing: int) -> ZeroPoints:
    """Return the zero-points of all joints' smoothed velocities in a recording (7.3, 7.6).

    **Arguments**

    - `spacing`: of the averaged splines [samples].
    """
    recording, truth = performed
    patterns = jc.prepare(recording, smoothing=jc.AveragedSplines(spacing), thresholds=0.0)
    time, velocity = np.asarray(patterns.time), np.asarray(patterns.qd)
    interval = float(np.median(np.diff(truth.time)))
    parts: list[ZeroPoints] = []
    for joint in range(velocity.shape[1]):
        estimated = zero_points(time, velocity[:, joint])
        true = zero_points(truth.time, truth.rotor_velocity[:, joint], RESTING)
        if len(estimated):
            parts.append(compared_zero_points(estimated, true, interval))
    return ZeroPoints.joined(parts)


def row_of(name: str, recordings: Sequence[ZeroPoints]) -> dict[str, Any]:
    """Return shares over the recordings of several seeds."""
    points = ZeroPoints.joined(recordings)
    near = points.distance <= 1.0
    shares = [100 * float(np.mean(part.distance <= 1.0)) for part in recordings]

    def percent(of: Bool[np.ndarray, " points"], among: Bool[np.ndarray, " points"]) -> str:
        return f"{100 * np.mean(of[among]):.1f}" if np.any(among) else "-"

    everywhere = np.ones_like(near)
    return {
        "recording": name,
        "zero-points": near.size,
        "at rests": int(np.sum(points.rests)),
        "same interval [%]": percent(points.same_interval, everywhere),
        "within one interval [%]": percent(near, everywhere),
        "at crossings [%]": percent(near, ~points.rests),
        "at rests [%]": percent(near, points.rests),
        "recordings [%]": f"{min(shares):.0f} to {max(shares):.0f}",
        "farthest [intervals]": float(np.max(points.distance)),
    }


def study(options: argparse.Namespace) -> int:
    """Simulate, compare zero-points, print the table and write it."""
    jobs: dict[str, list[sim.Job]] = {}
    for letter, build in MACHINES.items():
        machine = build()
        trajectories = {
            "training": sim.training(),
            "training, own gravity": sim.training(robot=machine.robot),
            "comparison": sim.comparison(),
        }
        for name, trajectory in trajectories.items():
            seeds = command.seeds_of(options)
            jobs[f"PUMA {letter}, {name}"] = [sim.Job(machine, trajectory, seed) for seed in seeds]
    in_order = [job for part in jobs.values() for job in part]
    performed = iter(sim.record(in_order, progress=True))
    rows = [
        row_of(name, [zero_points_of(next(performed), options.spacing) for _ in part])
        for name, part in jobs.items()
    ]
    print(rows_table(rows))
    with all_or_nothing(options.output) as folder:
        write_csv(folder / "zero_points.csv", rows)
        arguments = vars(options) | {"output": str(options.output)}
        write_json(folder / "zero_points.json", {"rows": rows, "command": arguments})
    print(f"wrote {options.output}")
    return 0


def main(argv: Sequence[str] | None = None) -> int:
    parser = command.new_parser(__doc__, "zero_points")
    command.add_seeds(parser, 16)
    parser.add_argument("--spacing", type=int, default=9, help="of the averaged splines [samples]")
    options = command.parse(parser, argv, seeds=1)
    command.require_least(parser, options, seeds=1, first=0, spacing=2)
    return command.run(parser, lambda: study(options), seconds=10.0 + 3.0 * options.seeds)


if __name__ == "__main__":
    raise SystemExit(main())
