"""Printed tables of the study of PERAL: epochs and seconds to goals, operations, one minimum."""

from collections.abc import Sequence
from typing import Any

import numpy as np
from jaxtyping import Float

from jaxcslc._text_table import text_table
from scripts.studies.training.peral_comparison import RULES, Outcome, Problem, starts
from scripts.studies.training.peral_operations import (
    BACKPROPAGATION,
    COUNTED_FORMULAS,
    PERAL_RULE,
    THESIS_CSLC,
    THESIS_FORMULAS,
    THESIS_IDENTIFICATION,
    compiled,
    counted,
    dense_links,
    seconds_per_pattern,
)


def spread(values: Float[np.ndarray, " seeds"]) -> dict[str, float]:
    """Lowest, quartiles and highest; infinity is a number like others, NaN is left out."""
    numbers = values[~np.isnan(values)]
    if not numbers.size:
        return dict.fromkeys(("lowest", "lower", "median", "upper", "highest"), float("nan"))
    quantiles = np.quantile(numbers, (0.0, 0.25, 0.5, 0.75, 1.0), method="inverted_cdf")
    names = ("lowest", "lower", "median", "upper", "highest")
    return dict(zip(names, map(float, quantiles), strict=True))


def epoch_rows(outcome: Outcome) -> list[dict[str, Any]]:
    """A line for every goal and rule: epochs and seconds from the hand-over, over seeds."""
    rows: list[dict[str, Any]] = []
    handed = int(np.isfinite(outcome.hand_over).sum())
    for goal in outcome.goals:
        both = [outcome.epochs[rule][goal] for rule in RULES]
        with np.errstate(invalid="ignore"):
            sooner = int(np.sum(both[1] < both[0]))
        for rule, epochs in zip(RULES, both, strict=True):
            over = spread(epochs)
            rows.append(
                {
                    "problem": outcome.problem.name,
                    "variant": outcome.problem.variant,
                    "goal": goal,
                    "rule": rule,
                    "seeds": len(epochs),
                    "handed over": handed,
                    "reached": int(np.isfinite(epochs).sum()),
                    "epochs, lower quartile": over["lower"],
                    "epochs, median": over["median"],
                    "epochs, upper quartile": over["upper"],
                    "ms an epoch": 1e3 * outcome.seconds[rule],
                    "seconds, lower quartile": outcome.seconds[rule] * over["lower"],
                    "seconds, median": outcome.seconds[rule] * over["median"],
                    "seconds, upper quartile": outcome.seconds[rule] * over["upper"],
                    "backpropagation's median epochs over PERAL's": quotient(
                        spread(both[0])["median"], spread(both[1])["median"]
                    ),
                    "backpropagation's median seconds over PERAL's": quotient(
                        outcome.seconds[BACKPROPAGATION] * spread(both[0])["median"],
                        outcome.seconds[PERAL_RULE] * spread(both[1])["median"],
                    ),
                    "seeds with PERAL sooner": sooner,
                }
            )
    return rows


def quotient(a: float, b: float) -> float:
    """NaN where neither ended: their order is unknown."""
    if np.isinf(a) and np.isinf(b):
        return float("nan")
    return float(np.divide(a, b)) if b else float("inf") if a else 1.0


def epochs_cells(rows: Sequence[dict[str, Any]]) -> list[list[str]]:
    """Epochs and seconds to each goal, the head first."""
    header = [
        "",
        "goal",
        "rule",
        "reached",
        "epochs (quartiles)",
        "seconds",
        "ratio",
        "PERAL sooner",
    ]
    lines = [
        [
            f"{row['problem']}, {row['variant']}",
            row["goal"],
            row["rule"],
            f"{row['reached']}/{row['handed over']}",
            f"{number(row['epochs, median'])} ({number(row['epochs, lower quartile'])} to"
            f" {number(row['epochs, upper quartile'])})",
            number(row["seconds, median"], 3),
            ratio_text(row) if row["rule"] == PERAL_RULE else "",
            str(row["seeds with PERAL sooner"]) if row["rule"] == PERAL_RULE else "",
        ]
        for row in rows
    ]
    return [header, *lines]


def epochs_table(rows: Sequence[dict[str, Any]]) -> str:
    """The same as text."""
    head, *lines = epochs_cells(rows)
    return text_table(head, lines)


def ratio_text(row: dict[str, Any]) -> str:
    """Epochs first, then seconds."""
    names = ("epochs", "seconds")
    ratios = [row[f"backpropagation's median {name} over PERAL's"] for name in names]
    return " / ".join(number(value, 2) for value in ratios)


def number(value: float, digits: int = 4) -> str:
    """A number, `never` for infinity."""
    if np.isnan(value):
        return "-"
    return "never" if np.isinf(value) else f"{value:.{digits}g}"


def operations(problems: Sequence[Problem]) -> list[dict[str, Any]]:
    """Fig. 6.3-5, for its two problems."""
    rows: list[dict[str, Any]] = []
    printed = {"ultrasound": THESIS_IDENTIFICATION, "PUMA 560": THESIS_CSLC}
    for problem in problems:
        links, dense = dense_links(problem.network)
        for name, rule in RULES.items():
            weights = starts(problem, 1)[0]
            case = (problem.network, rule, problem.first, weights)
            operations_of = compiled(*case)
            rows.append(
                {
                    "network": f"{problem.name}: {links} links, {dense} multiplied",
                    "rule": name,
                    "thesis": printed[problem.name][name],
                    "counted": counted(problem.network)[name],
                    "compiled": operations_of["operations"],
                    "compiled, transcendental": operations_of["transcendental"],
                    "ns a pattern": 1e9 * seconds_per_pattern(*case),
                }
            )
    return rows


def operations_table(rows: Sequence[dict[str, Any]]) -> str:
    """Operations and time of a pattern in an epoch."""
    header = ["", "rule", "thesis", "counted", "compiled", "ns"]
    general = [
        ["general two-layer", name, THESIS_FORMULAS[name], COUNTED_FORMULAS[name], "", ""]
        for name in RULES
    ]
    lines = [
        [
            row["network"],
            row["rule"],
            f"{row['thesis']:,}",
            f"{row['counted']:,}",
            f"{row['compiled']:,.0f}",
            f"{row['ns a pattern']:.0f}",
        ]
        for row in rows
    ]
    return text_table(header, [*general, *lines])


def report(
    rows: Sequence[dict[str, Any]],
    counts: Sequence[dict[str, Any]],
    outcomes: Sequence[Outcome],
    minimum: dict[str, Any],
) -> str:
    """Return everything that the study prints."""
    parts = [
        "From the hand-over; ratio: backpropagation's median over PERAL's, epochs / seconds (the"
        " thesis: about five times fewer epochs)\n" + epochs_table(rows)
    ]
    for outcome in outcomes:
        ended = "; ".join(
            f"{rule}: " + ", ".join(f"{n} {how}" for how, n in ways.items())
            for rule, ways in outcome.ended.items()
        )
        over = spread(outcome.hand_over)
        parts.append(
            f"{outcome.problem.name}, {outcome.problem.variant}: handed over after"
            f" {number(over['median'])} epochs ({number(over['lowest'])} to"
            f" {number(over['highest'])}); PERAL's first rate {outcome.rate:g}; one epoch"
            f" {1e3 * outcome.seconds[BACKPROPAGATION]:.2f} and"
            f" {1e3 * outcome.seconds[PERAL_RULE]:.2f} ms. Ended: {ended}"
        )
    parts.append(
        "Floating point operations of an epoch for a pattern, and time of the change of weights"
        " (Fig. 6.3-5)\n" + operations_table(counts) + "\nCompiled adaptive layers are dense"
        " products: links that do not exist are multiplied too."
    )
    near, ratios = minimum["ended"], minimum["backpropagation"]
    parts.append(
        f"One minimum: of {minimum['starts']} starts, backpropagation brings {near['below']} to"
        f" {near['ratio']:g} times the direct solution's half square cost or below; ratio at most"
        f" {ratios['highest']:.6f}, median {ratios['median']:.6f}; epochs: median"
        f" {number(minimum['epochs']['median'], 6)}, at most"
        f" {number(minimum['epochs']['highest'], 6)}\nthe comparison's own trainings, ratio"
        f" ({minimum['of']}): "
        + "; ".join(
            f"{name} {number(over['median'])} ({number(over['lowest'])} to"
            f" {number(over['highest'])})"
            for name, over in minimum["comparison"].items()
        )
    )
    return "\n\n".join(parts)
