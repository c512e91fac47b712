"""A mask against the record of what it should have left out."""

import numpy as np
import pytest
from numpy.testing import assert_allclose

from sim.recording._mask_quality import mask_quality


def test_against_a_literal_count(rng: np.random.Generator) -> None:
    kept, disturbed = rng.random((2, 200, 3)) < np.array([0.6, 0.1])[:, None, None]
    quality = mask_quality(kept, disturbed)
    for joint in range(3):
        pairs = list(zip(kept[:, joint], disturbed[:, joint], strict=True))
        caught = sum(1 for keep, bad in pairs if bad and not keep)
        lost = sum(1 for keep, bad in pairs if not bad and not keep)
        bad = int(np.sum(disturbed[:, joint]))
        assert quality.disturbed[joint] == bad
        assert_allclose(quality.caught_share[joint], caught / bad)
        assert_allclose(quality.lost_share[joint], lost / (200 - bad))
        assert_allclose(quality.precision[joint], caught / (caught + lost))


def test_a_perfect_mask(rng: np.random.Generator) -> None:
    disturbed = rng.random((50, 2)) < 0.3
    quality = mask_quality(~disturbed, disturbed)
    assert_allclose(quality.caught_share, 1.0)
    assert_allclose(quality.lost_share, 0.0)
    assert_allclose(quality.precision, 1.0)


def test_shares_of_nothing_are_no_number() -> None:
    """A joint whose gears never part, and a mask that leaves nothing out."""
    quality = mask_quality(np.ones((4, 1), bool), np.zeros((4, 1), bool))
    assert np.isnan(quality.caught_share) and np.isnan(quality.precision)
    assert_allclose(quality.lost_share, 0.0)


def test_rows_end_with_all_pairs_together(rng: np.random.Generator) -> None:
    kept, disturbed = rng.random((2, 100, 6)) < 0.5
    rows = mask_quality(kept, disturbed).rows()
    assert [row["joint"] for row in rows] == ["1", "2", "3", "4", "5", "6", "all"]
    assert rows[-1]["disturbed"] == int(np.sum(disturbed))
    flat = mask_quality(kept.reshape(-1, 1), disturbed.reshape(-1, 1)).rows()[0]
    assert {**flat, "joint": "all"} == rows[-1]


def test_shapes_must_agree() -> None:
    with pytest.raises(ValueError, match=r"kept has shape \(3, 2\), disturbed \(4, 2\)"):
        mask_quality(np.ones((3, 2), bool), np.ones((4, 2), bool))
