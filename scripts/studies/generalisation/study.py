"""Do other networks generalise? Section 4.3's claim, on recordings of a simulated PUMA 560.

Sigmoidal multilayer networks and networks of radial basis functions of several sizes learn the
torques of the training recording from positions, velocities and accelerations (18 inputs, 6
outputs), and predict those of the comparison recording, as does the CSLC fitted to the same
patterns. Every seed has other recordings, another stop set and other starting weights.

- **Patterns.** Recordings are smoothed and masked with the settings that `choose_settings` selects
  for the CSLC on the first training recording. Of 20 stretches of time of each training recording,
  4 are its stop set (3.6.1). The comparison recording is prepared as in `make demo`, and is judged
  where a joint moves.
- **Sigmoidal**: hyperbolic-tangent hidden nodes, linear outputs, Adam on mini-batches.
- **Radial basis**: Gaussians; centres by k-means, outputs by ridge regression, with the width and
  the ridge of least stop-set error; then everything is trained by Adam as above.
- **Stop set.** The weights kept are those of the epoch of least stop-set error; the error after the
  last epoch is in the table too. The rate falls to zero along half a cosine, so the last epochs
  change little.
- **Pruned** (3.6.2): a trained network without the links to which the training-set error is not
  sensitive (`jaxcslc.training`'s `prune`), trained again; several rounds of both. In each round the
  mean square error may grow to (1 + tolerance) times itself before the network is trained again.
- Inputs and torques are standardised by the training patterns. In 'sin cos' networks each position
  is replaced by its sine and cosine, 24 inputs in all: a part of the CSLC's knowledge.
- **In range**: those comparison patterns of which every input lies in the range that the training
  patterns span. The others ask for extrapolation.
- **ε** (7.5): half the root mean square over joints of a pattern's errors, averaged over patterns.
- **Mean torque**: no network, but each joint's mean torque of the training patterns: the error
  without any model.
- **Order** (4.2): the highest product, over all routes from inputs to outputs, of the number of
  links to each node, biases included. Radial basis functions are not monotonic, as Section 4.2
  requires, so their networks have none.

Rows of finished networks are kept in `rows.jsonl`; an interrupted run goes on from there.
"""

import argparse
from collections.abc import Sequence
from pathlib import Path
from typing import Any

import numpy as np

import jaxcslc as jc
import sim
from jaxcslc._text_table import text_table
from jaxcslc.report import all_or_nothing, write_csv
from scripts.studies import command
from scripts.studies.figures import save_picture
from scripts.studies.generalisation.patterns import data_of, in_range, stop_set
from scripts.studies.generalisation.results import picture, summary, table
from scripts.studies.generalisation.training import (
    MORE,
    QUICK,
    STANDARD,
    Kind,
    constant,
    fitted,
    train,
)
from scripts.studies.rows import Rows, made_of
from scripts.studies.stored import store


jc.enable_x64()

MOVING = 0.01  # rad/s
MACHINES = {
    "puma560": sim.puma560,
    "a": lambda: sim.disturbed(sim.puma_a()),
    "b": lambda: sim.disturbed(sim.puma_b()),
}
OPTIONS = ("machine", "seeds", "samples", "epochs", "batch", "rounds", "tolerance")


def recorded(options: argparse.Namespace) -> list[jc.Recording]:
    """Training and comparison recording of every seed in turn."""
    machine = MACHINES[options.machine]()
    trajectories = (sim.training(samples=options.samples, robot=machine.robot), sim.comparison())
    # Two numbers a seed: the encoders of the two recordings start elsewhere.
    jobs = [
        sim.Job(machine, trajectory, 2 * seed + offset)
        for seed in range(options.seeds)
        for offset, trajectory in enumerate(trajectories)
    ]
    return [result.recording for result in sim.record(jobs, progress=True)]


def make_rows(options: argparse.Namespace, kinds: Sequence[Kind]) -> list[dict[str, Any]]:
    """Rows of the CSLC and of each network, from the file or made now."""
    network = jc.derive(jc.puma560())
    recordings = recorded(options)
    if options.quick:
        settings = jc.Settings(jc.Preparation(jc.AveragedSplines(17), torque_alignment="mean"))
    else:
        settings = jc.choose_settings(network, recordings[0]).settings
    training = [settings.patterns(recording) for recording in recordings[::2]]
    comparison = [
        jc.prepare(
            recording,
            smoothing=jc.AveragedSplines(17),
            torque_alignment="mean",
            thresholds=MOVING,
        )
        for recording in recordings[1::2]
    ]
    stop = [stop_set(patterns.samples, seed) for seed, patterns in enumerate(training)]
    code = [Path(__file__).with_name(f"{name}.py") for name in ("networks", "patterns", "training")]
    digest = made_of({name: getattr(options, name) for name in OPTIONS}, code)
    finished = Rows(options.output / "rows.jsonl", ("network",), digest)
    plain = data_of(training, stop, comparison, trigonometric=False)
    rows = [fitted(network, settings, training, stop, comparison), constant(plain)]
    missing = [kind for kind in kinds if (kind.name,) not in finished]
    rounds = sum(1 + kind.pruned * options.rounds for kind in missing)
    inside = [
        np.mean(in_range(judged, patterns, ~stopping))
        for judged, patterns, stopping in zip(comparison, training, stop, strict=True)
    ]
    print(f"settings: {settings}")
    print(f"comparison patterns in range of the training patterns: {100 * np.mean(inside):.1f} %")
    total = rounds * options.epochs
    with command.progress(desc="networks", unit="epoch", total=total) as bar:
        for kind in missing:
            bar.set_description(kind.name)
            data = data_of(training, stop, comparison, kind.trigonometric)
            finished.add(train(kind, data, options, bar))
    return [*rows, *(finished[(kind.name,)] for kind in kinds)]


def study(options: argparse.Namespace, kinds: Sequence[Kind]) -> int:
    """Makes what is missing, prints the table and writes the files."""
    rows = make_rows(options, kinds)
    document = summary(rows)
    head, *lines = table(document)
    print(f"\nε [N m]\n{text_table(head, lines)}")
    store(options, "generalisation", f"{options.seeds} seeds", {"networks": [head, *lines]})
    with all_or_nothing(options.output) as folder:
        write_csv(folder / "generalisation.csv", document)
        save_picture(picture(rows, options.seeds), folder / "generalisation.png")
    print(f"\nwrote generalisation.csv and generalisation.png into {options.output}")
    return 0


def main(argv: Sequence[str] | None = None) -> int:
    by_name = {kind.name: kind for kind in (*STANDARD, *MORE)}
    parser = command.new_parser(__doc__, "generalisation_study")
    parser.add_argument("--machine", choices=MACHINES, default="puma560")
    parser.add_argument("--seeds", type=int, default=10, help="recordings and starting weights")
    parser.add_argument("--samples", type=int, default=3300, help="of a training recording")
    parser.add_argument("--epochs", type=int, default=400, help="of a training")
    parser.add_argument("--batch", type=int, default=64, help="patterns of a step")
    parser.add_argument("--rounds", type=int, default=3, help="of pruning and training again")
    parser.add_argument("--tolerance", type=float, default=9.0, help="of pruning, each round")
    parser.add_argument(
        "--networks",
        nargs="+",
        choices=by_name,
        metavar="NAME",
        default=[kind.name for kind in STANDARD],
        help="some of: " + ", ".join(by_name),
    )
    command.add_store(parser)
    options = command.parse(parser, argv, seeds=2, samples=1200, epochs=6, rounds=1)
    if not 0.0 <= options.tolerance < np.inf:
        parser.error(f"--tolerance is {options.tolerance}; expected a finite number, 0 or more")
    command.require_least(parser, options, seeds=1, samples=600, epochs=1, batch=1, rounds=1)
    kinds = QUICK if options.quick else tuple(by_name[name] for name in options.networks)
    trainings = sum(1 + kind.pruned * options.rounds for kind in kinds)
    seconds = 25.0 + 1e-6 * trainings * options.seeds * options.samples * options.epochs
    return command.run(
        parser, lambda: study(options, kinds), options.output / "rows.jsonl", seconds=seconds
    )


if __name__ == "__main__":
    raise SystemExit(main())
