"""Chapter 7's training of the network in `network.py`: rules, rates, turns and ε, in NumPy alone.

Written from the thesis (3.4, 5.2.6, 6.2, 6.3.1, 6.3.2, 7.5). Where it is silent, from what the
docstrings of `Backpropagation`, `PERAL`, `AdaptedRates`, `Schedule` and `half_rms` in
`jaxcslc.training` promise. Nothing of `jaxcslc` is used. Batch mode: averages over patterns.
"""

from collections.abc import Callable, Sequence
from typing import NamedTuple

import numpy as np
from jaxtyping import Float

from scripts.studies.transcription.network import Signals, Subnetwork, Values, forward, outputs


Coefficients = Float[np.ndarray, " coefficients"]
Counts = Float[np.ndarray, "subnetworks outputs patterns"]
#: Rates, one per subnetwork (6.3.2).
Rates = Float[np.ndarray, " subnetworks"]
#: How far an epoch at a rate of one moves k, one row for the links of each subnetwork.
Change = Float[np.ndarray, "subnetworks coefficients"]


class Problem(NamedTuple):
    """A network and its training patterns.

    **Attributes**

    - `parts`, `signals`: subnetworks, and what enters each.
    - `t`: target torques [N m].
    - `counts`: one where a pair of output and pattern takes part in a subnetwork's training.
    """

    parts: tuple[Subnetwork, ...]
    signals: tuple[Signals, ...]
    t: Values
    counts: Counts

    @property
    def judged(self) -> Values:
        """Pairs that ε judges: those that at least one subnetwork learns from."""
        return np.max(self.counts, axis=0)

    @property
    def patterns(self) -> int:
        """The number p of patterns with a pair that counts: averages divide by it."""
        return int(np.sum(np.any(self.judged > 0, axis=0)))


def cost_of(errors: Values, judged: Values) -> float:
    """Return ε: half the root mean square over a pattern's joints, averaged over patterns (7.5)."""
    joints = np.sum(judged, axis=0)
    some = joints > 0
    mean_squares = np.sum(errors**2 * judged, axis=0)[some] / joints[some]
    return float(0.5 * np.mean(np.sqrt(mean_squares)))


def sharing_links(parts: Sequence[Subnetwork], size: int) -> Coefficients:
    """Return how many links share each coefficient, in all subnetworks (5.2.6)."""
    sharing = np.zeros(size)
    for part in parts:
        for link in part.links:
            sharing[link.k] += 1
    return sharing


def quotient(a: np.ndarray, b: np.ndarray) -> np.ndarray:
    """Return a / b, and nothing where there is nothing to divide among: the thesis's 0 / 0."""
    return np.divide(a, b, out=np.zeros_like(a), where=b != 0)


def backpropagation(problem: Problem, k: Coefficients, errors: Values) -> Change:
    """Return the change by Eqn. 3.4-9; by the chain rule, dW moves k by multiple times dW."""
    sharing = sharing_links(problem.parts, k.size)
    change = np.zeros((len(problem.parts), k.size))
    for row, part, signals, counts in zip(
        change, problem.parts, problem.signals, problem.counts, strict=True
    ):
        delta = errors * counts
        for layer, context in zip(reversed(part.contexts), reversed(signals.contexts), strict=True):
            nodes = 1 + max(link.source for link in layer.links)
            behind = np.zeros((nodes, delta.shape[1]))
            for link in layer.links:
                behind[link.source] += context[link.context] * delta[link.node]
            delta = behind
        for link in part.links:
            dW = signals.x[link.source] @ delta[link.node] / problem.patterns
            row[link.k] += link.multiple * dW / sharing[link.k]
    return change


def peral(problem: Problem, k: Coefficients, errors: Values) -> Change:
    """Return the change by Eqns. 6.2-1 to 6.2-7; dW moves k by dW over the link's multiple.

    Eqn. 6.2-3 averages over the nodes that a node connects to. It is taken twice through the
    velocity subnetwork's two context layers. The error of an output node is shared among the
    links of all subnetworks.
    """
    passed = [
        forward(part, signals, k)
        for part, signals in zip(problem.parts, problem.signals, strict=True)
    ]
    # What links bring to the nodes of each layer, in moduli: the sums under Eqns. 6.2-3, 6.2-6.
    brought: list[list[Values]] = []
    for part, signals, values in zip(problem.parts, problem.signals, passed, strict=True):
        total = np.zeros_like(values[0])
        for link in part.links:
            total[link.node] += abs(link.multiple * k[link.k]) * np.abs(signals.x[link.source])
        layers = [total]
        for number, layer in enumerate(part.contexts):
            total = np.zeros((layer.nodes, total.shape[1]))
            context, below = np.abs(signals.contexts[number]), np.abs(values[number])
            for link in layer.links:
                total[link.node] += context[link.context] * below[link.source]
            layers.append(total)
        brought.append(layers)
    at_outputs = np.sum([layers[-1] for layers in brought], axis=0)

    sharing = sharing_links(problem.parts, k.size)
    change = np.zeros((len(problem.parts), k.size))
    for number, (part, signals) in enumerate(zip(problem.parts, problem.signals, strict=True)):
        dS, total = errors * problem.counts[number], at_outputs  # Eqn. 6.2-1
        for at in reversed(range(len(part.contexts))):
            below = passed[number][at]
            portion = quotient(dS, total)
            wanted, o = np.zeros_like(below), np.zeros(len(below))
            for link in part.contexts[at].links:
                sign = np.sign(signals.contexts[at][link.context])
                wanted[link.source] += sign * portion[link.node]
                o[link.source] += 1
            # Eqns. 6.2-3 and 6.2-5: linear combiners are strictly increasing.
            dS = wanted * np.abs(below) / o[:, None]
            total = brought[number][at]
        portion = quotient(dS, total)
        signs = np.sign(signals.x)
        for link in part.links:
            W = link.multiple * k[link.k]
            dW = abs(W) * (signs[link.source] @ portion[link.node]) / problem.patterns
            change[number, link.k] += dW / link.multiple / sharing[link.k]
    return change


class RateRule(NamedTuple):
    """How a rate follows what it gains (6.3.1).

    - `start`: the first rates.
    - `step`: the tenth by which a rate goes up or down.
    - `gain`: the 8 % that a tenth more must gain, of what the rate itself gains.
    - `floor`: the part of `start` that no rate falls below.
    """

    start: float
    step: float = 0.1
    gain: float = 0.08
    floor: float = 1e-4


def followed_rates(
    rule: RateRule, rates: Rates, before: float, cost_at: Callable[[Rates], float]
) -> tuple[Rates, bool]:
    """Return the rates of an epoch, and whether they are taken (docstring of `AdaptedRates`).

    **Arguments**

    - `before`: ε as it stands.
    - `cost_at`: ε after an epoch at some rates.
    """
    least = rule.floor * rule.start
    present = cost_at(rates)
    wanted = rates.copy()
    for layer, rate in enumerate(rates):

        def with_rate(changed: float, layer: int = layer) -> float:
            trial = rates.copy()
            trial[layer] = changed
            return cost_at(trial)

        alone = with_rate(0.0) - present
        if alone > 0 and present - with_rate((1 + rule.step) * rate) >= rule.gain * alone:
            wanted[layer] = (1 + rule.step) * rate
        elif with_rate((1 - rule.step) * rate) < present or not np.isfinite(present):
            wanted[layer] = (1 - rule.step) * rate
        wanted[layer] = max(wanted[layer], least)
    if cost_at(wanted) <= before:
        return wanted, True
    if present <= before:
        return rates, True
    return np.maximum((1 - rule.step) * np.minimum(rates, wanted), least), False


class Turns(NamedTuple):
    """Schedule of rules that take turns (7.5), as the docstring of `Schedule` has it.

    - `hand_over`: ε below which turns begin [N m].
    - `least`: the reduction of ε below which an epoch gains too little [N m].
    - `bout`: epochs of a rule before it is the other's turn.
    - `tolerated`: epochs in a row that may gain too little.
    """

    hand_over: float
    least: float
    bout: int = 100
    tolerated: int = 5


class Route(NamedTuple):
    """A training: ε before each epoch, the epoch's rule and rates; k and ε at the end."""

    cost: list[float]
    rule: list[int]
    rates: list[Rates]
    k: Coefficients
    final: float


#: Backpropagation, then PERAL.
RULES = (backpropagation, peral)
#: Small rates to begin with (7.5), as in `scripts.studies.training.thesis_route`.
RATE_RULES = (RateRule(1e-3), RateRule(0.1))


def train(problem: Problem, k: Coefficients, turns: Turns, *, epochs: int) -> Route:
    """Train from k by backpropagation to the hand-over, then by both rules by turns (7.5)."""
    judged = problem.judged
    rates = [np.full(len(problem.parts), rule.start) for rule in RATE_RULES]
    route = Route([], [], [], k, np.nan)
    rule, in_bout, little, spent = 0, 0, 0, 0
    fruitful, handed_over = False, False
    y = outputs(problem.parts, problem.signals, k)
    cost = cost_of(problem.t - y, judged)
    best_k, lowest = k, cost
    for _ in range(epochs):
        errors = problem.t - y
        change = RULES[rule](problem, k, errors)
        # Outputs are linear in the weights (5.2.2): a trial adds multiples of these.
        moves = [outputs(problem.parts, problem.signals, row) for row in change]

        def cost_at(trial: Rates, errors: Values = errors, moves: list[Values] = moves) -> float:
            left = errors.copy()
            for rate, move in zip(trial, moves, strict=True):
                left -= rate * move
            return cost_of(left, judged)

        rates[rule], moved = followed_rates(RATE_RULES[rule], rates[rule], cost, cost_at)
        route.cost.append(cost)
        route.rule.append(rule)
        route.rates.append(rates[rule])
        before = cost
        if moved:
            k = k + rates[rule] @ change
            y = outputs(problem.parts, problem.signals, k)
            cost = cost_of(problem.t - y, judged)
        if cost < lowest:
            best_k, lowest = k, cost

        over = exhausted = False
        if not handed_over:
            # The epoch that brings the hand-over is the last of the first rule alone.
            over = handed_over = cost < turns.hand_over
        else:
            in_bout += 1
            if before - cost >= turns.least:
                fruitful, little, spent = True, 0, 0
            elif cost != before:  # rates that come down move nothing, and do not count
                little += 1
            passed = in_bout >= turns.bout
            exhausted = little >= turns.tolerated or (passed and not fruitful)
            over = passed or exhausted
        if over:
            rule, in_bout, little, fruitful = (rule + 1) % len(RULES), 0, 0, False
            spent += exhausted
            if spent >= len(RULES):
                break
            if cost != lowest:
                k, cost = best_k, lowest
                y = outputs(problem.parts, problem.signals, k)
    return route._replace(k=best_k, final=lowest)
