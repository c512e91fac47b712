from collections.abc import Sequence

import numpy as np
from jaxtyping import Float

from ..network import CSLC
from ..network.terms import FrictionTerm
from ._expressions import Expressions, Motion, Value


def friction_entries(network: CSLC, motion: Motion) -> list[tuple[int, int, Value]]:
    """The regressor's entries beside the rigid body's: joint, coefficient, value.

    Everything that the network adds to it: friction, offsets, springs, coupled joints.
    """
    graph, q, qd, qdd = motion.graph, motion.q, motion.qd, motion.qdd
    slopes = network.static_slopes
    held = [1.0] * network.joint_count if slopes is None else np.asarray(slopes, float).tolist()
    entries: list[tuple[int, int, Value]] = []
    start = len(network.algebra.coefficients)
    for term in network.terms:
        if term.pairs:
            inputs = [
                x for pair in range(len(term.pairs)) for x in _coupled(term, pair, qd, qdd, graph)
            ]
        else:
            inputs = [_own(term, j, held[j], q, qd, graph) for j in term.joints]
        for joint, place, value in zip(term.joints, term.places, inputs, strict=True):
            entries.append((joint, start + place, value))
        start += term.size
    return entries


def _own(
    term: FrictionTerm,
    j: int,
    slope: float,
    q: Sequence[Value],
    qd: Sequence[Value],
    graph: Expressions,
) -> Value:
    rate = qd[j]
    match term.word:
        case "viscous" | "asymmetric_viscous":
            value = rate
        case "dry" | "asymmetric_dry":
            value = graph.apply("sign", rate)
        case "static":
            decay = graph.apply("exp", -(graph.apply("fabs", rate) * slope))
            value = graph.apply("sign", rate) * decay
        case "root":
            speed = graph.apply("sqrt", graph.apply("fabs", rate))
            value = graph.apply("sign", rate) * speed
        case "spring":
            value = q[j]
        case "offset":
            value = graph.constant(1.0)
        case _:
            raise ValueError(f"friction term {term.word!r} has no C code")
    if not term.part:
        return value
    return graph.apply("positive" if term.part == "+" else "negative", value)


def _coupled(
    term: FrictionTerm, pair: int, qd: Sequence[Value], qdd: Sequence[Value], graph: Expressions
) -> tuple[Value, Value]:
    """As the network's: what a shaft that two joints turn adds to either."""
    first, second = term.pairs[pair].first - 1, term.pairs[pair].second - 1
    ratio = float(term.pairs[pair].ratio)
    if term.word == "coupled_dry":
        sign = graph.apply("sign", qd[first] + qd[second] * ratio)
        return sign, sign * ratio
    if term.word not in ("coupled_inertia", "coupled_viscous"):
        raise ValueError(f"friction term {term.word!r} has no C code")
    motion = qdd if term.word == "coupled_inertia" else qd
    return motion[second] * ratio, motion[first] * ratio


def coupled_inertias(
    network: CSLC, k: Float[np.ndarray, " coefficients"]
) -> list[tuple[int, int, float]]:
    """What coupled joints add to the mass matrix above its diagonal: row, column, value."""
    found: list[tuple[int, int, float]] = []
    start = len(network.algebra.coefficients)
    for term in network.terms:
        if term.word == "coupled_inertia":
            for place, pair in enumerate(term.pairs):
                i, j = sorted((pair.first - 1, pair.second - 1))
                found.append((i, j, float(pair.ratio) * float(k[start + place])))
        start += term.size
    return found
