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

import argparse
import time
from collections.abc import Iterator, Sequence
from pathlib import Path
from typing import Any

import jax
import numpy as np
from jaxtyping import Float

import jaxcslc as jc
from jaxcslc.identification import Identification, fit_pre_sliding
from jaxcslc.identification.report import text_table, write_csv
from scripts.studies import command
from scripts.studies.rows import Rows, made_of


jax.config.update("jax_enable_x64", True)

LENGTHS = (0.03, 2e-3, 5e-4, 1e-4)
_INERTIA, _WEIGHT, _VISCOUS, _DRY = 0.4, 3.0, 0.3, 0.8
_COUNT, _NOISE, _INTERVAL, _STEPS = 1e-4, 0.02, 0.005, 25
_SETTINGS = jc.Settings(jc.Preparation(jc.Butterworth(20.0), threshold_fraction=0.0))


def pendulum() -> tuple[jc.CSLC, Float[np.ndarray, " coefficients"]]:
    """Its network, and the true coefficients."""
    robot = jc.Manipulator.from_modified_dh([(0, 0, 0, 0)], gravity=(0, -9.81, 0))
    network = jc.derive(robot.with_friction("viscous", "dry"), lengths="numeric")
    true = {"kB1": _INERTIA, "kB2": _WEIGHT / 9.81, "kB3": 0.0, "kv1": _VISCOUS, "kd1": _DRY}
    return network, np.array([true[name] for name in network.names])


def swing(length: float, seed: int, samples: int) -> jc.Recording:
    """A recording of it; `length` of pre-sliding [rad]."""
    rng = np.random.default_rng(seed)
    phase, size = rng.uniform(0.0, 2.0 * np.pi, 3), rng.uniform(0.8, 1.2, 3)
    t = _INTERVAL * np.arange(samples)
    cosines = np.sin(np.array([1.7, 5.1, 11.0]) * t[:, None] + phase)
    torque = _WEIGHT + cosines @ (size * np.array([1.3, 1.0, 0.6]))
    step, state, path = _INTERVAL / _STEPS, np.zeros(3), []

    def rates(state: Float[np.ndarray, "3"], held: float) -> Float[np.ndarray, "3"]:
        q, qd, w = state
        net = held - _WEIGHT * np.cos(q) - _VISCOUS * qd - _DRY * w
        return np.array([qd, net / _INERTIA, (qd - abs(qd) * w) / length])

    for held in torque:
        path.append(state[0])
        for _ in range(_STEPS):
            one = rates(state, held)
            two = rates(state + 0.5 * step * one, held)
            three = rates(state + 0.5 * step * two, held)
            four = rates(state + step * three, held)
            state = state + step / 6.0 * (one + 2.0 * two + 2.0 * three + four)
    counts = _COUNT * np.round(np.array(path) / _COUNT)
    noisy = torque + _NOISE * rng.normal(size=samples)
    return jc.Recording(t, counts[:, None], noisy[:, None])


def rows_of(length: float, seed: int, samples: int) -> Iterator[dict[str, Any]]:
    """One row an estimator."""
    (network, true), recording = pendulum(), swing(length, seed, samples)
    started = time.process_time()
    regression = fit_pre_sliding(network, _SETTINGS.patterns(recording))
    identified = tuple(regression.lengths.tolist())
    fits: dict[str, tuple[float, ...]] = {
        "step": (),
        "states, length of regression": identified,
        "states, true length": (length,),
    }
    fit: Identification = regression.fit
    yield _row("regression with states", fit, True, identified, true, started, length, seed)
    for name, lengths in fits.items():
        started = time.process_time()
        options = jc.MaximumLikelihood(lengths=lengths, every=1, noise_order=0)
        result = options.fit(network, recording)
        yield _row(name, result.fit, result.converged, lengths, true, started, length, seed)


def _row(
    name: str,
    fit: Identification,
    converged: bool,
    lengths: tuple[float, ...],
    true: Float[np.ndarray, " coefficients"],
    started: float,
    length: float,
    seed: int,
) -> dict[str, Any]:
    rng = np.random.default_rng(0)
    q, qd, qdd = rng.uniform(-1, 1, (3, 300, 1)) * np.array([1.0, 2.0, 8.0])[:, None, None]
    error = pendulum()[0].torque(np.asarray(fit.k) - true, q, qd, qdd)
    low, high = np.asarray(fit.confidence_interval()).T
    return {
        "length": length,
        "seed": seed,
        "estimator": name,
        "error": float(np.sqrt(np.mean(np.square(error)))),
        "inside": float(100 * np.mean((low <= true) & (true <= high))),
        "converged": bool(converged),
        "used_length": lengths[0] if lengths else 0.0,
        "seconds": time.process_time() - started,
    }


def table(rows: Sequence[dict[str, Any]], length: float) -> str:
    """Of one length: torque errors, intervals, convergence."""
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
    return text_table(header, lines)


def study(options: argparse.Namespace) -> int:
    """Makes what is missing, prints the tables and writes the rows."""
    digest = made_of({"samples": options.samples}, [Path(__file__)])
    finished = Rows(options.output / "rows.jsonl", ("length", "seed", "estimator"), digest)
    cases = [(length, seed) for length in LENGTHS for seed in command.seeds_of(options)]
    for length, seed in command.progress(cases, desc="recordings", unit="recording"):
        if (length, seed, "states, true length") not in finished:
            for row in rows_of(length, seed, options.samples):
                finished.add(row)
    rows = [row for row in finished.all() if (row["length"], row["seed"]) in cases]
    for length in LENGTHS:
        print(table(rows, length), end="\n\n")
    write_csv(options.output / "seeds.csv", rows)
    print(f"wrote {options.output / 'seeds.csv'}")
    return 0


def main(argv: Sequence[str] | None = None) -> int:
    parser = command.new_parser(__doc__, "likelihood_pre_sliding")
    command.add_seeds(parser, 20)
    parser.add_argument("--samples", type=int, default=2000, help="of a recording, 5 ms apart")
    options = command.parse(parser, argv, seeds=2)
    command.require_least(parser, options, seeds=1, first=0, samples=400)
    return command.run(
        parser,
        lambda: study(options),
        options.output / "rows.jsonl",
        seconds=4 * 4.0 * options.seeds,
    )


if __name__ == "__main__":
    raise SystemExit(main())
