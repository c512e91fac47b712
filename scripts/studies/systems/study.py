"""Systems that are not manipulators: coefficients against the truth, and simulated motion.

Six systems, each with a simulator of its own as the truth: a cart-pole and a quadrotor (MuJoCo), a
DC motor with cogging torque and a belt, a vehicle, two coupled tanks, and Lorenz's oscillator
(SciPy). Each recording has another noise, and there are so many different motions. Each is
identified, and the identified system is simulated from the first sample of a validation recording
with its inputs. A line a system:

- **within 2 errors**: of all coefficients of all recordings, those that are within two standard
  errors of the truth, corrected for noise and smoothing as `identify_system` does; **least
  squares**: without that; **in interval**: those within the interval of 95 % by Student's t;
- **errors / standard errors**: root mean square of all; **standard error / spread**: of a
  coefficient, the median standard error over the standard deviation of its values (median over
  coefficients);
- **least coefficient**: the smallest share of a single one; **bias**: the largest mean of a
  coefficient's error over its standard error, with and without correction;
- **square error**: mean square error of a coefficient over that of least squares, mean over
  coefficients (and largest); **explained**: recordings of which noise explains the errors of the
  equations;
- **equation error**: root mean square on validation recordings over that of training recordings,
  the largest of all equations (median over recordings);
- **simulation error**: root mean square over the variable's standard deviation, the largest of all
  variables (median over recordings); beside it that of the true constants;
- **follows for**: until a variable is off by half of its standard deviation [s]; the same for the
  true constants.

Finished rows stay in the output folder, and an interrupted run goes on from there.
"""

import argparse
from collections.abc import Sequence
from pathlib import Path
from typing import Any

import numpy as np

import jaxcslc as jc
from jaxcslc._text_table import text_table
from jaxcslc.least_squares import Identification
from jaxcslc.recordings import Patterns
from jaxcslc.report import all_or_nothing, write_csv
from jaxcslc.systems import (
    SystemRecording,
    correct_for_noise,
    simulate_system,
    system_patterns,
)
from scripts.studies import command
from scripts.studies.rows import Rows, made_of
from scripts.studies.stored import store
from scripts.studies.systems.example import Example
from scripts.studies.systems.examples.cart_pole import CART_POLE
from scripts.studies.systems.examples.lorenz import LORENZ
from scripts.studies.systems.examples.motor import DC_MOTOR
from scripts.studies.systems.examples.quadrotor import QUADROTOR
from scripts.studies.systems.examples.tanks import COUPLED_TANKS
from scripts.studies.systems.examples.vehicle import VEHICLE


jc.enable_x64()

EXAMPLES = {
    example.name: example
    for example in (CART_POLE, QUADROTOR, DC_MOTOR, VEHICLE, COUPLED_TANKS, LORENZ)
}
_FOLDER = Path(__file__).parent
_SECONDS = 2.0  # of a recording, with its part of simulations
# What rows depend on.
CODE = [*sorted(_FOLDER.glob("*.py")), *sorted((_FOLDER / "examples").glob("*.*"))]


def row_of(
    example: Example, seed: int, training: SystemRecording, validation: SystemRecording | None
) -> dict[str, Any]:
    """Identifies a recording; simulates if there is one to compare with."""
    settings, system = example.settings, example.system
    patterns = system_patterns(system, training, settings.preparation)
    plain = settings.solver.fit(system.network, patterns)
    # Other draws for each recording: their chance would be the same in all.
    correction = correct_for_noise(system, training, patterns, settings, plain, seed=seed)
    fit = correction.fit
    row = {
        "example": example.name,
        "seed": seed,
        "explained": correction.explained,
        "smoothing_bias": correction.smoothing_bias.tolist(),
        **{name: judged(example, some) for name, some in (("plain", plain), ("corrected", fit))},
    }
    if validation is not None:
        row |= simulation_row(example, fit, patterns, validation)
    return row


def judged(example: Example, fit: Identification) -> dict[str, Any]:
    """Coefficients, and where the truth is among their errors."""
    low, high = fit.confidence_interval(0.95).T
    truth, k = example.coefficients, np.asarray(fit.k)
    return {
        "k": k.tolist(),
        "standard_error": np.asarray(fit.standard_error).tolist(),
        "z": ((k - truth) / np.asarray(fit.standard_error)).tolist(),
        "in_interval": ((low <= truth) & (truth <= high)).tolist(),
    }


def simulation_row(
    example: Example, fit: Identification, training: Patterns, validation: SystemRecording
) -> dict[str, Any]:
    """Equation and simulation errors on a validation recording."""
    system, preparation = example.system, example.settings.preparation
    patterns = system_patterns(system, validation, preparation)
    row: dict[str, Any] = {
        "equation_ratio": float(
            np.max(equation_error(example, fit, patterns) / equation_error(example, fit, training))
        )
    }
    for name, k in (("identified", np.asarray(fit.k)), ("true", example.coefficients)):
        simulation = simulate_system(system, k, patterns, recorded=example.recorded)
        row |= {
            f"{name}_error": float(np.max(simulation.relative_error)),
            f"{name}_horizon": simulation.follows_for(),
            "duration": float(simulation.time[-1] - simulation.time[0]),
        }
    return row


def equation_error(example: Example, fit: Identification, patterns: Patterns) -> np.ndarray:
    """Root mean square of each equation on the samples of the mask."""
    motion = (np.asarray(x) for x in (patterns.q, patterns.qd, patterns.qdd))
    residual = np.asarray(patterns.torque - example.system.network.torque(fit.k, *motion))
    mask = np.asarray(patterns.mask)
    return np.sqrt(np.sum(residual**2 * mask, axis=0) / np.sum(mask, axis=0))


def seeds_of(options: argparse.Namespace) -> range:
    """Return the seeds of the recordings of each system."""
    return range(options.first, options.first + options.recordings)


def compute(options: argparse.Namespace, rows: Rows) -> None:
    """Adds the rows that are missing."""
    for name in options.examples:
        example = EXAMPLES[name]
        missing = [s for s in seeds_of(options) if (name, s) not in rows]
        if not missing:
            continue
        training = example.recordings(missing, motions=options.motions)
        simulated = [seed for seed in missing if seed - options.first < options.simulations]
        validation = dict(
            zip(simulated, example.recordings(simulated, validation=True), strict=True)
            if simulated
            else ()
        )
        pairs = zip(missing, training, strict=True)
        for seed, recording in command.progress(
            pairs, desc=name, unit="recording", total=len(missing)
        ):
            rows.add(row_of(example, seed, recording, validation.get(seed)))


def table(rows: Sequence[dict[str, Any]], way: str, name: str) -> np.ndarray:
    """Return what a column says of all coefficients, (recordings, coefficients).

    - `way`: `"plain"` or `"corrected"`.
    - `name`: `"k"`, `"standard_error"`, `"z"`, errors over standard errors, or `"in_interval"`.
    """
    return np.array([row[way][name] for row in rows])


COVERAGE = (
    *("system", "recordings", "within 2 errors", "least squares", "in interval"),
    *("least coefficient", "errors / standard errors", "standard error / spread", "bias"),
    *("least squares' bias", "square error", "explained"),
)
SIMULATION = (
    *("system", "identified", "true constants", "follows for"),
    "equation error, validation / training",
)


def coverage(rows: Sequence[dict[str, Any]]) -> list[str]:
    """The line of `COVERAGE` of one example."""
    example = EXAMPLES[rows[0]["example"]]
    names, truth = example.system.network.names, example.coefficients
    k, z, inside, errors = (
        table(rows, "corrected", name) for name in ("k", "z", "in_interval", "standard_error")
    )
    plain_k, plain_z = (table(rows, "plain", name) for name in ("k", "z"))
    within = np.abs(z) <= 2.0
    least = int(np.argmin(np.mean(within, axis=0)))
    squares = np.mean((k - truth) ** 2, axis=0) / np.mean((plain_k - truth) ** 2, axis=0)
    share = np.mean(within, axis=1)
    deviation = np.std(share, ddof=1) / np.sqrt(len(share)) if len(share) > 1 else np.nan
    return [
        f"{example.name}, {z.shape[1]} coefficients",
        str(len(rows)),
        f"{100 * np.mean(within):.1f} ± {100 * deviation:.1f} %",
        f"{100 * np.mean(np.abs(plain_z) <= 2.0):.1f} %",
        f"{100 * np.mean(inside):.1f} %",
        f"{100 * np.mean(within[:, least]):.1f} % ({names[least]})",
        f"{np.sqrt(np.mean(z**2)):.2f}",
        f"{np.median(np.median(errors, axis=0) / spread(k)):.2f}",
        f"{largest_mean(z):.2f}",
        f"{largest_mean(plain_z):.2f}",
        f"{np.mean(squares):.2f} ({np.max(squares):.2f})",
        f"{100 * np.mean([row['explained'] for row in rows]):.0f} %",
    ]


def simulation(rows: Sequence[dict[str, Any]]) -> list[str]:
    """The line of `SIMULATION` of one example: medians over the recordings that were simulated."""
    middle = lambda name: float(np.median([row[name] for row in rows if "duration" in row]))
    return [
        EXAMPLES[rows[0]["example"]].name,
        f"{100 * middle('identified_error'):.2g} %",
        f"{100 * middle('true_error'):.2g} %",
        f"{middle('identified_horizon'):.3g} of {middle('duration'):.3g} s (true:"
        f" {middle('true_horizon'):.3g})",
        f"{middle('equation_ratio'):.2f}",
    ]


def spread(k: np.ndarray) -> np.ndarray:
    """Standard deviation of each coefficient over the recordings."""
    return np.std(k, axis=0, ddof=1) if len(k) > 1 else np.full(k.shape[1], np.nan)


def largest_mean(z: np.ndarray) -> float:
    """Return the largest modulus of a coefficient's mean error over its standard error."""
    return float(np.max(np.abs(np.mean(z, axis=0))))


def coefficient_rows(rows: Sequence[dict[str, Any]]) -> list[dict[str, Any]]:
    """A row for each coefficient of one example."""
    example = EXAMPLES[rows[0]["example"]]
    k, z, inside, errors = (
        table(rows, "corrected", name) for name in ("k", "z", "in_interval", "standard_error")
    )
    plain_k, plain_z = (table(rows, "plain", name) for name in ("k", "z"))
    truth = example.coefficients
    squares = np.mean((k - truth) ** 2, axis=0) / np.mean((plain_k - truth) ** 2, axis=0)
    return [
        {
            "example": example.name,
            "coefficient": coefficient.name,
            "expression": coefficient.expression,
            "unit": coefficient.unit,
            "true value": truth[i],
            "mean": np.mean(k[:, i]),
            "standard deviation": spread(k)[i],
            "median standard error": np.median(errors[:, i]),
            "root mean square error / standard error": np.sqrt(np.mean(z[:, i] ** 2)),
            "within two standard errors": np.mean(np.abs(z[:, i]) <= 2.0),
            "least squares, within two": np.mean(np.abs(plain_z[:, i]) <= 2.0),
            "in interval": np.mean(inside[:, i]),
            "mean error / standard error": np.mean(z[:, i]),
            "least squares, mean": np.mean(plain_z[:, i]),
            "square error / least squares": squares[i],
        }
        for i, coefficient in enumerate(example.system.network.coefficients)
    ]


def study(options: argparse.Namespace) -> int:
    """Identifies and simulates, prints the table and writes the files."""
    path = options.output / "rows.jsonl"
    rows = Rows(path, ("example", "seed"), made_of({"motions": options.motions}, CODE))
    compute(options, rows)
    by_example = [[rows[name, seed] for seed in seeds_of(options)] for name in options.examples]
    lines = [coverage(group) for group in by_example]
    print(text_table(COVERAGE, lines, left=("system",)))
    sample = f"{options.recordings} recordings of each, seeds from {options.first} on"
    store(options, "systems", sample, {"coverage": [COVERAGE, *lines]})
    if options.simulations:
        lines = [simulation(group) for group in by_example]
        print("\n" + text_table(SIMULATION, lines, left=("system",)))
        sample = f"{options.simulations} recordings of each"
        store(options, "systems_simulated", sample, {"variables": [SIMULATION, *lines]})
    with all_or_nothing(options.output) as folder:
        write_csv(
            folder / "coefficients.csv",
            [row for group in by_example for row in coefficient_rows(group)],
        )
    print(f"\nwrote coefficients.csv into {options.output}")
    return 0


def main(argv: Sequence[str] | None = None) -> int:
    parser = command.new_parser(__doc__, "systems_study")
    parser.add_argument("--recordings", type=int, default=200, help="of each system")
    parser.add_argument("--motions", type=int, default=20, help="different ones of each system")
    parser.add_argument("--simulations", type=int, default=20, help="validation recordings of each")
    parser.add_argument("--first", type=int, default=0, help="seed of the first recording")
    parser.add_argument("--examples", nargs="+", default=list(EXAMPLES), metavar="NAME")
    quick = {"examples": ["cart-pole", "vehicle", "tanks", "lorenz"], "recordings": 2}
    command.add_store(parser)
    options = command.parse(parser, argv, motions=2, simulations=1, **quick)
    command.require_least(parser, options, recordings=1, motions=1, simulations=0, first=0)
    command.require_some_of(parser, "example", options.examples, tuple(EXAMPLES))
    return command.run(
        parser,
        lambda: study(options),
        options.output / "rows.jsonl",
        seconds=_SECONDS * options.recordings * len(options.examples),
    )


if __name__ == "__main__":
    raise SystemExit(main())
