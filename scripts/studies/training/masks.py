"""Compare what masks leave out: slow pairs of everything, of friction only, or nothing (7.2.2).

PUMA A and B with all disturbances of Section 7.2 make a training and a comparison recording per
seed. Each set of masks has the weights at which backpropagation ends (`NormalEquations.solution`):
the direct solve, where all subnetworks learn from the same pairs. Slow pairs are below one
hundredth of a joint's greatest speed (7.5). Each set is solved with the backlash mask (Eqn. 2.5-7),
without it, and with the same mask shuffled over time. The last loses as many pairs per joint, and
does not select them by the sign of the torque.

- **ε** (7.5) is on the comparison recording, divided by that of the true coefficients.
- **Errors of torque** are root mean squares over the comparison's pairs [N m]. They are of the
  torque by the wrong part of the coefficients: of friction, and of all others (rigid bodies).
- **Residuals** are what true coefficients leave on the training recording, times the sign of the
  velocity, averaged per joint [N m]. Disturbances that no coefficient explains have such a mean of
  about zero. A mask that selects pairs by the sign of the torque shifts it.
- **Signs** of the smoothed velocity are compared with the true ones at slow pairs.

Rows of finished seeds are kept in `rows.jsonl`; an interrupted run goes on from there.

    python -m scripts.studies.training.masks
    python -m scripts.studies.training.masks --seeds 32 --threshold 0.03
    python -m scripts.studies.training.masks --amplitude 25 13 14 8 10 14
"""

import argparse
import dataclasses
from collections.abc import Callable, Mapping, Sequence
from itertools import product
from pathlib import Path
from typing import Any

import equinox as eqx
import numpy as np
from jaxtyping import Array, Bool, Float

import jaxcslc as jc
import sim
from jaxcslc._text_table import text_table
from jaxcslc.report import all_or_nothing, write_csv
from jaxcslc.training import (
    AdaptiveNetwork,
    examples,
    inverse_dynamics,
    normal_equations,
    subnetwork_masks,
)
from scripts.studies import command
from scripts.studies.rows import Rows, made_of
from scripts.studies.tables import median_text
from scripts.studies.truth import true_coefficients


jc.enable_x64()

MACHINES = {"A": sim.puma_a, "B": sim.puma_b}
OPTIONS = ("samples", "threshold", "amplitude")
# What slow pairs are left out of, and whether there is a backlash mask.
SLOW = ("everything", "friction only", "nothing")
BACKLASH = ("yes", "no", "shuffled")
# Of both recordings, as in the trainings of `cslc.py`.
_ALIGNMENT = "mean"
_COMPARISON = jc.Preparation(jc.AveragedSplines(17), torque_alignment=_ALIGNMENT, thresholds=0.05)
# Of training torques [N m]. With the 13 N m of 7.4.1 at joint 2, it stands still for half of PUMA
# A's recording, and a quarter of PUMA B's.
_AMPLITUDE = (25.0, 20.0, 14.0, 8.0, 10.0, 14.0)
# Recordings made side by side: few enough to lose little by an interruption.
_SEEDS_AT_ONCE = 4

Torques = Float[np.ndarray, "samples joints"]


@dataclasses.dataclass(frozen=True)
class Case:
    """One set of masks.

    **Attributes**

    - `backlash`: whether pairs in possible backlash are left out (Eqn. 2.5-7), one of `BACKLASH`.
    - `slow`: what slow pairs are left out of, one of `SLOW`.
    """

    backlash: str
    slow: str

    def masks(
        self, network: AdaptiveNetwork, patterns: jc.Patterns
    ) -> Bool[np.ndarray, "subnetworks samples joints"]:
        """Return the pairs that each subnetwork learns from."""
        every = np.ones(patterns.q.shape, bool)
        if self.backlash != "yes":
            shuffled = np.random.default_rng(0).permuted(patterns.backlash_mask, axis=0)
            other = shuffled if self.backlash == "shuffled" else every
            patterns = eqx.tree_at(lambda p: p.backlash_mask, patterns, other)
        if self.slow == "nothing":
            patterns = eqx.tree_at(lambda p: p.friction_mask, patterns, every)
        if self.slow == "friction only":
            return subnetwork_masks(network, patterns)
        return np.broadcast_to(np.asarray(patterns.mask), (len(network.groups), *every.shape))

    @property
    def cells(self) -> list[str]:
        """Return its words in a table."""
        return [self.slow, self.backlash]

    @property
    def key(self) -> str:
        """Return its name in a row."""
        return "/".join(self.cells)


CASES = [Case(*case) for case in product(BACKLASH, SLOW)]


@eqx.filter_jit
def solved(
    network: AdaptiveNetwork,
    motion: tuple[Torques, Torques, Torques],
    torque: Torques,
    masks: Bool[np.ndarray, "subnetworks samples joints"],
) -> Float[Array, " coefficients"]:
    """Return the weights at which backpropagation with these masks ends."""
    return normal_equations(network, examples(network, motion, torque, masks)).solution()


def coefficients_of(
    network: AdaptiveNetwork, patterns: jc.Patterns
) -> dict[str, Float[Array, " coefficients"]]:
    """Return the coefficients by each set of masks."""
    motion, torque = _motion(patterns), np.asarray(patterns.torque)
    return {
        case.key: solved(network, motion, torque, case.masks(network, patterns)) for case in CASES
    }


def errors_of_torque(
    cslc: jc.CSLC,
    patterns: jc.Patterns,
    wrong: Float[np.ndarray, " coefficients"],
) -> dict[str, float]:
    """Return what wrong parts of coefficients do to the torque, root mean squares [N m]."""
    kinds = [term.kind for term in cslc.input_terms]
    friction = np.zeros(cslc.size, bool)
    friction[np.concatenate([cslc.layout.indices(kind) for kind in kinds])] = True
    mask = np.asarray(patterns.mask)
    parts = {"friction": np.where(friction, wrong, 0.0), "rigid": np.where(friction, 0.0, wrong)}
    return {
        name: float(np.sqrt(np.mean(np.asarray(cslc.torque(k, *_motion(patterns)))[mask] ** 2)))
        for name, k in parts.items()
    }


def _motion(patterns: jc.Patterns) -> tuple[Torques, Torques, Torques]:
    return np.asarray(patterns.q), np.asarray(patterns.qd), np.asarray(patterns.qdd)


def residual_figures(
    cslc: jc.CSLC,
    patterns: jc.Patterns,
    truth: Float[np.ndarray, " coefficients"],
    true_velocity: Torques,
) -> dict[str, list[float]]:
    """Return per joint: mean residuals times the velocity's sign, and signs that are wrong.

    **Arguments**

    - `truth`: the true coefficients.
    - `true_velocity`: of the patterns' instants [rad/s].
    """
    residual = np.asarray(patterns.torque) - np.asarray(cslc.torque(truth, *_motion(patterns)))
    along = residual * np.sign(np.asarray(patterns.qd))
    slow, kept = ~np.asarray(patterns.friction_mask), np.asarray(patterns.backlash_mask)
    wrong = np.sign(np.asarray(patterns.qd)) != np.sign(true_velocity)
    everywhere = np.ones(slow.shape, bool)
    return {
        "all pairs": _means(along, everywhere),
        "kept by the backlash mask": _means(along, kept),
        "left out by the backlash mask": _means(along, ~kept),
        "slow pairs": _means(along, slow),
        "|residual|, slow pairs": _means(np.abs(residual), slow),
        "|residual|, other pairs": _means(np.abs(residual), ~slow),
        "share of slow pairs": _means(slow.astype(float), everywhere),
        "share kept by the backlash mask": _means(kept.astype(float), everywhere),
        "slow pairs of wrong sign": _means(wrong.astype(float), slow),
    }


def _means(values: Torques, where: Bool[np.ndarray, "samples joints"]) -> list[float]:
    """Return the mean per joint over some pairs."""
    number = np.maximum(where.sum(axis=0), 1)
    return (np.where(where, values, 0.0).sum(axis=0) / number).tolist()


def figures_of(
    cslc: jc.CSLC,
    network: AdaptiveNetwork,
    machine: sim.Machine,
    results: Sequence[sim.SimulatedRecording | sim.SimulationError],
    threshold: float,
) -> dict[str, Any]:
    """Return what a row holds of a seed.

    **Arguments**

    - `results`: the training and the comparison recording, or the error that ended one.
    - `threshold`: part of a joint's greatest speed that is slow.

    **Raises** `SimulationError` if one of the recordings was not made.
    """
    recorded: list[sim.SimulatedRecording] = []
    for result in results:
        if isinstance(result, sim.SimulationError):
            raise result
        recorded.append(result)
    (recording, motion), (compared, _) = recorded
    preparation = jc.Preparation(
        torque_alignment=_ALIGNMENT, threshold_fraction=threshold, backlash=True
    )
    patterns = preparation.patterns(recording)
    judged = _COMPARISON.patterns(compared)
    truth = np.asarray(true_coefficients(cslc, machine))
    by_case = coefficients_of(network, patterns)
    epsilon = np.asarray(jc.compare(cslc, judged, {"truth": truth, **by_case}).epsilon)
    samples = np.searchsorted(recording.time, np.asarray(patterns.time))
    return {
        "true ε": float(epsilon[0]),
        "ε": {case: float(e / epsilon[0]) for case, e in zip(by_case, epsilon[1:], strict=True)},
        "errors": {
            case: errors_of_torque(cslc, judged, np.asarray(k) - truth)
            for case, k in by_case.items()
        },
        "residuals": residual_figures(cslc, patterns, truth, motion.velocity[samples]),
    }


def make_rows(
    options: argparse.Namespace, rows: Rows, show: Callable[[Mapping[str, Any]], None]
) -> None:
    """Makes every missing row, some seeds of a machine at a time."""
    cslc = jc.derive(jc.puma560())
    network = inverse_dynamics(cslc)
    seeds = command.seeds_of(options)
    with command.progress(
        total=len(options.machines) * len(seeds), desc="seeds", unit="seed"
    ) as bar:
        for name in options.machines:
            machine = sim.disturbed(MACHINES[name]())
            # Machines compensate their own gravity: see `sim.training`.
            trajectories = (
                sim.training(
                    samples=options.samples,
                    robot=machine.robot,
                    amplitude=tuple(options.amplitude),
                ),
                sim.comparison(),
            )
            missing = [seed for seed in seeds if (name, seed) not in rows]
            bar.update(len(seeds) - len(missing))
            for start in range(0, len(missing), _SEEDS_AT_ONCE):
                part = missing[start : start + _SEEDS_AT_ONCE]
                # Two numbers a seed: the encoders of the two recordings start elsewhere.
                jobs = [
                    sim.Job(machine, trajectory, 2 * seed + i)
                    for i, trajectory in enumerate(trajectories)
                    for seed in part
                ]
                results = dict(sim.record_each(jobs))
                for i, seed in enumerate(part):
                    pair = results[i], results[len(part) + i]
                    row: dict[str, Any] = {"machine": name, "seed": seed}
                    try:
                        row |= figures_of(cslc, network, machine, pair, options.threshold)
                    except (sim.SimulationError, ValueError) as error:
                        row["failed"] = str(error).partition("\n")[0]
                    rows.add(row)
                    show(row)
                    bar.update()


def tables_of(finished: Sequence[Mapping[str, Any]]) -> dict[str, list[dict[str, str]]]:
    """Return the tables of one machine's seeds: by masks, and by joint."""
    by_masks: list[dict[str, str]] = []
    for case in CASES:
        errors = [row["errors"][case.key] for row in finished]
        by_masks.append(
            dict(zip(("slow pairs left out of", "backlash mask"), case.cells, strict=True))
            | {
                "ε over true": median_text([row["ε"][case.key] for row in finished]),
                "friction [N m]": median_text([error["friction"] for error in errors]),
                "rigid [N m]": median_text([error["rigid"] for error in errors]),
            }
        )
    by_joint: list[dict[str, str]] = []
    for name in finished[0]["residuals"]:
        values = np.array([row["residuals"][name] for row in finished])
        cells = {
            f"joint {joint + 1}": f"{value:.3f}"
            for joint, value in enumerate(np.median(values, axis=0))
        }
        by_joint.append({"median over seeds": name, **cells})
    return {"masks": by_masks, "residuals": by_joint}


def study(options: argparse.Namespace) -> int:
    """Makes what is missing, prints the tables and writes the files."""
    digest = made_of({name: getattr(options, name) for name in OPTIONS}, [Path(__file__)])
    rows = Rows(options.output / "rows.jsonl", ("machine", "seed"), digest)

    def show(row: Mapping[str, Any]) -> None:
        if "failed" in row:
            print(f"failed: PUMA {row['machine']}, seed {row['seed']}: {row['failed']}", flush=True)

    make_rows(options, rows, show)
    tables: dict[str, list[dict[str, str]]] = {}
    for name in options.machines:
        wanted = [rows[name, seed] for seed in command.seeds_of(options)]
        finished = [row for row in wanted if "failed" not in row]
        if not finished:
            print(f"PUMA {name}: all {len(wanted)} seeds failed; nothing to summarise")
            return 1
        true = median_text([row["true ε"] for row in finished])
        print(
            f"\nPUMA {name}, {len(finished)} of {len(wanted)} seeds, median (10 to 90 %); ε of the"
            f" true coefficients {true} N m"
        )
        for kind, table in tables_of(finished).items():
            tables[f"{kind}_{name.lower()}"] = table
            cells = [list(row.values()) for row in table]
            print(text_table(list(table[0]), cells, left=list(table[0])[:2]))
    with all_or_nothing(options.output) as folder:
        for name, table in tables.items():
            write_csv(folder / f"{name}.csv", table)
    print(f"wrote {options.output}")
    return 0


def main(argv: Sequence[str] | None = None) -> int:
    parser = command.new_parser(__doc__, "training_masks")
    command.add_seeds(parser, 8)
    parser.add_argument("--machines", nargs="+", choices=list(MACHINES), default=list(MACHINES))
    parser.add_argument("--threshold", type=float, default=0.01,
                        help="part of a joint's greatest speed that is slow")  # fmt: skip
    parser.add_argument("--amplitude", type=float, nargs=6, default=list(_AMPLITUDE),
                        metavar="TORQUE", help="of each joint in training [N m]")  # fmt: skip
    parser.add_argument("--samples", type=int, default=3300, help="of a training recording")
    options = command.parse(parser, argv, seeds=2, samples=1500)
    command.require_least(parser, options, seeds=1, samples=500)
    command.require_between(parser, options, threshold=(0.0, 1.0))
    return command.run(
        parser,
        lambda: study(options),
        options.output / "rows.jsonl",
        seconds=40.0 + 12.0 * options.seeds * len(options.machines),
    )


if __name__ == "__main__":
    raise SystemExit(main())
