"""Why PERAL does or does not suit a class: its own linear iteration at the optimum."""

from typing import Any

import jax
import jax.numpy as jnp
import numpy as np
from jaxtyping import Array, Float

from jaxcslc.training import PERAL, AbstractRule, Backpropagation, Examples
from scripts.studies.peral_classes.alternatives import direct_solution
from scripts.studies.peral_classes.classes import Problem


# Of the largest eigenvalue: below, a direction counts as one that the rule does not see.
NEGLIGIBLE = 1e-9


def eigenvalues(
    problem: Problem, rule: AbstractRule, patterns: Examples, weights: Float[Array, " weights"]
) -> Float[np.ndarray, " weights"]:
    """Real parts of the eigenvalues of a rule's pull towards the weights, at a rate of one.

    Small errors shrink by 1 - rate x eigenvalue in an epoch: a rate that suits the largest moves
    the smallest by little, and a negative one leads away at every rate.
    """
    learning = (True,) * len(problem.network.groups)

    def step(w: Array) -> Array:
        return jnp.sum(patterns.change(problem.network, rule, w, learning), axis=0)

    descent = -np.asarray(jax.jit(jax.jacfwd(step))(weights))
    return np.sort(np.linalg.eigvals(descent).real)


def spectrum_row(problem: Problem) -> dict[str, Any]:
    """Condition of backpropagation and of PERAL at the optimum, of every seed."""
    reason = PERAL().check_network(problem.network)
    row: dict[str, Any] = {"refused": reason or "", "condition": {}, "away": {}}
    rules = [
        rule for rule in (Backpropagation(), PERAL()) if not rule.check_network(problem.network)
    ]
    for rule in rules:
        conditions: list[float] = []
        away: list[int] = []
        for seed in range(len(problem.starts)):
            patterns = problem.of_seed(seed)
            if problem.linear:
                weights = jnp.asarray(direct_solution(problem.network, patterns))
            else:
                assert problem.optima is not None
                weights = problem.optima[seed]
            values = eigenvalues(problem, rule, patterns, weights)
            limit = NEGLIGIBLE * np.max(np.abs(values))
            conditions.append(float(values[-1] / values[0]) if values[0] > limit else np.inf)
            away.append(int(np.sum(values < -limit)))
        row["condition"][rule.name] = conditions
        row["away"][rule.name] = away
    return row
