"""The page of the documentation about real arms, from the study's rows."""

import textwrap
from collections.abc import Mapping, Sequence
from typing import Any, NamedTuple

import numpy as np


# Errors of less than so much more are as good.
_AS_GOOD = 1.02
_OURS, _PIPELINE = "identify", "usual pipeline"
_INTRODUCTION = """\
# Real robots

{points}

![Bars: held-out torque errors on real arms](images/evidence/real_robots.svg)

The tables compare all our recordings of arms with torques. The numbers are 100·‖error‖/‖torque‖
per joint [%], of the raw torque. The first is over all samples. The second is over the samples
that the masks keep, without slow motion. Bold is the smallest error over all samples and those
within 2 % of it. All methods are judged on motion that is smoothed in the same way. Each recording
is divided once into motion that is fitted and motion that is judged. Nothing of a fit is chosen on
the latter.

- **usual pipeline**: 20 Hz Butterworth filter of order 4, forwards and backwards, on positions
  and torques. Central differences. Ordinary (OLS) or weighted (WLS) least squares, with the
  friction terms of the robot's file, without and with torque offsets of all joints. Examples of
  Pinocchio do this. FIGAROH 1.0.2 does, too: its coefficients are those of the OLS rows to ten
  digits. The pipeline is also judged on its own motion, and with friction at rest by the sign of
  measured velocity. The best of the four errors counts.
- **ridge to the file**: weighted least squares with offsets and a ridge towards the masses of the
  robot's file. The ridge's width is 20 % of a mass. It was found on this arm, the LWR4+. Only its
  file has masses.
- **identify**: the command as typed, `jaxcslc identify ROBOT RECORDING`, without any option.
- **maximum likelihood**: `--estimator maximum-likelihood` ([page](likelihood.md)).
- **friction auto**: `--friction auto` ([page](friction.md#choose-terms-automatically)).
- **best**: `--quality best`, which is `--estimator auto --friction auto`.

```sh
OPENBLAS_NUM_THREADS=1 python -m scripts.studies.real_robots.study --page docs/real_robots.md
```

The recordings are not part of this repository; `--data` names the folder that holds them. An SO-101
has position servos and no torque signal. [Its figures](servo_evidence.md#a-real-so-101) are errors
of simulated positions.

These are no blind tests. Five rules of `identify` were chosen after errors on these recordings had
been seen:

- the odds of one in five at which physically consistent parameters are used (KR300);
- the [friction at standstill](friction.md#joints-at-standstill) (KR300);
- weights by residual with the file as prior (LWR4+);
- torque offsets of all joints, with the file as prior (LWR4+);
- the noise of halves of a recording, by which the file's strength is found (LWR4+).

## Cases it loses

`identify` as typed loses at a joint if its error is more than 2 % above that of the usual pipeline.
The pipeline's variant is the one with the smallest mean over the joints on the judged recording.
The ridge is one of the variants.

{losses}

## MuJoCo's toolbox

MuJoCo's toolbox, `mujoco.sysid` 4.0, fits by simulation. It searches for bodies, friction and
motor inertias with which an MJCF model moves as the arm did. It needs start values, bounds, and
initial states of simulations. Here it starts from equal bodies with the arm's mass. It has one
simulation per second of the KR300's motion A, 78 parameters and 30 steps (108 s of processor
time). Its errors are 567 1427 301 526 38 153 % on B, 409 801 350 617 28 164 % on C, and 85 510 76
454 15 121 % on A. With simulations of 0.2 s and 60 steps they are 440 393 151 2926 256 574 % on
A. The toolbox is made for models that are nearly right already.

    python -m scripts.studies.real_robots.simulation_fit --arms "KUKA KR300" --steps 30
"""


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


def _points(compared: Sequence[_Comparison]) -> str:
    """What the page says first: where `identify` loses, and where it does not."""
    by_mean = {
        worse: [
            f"{one.recording} ({one.ours.mean():.1f} %, pipeline {one.usual.mean():.1f} %)"
            for one in compared
            if (one.ours.mean() > one.usual.mean()) == worse
        ]
        for worse in (True, False)
    }
    lost, joints = sum(len(one.worse) for one in compared), sum(len(x.ours) for x in compared)
    points = (
        f"`identify` as typed loses to the usual pipeline at {lost} of {joints} joints"
        " ([list](#cases-it-loses)).",
        f"Its mean error over the joints is larger on {_listed(by_mean[True])}.",
        f"It is smaller on {_listed(by_mean[False])}.",
    )
    return "\n".join(f"- {textwrap.fill(text, 98, subsequent_indent='  ')}" for text in points)


def _listed(recordings: Sequence[str]) -> str:
    return ", ".join(recordings) or "no recording"


def _losses(compared: Sequence[_Comparison]) -> str:
    lines = ["| recording | usual pipeline | joint: `identify`, pipeline [%] |", "|---|---|---|"]
    for one in compared:
        joints = "; ".join(
            f"{joint + 1}: {one.ours[joint]:.1f}, {one.usual[joint]:.1f}" for joint in one.worse
        )
        lines.append(f"| {one.recording} | {one.variant} | {joints or 'none'} |")
    return "\n".join(lines)


def page_text(results: Sequence[Mapping[str, Any]], date: str) -> str:
    """The page.

    - `results`: of the study, an arm each.
    - `date`: of the figures.
    """
    compared = _comparisons(results)
    introduction = _INTRODUCTION.format(points=_points(compared), losses=_losses(compared))
    sections = [introduction, *(_arm(result) for result in results)]
    return "\n".join(sections) + f"\nFigures of {date}.\n"


def _arm(result: Mapping[str, Any]) -> str:
    lines = [
        f"## {result['arm']}",
        "",
        f"The recordings are from {result['source']}. Split: {result['split']}.",
        "",
    ]
    rows = result["rows"]
    for recording in dict.fromkeys(row["recording"] for row in rows):
        of_recording = [row for row in rows if row["recording"] == recording]
        lines += [*_table(recording, of_recording), ""]
    notes: dict[str, list[str]] = {}  # methods of each note
    for row in rows:
        if row["recording"] == rows[0]["recording"] and row["note"]:
            notes.setdefault(row["note"], []).append(row["method"])
    if notes:
        lines += ["| method | estimator | friction | settings |", "|---|---|---|---|"]
        for note, methods in notes.items():
            lines.append(f"| {'<br>'.join(methods)} | {' | '.join(note.split('; ', 2))} |")
    return "\n".join(lines) + "\n"


def _table(recording: str, rows: Sequence[Mapping[str, Any]]) -> list[str]:
    errors = np.array([row["all"] for row in rows])
    least = errors.min(axis=0)
    joints = " | ".join(str(joint + 1) for joint in range(errors.shape[1]))
    lines = [
        f"| {recording} | {joints} | mean | processor [s] |",
        "|---" * (errors.shape[1] + 3) + "|",
    ]
    for row, values in zip(rows, errors, strict=True):
        cells = [
            f"{_bold(f'{value:.1f}', value <= _AS_GOOD * best)} / {inside:.1f}"
            for value, inside, best in zip(values, row["judged"], least, strict=True)
        ]
        mean = f"{values.mean():.1f} / {np.nanmean(row['judged']):.1f}"
        lines.append(
            f"| {row['method']} | {' | '.join(cells)} | {mean} | {_seconds(row['seconds'])} |"
        )
    share = " | ".join(f"{value:.0f} %" for value in rows[-1]["share"])
    return [*lines, f"| *judged samples* | {share} | | |"]


def _bold(text: str, condition: bool) -> str:
    return f"**{text}**" if condition else text


def _seconds(value: float) -> str:
    return f"{value:.0f}" if value >= 10.0 else f"{value:.2g}"
