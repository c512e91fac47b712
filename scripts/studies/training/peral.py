"""PERAL against backpropagation, as Section 6.3 compares them, and one minimum (5.2.2).

Two problems: the ultrasound scene (6.3.1: backpropagation from random weights until 30 % of the
patterns are classified correctly, then both rules from there until 50 %) and the PUMA 560's CSLC
(6.3.2: Gaussian noise on its unprocessed inputs and on its targets, static friction in the plant
that the network has no term for; backpropagation for 500 epochs, then both). Every seed is another
start, and on the PUMA another noise. All rates are adapted by the rule of 6.3.1, by the mean error
modulus; PERAL starts with 31 % of the rate that would gain most in its first epoch, the median over
seeds: as high as that rule raises a rate. Backpropagation goes on with its rates.

Epochs are counted from the hand-over to goals: shares of correct classifications, or parts of the
way from the hand-over's mean error modulus to the direct solution's. A training that never reaches
a goal counts as infinitely long. Seconds are epochs times the time of one epoch of the rule,
measured on a training alone, the search for rates included.

An interrupted run goes on from its checkpoints in the output folder.
"""

import argparse
from collections.abc import Sequence
from pathlib import Path
from typing import Any

import equinox as eqx
import jax
import jax.numpy as jnp
import numpy as np
from matplotlib.figure import Figure

import jaxcslc as jc
from jaxcslc.report import all_or_nothing, write_csv, write_json
from jaxcslc.training import (
    AdaptedRates,
    Backpropagation,
    Examples,
    Plan,
    TrainingState,
    half_square,
    training_steps,
    with_normal_equations,
)
from scripts.studies import command
from scripts.studies.figures import save_picture
from scripts.studies.rows import Rows, made_of
from scripts.studies.stored import store
from scripts.studies.tables import grouped
from scripts.studies.training.learning_pictures import Learning, learning_picture
from scripts.studies.training.peral_comparison import (
    BACKPROPAGATION_RATE,
    CORRECT,
    RULES,
    Outcome,
    Problem,
    compare_puma,
    compare_ultrasound,
    correct,
    costs_of,
    direct_solutions,
    moduli,
    puma,
    starts,
    ultrasound,
)
from scripts.studies.training.peral_operations import (
    BACKPROPAGATION,
    COUNTED_FORMULAS,
    PERAL_RULE,
    THESIS_FORMULAS,
)
from scripts.studies.training.peral_tables import (
    epoch_rows,
    epochs_cells,
    epochs_table,
    operations,
    report,
    spread,
)


jc.enable_x64()

NEAR = 1.001
STARTS_AT_ONCE = 25
CHECKS = 2000  # epochs between checks whether all trainings are near the minimum


def one_minimum(outcome: Outcome, options: argparse.Namespace, rows: Rows) -> dict[str, Any]:
    """Half square costs over the direct solution's: of backpropagation from random starts on the
    first seed's normal equations, and at the ends of the comparison's trainings.
    """
    problem = outcome.problem
    patterns = with_normal_equations(problem.network, problem.first)
    assert patterns.equations is not None
    least = float(patterns.equations.cost(patterns.equations.solution()))
    missing = [number for number in range(options.starts) if (number,) not in rows]
    with command.progress(
        desc="one minimum",
        unit="epoch",
        total=-(-len(missing) // STARTS_AT_ONCE) * options.minimum_epochs,
    ) as bar:
        for first in range(0, len(missing), STARTS_AT_ONCE):
            numbers = missing[first : first + STARTS_AT_ONCE]
            state = to_the_minimum(problem, patterns, least, numbers, options, bar)
            rows.add(
                *(
                    {"start": number, "epochs": epochs, "ratio": lowest / least}
                    for number, epochs, lowest in zip(
                        numbers, state.epoch.tolist(), state.lowest.tolist(), strict=True
                    )
                )
            )
    ended = [rows[(number,)] for number in range(options.starts)]
    ratios = np.array([row["ratio"] for row in ended])
    best = costs_of(problem, direct_solutions(problem), half_square)
    ends = {"hand-over": outcome.at_hand_over, **outcome.at_end}
    return {
        "direct solution's half square cost [N² m²]": least,
        "starts": options.starts,
        "epochs": spread(np.array([row["epochs"] for row in ended], float)),
        "backpropagation": spread(ratios),
        "ended": {"below": int(np.sum(ratios <= NEAR)), "ratio": NEAR},
        "of": f"{problem.name}, {problem.variant}, {len(best)} seeds",
        "comparison": {
            name: spread(costs_of(problem, weights, half_square) / best)
            for name, weights in ends.items()
        },
    }


def to_the_minimum(
    problem: Problem,
    patterns: Examples,
    least: float,
    numbers: Sequence[int],
    options: argparse.Namespace,
    bar: Any,
) -> TrainingState:
    """Backpropagation from some of the starts until all are near the least cost."""
    network = problem.network
    plan = Plan(
        Backpropagation(),
        AdaptedRates(BACKPROPAGATION_RATE, gain=options.minimum_gain),
        cost=half_square,
        target=NEAR * least,
        patience=options.minimum_epochs,
    )
    start = starts(problem, options.starts)[np.array(numbers)]
    keys = jax.random.split(jax.random.key(0), len(numbers))
    state = jax.vmap(lambda w, key: TrainingState.first(network, plan, w, key))(start, keys)
    epochs = min(CHECKS, options.minimum_epochs)
    steps = eqx.filter_jit(
        jax.vmap(lambda s: training_steps(network, plan, patterns, None, s, epochs)[0])
    )
    passed = 0
    while passed < options.minimum_epochs and not bool(jnp.all(state.done)):
        state = steps(state)
        passed += epochs
        bar.update(epochs)
        bar.set_postfix(highest=f"{float(jnp.max(state.cost)) / least:.5f}")
    bar.update(max(0, options.minimum_epochs - passed))
    return state


def typical(outcome: Outcome) -> int:
    """The seed that backpropagation takes the median number of epochs with to the hardest goal
    that half of the seeds reach, or simply the first.
    """
    for goal in reversed(list(outcome.goals)):
        epochs = outcome.epochs[BACKPROPAGATION][goal]
        middle = spread(epochs)["median"]
        if np.isfinite(middle):
            return int(np.flatnonzero(epochs == middle)[0])
    return 0


def learning(outcome: Outcome) -> Learning:
    """The curves of the typical seed, until both are at the hardest goal or at their ends."""
    seed = typical(outcome)
    curves = {rule: outcome.curves[rule][seed] for rule in RULES}
    handed = outcome.hand_over[seed]
    hand_over = int(handed) if np.isfinite(handed) else 0
    ends = {rule: outcome.epochs[rule][list(outcome.goals)[-1]][seed] for rule in RULES}
    if outcome.problem.name == "ultrasound":
        levels = {f"{CORRECT[-1]:.0%} correct": 100.0 * CORRECT[-1]}
        curves = {rule: 100.0 * (1.0 - curve) for rule, curve in curves.items()}
        for rule, end in ends.items():  # behind the goal, early finishers wait
            whole = hand_over * (rule == BACKPROPAGATION)
            stop = int(end) + whole + 1 if np.isfinite(end) else None
            curves[rule] = curves[rule][:stop]
    else:
        best = moduli(outcome.problem, direct_solutions(outcome.problem))[seed]
        levels = {"direct solution": float(best)}
    return Learning(
        (BACKPROPAGATION, curves[BACKPROPAGATION]),
        {PERAL_RULE: curves[PERAL_RULE]},
        hand_over,
        levels,
    )


def pictures(scenes: Sequence[Outcome], arms: Sequence[Outcome]) -> dict[str, Figure]:
    """Figs. 6.3-3 and 6.3-4, by file name."""
    return {
        "ultrasound.png": learning_picture(
            {outcome.problem.variant: learning(outcome) for outcome in scenes},
            "classified correctly [%]",
            title="Ultrasound object identification, a typical start (Fig. 6.3-3)",
            limits=(0.0, 60.0),
        ),
        "puma.png": learning_picture(
            {
                f"{outcome.problem.variant} of inputs and targets": learning(outcome)
                for outcome in arms
            },
            "mean error modulus [N m]",
            title="Inverse dynamics of a simulated PUMA 560, a typical start (Fig. 6.3-4)",
        ),
    }


def document(
    options: dict[str, Any],
    outcomes: Sequence[Outcome],
    rows: Sequence[dict[str, Any]],
    counts: Sequence[dict[str, Any]],
    minimum: dict[str, Any],
) -> dict[str, Any]:
    """Return all of it; infinite epochs are null."""
    return {
        "options": options,
        "trainings": [
            {
                "problem": outcome.problem.name,
                "variant": outcome.problem.variant,
                "hand-over [epochs]": outcome.hand_over,
                "epochs": outcome.epochs,
                "ended": outcome.ended,
                "correct": correct(outcome),
                "seconds an epoch": outcome.seconds,
                "PERAL's first rate": outcome.rate,
            }
            for outcome in outcomes
        ],
        "epochs": rows,
        "operations": counts,
        "formulas": {"thesis": THESIS_FORMULAS, "counted": COUNTED_FORMULAS},
        "one minimum": minimum,
    }


def printed(outcome: Outcome) -> Outcome:
    """The outcome, its table printed at once."""
    print(f"\n{epochs_table(epoch_rows(outcome))}\n", flush=True)
    return outcome


def study(options: argparse.Namespace) -> int:
    """Trains everything, prints the tables and writes the files."""
    numbers = {
        k: v for k, v in sorted(vars(options).items()) if k not in ("output", "quick", "store")
    }
    code = [Path(__file__).with_name(f"peral{name}.py") for name in ("", "_comparison")]
    digest = made_of(numbers, code)
    checkpoints = options.output / f"checkpoints-{digest[:12]}"
    scenes = [
        printed(
            compare_ultrasound(
                ultrasound(options.ultrasound_patterns, centred=centred), options, checkpoints
            )
        )
        for centred in (False, True)
    ]
    arms = [
        printed(
            compare_puma(
                puma(options.puma_patterns, noise, options.other_seeds if i else options.seeds),
                options,
                checkpoints,
            )
        )
        for i, noise in enumerate(options.noise)
    ]
    minimum = one_minimum(
        arms[0], options, Rows(options.output / "starts.jsonl", ("start",), digest)
    )
    outcomes = [*scenes, *arms]
    rows = [row for outcome in outcomes for row in epoch_rows(outcome)]
    # A trial run does without the CSLC's, whose programs take most of a minute to compile.
    counted = scenes[:1] if options.quick else [scenes[0], arms[0]]
    counts = operations([outcome.problem for outcome in counted])
    print("\n" + report(rows, counts, outcomes, minimum))
    with all_or_nothing(options.output) as folder:
        write_csv(folder / "epochs.csv", rows)
        write_csv(folder / "operations.csv", counts)
        whole = document(numbers, outcomes, rows, counts, minimum)
        write_json(folder / "peral_study.json", whole)
        figures = pictures(scenes, [arms[i] for i in np.argsort(options.noise)])
        for name, figure in figures.items():
            save_picture(figure, folder / name)
    of_arms = [row for outcome in arms for row in epoch_rows(outcome)]
    sample = f"{options.seeds} seeds, {options.other_seeds} at other noises"
    store(options, "peral_puma", sample, {"epochs": grouped(epochs_cells(of_arms))})
    names = ", ".join(["epochs.csv", "operations.csv", "peral_study.json", *figures])
    print(f"\nwrote {names} into {options.output}")
    return 0


def seconds(options: argparse.Namespace) -> float:
    """Return how long the study takes on two cores."""
    scenes = 2 * options.ultrasound_patterns * options.seeds
    arms = options.seeds + (len(options.noise) - 1) * options.other_seeds
    epochs = options.hand_over + options.further + options.tuning
    return (
        40.0
        + 1e-6 * scenes * (2 * options.before + options.further + options.tuning)
        + 4e-6 * options.puma_patterns * arms * epochs
        + 2e-5 * options.starts * options.minimum_epochs
    )


def check(parser: argparse.ArgumentParser, options: argparse.Namespace) -> None:
    """Ends the program with one line if an option is out of its range."""
    names = ("seeds", "other_seeds", "starts", "before", "hand_over", "further", "tuning")
    command.require_least(parser, options, **dict.fromkeys(names, 1))
    for name, low, high in (("ultrasound", 100, 3150), ("puma", 30, 3300)):
        count = getattr(options, f"{name}_patterns")
        if not low <= count <= high:
            parser.error(f"--{name}-patterns is {count}; expected {low} to {high}")
    if not all(0.0 <= noise < np.inf for noise in options.noise):
        parser.error(f"--noise is {options.noise}; expected finite numbers, 0 or more")
    if len(set(options.noise)) < len(options.noise):
        parser.error(f"--noise is {options.noise}; expected different levels")
    if options.minimum_epochs < 1 or not 0.0 <= options.minimum_gain < 0.1:
        parser.error("--minimum-epochs must be 1 or more, --minimum-gain at least 0 and below 0.1")


def main(argv: Sequence[str] | None = None) -> int:
    parser = command.new_parser(__doc__, "peral_study")
    parser.add_argument("--seeds", type=int, default=100, help="starts, and noises on the PUMA")
    parser.add_argument(
        "--other-seeds", type=int, default=10, help="at other noises than the first"
    )
    parser.add_argument("--starts", type=int, default=100, help="towards the one minimum")
    parser.add_argument("--ultrasound-patterns", type=int, default=1050, help="of at most 3150")
    parser.add_argument("--puma-patterns", type=int, default=330, help="of at most 3300")
    parser.add_argument("--noise", type=float, nargs="+", default=[0.1, 0.05, 0.2])
    parser.add_argument("--before", type=int, default=300, help="epochs at most to the 30 %% mark")
    parser.add_argument("--hand-over", type=int, default=500, help="epochs before it, on the PUMA")
    parser.add_argument("--further", type=int, default=700, help="epochs of backpropagation after")
    parser.add_argument("--tuning", type=int, default=300, help="epochs of PERAL at most")
    parser.add_argument("--minimum-epochs", type=int, default=200_000)
    parser.add_argument("--minimum-gain", type=float, default=0.01, help="in place of the 8 %%")
    epochs = {"before": 100, "hand_over": 50, "further": 50, "tuning": 50, "minimum_epochs": 4000}
    patterns = {"ultrasound_patterns": 200, "puma_patterns": 60}
    seeds = {"seeds": 2, "other_seeds": 2, "starts": 2, "noise": [0.1]}
    command.add_store(parser)
    options = command.parse(parser, argv, **epochs, **patterns, **seeds)
    check(parser, options)
    if options.quick:  # 80 in place of 120 s of processor time, nothing compiled before
        command.compile_quickly()
    return command.run(parser, lambda: study(options), options.output, seconds=seconds(options))


if __name__ == "__main__":
    raise SystemExit(main())
