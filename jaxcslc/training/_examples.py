from typing import Any

import equinox as eqx
import jax
import jax.numpy as jnp
import numpy as np
from jax.core import Tracer
from jaxtyping import Array, Bool, Float

from ..adaptive import HARD_LIMITER, AdaptiveNetwork, Signals
from ._costs import Cost
from ._reach import covered, reach
from ._rules import AbstractRule


class Examples(eqx.Module):
    """Patterns ready to train a network with: preprocessed inputs, targets, and what counts.

    Units first, patterns last. Built by `examples`.

    **Attributes**

    - `signals`: preprocessed inputs and contexts.
    - `targets`: (outputs, patterns).
    - `counts`: (outputs, patterns), one where the pair of output and pattern takes part in
      learning and zero where it is masked.
    - `condensed`: for a network with context-sensitive layers that is linear in its weights,
      for every output the sensitivity to each weight that reaches it, (weights, patterns);
      otherwise none. What an epoch needs to know a cost, in a tenth of the operations.
    """

    signals: Signals
    targets: Float[Array, "outputs patterns"]
    counts: Float[Array, "outputs patterns"]
    condensed: tuple[Float[Array, "_ patterns"], ...] | None

    @property
    def patterns(self) -> Float[Array, ""]:
        """How many patterns have an output that counts."""
        return jnp.maximum(jnp.sum(jnp.any(self.counts > 0, axis=0)), 1).astype(self.counts.dtype)

    @property
    def trainings(self) -> int | None:
        """How many sets of patterns these are, if there is a leading axis of them."""
        return self.targets.shape[0] if self.targets.ndim == 3 else None

    @property
    def arrays(self) -> tuple[Array, ...]:
        """The numbers, to check their precision."""
        return (*self.signals.inputs, self.targets)

    def refuse(self, rule: AbstractRule, cost: Cost, order: str) -> str | None:
        """Why they cannot be trained with so, in one line; none if they can."""
        del rule, cost, order
        return None

    def costs(
        self, network: AdaptiveNetwork, weights: Float[Array, " weights"], *costs: Cost
    ) -> tuple[Float[Array, ""], ...]:
        """Each cost of the network with these weights."""
        errors = self.errors(network, weights)
        return tuple(cost(errors, self.counts) for cost in costs)

    def trial_costs(
        self,
        network: AdaptiveNetwork,
        weights: Float[Array, " weights"],
        change: Float[Array, "groups weights"],
        trials: Float[Array, "trials groups"],
        cost: Cost,
    ) -> Float[Array, " trials"]:
        """The cost after a change of the weights at each of several sets of rates.

        Sums at the output nodes that are linear in the weights are combined from those of one
        layer's change at a time: five passes for the PUMA 560 and not sixteen.
        """
        if not network.linear:
            return jax.lax.map(
                lambda trial: self.costs(network, weights + trial @ change, cost)[0], trials
            )
        present = self.totals(network, weights)
        parts = jax.vmap(lambda part: self.totals(network, part))(change)

        def after(trial: Array) -> Array:
            total = present
            for group in range(trials.shape[1]):  # written out: a product of matrices stays apart
                total = total + trial[group] * parts[group]
            return cost((self.targets - network.activation.value(total)) * self.counts, self.counts)

        return jax.vmap(after)(trials)

    def change(
        self,
        network: AdaptiveNetwork,
        rule: AbstractRule,
        weights: Float[Array, " weights"],
        learning: tuple[bool, ...],
    ) -> Float[Array, "groups weights"]:
        """A batch's move at a rate of one: the mean over patterns."""
        change = rule.change(network, weights, self.signals, self.targets, self.counts, learning)
        return change / self.patterns

    def totals(
        self, network: AdaptiveNetwork, weights: Float[Array, " weights"]
    ) -> Float[Array, "outputs patterns"]:
        """The sums at the output nodes."""
        if self.condensed is None:
            return network.forward(weights, self.signals).total
        return jnp.stack(
            [
                weights[np.array(support, int)] @ rows
                for support, rows in zip(reach(network), self.condensed, strict=True)
            ]
        )

    def errors(
        self, network: AdaptiveNetwork, weights: Float[Array, " weights"]
    ) -> Float[Array, "outputs patterns"]:
        """Target less output (Eqn. 6.1-1), zero where it does not count."""
        return (self.targets - network.activation.value(self.totals(network, weights))) * (
            self.counts
        )


def examples(
    network: AdaptiveNetwork,
    patterns: Any,
    targets: Float[Array | np.ndarray, "patterns outputs"],
    counts: Bool[Array | np.ndarray, "patterns outputs"] | None = None,
) -> Examples:
    """Patterns and targets as training takes them.

    **Arguments**

    - `network`: o outputs.
    - `patterns`: whatever the network's preprocessing takes: (patterns, inputs), or motion.
    - `targets`: (patterns, o), within the range of the network's activation.
    - `counts`: (patterns, o), False for pairs of pattern and output to leave out (5.2.4, 7.5);
      all count if omitted.

    **Raises** `ValueError`, unless under `jit` or `vmap`, if targets are not of that shape or
    not finite, lie outside what the activation can answer, or if no pair that counts reaches
    one of the weights.

    >>> import numpy as np
    >>> from jaxcslc.adaptive import fully_connected
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
    if counts is not None and jnp.shape(counts) != wanted.shape:
        raise ValueError(f"counts: expected shape {wanted.shape}, got {jnp.shape(counts)}")
    dtype = jnp.result_type(float, signals.inputs[0])
    taking_part = jnp.ones(wanted.shape, dtype) if counts is None else jnp.asarray(counts, dtype)
    wanted = jnp.where(taking_part.T > 0, wanted.T.astype(dtype), 0.0)
    chosen = Examples(signals, wanted, taking_part.T, None)
    _check(network, chosen, named=jnp.asarray(targets))
    with_contexts = any(subnetwork.contexts for subnetwork in network.subnetworks)
    if network.linear and with_contexts:
        chosen = eqx.tree_at(
            lambda e: e.condensed, chosen, _condensed(network, signals), is_leaf=_is_none
        )
    return chosen


def _is_none(x: object) -> bool:
    return x is None


@eqx.filter_jit
def _condensed(network: AdaptiveNetwork, signals: Signals) -> tuple[Array, ...]:
    """Sensitivities of every output: the answers to one weight at a time."""
    each = jax.lax.map(
        lambda unit: network.forward(unit, signals).total,
        jnp.eye(network.size, dtype=signals.inputs[0].dtype),
    )
    return tuple(
        each[np.array(support, int), output] for output, support in enumerate(reach(network))
    )


def _check(network: AdaptiveNetwork, chosen: Examples, named: Array) -> None:
    if any(isinstance(leaf, Tracer) for leaf in jax.tree.leaves(chosen)):
        return  # values are not known under a transformation
    counted = np.asarray(chosen.counts).T > 0
    finite = np.isfinite(np.asarray(named)) | ~counted
    if not finite.all():
        pattern, output = np.argwhere(~finite)[0]
        raise ValueError(
            f"targets: output {output + 1} of pattern {pattern + 1} is"
            f" {np.asarray(named)[pattern, output]}, expected a finite number or a mask"
        )
    for part, *seen in zip(
        network.subnetworks, chosen.signals.inputs, chosen.signals.contexts, strict=True
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
    missing = np.flatnonzero(~np.asarray(covered(network, chosen.signals, chosen.counts)))
    if len(missing):
        names = ", ".join(network.names[index] for index in missing[:5])
        more = f" and {len(missing) - 5} more" if len(missing) > 5 else ""
        raise ValueError(
            f"masks leave no data for {names}{more}: of every pattern that could tell, the"
            " output is masked or the input zero"
        )
