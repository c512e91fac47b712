"""Sections of long recordings whose equations fit into memory."""

from collections.abc import Mapping
from typing import NamedTuple

import numpy as np

from ..network import CSLC
from ..recordings import Recording


# Copies of a regressor that choosing settings and judging fits hold at a time, JAX's included.
_COPIES = 12
# Sections that the best is selected from.
_SECTIONS = 32
_LEAST_SAMPLES = 4096
# A longer distance between samples, in sampling intervals, is a gap.
_GAP = 2.5


class Segment(NamedTuple):
    """The part of a long recording that settings are chosen on and fits are judged on.

    - `recording`: of consecutive samples.
    - `description`: where it is, in words.
    """

    recording: Recording
    description: str


def section_of(
    network: CSLC, recording: Recording, memory: float, *, streamed: bool = True
) -> Segment | None:
    """Return the part of a recording whose regressor fits into memory [GB], or None if all of it
    does.

    Of sections of equal length without gaps that start at even distances, that in which joints
    cover the most: the greatest sum of logarithms of the standard deviations of positions and of
    their differences. (Sections apart from each other would have gaps between them, which no
    filter may pass.)

    - `streamed`: whether coefficients are fitted to all of the recording nevertheless.
    """
    if not 0.0 < memory < np.inf:
        raise ValueError(f"memory: expected more than 0 GB, got {memory:g}")
    row = 8 * network.joint_count * network.size
    most = max(int(1e9 * memory / (_COPIES * row)), _LEAST_SAMPLES)
    if recording.samples <= most:
        return None
    starts = np.linspace(0, recording.samples - most, _SECTIONS).astype(int)
    steps = np.diff(recording.time)
    gaps = np.flatnonzero(steps > _GAP * np.median(steps))
    whole = [start for start in starts if not np.any((gaps >= start) & (gaps < start + most))]
    start = max(whole or starts, key=lambda start: _motion(recording, slice(start, start + most)))
    part = recording.rows(slice(start, start + most))
    from_start = part.time - recording.time[0]
    what = "settings, held-out errors, systematic errors and physical consistency are tested on"
    return Segment(
        part,
        f"{what if streamed else 'of this recording are used'} {most} of {recording.samples}"
        f" samples, from {from_start[0]:.4g} s to {from_start[-1]:.4g} s, where joints move most:"
        f" the regressor of all would take more than {memory:g} GB (--memory)"
        + ("; coefficients are fitted to all samples" if streamed else ""),
    )


def sections_of(
    network: CSLC, recordings: Mapping[str, Recording], memory: float
) -> tuple[dict[str, Recording], list[str]]:
    """Cut several recordings to what is fitted together in a memory, shared by their lengths.

    Equations of all are kept until the recordings are compared, so that they are not streamed.
    **Returns** the recordings, and a sentence about each that was cut.
    """
    total = sum(recording.samples for recording in recordings.values())
    sections = {
        name: section_of(network, recording, memory * recording.samples / total, streamed=False)
        for name, recording in recordings.items()
    }
    return (
        {
            name: recordings[name] if section is None else section.recording
            for name, section in sections.items()
        },
        [f"{name}: {part.description}" for name, part in sections.items() if part is not None],
    )


def _motion(recording: Recording, rows: slice) -> float:
    """Return a measure of how much the joints move in a part of a recording."""
    position = recording.position[rows]
    spread = np.std(position, axis=0) * np.std(np.diff(position, axis=0), axis=0)
    return float(np.sum(np.log(np.maximum(spread, 1e-30))))
