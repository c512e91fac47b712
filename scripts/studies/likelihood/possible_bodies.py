"""Possible bodies in the search of maximum likelihood, beside those nearest to a fit without them.

Two joints with counts of 5e-5 rad are sampled at 100 Hz: three seconds of a small motion with
strong torque noise, ten of a large one, and ten of a large one with a single sine a joint. The
robot's file has no links, or links whose masses and inertias are 25 % too large and 20 % too small.
Over seeds, the RMS torque error on faster motion of regression on smoothed motion, of maximum
likelihood without bodies (`LikelihoodFit.free`), of the bodies nearest to it
(`jaxcslc.physical_parameters`), and of those of the search (`MaximumLikelihood(possible=True)`);
the greatest change of a coefficient by the constraint in standard errors; and in how many
recordings the search's bodies have a smaller error than no bodies.

Rows of finished seeds are kept in `rows.jsonl`; an interrupted run goes on from there.
"""

import argparse
import dataclasses
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
from scripts.studies.tables import grouped


jc.enable_x64()

INTERVAL, COUNT = 0.01, 5e-5  # s, rad
VISCOUS = (0.3, 0.2)  # N m s/rad
SPEEDS, FASTER, JUDGED = (1.3, 2.1), (2.3, 3.1), (1.2, 1000)  # rad/s, rad/s, (rad, samples)
FILES = {"none": None, "wrong": (1.25, 0.8)}  # factors of masses and inertias


class Case(NamedTuple):
    """A recording: amplitude [rad], samples, torque noise [N m], and sines a joint."""

    amplitude: float
    samples: int
    noise: float
    sines: int = 2


CASES = {
    "3 s, 0.3 rad, 0.2 N m": Case(0.3, 300, 0.2),
    "10 s, 1.2 rad, 0.05 N m": Case(1.2, 1000, 0.05),
    "the same, one sine a joint": Case(1.2, 1000, 0.05, 1),
}
# Of the sines of a joint: parts of the amplitude, multiples of its speed, phases of both joints.
SINES = ((0.7, 1.0, (0.3, 1.1)), (0.3, 2.7, (1.0, 2.0)))


def links_of(factors: Sequence[float] = (1.0, 1.0)) -> tuple[jc.LinkParameters, ...]:
    """The arm's links, masses and inertias times a factor each."""
    return tuple(
        jc.LinkParameters(
            factor * mass, np.array([0.05, 0.02, 0.1]), factor * 0.01 * np.eye(3), 0.05
        )
        for mass, factor in zip((2.0, 1.5), factors, strict=True)
    )


def network_of(factors: Sequence[float] | None) -> jc.CSLC:
    """Return the network of an arm whose file has links, times factors, or none."""
    robot = jc.Manipulator.from_modified_dh(
        [(0, 0, 0, 0), ("-pi/2", 0.1, 0, 0)], gravity=(0, -9.81, 0), name="elbow"
    )
    links = None if factors is None else links_of(factors)
    return jc.derive(
        dataclasses.replace(robot, links=links).with_friction("viscous"), lengths="numeric"
    )


def motion(
    amplitude: float, samples: int, speeds: tuple[float, float], sines: int = 2
) -> tuple[Float[np.ndarray, "samples 2"], ...]:
    """Sums of sines: positions, velocities, accelerations [rad, rad/s, rad/s²]."""
    t = INTERVAL * np.arange(samples)[:, None]
    q, qd, qdd = np.zeros((3, samples, 2))
    for part, multiple, phase in SINES[:sines]:
        w = multiple * np.array(speeds)
        sine, cosine = (amplitude * part * f(w * t + phase) for f in (np.sin, np.cos))
        q, qd, qdd = q + sine, qd + w * cosine, qdd - w**2 * sine
    return q, qd, qdd


def torque_error(
    network: jc.CSLC, k: Float[np.ndarray, " p"], true: Float[np.ndarray, " p"]
) -> float:
    """The RMS torque error of coefficients on the faster motion [N m]."""
    return float(
        np.sqrt(np.mean(np.asarray(network.torque(k - true, *motion(*JUDGED, FASTER))) ** 2))
    )


def row_of(network: jc.CSLC, case: Case, seed: int) -> dict[str, Any]:
    """Return the row of one recording."""
    rng = np.random.default_rng(seed)
    true = np.asarray(network.coefficients_from(links_of(), viscous=VISCOUS))
    q, *rates = motion(case.amplitude, case.samples, SPEEDS, case.sines)
    torque = np.asarray(network.torque(true, q, *rates)) + case.noise * rng.normal(size=q.shape)
    recording = jc.Recording(
        INTERVAL * np.arange(case.samples), COUNT * np.round(q / COUNT), torque
    )
    result = jc.MaximumLikelihood(torque_sampling="sampled", possible=True).fit(network, recording)
    free = result.free
    assert free is not None
    settings = jc.Settings().with_options(torque_alignment="sample")
    regression = settings.fit(network, settings.patterns(recording))
    change = np.abs(np.asarray(result.k) - np.asarray(free.k))
    return {
        "regression": torque_error(network, np.asarray(regression.k), true),
        "without": torque_error(network, np.asarray(free.k), true),
        "nearest": torque_error(network, jc.physical_parameters(network, free).k, true),
        "search": torque_error(network, np.asarray(result.k), true),
        "moves": float(np.max(change / np.asarray(free.standard_error))),
        "converged": result.converged,
    }


def table(rows: Sequence[dict[str, Any]]) -> list[list[str]]:
    """A line per kind of recording and file, the head first; median, and greatest."""
    lines: list[list[str]] = []
    for case, file in dict.fromkeys((row["case"], row["file"]) for row in rows):
        part = [row for row in rows if (row["case"], row["file"]) == (case, file)]
        values = {
            name: [row[name] for row in part]
            for name in ("regression", "without", "nearest", "search", "moves")
        }
        nearer = sum(row["search"] < row["without"] for row in part)
        lines.append(
            [
                case,
                file,
                *(f"{np.median(x):.2g}, {np.max(x):.2g}" for x in values.values()),
                f"{nearer} of {len(part)}",
                f"{sum(row['converged'] for row in part)} of {len(part)}",
            ]
        )
    header = ["recording", "file", "regression [N m]", "without bodies [N m]"]
    header += ["nearest bodies [N m]", "search [N m]", "moves [standard errors]"]
    header += ["nearer than without", "converged"]
    return [header, *lines]


def study(options: argparse.Namespace) -> int:
    """Makes what is missing, prints the table and writes the rows."""
    finished = Rows(
        options.output / "rows.jsonl", ("case", "file", "seed"), made_of({}, [Path(__file__)])
    )
    seeds = command.seeds_of(options)
    networks = {file: network_of(factors) for file, factors in FILES.items()}
    jobs = [(case, file, seed) for case in CASES for file in FILES for seed in seeds]
    for case, file, seed in command.progress(jobs, desc="recordings", unit="recording"):
        if (case, file, seed) not in finished:
            row = row_of(networks[file], CASES[case], seed)
            finished.add({"case": case, "file": file, "seed": seed, **row})
    rows = [finished[job] for job in jobs]
    head, *lines = table(rows)
    print(text_table(head, lines, left=head[:2]))
    tables = {"errors": grouped([head, *lines])}
    store(options, "possible_search", f"seeds {seeds[0]} to {seeds[-1]}", tables)
    for file, network in networks.items():
        if network.robot.links is not None:
            k, true = (
                np.asarray(network.coefficients_from(links, viscous=VISCOUS))
                for links in (network.robot.links, links_of())
            )
            print(f"file {file!r}: its own links leave {torque_error(network, k, true):.3f} N m")
    write_csv(options.output / "seeds.csv", rows)
    print(f"wrote {options.output / 'seeds.csv'}")
    return 0


def main(argv: Sequence[str] | None = None) -> int:
    parser = command.new_parser(__doc__, "likelihood_bodies")
    command.add_seeds(parser, 20)
    command.add_store(parser)
    options = command.parse(parser, argv, seeds=1)
    command.require_least(parser, options, seeds=1, first=0)
    return command.run(
        parser,
        lambda: study(options),
        options.output / "rows.jsonl",
        seconds=30.0 + 12.0 * options.seeds,
    )


if __name__ == "__main__":
    raise SystemExit(main())
