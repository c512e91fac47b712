"""What any motion at all can tell: exact verdicts, against the rank of Pinocchio's regressor."""

from collections import Counter
from collections.abc import Callable
from typing import Any

import numpy as np
import pytest

import jaxcslc as jc
from jaxcslc.derivation import derive_algebra, structural_identifiability
from jaxcslc.manipulator import Manipulator


# Pinocchio's order of a body's ten parameters, in the names of expressions.
_BODY = ("m", "m*rx", "m*ry", "m*rz", "Ixx", "Ixy", "Iyy", "Ixz", "Iyz", "Izz")


def numeric_verdicts(model: Any, rng: np.random.Generator) -> dict[str, str]:
    """Oracle: a parameter is identifiable alone if the rank falls without its column."""
    import pinocchio as pin

    data = model.createData()
    blocks: list[np.ndarray] = []
    for _ in range(60):
        q, qd, qdd = rng.uniform(-3, 3, (3, model.nv))
        link_columns = pin.computeJointTorqueRegressor(model, data, q, qd, qdd)
        blocks.append(np.hstack([link_columns, np.diag(qdd)]))
    regressor = np.vstack(blocks)
    norms = np.linalg.norm(regressor, axis=0)
    visible = norms > 1e-9 * norms.max()
    columns = np.where(visible, regressor / np.where(visible, norms, 1.0), 0.0)

    def rank(matrix: np.ndarray) -> int:
        return int(np.linalg.matrix_rank(matrix, tol=1e-8))

    whole = rank(columns)
    names = [
        "*".join(f"{factor}{link}" for factor in name.split("*"))
        for link in range(1, model.nv + 1)
        for name in _BODY
    ] + [f"Im{link}" for link in range(1, model.nv + 1)]
    verdicts: dict[str, str] = {}
    for i, name in enumerate(names):
        if not visible[i]:
            verdicts[name] = "not at all"
        elif rank(np.delete(columns, i, axis=1)) < whole:
            verdicts[name] = "alone"
        else:
            verdicts[name] = "only in combinations"
    return verdicts


@pytest.mark.parametrize("name", ["puma560", "stanford", "ur5"])
def test_verdicts_are_those_of_pinocchios_rank(
    literature: dict[str, Manipulator],
    pinocchio_chain: Callable[[Manipulator], Any],
    rng: np.random.Generator,
    name: str,
) -> None:
    robot = literature[name].with_inertia("full", motor_inertia=True)
    exact = structural_identifiability(derive_algebra(robot, "numeric"))
    expected = numeric_verdicts(pinocchio_chain(literature[name]), rng)
    assert {row.parameter: row.verdict for row in exact} == expected
    assert len(set(expected.values())) == 3  # all kinds occur


def test_named_combinations_are_those_of_the_expressions() -> None:
    algebra = derive_algebra(jc.puma560(), "numeric")
    for row in structural_identifiability(algebra):
        expected = tuple(
            c.name for c in algebra.coefficients if row.parameter in [a.label for a in _bare(c)]
        )
        assert row.coefficients == expected
        assert (row.verdict == "not at all") == (not expected)


def _bare(coefficient: jc.Coefficient) -> list[Any]:
    return [addend.term for addend in coefficient.addends]


def test_symbols_tell_no_more_than_numbers() -> None:
    """What is identifiable alone for all lengths is so at these."""
    robot = jc.puma560()
    symbolic, numeric = (
        {row.parameter: row.verdict for row in structural_identifiability(derive_algebra(robot, l))}
        for l in ("symbolic", "numeric")
    )
    order = ("not at all", "only in combinations", "alone")
    # A single combination of mass and motor inertias is what gravity or lengths separate.
    alone = {name for name, verdict in symbolic.items() if verdict == "alone"}
    assert alone - {name for name, verdict in numeric.items() if verdict == "alone"} == set()
    assert set(symbolic.values()) <= set(order)


def test_panda_in_words() -> None:
    rows = structural_identifiability(derive_algebra(jc.panda(), "numeric"))
    assert len(rows) == 7 * 10
    counts = Counter(row.verdict for row in rows)
    assert counts["not at all"] + counts["only in combinations"] + counts["alone"] == 70
    assert str(rows[0]) == "Ixx1: not at all"
    assert "only in combinations, kB1" in str(rows[2])
