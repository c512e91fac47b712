"""The page of the documentation about real arms, from the study's rows."""

from collections.abc import Mapping, Sequence
from typing import Any

import numpy as np


_INTRODUCTION = """\
# Real robots

What `jaxcslc identify` reaches on published recordings of real arms, by its defaults and where it
decides more by itself, beside the usual pipeline. Each recording is divided once and for all into
motion that is fitted and motion that is judged, and nothing of a fit is chosen on the latter. (Two
things were set with these figures known: possible bodies are used at odds of one in five; at one in
twenty, `auto` was least squares without them on the KR300. And
[friction at rest](friction.md#joints-at-standstill), for all methods.) Numbers are
100·‖error‖/‖torque‖ of each joint [%], of the raw torque, on motion smoothed in one way for all:
over all samples and, after the stroke, over those that masks leave in (no slow motion, where
friction is not known). In bold: the least error over all samples, joint by joint, and those within
2 % of it.

- **usual pipeline**: 20 Hz Butterworth of order 4, forwards and backwards, on positions and
  torques, central differences, ordinary (OLS) or weighted (WLS) least squares; what examples of
  Pinocchio do, and FIGAROH 1.0.2 (its coefficients are those of the OLS rows to ten digits). It is
  judged on its own motion too, and with friction at rest by the sign of measured velocity too;
  the best of the four counts.
- **least-squares**: `--estimator least-squares`, the default: settings chosen by
  cross-validation.
- **maximum-likelihood**: `--estimator maximum-likelihood`: no smoothing, positions are estimated
  along ([page](likelihood.md)).
- **possible bodies**: the same with `--possible always` ([page](uncertainty.md#physically-consistent-parameters)).
- **friction auto**: `--friction auto`: friction terms, and states of dry friction that yields
  before it slides, where motion that was left out is predicted better
  ([page](friction.md#choose-terms-automatically)).
- **auto**: `--estimator auto --possible auto`, which decides within the fitted motion.

```sh
OPENBLAS_NUM_THREADS=1 python -m scripts.studies.real_robots.study --page docs/real_robots.md
```

(One thread of BLAS, as the command has it: more of them spend two to five times the processor
time on small matrices.)

The recordings are not part of this repository; `--data` names the folder that holds them.

MuJoCo's toolbox, `mujoco.sysid` 4.0, fits by simulation: it searches for bodies, friction and
motor inertias with which an MJCF model, driven by the recorded torques, moves as the arm did. It
needs the package `tabulate`, numbers to start from, bounds, and states to begin simulations at.
From equal bodies of the arm's mass on the data sheet, with one simulation for each second of the
KR300's motion A, 78 parameters and 30 steps (108 s of processor), its errors are 567 1427 301 526
38 153 % on B, 409 801 350 617 28 164 % on C, and 85 510 76 454 15 121 % on A itself: its steps
become small long before torques are right. With simulations of 0.2 s and 60 steps they are worse
(440 393 151 2926 256 574 % on A), since bodies that are too heavy hardly feel the torque, and so
hardly leave the motion in so short a time. It is made for models that are near the truth already.

    python -m scripts.studies.real_robots.simulation_fit --arms "KUKA KR300" --steps 30
"""


def page_text(results: Sequence[Mapping[str, Any]], date: str) -> str:
    """The page.

    - `results`: of the study, an arm each.
    - `date`: of the figures.
    """
    sections = [_INTRODUCTION, *(_arm(result) for result in results)]
    return "\n".join(sections) + f"\nFigures of {date}.\n"


def _arm(result: Mapping[str, Any]) -> str:
    lines = [
        f"## {result['arm']}",
        "",
        f"From {result['source']}: {result['split']}.",
        "",
    ]
    rows = result["rows"]
    for recording in dict.fromkeys(row["recording"] for row in rows):
        of_recording = [row for row in rows if row["recording"] == recording]
        lines += [*_table(recording, of_recording), ""]
    notes = [row for row in rows if row["recording"] == rows[0]["recording"] and row["note"]]
    lines += [
        f"- {row['method']}: {row['note']}." for row in notes if "possible" not in row["method"]
    ]
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
            f"{_bold(f'{value:.1f}', value <= 1.02 * best)} / {inside:.1f}"
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
