"""The largest rate that still lowers the cost, along trainings by both rules (thesis 6.3.3).

Section 6.3.3: PERAL's rate "can be increased as training advances", backpropagation's "must
necessarily be reduced". At checkpoints of trainings by the rule of 6.3.1, this measures

- **one epoch**: below which rate an epoch lowers the cost, one rate for all layers;
- **epochs on end**: below which rate each of so many epochs, 50 by default, lowers it;
- **stable rate**: below which rate small errors shrink, from the eigenvalues of the Jacobian of
  the rule's change there. Where the cost is a parabola, that of backpropagation is the same
  everywhere: 2 over the largest curvature;
- **leading away**: how many eigenvalues have a part that grows at every rate;
- **adapted**: the rate that the training has come to by then, the geometric mean over layers.

Problems: the PUMA 560's CSLC on true motion with torques that it answers exactly, on what encoders
show of a simulated one, and with the noise of 10 % of 6.3.2; and the ultrasound scene's sigmoids
(6.3.1). Each by the half square cost and by the mean error modulus, which the thesis adapts rates
by. PERAL begins from the weights that backpropagation has at the hand-over.

    python -m scripts.studies.training.largest_rates
    python -m scripts.studies.training.largest_rates --quick
"""

import argparse
import functools
from collections.abc import Sequence
from pathlib import Path
from typing import Any

import equinox as eqx
import jax
import jax.numpy as jnp
import numpy as np
from jaxtyping import Array, Bool, Float, Int
from matplotlib.figure import Figure

import jaxcslc as jc
import sim
from jaxcslc._text_table import text_table
from jaxcslc.report import all_or_nothing, write_csv
from jaxcslc.training import (
    AbstractRule,
    AdaptedRates,
    AdaptiveNetwork,
    Cost,
    Examples,
    Plan,
    examples,
    half_square,
    inverse_dynamics,
    mean_modulus,
    train,
)
from scripts.studies import command
from scripts.studies.figures import COLOURS, STYLES, new_figure, save_picture
from scripts.studies.rows import Rows, made_of
from scripts.studies.stored import store
from scripts.studies.tables import grouped, number_text
from scripts.studies.training.peral_comparison import (
    BACKPROPAGATION_RATE,
    RULES,
    Problem,
    stable_rate,
    starts,
    ultrasound,
)
from scripts.studies.training.peral_operations import BACKPROPAGATION, PERAL_RULE
from scripts.studies.truth import published_coefficients


jc.enable_x64()

COSTS: dict[str, Cost] = {"half square": half_square, "mean modulus": mean_modulus}
EXACT, ENCODERS, NOISE, SCENE = "PUMA, exact", "PUMA, encoders", "PUMA, noise 10 %", "ultrasound"
PROBLEMS = (EXACT, ENCODERS, NOISE, SCENE)
CHECKPOINTS = (0, 10, 30, 100, 300, 1000)
ONE, MANY, STABLE, AWAY = "one epoch", "epochs on end", "stable rate", "leading away"
ADAPTED = "adapted"
MEASURES = (ONE, MANY, STABLE, AWAY, ADAPTED)
KEYS = ("problem", "cost", "rule", "start", "epoch")
# Rates that are tried: from which, times what, up to which, and then how many in between.
_LOWEST, _FACTOR, _HIGHEST, _BISECTIONS = 2.0**-20, 4.0, 2.0**30, 8
# Of the rate at the first checkpoint: the lower edge of the picture.
_EDGE = 1e-3
# Of the largest eigenvalue: below, a direction counts as one that the rule does not see.
_UNSEEN = 1e-9


@functools.cache
def puma_network() -> AdaptiveNetwork:
    """The PUMA 560's CSLC: one for all problems, so that programs compile once."""
    return inverse_dynamics(jc.derive(jc.puma560()))


def problem_of(name: str, patterns: int) -> Problem:
    """A problem by name."""
    if name == SCENE:
        return ultrasound(patterns, centred=True)
    machine = sim.puma560() if name == NOISE else sim.undisturbed(sim.puma560())
    if name == ENCODERS:
        machine = sim.disturbed(machine, "quantisation")
    recording, truth = sim.simulate(machine, sim.training(), seed=0)
    columns = (truth.position, truth.velocity, truth.acceleration, truth.torque)
    mask = np.ones(truth.torque.shape, bool)
    if name == NOISE:
        rng = np.random.default_rng([0, 1])
        columns = tuple(x + 0.1 * x.std(axis=0) * rng.standard_normal(x.shape) for x in columns)
    elif name == ENCODERS:
        prepared = jc.prepare(recording)
        columns = (prepared.q, prepared.qd, prepared.qdd, prepared.torque)
        mask = np.asarray(prepared.mask)
    rows = np.arange(patterns) * (len(mask) // patterns)
    *motion, torque = (jnp.asarray(x)[rows] for x in columns)
    if name == EXACT:  # simulated joints stick at rest, which the network has no term for
        truth_of = published_coefficients(jc.derive(jc.puma560()))
        torque = puma_network().outputs(truth_of, tuple(motion))
    of_training = examples(puma_network(), tuple(motion), torque, mask[rows])
    return Problem("PUMA 560", name, puma_network(), of_training, of_training)


def direction(
    network: AdaptiveNetwork, rule: AbstractRule, patterns: Examples, weights: Array
) -> Float[Array, " weights"]:
    """Return what an epoch at a rate of one, the same for all layers, moves the weights by."""
    learning = (True,) * len(network.groups)
    return jnp.sum(patterns.change(network, rule, weights, learning), axis=0)


@eqx.filter_jit
def largest_rate(
    network: AdaptiveNetwork,
    rule: AbstractRule,
    cost: Cost,
    patterns: Examples,
    weights: Float[Array, " weights"],
    epochs: Int[Array, ""],
) -> Float[Array, ""]:
    """Below which rate each of some epochs lowers the cost: zero if none does, infinite if all do.

    Raised from a low rate until the cost rises, then found between the two by bisection. Rates
    far beyond may lower it once more, where sigmoids saturate.
    """

    def cost_of(w: Array) -> Array:
        return patterns.costs(network, w, cost)[0]

    def lowers(rate: Array) -> Bool[Array, ""]:
        def going_on(carry: tuple[Array, Array, Array, Array]) -> Array:
            return carry[3] & (carry[0] < epochs)

        def epoch(carry: tuple[Array, Array, Array, Array]) -> tuple[Array, Array, Array, Array]:
            passed, w, before, _ = carry
            w = w + rate * direction(network, rule, patterns, w)
            after = cost_of(w)
            return passed + 1, w, after, after < before

        first = (jnp.zeros((), int), weights, cost_of(weights), jnp.ones((), bool))
        return jax.lax.while_loop(going_on, epoch, first)[3]

    def raised(carry: tuple[Array, Array]) -> tuple[Array, Array]:
        return carry[1], carry[1] * _FACTOR

    lowest = jnp.asarray(_LOWEST, weights.dtype)
    good, bad = jax.lax.while_loop(
        lambda carry: (carry[1] < _HIGHEST) & lowers(carry[1]), raised, (0.0 * lowest, lowest)
    )

    def bisected(_: Array, interval: tuple[Array, Array]) -> tuple[Array, Array]:
        middle = jnp.sqrt(interval[0] * interval[1])
        fine = lowers(middle)
        return jnp.where(fine, middle, interval[0]), jnp.where(fine, interval[1], middle)

    between, _ = jax.lax.fori_loop(0, _BISECTIONS, bisected, (good, bad))
    return jnp.where(bad >= _HIGHEST, jnp.inf, jnp.where(good > 0.0, between, 0.0))


@eqx.filter_jit
def _jacobian(
    network: AdaptiveNetwork, rule: AbstractRule, patterns: Examples, weights: Array
) -> Array:
    return jax.jacfwd(lambda w: direction(network, rule, patterns, w))(weights)


def shrinking_rate(jacobian: Float[np.ndarray, "weights weights"]) -> float:
    """Below which rate small errors shrink in every direction that the rule leads back along.

    A direction of eigenvalue -λ changes by 1 - rate x λ in an epoch, which is below one in modulus
    for rates up to 2 Re λ / |λ|². Directions that lead away, Re λ < 0, do so at every rate.
    """
    values = -np.linalg.eigvals(jacobian)
    seen = values[values.real > _UNSEEN * np.max(np.abs(values))]
    return float(np.min(2.0 * seen.real / np.abs(seen) ** 2)) if seen.size else np.nan


def leading_away(jacobian: Float[np.ndarray, "weights weights"]) -> int:
    """Return how many directions grow at every rate."""
    values = np.linalg.eigvals(jacobian)
    return int(np.sum(values.real > _UNSEEN * np.max(np.abs(values))))


def rows_of(name: str, cost: str, options: argparse.Namespace) -> list[dict[str, Any]]:
    """Return both rules on one problem, every start and checkpoint."""
    problem = problem_of(name, options.patterns)
    network, measured_by = problem.network, COSTS[cost]
    hand_over = options.scene_hand_over if name == SCENE else options.hand_over
    epochs = max(options.checkpoints) + 1
    begin = starts(problem, options.starts)
    rows: list[dict[str, Any]] = []
    for rule_name, rule in RULES.items():
        rate = BACKPROPAGATION_RATE
        if rule_name == PERAL_RULE:
            rate = stable_rate(problem, begin, measured_by)
        training = train(
            network, problem.examples, begin, Plan(rule, AdaptedRates(rate), cost=measured_by,
            patience=10**6), epochs=max(epochs, hand_over + 1),
        )  # fmt: skip
        history = training.history
        assert history.weights is not None
        for start in range(options.starts):
            for epoch in options.checkpoints:
                weights = jnp.asarray(history.weights[start, epoch])
                one, many = (
                    float(
                        largest_rate(
                            network, rule, measured_by, problem.first, weights, jnp.asarray(count)
                        )
                    )
                    for count in (1, options.on_end)
                )
                jacobian = np.asarray(_jacobian(network, rule, problem.first, weights))
                rates = np.asarray(history.rates[start, epoch])
                rows.append(
                    dict(zip(KEYS, (name, cost, rule_name, start, epoch), strict=True))
                    | {
                        "value": float(history.cost[start, epoch]),
                        ONE: one,
                        MANY: many,
                        STABLE: shrinking_rate(jacobian),
                        AWAY: leading_away(jacobian),
                        ADAPTED: float(np.exp(np.mean(np.log(rates)))),
                    }
                )
        if rule_name == BACKPROPAGATION:
            begin = jnp.asarray(history.weights[:, hand_over])
    return rows


def medians(
    rows: Sequence[dict[str, Any]], checkpoints: Sequence[int]
) -> dict[tuple[str, str, str], dict[str, Float[np.ndarray, " checkpoints"]]]:
    """Return by problem, cost and rule each median over starts at the checkpoints."""
    cases = list(dict.fromkeys((row["problem"], row["cost"], row["rule"]) for row in rows))
    return {
        case: {
            measure: np.array(
                [
                    np.median(
                        [
                            row[measure]
                            for row in rows
                            if (row["problem"], row["cost"], row["rule"]) == case
                            and row["epoch"] == epoch
                        ]
                    )
                    for epoch in checkpoints
                ]
            )
            for measure in ("value", *MEASURES)
        }
        for case in cases
    }


def table(rows: Sequence[dict[str, Any]], checkpoints: Sequence[int]) -> list[list[str]]:
    """Medians over starts, a line for each case and measure; the head first."""
    lines = [
        [*case, measure, *(number_text(float(x), 3) for x in values)]
        for case, of_case in medians(rows, checkpoints).items()
        for measure, values in of_case.items()
    ]
    header = ["problem", "cost", "rule", "measure", *(f"epoch {x}" for x in checkpoints)]
    return [header, *lines]


def picture(rows: Sequence[dict[str, Any]], checkpoints: Sequence[int]) -> Figure:
    """Largest rates of epochs on end, over those at the first checkpoint; a panel for each cost.

    Where no rate lowers the cost, the mark is at the lower edge.
    """
    of_case = medians(rows, checkpoints)
    costs = list(dict.fromkeys(cost for _, cost, _ in of_case))
    problems = list(dict.fromkeys(name for name, _, _ in of_case))
    figure = new_figure(4.6 * len(costs) + 0.6, 4.6)
    panels = figure.subplots(1, len(costs), squeeze=False, sharey=True)[0]
    for axes, cost in zip(panels, costs, strict=True):
        for (name, of_cost, rule), values in of_case.items():
            if of_cost != cost:
                continue
            rates = values[MANY]
            first = rates[0] if rates[0] > 0 else np.nan
            axes.plot(
                np.maximum(checkpoints, 1), np.maximum(rates / first, _EDGE),
                color=COLOURS[problems.index(name) % len(COLOURS)], marker="o", ms=4,
                ls=STYLES[rule == PERAL_RULE], label=f"{name}, {rule}",
            )  # fmt: skip
        axes.set_xscale("log")
        axes.set_yscale("log")
        axes.set_ylim(bottom=_EDGE)
        axes.grid(alpha=0.25)
        axes.set_xlabel("epochs (lower edge: no rate lowers the cost)")
        axes.set_title(f"by the {cost}")
    panels[0].set_ylabel("largest rate / that at the first checkpoint")
    handles, labels = panels[0].get_legend_handles_labels()
    figure.legend(handles, labels, loc="outside lower center", ncols=2, frameon=False)
    return figure


def study(options: argparse.Namespace) -> int:
    """Measures what is missing, prints the table and writes the files."""
    names = ("patterns", "starts", "hand_over", "scene_hand_over", "on_end", "checkpoints")
    code = [Path(__file__), Path(__file__).with_name("peral_comparison.py")]
    finished = Rows(
        options.output / "rows.jsonl", KEYS, made_of({n: getattr(options, n) for n in names}, code)
    )
    cases = [(name, cost) for name in options.problems for cost in options.costs]
    last = (BACKPROPAGATION, PERAL_RULE)[-1], options.starts - 1, options.checkpoints[-1]
    with command.progress(desc="problems", unit="case", total=len(cases)) as bar:
        for case in cases:
            bar.set_description(", ".join(case))
            if (*case, *last) not in finished:
                finished.add(*rows_of(*case, options))
            bar.update()
    rows = [row for row in finished.all() if (row["problem"], row["cost"]) in cases]
    print(f"Medians of {options.starts} starts; value: of the cost before the epoch")
    head, *lines = table(rows, options.checkpoints)
    print(text_table(head, lines, left=head[:4]))
    tables = {"rates": grouped([head, *lines])}
    store(options, "largest_rates", f"{options.starts} starts", tables)
    with all_or_nothing(options.output) as folder:
        write_csv(folder / "rates.csv", rows)
        save_picture(picture(rows, options.checkpoints), folder / "rates.png")
    print(f"wrote rates.csv and rates.png into {options.output}")
    return 0


def main(argv: Sequence[str] | None = None) -> int:
    parser = command.new_parser(__doc__, "largest_rates")
    parser.add_argument("--problems", nargs="+", default=list(PROBLEMS), metavar="NAME",
                        help=f"some of: {', '.join(map(repr, PROBLEMS))}")  # fmt: skip
    parser.add_argument("--costs", nargs="+", default=list(COSTS), metavar="NAME",
                        help=f"some of: {', '.join(map(repr, COSTS))}")  # fmt: skip
    parser.add_argument("--patterns", type=int, default=165, help="of a training")
    parser.add_argument("--starts", type=int, default=3, help="random weights to start from")
    parser.add_argument("--hand-over", type=int, default=500, help="epochs before PERAL, PUMA")
    parser.add_argument("--scene-hand-over", type=int, default=50, help="the same, ultrasound")
    parser.add_argument("--on-end", type=int, default=50, help="epochs that must lower the cost")
    parser.add_argument("--checkpoints", type=int, nargs="+", default=list(CHECKPOINTS),
                        help="epochs at which rates are measured")  # fmt: skip
    command.add_store(parser)
    options = command.parse(
        parser, argv, problems=[SCENE], patterns=100, starts=1, checkpoints=[0, 10, 30],
        on_end=10, scene_hand_over=20,
    )  # fmt: skip
    command.require_least(
        parser, options, patterns=30, starts=1, hand_over=1, scene_hand_over=1, on_end=1
    )
    command.require_some_of(parser, "problem", options.problems, PROBLEMS)
    command.require_some_of(parser, "cost", options.costs, tuple(COSTS))
    options.checkpoints = sorted(set(options.checkpoints))
    if options.checkpoints[0] < 0:
        parser.error(f"--checkpoints begin at {options.checkpoints[0]}; expected 0 or more")
    return command.run(
        parser, lambda: study(options), options.output / "rows.jsonl", seconds=seconds(options)
    )


def seconds(options: argparse.Namespace) -> float:
    """Return how long the study takes on two cores: compilation, trainings, epochs on end."""
    cases = len(options.problems) * len(options.costs)
    measured = options.starts * len(options.checkpoints) * options.on_end
    return cases * (40.0 + 8e-6 * options.patterns * (max(options.checkpoints) + measured))


if __name__ == "__main__":
    raise SystemExit(main())
