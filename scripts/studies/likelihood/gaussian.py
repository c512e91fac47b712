"""Maximum likelihood of sampled motion with normally distributed position noise and exact torque.

A PUMA 560 with viscous friction follows a random sum of sines, known in closed form, and is read
at 100 Hz for ten seconds: torques are exact values at the samples, positions have noise of one
level. For each level, over seeds, the worst joint's RMS torque error on further motion, the root
mean square of the coefficients' errors over their standard errors, and the share of 95 % intervals
that cover the truth.

The last line is of exact positions and of held torques that belong to their differences: there the
model is exact, and coefficients are right but for rounding. It holds the greatest relative error of
a coefficient.

Rows of finished seeds are kept in `rows.jsonl`; an interrupted run goes on from there.
"""

import argparse
from collections.abc import Sequence
from pathlib import Path
from typing import Any, NamedTuple

import numpy as np
from jaxtyping import Float

import jaxcslc as jc
from jaxcslc._text_table import text_table
from jaxcslc.report import write_csv
from scripts.studies import command
from scripts.studies.rows import Rows, made_of
from scripts.studies.stored import store


jc.enable_x64()

LEVELS = (1e-5, 1e-4)  # of position noise [rad]
INTERVAL, HARMONICS, SLOWEST, AMPLITUDE = 0.01, 5, 0.1, 0.25  # s, -, Hz, rad
# Seeds of motion that coefficients are judged on, and of noise.
_JUDGED, _NOISE = 10_000, 20_000


class Motion(NamedTuple):
    """Time, (samples,), and positions, velocities and accelerations, (samples, n)."""

    time: np.ndarray
    q: np.ndarray
    qd: np.ndarray
    qdd: np.ndarray


def random_motion(seed: int, samples: int, joints: int) -> Motion:
    """A sum of sines of 0.1 to 0.5 Hz, with normally distributed amplitudes."""
    rng = np.random.default_rng(seed)
    time = INTERVAL * np.arange(samples)
    number = np.arange(1, HARMONICS + 1)
    sine, cosine = AMPLITUDE * rng.normal(size=(2, HARMONICS, joints)) / np.sqrt(number)[:, None]
    rate = 2.0 * np.pi * SLOWEST * number
    sines, cosines = np.sin(time[:, None] * rate), np.cos(time[:, None] * rate)
    return Motion(
        time,
        sines @ sine + cosines @ cosine,
        (cosines * rate) @ sine - (sines * rate) @ cosine,
        -(sines * rate**2) @ sine - (cosines * rate**2) @ cosine,
    )


def torque_of(
    network: jc.CSLC, k: Float[np.ndarray, " coefficients"], motion: Motion
) -> Float[np.ndarray, "samples joints"]:
    """Torque along a motion [N m]."""
    return np.asarray(network.torque(k, motion.q, motion.qd, motion.qdd))


def row_of(
    network: jc.CSLC,
    true: Float[np.ndarray, " coefficients"],
    noise: float,
    seed: int,
    samples: int,
) -> dict[str, Any]:
    """Errors of one motion and level of position noise [rad]."""
    joints = network.joint_count
    motion = random_motion(seed, samples, joints)
    drawn = np.random.default_rng(_NOISE + seed).normal(size=motion.q.shape)
    recording = jc.Recording(
        motion.time, motion.q + noise * drawn, torque_of(network, true, motion)
    )
    result = jc.MaximumLikelihood(torque_sampling="sampled").fit(network, recording)
    judged = random_motion(_JUDGED + seed, samples, joints)
    k = np.asarray(result.k)
    error = torque_of(network, k, judged) - torque_of(network, true, judged)
    low, high = np.asarray(result.fit.confidence_interval()).T
    return {
        "torque": float(np.sqrt(np.mean(error**2, axis=0)).max()),
        "deviation": float(
            np.sqrt(np.mean(((k - true) / np.asarray(result.fit.standard_error)) ** 2))
        ),
        "inside": float(np.mean((low <= true) & (true <= high))),
        "converged": result.converged,
    }


def exact_error(
    network: jc.CSLC, true: Float[np.ndarray, " coefficients"], samples: int
) -> tuple[float, bool]:
    """The greatest relative error of a coefficient, and whether the search converged."""
    q = random_motion(0, samples, network.joint_count).q
    first, second = (q[2:] - q[:-2]) / (2 * INTERVAL), np.diff(q, 2, axis=0) / INTERVAL**2
    means = np.asarray(network.torque(true, q[1:-1], first, second))
    # Held torques with these means over the two intervals around each sample.
    held = np.zeros_like(q)
    held[0] = means[0]
    for row, value in enumerate(means):
        held[row + 1] = 2.0 * value - held[row]
    recording = jc.Recording(INTERVAL * np.arange(samples), q, held)
    result = jc.MaximumLikelihood().fit(network, recording)
    return float(np.max(np.abs(np.asarray(result.k) / true - 1.0))), result.converged


def table(rows: Sequence[dict[str, Any]]) -> list[list[str]]:
    """A line per level, the head first."""
    lines: list[list[str]] = []
    for noise in dict.fromkeys(row["noise"] for row in rows):
        part = [row for row in rows if row["noise"] == noise]
        torque = [row["torque"] for row in part]
        deviation = np.sqrt(np.mean([row["deviation"] ** 2 for row in part]))
        lines.append(
            [
                f"{noise:g} rad",
                *(f"{value:.5f}" for value in (np.median(torque), min(torque), max(torque))),
                f"{deviation:.2f}",
                f"{100 * np.mean([row['inside'] for row in part]):.1f} %",
                f"{sum(row['converged'] for row in part)} of {len(part)}",
            ]
        )
    header = [
        "position noise",
        "torque error [N m], median",
        "least",
        "greatest",
        "RMS error over reported",
        "coverage of 95 % intervals",
        "converged",
    ]
    return [header, *lines]


def study(options: argparse.Namespace) -> int:
    """Makes what is missing, prints the table and writes the rows."""
    robot = jc.puma560()
    network = jc.derive(robot.with_friction("viscous"))
    assert robot.links is not None
    true = np.asarray(network.coefficients_from(robot.links, viscous=robot.viscous))
    digest = made_of({"samples": options.samples}, [Path(__file__)])
    finished = Rows(options.output / "rows.jsonl", ("noise", "seed"), digest)
    seeds = command.seeds_of(options)
    for seed in command.progress(seeds, desc="seeds", unit="seed"):
        for noise in LEVELS:
            if (noise, seed) not in finished:
                row = row_of(network, true, noise, seed, options.samples)
                finished.add({"noise": noise, "seed": seed, **row})
    rows = [finished[(noise, seed)] for noise in LEVELS for seed in seeds]
    head, *lines = table(rows)
    print(text_table(head, lines))
    store(options, "gaussian", f"seeds {seeds[0]} to {seeds[-1]}", {"noise": [head, *lines]})
    error, converged = exact_error(network, true, options.samples)
    ended = "converged" if converged else "not converged"
    print(f"exact model: coefficients off by {error:.1e} of their size at most, {ended}")
    write_csv(options.output / "seeds.csv", rows)
    print(f"wrote {options.output / 'seeds.csv'}")
    return 0


def main(argv: Sequence[str] | None = None) -> int:
    parser = command.new_parser(__doc__, "gaussian")
    command.add_seeds(parser, 20)
    parser.add_argument("--samples", type=int, default=1000, help="of each motion, 10 ms apart")
    command.add_store(parser)
    options = command.parse(parser, argv, seeds=2)
    command.require_least(parser, options, seeds=1, first=0, samples=200)
    return command.run(
        parser,
        lambda: study(options),
        options.output / "rows.jsonl",
        seconds=15.0 + options.seeds * 3.0 * options.samples / 1000,
    )


if __name__ == "__main__":
    raise SystemExit(main())
