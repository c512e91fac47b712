"""Writes docs/experiment.md: what `make demo` measured, beside the thesis's Chapter 7.

    make demo
    .venv/bin/python -m scripts.tools.thesis.page --collect build
    .venv/bin/python -m scripts.tools.thesis.experiment_page

Every number is from the tables in results/. A test fails when the page and the tables disagree.
"""

import argparse
from collections.abc import Sequence
from pathlib import Path

from scripts.tools.thesis import results
from scripts.tools.thesis.references import ROOT


PAGE = ROOT / "docs" / "experiment.md"

_INTRODUCTION = """\
# The experiment of Chapter 7

- On both machines, identified coefficients predict torques better than published ones.
- A network that is trained as in the thesis ends near the direct solve.
- Nearly all intervals contain the true coefficient, systematic errors included.

![Bars: torque error by coefficients on PUMA A and B](images/evidence/experiment.svg)

`make demo` repeats the thesis's experiment on two simulated machines, [PUMA A and B](puma_a_b.md),
with every disturbance of Section 7.2. This page has its tables; `build/demo/experiment.html` has
the figures, coefficients and all else. It is written by `scripts/tools/thesis/experiment_page.py`
from the tables of one run (`make demo`, seed 1).

## Torque errors

The tables have mean moduli of the torque error in the comparison trajectory, and the error cost ε,
half the root mean square over joints [N m] (Figs. 7.6-3 and 7.6-4). The thesis judges in this way.
Positions are smoothed by splines of 17 samples. The torque of a sample is the demand of the sample
before (7.4). The first and the last 0.2 s are disregarded (7.4.2).

- Ar+LS: links of Armstrong et al., friction of Leahy and Saridis.
- Ar+Rg: the same links, friction regressed from the training trajectory.
- CSLC trained: backpropagation and PERAL in turns ([networks
  trained](#networks-trained-side-by-side)).
- CSLC solved: the direct solve of the same patterns.
- CSLC: the direct solve with the settings that `jaxcslc identify` chooses.
- True: the machine's own coefficients, in a model without its disturbances. What they leave is
  about what any model of this form leaves. A fit may absorb a part of a disturbance.
"""

_EPSILON = """\
The rows below the first *mean ε* judge the same recording in two other ways. *Mean of two
demands*: the mean of the demands before and after a sample, and joints that move faster than 0.01
rad/s. *As jaxcslc identify judges*: the settings that were chosen for the fit. The command gives
the same number of unconstrained coefficients, which physically consistent ones may replace by
default:

```sh
.venv/bin/jaxcslc identify puma560 build/demo/puma_a_training.csv \\
    --validate build/demo/puma_a_comparison.csv --physical never
```
"""

_HAND = """\
### Errors at the hand

Section 7.5 discusses weights for the joints' errors and leaves them open. Here each torque error is
judged by the acceleration that it would cause at the flange [m/s²]. This uses the true machine's
mass matrix. Joints 1 to 3 carry nearly all of it.
"""

_INTERVALS = """\
## Intervals of the coefficients

The table has the number of the 43 intervals of 95 % that contain the machine's true coefficient.
The intervals include the standard error alone, one cause of [systematic
errors](uncertainty.md#systematic-errors) as well, or all causes. `jaxcslc identify` prints the
last:
"""

_INTERVALS_RESULT = """\
Of 43 intervals, 95 % are 41. Those of the standard error alone fall short. The viscous friction of
the wrist is within 2 % of the truth on both machines. The reason is that a sample has the mean of
the demands before and after it ([which torque belongs to a
sample](preparation.md#torque-of-a-sample)). The one interval that does not contain the
truth is that of PUMA A's kM8.
"""

_LINEARITY = """\
## Linearity of the motors

The thesis measures up to which torque joint 2's motor is linear (7.2.3, Fig. 7.2-2). It takes the
other motors for linear up to the same part of their greatest torques, and finds that no trajectory
demands more. As a double-check, it repeats the experiment on joint 3, with similar results.

The demo does the same on PUMA A. The tested link oscillates about the horizontal, and all other
joints are locked. Joint 2's heaviest weight covers joint 6's demand, the largest in proportion.
Ranges of joints 2 and 3 are measured, those of other joints are joint 2's in proportion. Greatest
demands [N m]:
"""

_WEAK = """\
What if the premise does not hold? The same machine gets weaker motors, with the limits of
`sim.DISTURBANCES`. The training trajectory exceeds all of them except joint 2's. The machine is
identified from its own training recording and judged on the same comparison recording [N m]:
"""

_WEAK_RESULT = """\
The error grows by a fifth: pairs beyond the limits are many, but the curve leaves the line slowly.
To exclude them is worse: a third of the pairs is lost, and those that stay are chosen by their
torque.
"""

_TRAINED = """\
## Networks trained side by side

Each of 32 seeds has a training and a comparison recording of its own (encoder phases, starts,
timing). Their networks are trained at once, from zero weights, on all patterns. Slow pairs of
joint and sample (below a hundredth of top speed) are excluded, and no pair for backlash. The
training torques have Armstrong's abbreviated gravity (7.4.1), and amplitudes that were adjusted in
trials (`python -m scripts.studies.puma560.trials`).

- Backpropagation: one rate per subnetwork, adapted by the rule of 6.3.1, from 0.001.
- Backpropagation and PERAL: the same until the cost is that of Ar+LS, then bouts of 10 epochs of
  PERAL at a rate of 1 after every 200 epochs.
- Training ends when a round of bouts lowers half the summed squared errors by less than 3e-5 (N
  m)² per epoch.

Rates, bouts and this end were chosen with the comparison errors of other recordings of these
machines in view. Medians over the seeds, ε as in the thesis; the seconds contain compiling:
"""

_TRAINED_RESULT = """\
The table has the time without compiling (`python -m scripts.studies.training.cslc --seeds 32
--routes ...`; on the H100 with 11.6 N m as joint 5's amplitude):

| route | one, two cores [s] | 32, two cores [s] | one, H100 [s] | 32, H100 [s] |
| --- | ---: | ---: | ---: | ---: |
| PUMA A, backpropagation | 0.025 | 0.20 | 0.18 | 0.17 |
| PUMA A, in turns | 0.22 | 6.4 | 0.28 | 0.36 |
| PUMA B, backpropagation | 0.050 | 0.28 | 0.17 | 0.21 |
| PUMA B, in turns | 0.28 | 9.7 | 0.31 | 0.43 |

Backpropagation needs no pattern after its normal equations are there. PERAL needs every pattern in
every epoch: one training alone keeps two cores busy, and 32 take about 30 times as long. A GPU
does 32 in the time of one. With PERAL in most epochs (25 after every 20 of backpropagation), the
H100 takes 3.5 s for 32. Training then ends at 1.01 (A) and 1.09 (B) of the direct solve's ε in the
median, and at 1.02 and 1.10 in the worst seed.

PERAL alone does not end there. A weight keeps its sign under PERAL: one that has the wrong sign at
the hand-over ends at zero. PERAL also comes to rest elsewhere than least squares: started at the
true coefficients, it moves away from them ([tolerances of
weights](peral.md#tolerances-of-weights)).
"""

_ROUTE = """\
## The thesis's own route

This training follows Section 7.5 to the letter. Backpropagation runs until ε is that of Ar+LS on
the training patterns. Bouts of both rules follow until neither lowers ε by 0.001 N m in an epoch.
Pairs in possible backlash (Eqn. 2.5-7) are excluded from everything, and slow pairs from the
friction subnetworks (7.2.2). Then thresholds are taken from the residuals, and training goes on.
"When PERAL begins" is ε of Ar+LS on the same pairs.
"""

_ROUTE_RESULT = """\
Three things keep the letter from the thesis's 0.25 and 0.31 N m on these machines.

- The end: where an epoch gains less than 0.001 N m, thousands of such epochs are still to come.
- The mask of backlash: it takes half of the pairs by the sign of their torque, which correlates
  with what the model lacks. Shuffled over time, the same mask costs next to nothing (`python -m
  scripts.studies.training.masks`).
- Slow pairs: joints that stand still or nearly so. Their friction does not average out over the
  training set, and the sign of the smoothed velocity is wrong at up to two thirds of them. If they
  are excluded from friction only, they spoil the other subnetworks.
"""

_THRESHOLDS = """\
## Thresholds of static friction

The machines' static friction is insignificant from the speeds of Figs. B.6-1 and B.6-2 on: it was
made so. `scripts/studies/thresholds.py` takes thresholds from the residuals, as 7.5 does by eye.
"Seen" says whether the criterion finds static friction at all. Where it does not, the speed "from
residuals" is no finding: it is the least that is looked at, a hundredth of the joint's top speed.
The last column is how many samples a joint takes from rest to the thesis's speed, in the median.
"""

_THRESHOLDS_WHY = """\
The last three columns say why so few are seen. In friction by Eqn. 2.5-4, the criterion sees the
ramps of every joint that has them. In the rotors' true friction, without any smoothing or noise,
asymmetry and the compliant wrist hide some: they are no function of the rotor's speed alone. The
rest has to be seen through smoothing that is as wide as the way from rest to that speed, and next
to backlash.

What would better thresholds gain? The fit of the table above, under others:
"""

_THRESHOLDS_END = """\
Automatic thresholds change little, since most joints do not show theirs. Nor do the right ones,
those of Fig. B.6: ε changes by less than 2 % on both machines.
"""


def page() -> str:
    """The page as text."""
    parts = [_INTRODUCTION]
    for letter in "ab":
        parts += [f"### PUMA {letter.upper()}\n", _table(f"errors_{letter}")]
    parts += [_EPSILON, _HAND]
    for letter in "ab":
        parts += [f"PUMA {letter.upper()}:\n", _table(f"hand_{letter}")]
    parts.append(_TRAINED)
    for letter in "ab":
        parts += [f"### PUMA {letter.upper()}, trained\n", _table(f"training_{letter}")]
    parts += [_TRAINED_RESULT, _ROUTE]
    for letter in "ab":
        parts += [f"PUMA {letter.upper()}:\n", _table(f"letter_{letter}")]
    parts += [_ROUTE_RESULT, _INTERVALS, _table("intervals"), _INTERVALS_RESULT]
    parts += [_LINEARITY, _table("demands"), _WEAK, _table("weak_motors"), _WEAK_RESULT]
    parts.append(_THRESHOLDS)
    for letter in "ab":
        parts += [f"PUMA {letter.upper()}:\n", _table(f"thresholds_{letter}")]
    parts.append(_THRESHOLDS_WHY)
    for letter in "ab":
        parts += [f"PUMA {letter.upper()}:\n", _table(f"threshold_fits_{letter}")]
    parts.append(_THRESHOLDS_END)
    return "\n".join(parts)


def _table(name: str) -> str:
    """A stored table in Markdown, numbers to four digits; text to the left."""
    rows = results.rows("demo", f"{name}.csv")
    heads = list(rows[0])
    cells = [[_cell(row[head]) for head in heads] for row in rows]
    numeric = [all(_number(row[head]) is not None for row in rows) for head in heads]
    rule = ["---:" if right else "---" for right in numeric]
    return "".join(f"| {' | '.join(row)} |\n" for row in (heads, rule, *cells))


def _cell(text: str) -> str:
    number = _number(text)
    if number is None or text.lstrip("-").isdigit():
        return {"True": "yes", "False": "no"}.get(text, text.replace("|", "\\|"))
    return "" if number != number else f"{number:.4g}"


def _number(text: str) -> float | None:
    try:
        return float(text or "nan")
    except ValueError:
        return None


def main(argv: Sequence[str] | None = None) -> int:
    parser = argparse.ArgumentParser(
        description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter
    )
    parser.add_argument("-o", "--output", type=Path, default=PAGE, help="docs/experiment.md")
    options = parser.parse_args(argv)
    options.output.write_text(page(), encoding="utf-8")
    print(f"wrote {options.output}")
    return 0


if __name__ == "__main__":
    raise SystemExit(main())
