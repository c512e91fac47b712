"""Figures that the README and guides quote are those that studies have stored.

A quote is a phrase of a page, with `{}` for each number, and for each the stored figure that it
rounds (`scripts/tools/stored_figures.py`). What a page says in words is a claim: the figures, and
what must hold of them.
"""

import re
from collections.abc import Callable
from dataclasses import dataclass
from pathlib import Path

import pytest

from scripts.studies.stored import table
from scripts.tools.stored_figures import cell_named, numbers_of, stored


ROOT = Path(__file__).parents[1]


@dataclass(frozen=True)
class Quote:
    """Numbers of a page, each with the reference of the figure that it rounds."""

    page: str
    phrase: str
    figures: tuple[str, ...]


@dataclass(frozen=True)
class Claim:
    """What a page says in words or in rounded numbers, and what stored figures it rests on.

    - `holds`: whether it is right, of the figures of each reference.
    """

    page: str
    phrase: str
    figures: tuple[str, ...]
    holds: Callable[..., bool]


def real_robots(arm: str, *rows: str) -> tuple[str, ...]:
    return tuple(f"real_robots/{arm} | {row} | mean" for row in rows)


_OURS = ("identify", "identify, best")
_OFFSETS = "usual pipeline, 20 Hz, WLS and offsets"
# Rows of the README, tables of real arms, and the variant of the usual pipeline that is best on
# the judged motion.
_REAL_CASES = (
    ("KUKA KR300, motion B", "KUKA KR300, B", "usual pipeline, 20 Hz, WLS"),
    ("KUKA KR300, motion C", "KUKA KR300, C", _OFFSETS),
    ("KUKA LWR4+, faster motion", "KUKA LWR4+, hw3", "usual pipeline, 20 Hz, ridge to the file"),
    ("KUKA LWR4+, same motion", "KUKA LWR4+, hw2", _OFFSETS),
    ("Franka Panda, last third", "Franka Panda, last third", _OFFSETS),
    ("Stäubli TX40, last third", "Stäubli TX40, last third", _OFFSETS),
)
QUOTES = (
    Quote(
        "README.md",
        "on new motion is {} % instead of {} %",
        tuple(reversed(real_robots(*_REAL_CASES[0][1:], "identify"))),
    ),
    Quote(
        "README.md",
        "The case that it loses is a repeated motion of a KUKA LWR4+, with {} % instead of {} %",
        tuple(reversed(real_robots(*_REAL_CASES[3][1:], "identify"))),
    ),
    *(
        Quote(
            "README.md",
            f"| {name} | {{}} | {{}} | {{}} |",
            real_robots(arm, pipeline, *_OURS),
        )
        for name, arm, pipeline in _REAL_CASES
    ),
    *(
        Quote(
            "docs/real_robots.md",
            f"{arm} ({{}} %, pipeline {{}} %)",
            real_robots(arm, "identify", pipeline),
        )
        for _, arm, pipeline in _REAL_CASES
    ),
    Quote(
        "docs/excitation_evidence.md",
        "their ratio is {} in the median for least squares and {} for maximum likelihood",
        tuple(
            f"excitation/predicted | {estimator} | median"
            for estimator in ("regression", "maximum likelihood")
        ),
    ),
    Quote(
        "docs/friction_evidence.md",
        "errors over all samples are {} {} {} {} {} {} {} % of the torque. With the defaults they"
        " are {} {} {} {} {} {} {} %",
        tuple(
            f"real_robots/Franka Panda, last third | {row} | {joint}"
            for row in ("identify, friction auto", "identify")
            for joint in range(1, 8)
        ),
    ),
    Quote(
        "docs/scale.md",
        "agree with those of QR to {} of a standard error for well-conditioned motion",
        ("factorisation/motions | a hundredth of it | difference",),
    ),
    Quote(
        "docs/several.md",
        "600,000 samples of a geared 7-joint arm take {} to {} s and {} to {} GB",
        (
            "benchmark identify.600000_samples : min",
            "benchmark identify.600000_samples : max",
            "benchmark identify.600000_samples.peak_memory : min",
            "benchmark identify.600000_samples.peak_memory : max",
        ),
    ),
    Quote(
        "docs/likelihood_evidence.md",
        "takes {} s on two cores in a later run, {} s of processor time",
        (
            "benchmark likelihood.3300_samples.later_run : min",
            "benchmark likelihood.3300_samples.later_run.processor : min",
        ),
    ),
    Quote(
        "docs/likelihood_evidence.md",
        "60,000 samples take {} s and {} GB",
        (
            "benchmark likelihood.60000_samples : min",
            "benchmark likelihood.60000_samples.peak_memory : min",
        ),
    ),
    Quote(
        "docs/scale_evidence.md",
        "`identify` of 3,300 samples takes {} to {} s of processor time in a later run",
        (
            "benchmark identify.puma560.later_run.processor : min",
            "benchmark identify.puma560.later_run.processor : max",
        ),
    ),
    Quote(
        "docs/scale_evidence.md",
        "Two cores stream {} to {} million.",
        ("benchmark stream.rate : min", "benchmark stream.rate : max"),
    ),
    Quote(
        "docs/report.md",
        "the last frame of a real KUKA KR300 was {} mm off with physically consistent coefficients,"
        " and {} mm with unconstrained ones",
        tuple(
            f"kr300_simulated/horizons | 1 & {row} | last frame [mm]"
            for row in ("consistent", "unconstrained")
        ),
    ),
    Quote(
        "docs/servo.md",
        "were found with RMS errors of {} % in gains, {} % in armatures and {} ms in delays",
        tuple(f"servo/five | {name} | RMS error" for name in ("gain", "armature", "delay")),
    ),
    Quote(
        "docs/servo.md",
        "A real SO-101 was simulated to {} mrad on new motion",
        ("servo_sage/joints | identified drives | joints 1 to 5",),
    ),
    Quote(
        "docs/payload.md",
        "With every disturbance, errors reached {} %",
        ("payload/disturbances | mass after 2 s [%] | all disturbances : greatest",),
    ),
    Quote(
        "docs/control.md",
        "brings the arm to rest, in a study within {} s",
        ("faults/faults | stuck encoder | at rest after [s] : greatest",),
    ),
    Quote(
        "docs/estimators.md",
        "contain the truth in {} % of cases, and in {} % with systematic errors",
        tuple(
            f"estimators/all disturbances | {row} | 95 % intervals that hold"
            for row in ("least squares", "least squares, with systematic errors")
        ),
    ),
)

_DEFAULT = "prior, torque offsets at all joints, the default"
_SECONDS = "real_robots/{} | {} | processor [s]"
CLAIMS = (
    Claim(
        "README.md",
        "A report of 3,300 samples takes a few seconds on two cores",
        ("benchmark identify.puma560.later_run",),
        lambda seconds: all(1 < value < 5 for value in seconds),
    ),
    Claim(
        "docs/simulator_evidence.md",
        "Trained networks have 4 % more torque error than direct solutions in the median",
        ("thousand/errors | trained over solved | median",),
        lambda ratio: round(100 * (ratio[0] - 1)) == 4,
    ),
    Claim(
        "docs/likelihood_evidence.md",
        "the torque error of maximum likelihood is one twentieth of that of least squares",
        (
            "likelihood/torque | maximum likelihood | median",
            "likelihood/torque | regression, masks, averaged splines, 15 Hz filter | median",
        ),
        lambda ours, usual: 18 < usual[0] / ours[0] < 22,
    ),
    Claim(
        "docs/robots.md",
        "An arm of seven joints takes less than a second",
        ("benchmark derive.panda",),
        lambda seconds: all(value < 1 for value in seconds),
    ),
    Claim(
        "docs/payload.md",
        "the mass was known to less than 1 % after one second of motion",
        (
            "payload/disturbances | mass after 1 s of motion [%]"
            " | static friction as well : greatest",
        ),
        lambda errors: errors[0] < 1,
    ),
    Claim(
        "docs/control.md",
        "every fault of three kinds at every joint was named rightly",
        tuple(
            f"faults/faults | {fault} | named rightly : {which}"
            for fault in ("lost samples", "stuck encoder", "reversed torque")
            for which in ("least", "greatest")
        ),
        lambda *counts: len({count for (count,) in counts}) == 1,
    ),
    Claim(
        "docs/checks.md",
        "104 of 108 causes were named first",
        tuple(
            f"checks/causes | {cause} | named first : {which}"
            for cause in (
                "units",
                "sign of a joint",
                "late torque",
                "gap",
                "spikes",
                "stale rows",
                "jitter",
                "clipping",
                "wrong robot",
                "swapped joints",
                "two rates",
                "wrong payload",
            )
            for which in ("least", "greatest")
        ),
        lambda *counts: (
            sum(count for (count,) in counts[::2]) == 104
            and sum(count for (count,) in counts[1::2]) == 108
        ),
    ),
    Claim(
        "docs/likelihood.md",
        "The command takes up to twice as long as with least squares",
        tuple(
            _SECONDS.format(arm, row)
            for arm in ("KUKA KR300, B", "Franka Panda, last third", "Stäubli TX40, last third")
            for row in ("identify, maximum likelihood", "identify")
        ),
        lambda *seconds: all(
            1 < a / b < 2.2 for (a,), (b,) in zip(seconds[::2], seconds[1::2], strict=True)
        ),
    ),
    *(
        Claim(
            page,
            "takes two to three times as long",
            tuple(
                _SECONDS.format(arm, row)
                for arm in (
                    "KUKA KR300, B",
                    "KUKA LWR4+, hw3",
                    "Franka Panda, last third",
                    "Stäubli TX40, last third",
                )
                for row in ("identify, best", "identify")
            ),
            lambda *seconds: all(
                1.5 < a / b < 3.5 for (a,), (b,) in zip(seconds[::2], seconds[1::2], strict=True)
            ),
        )
        for page in ("README.md", "docs/tutorial.md")
    ),
    Claim(
        "README.md",
        "better than filtering and weighted least squares in five of six cases",
        tuple(
            reference
            for _, arm, pipeline in _REAL_CASES
            for reference in real_robots(arm, pipeline, "identify")
        ),
        lambda *errors: (
            sum(ours < usual for (usual,), (ours,) in zip(errors[::2], errors[1::2], strict=True))
            == 5
        ),
    ),
    Claim(
        "docs/control.md",
        "takes about 0.1 ms in Python, and less than 1 µs in exported C",
        tuple(
            f"control_time/steps | {row} | {arm}"
            for row in (
                "computed torque with velocity estimation, compiled Python",
                "computed torque in exported C (`jc.c_code`)",
            )
            for arm in ("PUMA 560", "Panda")
        ),
        lambda *times: (
            all(90 < time < 150 for (time,) in times[:2]) and all(time < 1 for (time,) in times[2:])
        ),
    ),
    Claim(
        "docs/estimators.md",
        "instruments have 22 times less error than least squares",
        tuple(
            f"estimators/Gaussian noise, hardly smoothed | {row} | ε [N m]"
            for row in ("least squares", "instruments, known controller")
        ),
        lambda least, instruments: round(least[0] / instruments[0]) == 22,
    ),
    Claim(
        "docs/benchmarks.md",
        "two to seven times as fast as Pinocchio computes its regressor in C++",
        ("benchmark puma560.ratio", "benchmark panda.ratio"),
        lambda *ratios: all(2 < one < 7.5 for arm in ratios for one in arm),
    ),
    Claim(
        "docs/generalisation.md",
        "more than fifty times that of the CSLC",
        tuple(f"generalisation/networks | tanh {nodes} | over the CSLC's" for nodes in (4, 8, 16)),
        lambda *ratios: all(ratio[0] > 50 for ratio in ratios),
    ),
)


def words(page: str) -> str:
    """Text of a page without line breaks and bold type."""
    return re.sub(r"\s+", " ", (ROOT / page).read_text("utf-8").replace("**", ""))


def figures_of(reference: str) -> list[float]:
    """Stored figures.

    `: min` or `: max` names one of several machines', `: least` or `: greatest` one of several
    numbers of a cell.
    """
    name, _, which = reference.partition(" : ")
    if which in ("least", "greatest"):
        numbers = numbers_of(cell_named(name))
        return [min(numbers) if which == "least" else max(numbers)]
    values = stored(name)
    return [{"min": min, "max": max}[which](values)] if which else values


def rounded_alike(text: str, value: float) -> bool:
    """Whether a number is a stored one, rounded to the digits that it has."""
    mantissa, _, exponent = text.partition("e")
    digit = 10.0 ** (int(exponent or 0) - len(mantissa.partition(".")[2]))
    return abs(float(text) - value) <= 0.5001 * digit


@pytest.mark.parametrize("quote", QUOTES, ids=lambda quote: f"{quote.page} {quote.phrase[:30]}")
def test_quoted_numbers_are_the_stored_ones(quote: Quote) -> None:
    pattern = re.escape(quote.phrase).replace(r"\{\}", r"(\d[\d.]*(?:e-?\d+)?)")
    match = re.search(pattern, words(quote.page))
    assert match is not None, f"{quote.page} does not say: {quote.phrase}"
    for text, reference in zip(match.groups(), quote.figures, strict=True):
        (value,) = figures_of(reference)
        assert rounded_alike(text, value), f"{quote.page}: {text}, stored {value} ({reference})"


@pytest.mark.parametrize("claim", CLAIMS, ids=lambda claim: f"{claim.page} {claim.phrase[:30]}")
def test_claims_hold_of_stored_figures(claim: Claim) -> None:
    assert claim.phrase in words(claim.page)
    values = [figures_of(reference) for reference in claim.figures]
    assert claim.holds(*values), f"{claim.page}: {claim.phrase}, stored {values}"


def test_the_gain_of_the_file_on_new_motion_is_that_of_the_table() -> None:
    by_case = {row[0]: numbers_of(row[1]) for row in table("file_prior_kuka/joints")[1:]}
    without, default = by_case["no prior, no offsets"], by_case[_DEFAULT]
    falls = [100 * (1 - ours / theirs) for theirs, ours in zip(without, default, strict=True)]
    text = f"fall by {min(falls):.0f} to {max(falls):.0f} % per joint"
    assert text in words("docs/file_prior_evidence.md")


def test_ranges_of_summaries_are_those_of_tables() -> None:
    head, *rows = table("systems/coverage")
    low, high = (
        [numbers_of(row[head.index(name)])[0] for row in rows]
        for name in ("least squares", "within 2 errors")
    )
    text = words("docs/systems_evidence.md")
    assert f"{min(high)} to {max(high)} % of the corrected coefficients" in text
    assert f"Least squares alone has {min(low)} to {max(low)} %" in text
    _, *rows = table("intervals/pairs")
    whole = [numbers_of(row[-1])[0] for row in rows if row[1] == "these and systematic errors"]
    text = f"agree in {min(whole):.0f} to {max(whole):.0f} % of cases"
    assert text in words("docs/uncertainty_evidence.md")


def test_lost_joints_of_real_arms_are_counted() -> None:
    _, *rows = table("real_robots/losses")
    lost = sum(len(re.findall(r"\d:", joints)) for *_, joints in rows)
    joints = sum(len(table(f"real_robots/{recording}")[0]) - 3 for recording, *_ in rows)
    assert f"at {lost} of {joints} joints" in words("docs/real_robots.md")


def test_a_wrong_digit_is_noticed() -> None:
    assert rounded_alike("21.9", 21.86) and not rounded_alike("21.9", 21.99)
    assert rounded_alike("4e-10", 4.2e-10) and not rounded_alike("4e-10", 5.1e-10)
