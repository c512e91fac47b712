"""Which smoothing gives the best accelerations of a PUMA 560's quantised positions.

Averaged splines (thesis, Section 7.3), with the spacing that is selected from the positions and
with the best one, against zero-phase Butterworth filters with the best cut-off and Savitzky-Golay
filters with the best window. Best means with hindsight: for each joint, trajectory and region the
one setting for all seeds that comes closest to the truth, which no real recording determines.

What is compared with the derivatives at a sample is the mean of the true accelerations just before
and just after it: the acceleration jumps at each sample, where the torque does, so no smooth
derivative can be closer to both. 'At reversals' is within 0.05 s of a change of
sign of the true velocity; a tenth of a second at both ends of a recording, where methods have
samples on one side only, is left out.
"""

import argparse
import dataclasses
from collections.abc import Sequence
from pathlib import Path
from typing import Any

import jax
import numpy as np
from jaxtyping import Bool, Float

import jaxcslc as jc
import sim
from jaxcslc.recordings import AbstractSmoothing, SavitzkyGolay, away_from_reversals, choose_spacing
from jaxcslc.report import all_or_nothing, write_csv
from scripts.studies import command
from scripts.studies.figures import save_picture
from scripts.studies.rows import Rows, made_of
from scripts.studies.smoothing.results import SELECTED, Entry, picture, table
from scripts.studies.truth import true_coefficients


jc.enable_x64()

AT_REVERSAL = 0.05  # s
ENDS = 0.1  # s
# Slower than this a joint is at rest: the simulator's friction creeps.
AT_REST = 1e-6  # rad/s
AWAY, AT = "away from reversals", "at reversals"
BEST = "averaged splines, best"
TRAJECTORIES = ("training", "comparison")


def candidates() -> dict[str, dict[float, AbstractSmoothing]]:
    """Smoothings by method and by setting.

    Spacings, cut-offs and windows are in steps of about a fifth.
    """
    spacings = (3, 5, 7, 9, 11, 13, 15, 17, 21, 25, 29, 35, 41, 49)
    cutoffs = (
        5.0,
        6.0,
        7.0,
        8.5,
        10.0,
        12.0,
        14.0,
        17.0,
        20.0,
        24.0,
        29.0,
        35.0,
        42.0,
        50.0,
        60.0,
        72.0,
        86.0,
    )
    windows = (9, 11, 13, 15, 19, 23, 27, 33, 39, 47, 57, 69, 83, 99, 119)
    return {
        BEST: {j: jc.AveragedSplines(j) for j in spacings},
        "undivided splines, best": {j: jc.AveragedSplines(j, sections=False) for j in spacings},
        "Butterworth, best": {f: jc.Butterworth(f) for f in cutoffs},
        # The second derivative of order 3 is that of order 2: in a symmetric window, odd powers
        # have no part in it.
        "Savitzky-Golay 2 and 3, best": {w: SavitzkyGolay(w, 3) for w in windows},
        "Savitzky-Golay 4, best": {w: SavitzkyGolay(w, 4) for w in windows},
    }


@dataclasses.dataclass(frozen=True)
class Errors:
    """Mean squared errors of one recording's accelerations, joint by joint [rad²/s⁴].

    `selected` by region, for averaged splines of the selected `spacing`; `trials` by region, method
    and setting. NaN where a joint has no sample of the region.
    """

    spacing: tuple[int, ...]
    selected: dict[str, Float[np.ndarray, " joints"]]
    trials: dict[str, dict[str, dict[float, Float[np.ndarray, " joints"]]]]

    def row(self) -> dict[str, Any]:
        """Lists and text, for a file of rows."""
        listed = {
            region: {
                method: [[setting, square.tolist()] for setting, square in settings.items()]
                for method, settings in methods.items()
            }
            for region, methods in self.trials.items()
        }
        selected = {region: square.tolist() for region, square in self.selected.items()}
        return {"spacing": list(self.spacing), "selected": selected, "trials": listed}

    @classmethod
    def of_row(cls, row: dict[str, Any]) -> "Errors":
        """Return it from what `row` returned."""
        trials = {
            region: {
                method: {setting: np.array(square) for setting, square in settings}
                for method, settings in methods.items()
            }
            for region, methods in row["trials"].items()
        }
        selected = {region: np.array(square) for region, square in row["selected"].items()}
        return cls(tuple(row["spacing"]), selected, trials)


def true_acceleration(
    network: jc.CSLC, k: jax.Array, truth: sim.Truth
) -> Float[np.ndarray, "samples joints"]:
    """The mean of the accelerations just before and just after each sample.

    A recorded row begins with its torque. Only the torque jumps at a sample, so
    just before it the acceleration was less by M⁻¹ times that jump, over the joints that move.
    """
    jump = np.diff(truth.torque, axis=0, prepend=truth.torque[:1])
    moving = np.abs(truth.velocity) > AT_REST
    mass = np.asarray(network.mass_matrix(k, truth.position))
    both = moving[:, :, None] & moving[:, None, :]
    free = np.where(both, mass, np.eye(mass.shape[-1]))
    step = np.linalg.solve(free, np.where(moving, jump, 0.0)[..., None])[..., 0]
    return truth.acceleration - 0.5 * step


def regions(truth: sim.Truth) -> dict[str, Bool[np.ndarray, "samples joints"]]:
    """Return which pairs of sample and joint are near a velocity reversal, and which are not."""
    interval = float(np.median(np.diff(truth.time)))
    velocity = np.where(np.abs(truth.velocity) < AT_REST, 0.0, truth.velocity)
    away = away_from_reversals(velocity, round(AT_REVERSAL / interval))
    inside = np.zeros(len(away), dtype=bool)
    end = round(ENDS / interval)
    inside[end : len(away) - end] = True
    return {AWAY: away & inside[:, None], AT: ~away & inside[:, None]}


def measure(
    recording: jc.Recording, truth: sim.Truth, target: Float[np.ndarray, "samples joints"]
) -> Errors:
    """Smooth one recording by every candidate and compare its accelerations with the target."""
    masks = regions(truth)

    def squares(smoothing: AbstractSmoothing) -> dict[str, Float[np.ndarray, " joints"]]:
        _, _, qdd = smoothing.smooth(recording.time, recording.position)
        square = (qdd - target) ** 2
        return {region: mean_where(square, where) for region, where in masks.items()}

    spacing = choose_spacing(recording.time, recording.position)
    by_method = {
        method: {setting: squares(smoothing) for setting, smoothing in settings.items()}
        for method, settings in candidates().items()
    }
    by_region = {
        region: {
            method: {setting: of_regions[region] for setting, of_regions in settings.items()}
            for method, settings in by_method.items()
        }
        for region in masks
    }
    return Errors(spacing, squares(jc.AveragedSplines(spacing)), by_region)


def mean_where(
    values: Float[np.ndarray, "samples joints"], where: Bool[np.ndarray, "samples joints"]
) -> Float[np.ndarray, " joints"]:
    """The mean of each joint's values in a region, NaN where it has none."""
    count = np.sum(where, axis=0)
    total = np.sum(np.where(where, values, 0.0), axis=0)
    return np.where(count > 0, total / np.maximum(count, 1), np.nan)


def summarise(trajectory: str, errors: Sequence[Errors]) -> list[Entry]:
    """Every method with its best setting, joint by joint and region by region."""
    entries: list[Entry] = []
    joints = len(errors[0].spacing)
    for region in (AWAY, AT):
        for joint in range(joints):
            squares = np.array([of_seed.selected[region][joint] for of_seed in errors])
            if np.all(np.isnan(squares)):
                continue
            spacings = [of_seed.spacing[joint] for of_seed in errors]
            low, high = min(spacings), max(spacings)
            setting = f"{low}" if low == high else f"{low}-{high}"
            case = (trajectory, region, joint + 1)
            entries.append(Entry(*case, SELECTED, setting, *over_seeds(squares)))
            for method, settings in errors[0].trials[region].items():
                results = {
                    value: over_seeds(
                        np.array(
                            [of_seed.trials[region][method][value][joint] for of_seed in errors]
                        )
                    )
                    for value in settings
                }
                best = min(results, key=lambda value: results[value][0])
                entries.append(Entry(*case, method, f"{best:g}", *results[best]))
    return entries


def over_seeds(squares: Float[np.ndarray, " seeds"]) -> tuple[float, float]:
    """RMSE over all seeds, and the standard deviation of the seeds' RMSE (NaN of a single one)."""
    finite = squares[~np.isnan(squares)]
    spread = float(np.std(np.sqrt(finite), ddof=1)) if finite.size > 1 else float("nan")
    return float(np.sqrt(np.mean(finite))), spread


def study(options: argparse.Namespace) -> int:
    """Measures all recordings, prints the table and writes the files."""
    machine = sim.puma560()
    network = jc.derive(machine.robot)
    k = true_coefficients(network, machine)
    trajectories = {"training": sim.training(), "comparison": sim.comparison()}
    digest = made_of({}, [Path(__file__)])
    rows = Rows(options.output / "rows.jsonl", ("trajectory", "seed"), digest)
    keys = [(name, seed) for seed in range(options.seeds) for name in TRAJECTORIES]
    missing = [key for key in keys if key not in rows]
    with command.progress(
        desc="recordings", unit="recording", total=len(keys), initial=len(keys) - len(missing)
    ) as bar:
        for name, seed in missing:
            # Two numbers a seed: the encoders of the two recordings start elsewhere.
            number = 2 * seed + TRAJECTORIES.index(name)
            recording, truth = sim.simulate(machine, trajectories[name], seed=number)
            measured = measure(recording, truth, true_acceleration(network, k, truth))
            rows.add({"trajectory": name, "seed": seed, **measured.row()})
            bar.update()
    errors = {
        name: [Errors.of_row(rows[name, seed]) for seed in range(options.seeds)]
        for name in TRAJECTORIES
    }
    entries = [entry for name in TRAJECTORIES for entry in summarise(name, errors[name])]
    print(table(entries, machine.joint_count))
    with all_or_nothing(options.output) as folder:
        write_csv(folder / "smoothing.csv", [entry.row() for entry in entries])
        save_picture(picture(entries, options.seeds), folder / "smoothing.png")
    print(f"\nwrote smoothing.csv and smoothing.png into {options.output}")
    return 0


def main(argv: Sequence[str] | None = None) -> int:
    parser = command.new_parser(__doc__, "smoothing_study")
    parser.add_argument("--seeds", type=int, default=10, help="how many of each trajectory")
    options = command.parse(parser, argv, seeds=1)
    command.require_least(parser, options, seeds=1)
    return command.run(
        parser,
        lambda: study(options),
        options.output / "rows.jsonl",
        seconds=10 + 14 * options.seeds,
    )


if __name__ == "__main__":
    raise SystemExit(main())
