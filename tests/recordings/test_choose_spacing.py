"""The spacing of averaged splines: the criterion, and the part that the encoder has in it."""

import numpy as np
import pytest

from jaxcslc.recordings import AveragedSplines, choose_spacing, left_out_error, noise_level


COUNT = 1e-4
CANDIDATES = (5, 9, 13, 17, 25, 35)


def motion() -> tuple[np.ndarray, np.ndarray]:
    time = np.arange(2000) * 0.002
    return time, np.stack([np.sin(3.0 * time), 0.5 * np.cos(11.0 * time)], axis=1)


def quantised(position: np.ndarray) -> np.ndarray:
    return COUNT * np.round(position / COUNT)


@pytest.mark.parametrize("slack", [0.0, 0.01, 0.3])
def test_the_widest_that_meets_the_criterion(slack: float) -> None:
    time, position = motion()
    readings = quantised(position)
    spacings = choose_spacing(time, readings, candidates=CANDIDATES, slack=slack)
    errors = {j: left_out_error(time, readings, AveragedSplines(j)) for j in CANDIDATES}
    least = np.min(list(errors.values()), axis=0)
    allowed = least**2 + 2.0 * slack * noise_level(readings) ** 2
    for joint, spacing in enumerate(spacings):
        meeting = [j for j in CANDIDATES if errors[j][joint] ** 2 <= allowed[joint]]
        assert spacing == max(meeting)


def test_without_noise_nothing_may_be_taken_from_the_motion() -> None:
    time, position = motion()
    assert choose_spacing(time, position, candidates=CANDIDATES) == (5, 5)


def test_a_coarser_encoder_allows_more() -> None:
    """The resolution can be passed for readings that do not show their counts."""
    time, position = motion()
    steps = [0.0, 1e-5, 1e-4, 1e-3]
    spacings = np.array(
        [choose_spacing(time, position, candidates=CANDIDATES, resolution=r) for r in steps]
    )
    assert np.all(np.diff(spacings, axis=0) >= 0)
    assert np.all(spacings[-1] > spacings[0])
    by_joint = choose_spacing(
        time, position, candidates=CANDIDATES, resolution=np.array([steps[0], steps[-1]])
    )
    assert by_joint == (spacings[0, 0], spacings[-1, 1])


def test_the_resolution_is_estimated_from_readings() -> None:
    time, position = motion()
    readings = quantised(position)
    seen = choose_spacing(time, readings, candidates=CANDIDATES)
    assert choose_spacing(time, readings, candidates=CANDIDATES, resolution=COUNT) == seen


def test_a_resolution_below_nothing() -> None:
    time, position = motion()
    with pytest.raises(ValueError, match=r"encoder resolution is -1\.0; expected 0 or more"):
        choose_spacing(time, position, resolution=-1.0)
