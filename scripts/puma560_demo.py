"""Simulate a PUMA 560, identify its coefficients, and compare them with the truth.

Two machines: one whose links and friction are Armstrong's and Leahy and Saridis's to the digit
(so that Ar+LS is the truth but for static friction), and another specimen of the design, which
nobody has taken apart. For each, the network learns from the training trajectory (7.4.1) and is
judged on the comparison trajectory (7.4.2), on its true motion, as in Fig. 7.6-3.
"""

import argparse
import dataclasses
from pathlib import Path

import jax
import numpy as np
from tqdm import tqdm

import jaxcslc as jc
import sim
from jaxcslc.assessment import (
    all_or_nothing,
    coefficient_rows,
    coefficient_text,
    predicted_torque,
    save_picture,
    torque_picture,
    write_csv,
)
from jaxcslc.motion import as_recorded


jax.config.update("jax_enable_x64", True)

# Slower than this a joint may be stuck, where no model of sliding friction can know its torque.
# The thesis drops the beginning and end of the comparison trajectory for the same reason (7.4.2).
_MOVING = 1e-3  # rad/s


@dataclasses.dataclass(frozen=True)
class Identified:
    """What one machine's recordings gave."""

    recordings: dict[str, jc.Recording]
    settings: str
    fit: jc.Identification
    truth: jc.Patterns
    vectors: dict[str, jax.Array]


def true_patterns(recording: jc.Recording, truth: sim.Truth) -> jc.Patterns:
    """The comparison trajectory as it truly was, where the joints move."""
    motion = jc.Recording(
        recording.time, truth.position, truth.torque, truth.velocity, truth.acceleration
    )
    return as_recorded(motion, thresholds=_MOVING)


def usual_pipeline(network: jc.CSLC, recording: jc.Recording) -> jax.Array:
    """The field's usual way: 20 Hz zero-phase Butterworth, differences, ordinary least squares."""
    patterns = jc.prepare(recording, smoothing=jc.Butterworth(20.0), threshold_fraction=0.01)
    return jc.least_squares(network, patterns).k


def identify(network: jc.CSLC, machine: sim.Machine, seed: int) -> Identified:
    """Record both trajectories of a machine and fit its coefficients to the first."""
    train, _ = sim.simulate(machine, sim.training(), seed=seed)
    comparison, truth = sim.simulate(machine, sim.comparison(), seed=seed + 1)
    settings = jc.choose_settings(network, train).settings
    patterns = settings.patterns(train)
    fit = settings.fit(network, patterns)

    book = jc.puma560()  # what direct measurement says of every PUMA 560
    assert book.links is not None and machine.robot.links is not None
    published = network.coefficients_from(book.links, viscous=book.viscous, dry=book.dry)
    vectors = {
        "Ar+LS": published,
        "Ar+Rg": jc.regress_friction(network, patterns, published),
        "usual": usual_pipeline(network, train),
        "CSLC": fit.k,
        "true": network.coefficients_from(
            machine.robot.links, viscous=machine.viscous, dry=machine.dry
        ),
    }
    return Identified(
        {"train": train, "comparison": comparison},
        str(settings),
        fit,
        true_patterns(comparison, truth),
        vectors,
    )


def write(folder: Path, network: jc.CSLC, found: Identified, name: str) -> None:
    """Recordings, tables and the picture of one machine."""
    for kind, recording in found.recordings.items():
        jc.save_recording(recording, folder / f"{name}_{kind}.csv")
    write_csv(folder / f"{name}_errors.csv", jc.compare(network, found.truth, found.vectors).rows())
    rows = coefficient_rows(network, found.fit, {"true": np.asarray(found.vectors["true"])})
    write_csv(folder / f"{name}_coefficients.csv", rows)
    figure = torque_picture(
        np.asarray(found.truth.time),
        found.truth.torque,
        {
            model: np.asarray(predicted_torque(network, found.truth, found.vectors[model]))
            for model in ("Ar+LS", "Ar+Rg", "CSLC")
        },
        title=f"PUMA 560, {name} machine: torques of the comparison trajectory",
        units=("N m",) * 6,
        counts=found.truth.counts_in,
    )
    save_picture(figure, folder / f"{name}_comparison_torque.png")


def main() -> None:
    parser = argparse.ArgumentParser(description=(__doc__ or "").partition("\n")[0])
    parser.add_argument("-o", "--output", type=Path, default=Path("build/demo"))
    parser.add_argument("--seed", type=int, default=1, help="of encoders, starts and specimen")
    arguments = parser.parse_args()

    cache = Path(__file__).parents[1] / ".cache" / "jax"
    jax.config.update("jax_compilation_cache_dir", str(cache))
    jax.config.update("jax_persistent_cache_min_compile_time_secs", 0.2)

    network = jc.derive(jc.puma560())
    print(network)
    nominal = sim.puma560()
    machines = {"nominal": nominal, "specimen": sim.specimen(nominal, arguments.seed)}
    results = {
        name: identify(network, machine, arguments.seed)
        for name, machine in tqdm(machines.items(), desc="machines", unit="machine", disable=None)
    }
    for name, found in results.items():
        print(f"\n{name} machine, settings chosen on the training recording: {found.settings}")
        print(f"{found.fit}\n")
        print("torque error on the comparison trajectory's true motion")
        print(jc.compare(network, found.truth, found.vectors))
    found = results["specimen"]
    print("\ncoefficients of the specimen")
    truth = {"true": np.asarray(found.vectors["true"])}
    print(coefficient_text(coefficient_rows(network, found.fit, truth)))
    with all_or_nothing(arguments.output) as folder:
        for name, found in results.items():
            write(folder, network, found, name)
    print(f"\nwrote recordings, tables and pictures into {arguments.output}")


if __name__ == "__main__":
    main()
