"""Sigmoidal and radial basis networks, and their training, all seeds at once.

In Equinox and Optax; `study.py` describes the methods.
"""

import argparse
import functools
from collections.abc import Callable, Sequence
from typing import Any

import equinox as eqx
import jax
import jax.numpy as jnp
import numpy as np
import optax
from jax.flatten_util import ravel_pytree
from jaxtyping import Array, Bool, Float

from scripts.studies.generalisation.pruning import LinkEnds, prune


CHUNKS = 20  # of a training, for the progress bar
PARTS = ("training", "stop", "comparison", "in_range")


class Sigmoidal(eqx.Module):
    """Hyperbolic-tangent hidden layers and linear outputs."""

    layers: tuple[eqx.nn.Linear, ...]

    def __init__(self, sizes: Sequence[int], key: Array) -> None:
        keys = jax.random.split(key, len(sizes) - 1)
        self.layers = tuple(
            eqx.nn.Linear(sizes[i], sizes[i + 1], key=keys[i], dtype=jnp.float32)
            for i in range(len(keys))
        )

    def __call__(self, x: Float[Array, " inputs"]) -> Float[Array, " outputs"]:
        for layer in self.layers[:-1]:
            x = jnp.tanh(layer(x))
        return self.layers[-1](x)

    def link_ends(self) -> LinkEnds:
        """Return the ends of the links of `ravel_pytree`'s weights, layer by layer: matrix, then
        biases.
        """
        source: list[np.ndarray] = []
        target: list[np.ndarray] = []
        first = 1  # node 0 is the constant
        for layer in self.layers:
            shape = layer.weight.shape[-2:]  # several seeds' are stacked
            outputs = first + shape[1] + np.arange(shape[0])
            inputs = np.broadcast_to(first + np.arange(shape[1]), shape)
            source += [inputs.ravel(), np.zeros(shape[0], dtype=int)]
            target += [np.broadcast_to(outputs[:, None], shape).ravel(), outputs]
            first += shape[1]
        return LinkEnds(np.concatenate(source), np.concatenate(target))


class Radial(eqx.Module):
    """Gaussian radial basis functions and linear outputs."""

    centres: Float[Array, "hidden inputs"]
    log_widths: Float[Array, " hidden"]
    output: Float[Array, "outputs hidden"]
    bias: Float[Array, " outputs"]

    def __call__(self, x: Float[Array, " inputs"]) -> Float[Array, " outputs"]:
        # Not as differences: a batch of them would fill the cache many times over.
        square = jnp.sum(x**2) - 2.0 * self.centres @ x + jnp.sum(self.centres**2, axis=1)
        return self.output @ jnp.exp(-0.5 * square * jnp.exp(-2.0 * self.log_widths)) + self.bias


class Part(eqx.Module):
    """Some patterns: standardised inputs, torques [N m], mask of pairs of pattern and joint."""

    x: Float[Array, "*seeds samples inputs"]
    torque: Float[Array, "*seeds samples joints"]
    mask: Bool[Array, "*seeds samples joints"]


class Data(eqx.Module):
    """Patterns of every seed; all arrays have a leading axis of seeds."""

    training: Part
    stop: Part
    comparison: Part
    in_range: Part
    mean: Float[Array, "*seeds joints"]
    scale: Float[Array, "*seeds joints"]

    def torque_of(self, network: Any, x: Array) -> Array:
        """A network's outputs in N m, of one seed."""
        return self.mean[None] + self.scale[None] * jax.vmap(network)(x)


@jax.jit
def epsilon(error: Array, mask: Array) -> Array:
    """ε of one seed [N m] (7.5), as `jaxcslc.compare` has it; NaN of no patterns."""
    of_pattern = jnp.sum(mask, axis=1)
    square = jnp.sum(jnp.where(mask, error, 0.0) ** 2, axis=1) / jnp.maximum(of_pattern, 1)
    return 0.5 * jnp.sum(jnp.sqrt(square)) / jnp.sum(of_pattern > 0)


def loss(network: Any, x: Array, target: Array, mask: Array) -> Array:
    """Mean square of standardised errors over the pairs of a mask."""
    error = jnp.where(mask, jax.vmap(network)(x) - target, 0.0)
    return jnp.sum(error**2) / jnp.sum(mask)


def start_radial(data: Data, hidden: int, key: Array) -> Radial:
    """Centres by k-means; outputs by ridge regression; width and ridge by the stop set."""
    x = data.training.x
    centres = jax.random.choice(key, x, (hidden,), replace=False)

    def square(a: Array, b: Array) -> Array:
        return jnp.sum(a**2, 1)[:, None] - 2.0 * a @ b.T + jnp.sum(b**2, 1)[None]

    def lloyd(centres: Array, _: Any) -> tuple[Array, None]:
        nearest = jax.nn.one_hot(jnp.argmin(square(x, centres), axis=1), hidden, dtype=x.dtype)
        many = jnp.sum(nearest, axis=0)[:, None]
        return jnp.where(many > 0, nearest.T @ x / jnp.maximum(many, 1), centres), None

    centres, _ = jax.lax.scan(lloyd, centres, None, length=20)
    apart = square(centres, centres) + jnp.where(jnp.eye(hidden) > 0, jnp.inf, 0.0).astype(x.dtype)
    nearest = 0.5 * jnp.log(jnp.maximum(jnp.min(apart, axis=1), 1e-3))
    target = (data.training.torque - data.mean[None]) / data.scale[None]

    def solved(log_overlap: Array, ridge: Array) -> tuple[Radial, Array]:
        empty = jnp.zeros((target.shape[1], hidden), x.dtype)
        network = Radial(centres, nearest + log_overlap, empty, empty[:, 0])
        basis = eqx.tree_at(
            lambda n: (n.output, n.bias), network, (jnp.eye(hidden), jnp.zeros(hidden))
        )
        columns = jax.vmap(basis)(x).astype(float)
        columns = jnp.concatenate([columns, jnp.ones((len(x), 1))], axis=1)

        def one(t: Array, mask: Array) -> Array:
            rows = jnp.where(mask[:, None], columns, 0.0)
            penalty = ridge * jnp.sum(mask) * jnp.eye(hidden + 1).at[-1, -1].set(1e-12)
            return jnp.linalg.solve(rows.T @ rows + penalty, rows.T @ t)

        weights = jax.vmap(one, in_axes=1)(target.astype(float), data.training.mask)
        output = (weights[:, :-1].astype(x.dtype), weights[:, -1].astype(x.dtype))
        network = eqx.tree_at(lambda n: (n.output, n.bias), network, output)
        error = data.stop.torque - data.torque_of(network, data.stop.x)
        return network, epsilon(error, data.stop.mask)

    overlaps, ridges = jnp.meshgrid(
        jnp.log(jnp.array([1.0, 2.0, 4.0, 8.0], x.dtype)), jnp.array([1e-9, 1e-7, 1e-5, 1e-3])
    )
    tried, error = jax.lax.map(lambda pair: solved(*pair), (overlaps.ravel(), ridges.ravel()))
    return jax.tree.map(lambda leaves: leaves[jnp.argmin(error)], tried)


class Progress(eqx.Module):
    """The state of one seed's training."""

    network: Any
    optimiser: Any
    best: Any
    least: Array


@functools.cache  # a new one would make `epochs` compile again
def optimiser_of(rate: float, steps: int) -> optax.GradientTransformation:
    return optax.adam(optax.cosine_decay_schedule(rate, steps))


@eqx.filter_jit
def epochs(
    progress: Progress,
    data: Data,
    mask: Any,
    keys: Array,
    optimiser: optax.GradientTransformation,
    batch: int,
) -> Progress:
    """Some epochs of all seeds; `keys` are (seeds, epochs)."""

    def of_one(progress: Progress, data: Data, mask: Any, keys: Array) -> Progress:
        part = data.training
        target = (part.torque - data.mean[None]) / data.scale[None]
        batches = len(part.x) // batch

        def step(carry: Any, batch_rows: Array) -> tuple[Any, None]:
            network, state = carry
            slope = eqx.filter_grad(loss)(
                network, part.x[batch_rows], target[batch_rows], part.mask[batch_rows]
            )
            slope = jax.tree.map(jnp.multiply, slope, mask)
            change, state = optimiser.update(slope, state)
            return (optax.apply_updates(network, change), state), None

        def epoch(now: Progress, key: Array) -> tuple[Progress, None]:
            order = jax.random.permutation(key, len(part.x))[: batches * batch]
            (network, state), _ = jax.lax.scan(
                step, (now.network, now.optimiser), order.reshape(batches, batch)
            )
            error = data.stop.torque - data.torque_of(network, data.stop.x)
            stop_error = epsilon(error, data.stop.mask)
            better = stop_error < now.least
            best = jax.tree.map(lambda a, b: jnp.where(better, a, b), network, now.best)
            return Progress(network, state, best, jnp.minimum(stop_error, now.least)), None

        return jax.lax.scan(epoch, progress, keys)[0]

    return eqx.filter_vmap(of_one)(progress, data, mask, keys)


def trained(
    network: Any, data: Data, mask: Any, options: argparse.Namespace, rate: float, bar: Any
) -> tuple[Any, Any]:
    """The networks of all seeds at their least stop-set error, and after the last epoch."""
    seeds, samples = data.training.x.shape[:2]
    batch = min(options.batch, samples)
    optimiser = optimiser_of(rate, options.epochs * (samples // batch))
    least = errors(network, data)["stop"]
    now = Progress(network, eqx.filter_vmap(optimiser.init)(network), network, least)
    keys = jax.random.split(jax.random.key(1), (seeds, options.epochs))
    chunk = max(options.epochs // CHUNKS, 1)
    for first in range(0, options.epochs, chunk):
        part = keys[:, first : first + chunk]
        now = jax.block_until_ready(epochs(now, data, mask, part, optimiser, batch))
        bar.update(part.shape[1])
    return now.best, now.network


@eqx.filter_jit
def errors(network: Any, data: Data) -> dict[str, Array]:
    """ε of every seed on its three parts [N m]."""

    def of_one(network: Any, data: Data) -> dict[str, Array]:
        parts = {name: getattr(data, name) for name in PARTS}
        return {
            name: epsilon(part.torque - data.torque_of(network, part.x), part.mask)
            for name, part in parts.items()
        }

    return eqx.filter_vmap(of_one)(network, data)


@functools.cache
def cost_of(sizes: tuple[int, ...]) -> Callable[..., Array]:
    """A sigmoidal network's training-set error by its flat weights; one function for one shape."""
    _, unravel = ravel_pytree(Sigmoidal(sizes, jax.random.key(0)))
    return lambda weights, x, target, mask: loss(unravel(weights), x, target, mask)


def of_seed(tree: Any, seed: int) -> Any:
    """One seed's part of what is stacked; in NumPy, since JAX compiles for each shape it slices."""
    return jax.tree.map(lambda leaves: np.asarray(leaves)[seed], tree)


def stacked(trees: Sequence[Any]) -> Any:
    """The seeds' parts as one, with a leading axis of seeds."""
    return jax.tree.map(lambda *leaves: jnp.asarray(np.stack(leaves)), *trees)


def flat(tree: Any, seed: int) -> np.ndarray:
    """One seed's weights, (p,)."""
    return np.asarray(ravel_pytree(of_seed(tree, seed))[0])


def pruned(
    network: Sigmoidal, data: Data, sizes: tuple[int, ...], tolerance: float
) -> tuple[Any, Any]:
    """Return each seed's network pruned: its weights, and which of them are kept (as 0 and 1).

    What an earlier round removed goes again at once: without it the cost is the same.
    """
    ends = network.link_ends()
    _, unravel = ravel_pytree(of_seed(network, 0))
    weights: list[Any] = []
    masks: list[Any] = []
    for seed in range(len(data.mean)):
        one = of_seed(data, seed)
        target = (one.training.torque - one.mean[None]) / one.scale[None]
        result = prune(
            cost_of(sizes),
            flat(network, seed),
            ends,
            tolerance=tolerance,
            args=(one.training.x, target, one.training.mask),
        )
        weights.append(unravel(jnp.asarray(result.weights.astype(np.float32))))
        masks.append(unravel(jnp.asarray(result.kept.astype(np.float32))))
    return stacked(weights), stacked(masks)


def order_of(ends: LinkEnds, kept: Bool[np.ndarray, " weights"]) -> int:
    """The highest product of links to each node along any route (4.2); links in order of layers."""
    order: dict[int, int] = {}
    source, target = ends.source[kept], ends.target[kept]
    for node in dict.fromkeys(target.tolist()):
        feeding = source[target == node].tolist()
        order[node] = len(feeding) * max(order.get(before, 1) for before in feeding)
    return max(order.values(), default=0)
