"""The page of the documentation about real arms, from the study's rows."""

from collections.abc import Mapping, Sequence
from typing import Any

import numpy as np


_INTRODUCTION = """\
# Real robots

- `identify` is compared with the usual pipeline on published recordings of three arms.
- Its mean error is smaller on the KUKA KR300 and the Franka Panda, and larger on the Stäubli
  TX40.
- `--friction auto` helps the Panda most.

![Bars: held-out torque errors on three real arms](images/evidence/real_robots.svg)

The numbers are 100·‖error‖/‖torque‖ per joint [%], of the raw torque. The first is over all
samples. The second is over the samples that the masks keep, without slow motion. Bold is the
smallest error over all samples and those within 2 % of it. All methods are judged on motion that
is smoothed in the same way. Each recording is divided once into motion that is fitted and motion
that is judged, and nothing of a fit is chosen on the latter.

Two choices were made after seeing these results. Physically consistent parameters are used at
odds of one in five; at one in twenty, `auto` was least squares without them on the KR300. The
other is [friction at standstill](friction.md#joints-at-standstill), for all methods.

- **usual pipeline**: 20 Hz Butterworth filter of order 4, forwards and backwards, on positions
  and torques. Central differences. Ordinary (OLS) or weighted (WLS) least squares. Examples of
  Pinocchio do this, and FIGAROH 1.0.2: its coefficients are those of the OLS rows to ten digits.
  It is also judged on its own motion, and with friction at rest by the sign of measured velocity.
  The best of the four counts.
- **least-squares**: `--estimator least-squares --physical never`, settings chosen by
  cross-validation. With `--physical auto`, the command's default, the row *auto* applies where it
  says least squares.
- **maximum-likelihood**: `--estimator maximum-likelihood`, without smoothing
  ([page](likelihood.md)).
- **consistent**: the same with `--physical always`
  ([page](uncertainty.md#physically-consistent-parameters)).
- **friction auto**: `--friction auto`, friction terms and pre-sliding friction that improve the
  prediction of held-out data ([page](friction.md#choose-terms-automatically)).
- **auto**: `--estimator auto --physical auto`, which decides within the fitted motion.

```sh
OPENBLAS_NUM_THREADS=1 python -m scripts.studies.real_robots.study --page docs/real_robots.md
```

The recordings are not part of this repository; `--data` names the folder that holds them.

MuJoCo's toolbox, `mujoco.sysid` 4.0, fits by simulation. It searches for bodies, friction and
motor inertias with which an MJCF model moves as the arm did. It needs start values, bounds, and
states to begin simulations at. It started from equal bodies with the arm's mass, with one
simulation per second of the KR300's motion A, 78 parameters and 30 steps (108 s of processor
time). Its errors are 567 1427 301 526 38 153 % on B, 409 801 350 617 28 164 % on C, and 85 510 76
454 15 121 % on A. With simulations of 0.2 s and 60 steps they are 440 393 151 2926 256 574 % on
A. It is made for models that are nearly right already.

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
        f"- {row['method']}: {row['note']}." for row in notes if "consistent" not in row["method"]
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
