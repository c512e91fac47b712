"""Initial weights restricted by sign: whether a CSLC learns sooner from them (5.2.3).

The derivation knows which coefficients must be positive. The thesis suggests to restrict initial
weights to the correct signs. Three starts of the PUMA 560's CSLC are compared, on simulated motion
and torques with Gaussian noise (6.3.2):

- zero weights, from which PERAL cannot start;
- random signs, with moduli up to the scale;
- the same moduli and signs, except that coefficients that must be positive are.

Each rule trains alone, its rates adapted by 6.3.1's rule on the mean error modulus. Epochs are
counted to parts of the way from the cost of zero weights to that of the direct solution, so that
goals are the same for all starts. A training that never arrives counts as infinitely long.

    python -m scripts.studies.training.signed_starts
"""

import argparse
from collections.abc import Sequence
from pathlib import Path
from typing import Any

import jax
import jax.numpy as jnp
import numpy as np

import jaxcslc as jc
from jaxcslc._text_table import text_table
from jaxcslc.report import all_or_nothing, write_csv
from jaxcslc.training import mean_modulus, train
from scripts.studies import command
from scripts.studies.rows import Rows, made_of
from scripts.studies.training.peral_comparison import (
    RULES,
    Problem,
    direct_solutions,
    first_at_most,
    moduli,
    plans,
    puma,
    stable_rate,
)
from scripts.studies.training.peral_operations import PERAL_RULE
from scripts.studies.training.peral_tables import number, spread


jc.enable_x64()

ZERO, RANDOM, SIGNED = "zero", "random signs", "signs of 5.2.3"
GOALS = (0.5, 0.75, 0.9, 0.95)
KEYS = ("rule", "start", "scale")
OPTIONS = ("seeds", "patterns", "noise", "epochs")


def signed_start(network: jc.CSLC, key: jax.Array, scale: np.ndarray | float = 1.0) -> jax.Array:
    """Draw initial weights of a CSLC whose signs are those of its coefficients (thesis 5.2.3).

    A coefficient that is a sum of masses, moments of inertia and squares is positive, and so are
    viscous and Coulomb friction (`Coefficient.positive`). Their weights are positive. Every other
    weight has either sign with equal probability. Moduli are uniform from zero to the scale, and
    never zero: PERAL leaves a weight of zero as it is.

    **Arguments**

    - `network`: p coefficients.
    - `key`: of JAX's random numbers; `jax.vmap` over keys draws several starts.
    - `scale`: greatest modulus of all weights, or of each, (p,), in its unit; positive.

    **Returns** weights in the order of the coefficients, (p,).

    **Raises** `ValueError` for a scale of another shape, or one that is not positive.

    """
    largest = np.asarray(scale, float)
    if largest.shape not in ((), (network.size,)) or not np.all(largest > 0):
        raise ValueError(
            f"scale: expected a positive number, or one for each of {network.size} coefficients,"
            f" got shape {largest.shape} and at least {largest.min():g}"
        )
    positive = np.array([coefficient.positive for coefficient in network.coefficients])
    of_moduli, of_signs = jax.random.split(key)
    moduli = jnp.asarray(largest) * (1.0 - jax.random.uniform(of_moduli, (network.size,), float))
    negative = jax.random.bernoulli(of_signs, shape=(network.size,)) & ~positive
    return jnp.where(negative, -moduli, moduli)


def starts(start: str, scale: float, seeds: int) -> jax.Array:
    """Initial weights, (seeds, p); random and signed ones differ in forbidden signs alone."""
    cslc = jc.derive(jc.puma560())
    if start == ZERO:
        return jnp.zeros((1, cslc.size))
    keys = jax.vmap(jax.random.key)(jnp.arange(seeds))
    signed = jax.vmap(lambda key: signed_start(cslc, key, scale))(keys)
    if start == SIGNED:
        return signed
    forbidden = jax.vmap(lambda key: jax.random.bernoulli(key, shape=(cslc.size,)))(
        jax.vmap(jax.random.fold_in)(keys, jnp.ones(seeds, int))
    )
    positive = jnp.array([coefficient.positive for coefficient in cslc.coefficients])
    return jnp.where(forbidden & positive[None], -signed, signed)


def row(
    problem: Problem, options: argparse.Namespace, key: tuple[str, str, float]
) -> dict[str, Any]:
    """Epochs of every seed to every goal."""
    rule, start, scale = key
    weights = starts(start, scale, options.seeds)
    several = jax.tree.map(lambda x: jnp.broadcast_to(x, (len(weights), *x.shape)), problem.first)
    rate = 1.0
    if rule == PERAL_RULE:
        here = Problem(problem.name, problem.variant, problem.network, several, problem.first)
        rate = stable_rate(here, weights)
    training = train(
        problem.network,
        problem.first,
        weights,
        plans(None, rate)[rule],
        epochs=options.epochs,
        keep_weights=False,
        progress=True,
    )
    curves = np.asarray(training.history.cost)
    least = float(moduli(problem, direct_solutions(problem))[0])
    zero = float(problem.first.costs(problem.network, jnp.zeros(weights.shape[1]), mean_modulus)[0])
    epochs = {
        f"{part:.0%}": first_at_most(
            curves, np.full(len(curves), zero + part * (least - zero))
        ).tolist()
        for part in GOALS
    }
    return dict(zip(KEYS, key, strict=True)) | {
        "first cost over that of zero weights": spread(curves[:, 0] / zero)["median"],
        "epochs": epochs,
    }


def study(options: argparse.Namespace) -> int:
    """Trains from every start, prints the table and writes the file."""
    digest = made_of({name: getattr(options, name) for name in OPTIONS}, [Path(__file__)])
    finished = Rows(options.output / "rows.jsonl", KEYS, digest)
    wanted = [
        (rule, start, scale)
        for rule in RULES
        for start in (ZERO, RANDOM, SIGNED)
        for scale in (options.scales if start != ZERO else [0.0])
        if (rule, start) != (PERAL_RULE, ZERO)
    ]
    problem = puma(options.patterns, options.noise, 1)
    for key in wanted:
        if key not in finished:
            finished.add(row(problem, options, key))
    rows = [finished[key] for key in wanted]
    first = "first cost over that of zero weights"
    names = [f"{part:.0%}" for part in GOALS]
    lines: list[list[str]] = []
    for one in rows:
        arrived = {name: np.array(one["epochs"][name]) for name in names}
        lines.append(
            [one["rule"], one["start"], f"{one['scale']:g}", number(one[first], 2)]
            + [
                f"{number(spread(epochs)['median'])} ({np.isfinite(epochs).sum()}/{len(epochs)})"
                for epochs in arrived.values()
            ]
        )
    header = [*KEYS, "first cost", *names]
    print("median epochs to parts of the way to the direct solution (starts that arrive)")
    print(text_table(header, lines, left=("rule", "start")))
    with all_or_nothing(options.output) as folder:
        write_csv(
            folder / "signed_starts.csv",
            [dict(zip(header, line, strict=True)) for line in lines],
        )
    print(f"wrote signed_starts.csv into {options.output}")
    return 0


def main(argv: Sequence[str] | None = None) -> int:
    parser = command.new_parser(__doc__, "signed_starts")
    parser.add_argument("--seeds", type=int, default=16, help="starts")
    parser.add_argument("--scales", type=float, nargs="+", default=[0.1, 1.0],
                        help="greatest moduli of initial weights")  # fmt: skip
    parser.add_argument("--patterns", type=int, default=330, help="of at most 3300")
    parser.add_argument("--noise", type=float, default=0.1, help="in parts of deviations")
    parser.add_argument("--epochs", type=int, default=1000, help="at most")
    options = command.parse(parser, argv, seeds=2, scales=[0.1], patterns=60, epochs=50)
    command.require_least(parser, options, seeds=1, patterns=30, noise=0.0, epochs=1)
    if not all(scale > 0.0 for scale in options.scales):
        parser.error(f"--scales is {options.scales}; expected more than 0")
    trainings = 1 + 4 * len(options.scales) * options.seeds
    return command.run(
        parser,
        lambda: study(options),
        options.output / "rows.jsonl",
        seconds=30.0 + 4e-6 * options.patterns * trainings * options.epochs,
    )


if __name__ == "__main__":
    raise SystemExit(main())
