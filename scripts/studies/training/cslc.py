"""Train the PUMA 560's CSLC as the thesis does (7.5), beside the direct solve on the same patterns.

From zero weights at small rates by backpropagation, until the error cost on the training patterns
falls below that of the coefficients from direct measurement (Ar+LS); then bouts of PERAL and
backpropagation by turns, one adapted rate for each of the five subnetworks (6.3.1), until no rule
reaches the least reduction in an epoch any more. The thesis ends at 0.001 N m; smaller ends show
what is left to gain. Judged on the comparison recordings of the simulated PUMA A and B.

    python -m scripts.studies.training.cslc
    python -m scripts.studies.training.cslc --least 1e-3 1e-6 --without-velocity
"""

import argparse
from collections.abc import Iterator, Sequence
from pathlib import Path
from typing import Any

import jax
import jax.numpy as jnp
import numpy as np

import jaxcslc as jc
import sim
from jaxcslc.adaptive import AdaptiveNetwork, inverse_dynamics
from jaxcslc.identification.report import all_or_nothing, text_table, write_csv, write_json
from jaxcslc.training import Examples, examples, half_rms, train
from scripts.studies import command
from scripts.studies.rows import Rows, made_of
from scripts.studies.tables import number_text
from scripts.studies.training.thesis_route import plan_of
from scripts.studies.truth import published_coefficients


jax.config.update("jax_enable_x64", True)

OPTIONS = ("bout", "epochs", "seed", "samples", "without_velocity")
CHUNK = 500  # epochs between looks at progress
# Joints that move, as in the experiment of Chapter 7.
_MOVING = 0.05  # rad/s

CODE = [Path(__file__), Path(__file__).with_name("thesis_route.py")]


def prepared(
    network: AdaptiveNetwork, training: jc.Recording, comparison: jc.Recording
) -> tuple[jc.Patterns, Examples, Examples]:
    """Training patterns, with thresholds of a hundredth (7.5), and examples of both recordings."""
    patterns = jc.prepare(training, torque_alignment="mean", threshold_fraction=0.01)
    judged = jc.prepare(
        comparison, smoothing=jc.AveragedSplines(17), torque_alignment="mean", thresholds=_MOVING
    )
    of_training, of_comparison = (
        examples(network, part, part.torque, part.mask) for part in (patterns, judged)
    )
    return patterns, of_training, of_comparison


def error(network: AdaptiveNetwork, of: Examples, weights: jax.Array) -> float:
    """The thesis's ε [N m]."""
    return float(of.costs(network, weights, half_rms)[0])


def method_of(least: float) -> str:
    """The name of a training that ends at a least reduction of an epoch [N m]."""
    return f"trained to {least:g} N m"


def rows_of(
    name: str,
    machine: sim.Machine,
    network: AdaptiveNetwork,
    cslc: jc.CSLC,
    options: argparse.Namespace,
    finished: Rows,
) -> Iterator[dict[str, Any]]:
    """A row for each method of identification that has none."""
    recordings = [
        sim.simulate(machine, trajectory, seed=options.seed).recording
        for trajectory in (sim.training(samples=options.samples), sim.comparison())
    ]
    patterns, training_examples, comparison_examples = prepared(network, *recordings)
    published = published_coefficients(cslc)
    direct = jc.LeastSquares(joint_weights="equal", errors="independent").fit(cslc, patterns).k
    floor = error(network, comparison_examples, direct)
    hand_over = error(network, training_examples, published)

    def row(method: str, k: jax.Array, epochs: Any = "", outcome: str = "") -> dict[str, Any]:
        compared_error = error(network, comparison_examples, k)
        return {
            "machine": name,
            "method": method,
            "epochs": epochs,
            "training ε [N m]": error(network, training_examples, k),
            "comparison ε [N m]": compared_error,
            "over direct": compared_error / floor,
            "ended": outcome,
        }

    yield row("Ar+LS", published)
    yield row("direct solve", direct)
    for least in options.least:
        if (name, method_of(least)) in finished:
            continue
        plan = plan_of(
            hand_over,
            least,
            bout=options.bout,
            frozen=("velocity",) if options.without_velocity else (),
        )
        training = train(
            network,
            training_examples,
            jnp.zeros(network.size),
            plan,
            epochs=options.epochs,
            checkpoint=finished.path.with_name(f"{name} {least:g} {finished.digest[:12]}.npz"),
            chunk=CHUNK,
            keep_weights=False,
            progress=True,
            throw=False,
        )
        (outcome,) = training.outcomes()
        rule = np.asarray(training.history.rule)
        passed = f"{int((rule == 0).sum())} + {int((rule == 1).sum())}"
        yield row(method_of(least), training.weights, passed, outcome)


def study(options: argparse.Namespace) -> int:
    """Trains on every machine, prints the table and writes the files."""
    cslc = jc.derive(jc.puma560())
    network = inverse_dynamics(cslc)
    machines = {"A": sim.puma_a, "B": sim.puma_b}
    digest = made_of({name: getattr(options, name) for name in OPTIONS}, CODE)
    finished = Rows(options.output / "rows.jsonl", ("machine", "method"), digest)
    methods = ["Ar+LS", "direct solve", *map(method_of, options.least)]
    keys = [(f"PUMA {name}", method) for name in options.machines for method in methods]
    for name in options.machines:
        if any(key not in finished for key in keys if key[0] == f"PUMA {name}"):
            for row in rows_of(f"PUMA {name}", machines[name](), network, cslc, options, finished):
                finished.add(row)
                print(", ".join(number_text(value) for value in row.values()), flush=True)
    rows = [finished[key] for key in keys]
    print(text_table(list(rows[0]), [[number_text(x) for x in row.values()] for row in rows]))
    print("epochs: of backpropagation + of PERAL")
    with all_or_nothing(options.output) as folder:
        write_csv(folder / "training.csv", rows)
        arguments = vars(options) | {"output": str(options.output)}
        write_json(folder / "training.json", {"rows": rows, "command": arguments})
    print(f"wrote {options.output}")
    return 0


def main(argv: Sequence[str] | None = None) -> int:
    parser = command.new_parser(__doc__, "cslc_training")
    parser.add_argument("--least", type=float, nargs="+", default=[1e-3, 1e-5, 1e-7],
                        help="reductions of an epoch that end a training [N m]")  # fmt: skip
    parser.add_argument("--bout", type=int, default=100, help="epochs of a rule before it turns")
    parser.add_argument("--epochs", type=int, default=60_000, help="at most")
    parser.add_argument("--seed", type=int, default=1, help="of the recordings")
    parser.add_argument("--samples", type=int, default=3300, help="of the training recording")
    parser.add_argument("--machines", nargs="+", choices=["A", "B"], default=["A", "B"])
    parser.add_argument("--without-velocity", action="store_true", help="as 5.2.6 allows")
    options = command.parse(parser, argv, samples=1500, least=[1e-2], machines=["A"], epochs=300)
    command.require_least(parser, options, samples=500, epochs=1, bout=1)
    if options.quick:  # 42 in place of 63 s of processor time, nothing compiled before
        command.compile_quickly()
    trainings = len(options.machines) * len(options.least)
    return command.run(
        parser,
        lambda: study(options),
        options.output / "rows.jsonl",
        seconds=(45.0 if options.quick else 60.0)
        + 4e-6 * trainings * options.samples * options.epochs,
    )


if __name__ == "__main__":
    raise SystemExit(main())
