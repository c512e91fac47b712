"""Tables of the page about real arms, from the study's rows."""

from collections.abc import Mapping, Sequence
from typing import Any, NamedTuple

import numpy as np


# Errors of less than so much more are as good.
_AS_GOOD = 1.02
_OURS, _PIPELINE = "identify", "usual pipeline"


class _Comparison(NamedTuple):
    """Errors of `identify` and of the best variant of the usual pipeline, joint by joint."""

    recording: str
    variant: str
    ours: np.ndarray
    usual: np.ndarray

    @property
    def worse(self) -> list[int]:
        """Joints, from 0, at which `identify` loses."""
        return np.flatnonzero(self.ours > _AS_GOOD * self.usual).tolist()


def _comparisons(results: Sequence[Mapping[str, Any]]) -> list[_Comparison]:
    compared: list[_Comparison] = []
    for result in results:
        for recording in dict.fromkeys(row["recording"] for row in result["rows"]):
            rows = [row for row in result["rows"] if row["recording"] == recording]
            ours = [row for row in rows if row["method"] == _OURS]
            usual = [row for row in rows if row["method"].startswith(_PIPELINE)]
            if ours and usual:
                best = min(usual, key=lambda row: np.mean(row["all"]))
                name = best["method"].removeprefix(f"{_PIPELINE}, 20 Hz, ")
                errors = (np.array(row["all"]) for row in (ours[0], best))
                compared.append(_Comparison(f"{result['arm']}, {recording}", name, *errors))
    return compared


def tables(results: Sequence[Mapping[str, Any]]) -> dict[str, list[list[str]]]:
    """Tables of the page by their names, the head first.

    - `results`: of the study, an arm each.
    """
    found = {"losses": _losses(_comparisons(results))}
    for result in results:
        arm, rows = result["arm"], result["rows"]
        for recording in dict.fromkeys(row["recording"] for row in rows):
            of_recording = [row for row in rows if row["recording"] == recording]
            found[f"{arm}, {recording}"] = _errors(recording, of_recording)
        found[f"{arm}, settings"] = _settings(rows)
    return found


def _losses(compared: Sequence[_Comparison]) -> list[list[str]]:
    lines = [["recording", "usual pipeline", "joint: `identify`, pipeline [%]"]]
    for one in compared:
        joints = "; ".join(
            f"{joint + 1}: {one.ours[joint]:.1f}, {one.usual[joint]:.1f}" for joint in one.worse
        )
        lines.append([one.recording, one.variant, joints or "none"])
    return lines


def _settings(rows: Sequence[Mapping[str, Any]]) -> list[list[str]]:
    notes: dict[str, list[str]] = {}  # methods of each note
    for row in rows:
        if row["recording"] == rows[0]["recording"] and row["note"]:
            notes.setdefault(row["note"], []).append(row["method"])
    head = ["method", "estimator", "friction", "settings"]
    return [
        head,
        *(["<br>".join(methods), *note.split("; ", 2)] for note, methods in notes.items()),
    ]


def _errors(recording: str, rows: Sequence[Mapping[str, Any]]) -> list[list[str]]:
    errors = np.array([row["all"] for row in rows])
    least = errors.min(axis=0)
    joints = [str(joint + 1) for joint in range(errors.shape[1])]
    lines = [[recording, *joints, "mean", "processor [s]"]]
    for row, values in zip(rows, errors, strict=True):
        cells = [
            f"{_bold(f'{value:.1f}', value <= _AS_GOOD * best)} / {inside:.1f}"
            for value, inside, best in zip(values, row["judged"], least, strict=True)
        ]
        mean = f"{values.mean():.1f} / {np.nanmean(row['judged']):.1f}"
        lines.append([row["method"], *cells, mean, _seconds(row["seconds"])])
    share = [f"{value:.0f} %" for value in rows[-1]["share"]]
    return [*lines, ["*judged samples*", *share, "", ""]]


def _bold(text: str, condition: bool) -> str:
    return f"**{text}**" if condition else text


def _seconds(value: float) -> str:
    return f"{value:.0f}" if value >= 10.0 else f"{value:.2g}"
