"""The PUMA 560's CSLC link by link (thesis, Chapter 5), from Appendix B as data, in NumPy alone.

Nothing of `jaxcslc` is used. Loops run over links; a link's values of all patterns are one array.
Names are the thesis's: `x` inputs, `W` weights, `S` their sums, `t` targets, `y` outputs. A is the
adaptive layer and B the context-sensitive one behind it. `training.py` trains this network.
"""

from collections.abc import Sequence
from typing import Any, NamedTuple

import numpy as np
from jaxtyping import Bool, Float


JOINTS = 6
Values = Float[np.ndarray, "units patterns"]
Motion = Float[np.ndarray, "patterns joints"]


class Link(NamedTuple):
    """An adaptive link, whose weight W is `multiple` times coefficient number `k` (5.1.1).

    The link of a Christoffel symbol that weighs 'a pair' of coefficients (5.1.2, Eqn. 5.1-3) is
    two links here, one for each.
    """

    source: int
    node: int
    k: int
    multiple: float = 1.0


class ContextLink(NamedTuple):
    """A link whose weight is a system input of the pattern: number `context` of six (3.3.5)."""

    source: int
    node: int
    context: int


class ContextLayer(NamedTuple):
    """The nodes of a context-sensitive layer, and the links to them."""

    nodes: int
    links: tuple[ContextLink, ...]


class Subnetwork(NamedTuple):
    """An adaptive layer of linear combiners, then context layers (Figs. 5.1-1 to 5.1-5)."""

    name: str
    nodes: int
    links: tuple[Link, ...]
    contexts: tuple[ContextLayer, ...] = ()


class Signals(NamedTuple):
    """Preprocessed inputs of a subnetwork, and the weights of its context layers."""

    x: Values
    contexts: tuple[Values, ...] = ()


def appendix_names() -> tuple[str, ...]:
    """Return the names of the 43 coefficients in the order of the vector k."""
    sizes = {"kM": 26, "kG": 5, "kv": JOINTS, "kd": JOINTS}
    return tuple(f"{name}{i + 1}" for name, size in sizes.items() for i in range(size))


def appendix_network(appendix: dict[str, Any], names: Sequence[str]) -> tuple[Subnetwork, ...]:
    """Return mass, velocity, gravity, viscous and dry subnetworks with the links as printed.

    **Arguments**

    - `appendix`: Appendix B as data, indices from one (`tests/data/appendix_b.json`).
    - `names`: of coefficients, in the order of k.
    """
    index_of = {name: index for index, name in enumerate(names)}

    def links(table: str, node: str) -> tuple[Link, ...]:
        return tuple(
            Link(link["input"] - 1, link[node] - 1, index_of[name], float(multiple))
            for link in appendix[table]
            for name, multiple in link["weight"].items()
        )

    def diagonal(prefix: str) -> tuple[Link, ...]:
        return tuple(Link(i, i, index_of[f"{prefix}{i + 1}"]) for i in range(JOINTS))

    # A node M_ij leads to joints i and j, weighted by the acceleration of the other index.
    elements = [[i - 1 for i in joints] for joints in appendix["mass_columns"].values()]
    to_torque: list[ContextLink] = []
    for node, (i, j) in enumerate(elements):
        to_torque.append(ContextLink(node, i, j))
        if i != j:
            to_torque.append(ContextLink(node, j, i))
    # Eqn. 5.1-5: a node c_ijk leads to C_ij and C_ik, weighted by a velocity; Eqn. 5.1-6: C_ij
    # leads to joint i.
    symbols = [[i - 1 for i in joints] for joints in appendix["velocity_columns"].values()]
    to_matrix: list[ContextLink] = []
    for node, (i, j, k) in enumerate(symbols):
        to_matrix.append(ContextLink(node, JOINTS * i + j, k))
        if j != k:
            to_matrix.append(ContextLink(node, JOINTS * i + k, j))
    from_matrix = [ContextLink(JOINTS * i + j, i, j) for i in range(JOINTS) for j in range(JOINTS)]
    return (
        Subnetwork(
            "mass",
            len(elements),
            links("mass_links", "column"),
            (ContextLayer(JOINTS, tuple(to_torque)),),
        ),
        Subnetwork(
            "velocity",
            len(symbols),
            links("velocity_links", "column"),
            (ContextLayer(JOINTS**2, tuple(to_matrix)), ContextLayer(JOINTS, tuple(from_matrix))),
        ),
        Subnetwork("gravity", JOINTS, links("gravity_links", "joint")),
        Subnetwork("viscous", JOINTS, diagonal("kv")),
        Subnetwork("dry", JOINTS, diagonal("kd")),
    )


def appendix_inputs(appendix: dict[str, Any], table: str, q: Motion) -> Values:
    """Return the products of sines and cosines that Appendix B lists, one row per product."""
    angles = {"2": q[:, 1], "23": q[:, 1] + q[:, 2], "4": q[:, 3], "5": q[:, 4]}
    rows: list[np.ndarray] = []
    for number in sorted(appendix[table], key=int):
        value = np.ones(len(q))
        for factor, power in appendix[table][number].items():
            function = np.cos if factor[0] == "c" else np.sin
            value = value * function(angles[factor[1:]]) ** power
        rows.append(value)
    return np.stack(rows)


def appendix_signals(
    appendix: dict[str, Any], q: Motion, qd: Motion, qdd: Motion
) -> tuple[Signals, ...]:
    """Return what enters each subnetwork of `appendix_network`, in its order [rad, rad/s, ...]."""
    mass, velocity, gravity = (
        appendix_inputs(appendix, f"{name}_inputs", q) for name in ("mass", "velocity", "gravity")
    )
    speeds, accelerations = np.ascontiguousarray(qd.T), np.ascontiguousarray(qdd.T)
    return (
        Signals(mass, (accelerations,)),
        Signals(velocity, (speeds, speeds)),
        Signals(gravity),
        Signals(speeds),
        Signals(np.sign(speeds)),
    )


def forward(
    part: Subnetwork, signals: Signals, k: Float[np.ndarray, " coefficients"]
) -> list[Values]:
    """Return the outputs of every layer, the adaptive one first, for every pattern."""
    sums = np.zeros((part.nodes, signals.x.shape[1]))
    for link in part.links:
        sums[link.node] += (link.multiple * k[link.k]) * signals.x[link.source]
    values = [sums]
    for layer, context in zip(part.contexts, signals.contexts, strict=True):
        sums = np.zeros((layer.nodes, context.shape[1]))
        for link in layer.links:
            sums[link.node] += context[link.context] * values[-1][link.source]
        values.append(sums)
    return values


def outputs(
    parts: Sequence[Subnetwork],
    signals: Sequence[Signals],
    k: Float[np.ndarray, " coefficients"],
) -> Values:
    """Return the torques y, the sums over the superimposed output nodes (5.1.5) [N m]."""
    y = np.zeros((JOINTS, signals[0].x.shape[1]))
    for part, entering in zip(parts, signals, strict=True):
        if np.any(k[[link.k for link in part.links]]):  # otherwise its torques are zero
            y += forward(part, entering, k)[-1]
    return y


def possible_backlash(
    qd: Motion, qdd: Motion, torque: Motion
) -> Bool[np.ndarray, "patterns joints"]:
    """Return where torque, velocity and acceleration have the same sign (2.5-7).

    A zero, whose true sign is not known, agrees with any sign, as the docstring of
    `jaxcslc.recordings.possible_backlash` promises. To the letter, Eqn. 2.5-7 is false there.
    """
    signs = np.sign([torque, qd, qdd])
    return ~(np.any(signs > 0, axis=0) & np.any(signs < 0, axis=0))


def slow(qd: Motion, fraction: float = 0.01) -> Bool[np.ndarray, "patterns joints"]:
    """Return where a joint is no faster than a hundredth of its greatest speed (7.5)."""
    return np.abs(qd) <= fraction * np.max(np.abs(qd), axis=0)


def counted(
    parts: Sequence[Subnetwork],
    backlash: Bool[np.ndarray, "patterns joints"],
    slow_pairs: Bool[np.ndarray, "patterns joints"],
    *,
    friction_only: bool,
) -> Float[np.ndarray, "subnetworks outputs patterns"]:
    """Return one where a pair of pattern and joint takes part in a subnetwork's training.

    **Arguments**

    - `backlash`: pairs that no subnetwork learns from (7.2.4).
    - `slow_pairs`: pairs that the viscous and dry subnetworks do not learn from (7.2.2).
    - `friction_only`: otherwise no subnetwork learns from slow pairs.
    """
    rows: list[np.ndarray] = []
    for part in parts:
        left_out = backlash
        if not friction_only or part.name in ("viscous", "dry"):
            left_out = backlash | slow_pairs
        rows.append(~left_out.T)
    return np.stack(rows).astype(float)
