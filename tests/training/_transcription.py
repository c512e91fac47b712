"""The thesis's equations, letter by letter: one pattern, one link, one number at a time.

Written from its text (3.3-3.4, 5.2.6, 6.1-6.2), slowly and without a thought for speed, and from
nothing of the library. Names are the thesis's: `x` inputs, `W` weights, `S` sums, `f` activations,
`t` targets, `y` outputs, A the adaptive layer and B what follows. Rates are one.
"""

import math
from collections.abc import Callable, Sequence
from dataclasses import dataclass, field
from typing import NamedTuple

import numpy as np


Vector = Sequence[float] | np.ndarray


@dataclass(frozen=True)
class Function:
    """An activation function of a node, and its derivative."""

    f: Callable[[float], float]
    slope: Callable[[float], float]
    increasing: bool = True


def logistic(s: float) -> float:
    return 1 / (1 + math.exp(-s))


IDENTITY = Function(lambda s: s, lambda s: 1.0)
LOGISTIC = Function(logistic, lambda s: logistic(s) * (1 - logistic(s)))
TANH = Function(math.tanh, lambda s: 1 - math.tanh(s) ** 2)
FALLING_TANH = Function(lambda s: math.tanh(-s), lambda s: -(1 - math.tanh(s) ** 2), False)
FALLING_LOGISTIC = Function(
    lambda s: logistic(-s), lambda s: -logistic(s) * (1 - logistic(s)), False
)


class Link(NamedTuple):
    """An adaptive link: its weight is `multiple` times coefficient number `k` (5.1.1)."""

    source: int
    node: int
    k: int
    multiple: float = 1.0


class ContextLink(NamedTuple):
    """A link whose weight is context value number `context` of the pattern (3.3.5)."""

    source: int
    node: int
    context: int


@dataclass(frozen=True)
class Subnetwork:
    """Adaptive layers (nodes, links, f; a bias is a last input), then contexts (nodes, links)."""

    layers: Sequence[tuple[int, Sequence[Link], Function]]
    contexts: Sequence[tuple[int, Sequence[ContextLink]]] = ()
    bias: bool = False


@dataclass(frozen=True)
class Values:
    """What a pass forward leaves: outputs of every layer of a subnetwork, its inputs first."""

    seen: list[list[float]] = field(default_factory=list)  # by the links of each adaptive layer
    S: list[list[float]] = field(default_factory=list)
    passed: list[list[float]] = field(default_factory=list)  # to each context layer, then out


def sgn(x: float) -> float:
    return 0.0 if x == 0 else math.copysign(1.0, x)


def divided(a: float, b: float) -> float:
    """Nothing where there is nothing to divide among: the thesis's 0 / 0."""
    return 0.0 if b == 0 else a / b


def eqn_3_3_1(x: Vector, w: Vector) -> float:
    """s = sum of x_i w_i."""
    s = 0.0
    for i in range(len(x)):
        s += x[i] * w[i]
    return s


def eqn_3_3_2(s: float) -> float:
    """The step function."""
    return 1.0 if s >= 0 else 0.0


def eqn_3_4_1(x: Vector, t: Vector, W: np.ndarray) -> np.ndarray:
    """The perceptron rule, dW = x' (t - y), with y = step(x W); W is inputs by outputs."""
    dW = np.zeros(W.shape)
    for k in range(W.shape[1]):
        y = eqn_3_3_2(eqn_3_3_1(x, W[:, k]))
        for j in range(W.shape[0]):
            dW[j, k] = x[j] * (t[k] - y)
    return dW


def eqn_3_4_3(hidden: Vector, S_B: Vector, t: Vector, f_B: Function) -> np.ndarray:
    """dW^B_kl = (t_l - y_l) f_B'(S_l) f_A(S_k)."""
    dW = np.zeros((len(hidden), len(t)))
    for k in range(len(hidden)):
        for l in range(len(t)):
            dW[k, l] = (t[l] - f_B.f(S_B[l])) * f_B.slope(S_B[l]) * hidden[k]
    return dW


def eqn_3_4_8(
    x: Vector, S_A: Vector, S_B: Vector, W_B: np.ndarray, t: Vector, f_A: Function, f_B: Function
) -> np.ndarray:
    """dW^A_jk = [sum over l of (t_l - y_l) f_B'(S_l) W^B_kl] f_A'(S_k) x_j."""
    dW = np.zeros((len(x), len(S_A)))
    for j in range(len(x)):
        for k in range(len(S_A)):
            bracket = 0.0
            for l in range(len(t)):
                bracket += (t[l] - f_B.f(S_B[l])) * f_B.slope(S_B[l]) * W_B[k, l]
            dW[j, k] = bracket * f_A.slope(S_A[k]) * x[j]
    return dW


def eqn_6_1_3(x: Vector, optimum: Vector, w: Vector, t: float) -> np.ndarray:
    """dw_j = sgn(x_j) |w*_j| e / sum of |x_m w*_m|: Eqn. 6.1-2 divided by x_j."""
    e = t - eqn_3_3_1(x, w)
    total = sum(abs(x[m] * optimum[m]) for m in range(len(x)))
    return np.array([divided(sgn(x[j]) * abs(optimum[j]) * e, total) for j in range(len(x))])


def eqn_6_2_1(t: float, y: float, f_B: Function) -> float:
    """The adjustment that is wanted of an output node's sum."""
    return t - y if f_B.increasing else y - t


def eqn_6_2_3(f_A: Vector, W_B: np.ndarray, dS_B: Vector) -> np.ndarray:
    """Wanted of hidden node k, averaged over the o output nodes that it connects to."""
    h, o = W_B.shape
    wanted = np.zeros(h)
    for k in range(h):
        for l in range(o):
            total = sum(abs(f_A[m] * W_B[m, l]) for m in range(h))
            wanted[k] += divided(abs(f_A[k]) * sgn(W_B[k, l]) * dS_B[l], total) / o
    return wanted


def eqn_6_2_4(f_A: np.ndarray, W_B: np.ndarray, dS_B: np.ndarray) -> np.ndarray:
    """The same for the whole layer, in row vectors and matrices."""
    return (dS_B / (np.abs(f_A) @ np.abs(W_B))) @ np.sign(W_B).T * np.abs(f_A) / W_B.shape[1]


def eqn_6_2_5(wanted: float, f_A: Function) -> float:
    """The adjustment that is wanted of a hidden node's sum."""
    return wanted if f_A.increasing else -wanted


def eqn_6_2_6(x: Vector, W_A: np.ndarray, dS_A: Vector) -> np.ndarray:
    """dW^A_jk = sgn(x_j) |W_jk| dS_k / sum over m of |x_m W_mk|.

    The scan prints x_j in the sum; with x_m it is what Eqns. 6.1-3 and 6.2-7 say.
    """
    dW = np.zeros(W_A.shape)
    for j in range(W_A.shape[0]):
        for k in range(W_A.shape[1]):
            total = sum(abs(x[m] * W_A[m, k]) for m in range(W_A.shape[0]))
            dW[j, k] = divided(sgn(x[j]) * abs(W_A[j, k]) * dS_A[k], total)
    return dW


def eqn_6_2_7(x: np.ndarray, W_A: np.ndarray, dS_A: np.ndarray) -> np.ndarray:
    """The same for the whole matrix."""
    return np.outer(np.sign(x), dS_A / (np.abs(x) @ np.abs(W_A))) * np.abs(W_A)


# The same equations where links are missing, share coefficients (5.1.1), and subnetworks meet in
# their output nodes (5.1.5): sums run over the links that exist.


def forward(part: Subnetwork, x: Vector, contexts: Sequence[Vector], k: Vector) -> Values:
    """Eqn. 3.3-1 and the activation, layer by layer."""
    values, now = Values(), [float(v) for v in x]
    for nodes, links, f in part.layers:
        if part.bias:
            now = [*now, 1.0]
        S = [0.0] * nodes
        for link in links:
            S[link.node] += now[link.source] * (link.multiple * k[link.k])
        values.seen.append(now)
        values.S.append(S)
        now = [f.f(s) for s in S]
    values.passed.append(now)
    for (nodes, context_links), context in zip(part.contexts, contexts, strict=True):
        total = [0.0] * nodes
        for link in context_links:
            total[link.node] += now[link.source] * context[link.context]
        now = total
        values.passed.append(now)
    return values


def outputs_of(passes: Sequence[Values]) -> list[float]:
    """The sums at the output nodes, over the superposed subnetworks."""
    return [sum(item) for item in zip(*(values.passed[-1] for values in passes), strict=True)]


def count(counts: np.ndarray | None, subnetwork: int, output: int) -> float:
    """One where the pair is learnt from: by all subnetworks, or by this one (7.2.2)."""
    if counts is None:
        return 1.0
    return float(counts[output] if counts.ndim == 1 else counts[subnetwork, output])


Moves = list[list[float]]  # of every link of every adaptive layer, subnetwork after subnetwork


def backpropagation(
    parts: Sequence[Subnetwork],
    f: Function,
    xs: Sequence[Vector],
    contexts: Sequence[Sequence[Vector]],
    t: Vector,
    k: Vector,
    counts: np.ndarray | None = None,
) -> Moves:
    """Eqn. 3.4-9 for one pattern: how every link's weight W would move, dW = f_A(S_A) delta_B."""
    passes = [forward(*item, k) for item in zip(parts, xs, contexts, strict=True)]
    S = outputs_of(passes)
    errors = [t[l] - f.f(S[l]) for l in range(len(S))]
    moves: Moves = []
    for number, (part, values, context) in enumerate(zip(parts, passes, contexts, strict=True)):
        arriving = [f.slope(S[l]) * errors[l] * count(counts, number, l) for l in range(len(S))]
        for at in reversed(range(len(part.contexts))):
            back = [0.0] * len(values.passed[at])
            for link in part.contexts[at][1]:
                back[link.source] += context[at][link.context] * arriving[link.node]
            arriving = back
        local_moves: Moves = []
        for at in reversed(range(len(part.layers))):
            _, links, f_A = part.layers[at]
            delta = [f_A.slope(s) * d for s, d in zip(values.S[at], arriving, strict=True)]
            local_moves.append([values.seen[at][link.source] * delta[link.node] for link in links])
            arriving = [0.0] * len(values.seen[at])
            for link in links:
                arriving[link.source] += link.multiple * k[link.k] * delta[link.node]
            arriving = arriving[: len(arriving) - part.bias]
        moves += reversed(local_moves)
    return moves


def peral(
    parts: Sequence[Subnetwork],
    f: Function,
    xs: Sequence[Vector],
    contexts: Sequence[Sequence[Vector]],
    t: Vector,
    k: Vector,
    counts: np.ndarray | None = None,
    optimum: Vector | None = None,
) -> Moves:
    """Eqns. 6.2-1 to 6.2-6 for one pattern: how every link's weight W would move.

    With `optimum`, the ideal form of 6.1: significance is what links pass at the optimum.
    """
    passes = [forward(*item, k) for item in zip(parts, xs, contexts, strict=True)]
    S = outputs_of(passes)
    dS_B = [eqn_6_2_1(t[l], f.f(S[l]), f) for l in range(len(S))]
    significant = k if optimum is None else optimum

    def adaptive_totals(part: Subnetwork, values: Values) -> list[float]:
        nodes, links, _ = part.layers[0]
        total = [0.0] * nodes
        for link in links:
            W = link.multiple * significant[link.k]
            total[link.node] += abs(values.seen[0][link.source] * W)
        return total

    def context_totals(part: Subnetwork, values: Values, context: Vector, at: int) -> list[float]:
        nodes, links = part.contexts[at]
        total = [0.0] * nodes
        for link in links:
            total[link.node] += abs(values.passed[at][link.source] * context[link.context])
        return total

    # What all links of all subnetworks bring to an output node.
    meeting = [0.0] * len(S)
    for part, values, context in zip(parts, passes, contexts, strict=True):
        local_moves = (
            context_totals(part, values, context[-1], len(part.contexts) - 1)
            if part.contexts
            else adaptive_totals(part, values)
        )
        meeting = [a + b for a, b in zip(meeting, local_moves, strict=True)]

    moves: Moves = []
    for number, (part, values, context) in enumerate(zip(parts, passes, contexts, strict=True)):
        dS = [dS_B[l] * count(counts, number, l) for l in range(len(S))]
        total = meeting
        for at in reversed(range(len(part.contexts))):
            links = part.contexts[at][1]
            wanted = [0.0] * len(values.passed[at])
            for node in range(len(wanted)):
                leading = [link for link in links if link.source == node]
                for link in leading:
                    W = context[at][link.context]
                    item = abs(values.passed[at][node]) * sgn(W) * dS[link.node]
                    wanted[node] += divided(item, total[link.node]) / len(leading)
            f_A = part.layers[0][2] if at == 0 else IDENTITY
            dS = [eqn_6_2_5(item, f_A) for item in wanted]
            total = (
                context_totals(part, values, context[at - 1], at - 1)
                if at > 0
                else adaptive_totals(part, values)
            )
        moves.append(
            [
                divided(
                    sgn(values.seen[0][link.source])
                    * abs(link.multiple * significant[link.k])
                    * dS[link.node],
                    total[link.node],
                )
                for link in part.layers[0][1]
            ]
        )
    return moves


def mean_over_patterns(item: Sequence[Moves]) -> Moves:
    """The batch form: averages across the whole set (3.4)."""
    return [
        [sum(numbers) / len(item) for numbers in zip(*layer, strict=True)]
        for layer in zip(*item, strict=True)
    ]


def average_over_links(
    parts: Sequence[Subnetwork],
    moves: Moves,
    size: int,
    *,
    by_chain_rule: bool,
    learning: Sequence[bool] | None = None,
) -> np.ndarray:
    """What a coefficient moves by: the average over the links that share it (5.2.6), by layer.

    A link's weight is W = multiple k. By the chain rule, dW moves k by multiple dW; where a rule
    says what W itself is to become, dW moves k by dW / multiple.
    """
    layers = [links for part in parts for _, links, _ in part.layers]
    takes_part = [True] * len(layers) if learning is None else list(learning)
    sharing = np.zeros(size)
    for links, learns in zip(layers, takes_part, strict=True):
        for link in links:
            sharing[link.k] += learns
    change = np.zeros((len(layers), size))
    for row, (links, item, learns) in enumerate(zip(layers, moves, takes_part, strict=True)):
        for link, move in zip(links, item, strict=True):
            if learns:
                k_move = move * link.multiple if by_chain_rule else move / link.multiple
                change[row, link.k] += k_move / sharing[link.k]
    return change
