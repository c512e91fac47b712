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

`make demo` repeats the thesis's experiment on two simulated machines, [PUMA A and B](puma_a_b.md),
with every disturbance of Section 7.2. This page has its tables; `build/demo/index.html` has the
figures, coefficients and all else. It is written by `scripts/tools/thesis/experiment_page.py` from
the tables of one run (`make demo`, seed 1).

## Torque errors

Mean moduli of the torque error in the comparison trajectory, and the error cost ε, half the root
mean square over joints [N m] (Figs. 7.6-3 and 7.6-4). Ar+LS: links of Armstrong et al., friction of
Leahy and Saridis. Ar+Rg: the same links, regressed friction. CSLC trained: the [thesis's
route](#the-thesiss-own-route), which on these machines ends long before the minimum, at errors
larger than with any other coefficients here. CSLC: the direct solve, under settings that `jaxcslc
identify` would choose. True: the machine's own coefficients, in a model without its disturbances.
What they leave is about what any model of this form leaves; a fit may make up for a part of a
disturbance.
"""

_EPSILON = """\
One ε, judged in two ways. *mean ε* is judged as in the thesis, alike for both machines: positions
smoothed by splines of 17 samples, the mean of the demands before and after a sample, joints that
move faster than 0.01 rad/s. *As jaxcslc identify judges*: the recording is prepared by the settings
that were chosen for the fit, which differ in the speed from which on a joint counts. The command
gives the same number of free coefficients, which possible bodies may replace by default:

```sh
.venv/bin/jaxcslc identify puma560 build/demo/puma_a_training.csv \\
    --validate build/demo/puma_a_comparison.csv --possible never
```
"""

_INTERVALS = """\
## Intervals of the coefficients

How many of the 43 intervals of 95 % contain the machine's true coefficient, by what they allow for:
the standard error alone, one cause of [systematic errors](uncertainty.md#systematic-errors) beside
it, or all of them, as `jaxcslc identify` prints them:
"""

_INTERVALS_RESULT = """\
Of 43 intervals, 95 % are 41. Those of the standard error alone fall short. The viscous friction of
the wrist is within 1 % of the truth on both machines, since a sample has the mean of the demands
before and after it. Held-out errors do not show that here: by them alone, it would be the demand at
the sample for PUMA A and the one before for PUMA B, and joint 6's viscous friction would be wrong
by 12 and 6.8 %
([which torque belongs to a sample](recordings.md#which-torque-belongs-to-a-sample)). The intervals
that do not contain the truth are those of PUMA A's kM17 and PUMA B's kM25.
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
What if the premise does not hold? The same machine with weaker motors (the limits of
`sim.DISTURBANCES`, of which the training trajectory exceeds all but joint 2's), identified from a
training recording of its own and judged on the same comparison recording [N m]:
"""

_WEAK_RESULT = """\
The error grows a little: pairs beyond the limits are many, but the curve leaves the line slowly.
To leave them out is worse: a third of the pairs is lost, and those that stay are chosen by their
torque.
"""

_ROUTE = """\
## The thesis's own route

Section 7.5 trains the network, from zero weights: backpropagation until ε is that of Ar+LS on the
training patterns, then bouts of both rules until neither lowers ε by 0.001 N m in an epoch. Pairs
in possible backlash (Eqn. 2.5-7) and below a hundredth of each joint's top speed are left out;
then thresholds are taken from the residuals, and training goes on. "When PERAL begins" is ε at
the end of backpropagation's first bout. The last column is the least squares solution on the same
patterns, which training without end would come near.
"""

_ROUTE_RESULT = """\
Two things keep the route from the thesis's 0.25 and 0.31 N m on these machines. Training ends long
before the minimum: where an epoch gains less than 0.001 N m, thousands of such epochs are still to
come (`scripts/studies/training/cslc.py` goes on to smaller reductions). And the mask of backlash
takes half of the pairs by the sign of their torque, which biases any fit to the others, the direct
solve included ([the mask](simulator.md#quality-of-the-backlash-mask)).
"""

_THRESHOLDS = """\
## Thresholds of static friction

The machines' static friction is insignificant from the speeds of Figs. B.6-1 and B.6-2 on: it was
made so. `jc.refine_thresholds` takes thresholds from the residuals, as 7.5 does by eye. "Seen" says
whether the criterion finds static friction at all. Where it does not, the speed "from residuals" is
no finding: it is the least that is looked at, a hundredth of the joint's top speed. The last column
is how many samples a joint takes from rest to the thesis's speed, in the median.
"""

_THRESHOLDS_WHY = """\
The last three columns say why so few are seen. In friction by Eqn. 2.5-4, the criterion sees the
ramps of every joint that has them. In the rotors' true friction, without any smoothing or noise,
asymmetry and the compliant wrist hide some: they are no function of the rotor's speed alone. What
is left has to be seen through smoothing that is as wide as the way from rest to that speed, and
beside backlash.

What would better thresholds gain? The fit of the table above, under others:
"""

_THRESHOLDS_END = """\
Automatic thresholds change little, since most joints do not show theirs. Nor are the right ones,
those of Fig. B.6, better than what cross-validation chooses (`jc.choose_settings`): in this run
they take a fifth off PUMA A's error and nothing off PUMA B's; with `--seed 3` and `--seed 5`,
where cross-validation chose a tenth of top speed, they add more than a tenth to PUMA A's.
"""


def page() -> str:
    """The page as text."""
    parts = [_INTRODUCTION]
    for letter in "ab":
        parts += [f"### PUMA {letter.upper()}\n", _table(f"errors_{letter}")]
    parts += [_EPSILON, _INTERVALS, _table("intervals"), _INTERVALS_RESULT]
    parts += [_LINEARITY, _table("demands"), _WEAK, _table("weak_motors")]
    parts += [_WEAK_RESULT, _ROUTE]
    for letter in "ab":
        parts += [f"### PUMA {letter.upper()}, trained\n", _table(f"training_{letter}")]
    parts += [_ROUTE_RESULT, _THRESHOLDS]
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
