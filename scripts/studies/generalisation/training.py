"""Networks of the generalisation study, and the row of each over all seeds."""

import argparse
import dataclasses
from collections.abc import Sequence
from typing import Any

import equinox as eqx
import jax
import jax.numpy as jnp
import numpy as np

import jaxcslc as jc
from scripts.studies.generalisation.networks import (
    PARTS,
    Data,
    Sigmoidal,
    epsilon,
    errors,
    flat,
    order_of,
    pruned,
    start_radial,
    trained,
)
from scripts.studies.generalisation.patterns import in_range
from scripts.studies.generalisation.results import CSLC, MEAN, row_of


@dataclasses.dataclass(frozen=True)
class Kind:
    """A network to be trained."""

    family: str
    hidden: tuple[int, ...]
    trigonometric: bool = False
    pruned: bool = False

    @property
    def name(self) -> str:
        return f"{self.family} {'-'.join(str(h) for h in self.hidden)}"


TANH, RBF, SIN_COS = "tanh", "radial basis", "sin cos"
STANDARD = (
    *(Kind(TANH, (h,)) for h in (4, 8, 16, 32, 64)),
    *(Kind(f"{TANH} two layers", (h, h)) for h in (8, 16, 32)),
    Kind(f"{TANH} pruned", (32,), pruned=True),
    *(Kind(f"{TANH} {SIN_COS}", (h,), trigonometric=True) for h in (16, 64)),
    *(Kind(RBF, (h,)) for h in (16, 64, 256)),
    *(Kind(f"{RBF} {SIN_COS}", (h,), trigonometric=True) for h in (16, 64)),
)
# Trained only if their names are among the options.
MORE = (
    *(Kind(TANH, (h,)) for h in (2, 128)),
    Kind(f"{TANH} two layers", (64, 64)),
    *(Kind(f"{TANH} pruned", (h,), pruned=True) for h in (16, 64)),
    Kind(f"{TANH} pruned {SIN_COS}", (32,), trigonometric=True, pruned=True),
    Kind(f"{RBF} {SIN_COS}", (256,), trigonometric=True),
)
QUICK = (
    Kind(TANH, (4,)),
    Kind(f"{TANH} pruned", (4,), pruned=True),
    Kind(f"{RBF} {SIN_COS}", (8,), trigonometric=True),
)


def train(kind: Kind, data: Data, options: argparse.Namespace, bar: Any) -> dict[str, Any]:
    """The row of one network, all seeds."""
    seeds, _, inputs = data.training.x.shape
    keys = jax.random.split(jax.random.key(0), seeds)
    sizes = (inputs, *kind.hidden, data.mean.shape[1])
    order: list[int | None] = [None] * seeds
    if kind.family.startswith(RBF):
        start = eqx.filter_jit(eqx.filter_vmap(lambda d, k: start_radial(d, kind.hidden[0], k)))
        network = start(data, keys)
        rate = 3e-3
    else:
        start = eqx.filter_jit(eqx.filter_vmap(lambda key: Sigmoidal(sizes, key)))
        network = start(keys)
        rate = 1e-2 if len(kind.hidden) == 1 else 5e-3
    kept = jax.tree.map(jnp.ones_like, network)
    best, last = trained(network, data, kept, options, rate, bar)
    for _ in range(options.rounds if kind.pruned else 0):
        network, kept = pruned(best, data, sizes, options.tolerance)
        best, last = trained(network, data, kept, options, rate, bar)
    masks = [flat(kept, seed) > 0 for seed in range(seeds)]
    if isinstance(best, Sigmoidal):
        order = [order_of(best.link_ends(), mask) for mask in masks]
    stopped, last_of_all = (
        {name: np.asarray(values).tolist() for name, values in errors(network, data).items()}
        for network in (best, last)
    )
    weights = [int(mask.sum()) for mask in masks]
    return row_of(kind.name, kind.family, inputs, weights, order, stopped, last_of_all)


def fitted(
    network: jc.CSLC,
    settings: jc.Settings,
    training: Sequence[jc.Patterns],
    stop: Sequence[np.ndarray],
    comparison: Sequence[jc.Patterns],
) -> dict[str, Any]:
    """The CSLC's row, fitted to the patterns that the networks are trained on."""
    epsilons: dict[str, list[float]] = {name: [] for name in PARTS}
    for patterns, stopping, judged in zip(training, stop, comparison, strict=True):
        used = dataclasses.replace(
            patterns, backlash_mask=patterns.backlash_mask & ~stopping[:, None]
        )
        k = settings.fit(network, used).k
        on_training = jc.report.torque_errors(network, patterns, k)
        on_comparison = jc.report.torque_errors(network, judged, k)
        mask, mask_judged = np.asarray(patterns.mask), np.asarray(judged.mask)
        inside = in_range(judged, patterns, ~stopping)[:, None]
        cases = (
            (on_training, mask & ~stopping[:, None]),
            (on_training, mask & stopping[:, None]),
            (on_comparison, mask_judged),
            (on_comparison, mask_judged & inside),
        )
        for name, (error, pairs) in zip(PARTS, cases, strict=True):
            epsilons[name].append(float(epsilon(error, jnp.asarray(pairs))))
    seeds, n = len(training), network.joint_count
    size, order = len(network.coefficients), network.order
    return row_of(CSLC, CSLC, 3 * n, [size] * seeds, [order] * seeds, epsilons, epsilons)


def constant(data: Data) -> dict[str, Any]:
    """The row without a network: each joint's mean torque of the training patterns."""
    epsilons = {
        name: [
            float(epsilon(part.torque[seed] - mean[None], part.mask[seed]))
            for seed, mean in enumerate(data.mean)
        ]
        for name in PARTS
        for part in [getattr(data, name)]
    }
    seeds, joints = data.mean.shape
    return row_of(MEAN, MEAN, 0, [joints] * seeds, [None] * seeds, epsilons, epsilons)
