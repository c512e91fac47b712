"""Train the PUMA 560's CSLC as the thesis does (7.5), beside the direct solve on the same patterns.

From zero weights at small rates by backpropagation, until the error cost on the training patterns
falls below that of the coefficients from direct measurement (Ar+LS); then bouts of PERAL and
backpropagation by turns, one adapted rate for each of the five subnetworks (6.3.1), until no rule
gains the least reduction in an epoch any more. The thesis ends at 0.001 N m; smaller ends show
what is left to gain. Judged on the comparison recordings of the simulated PUMA A and B.

    python scripts/studies/training/cslc.py
    python scripts/studies/training/cslc.py --least 1e-3 1e-6 --without-velocity
"""

import argparse
from collections.abc import Iterator
from pathlib import Path
from typing import Any

import jax
import jax.numpy as jnp
import numpy as np

import jaxcslc as jc
import sim
from jaxcslc.adaptive import AdaptiveNetwork, inverse_dynamics
from jaxcslc.identification import all_or_nothing, text_table, write_csv, write_json
from jaxcslc.training import (
    PERAL,
    AdaptedRates,
    Backpropagation,
    Examples,
    Plan,
    Schedule,
    examples,
    half_rms,
    train,
)


jax.config.update("jax_enable_x64", True)

# What the comparison is judged by, as in `puma560_experiment.py`: joints that move.
_MOVING = 0.05  # rad/s


def prepared(
    network: AdaptiveNetwork, cslc: jc.CSLC, recording: jc.Recording, judged: jc.Recording
) -> tuple[jc.Patterns, Examples, Examples]:
    """Patterns to learn from, with thresholds of a hundredth (7.5), and those to judge by."""
    patterns = jc.prepare(recording, torque_alignment="mean", threshold_fraction=0.01)
    kept = jc.prepare(
        judged, smoothing=jc.AveragedSplines(17), torque_alignment="mean", thresholds=_MOVING
    )
    learnt, compared = (
        examples(network, part, part.torque, part.mask) for part in (patterns, kept)
    )
    return patterns, learnt, compared


def error(network: AdaptiveNetwork, chosen: Examples, weights: jax.Array) -> float:
    """The thesis's ε [N m]."""
    return float(chosen.costs(network, weights, half_rms)[0])


def rows_of(
    name: str,
    machine: sim.Machine,
    network: AdaptiveNetwork,
    cslc: jc.CSLC,
    arguments: argparse.Namespace,
) -> Iterator[dict[str, Any]]:
    """One row a way to find coefficients."""
    recordings = [
        sim.simulate(machine, trajectory, seed=arguments.seed).recording
        for trajectory in (sim.training(samples=arguments.samples), sim.comparison())
    ]
    patterns, learnt, compared = prepared(network, cslc, *recordings)
    book = jc.puma560()
    assert book.links is not None
    published = cslc.coefficients_from(book.links, viscous=book.viscous, dry=book.dry)
    direct = jc.LeastSquares(joint_weights="equal", errors="independent").fit(cslc, patterns).k
    floor = error(network, compared, direct)
    hand_over = error(network, learnt, published)

    def row(way: str, k: jax.Array, epochs: Any = "", outcome: str = "") -> dict[str, Any]:
        compared_error = error(network, compared, k)
        return {
            "machine": name,
            "found by": way,
            "epochs": epochs,
            "training ε [N m]": error(network, learnt, k),
            "comparison ε [N m]": compared_error,
            "over direct": compared_error / floor,
            "ended": outcome,
        }

    yield row("Ar+LS", published)
    yield row("direct solve", direct)
    for least in arguments.least:
        schedule = Schedule(
            (Backpropagation(), PERAL()),
            hand_over=hand_over,
            bout=arguments.bout,
            least_reduction=least,
        )
        plan = Plan(
            schedule,
            (AdaptedRates(1e-3), AdaptedRates(0.1)),
            frozen=("velocity",) if arguments.without_velocity else (),
        )
        training = train(
            network,
            learnt,
            jnp.zeros(network.size),
            plan,
            epochs=arguments.epochs,
            keep_weights=False,
            progress=True,
            throw=False,
        )
        (outcome,) = training.outcomes()
        rule = np.asarray(training.history.rule)
        passed = f"{int((rule == 0).sum())} + {int((rule == 1).sum())}"
        yield row(f"trained to {least:g} N m", training.weights, passed, outcome)


def shown(value: Any) -> str:
    return f"{value:.4g}" if isinstance(value, float) else str(value)


def main() -> None:
    parser = argparse.ArgumentParser(description=(__doc__ or "").partition("\n")[0])
    parser.add_argument("-o", "--output", type=Path, default=Path("build/cslc_training"))
    parser.add_argument("--least", type=float, nargs="+", default=[1e-3, 1e-5, 1e-7])
    parser.add_argument("--bout", type=int, default=100, help="epochs of a rule before it turns")
    parser.add_argument("--epochs", type=int, default=60_000, help="at most")
    parser.add_argument("--seed", type=int, default=1)
    parser.add_argument("--samples", type=int, default=3300, help="of the training recording")
    parser.add_argument("--machines", nargs="+", choices=["A", "B"], default=["A", "B"])
    parser.add_argument("--without-velocity", action="store_true", help="as 5.2.6 allows")
    arguments = parser.parse_args()
    if arguments.samples < 500 or arguments.epochs < 1 or arguments.bout < 1:
        parser.error("--samples must be at least 500, --epochs and --bout at least 1")

    cslc = jc.derive(jc.puma560())
    network = inverse_dynamics(cslc)
    machines = {"A": sim.puma_a, "B": sim.puma_b}
    rows: list[dict[str, Any]] = []
    for name in arguments.machines:
        rows += rows_of(f"PUMA {name}", machines[name](), network, cslc, arguments)
    print(text_table(list(rows[0]), [[shown(x) for x in row.values()] for row in rows]))
    print("epochs: of backpropagation + of PERAL")
    with all_or_nothing(arguments.output) as folder:
        write_csv(folder / "training.csv", rows)
        write_json(
            folder / "training.json",
            {"rows": rows, "command": vars(arguments) | {"output": str(arguments.output)}},
        )
    print(f"wrote {arguments.output}")


if __name__ == "__main__":
    main()
