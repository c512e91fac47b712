"""Patterns of the generalisation study: stop sets, inputs of networks, ranges."""

from collections.abc import Sequence
from typing import Any

import jax.numpy as jnp
import numpy as np
from jaxtyping import Bool

import jaxcslc as jc
from scripts.studies.generalisation.networks import Data, Part, stacked


STRETCHES, GROUP = 20, 5  # one of every five stretches is in the stop set


def stop_set(samples: int, seed: int) -> Bool[np.ndarray, " samples"]:
    """One stretch of time drawn from each group of five; as many patterns for every seed."""
    rng = np.random.default_rng(seed)
    length = samples // STRETCHES
    stopping = np.zeros(samples, dtype=bool)
    for first in range(0, STRETCHES, GROUP):
        start = (first + int(rng.integers(GROUP))) * length
        stopping[start : start + length] = True
    return stopping


def inputs_of(patterns: jc.Patterns, trigonometric: bool) -> np.ndarray:
    """The inputs of a network, (samples, 18), or (samples, 24) with sines and cosines."""
    q = np.asarray(patterns.q)
    positions = [np.sin(q), np.cos(q)] if trigonometric else [q]
    return np.concatenate([*positions, patterns.qd, patterns.qdd], axis=1)


def in_range(
    judged: jc.Patterns, patterns: jc.Patterns, used: Bool[np.ndarray, " samples"]
) -> Bool[np.ndarray, " judged"]:
    """Which judged patterns have every input within the range of the used patterns' inputs."""
    inside, x = inputs_of(patterns, False)[used], inputs_of(judged, False)
    return np.all((x >= inside.min(axis=0)) & (x <= inside.max(axis=0)), axis=1)


def data_of(
    training: Sequence[jc.Patterns],
    stop: Sequence[np.ndarray],
    comparison: Sequence[jc.Patterns],
    trigonometric: bool,
) -> Data:
    """Return everything in float32, as networks are usually trained."""

    def part(x: np.ndarray, torque: Any, mask: np.ndarray) -> Part:
        return Part(jnp.asarray(x, "float32"), jnp.asarray(torque, "float32"), jnp.asarray(mask))

    rows: list[Data] = []
    for patterns, stopping, judged in zip(training, stop, comparison, strict=True):
        used = ~stopping
        x, x_judged = (inputs_of(p, trigonometric) for p in (patterns, judged))
        torque, mask = np.asarray(patterns.torque), np.asarray(patterns.mask)
        middle, spread = x[used].mean(axis=0), x[used].std(axis=0)
        x, x_judged = (x - middle) / spread, (x_judged - middle) / spread
        mask_judged = np.asarray(judged.mask)
        inside = in_range(judged, patterns, used)[:, None]
        targets = np.where(mask & used[:, None], torque, np.nan)
        rows.append(
            Data(
                training=part(x[used], torque[used], mask[used]),
                stop=part(x[stopping], torque[stopping], mask[stopping]),
                comparison=part(x_judged, judged.torque, mask_judged),
                in_range=part(x_judged, judged.torque, mask_judged & inside),
                mean=jnp.asarray(np.nanmean(targets, axis=0), "float32"),
                scale=jnp.asarray(np.nanstd(targets, axis=0), "float32"),
            )
        )
    return stacked(rows)
