"""Section 5.2.3: coefficients that must be positive, and what a standard error excuses."""

from typing import Any

import jax
import jax.numpy as jnp
import numpy as np
import pytest

import jaxcslc as jc
from scripts.studies.puma560.sign_check import sign_check


def test_possible_machines_pass(puma: jc.CSLC, puma_k: jax.Array) -> None:
    check = sign_check(puma, puma_k)
    assert check.passed
    assert set(check.verdicts) == {"right"}
    assert check.standard_errors is None


def test_names_the_thesis_s_four(puma: jc.CSLC, puma_k: jax.Array, appendix_b: Any) -> None:
    assert set(appendix_b["positive_by_construction"]) <= set(sign_check(puma, puma_k).names)


@pytest.mark.parametrize("machine", ["puma_a", "puma_b"])
def test_thesis_s_identified_signs_are_right(puma: jc.CSLC, appendix_b: Any, machine: str) -> None:
    """Section 7.6: the network identified the correct sign for all, for both PUMA 560s."""
    values = appendix_b["values"][machine]
    k = np.array([*values["kM"], *values["kG"], *values["kv"], *values["kd"]])
    assert sign_check(puma, k).passed


def test_an_error_that_reaches_zero_excuses(puma: jc.CSLC, puma_k: jax.Array) -> None:
    k = puma_k
    for name, value in (("kM6", -0.1), ("kM9", -0.1), ("kM11", 0.0), ("kM4", 0.1)):
        k = k.at[puma.names.index(name)].set(value)
    error = jnp.full(puma.size, 0.05).at[puma.names.index("kM9")].set(0.2)
    check = sign_check(puma, k, error)
    verdicts = dict(zip(check.names, check.verdicts, strict=True))
    assert verdicts["kM6"] == "wrong"
    assert verdicts["kM9"] == verdicts["kM11"] == "within its error"
    assert verdicts["kM4"] == "right"
    assert not check.passed
    assert str(check) == (
        "19 of 22 coefficients that must be positive are; negative within their error: kM9, kM11;"
        " wrong: kM6"
    )


def test_without_errors_nothing_is_excused(puma: jc.CSLC, puma_k: jax.Array) -> None:
    check = sign_check(puma, puma_k.at[puma.names.index("kM9")].set(0.0))
    assert check.verdicts[check.names.index("kM9")] == "wrong"


def test_what_is_undetermined_contradicts_nothing(puma: jc.CSLC, puma_k: jax.Array) -> None:
    check = sign_check(puma, -puma_k, jnp.full(puma.size, jnp.inf))
    assert set(check.verdicts) == {"within its error"}


def test_rows(puma: jc.CSLC, puma_k: jax.Array) -> None:
    rows = sign_check(puma, puma_k, 0 * puma_k).rows()
    assert list(rows[0]) == ["name", "value", "standard_error", "sign", "expression"]
    assert [row["name"] for row in rows][:2] == ["kM4", "kM6"]
    assert rows[1]["expression"] == puma.coefficients[puma.names.index("kM6")].expression


def test_a_vector_of_another_length(puma: jc.CSLC, puma_k: jax.Array) -> None:
    with pytest.raises(ValueError, match=r"k: expected shape \(43,\), got \(42,\)"):
        sign_check(puma, puma_k[:-1])
    with pytest.raises(ValueError, match=r"standard_error: expected shape \(43,\)"):
        sign_check(puma, puma_k, puma_k[:-1])
