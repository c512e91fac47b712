"""Which smoothing gives the best accelerations of a PUMA 560's quantised positions.

Averaged splines (thesis, Section 7.3), with the spacing that the positions themselves suggest and
with the best one, against zero-phase Butterworth filters with the best cut-off and Savitzky-Golay
filters with the best window. Best means with hindsight: for each joint, trajectory and region the
one setting of all seeds that comes closest to the truth, which no real recording could tell.

What is compared with the derivatives at a sample is the mean of the true accelerations just before
and just after it: the acceleration jumps at each sample, where the torque does, so no smooth
derivative can be closer to both. 'At reversals' is within 0.05 s of a change of
sign of the true velocity; a tenth of a second at both ends of a recording, where all methods see
one side only, is left out.
"""

import argparse
import dataclasses
from collections.abc import Iterable, Sequence
from pathlib import Path
from typing import Any

import jax
import numpy as np
from jaxtyping import Bool, Float
from matplotlib.figure import Figure
from matplotlib.ticker import FormatStrFormatter, LogLocator, NullFormatter
from tqdm import tqdm

import jaxcslc as jc
import sim
from jaxcslc.identification import all_or_nothing, text_table, write_csv
from jaxcslc.motion import AbstractSmoothing, SavitzkyGolay, away_from_reversals, choose_spacing
from jaxcslc.plotting import save_picture


jax.config.update("jax_enable_x64", True)

AT_REVERSAL = 0.05  # s
ENDS = 0.1  # s
# Slower than this a joint is at rest: the simulator's friction creeps.
AT_REST = 1e-6  # rad/s
AWAY, AT = "away from reversals", "at reversals"
CHOSEN = "averaged splines, chosen"
BEST = "averaged splines, best"
TRAJECTORIES = ("training", "comparison")


def candidates() -> dict[str, dict[float, AbstractSmoothing]]:
    """The settings that the best is sought among, by method and by what is varied.

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

    `chosen` by region; `tried` by region, method and setting. NaN where a joint has no sample of
    the region. `spacing` is what was chosen.
    """

    spacing: tuple[int, ...]
    chosen: dict[str, Float[np.ndarray, " joints"]]
    tried: dict[str, dict[str, dict[float, Float[np.ndarray, " joints"]]]]


@dataclasses.dataclass(frozen=True)
class Entry:
    """How one method did at one joint, in one region of one trajectory, over all seeds."""

    trajectory: str
    region: str
    joint: int
    method: str
    setting: str
    rmse: float
    spread: float

    def row(self) -> dict[str, Any]:
        """For a CSV file."""
        return {
            "trajectory": self.trajectory,
            "region": self.region,
            "joint": self.joint,
            "method": self.method,
            "setting": self.setting,
            "acceleration RMSE [rad/s²]": self.rmse,
            "standard deviation over seeds [rad/s²]": self.spread,
        }


def true_acceleration(
    network: jc.CSLC, k: jax.Array, truth: sim.Truth
) -> Float[np.ndarray, "samples joints"]:
    """The mean of the accelerations just before and just after each sample.

    What is recorded begins with the torque of its row. Only the torque jumps at a sample, so
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
    """Which pairs of sample and joint are near a velocity reversal, and which are not."""
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
    judged = regions(truth)

    def squares(smoothing: AbstractSmoothing) -> dict[str, Float[np.ndarray, " joints"]]:
        _, _, qdd = smoothing.smooth(recording.time, recording.position)
        square = (qdd - target) ** 2
        return {region: mean_where(square, where) for region, where in judged.items()}

    spacing = choose_spacing(recording.time, recording.position)
    tried = {
        method: {setting: squares(smoothing) for setting, smoothing in settings.items()}
        for method, settings in candidates().items()
    }
    by_region = {
        region: {
            method: {setting: found[region] for setting, found in settings.items()}
            for method, settings in tried.items()
        }
        for region in judged
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
            here = np.array([found.chosen[region][joint] for found in errors])
            if np.all(np.isnan(here)):
                continue
            spacings = [found.spacing[joint] for found in errors]
            low, high = min(spacings), max(spacings)
            setting = f"{low}" if low == high else f"{low}-{high}"
            place = (trajectory, region, joint + 1)
            entries.append(Entry(*place, CHOSEN, setting, *over_seeds(here)))
            for method, settings in errors[0].tried[region].items():
                tried = {
                    value: over_seeds(
                        np.array([found.tried[region][method][value][joint] for found in errors])
                    )
                    for value in settings
                }
                best = min(tried, key=lambda value: tried[value][0])
                entries.append(Entry(*place, method, f"{best:g}", *tried[best]))
    return entries


def over_seeds(squares: Float[np.ndarray, " seeds"]) -> tuple[float, float]:
    """RMSE over all seeds, and the standard deviation of the seeds' own (NaN of a single one)."""
    known = squares[~np.isnan(squares)]
    spread = float(np.std(np.sqrt(known), ddof=1)) if known.size > 1 else float("nan")
    return float(np.sqrt(np.mean(known))), spread


def grouped(entries: Iterable[Entry]) -> dict[tuple[str, str], dict[str, dict[int, Entry]]]:
    """Entries by trajectory and region, then by method, then by joint."""
    groups: dict[tuple[str, str], dict[str, dict[int, Entry]]] = {}
    for entry in entries:
        group = groups.setdefault((entry.trajectory, entry.region), {})
        group.setdefault(entry.method, {})[entry.joint] = entry
    return groups


def table(entries: Sequence[Entry], joints: int) -> str:
    """One table for each trajectory and region, and who wins each."""
    parts: list[str] = []
    for (trajectory, region), methods in grouped(entries).items():
        rows = [
            [
                method,
                *(
                    f"{found[j].rmse:.3f} ({found[j].setting})" if j in found else "-"
                    for j in range(1, joints + 1)
                ),
                f"{relative(found, methods[CHOSEN]):.2f}",
            ]
            for method, found in methods.items()
        ]
        header = ["", *(f"joint {j}" for j in range(1, joints + 1)), "ratio"]
        wins = ", ".join(
            f"joint {j}: {min(methods, key=lambda m: methods[m][j].rmse)}"
            for j in sorted(methods[CHOSEN])
        )
        least = min(methods, key=lambda m: relative(methods[m], methods[CHOSEN]))
        parts.append(
            f"{trajectory} trajectory, {region}: acceleration RMSE [rad/s²] (setting)\n"
            f"{text_table(header, rows)}\nleast: {wins}; over all joints: {least}"
        )
    return "\n\n".join(parts)


def relative(found: dict[int, Entry], chosen: dict[int, Entry]) -> float:
    """Geometric mean over joints of the RMSE, in units of that of the chosen splines."""
    ratios = [found[joint].rmse / chosen[joint].rmse for joint in found]
    return float(np.exp(np.mean(np.log(ratios))))


def picture(entries: Sequence[Entry], seeds: int) -> Figure:
    """RMSE of every method at every joint, with its spread over seeds; a panel for each region."""
    # Okabe and Ito's palette, told apart by colour-blind readers; shapes tell them apart as well.
    styles = (
        ("#D55E00", "o"),
        ("#E69F00", "s"),
        ("#000000", "x"),
        ("#0072B2", "v"),
        ("#009E73", "^"),
        ("#56B4E9", "D"),
    )
    groups = grouped(entries)
    figure = Figure(figsize=(11, 1.2 + 2.8 * len(groups)), layout="constrained")
    axes = np.atleast_1d(figure.subplots(len(groups), 1))
    for axis, ((trajectory, region), methods) in zip(axes, groups.items(), strict=True):
        apart = 0.6 / len(methods)
        for number, (method, found) in enumerate(methods.items()):
            colour, marker = styles[number % len(styles)]
            joints = np.array(sorted(found))
            axis.errorbar(
                joints + (number - 0.5 * (len(methods) - 1)) * apart,
                [found[j].rmse for j in joints],
                yerr=[found[j].spread for j in joints] if seeds > 1 else None,
                color=colour,
                marker=marker,
                ms=6,
                ls="none",
                elinewidth=1.0,
                label=method,
            )
        axis.set_yscale("log")
        axis.yaxis.set_major_locator(LogLocator(subs=(1.0, 2.0, 5.0)))
        axis.yaxis.set_major_formatter(FormatStrFormatter("%g"))
        axis.yaxis.set_minor_formatter(NullFormatter())
        axis.set_xticks(sorted(methods[CHOSEN]))
        axis.set_ylabel("acceleration RMSE\n[rad/s²]")
        axis.set_title(f"{trajectory} trajectory, {region}", fontsize="medium")
        axis.grid(axis="y", alpha=0.25)
    axes[-1].set_xlabel("joint")
    handles, labels = axes[0].get_legend_handles_labels()
    figure.legend(handles, labels, loc="outside lower center", ncols=3, frameon=False)
    figure.suptitle(
        f"PUMA 560, quantised positions: accelerations by averaged splines and others ({seeds} "
        f"seed{'s' if seeds > 1 else ''})"
    )
    return figure


def main(arguments: Sequence[str] | None = None) -> None:
    parser = argparse.ArgumentParser(description=(__doc__ or "").partition("\n")[0])
    parser.add_argument("-o", "--output", type=Path, default=Path("build/smoothing_study"))
    parser.add_argument("--seeds", type=int, default=10, help="how many of each trajectory")
    given = parser.parse_args(arguments)
    if given.seeds < 1:
        parser.error(f"--seeds is {given.seeds}; expected 1 or more")

    machine = sim.puma560()
    assert machine.robot.links is not None
    network = jc.derive(machine.robot)
    k = network.coefficients_from(machine.robot.links, viscous=machine.viscous, dry=machine.dry)
    trajectories = {"training": sim.training(), "comparison": sim.comparison()}
    jobs = [(name, seed) for seed in range(given.seeds) for name in TRAJECTORIES]
    errors: dict[str, list[Errors]] = {name: [] for name in TRAJECTORIES}
    for name, seed in tqdm(jobs, desc="recordings", unit="recording", disable=None):
        # Different numbers for the two, as in the demonstration: encoders start elsewhere.
        number = 2 * seed + TRAJECTORIES.index(name)
        recording, truth = sim.simulate(machine, trajectories[name], seed=number)
        errors[name].append(measure(recording, truth, true_acceleration(network, k, truth)))
    entries = [entry for name in TRAJECTORIES for entry in summarise(name, errors[name])]
    print(table(entries, machine.joint_count))
    with all_or_nothing(given.output) as folder:
        write_csv(folder / "smoothing.csv", [entry.row() for entry in entries])
        save_picture(picture(entries, given.seeds), folder / "smoothing.png")
    print(f"\nwrote smoothing.csv and smoothing.png into {given.output}")


if __name__ == "__main__":
    main()
