"""Backpropagation and PERAL on the PUMA 560's network, whose links Appendix B prints."""

from collections.abc import Callable
from typing import Any

import numpy as np
import pytest
from numpy.testing import assert_allclose

from jaxcslc import CSLC
from jaxcslc.training import PERAL, Backpropagation, examples, inverse_dynamics
from jaxcslc.training._rules import AbstractRule
from scripts.studies.transcription import network as transcription, training
from tests.training import _transcription as thesis
from tests.training._problems import Problem, change


def literal(part: transcription.Subnetwork) -> thesis.Subnetwork:
    """The same subnetwork for the equations letter by letter."""
    layer = (part.nodes, [thesis.Link(*link) for link in part.links], thesis.IDENTITY)
    return thesis.Subnetwork(
        [layer],
        [
            (context.nodes, [thesis.ContextLink(*link) for link in context.links])
            for context in part.contexts
        ],
    )


@pytest.fixture
def puma_problem(puma: CSLC, appendix_b: dict[str, Any], rng: np.random.Generator) -> Problem:
    q, qd, qdd = rng.uniform(-2, 2, (3, 4, 6))
    qd[1, 2] = 0.0  # a joint at rest
    parts = transcription.appendix_network(appendix_b, puma.names)
    signals = transcription.appendix_signals(appendix_b, q, qd, qdd)
    return Problem(
        inverse_dynamics(puma),
        [literal(part) for part in parts],
        thesis.IDENTITY,
        [part.x.T for part in signals],
        [[context.T for context in part.contexts] for part in signals],
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
    equations = thesis.peral if isinstance(rule, PERAL) else thesis.backpropagation
    training_set = examples(case.network, case.patterns, case.t)
    result = change(rule, case.network, case.k, training_set, learning)
    expected = case.literally(equations, learning)
    assert_allclose(result, expected, rtol=1e-10, atol=1e-11)
    assert velocity == bool(np.any(result[1]))


def test_the_whole_cslc_with_masks(puma_problem: Problem, rng: np.random.Generator) -> None:
    case = puma_problem
    counts = (rng.uniform(size=case.t.shape) < 0.7).astype(float)
    training_set = examples(case.network, case.patterns, case.t, counts > 0)
    result = change(PERAL(), case.network, case.k, training_set)
    expected = case.literally(thesis.peral, counts=counts)
    assert_allclose(result, expected, rtol=1e-10, atol=1e-11)


@pytest.mark.parametrize(
    ("equations", "link_by_link"),
    [
        (thesis.backpropagation, training.backpropagation),
        (thesis.peral, training.peral),
    ],
    ids=["backpropagation", "PERAL"],
)
def test_the_transcription_of_all_patterns_at_once(
    puma_problem: Problem,
    appendix_b: dict[str, Any],
    rng: np.random.Generator,
    equations: Callable[..., thesis.Moves],
    link_by_link: Callable[[training.Problem, np.ndarray, np.ndarray], np.ndarray],
) -> None:
    """With masks by subnetwork: as with each mask for all, the row of its subnetwork (7.2.2)."""
    case = puma_problem
    counts = (rng.uniform(size=(5, *case.t.shape)) < 0.7).astype(float)
    counts[:, :, 0] = 1.0  # every pattern has a pair that counts
    parts = transcription.appendix_network(appendix_b, transcription.appendix_names())
    signals = transcription.appendix_signals(appendix_b, *case.patterns)
    t = case.t.T
    problem = training.Problem(parts, signals, t, np.swapaxes(counts, 1, 2))
    errors = t - transcription.outputs(parts, signals, case.k)
    expected = [case.literally(equations, counts=mask)[row] for row, mask in enumerate(counts)]
    result = link_by_link(problem, case.k, errors)
    assert_allclose(result, expected, rtol=1e-10, atol=1e-11)
