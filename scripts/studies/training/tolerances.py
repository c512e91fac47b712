"""What the tolerances of weights that are found from noisy targets go with (thesis Eqn. 6.1-6).

Section 6.1: the tolerances within which the optimal weights can be identified "are largely related
to" (1/p) Σ x k, the mean over p patterns of input times disturbance. Here many draws of noise on
the same patterns show the error of each weight by least squares, by ideal PERAL and by PERAL, each
at the end of its training. What they are compared with, by weight:

- **|mean x k|**: the modulus of Eqn. 6.1-6, root mean square over the draws;
- **mean |x k|**: the mean of moduli;
- **|mean x k| / mean x²**: the error of the weight if it were the only one;
- **least squares**: the standard error of least squares, which for normal noise of one size is the
  Cramér-Rao bound;
- **the rule**: the standard error of the rule itself. Where its mean change d(w, k) is zero, small
  noise moves the weights by -(∂d/∂w)⁻¹ (∂d/∂k) k. For backpropagation that is least squares.

Problems: linear combiners whose inputs differ in size, independent ones, and such as are correlated
and have means; and the CSLC of a PUMA 560, which ideal PERAL does not train. Each training starts
at the truth, and once more at weights of 0.5 to 1.5 times the truth, to see what the start does.

    python -m scripts.studies.training.tolerances
    python -m scripts.studies.training.tolerances --quick
"""

import argparse
import dataclasses
from collections.abc import Sequence
from pathlib import Path
from typing import Any

import equinox as eqx
import jax
import jax.numpy as jnp
import numpy as np
from jaxtyping import Array, Float
from scipy.stats import spearmanr

import jaxcslc as jc
import sim
from jaxcslc._text_table import text_table
from jaxcslc.report import all_or_nothing, write_csv
from jaxcslc.training import (
    PERAL,
    AbstractRule,
    AdaptiveNetwork,
    Backpropagation,
    Examples,
    FixedRates,
    IdealPERAL,
    Plan,
    examples,
    fully_connected,
    half_square,
    inverse_dynamics,
    train,
)
from scripts.studies import command
from scripts.studies.rows import Rows, made_of
from scripts.studies.stored import store
from scripts.studies.tables import number_text
from scripts.studies.training.largest_rates import direction, shrinking_rate
from scripts.studies.truth import published_coefficients


jc.enable_x64()

INDEPENDENT, CORRELATED, PUMA = "independent inputs", "correlated inputs", "PUMA 560"
PROBLEMS = (INDEPENDENT, CORRELATED, PUMA)
LEAST_SQUARES, IDEAL, PRACTICAL = "least squares", "ideal PERAL", "PERAL"
KEYS = ("problem", "method")
OPTIONS = ("patterns", "seeds", "epochs", "noise")
MEAN, MODULI, ALONE = "|mean x k|", "mean |x k|", "|mean x k| / mean x²"
BOUND, OWN = "least squares", "the rule"
# Of the linear combiners: standard deviations of inputs; and, of correlated ones, means in parts of
# these and the correlation of neighbours.
_SIZES, _MEAN, _CORRELATION = np.geomspace(0.1, 10.0, 8), 0.3, 0.5
# Of the rate at which small errors no longer shrink: well below, so that all trainings settle.
_SAFE = 0.5
_START = (0.5, 1.5)  # in parts of the truth


@dataclasses.dataclass(frozen=True)
class Noisy:
    """A network, its patterns and draws of noise on their targets.

    - `clean`: patterns whose targets the truth meets exactly.
    - `noise`: what is added to targets.
    - `deviation`: standard deviation of the noise, by output.
    """

    network: AdaptiveNetwork
    clean: Examples
    truth: Float[np.ndarray, " weights"]
    noise: Float[np.ndarray, "seeds outputs patterns"]
    deviation: Float[np.ndarray, " outputs"]

    @property
    def inputs(self) -> Float[np.ndarray, "weights outputs patterns"]:
        """Return what each output takes of each weight: x of Eqn. 6.1-6."""
        units = jnp.eye(self.network.size)
        totals = jax.lax.map(lambda unit: self.clean.totals(self.network, unit), units)
        return np.asarray(totals)

    @property
    def examples(self) -> Examples:
        """The patterns with each draw of noise."""
        seeds = len(self.noise)
        every = jax.tree.map(lambda x: jnp.broadcast_to(x, (seeds, *x.shape)), self.clean)
        targets = jnp.asarray(np.asarray(self.clean.targets) + self.noise)
        return eqx.tree_at(lambda e: e.targets, every, targets)


def problem_of(name: str, patterns: int, seeds: int, noise: float) -> Noisy:
    """A problem, with noise of so much of each target's standard deviation."""
    rng = np.random.default_rng(3)
    if name != PUMA:
        count = len(_SIZES)
        part, correlation = (_MEAN, _CORRELATION) if name == CORRELATED else (0.0, 0.0)
        distance = np.abs(np.subtract.outer(np.arange(count), np.arange(count)))
        factor = np.linalg.cholesky(correlation**distance)
        normal = rng.standard_normal((patterns, count)) @ factor.T
        motion: Any = jnp.asarray(_SIZES * (part + normal))
        network = fully_connected([count, 1], "linear combiner")
        truth = rng.uniform(0.5, 2.0, network.size) * rng.choice([-1.0, 1.0], network.size)
    else:
        _, exact = sim.simulate(sim.undisturbed(sim.puma560()), sim.training(), seed=0)
        every = max(1, len(exact.time) // patterns)
        columns = (exact.position, exact.velocity, exact.acceleration)
        motion = tuple(jnp.asarray(x[::every]) for x in columns)
        cslc = jc.derive(jc.puma560())
        network = inverse_dynamics(cslc)
        truth = np.asarray(published_coefficients(cslc))
    targets = np.asarray(network.outputs(jnp.asarray(truth), motion))
    deviation = noise * targets.std(axis=0)
    drawn = deviation[:, None] * rng.standard_normal((seeds, targets.shape[1], len(targets)))
    return Noisy(network, examples(network, motion, jnp.asarray(targets)), truth, drawn, deviation)


def rules(problem: Noisy) -> dict[str, AbstractRule]:
    """The rules by name of the method that they lead to."""
    ideal = IdealPERAL(jnp.asarray(problem.truth))
    of_all: dict[str, AbstractRule] = {LEAST_SQUARES: Backpropagation(), PRACTICAL: PERAL()}
    if ideal.check_network(problem.network) is None:
        of_all[IDEAL] = ideal
    return of_all


def change_jacobian(problem: Noisy, rule: AbstractRule) -> Float[np.ndarray, "weights weights"]:
    """The Jacobian of a rule's mean change by the weights, at the truth without noise."""
    network, clean = problem.network, problem.clean

    @jax.jit
    def jacobian(weights: Array) -> Array:
        return jax.jacfwd(lambda w: direction(network, rule, clean, w))(weights)

    return np.asarray(jacobian(jnp.asarray(problem.truth)))


def standard_errors(
    problem: Noisy, rule: AbstractRule, jacobian: Float[np.ndarray, "weights weights"]
) -> Float[np.ndarray, " weights"]:
    """The standard error of each weight where a rule comes to rest, for small noise."""
    network, truth = problem.network, jnp.asarray(problem.truth)

    @jax.jit
    def by_target(targets: Array) -> Array:
        def change(t: Array) -> Array:
            patterns = eqx.tree_at(lambda e: e.targets, problem.clean, t)
            return direction(network, rule, patterns, truth)

        return jax.jacrev(change)(targets)

    sensitivity = np.asarray(by_target(problem.clean.targets))  # (weights, outputs, patterns)
    moves = np.linalg.solve(jacobian, sensitivity.reshape(len(truth), -1))
    by_noise = moves.reshape(sensitivity.shape) * problem.deviation[None, :, None]
    return np.sqrt(np.sum(by_noise**2, axis=(1, 2)))


def least_squares(problem: Noisy) -> Float[np.ndarray, "seeds weights"]:
    """The weights of least squares for each draw of noise."""
    inputs = problem.inputs.reshape(len(problem.truth), -1).T
    targets = np.asarray(problem.examples.targets).reshape(len(problem.noise), -1).T
    return np.linalg.lstsq(inputs, targets, rcond=None)[0].T


def trained(
    problem: Noisy, rule: AbstractRule, rate: float, epochs: int, start: np.ndarray
) -> Float[np.ndarray, "seeds weights"]:
    """The weights at the end of a training on each draw of noise, at a rate that stays."""
    plan = Plan(rule, FixedRates(rate), cost=half_square, patience=epochs)
    starts = jnp.broadcast_to(start, (len(problem.noise), len(start)))
    training = train(
        problem.network, problem.examples, starts, plan, epochs=epochs, keep_weights=False
    )
    return np.asarray(training.weights)


def row_of(problem: Noisy, method: str, epochs: int) -> dict[str, Any]:
    """Return by weight the spread and bias of a method, and what they are compared with."""
    rule = rules(problem)[method]
    jacobian = change_jacobian(problem, rule)
    others = np.random.default_rng(5).uniform(*_START, len(problem.truth)) * problem.truth
    row: dict[str, Any] = {"names": list(problem.network.names)}
    if method == LEAST_SQUARES:
        weights, from_start = least_squares(problem), None
    else:
        rate = _SAFE * shrinking_rate(jacobian)
        weights, again = (trained(problem, rule, rate, epochs, s) for s in (problem.truth, others))
        row["rate"] = rate
        from_start = again - weights
    error = weights - problem.truth
    products = problem.inputs[None] * problem.noise[:, None]  # (seeds, weights, outputs, patterns)
    patterns = products.shape[-1]
    mean = products.sum(axis=(2, 3)) / patterns
    moduli = np.abs(products).sum(axis=(2, 3)) / patterns
    square = np.sum(problem.inputs**2, axis=(1, 2)) / patterns
    spread = error.std(axis=0, ddof=1)
    return row | {
        "spread": spread.tolist(),
        "bias": (error.mean(axis=0) / (spread / np.sqrt(len(error)))).tolist(),
        MEAN: np.sqrt(np.mean(mean**2, axis=0)).tolist(),
        MODULI: moduli.mean(axis=0).tolist(),
        ALONE: (np.sqrt(np.mean(mean**2, axis=0)) / square).tolist(),
        BOUND: standard_errors(
            problem, Backpropagation(), change_jacobian(problem, Backpropagation())
        ).tolist(),
        OWN: standard_errors(problem, rule, jacobian).tolist(),
        # Over draws, of each weight by itself.
        "by draw, " + MEAN: _rank_correlations(np.abs(error), np.abs(mean)),
        "by draw, " + MODULI: _rank_correlations(np.abs(error), moduli),
        "start": None
        if from_start is None
        else (np.sqrt(np.mean(from_start**2, axis=0)) / spread).tolist(),
    }


def _rank_correlations(left: np.ndarray, right: np.ndarray) -> list[float]:
    return [float(spearmanr(a, b).statistic) for a, b in zip(left.T, right.T, strict=True)]


def summary(row: dict[str, Any]) -> dict[str, Any]:
    """A line of the table: rank correlations over weights and over draws, and sizes."""
    spread = np.array(row["spread"])
    of_rule, bound = np.array(row[OWN]), np.array(row[BOUND])
    line: dict[str, Any] = {"problem": row["problem"], "method": row["method"]}
    for measure in (MEAN, MODULI, ALONE, BOUND, OWN):
        line[f"over weights: {measure}"] = float(spearmanr(spread, row[measure]).statistic)
    for measure in (MEAN, MODULI):
        line[f"over draws: {measure}"] = float(np.median(row[f"by draw, {measure}"]))
    start = row["start"]
    return line | {
        "spread / the rule's": float(np.median(spread / of_rule)),
        "spread / least squares'": float(np.median(spread / bound)),
        "its largest": float(np.max(spread / bound)),
        "rms bias [standard errors]": float(np.sqrt(np.mean(np.square(row["bias"])))),
        "start / spread": "-" if start is None else float(np.median(start)),
    }


def by_weight(rows: Sequence[dict[str, Any]]) -> list[dict[str, Any]]:
    """A row for each problem, method and weight."""
    columns = ("spread", "bias", MEAN, MODULI, ALONE, BOUND, OWN)
    return [
        {"problem": row["problem"], "method": row["method"], "weight": name}
        | {column: row[column][i] for column in columns}
        for row in rows
        for i, name in enumerate(row["names"])
    ]


def table(rows: Sequence[dict[str, Any]]) -> list[list[str]]:
    """The summary, methods as columns; the head first."""
    lines = [summary(row) for row in rows]
    header = [f"{line['problem']}, {line['method']}" for line in lines]
    names = [name for name in lines[0] if name not in KEYS]
    cells = [[name, *(number_text(line[name], 2) for line in lines)] for name in names]
    return [["", *header], *cells]


def study(options: argparse.Namespace) -> int:
    """Trains what is missing, prints the table and writes the rows by weight."""
    code = [Path(__file__), Path(__file__).with_name("largest_rates.py")]
    digest = made_of({name: getattr(options, name) for name in OPTIONS}, code)
    finished = Rows(options.output / "rows.jsonl", KEYS, digest)
    rows: list[dict[str, Any]] = []
    for name in command.progress(options.problems, desc="tolerances", unit="problem"):
        problem = problem_of(name, options.patterns, options.seeds, options.noise)
        for method in rules(problem):
            if (name, method) not in finished:
                finished.add(
                    {"problem": name, "method": method} | row_of(problem, method, options.epochs)
                )
            rows.append(finished[name, method])
    print(f"Rank correlations of {options.seeds} draws' spread or errors; medians over weights")
    head, *lines = table(rows)
    print(text_table(head, lines, left=[""]))
    store(
        options, "tolerances", f"{options.seeds} draws of noise", {"correlations": [head, *lines]}
    )
    with all_or_nothing(options.output) as folder:
        write_csv(folder / "tolerances.csv", by_weight(rows))
    print(f"wrote tolerances.csv into {options.output}")
    return 0


def main(argv: Sequence[str] | None = None) -> int:
    parser = command.new_parser(__doc__, "tolerances")
    parser.add_argument("--problems", nargs="+", default=list(PROBLEMS), metavar="NAME",
                        help=f"some of: {', '.join(map(repr, PROBLEMS))}")  # fmt: skip
    parser.add_argument("--patterns", type=int, default=200, help="of a training")
    parser.add_argument("--seeds", type=int, default=100, help="draws of noise")
    parser.add_argument("--epochs", type=int, default=5000, help="of PERAL")
    parser.add_argument("--noise", type=float, default=0.05,
                        help="in parts of the targets' standard deviations")  # fmt: skip
    command.add_store(parser)
    options = command.parse(
        parser, argv, problems=[CORRELATED], patterns=100, seeds=20, epochs=1000
    )
    command.require_least(parser, options, patterns=30, seeds=3, epochs=1)
    command.require_between(parser, options, noise=(0.0, 10.0))
    command.require_some_of(parser, "problem", options.problems, PROBLEMS)
    return command.run(
        parser, lambda: study(options), options.output / "rows.jsonl", seconds=seconds(options)
    )


def seconds(options: argparse.Namespace) -> float:
    """Return how long the study takes on two cores: mostly PERAL on the CSLC, from two starts."""
    passes = 2.0 * options.patterns * options.seeds * options.epochs
    return 20.0 * len(options.problems) + (2e-6 * passes if PUMA in options.problems else 0.0)


if __name__ == "__main__":
    raise SystemExit(main())
