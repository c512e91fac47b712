"""Patterns ready for training: preprocessed inputs, targets, and the pairs that count.

`Examples` computes costs and changes of the weights; for backpropagation of linear networks, by
their `NormalEquations`.
"""

import dataclasses
from collections.abc import Sequence
from functools import partial
from typing import Any

import equinox as eqx
import jax
import jax.numpy as jnp
import numpy as np
from jax.core import Tracer
from jaxtyping import Array, Bool, Float

from .._text_table import first_of
from ._functions import HARD_LIMITER, LINEAR_COMBINER, Cost, half_square
from ._kernel import CostKernel, batched_by, cost_kernel, summed_change
from ._network import AdaptiveNetwork, Layer, Signals, Subnetwork, reaching_weights
from ._rules import AbstractRule, Backpropagation, Counts, links_per_weight, subnetwork_counts


def covered(network: AdaptiveNetwork, signals: Signals, counts: Counts) -> Bool[Array, " weights"]:
    """Mark weights about which at least one counted pair of their subnetwork tells something.

    Moduli all the way, so that nothing cancels: what counts is carried back to the links of the
    first layer through whatever is not zero. Hidden nodes are taken to answer something, and so
    are layers that compute weights.
    """
    return _covered(network.subnetworks, network.size, signals, counts)


@partial(jax.jit, static_argnums=(0, 1))
def _covered(
    subnetworks: tuple[Subnetwork, ...],
    size: int,
    signals: Signals,
    counts: Counts,
) -> Bool[Array, " weights"]:
    total = jnp.zeros(size, counts.dtype)
    for at, subnetwork in enumerate(subnetworks):
        inputs, contexts = signals.inputs[at], signals.contexts[at]
        back = subnetwork_counts(counts, at)
        for layer, context in zip(reversed(subnetwork.contexts), reversed(contexts), strict=True):
            moduli = jnp.abs(context)
            if layer.layers:
                answers = jnp.ones((layer.inputs, back.shape[-1]), back.dtype)
                at_weights = layer.backward_to_contexts(back, answers)
                total = total + _covered_back(layer.layers, size, moduli, at_weights)
                moduli = jnp.ones((layer.contexts, back.shape[-1]), back.dtype)
            back = layer.backward(back, moduli)
        total = total + _covered_back(subnetwork.layers, size, jnp.abs(inputs), back)
    return total > 0


def _covered_back(
    layers: Sequence[Layer],
    size: int,
    inputs: Float[Array, "inputs patterns"],
    back: Float[Array, "nodes patterns"],
) -> Float[Array, " weights"]:
    """Carry moduli from the outputs of some layers back to their links, and sum them per weight."""
    total = jnp.zeros(size, back.dtype)
    for number, layer in reversed(list(enumerate(layers))):
        links = layer.links
        values = inputs if number == 0 else jnp.ones((layer.inputs, back.shape[-1]))
        sums = links.at_links(back @ layer.with_bias(values).T)
        total = total + links.to_weights(sums, size)
        some = links.matrix(jnp.ones(size, back.dtype), magnitude=True)
        back = (some.T @ back)[: layer.inputs]
    return total


class NormalEquations(eqx.Module):
    """Normal equations of patterns: all that full-batch backpropagation of a linear network needs.

    Outputs that are linear in the weights have a quadratic cost, Eqn. 3.4-2's half sum of
    squares: its Gram matrix says what any number of patterns would, so that an epoch costs p²
    operations and not a pass over them: see `with_normal_equations`.

    **Attributes**

    - `gram`: (p, p), the mean over patterns of regressor' regressor.
    - `moment`: (p,), the mean of regressor' target.
    - `square`: mean over patterns of the summed squared targets.
    - `layered_gram`: (groups, p, p), parts of `gram` by the adaptive layer that the left factor
      belongs to.
    - `layered_moment`: (groups, p), parts of `moment` by layer.

    Where subnetworks learn from pairs of their own, `gram`, `moment` and `square` are of all pairs
    that count for any, as costs are. A layer's parts are of its own pairs. The sum of
    `layered_gram` is then not `gram`, and not symmetric.
    """

    gram: Float[Array, "*sets weights weights"]
    moment: Float[Array, "*sets weights"]
    square: Float[Array, "*sets"]
    layered_gram: Float[Array, "*sets groups weights weights"]
    layered_moment: Float[Array, "*sets groups weights"]

    def cost(self, weights: Float[Array, " weights"]) -> Float[Array, ""]:
        """Half the mean of the summed squared errors (Eqn. 3.4-2).

        A difference of large numbers where it is small: of a cost below a millionth of a
        millionth of that of zero weights nothing is left but rounding, and it may be negative.
        """
        square = weights @ (self.gram @ weights) - 2.0 * (self.moment @ weights) + self.square
        return 0.5 * square

    def change(
        self,
        network: AdaptiveNetwork,
        weights: Float[Array, " weights"],
        learning: tuple[bool, ...],
    ) -> Float[Array, "groups weights"]:
        """Return a batch's move at a rate of one, as `Backpropagation` finds it on the patterns."""
        layers = [layer.links for _, layer in network.adaptive_layers]
        shares = jnp.asarray(1.0 / links_per_weight(layers, network.size, learning))
        gradient = self.layered_moment - self.layered_gram @ weights
        takes_part = jnp.asarray(learning, gradient.dtype)
        return gradient * shares[None, :] * takes_part[:, None]

    def solution(self) -> Float[Array, "*sets weights"]:
        """Return the weights at which backpropagation at one rate for all layers no longer moves,
        (p,).

        They solve Z'(t - X k) = 0 over all pairs of output and pattern. X is the regressor. Z is X
        with the columns of a subnetwork zero at pairs that it does not learn from. If all
        subnetworks learn from the same pairs, this is the least-squares solution, of lowest cost.
        Otherwise it is an instrumental-variable estimate with the instruments Z: its cost may be
        above the lowest. It helps where what the network lacks correlates with the columns that Z
        has zero, and with no others, as static friction does with viscous and Coulomb friction
        (7.2.2). The other columns then keep the pairs, which a mask of all subnetworks would lose.

        Of weights that the patterns leave open, the smallest in proportion to their regressors.
        Can be jitted, and mapped over sets of patterns.

        >>> import numpy as np
        >>> from jaxcslc.training import fully_connected
        >>> from jaxcslc.training import examples, normal_equations
        >>> network = fully_connected([1, 1], "linear combiner")
        >>> line = examples(network, np.array([[0.0], [1.0]]), np.array([[1.0], [3.0]]))
        >>> normal_equations(network, line).solution().round(9).tolist()  # slope and bias
        [2.0, 1.0]
        """
        matrix = jnp.sum(self.layered_gram, axis=-3)
        moment = jnp.sum(self.layered_moment, axis=-2)
        lengths = jnp.sqrt(jnp.diagonal(self.gram, axis1=-2, axis2=-1))
        lengths = jnp.where(lengths > 0.0, lengths, 1.0)
        scaled = matrix / (lengths[..., :, None] * lengths[..., None, :])

        def solved(scaled: Array, moment: Array) -> Array:
            return jnp.linalg.lstsq(scaled, moment)[0]

        for _ in range(moment.ndim - 1):
            solved = jax.vmap(solved)
        return solved(scaled, moment / lengths) / lengths


class Examples(eqx.Module):
    """Patterns ready to train a network with: preprocessed inputs, targets, and what counts.

    Units first, patterns last. Built by `examples`.

    **Attributes**

    - `signals`: preprocessed inputs and contexts.
    - `targets`: (outputs, patterns).
    - `counts`: (outputs, patterns), one where the pair of output and pattern takes part in
      learning and zero where it is masked. Costs are of these pairs.
    - `condensed`: for a network with context-sensitive layers that is linear in its weights,
      for every output the sensitivity to each weight that reaches it, (weights, patterns);
      otherwise none. What an epoch needs to know a cost, in a tenth of the operations.
    - `subnetwork_counts`: (subnetworks, outputs, patterns), of the pairs of `counts`, those that
      each subnetwork learns from (7.2.2); none where all learn from all of them.
    - `equations`: their `NormalEquations`, which `with_normal_equations` adds. Backpropagation and
      the cost `half_square` then take p² operations per epoch; other rules and costs are as before.
    """

    signals: Signals
    targets: Float[Array, "outputs patterns"]
    counts: Float[Array, "outputs patterns"]
    condensed: tuple[Float[Array, "_ patterns"], ...] | None
    subnetwork_counts: Float[Array, "subnetworks outputs patterns"] | None = None
    equations: NormalEquations | None = None

    @property
    def learning_counts(self) -> Counts:
        """Pairs that rules learn from: those of each subnetwork, or those of all."""
        return self.counts if self.subnetwork_counts is None else self.subnetwork_counts

    @property
    def patterns(self) -> Float[Array, ""]:
        """Number of patterns with an output that counts; at least 1."""
        return jnp.maximum(jnp.sum(jnp.any(self.counts > 0, axis=0)), 1).astype(self.counts.dtype)

    @property
    def trainings(self) -> int | None:
        """Number of sets of patterns, if there is a leading axis of them; otherwise None."""
        return self.targets.shape[0] if self.targets.ndim == 3 else None

    @property
    def arrays(self) -> tuple[Array, ...]:
        """The numbers, to check their precision."""
        return (*self.signals.inputs, self.targets)

    def costs(
        self, network: AdaptiveNetwork, weights: Float[Array, " weights"], *costs: Cost
    ) -> tuple[Float[Array, ""], ...]:
        """Return each cost of the network with these weights; of many at once by a kernel, where
        there is one."""
        values = {cost: self._cost(network, weights, cost) for cost in costs}
        return tuple(values[cost] for cost in costs)

    def _cost(
        self, network: AdaptiveNetwork, weights: Float[Array, " weights"], cost: Cost
    ) -> Float[Array, ""]:
        if self.equations is not None and cost is half_square:
            return self.equations.cost(weights)
        single, kernel = partial(_cost_after, network, cost), self._cost_kernel(network, cost, 0)
        if kernel is None:
            return single(weights, self)
        return batched_by(single, partial(_costs_of_many, kernel), 1)(weights, self)

    def trial_costs(
        self,
        network: AdaptiveNetwork,
        weights: Float[Array, " weights"],
        change: Float[Array, "groups weights"],
        trials: Float[Array, "trials groups"],
        cost: Cost,
    ) -> Float[Array, " trials"]:
        """Return the cost after a change of the weights at each of several sets of rates.

        Sums at the output nodes that are linear in the weights are combined from those of one
        layer's change at a time: five passes for the PUMA 560 and not sixteen.
        """
        if self.equations is not None and cost is half_square:
            by_equations = self.equations.cost
            return jax.vmap(lambda trial: by_equations(weights + trial @ change))(trials)
        if not network.linear:
            return jax.lax.map(
                lambda trial: self.costs(network, weights + trial @ change, cost)[0], trials
            )

        def single(weights: Array, change: Array, trials: Array, patterns: Examples) -> Array:
            present = patterns.totals(network, weights)
            parts = jax.vmap(lambda part: patterns.totals(network, part))(change)

            def after(trial: Array) -> Array:
                total = present
                for group in range(
                    trials.shape[1]
                ):  # written out: a product of matrices stays apart
                    total = total + trial[group] * parts[group]
                errors = patterns.targets - network.activation.value(total)
                return cost(errors * patterns.counts, patterns.counts)

            return jax.vmap(after)(trials)

        kernel = self._cost_kernel(network, cost, len(trials))
        if kernel is None:
            return single(weights, change, trials, self)
        many = partial(_trial_costs_of_many, kernel)
        return batched_by(single, many, 3)(weights, change, trials, self)

    def has_cost_kernel(self, network: AdaptiveNetwork, cost: Cost) -> bool:
        """Return whether a kernel computes the cost, also at all sets of rates to compare."""
        trials = 4 * len(network.adaptive_layers)
        return all(self._cost_kernel(network, cost, number) for number in (0, 1, trials))

    def _cost_kernel(self, network: AdaptiveNetwork, cost: Cost, trials: int) -> CostKernel | None:
        if self.condensed is None:
            return None
        return cost_kernel(network, cost, reaching_weights(network), trials)

    def change(
        self,
        network: AdaptiveNetwork,
        rule: AbstractRule,
        weights: Float[Array, " weights"],
        learning: tuple[bool, ...],
    ) -> Float[Array, "groups weights"]:
        """Return a batch's move at a rate of one: the mean over patterns."""
        if self.equations is not None and isinstance(rule, Backpropagation):
            return self.equations.change(network, weights, learning)
        patterns = self.signals, self.targets, self.learning_counts
        return summed_change(network, rule, weights, *patterns, learning) / self.patterns

    def totals(
        self, network: AdaptiveNetwork, weights: Float[Array, " weights"]
    ) -> Float[Array, "outputs patterns"]:
        """Return the sums at the output nodes."""
        if self.condensed is None:
            return network.forward(weights, self.signals).total
        return jnp.stack(
            [
                weights[np.array(support, int)] @ rows
                for support, rows in zip(reaching_weights(network), self.condensed, strict=True)
            ]
        )

    def errors(
        self, network: AdaptiveNetwork, weights: Float[Array, " weights"]
    ) -> Float[Array, "outputs patterns"]:
        """Target less output (Eqn. 6.1-1), zero where it does not count."""
        outputs = network.activation.value(self.totals(network, weights))
        return (self.targets - outputs) * self.counts


def _cost_after(network: AdaptiveNetwork, cost: Cost, weights: Array, patterns: Examples) -> Array:
    return cost(patterns.errors(network, weights), patterns.counts)


def _costs_of_many(kernel: CostKernel, weights: Array, patterns: Examples) -> Array:
    return _trial_costs_of_many(kernel, weights, None, None, patterns)[:, 0]


def _trial_costs_of_many(
    kernel: CostKernel,
    weights: Array,
    change: Array | None,
    trials: Array | None,
    patterns: Examples,
) -> Array:
    assert patterns.condensed is not None
    return kernel(weights, change, trials, patterns.condensed, patterns.targets, patterns.counts)


def examples(
    network: AdaptiveNetwork,
    patterns: Any,
    targets: Float[Array | np.ndarray, "patterns outputs"],
    counts: Bool[Array | np.ndarray, "*subnetworks patterns outputs"] | None = None,
) -> Examples:
    """Return patterns and targets as training takes them.

    **Arguments**

    - `network`: o outputs.
    - `patterns`: whatever the network's preprocessing takes: (patterns, inputs), or motion.
    - `targets`: (patterns, o), within the range of the network's activation.
    - `counts`: (patterns, o), False for pairs of pattern and output that are excluded (5.2.4, 7.5);
      all count if omitted. (subnetworks, patterns, o) for subnetworks that learn from different
      pairs, as friction does in 7.2.2: see `jaxcslc.training.subnetwork_masks`. Costs are then
      of all pairs that count for any subnetwork.

    **Raises** `ValueError`, unless under `jit` or `vmap`, if targets are not of that shape or
    not finite, lie outside what the activation can answer, or if no pair that counts for its
    subnetwork reaches one of the weights.

    >>> import numpy as np
    >>> from jaxcslc.training import fully_connected
    >>> from jaxcslc.training import examples
    >>> network = fully_connected([2, 1], "hard limiter")
    >>> both = examples(network, np.asarray([[0.0, 1.0], [1.0, 1.0]]), np.asarray([[0.0], [1.0]]))
    >>> float(both.patterns)
    2.0
    """
    signals = network.signals(patterns)
    wanted = jnp.asarray(targets)
    outputs = network.outputs_count
    samples = signals.inputs[0].shape[-1] if signals.inputs[0].ndim == 2 else -1
    if wanted.shape != (samples, outputs):
        raise ValueError(
            f"targets: expected shape ({samples if samples >= 0 else 'patterns'}, {outputs}), one"
            f" row a pattern and one column an output, got {wanted.shape}"
        )
    by_subnetwork = (len(network.subnetworks), *wanted.shape)
    if counts is not None and jnp.shape(counts) not in (wanted.shape, by_subnetwork):
        raise ValueError(
            f"counts: expected shape {wanted.shape}, or {by_subnetwork} for masks by subnetwork,"
            f" got {jnp.shape(counts)}"
        )
    dtype = jnp.result_type(float, signals.inputs[0])
    taking_part = jnp.ones(wanted.shape, dtype) if counts is None else jnp.asarray(counts, dtype)
    learning_counts = jnp.swapaxes(taking_part, -1, -2)
    subnetwork_counts = learning_counts if learning_counts.ndim == 3 else None
    if subnetwork_counts is not None:
        learning_counts = jnp.max(subnetwork_counts, axis=0)
    wanted = jnp.where(learning_counts > 0, wanted.T.astype(dtype), 0.0)
    training_set = Examples(signals, wanted, learning_counts, None, subnetwork_counts)
    _check(network, training_set, named=jnp.asarray(targets))
    with_contexts = any(subnetwork.contexts for subnetwork in network.subnetworks)
    if network.linear and with_contexts:
        return dataclasses.replace(training_set, condensed=_condensed(network, signals))
    return training_set


@eqx.filter_jit
def _condensed(network: AdaptiveNetwork, signals: Signals) -> tuple[Array, ...]:
    """Sensitivities of every output: the answers to one weight at a time."""
    counted_outputs = jax.lax.map(
        lambda unit: network.forward(unit, signals).total,
        jnp.eye(network.size, dtype=signals.inputs[0].dtype),
    )
    return tuple(
        counted_outputs[np.array(support, int), output]
        for output, support in enumerate(reaching_weights(network))
    )


def _check(network: AdaptiveNetwork, training_set: Examples, named: Array) -> None:
    if any(isinstance(leaf, Tracer) for leaf in jax.tree.leaves(training_set)):
        return  # values are not known under a transformation
    counted = np.asarray(training_set.counts).T > 0
    finite = np.isfinite(np.asarray(named)) | ~counted
    if not finite.all():
        pattern, output = np.argwhere(~finite)[0]
        raise ValueError(
            f"targets: output {output + 1} of pattern {pattern + 1} is"
            f" {np.asarray(named)[pattern, output]}, expected a finite number or a mask"
        )
    for part, *seen in zip(
        network.subnetworks, training_set.signals.inputs, training_set.signals.contexts, strict=True
    ):
        if not all(np.isfinite(np.asarray(leaf)).all() for leaf in jax.tree.leaves(seen)):
            raise ValueError(f"inputs: subnetwork {part.name!r} is given NaN or infinite numbers")
    activation = network.activation
    values = np.asarray(named)
    outside = counted & ((values < activation.low) | (values > activation.high))
    if outside.any():
        pattern, output = np.argwhere(outside)[0]
        raise ValueError(
            f"targets: output {output + 1} of pattern {pattern + 1} is"
            f" {values[pattern, output]:g}, but a {activation.name} answers"
            f" {activation.low:g} to {activation.high:g} only"
        )
    if activation == HARD_LIMITER and (between := counted & (values != 0) & (values != 1)).any():
        pattern, output = np.argwhere(between)[0]
        raise ValueError(
            f"targets: output {output + 1} of pattern {pattern + 1} is"
            f" {values[pattern, output]:g}, but a hard limiter answers 0 or 1 only"
        )
    missing = np.flatnonzero(
        ~np.asarray(covered(network, training_set.signals, training_set.learning_counts))
    )
    if len(missing):
        names = first_of([network.names[index] for index in missing], 5)
        raise ValueError(
            f"masks leave no data for {names}: of every pattern that could tell, the"
            " output is masked or the input zero"
        )


# Patterns whose sensitivities are held at once: 32 MB for a PUMA 560's five subnetworks.
_BLOCK = 4096


def normal_equations(network: AdaptiveNetwork, training_set: Examples) -> NormalEquations:
    """Return the normal equations of patterns, of the pairs that count.

    Can be jitted, and vmapped over recordings.

    **Raises** `ValueError` if the network's outputs are not linear in its weights.

    >>> import jax.numpy as jnp
    >>> from jaxcslc.training import fully_connected
    >>> from jaxcslc.training import examples, normal_equations
    >>> network = fully_connected([1, 1], "linear combiner")
    >>> line = examples(network, jnp.asarray([[0.0], [1.0]]), jnp.asarray([[1.0], [3.0]]))
    >>> float(normal_equations(network, line).cost(jnp.zeros(2)))  # (1 + 9) / 2 / 2
    2.5
    """
    if not network.linear or network.activation != LINEAR_COMBINER:
        raise ValueError(
            "normal equations need outputs that are linear in the weights: one layer of linear"
            " combiners, without or with context-sensitive layers"
        )
    if training_set.trainings is not None:
        raise ValueError("normal equations: for many sets of patterns, jax.vmap this function")
    return _normal_equations(network, training_set)


def with_normal_equations(network: AdaptiveNetwork, training_set: Examples) -> Examples:
    """Return patterns together with their normal equations.

    A schedule of backpropagation and PERAL needs the patterns for PERAL alone. Backpropagation of
    a linear network, and the cost `half_square`, then need p² operations per epoch instead of a
    pass over all patterns. Can be jitted, and vmapped over recordings.

    **Arguments**

    - `network`: whose outputs are linear in its p weights.
    - `training_set`: from `examples`.

    **Raises** `ValueError` as `normal_equations`.

    >>> import jax.numpy as jnp
    >>> from jaxcslc.training import fully_connected
    >>> from jaxcslc.training import Backpropagation, examples, with_normal_equations
    >>> network = fully_connected([1, 1], "linear combiner")
    >>> line = examples(network, jnp.asarray([[0.0], [1.0]]), jnp.asarray([[1.0], [3.0]]))
    >>> both = with_normal_equations(network, line)
    >>> both.change(network, Backpropagation(), jnp.zeros(2), (True,)).tolist()
    [[1.5, 2.0]]
    """
    return dataclasses.replace(training_set, equations=normal_equations(network, training_set))


@eqx.filter_jit
def _normal_equations(network: AdaptiveNetwork, training_set: Examples) -> NormalEquations:
    samples = training_set.targets.shape[-1]
    blocks = -(-samples // _BLOCK)
    width = min(samples, _BLOCK)

    def block_of(x: Array) -> Array:
        """(..., patterns) to (blocks, ..., width), filled up with patterns of no weight."""
        filled = jnp.pad(x, [(0, 0)] * (x.ndim - 1) + [(0, blocks * width - samples)])
        return jnp.moveaxis(filled.reshape(*x.shape[:-1], blocks, width), -2, 0)

    units = jnp.eye(network.size, dtype=training_set.targets.dtype)

    def sums(part: Any) -> tuple[Array, ...]:
        signals, targets, counts, subnetwork_counts = part
        own_counts = counts[None] if subnetwork_counts is None else subnetwork_counts
        unit_responses = jax.lax.map(
            lambda unit: jnp.stack(network.forward(unit, signals).parts), units
        )
        masked_responses = (
            jnp.moveaxis(unit_responses, 1, 0) * own_counts[:, None]
        )  # (groups, p, outputs, patterns)
        whole = jnp.sum(unit_responses, axis=1)
        layered = (
            jnp.einsum("gpok,qok->gpq", masked_responses, whole),
            jnp.einsum("gpok,ok->gp", masked_responses, targets),
        )
        square = jnp.sum(targets**2 * counts)
        if subnetwork_counts is None:
            return square, *layered
        counted = whole * counts[None]
        gram = jnp.einsum("pok,qok->pq", counted, whole)
        return square, *layered, gram, jnp.einsum("pok,ok->p", counted, targets)

    of_patterns = (
        training_set.signals,
        training_set.targets,
        training_set.counts,
        training_set.subnetwork_counts,
    )
    parts = jax.lax.map(sums, jax.tree.map(block_of, of_patterns))
    square, *layered = (jnp.sum(x, axis=0) / training_set.patterns for x in parts)
    layered_gram, layered_moment, *of_all = layered
    gram, moment = of_all or (jnp.sum(x, axis=0) for x in layered)
    return NormalEquations(gram, moment, square, layered_gram, layered_moment)
