"""Coefficient tables laid out as Figs. B.1-1 to B.5-2."""

import jax
import numpy as np
import pytest

import jaxcslc as jc
from jaxcslc.report import coefficient_rows, coefficient_text


def test_columns_of_appendix_b(puma: jc.CSLC, puma_k: jax.Array, rng: np.random.Generator) -> None:
    """Name, values beside values, and how much each matters; in the network's order."""
    sensitivity = rng.uniform(size=puma.size)
    rows = coefficient_rows(
        puma,
        reference={"Armstrong et al.": puma_k, "true": 2 * puma_k},
        sensitivity=sensitivity,
        groups=["mass"],
    )
    assert [row["name"] for row in rows] == [f"kM{i}" for i in range(1, 27)]
    assert [row["sensitivity"] for row in rows] == sensitivity[:26].tolist()
    assert [row["true"] for row in rows] == (2 * puma_k[:26]).tolist()
    assert list(rows[0])[-4:] == ["Armstrong et al.", "true", "sensitivity", "expression"]
    assert "sensitivity" in coefficient_text(rows).splitlines()[0]


def test_groups_keep_their_own_values(puma: jc.CSLC, puma_k: jax.Array) -> None:
    """A later group's rows do not take the first rows' values."""
    rows = coefficient_rows(puma, reference={"k": puma_k}, groups=["viscous", "gravity"])
    assert [row["name"] for row in rows][:6] == ["kG1", "kG2", "kG3", "kG4", "kG5", "kv1"]
    assert [row["k"] for row in rows] == puma_k[26:37].tolist()


def test_all_groups_by_default(puma: jc.CSLC) -> None:
    assert len(coefficient_rows(puma)) == 43
    assert "sensitivity" not in coefficient_rows(puma)[0]


def test_wrong_input(puma: jc.CSLC, puma_k: jax.Array) -> None:
    with pytest.raises(ValueError, match=r"groups: expected some of mass, .* got 'inertia'"):
        coefficient_rows(puma, groups=["inertia"])
    with pytest.raises(ValueError, match=r"true: expected shape \(43,\), got \(31,\)"):
        coefficient_rows(puma, reference={"true": puma_k[puma.layout.inertial]})
    with pytest.raises(ValueError, match=r"sensitivity: expected shape \(43,\), got \(1,\)"):
        coefficient_rows(puma, sensitivity=np.ones(1))
