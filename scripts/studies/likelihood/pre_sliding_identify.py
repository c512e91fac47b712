"""Dry friction that yields before it slides: `identify` with and without a choice of lengths.

A pendulum of 0.4 kg m² under position control, 20 s at 200 Hz along two sines, with many reversals;
held torques, counts of 1e-4 rad, torque noise of 0.02 N m. Dry friction of 0.8 N m follows Dahl's
equation over a length of 30, 10 or 2 mrad, integrated by Runge and Kutta's method in steps of
0.2 ms. Reports, with defaults:

- `regression`, `likelihood`: `identify(..., friction="auto")` by either estimator;
- `likelihood, step`: the same terms and static friction, dry friction following the sign of
  velocity, as for a joint that does not yield.

Torque errors are those of the pendulum between identified and true coefficients, where it slides.
Rows of finished seeds are kept in `rows.jsonl`; an interrupted run goes on from there.
"""

import time
from collections.abc import Iterator, Sequence
from typing import Any

import numpy as np

import jaxcslc as jc
from jaxcslc.selection import FrictionChoice
from jaxcslc.uncertainty import uncertainty_interval
from scripts.studies import command
from scripts.studies.likelihood.dahl_pendulum import (
    INERTIA,
    INTERVAL,
    WEIGHT,
    after_interval,
    counted,
    pendulum,
    recording,
    study_lengths,
    torque_error,
)


jc.enable_x64()

LENGTHS = (0.03, 0.01, 2e-3)
# Of the position controller, at 30 rad/s.
_STIFFNESS, _DAMPING = 360.0, 17.0
_SIZE, _RATE = np.array([0.25, 0.12]), np.array([2.0, 5.3])


def controlled(length: float, seed: int, samples: int) -> jc.Recording:
    """A recording of the pendulum; `length` of pre-sliding [rad]."""
    rng = np.random.default_rng(seed)
    phase = rng.uniform(0.0, 2.0 * np.pi, 2)
    size, rate = _SIZE * rng.uniform(0.8, 1.2, 2), _RATE * rng.uniform(0.8, 1.2, 2)
    t = INTERVAL * np.arange(samples)
    angle = rate * t[:, None] + phase
    path, speed = np.sin(angle) @ size, np.cos(angle) @ (size * rate)
    feedforward = -INERTIA * np.sin(angle) @ (size * rate**2) + WEIGHT * np.cos(path)
    state, before = np.array([path[0], speed[0], 0.0]), path[0]
    counts, torque = np.zeros(samples), np.zeros(samples)
    for i in range(samples):
        counts[i] = counted(state[0])
        velocity, before = (counts[i] - before) / INTERVAL if i else speed[0], counts[i]
        held = feedforward[i] + _STIFFNESS * (path[i] - counts[i])
        torque[i] = held + _DAMPING * (speed[i] - velocity)
        state = after_interval(state, torque[i], length)
    return recording(counts, torque, rng)


def rows_of(length: float, seed: int, samples: int) -> Iterator[dict[str, Any]]:
    """One row a report."""
    (network, true), recorded = pendulum(), controlled(length, seed, samples)
    expected = dict(zip(network.names, true.tolist(), strict=True))
    terms: jc.CSLC | None = None
    reports: dict[str, str] = {
        "regression": "least-squares",
        "likelihood": "maximum-likelihood",
    }
    for name, estimator in reports.items():
        started = time.process_time()
        report = jc.identify(
            network, recorded, estimator=estimator, friction="auto", possible="never"
        )
        terms = report.network
        yield _row(name, report, expected, started, length, seed)
    assert terms is not None
    started = time.process_time()
    with_step = FrictionChoice(terms, ()).with_static_friction().network
    report = jc.identify(with_step, recorded, estimator="maximum-likelihood", possible="never")
    yield _row("likelihood, step", report, expected, started, length, seed)


def _row(
    name: str,
    report: jc.Report,
    expected: dict[str, float],
    started: float,
    length: float,
    seed: int,
) -> dict[str, Any]:
    states = report.pre_sliding
    fit = report.fit if states is None else states.fit
    true = np.array([expected.get(name, 0.0) for name in report.network.names])
    systematic = report.systematic if states is None or report.presliding_distance.any() else None
    interval = uncertainty_interval(fit, systematic)
    low, high = np.asarray(interval).T
    known = np.array([name in expected for name in report.network.names])
    return {
        "length": length,
        "seed": seed,
        "report": name,
        "error": torque_error(report.network, np.asarray(fit.k) - true),
        "inside": float(100 * np.mean(((low <= true) & (true <= high))[known])),
        "used_length": 0.0 if states is None else float(states.presliding_distance[0]),
        "seconds": time.process_time() - started,
    }


def table(rows: Sequence[dict[str, Any]], length: float) -> list[list[str]]:
    """Return the table of one length, the head first: torque errors, intervals, used lengths."""
    lines: list[list[str]] = []
    of_length = [row for row in rows if row["length"] == length]
    for name in dict.fromkeys(row["report"] for row in of_length):
        part = [row for row in of_length if row["report"] == name]
        error = [row["error"] for row in part]
        used = [row["used_length"] for row in part if row["used_length"]]
        lines.append(
            [
                name,
                *(f"{f(error):.2g}" for f in (np.median, np.max)),
                f"{np.mean([row['inside'] for row in part]):.0f} %",
                f"{len(used)} of {len(part)}",
                f"{1e3 * np.median(used):.3g}" if used else "",
                f"{np.median([row['seconds'] for row in part]):.2f}",
            ]
        )
    header = [f"{1e3 * length:g} mrad", "torque error [N m], median", "greatest"]
    header += ["intervals with truth", "with a length", "length used [mrad]", "s"]
    return [header, *lines]


def main(argv: Sequence[str] | None = None) -> int:
    parser = command.new_parser(__doc__, "likelihood_pre_sliding_identify")
    command.add_seeds(parser, 8)
    parser.add_argument("--samples", type=int, default=4000, help="of a recording, 5 ms apart")
    command.add_store(parser)
    options = command.parse(parser, argv, seeds=1)
    command.require_least(parser, options, seeds=1, first=0, samples=800)
    return command.run(
        parser,
        lambda: study_lengths(
            options, LENGTHS, __file__, "report", "likelihood, step", rows_of, table
        ),
        options.output / "rows.jsonl",
        seconds=3 * 20.0 * options.seeds,
    )


if __name__ == "__main__":
    raise SystemExit(main())
