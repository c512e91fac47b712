"""docs/puma_a_b.md says what the code does."""

import re
from collections.abc import Callable
from pathlib import Path
from typing import Any

import numpy as np

import sim
from jaxcslc import CSLC
from scripts.tools import thesis_machines_page


_ROOT = Path(__file__).parents[3]
_FIGURE = re.compile(r"-?\d+(?:\.\d+)?(?:e[-+]\d+)?")
# The cost in torque is over a simulated motion, which stick and slip let wander by a little.
_RELATIVE = 0.02
# Differences of numbers that agree are rounding, or what the optimiser stops at.
_ABSOLUTE = 2e-5


def test_the_page_is_what_the_code_computes() -> None:
    _, truth = sim.simulate(sim.puma560(), sim.training(), seed=3)
    now = thesis_machines_page.page(truth).splitlines()
    page = (_ROOT / "docs" / "puma_a_b.md").read_text(encoding="utf-8").splitlines()
    advice = "docs/puma_a_b.md is out of date: run scripts/tools/thesis_machines_page.py"
    assert len(page) == len(now), advice
    for written, computed in zip(page, now, strict=True):
        assert _FIGURE.sub("#", written) == _FIGURE.sub("#", computed), advice
        np.testing.assert_allclose(
            [float(x) for x in _FIGURE.findall(written)],
            [float(x) for x in _FIGURE.findall(computed)],
            rtol=_RELATIVE,
            atol=_ABSOLUTE,
            err_msg=f"{advice}\n{written}",
        )


def test_what_the_page_says_of_every_machine(
    puma: CSLC, random_links: Callable[..., Any], rng: np.random.Generator
) -> None:
    """Each quantity has one value, and what is at least 0 is."""
    for _ in range(20):
        k = np.asarray(puma.coefficients_from(random_links(rng, 6, principal=True)))
        by_name = dict(zip(puma.names, k.tolist(), strict=True))
        groups: list[list[float]] = []
        for what, *_, value in thesis_machines_page.quantities(by_name):
            groups = [*groups, [value]] if what else [*groups[:-1], [*groups[-1], value]]
        assert [len(group) for group in groups] == [5, 3, 2, 1, 1]
        for group in groups:
            np.testing.assert_allclose(group, group[0], rtol=1e-9)
        assert all(value >= 0 for *_, value in thesis_machines_page.spreads(by_name))
