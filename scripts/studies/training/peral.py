"""PERAL against backpropagation, as Section 6.3 compares them, and one minimum (5.2.2).

Two problems: the ultrasound scene (6.3.1: backpropagation from random weights until 30 % of the
patterns are classified correctly, then both rules from there until 50 %) and the PUMA 560's CSLC
(6.3.2: Gaussian noise on its unprocessed inputs and on its targets, static friction in the plant
that the network has no term for; backpropagation for 500 epochs, then both). Every seed is another
start, and on the PUMA another noise. All rates are adapted as 6.3.1 says, by the mean error
modulus; PERAL sets out at 31 % of the rate that would gain most in its first epoch, the median over
seeds, which is how far that rule raises a rate, and backpropagation goes on with the rates it has.

Epochs are counted from the hand-over to goals: shares of correct classifications, or parts of the
way from the hand-over's mean error modulus to the direct solution's. A training that never gets
there counts as infinitely long. Seconds are epochs times the time of one epoch of the rule,
measured on a training alone, the search for rates included.

An interrupted run goes on where it was: the same command finds its checkpoints in the output
folder.
"""

import argparse
import hashlib
from collections.abc import Sequence
from pathlib import Path
from typing import Any

import equinox as eqx
import jax
import jax.numpy as jnp
import numpy as np
from matplotlib.figure import Figure
from tqdm import tqdm

from jaxcslc.identification import all_or_nothing, write_csv, write_json
from jaxcslc.plotting import save_picture
from jaxcslc.training import (
    AdaptedRates,
    Backpropagation,
    Plan,
    State,
    half_square,
    normal_equations,
    training_steps,
)
from scripts.studies.training.learning_pictures import Learning, learning_picture
from scripts.studies.training.peral_comparison import (
    BACKPROPAGATION_RATE,
    CORRECT,
    RULES,
    Outcome,
    compare_puma,
    compare_ultrasound,
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
from scripts.studies.training.peral_tables import epoch_rows, operations, report, spread


jax.config.update("jax_enable_x64", True)

NEAR = 1.001
LOOKS = 2000  # epochs between looks at whether all have come near the one minimum


def one_minimum(found: Outcome, given: argparse.Namespace) -> dict[str, Any]:
    """Half square costs over the direct solution's: of backpropagation from random starts on the
    first seed's normal equations, and of where the rules of the comparison ended.
    """
    problem = found.problem
    network = problem.network
    equations = normal_equations(network, problem.one)
    moment = np.asarray(equations.moment).sum(axis=0)
    direct = np.linalg.lstsq(np.asarray(equations.gram), moment, rcond=None)[0]
    least = float(equations.costs(network, jnp.asarray(direct), half_square)[0])
    plan = Plan(
        Backpropagation(),
        AdaptedRates(BACKPROPAGATION_RATE, gain=given.minimum_gain),
        cost=half_square,
        target=NEAR * least,
        patience=given.minimum_epochs,
    )
    start = starts(problem, given.starts)
    keys = jax.random.split(jax.random.key(0), given.starts)
    state = jax.vmap(lambda w, key: State.first(network, plan, w, key))(start, keys)
    looks = min(LOOKS, given.minimum_epochs)
    steps = eqx.filter_jit(
        jax.vmap(lambda s: training_steps(network, plan, equations, None, s, looks)[0])
    )
    passed = 0
    with tqdm(total=given.minimum_epochs, unit="epoch", desc="one minimum", disable=None) as bar:
        while passed < given.minimum_epochs and not bool(jnp.all(state.done)):
            state = steps(state)
            passed += looks
            bar.update(looks)
            bar.set_postfix(highest=f"{float(jnp.max(state.cost)) / least:.5f}")
    best = costs_of(problem, direct_solutions(problem), half_square)
    ends = {"hand-over": found.handed, **found.at_end}
    return {
        "direct solution's half square cost [N² m²]": least,
        "starts": given.starts,
        "epochs": spread(np.asarray(state.epoch, float)),
        "backpropagation": spread(np.asarray(state.lowest) / least),
        "ended": {"below": int(jnp.sum(state.lowest <= NEAR * least)), "ratio": NEAR},
        "of": f"{problem.name}, {problem.variant}, {len(best)} seeds",
        "comparison": {
            name: spread(costs_of(problem, weights, half_square) / best)
            for name, weights in ends.items()
        },
    }


def typical(found: Outcome) -> int:
    """The seed that backpropagation takes the median number of epochs with to the hardest goal
    that half of the seeds reach, or simply the first.
    """
    for goal in reversed(list(found.goals)):
        epochs = found.epochs[BACKPROPAGATION][goal]
        middle = spread(epochs)["median"]
        if np.isfinite(middle):
            return int(np.flatnonzero(epochs == middle)[0])
    return 0


def learning(found: Outcome) -> Learning:
    """The curves of the typical seed, until both are at the hardest goal or at their ends."""
    seed = typical(found)
    curves = {rule: found.curves[rule][seed] for rule in RULES}
    handed = found.hand_over[seed]
    at = int(handed) if np.isfinite(handed) else 0
    ends = {rule: found.epochs[rule][list(found.goals)[-1]][seed] for rule in RULES}
    if found.problem.name == "ultrasound":
        levels = {f"{CORRECT[-1]:.0%} correct": 100.0 * CORRECT[-1]}
        curves = {rule: 100.0 * (1.0 - curve) for rule, curve in curves.items()}
        for rule, end in ends.items():  # what comes after the goal is the wait of early finishers
            whole = at * (rule == BACKPROPAGATION)
            stop = int(end) + whole + 1 if np.isfinite(end) else None
            curves[rule] = curves[rule][:stop]
    else:
        best = moduli(found.problem, direct_solutions(found.problem))[seed]
        levels = {"direct solution": float(best)}
    return Learning(
        (BACKPROPAGATION, curves[BACKPROPAGATION]), {PERAL_RULE: curves[PERAL_RULE]}, at, levels
    )


def pictures(ears: Sequence[Outcome], arms: Sequence[Outcome]) -> dict[str, Figure]:
    """Figs. 6.3-3 and 6.3-4, by file name."""
    return {
        "ultrasound.png": learning_picture(
            {found.problem.variant: learning(found) for found in ears},
            "classified correctly [%]",
            title="Ultrasound object identification, a typical start (Fig. 6.3-3)",
            limits=(0.0, 60.0),
        ),
        "puma.png": learning_picture(
            {f"{found.problem.variant} of inputs and targets": learning(found) for found in arms},
            "mean error modulus [N m]",
            title="Inverse dynamics of a simulated PUMA 560, a typical start (Fig. 6.3-4)",
        ),
    }


def main(arguments: Sequence[str] | None = None) -> int:
    parser = argparse.ArgumentParser(description=(__doc__ or "").partition("\n")[0])
    parser.add_argument("-o", "--output", type=Path, default=Path("build/peral_study"))
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
    parser.add_argument("--quick", action="store_true", help="few seeds, patterns and epochs")
    given = parser.parse_args(arguments)
    if given.quick:
        given.seeds = given.other_seeds = given.starts = min(given.seeds, 3)
        given.ultrasound_patterns, given.puma_patterns, given.noise = 200, 60, given.noise[:2]
        given.before, given.hand_over, given.further, given.tuning = 100, 50, 50, 50
        given.minimum_epochs = 4000
    for name in ("seeds", "other_seeds", "starts", "before", "hand_over", "further", "tuning"):
        if getattr(given, name) < 1:
            shown = name.replace("_", "-")
            parser.error(f"--{shown} is {getattr(given, name)}; expected 1 or more")
    for name, low, high in (("ultrasound", 100, 3150), ("puma", 30, 3300)):
        count = getattr(given, f"{name}_patterns")
        if not low <= count <= high:
            parser.error(f"--{name}-patterns is {count}; expected {low} to {high}")
    if not all(0.0 <= noise < np.inf for noise in given.noise):
        parser.error(f"--noise is {given.noise}; expected finite numbers, 0 or more")
    if len(set(given.noise)) < len(given.noise):
        parser.error(f"--noise is {given.noise}; expected each level once")
    if given.minimum_epochs < 1 or not 0.0 <= given.minimum_gain < 0.1:
        parser.error("--minimum-epochs must be 1 or more, --minimum-gain at least 0 and below 0.1")
    cache = Path(__file__).parents[3] / ".cache" / "jax"
    jax.config.update("jax_compilation_cache_dir", str(cache))
    jax.config.update("jax_persistent_cache_min_compile_time_secs", 0.2)
    options = {k: v for k, v in sorted(vars(given).items()) if k not in ("output", "quick")}
    digest = hashlib.sha256(repr(options).encode()).hexdigest()[:12]
    checkpoints = given.output / f"checkpoints-{digest}"
    try:
        ears = [
            compare_ultrasound(ultrasound(given.ultrasound_patterns, centred=c), given, checkpoints)
            for c in (False, True)
        ]
        arms = [
            compare_puma(
                puma(given.puma_patterns, noise, given.other_seeds if at else given.seeds),
                given,
                checkpoints,
            )
            for at, noise in enumerate(given.noise)
        ]
        minimum = one_minimum(arms[0], given)
    except KeyboardInterrupt:
        print(f"\ninterrupted; the same command goes on from {checkpoints}")
        return 130
    except ValueError as error:
        parser.error(str(error))
    outcomes = [*ears, *arms]
    rows = [row for found in outcomes for row in epoch_rows(found)]
    counts = operations([ears[0].problem, arms[0].problem])
    tqdm.write("")
    print(report(rows, counts, outcomes, minimum))
    with all_or_nothing(given.output) as folder:
        write_csv(folder / "epochs.csv", rows)
        write_csv(folder / "operations.csv", counts)
        write_json(folder / "peral_study.json", document(options, outcomes, rows, counts, minimum))
        drawn = pictures(ears, [arms[at] for at in np.argsort(given.noise)])
        for name, figure in drawn.items():
            save_picture(figure, folder / name)
    names = ", ".join(["epochs.csv", "operations.csv", "peral_study.json", *drawn])
    print(f"\nwrote {names} into {given.output}")
    return 0


def document(
    options: dict[str, Any],
    outcomes: Sequence[Outcome],
    rows: Sequence[dict[str, Any]],
    counts: Sequence[dict[str, Any]],
    minimum: dict[str, Any],
) -> dict[str, Any]:
    """All of it; infinite epochs are null."""
    return {
        "options": options,
        "trainings": [
            {
                "problem": found.problem.name,
                "variant": found.problem.variant,
                "hand-over [epochs]": found.hand_over,
                "epochs": found.epochs,
                "ended": found.ended,
                "seconds an epoch": found.seconds,
                "PERAL's first rate": found.rate,
            }
            for found in outcomes
        ],
        "epochs": rows,
        "operations": counts,
        "formulas": {"thesis": THESIS_FORMULAS, "counted": COUNTED_FORMULAS},
        "one minimum": minimum,
    }


if __name__ == "__main__":
    raise SystemExit(main())
