"""Dry friction that yields before it slides: maximum likelihood with states against the truth.

A pendulum of 0.4 kg m² around rest, 10 s at 200 Hz under held torques of three cosines, with many
reversals; counts of 1e-4 rad, torque noise of 0.02 N m. Dry friction of 0.8 N m follows Dahl's
equation over a length of 30, 2, 0.5 or 0.1 mrad, integrated by Runge and Kutta's method in steps of
0.2 ms. Estimators:

- regression with states, its length included (`fit_pre_sliding`, 20 Hz low pass, all samples);
- maximum likelihood with dry friction as a step;
- the same with states over the length of that regression, and over the true one.

Torque errors are those of the pendulum between fitted and true coefficients, where it slides.
Rows of finished seeds are kept in `rows.jsonl`; an interrupted run goes on from there.
"""

import time
from collections.abc import Iterator, Sequence
from typing import Any

import numpy as np
from jaxtyping import Float

import jaxcslc as jc
from jaxcslc.friction import fit_pre_sliding
from jaxcslc.least_squares import Identification
from scripts.studies import command
from scripts.studies.likelihood.dahl_pendulum import (
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

LENGTHS = (0.03, 2e-3, 5e-4, 1e-4)
_SETTINGS = jc.Settings(jc.Preparation(jc.Butterworth(20.0), threshold_fraction=0.0))


def swing(length: float, seed: int, samples: int) -> jc.Recording:
    """A recording of the pendulum; `length` of pre-sliding [rad]."""
    rng = np.random.default_rng(seed)
    phase, size = rng.uniform(0.0, 2.0 * np.pi, 3), rng.uniform(0.8, 1.2, 3)
    t = INTERVAL * np.arange(samples)
    cosines = np.sin(np.array([1.7, 5.1, 11.0]) * t[:, None] + phase)
    torque = WEIGHT + cosines @ (size * np.array([1.3, 1.0, 0.6]))
    state, path = np.zeros(3), []
    for held in torque:
        path.append(state[0])
        state = after_interval(state, held, length)
    return recording(counted(np.array(path)), torque, rng)


def rows_of(length: float, seed: int, samples: int) -> Iterator[dict[str, Any]]:
    """One row an estimator."""
    (network, true), recorded = pendulum(), swing(length, seed, samples)
    started = time.process_time()
    regression = fit_pre_sliding(network, _SETTINGS.patterns(recorded))
    identified = tuple(regression.presliding_distance.tolist())
    fits: dict[str, tuple[float, ...]] = {
        "step": (),
        "states, length of regression": identified,
        "states, true length": (length,),
    }
    fit: Identification = regression.fit
    yield _row("regression with states", fit, True, identified, true, started, length, seed)
    for name, distance in fits.items():
        started = time.process_time()
        options = jc.MaximumLikelihood(presliding_distance=distance, every=1)
        result = options.fit(network, recorded)
        yield _row(name, result.fit, result.converged, distance, true, started, length, seed)


def _row(
    name: str,
    fit: Identification,
    converged: bool,
    distance: tuple[float, ...],
    true: Float[np.ndarray, " coefficients"],
    started: float,
    length: float,
    seed: int,
) -> dict[str, Any]:
    low, high = np.asarray(fit.confidence_interval()).T
    return {
        "length": length,
        "seed": seed,
        "estimator": name,
        "error": torque_error(pendulum()[0], np.asarray(fit.k) - true),
        "inside": float(100 * np.mean((low <= true) & (true <= high))),
        "converged": bool(converged),
        "used_length": distance[0] if distance else 0.0,
        "seconds": time.process_time() - started,
    }


def table(rows: Sequence[dict[str, Any]], length: float) -> list[list[str]]:
    """Return the table of one length, the head first: torque errors, intervals, convergence."""
    lines: list[list[str]] = []
    of_length = [row for row in rows if row["length"] == length]
    for estimator in dict.fromkeys(row["estimator"] for row in of_length):
        part = [row for row in of_length if row["estimator"] == estimator]
        error = [row["error"] for row in part]
        lines.append(
            [
                estimator,
                *(f"{f(error):.2g}" for f in (np.median, np.max)),
                f"{np.mean([row['inside'] for row in part]):.0f} %",
                f"{sum(row['converged'] for row in part)} of {len(part)}",
                f"{1e3 * np.median([row['used_length'] for row in part]):.3g}",
                f"{np.median([row['seconds'] for row in part]):.2f}",
            ]
        )
    header = [f"{1e3 * length:g} mrad", "torque error [N m], median", "greatest"]
    header += ["intervals with truth", "converged", "length used [mrad]", "s"]
    return [header, *lines]


def main(argv: Sequence[str] | None = None) -> int:
    parser = command.new_parser(__doc__, "likelihood_pre_sliding")
    command.add_seeds(parser, 20)
    parser.add_argument("--samples", type=int, default=2000, help="of a recording, 5 ms apart")
    command.add_store(parser)
    options = command.parse(parser, argv, seeds=2)
    command.require_least(parser, options, seeds=1, first=0, samples=400)
    return command.run(
        parser,
        lambda: study_lengths(
            options, LENGTHS, __file__, "estimator", "states, true length", rows_of, table
        ),
        options.output / "rows.jsonl",
        seconds=4 * 4.0 * options.seeds,
    )


if __name__ == "__main__":
    raise SystemExit(main())
