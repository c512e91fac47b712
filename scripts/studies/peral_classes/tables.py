"""Printed tables of the study of classes."""

from collections.abc import Sequence
from typing import Any

import numpy as np

from jaxcslc._text_table import text_table
from scripts.studies.peral_classes.classes import CLASSES
from scripts.studies.peral_classes.results import (
    BACKPROPAGATION,
    GOALS,
    PERAL_RULE,
    PERCEPTRON,
    best_seconds,
    guided_seconds,
    median_of,
    over_best,
    seconds_by_switch,
)


BEST, INDICATOR = "best switch", "indicator"
MIDDLE = 1  # index of the goal in the table of methods
Row = dict[str, Any]


class Results:
    """Rows of all parts, by class and noise.

    **Attributes**

    - `cases`: classes and noises, in order.
    - `rules`, `led`, `alternatives`: rows by class and noise; `spectra`: by class.
    """

    def __init__(self, rows: Sequence[Row]) -> None:
        def of_part(part: str) -> dict[tuple[str, float], Row]:
            return {(row["class"], row["noise"]): row for row in rows if row["part"] == part}

        self.rules, self.led = of_part("rules"), of_part("indicator")
        self.alternatives = of_part("alternatives")
        self.spectra = {name: row for (name, _), row in of_part("spectrum").items()}
        self.cases = list(self.rules)
        self.trained = [case for case in self.cases if BACKPROPAGATION in self.rules[case]]
        self.compared = [case for case in self.trained if not self.rules[case]["refused"]]

    def seconds(self, case: tuple[str, float], goal: int) -> dict[str, np.ndarray]:
        """Seconds to a goal by method, each of every seed."""
        row = self.rules[case]
        epoch = row["seconds"][BACKPROPAGATION]
        result = {BACKPROPAGATION: np.array(row[BACKPROPAGATION][goal]) * epoch}
        if not row["refused"]:
            result[PERAL_RULE] = np.array(row["after"][goal])[:, 0] * row["seconds"][PERAL_RULE]
            result[BEST] = best_seconds(row, goal)
            result[INDICATOR] = guided_seconds(row, self.led[case], goal)
        other = self.alternatives.get(case, {"steps": {}})
        for kind, steps in other["steps"].items():
            result[kind] = np.array(steps[goal]) * other["seconds"][kind]
        return result

    def epochs(self, case: tuple[str, float], goal: int) -> dict[str, np.ndarray]:
        """Epochs, or steps, to a goal by method, each of every seed."""
        row = self.rules[case]
        result = {BACKPROPAGATION: np.array(row[BACKPROPAGATION][goal])}
        if not row["refused"]:
            result[PERAL_RULE] = np.array(row["after"][goal])[:, 0]
            counts = np.array(self.led[case]["guided"][goal])
            result[INDICATOR] = counts[:, 0] + counts[:, 1]
        for kind, steps in self.alternatives.get(case, {"steps": {}})["steps"].items():
            result[kind] = np.array(steps[goal])
        return result

    def switch(self, case: tuple[str, float], goal: int) -> list[float]:
        """The epoch of the best switch of every seed, infinite for never."""
        row = self.rules[case]
        alone, switched = seconds_by_switch(row, goal)
        best = np.array(row["switches"])[np.argmin(switched, axis=1)].astype(float)
        return np.where(switched.min(axis=1) < alone, best, np.inf).tolist()

    def methods(self) -> list[Row]:
        """A row for each class, noise, goal and method."""
        rows: list[Row] = []
        for case in self.trained:
            for goal, excess in enumerate(GOALS):
                epochs = self.epochs(case, goal)
                for method, seconds in self.seconds(case, goal).items():
                    steps = epochs.get(method)
                    rows.append(
                        {
                            "class": case[0],
                            "noise": case[1],
                            "goal": excess,
                            "method": method,
                            "seeds": len(seconds),
                            "reached": int(np.isfinite(seconds).sum()),
                            "epochs, median": "" if steps is None else median_of(steps),
                            "seconds, median": median_of(seconds),
                        }
                    )
        return rows

    def indicator(self) -> list[Row]:
        """A row for each class, noise and goal: the indicator beside the best switch."""
        rows: list[Row] = []
        for case in self.compared:
            row, led = self.rules[case], self.led[case]
            for goal, excess in enumerate(GOALS):
                best = best_seconds(row, goal)
                alone, _ = seconds_by_switch(row, goal)
                with np.errstate(invalid="ignore", divide="ignore"):
                    of_alone = np.where(np.isinf(best) | (best == 0), np.nan, alone / best)
                rows.append(
                    {
                        "class": case[0],
                        "tuned": CLASSES[case[0]].tuned,
                        "noise": case[1],
                        "goal": excess,
                        "seeds": len(best),
                        "some switch reaches it": int(np.isfinite(best).sum()),
                        "the indicator reaches it": int(
                            np.isfinite(guided_seconds(row, led, goal)).sum()
                        ),
                        "best switch, median epoch": median_of(self.switch(case, goal)),
                        "indicator over best, median": median_of(over_best(row, led, goal)),
                        "backpropagation over best, median": median_of(of_alone),
                    }
                )
        return rows


def number(value: Any, digits: int = 3) -> str:
    """A number, `never` for infinity, a dash for none."""
    if isinstance(value, str) or np.isnan(value):
        return "-"
    return "never" if np.isinf(value) else f"{value:.{digits}g}"


def starred(name: str) -> str:
    """A class, with a star if the indicator's settings were selected on it."""
    return f"{name} *" if CLASSES[name].tuned else name


def method_table(results: Results, goal: int) -> str:
    """Milliseconds to a goal by class, noise and method, with the seeds that arrive."""
    every = [results.seconds(case, goal) for case in results.trained]
    names = list(dict.fromkeys(name for row in every for name in row))
    lines: list[list[str]] = []
    for (name, noise), row in zip(results.trained, every, strict=True):
        cells = [starred(name), f"{noise:.0%}"]
        for method in names:
            if method not in row:
                cells.append("-")
                continue
            values = row[method]
            missing = int(np.isinf(values).sum())
            text = number(1e3 * median_of(values), 2)
            cells.append(f"{text} ({len(values) - missing}/{len(values)})" if missing else text)
        lines.append(cells)
    return text_table(["class", "noise", *names], lines)


def epoch_table(results: Results, goal: int) -> str:
    """Epochs or steps to a goal by class, noise and method, and the best switch."""
    every = [results.epochs(case, goal) for case in results.trained]
    names = list(dict.fromkeys(name for row in every for name in row))
    lines: list[list[str]] = []
    for case, row in zip(results.trained, every, strict=True):
        best = median_of(results.switch(case, goal)) if case in results.compared else np.nan
        cells = [number(median_of(row[method])) if method in row else "-" for method in names]
        lines.append([starred(case[0]), f"{case[1]:.0%}", *cells, number(best)])
    return text_table(["class", "noise", *names, "best switch after"], lines)


def indicator_table(results: Results) -> str:
    """The indicator's time over that of the best switch, by class, noise and goal."""
    by_case: dict[tuple[str, float], list[Row]] = {}
    for row in results.indicator():
        by_case.setdefault((row["class"], row["noise"]), []).append(row)
    lines = [
        [
            starred(name),
            f"{noise:.0%}",
            *(number(row["indicator over best, median"]) for row in rows),
            *(number(row["backpropagation over best, median"]) for row in rows),
        ]
        for (name, noise), rows in by_case.items()
    ]
    header = ["class", "noise"]
    for what in ("indicator", "backpropagation alone"):
        header += [f"{what}, {goal:.0%}" for goal in GOALS]
    return text_table(header, lines)


_PAGE_NOISE = 0.05


def page_tables(results: Results) -> dict[str, list[list[str]]]:
    """Tables of the page by their names, the head first, at a noise of 5 %."""
    cases = [case for case in results.trained if case[1] == _PAGE_NOISE]
    epochs = {case: results.epochs(case, MIDDLE) for case in cases}
    seconds = {case: results.seconds(case, MIDDLE) for case in cases}
    tables: dict[str, list[list[str]]] = {}
    for name, values, digits in (("epochs", epochs, 3), ("milliseconds", seconds, 2)):
        methods = list(dict.fromkeys(method for row in values.values() for method in row))
        size = 1e3 if name == "milliseconds" else 1.0
        tables[name] = [["", *methods]]
        for case, row in values.items():
            cells = [_arrived(size * row[x], digits) if x in row else "" for x in methods]
            tables[name].append([starred(case[0]), *cells])
    tables["epochs"][0].append("best switch to PERAL after")
    for case, line in zip(cases, tables["epochs"][1:], strict=True):
        compared = case in results.compared
        line.append(number(median_of(results.switch(case, MIDDLE))) if compared else "")
    tables["hindsight"] = [["excess error", *(f"{goal:.0%}" for goal in GOALS)]]
    ratios = ("indicator over best, median", "backpropagation over best, median")
    rows = [row for row in results.indicator() if row["noise"] == _PAGE_NOISE]
    for name in dict.fromkeys(row["class"] for row in rows):
        of_class = (row for row in rows if row["class"] == name)
        cells = ["{} ({})".format(*(number(row[x]) for x in ratios)) for row in of_class]
        tables["hindsight"].append([starred(name), *cells])
    for tuned, which in ((False, "not tuned on"), (True, "tuned on")):
        cells = [
            "{} ({})".format(
                *(
                    number(over_classes(results, tuned=tuned, goal=i, what=what))
                    for what in (INDICATOR, BACKPROPAGATION)
                )
            )
            for i in range(len(GOALS))
        ]
        tables["hindsight"].append([f"median of classes {which}, all noises", *cells])
    return tables


def _arrived(values: np.ndarray, digits: int) -> str:
    """The median, with the number of seeds that arrive if it is not all."""
    arrive = int(np.isfinite(values).sum())
    text = number(median_of(values), digits)
    return text if arrive == len(values) else f"{text} ({arrive})"


def over_classes(results: Results, *, tuned: bool, goal: int, what: str) -> float:
    """Median over classes of the median over noises of a ratio to the best switch."""
    by_class: dict[str, list[float]] = {}
    for row in results.indicator():
        if row["tuned"] == tuned and row["goal"] == GOALS[goal]:
            by_class.setdefault(row["class"], []).append(row[f"{what} over best, median"])
    return median_of([median_of(values) for values in by_class.values()])


def spectrum_table(results: Results) -> str:
    """Conditions of both rules at the optimum."""
    lines: list[list[str]] = []
    for name, row in results.spectra.items():
        cells = [name]
        for rule in (BACKPROPAGATION, PERAL_RULE):
            of_rule = row["condition"].get(rule)
            cells.append("-" if of_rule is None else number(median_of(of_rule)))
        away = row["away"].get(PERAL_RULE)
        cells.append("-" if away is None else f"{sum(x > 0 for x in away)}/{len(away)}")
        lines.append(cells)
    header = ["class", "condition, backpropagation", "condition, PERAL", "PERAL leads away"]
    return text_table(header, lines)


def refusals(results: Results) -> str:
    """Return what PERAL does not train, and why."""
    reasons = {name: row["refused"] for (name, _), row in results.rules.items() if row["refused"]}
    lines = [f"{name}: {reason}" for name, reason in reasons.items()]
    for (name, _), row in results.rules.items():
        if PERCEPTRON in row:
            reached = np.array(row[PERCEPTRON])
            lines.append(
                f"{name}: the perceptron rule ends without an error in"
                f" {int(np.isfinite(reached).sum())} of {len(reached)} trainings, after"
                f" {number(median_of(reached))} epochs in the median"
            )
    return "\n".join(lines)


def report(results: Results, seeds: int) -> str:
    """Return everything that the study prints."""
    goal = f"{GOALS[MIDDLE]:.0%}"
    parts: list[str] = []
    if results.trained:
        parts += [
            f"Milliseconds to an excess error of {goal}, medians of {seeds} seeds (seeds that"
            " arrive)\n" + method_table(results, MIDDLE),
            f"Epochs or steps to an excess error of {goal}, medians\n"
            + epoch_table(results, MIDDLE),
        ]
    if results.compared:
        parts.append(
            "Time over that of the best switch in hindsight, medians, by excess error\n"
            + indicator_table(results)
        )
        for tuned, which in ((False, "not tuned on"), (True, "tuned on")):
            ratios = [
                f"{excess:.0%}: {{}} ({{}})".format(
                    *(
                        number(over_classes(results, tuned=tuned, goal=i, what=what))
                        for what in (INDICATOR, BACKPROPAGATION)
                    )
                )
                for i, excess in enumerate(GOALS)
            ]
            parts.append(
                f"Classes {which}, median over classes, of backpropagation alone in brackets: "
                + ", ".join(ratios)
            )
    if results.spectra:
        parts.append(
            "Condition at the optimum, without noise: largest over smallest eigenvalue, medians;"
            " never: a direction that the rule does not see\n" + spectrum_table(results)
        )
    if text := refusals(results):
        parts.append("Not trained by PERAL\n" + text)
    return "\n\n".join(parts)


def tuning_table(rows: Sequence[Row]) -> str:
    """Settings of the indicator: its time over the best switch, by goal."""
    rules = {(row["class"], row["noise"]): row for row in rows if row["part"] == "rules"}
    by_setting: dict[tuple[int, float], list[list[float]]] = {}
    for row in rows:
        if row["part"] == "indicator":
            ratios = [
                median_of(over_best(rules[row["class"], row["noise"]], row, goal))
                for goal in range(len(GOALS))
            ]
            by_setting.setdefault((row["every"], row["margin"]), []).append(ratios)
    lines = [
        [str(every), f"{margin:g}"]
        + [number(median_of(column)) for column in np.array(ratios).T]
        + [number(float(np.nanmean(np.log(ratios))))]
        for (every, margin), ratios in by_setting.items()
    ]
    header = ["every", "margin", *(f"{goal:.0%}" for goal in GOALS), "mean logarithm"]
    return text_table(header, lines)
