"""CSLCs of many recordings, trained side by side as in 7.5, next to the direct solve.

A recording's patterns are the same for every rule, and each rule begins at zero weights. Rates,
bouts and the end of training are those of `ROUTES`.
"""

import dataclasses
import os
import time
from collections.abc import Mapping, Sequence
from concurrent.futures import ThreadPoolExecutor

import equinox as eqx
import jax
import jax.numpy as jnp
import numpy as np
from jaxtyping import Array, Float

import jaxcslc as jc
from jaxcslc.training import (
    PERAL,
    AbstractRates,
    AbstractRule,
    AdaptedRates,
    AdaptiveNetwork,
    Backpropagation,
    Examples,
    FixedRates,
    Plan,
    Schedule,
    Training,
    examples,
    half_rms,
    half_square,
    inverse_dynamics,
    train,
    with_normal_equations,
)


# Reduction of half the summed squared errors per epoch at which training ends [(N m)²]. By
# backpropagation, ε on the training patterns of PUMA A and B (seed 1) ends 1.9 and 1.4 % above the
# direct solve's; at ten times as much, 3.3 and 6.6 %; at a tenth, 1.3 and 1.2 %.
LEAST_REDUCTION = 3e-5
# Recordings whose equations are computed at once: 2 GB for those of a PUMA 560 and 3,300 samples.
_PREPARED_TOGETHER = 64
EPOCHS = 20_000  # at most; the trainings of a simulated PUMA 560 need 2,000 to 3,000


@dataclasses.dataclass(frozen=True)
class Route:
    """Rules with the epochs of their bouts and their rates."""

    rules: tuple[AbstractRule, ...]
    bouts: tuple[int, ...]
    rates: tuple[AbstractRates, ...]


# Backpropagation begins at small rates (7.5), which 6.3.1's rule adapts. PERAL moves a link by the
# whole of its share of the error; rates are stable up to 2.9 (`largest_rates`).
_DESCENT, _ALLOCATION = AdaptedRates(1e-3), FixedRates(1.0)
ROUTES: Mapping[str, Route] = {
    "backpropagation": Route((Backpropagation(),), (500,), (_DESCENT,)),
    "backpropagation and PERAL": Route(
        (Backpropagation(), PERAL()), (200, 10), (_DESCENT, _ALLOCATION)
    ),
    "PERAL in most epochs": Route((Backpropagation(), PERAL()), (20, 25), (_DESCENT, _ALLOCATION)),
}


@dataclasses.dataclass(frozen=True)
class Trainings:
    """Trainings of n recordings by one route.

    **Attributes**

    - `training`: leading axis n.
    - `seconds`: of all of them, without compiling.
    - `compile_seconds`: what the first of two equal calls took more.
    """

    training: Training
    seconds: float
    compile_seconds: float

    @property
    def weights(self) -> Float[Array, "recordings coefficients"]:
        """Return the weights at the end of each training."""
        return self.training.weights

    def epochs(self) -> tuple[Float[np.ndarray, " recordings"], ...]:
        """Epochs of backpropagation and of PERAL, one number per training."""
        rule = np.asarray(self.training.history.rule)
        return tuple(np.sum(rule == number, axis=-1).astype(float) for number in (0, 1))


def stacked(
    network: AdaptiveNetwork, patterns: Sequence[jc.Patterns], *, equations: bool = False
) -> Examples:
    """Return the examples of several recordings with a leading axis of them.

    - `patterns`: one per recording, of the same number of samples.
    - `equations`: whether to add their normal equations.
    """
    parts = [(p.q, p.qd, p.qdd, p.torque, p.mask) for p in patterns]
    arrays = [jnp.stack([jnp.asarray(x) for x in column]) for column in zip(*parts, strict=True)]
    return _examples(network, tuple(arrays), equations)


@eqx.filter_jit
def _examples(network: AdaptiveNetwork, arrays: tuple[Array, ...], equations: bool) -> Examples:
    def one(q: Array, qd: Array, qdd: Array, torque: Array, mask: Array) -> Examples:
        made = examples(network, (q, qd, qdd), torque, mask)
        return with_normal_equations(network, made) if equations else made

    return jax.lax.map(lambda recording: one(*recording), arrays, batch_size=_PREPARED_TOGETHER)


def epsilon(
    network: AdaptiveNetwork,
    of: Examples,
    weights: Float[Array | np.ndarray, "*recordings coefficients"],
) -> Float[np.ndarray, " recordings"]:
    """Return the thesis's ε of each recording [N m].

    - `weights`: of each recording, or the same for all.
    """
    every = jnp.broadcast_to(weights, (of.targets.shape[0], network.size))
    return np.asarray(_costs(network, of, every, root=True))


def half_squares(
    network: AdaptiveNetwork,
    of: Examples,
    weights: Float[Array | np.ndarray, "*recordings coefficients"],
) -> Float[np.ndarray, " recordings"]:
    """Return the cost of Eqn. 3.4-2 of each recording, as `epsilon` does [(N m)²]."""
    every = jnp.broadcast_to(weights, (of.targets.shape[0], network.size))
    return np.asarray(_costs(network, of, every, root=False))


@eqx.filter_jit
def _costs(network: AdaptiveNetwork, of: Examples, weights: Array, *, root: bool) -> Array:
    cost = half_rms if root else half_square
    return jax.vmap(lambda one, k: one.costs(network, k, cost)[0])(of, weights)


def train_side_by_side(
    cslc: jc.CSLC,
    training_set: Examples,
    measured: Float[Array | np.ndarray, " coefficients"],
    route: Route,
    *,
    least_reduction: float = LEAST_REDUCTION,
    epochs: int = EPOCHS,
    workers: int | None = None,
    timed: bool = True,
) -> Trainings:
    """Train a CSLC on each of several recordings, from zero weights.

    On a CPU, the recordings are divided among its cores.

    **Arguments**

    - `training_set`: from `stacked` with its equations.
    - `measured`: coefficients by direct measurement, whose cost on the training patterns is that
      of the hand-over.
    - `workers`: threads; one on a GPU, one per core of a CPU if omitted.
    - `timed`: whether to train twice, so that seconds do not contain compiling.
    """
    network = inverse_dynamics(cslc)
    count = training_set.targets.shape[0]
    hand_over = half_squares(network, training_set, jnp.asarray(measured))
    if workers is None:
        workers = 1 if jax.default_backend() != "cpu" else len(os.sched_getaffinity(0))
    parts = np.array_split(np.arange(count), min(workers, count))

    def one(part: np.ndarray) -> Training:
        schedule = Schedule(
            route.rules,
            hand_over=jnp.asarray(hand_over[part]),
            bout=route.bouts,
            least_reduction=least_reduction,
            in_step=True,
        )
        plan = Plan(schedule, route.rates, cost=half_square, patience=epochs)
        return train(
            network,
            jax.tree.map(lambda x: x[part], training_set),
            jnp.zeros((len(part), network.size)),
            plan,
            epochs=epochs,
            chunk=max(route.bouts),
            keep_weights=False,
            throw=False,
        )

    def all_of_them() -> tuple[Training, float]:
        start = time.perf_counter()
        with ThreadPoolExecutor(len(parts)) as pool:
            several = list(pool.map(one, parts))
        return _joined(several), time.perf_counter() - start

    result, seconds = all_of_them()
    if not timed:
        return Trainings(result, seconds, float("nan"))
    result, again = all_of_them()
    return Trainings(result, again, seconds - again)


def _joined(parts: Sequence[Training]) -> Training:
    """Trainings one after the other; histories of those that ended sooner are filled up."""
    longest = max(part.history.cost.shape[-1] for part in parts)

    def filled(part: Training) -> Training:
        more = longest - part.history.cost.shape[-1]

        def longer(values: np.ndarray) -> np.ndarray:
            last = values[:, -1:]
            return np.concatenate([values, np.repeat(last, more, axis=1)], axis=1)

        history = jax.tree.map(lambda x: longer(np.asarray(x)), part.history)
        rule = history.rule
        rule[:, longest - more :] = -1
        return eqx.tree_at(lambda t: t.history, part, history)

    return jax.tree.map(lambda *xs: np.concatenate(xs), *(filled(part) for part in parts))
