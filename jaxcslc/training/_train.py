"""Trainings, one or thousands side by side, with checkpoints from which they resume."""

import hashlib
import zipfile
from pathlib import Path
from typing import Any

import equinox as eqx
import jax
import jax.numpy as jnp
import numpy as np
from jaxtyping import Array, Float, Key

from .._display import is_watched, progress_bar
from .._environment import platform_of, require_float64
from .._scratch import unfinished
from ._epoch import OUTCOMES, History, Training, TrainingState, epoch
from ._examples import Examples
from ._functions import half_square
from ._kernel import rule_kernel
from ._network import AdaptiveNetwork
from ._plan import Plan, Schedule
from ._rules import AbstractRule, Backpropagation


class Checkpoint:
    """A training's file: where it stands, its history so far, and what it is a training of.

    - `path`: of a NumPy archive; written whole beside it and then moved into place, so that an
      interruption leaves the last one intact.
    - `made_of`: whatever the result depends on.
    """

    def __init__(self, path: Path, made_of: Any) -> None:
        self.path = path
        self.fingerprint = _fingerprint(made_of)

    def load(self, state: TrainingState) -> tuple[TrainingState, list[History], int]:
        """The state, records and number of epochs saved last; those given if there is no file.

        **Raises** `ValueError` if the file is no checkpoint, or one of another training.
        """
        if not self.path.exists():
            return state, [], 0
        try:
            with self.path.open("rb") as file, np.load(file) as archive:
                content = dict(archive)
            saved_fingerprint, passed = str(content["fingerprint"]), int(content["epochs"])
        except (OSError, ValueError, KeyError, TypeError, EOFError, zipfile.BadZipFile):
            raise ValueError(
                f"{self.path}: expected a checkpoint of a training, and it is none"
            ) from None
        if saved_fingerprint != self.fingerprint:
            raise ValueError(
                f"{self.path}: the checkpoint is of another training (network, patterns, plan or"
                " start differ); give another file, or remove it to start anew"
            )
        leaves, structure = jax.tree.flatten(state)
        restored = [
            _restored(leaf, content[f"state_{number}"]) for number, leaf in enumerate(leaves)
        ]
        record = History(*(content.get(f"record_{name}") for name in History.__annotations__))  # pyright: ignore[reportArgumentType]
        return jax.tree.unflatten(structure, restored), [record], passed

    def save(self, state: TrainingState, records: list[History], passed: int) -> None:
        """Replace the file."""
        content: dict[str, Any] = {"fingerprint": self.fingerprint, "epochs": passed}
        leaves = enumerate(jax.tree.leaves(state))
        content |= {f"state_{number}": _plain(leaf) for number, leaf in leaves}
        axis = state.cost.ndim
        whole = jax.tree.map(lambda *parts: np.concatenate(parts, axis=axis), *records)
        kept = {name: getattr(whole, name) for name in History.__annotations__}
        content |= {f"record_{name}": x for name, x in kept.items() if x is not None}
        self.path.parent.mkdir(parents=True, exist_ok=True)
        with unfinished(self.path) as path, path.open("wb") as file:
            np.savez(file, **content)


def _plain(leaf: Any) -> np.ndarray:
    if isinstance(leaf, Array) and jnp.issubdtype(leaf.dtype, jax.dtypes.prng_key):
        return np.asarray(jax.random.key_data(leaf))
    return np.asarray(leaf)


def _restored(leaf: Any, saved: np.ndarray) -> Array:
    if isinstance(leaf, Array) and jnp.issubdtype(leaf.dtype, jax.dtypes.prng_key):
        return jax.random.wrap_key_data(jnp.asarray(saved), impl=jax.random.key_impl(leaf))
    return jnp.asarray(saved, leaf.dtype)


def _fingerprint(made_of: Any) -> str:
    """Hash the numbers and the structure of a training.

    Equal trainings have the same hash in every process.
    """
    leaves, structure = jax.tree.flatten(made_of)
    digest = hashlib.sha256(_without_addresses(str(structure)).encode())
    for leaf in leaves:
        if callable(leaf):  # such as a preprocessing: as a number it would be an address
            digest.update(_without_addresses(str(leaf)).encode())
            continue
        values = _plain(leaf)
        digest.update(f"{values.dtype} {values.shape}".encode())
        digest.update(values.tobytes())
    return digest.hexdigest()


def _without_addresses(text: str) -> str:
    """Remove memory addresses, which functions print and which differ from process to process."""
    return " ".join(word for word in text.replace(">", " ").split() if not word.startswith("0x"))


# Where kernels compute changes and costs, and nothing of a pattern is in memory for a training.
_ALL_BY_KERNELS = 65_536
# On normal equations, and on a processor, where trainings stay near its caches.
_MOST_OF_EQUATIONS, _MOST_ON_HOST = 256, 8
# What trainings may take of a GPU's memory [bytes].
_GPU_MEMORY = 4e9


def train(
    network: AdaptiveNetwork,
    training_set: Examples,
    weights: Float[Array | np.ndarray, "*trainings weights"],
    plan: Plan | AbstractRule,
    *,
    epochs: int = 1000,
    stop_set: Examples | None = None,
    key: Key[Array, "..."] | None = None,
    keep_weights: bool = True,
    chunk: int = 50,
    block: int | None = None,
    checkpoint: str | Path | None = None,
    progress: bool = False,
    throw: bool = True,
) -> Training:
    """Train a network, or thousands of copies of it side by side (thesis 3.4, 6.3, 7.5).

    **Arguments**

    - `network`: p weights.
    - `training_set`: the training patterns, from `examples`; for trainings on a recording each,
      with a leading axis on every array, as `jax.vmap` of `examples` gives.
    - `weights`: (p,) to start from; (trainings, p) for many.
    - `plan`: a `Plan`, or one rule for a plan of defaults.
    - `epochs`: at most.
    - `stop_set`: patterns that end the training when their cost rises (3.6.1).
    - `key`: for the order of sequential training; one, or one for each training.
    - `keep_weights`: whether the history holds the weights of every epoch.
    - `chunk`: epochs between looks at progress, checkpoints and whether all have ended.
    - `block`: how many trainings run side by side; what is best for memory and caches by default.
    - `checkpoint`: a file to save to after every chunk and to go on from if it is there. A run
      that is interrupted and resumed ends as it would have.
    - `progress`: show a progress bar in notebooks, at Python's prompt and on terminals.
    - `throw`: raise if a single training diverged or stalled. Of many, read `outcome`.

    **Returns** a `Training`.

    **Raises**

    - `ValueError`: if the rule cannot train such a network or from such weights, if shapes
      differ, numbers are not float64, or `checkpoint` holds another training.
    - `RuntimeError`: with `throw`, if a single training diverged or stalled.

    `jax.vmap` needs no loop of this kind: see `training_steps`, which this calls chunk by chunk.

    >>> import jax.numpy as jnp
    >>> from jaxcslc.training import fully_connected
    >>> from jaxcslc.training import PerceptronRule, Plan, FixedRates, examples, train
    >>> network = fully_connected([2, 1], "hard limiter")
    >>> x = jnp.asarray([[0.0, 0.0], [0.0, 1.0], [1.0, 0.0], [1.0, 1.0]])
    >>> both = examples(network, x, jnp.asarray([[0.0], [0.0], [0.0], [1.0]]))
    >>> plan = Plan(PerceptronRule(), FixedRates(0.5), order="sequential")
    >>> training = train(network, both, jnp.zeros(3), plan, epochs=50)
    >>> network.outputs(training.weights, x)[:, 0].tolist()
    [0.0, 0.0, 0.0, 1.0]
    """
    plan = Plan(plan) if isinstance(plan, AbstractRule) else plan
    start = jnp.asarray(weights)
    _check(network, training_set, start, plan)
    trainings = start.shape[0] if start.ndim == 2 else training_set.trainings
    many = trainings is not None
    key = jax.random.key(0) if key is None else key
    _check_numbers(plan, stop_set, key, trainings)
    if epochs < 0 or chunk < 1 or (block is not None and block < 1):
        raise ValueError("epochs, chunk, block: expected no less than 0, 1 and 1")
    plan = _of_arrays(plan)
    if trainings is not None:
        start = jnp.broadcast_to(start, (trainings, network.size))
        if key.ndim == 0:
            key = jax.random.split(key, trainings)
        state = jax.vmap(lambda w, k: TrainingState.first(network, plan, w, k))(start, key)
    else:
        state = TrainingState.first(network, plan, start, key)

    records: list[History] = []
    passed, saved = 0, None
    if checkpoint is not None:
        # Links print as a summary: the fingerprint needs their content.
        links = [layer.links for _, layer in network.adaptive_layers]
        wiring = [(part.source, part.node, part.weight, part.multiple) for part in links]
        made_of = (network, wiring, plan, training_set, stop_set, start, key, keep_weights)
        saved = Checkpoint(Path(checkpoint), made_of)
        state, records, passed = saved.load(state)
    if block is None:
        block = _block(network, training_set, plan, trainings or 1)
    shown = progress and is_watched()
    with progress_bar(total=epochs, initial=passed, unit="epoch", disable=not shown) as bar:
        while passed < epochs and not bool(jnp.all(state.done)):
            count, rule = min(chunk, epochs - passed), None
            if plan.schedule.in_step:
                rule, left = _turn_in_step(plan.schedule, state, records, passed)
                count = min(count, left)
            state, record = _many_steps(
                network, plan, training_set, stop_set, state, count, keep_weights, block, many, rule
            )
            records.append(jax.tree.map(np.asarray, record))
            passed += count
            if plan.schedule.in_step:
                state = _ended_in_step(plan.schedule, state, records, passed)
            if saved is not None:
                saved.save(state, records, passed)
            bar.update(count)
            lowest = float(jnp.min(state.lowest))
            bar.set_postfix(cost=f"{lowest:.4g}", ended=int(jnp.sum(state.done)))
    training = _training(state, records, stop_set is not None, network)
    if throw and not many:
        for failure in (OUTCOMES.diverged, OUTCOMES.stalled):
            if bool(training.outcome == failure):
                raise RuntimeError(OUTCOMES[failure])
    return training


@eqx.filter_jit
def training_steps(
    network: AdaptiveNetwork,
    plan: Plan,
    training_set: Examples,
    stop_set: Examples | None,
    state: TrainingState,
    epochs: int,
    keep_weights: bool = False,
    rule: int | None = None,
) -> tuple[TrainingState, History]:
    """Run epochs of one training: a pure function of its state, to be vmapped at will.

    A training that has ended waits, its state unchanged. Returns the state and the records,
    with a leading axis of epochs.

    - `rule`: of trainings in step, the index of the rule that learns in all these epochs.
    """

    def step(state: TrainingState, _: None) -> tuple[TrainingState, History]:
        return epoch(network, plan, training_set, stop_set, state, keep_weights, rule)

    return jax.lax.scan(step, state, None, length=epochs)


@eqx.filter_jit
def _many_steps(
    network: AdaptiveNetwork,
    plan: Plan,
    training_set: Examples,
    stop_set: Examples | None,
    state: TrainingState,
    epochs: int,
    keep_weights: bool,
    block: int,
    many: bool,
    rule: int | None,
) -> tuple[TrainingState, History]:
    if not many:
        return training_steps(
            network, plan, training_set, stop_set, state, epochs, keep_weights, rule
        )

    def numbers(plan: Plan) -> tuple[Any, ...]:
        return plan.schedule.hand_over, plan.schedule.least_reduction, plan.target

    # What differs between trainings is mapped over; the rest is shared.
    single = jax.tree.map(lambda _: False, plan)
    of_plan = eqx.tree_at(numbers, single, tuple(jnp.ndim(x) == 1 for x in numbers(plan)))
    of_stop_set = stop_set is not None and stop_set.trainings is not None
    differs = of_plan, training_set.trainings is not None, of_stop_set
    mapped, shared = eqx.partition((plan, training_set, stop_set), differs)

    def one(mapped: Any) -> tuple[TrainingState, History]:
        state, of_training = mapped
        plan, training_set, stop_set = eqx.combine(of_training, shared)
        return training_steps(
            network, plan, training_set, stop_set, state, epochs, keep_weights, rule
        )

    return jax.lax.map(one, (state, mapped), batch_size=block)


def _turn_in_step(
    schedule: Schedule, state: TrainingState, records: list[History], passed: int
) -> tuple[int, int]:
    """The rule whose turn it is, and how many epochs of its bout are left."""
    begun = _rounds_begun(schedule, state, records, passed)
    if begun is None:
        return 0, schedule.bouts[0]
    at = (passed - begun) % sum(schedule.bouts)
    for rule in (*range(1, len(schedule.rules)), 0):
        if at < schedule.bouts[rule]:
            return rule, schedule.bouts[rule] - at
        at -= schedule.bouts[rule]
    raise AssertionError("a round is the sum of its bouts")


def _rounds_begun(
    schedule: Schedule, state: TrainingState, records: list[History], passed: int
) -> int | None:
    """The epoch in which the second rule learnt first; None before every training is handed over.

    From what a checkpoint holds, so that a resumed run takes the same turns.
    """
    if len(schedule.rules) == 1:
        return 0
    before = 0
    for record in records:
        later_rules = np.asarray(record.rule).reshape(-1, record.rule.shape[-1]) > 0
        if later_rules.any():
            return before + int(np.argmax(later_rules.any(axis=0)))
        before += record.rule.shape[-1]
    return passed if bool(jnp.all(state.turn.handed_over | state.done)) else None


def _ended_in_step(
    schedule: Schedule, state: TrainingState, records: list[History], passed: int
) -> TrainingState:
    """The state after a round of bouts: trainings to which it brought too little have ended."""
    begun = _rounds_begun(schedule, state, records, passed)
    length = sum(schedule.bouts)
    if begun is None or passed == begun or (passed - begun) % length:
        return state
    costs = np.concatenate([np.asarray(record.cost) for record in records], axis=-1)
    before = np.min(costs[..., : max(passed - length, 1)], axis=-1)
    little = before - state.lowest < jnp.asarray(schedule.least_reduction) * length
    ended = little & ~state.done
    over_trainings = jax.vmap if ended.ndim else lambda function: function
    outcome = over_trainings(
        lambda end, before: OUTCOMES.where(end, OUTCOMES.no_further_reduction, before)
    )(ended, state.outcome)
    return eqx.tree_at(lambda s: s.outcome, state, outcome)


def _block(network: AdaptiveNetwork, training_set: Examples, plan: Plan, trainings: int) -> int:
    """Return the number of trainings to run side by side.

    A divisor of all trainings is preferred: a remainder needs another compilation.
    """
    most = min(_largest_block(network, training_set, plan), trainings)
    even = max(size for size in range(1, most + 1) if trainings % size == 0)
    return even if 2 * even > most else most


def _largest_block(network: AdaptiveNetwork, training_set: Examples, plan: Plan) -> int:
    """Return the most trainings to run side by side; on a CPU, those that stay near its caches."""
    rules, costs = plan.schedule.rules, {plan.cost, plan.measure or plan.cost}
    by_equations = training_set.equations is not None and costs == {half_square}
    if by_equations and all(isinstance(rule, Backpropagation) for rule in rules):
        return _MOST_OF_EQUATIONS
    if platform_of(training_set.targets) == "cpu":
        return _MOST_ON_HOST
    learning, layers = plan.learning(network), len(network.adaptive_layers)
    by_kernel = training_set.condensed is not None and training_set.trainings is None
    by_subnetwork = training_set.subnetwork_counts is not None
    by_kernel = by_kernel and all(
        rule_kernel(network, rule, learning, by_subnetwork=by_subnetwork) is not None
        for rule in rules
    )
    in_batches = by_kernel and plan.schedule.switch is None and plan.order == "batch"
    if in_batches and all(training_set.has_cost_kernel(network, cost) for cost in costs):
        return _ALL_BY_KERNELS
    # The values of every node at every pattern, of which an epoch keeps some ten at a time; with a
    # kernel, outputs, their parts by layer, and errors at trial rates, all at a time.
    numbers = 10 * sum(layer.links.nodes for _, layer in network.adaptive_layers)
    if by_kernel:
        numbers = network.outputs_count * (2 + layers) + 4 * layers
    return max(1, int(_GPU_MEMORY / (8 * max(numbers, 1) * training_set.targets.shape[-1])))


def _training(
    state: TrainingState, records: list[History], stop_set: bool, network: AdaptiveNetwork
) -> Training:
    axis = state.cost.ndim
    if records:
        history = jax.tree.map(lambda *parts: np.concatenate(parts, axis=axis), *records)
    else:
        none = np.zeros((*state.cost.shape, 0))
        rates = np.zeros((*none.shape, len(network.groups)))
        history = History(none, none, none, none.astype(int), rates, None)
    diverged = (state.outcome == OUTCOMES.diverged)[..., None]
    weights = jnp.where(diverged, state.lowest_weights, state.weights)
    if stop_set:
        weights = state.stop_weights
    return Training(
        weights=weights,
        rates=state.rates,
        cost=state.cost,
        epochs=state.epoch,
        outcome=state.outcome,
        history=history,
    )


def _of_arrays(plan: Plan) -> Plan:
    """Return the plan with its numbers as arrays, which are no part of a compiled function.

    Other numbers then compile nothing.
    """
    return jax.tree.map(lambda x: jnp.asarray(x) if eqx.is_array_like(x) else x, plan)


def _check_numbers(
    plan: Plan, stop_set: Examples | None, key: Array, trainings: int | None
) -> None:
    """Check that numbers are single, or one for each training."""
    if stop_set is not None:
        require_float64(*stop_set.arrays)
    sets = None if stop_set is None or stop_set.trainings is None else (stop_set.trainings,)
    for name, shape in (
        ("hand_over", jnp.shape(plan.schedule.hand_over)),
        ("least_reduction", jnp.shape(plan.schedule.least_reduction)),
        ("target", jnp.shape(plan.target)),
        ("key", key.shape),
        ("stop_set", sets or ()),
    ):
        if shape not in ((), (trainings,)):
            alternative = "" if trainings is None else f", or for each of {trainings} trainings"
            raise ValueError(f"{name}: expected one{alternative}, got shape {shape}")


def _check(network: AdaptiveNetwork, training_set: Examples, start: Array, plan: Plan) -> None:
    require_float64(start, *training_set.arrays)
    if start.ndim not in (1, 2) or start.shape[-1] != network.size:
        raise ValueError(
            f"weights: expected shape ({network.size},) or (trainings, {network.size}), got"
            f" {start.shape}"
        )
    if (
        training_set.trainings is not None
        and start.ndim == 2
        and len(start) != training_set.trainings
    ):
        raise ValueError(
            f"weights: {len(start)} starts, but {training_set.trainings} sets of patterns"
        )
    learning = plan.learning(network)
    for rule in plan.schedule.rules:
        reason = rule.check_network(network)
        if reason is not None:
            raise ValueError(reason)
        if training_set.trainings is None:
            reason = rule.check_patterns(
                network, training_set.signals, training_set.learning_counts
            )
            if reason is not None:
                raise ValueError(reason)
    reason = plan.schedule.rules[0].check_start(network, np.asarray(start), learning)
    if reason is not None:
        raise ValueError(reason)
