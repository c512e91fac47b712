"""Backpropagation and PERAL on the PUMA 560's network, whose links Appendix B prints."""

from collections.abc import Sequence
from typing import Any

import numpy as np
import pytest
from numpy.testing import assert_allclose

from jaxcslc import CSLC
from jaxcslc.adaptive import (
    inverse_dynamics,
)
from jaxcslc.training import PERAL, Backpropagation, examples
from jaxcslc.training._rules import AbstractRule

from . import _transcription as thesis
from ._problems import Problem, change


def appendix_network(appendix_b: dict[str, Any], names: Sequence[str]) -> list[thesis.Subnetwork]:
    """Figs. 5.1-1 to 5.1-6 with the links that Appendix B prints."""
    index_of = {name: index for index, name in enumerate(names)}
    columns = {
        table: {int(at): [i - 1 for i in joints] for at, joints in appendix_b[table].items()}
        for table in ("mass_columns", "velocity_columns")
    }

    def links(table: str, node: str) -> list[thesis.Link]:
        return [
            thesis.Link(link["input"] - 1, link[node] - 1, index_of[name], multiple)
            for link in appendix_b[table]
            for name, multiple in link["weight"].items()
        ]

    mass_context: list[thesis.ContextLink] = []
    for at, (i, j) in columns["mass_columns"].items():
        mass_context.append(thesis.ContextLink(at - 1, i, j))
        if i != j:
            mass_context.append(thesis.ContextLink(at - 1, j, i))
    inner: list[thesis.ContextLink] = []
    for at, (i, j, k) in columns["velocity_columns"].items():
        inner.append(thesis.ContextLink(at - 1, 6 * i + j, k))
        if j != k:
            inner.append(thesis.ContextLink(at - 1, 6 * i + k, j))
    outer = [thesis.ContextLink(6 * i + j, i, j) for i in range(6) for j in range(6)]

    def diagonal(prefix: str) -> list[thesis.Link]:
        return [thesis.Link(i, i, index_of[f"{prefix}{i + 1}"]) for i in range(6)]

    identity = thesis.IDENTITY
    return [
        thesis.Subnetwork([(21, links("mass_links", "column"), identity)], [(6, mass_context)]),
        thesis.Subnetwork(
            [(105, links("velocity_links", "column"), identity)], [(36, inner), (6, outer)]
        ),
        thesis.Subnetwork([(6, links("gravity_links", "joint"), identity)]),
        thesis.Subnetwork([(6, diagonal("kv"), identity)]),
        thesis.Subnetwork([(6, diagonal("kd"), identity)]),
    ]


def appendix_inputs(appendix_b: dict[str, Any], table: str, q: np.ndarray) -> np.ndarray:
    """Products of sines and cosines, (patterns, inputs)."""
    angles = {"2": q[:, 1], "23": q[:, 1] + q[:, 2], "4": q[:, 3], "5": q[:, 4]}
    columns: list[np.ndarray] = []
    for at in sorted(appendix_b[table], key=int):
        value = np.ones(len(q))
        for factor, power in appendix_b[table][at].items():
            function = np.cos if factor[0] == "c" else np.sin
            value = value * function(angles[factor[1:]]) ** power
        columns.append(value)
    return np.column_stack(columns)


@pytest.fixture
def puma_problem(puma: CSLC, appendix_b: dict[str, Any], rng: np.random.Generator) -> Problem:
    q, qd, qdd = rng.uniform(-2, 2, (3, 4, 6))
    qd[1, 2] = 0.0  # a joint at rest
    return Problem(
        inverse_dynamics(puma),
        appendix_network(appendix_b, puma.names),
        thesis.IDENTITY,
        [appendix_inputs(appendix_b, f"{t}_inputs", q) for t in ("mass", "velocity", "gravity")]
        + [qd, np.sign(qd)],
        [[qdd], [qd, qd], [], [], []],
        rng.normal(scale=10, size=(4, 6)),
        rng.normal(size=puma.size),
        (q, qd, qdd),
    )


@pytest.mark.parametrize("rule", [Backpropagation(), PERAL()], ids=lambda rule: rule.name)
@pytest.mark.parametrize("velocity", [True, False])
def test_the_whole_cslc(puma_problem: Problem, rule: AbstractRule, velocity: bool) -> None:
    """All five subnetworks, the network as the library derives it, the literal one as printed."""
    case = puma_problem
    learning = (True, velocity, True, True, True)
    literal = thesis.peral if isinstance(rule, PERAL) else thesis.backpropagation
    training_set = examples(case.network, case.patterns, case.t)
    result = change(rule, case.network, case.k, training_set, learning)
    expected = case.literally(literal, learning)
    assert_allclose(result, expected, rtol=1e-10, atol=1e-11)
    assert velocity == bool(np.any(result[1]))


def test_the_whole_cslc_with_masks(puma_problem: Problem, rng: np.random.Generator) -> None:
    case = puma_problem
    counts = (rng.uniform(size=case.t.shape) < 0.7).astype(float)
    training_set = examples(case.network, case.patterns, case.t, counts > 0)
    result = change(PERAL(), case.network, case.k, training_set)
    expected = case.literally(thesis.peral, counts=counts)
    assert_allclose(result, expected, rtol=1e-10, atol=1e-11)
