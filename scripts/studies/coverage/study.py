"""How often confidence intervals hold the truth: many simulated recordings of one motion.

Two kinds of recordings of the simulated PUMA 560's training trajectory, each with a seed of its
own, none with anything that the network's model does not have:

- torque noise: the true motion, its torque with white noise, of each joint's its own strength;
- encoders: positions as quantised encoders read them, their phases new in each recording, through
  smoothing, masks and the parallel filter to a fit; the drives' torque as it was demanded.

Each is identified as a user would, once with standard errors for independent noise and once for
correlated noise. Printed: how often the interval of a coefficient held the true value.

For intervals, a smoothing must leave more than is left after it: its pass band here ends at 28 Hz,
and the parallel filter cuts at 15 Hz. What a smoothing takes out of the motion itself is no noise,
and no interval allows for it.
"""

import jax


jax.config.update("jax_enable_x64", True)

import argparse  # noqa: E402
import dataclasses  # noqa: E402
from collections.abc import Iterator, Sequence  # noqa: E402
from pathlib import Path  # noqa: E402
from typing import Any  # noqa: E402

import numpy as np  # noqa: E402
from jaxtyping import Bool, Float  # noqa: E402
from tqdm import tqdm  # noqa: E402

import jaxcslc as jc  # noqa: E402
import sim  # noqa: E402
from jaxcslc.identification import all_or_nothing, text_table, write_csv  # noqa: E402
from jaxcslc.motion import as_recorded  # noqa: E402


NOISE, ENCODERS = "torque noise", "encoders"
KINDS = (NOISE, ENCODERS)
# Of the root mean square torque of each joint; the thesis's machines were near this.
NOISE_TO_TORQUE = 0.02
SETTINGS = jc.Settings(
    smoothing=jc.AveragedSplines(9),
    torque_alignment="mean",
    threshold_fraction=0.1,
    cutoff=15.0,
)


@dataclasses.dataclass(frozen=True)
class Coverage:
    """What the intervals of one kind of recording did."""

    kind: str
    errors: str
    held: Bool[np.ndarray, "recordings coefficients"]
    width: Float[np.ndarray, "recordings coefficients"]
    estimate: Float[np.ndarray, "recordings coefficients"]

    def row(self) -> list[str]:
        """For the table that is printed."""
        each = self.held.mean(axis=0)
        within = np.mean((each >= 0.93) & (each <= 0.97))
        return [
            f"{self.kind}, {self.errors} errors",
            f"{self.held.mean():.4f}",
            f"{np.median(each):.3f}",
            f"{each.min():.3f} to {each.max():.3f}",
            f"{100 * within:.0f} %",
        ]

    def rows(self, names: Sequence[str], truth: np.ndarray) -> list[dict[str, Any]]:
        """One row a coefficient, for a file."""
        spread = self.estimate.std(axis=0, ddof=1)
        return [
            {
                "recordings": self.kind,
                "errors": self.errors,
                "coefficient": name,
                "true value": truth[i],
                "coverage": self.held[:, i].mean(),
                "median interval width": np.median(self.width[:, i]),
                "standard deviation": spread[i],
                "mean error / standard deviation": (self.estimate[:, i].mean() - truth[i])
                / spread[i],
            }
            for i, name in enumerate(names)
        ]


def noisy_torques(machine: sim.Machine, count: int) -> Iterator[jc.Patterns]:
    """The true motion of one recording, its torque with new noise each time."""
    _, truth = sim.simulate(sim.undisturbed(machine), sim.training(), seed=0)
    deviation = NOISE_TO_TORQUE * np.sqrt(np.mean(truth.torque**2, axis=0))
    for seed in range(count):
        noise = deviation * np.random.default_rng(seed).normal(size=truth.torque.shape)
        recording = jc.Recording(
            truth.time, truth.position, truth.torque + noise, truth.velocity, truth.acceleration
        )
        yield as_recorded(recording, threshold_fraction=SETTINGS.threshold_fraction)


def quantised_positions(machine: sim.Machine, count: int) -> Iterator[jc.Patterns]:
    """Recordings with quantised encoders, smoothed and masked."""
    quantised = sim.disturbed(machine, "quantisation")
    trajectory = sim.training()
    jobs = [sim.Job(quantised, trajectory, seed) for seed in range(count)]
    for _, result in sim.record_each(jobs):
        if isinstance(result, sim.SimulationError):
            raise result
        yield SETTINGS.patterns(result.recording)


def study(kind: str, machine: sim.Machine, count: int, level: float) -> list[Coverage]:
    """Identifies `count` recordings of a kind and looks where the truth lies."""
    network = jc.derive(machine.robot)
    truth = true_coefficients(machine)
    patterns = {NOISE: noisy_torques, ENCODERS: quantised_positions}[kind](machine, count)
    # White noise on true motion needs no filter.
    cutoff = None if kind == NOISE else SETTINGS.cutoff
    found: dict[str, list[tuple[np.ndarray, ...]]] = {"independent": [], "correlated": []}
    for recording in tqdm(patterns, total=count, desc=kind, unit="recording", disable=None):
        for errors, results in found.items():
            settings = dataclasses.replace(SETTINGS, cutoff=cutoff, errors=errors)
            fit = settings.fit(network, recording)
            low, high = fit.confidence_interval(level).T
            held = (low <= truth) & (truth <= high)
            results.append((held, high - low, np.asarray(fit.k)))
    return [
        Coverage(kind, errors, *(np.stack(column) for column in zip(*results, strict=True)))
        for errors, results in found.items()
    ]


def true_coefficients(machine: sim.Machine) -> Float[np.ndarray, " coefficients"]:
    """What the machine was made with."""
    assert machine.robot.links is not None
    network = jc.derive(machine.robot)
    return np.asarray(
        network.coefficients_from(machine.robot.links, viscous=machine.viscous, dry=machine.dry)
    )


def main(arguments: Sequence[str] | None = None) -> None:
    parser = argparse.ArgumentParser(description=(__doc__ or "").partition("\n")[0])
    parser.add_argument("-o", "--output", type=Path, default=Path("build/coverage_study"))
    parser.add_argument("--recordings", type=int, default=500, help="how many of each kind")
    parser.add_argument("--level", type=float, default=0.95, help="of the intervals")
    given = parser.parse_args(arguments)
    if given.recordings < 2:
        parser.error(f"--recordings is {given.recordings}; expected 2 or more")
    if not 0.0 < given.level < 1.0:
        parser.error(f"--level is {given.level}; expected more than 0 and less than 1")

    machine = sim.puma560()
    names, truth = jc.derive(machine.robot).names, true_coefficients(machine)
    results = [
        coverage
        for kind in KINDS
        for coverage in study(kind, machine, given.recordings, given.level)
    ]
    header = ["recordings", "mean", "median", "coefficients from", "within 93 to 97 %"]
    print(
        f"{100 * given.level:g} % intervals of {len(names)} coefficients that held the truth,"
        f" {given.recordings} recordings of each kind"
    )
    print(text_table(header, [coverage.row() for coverage in results]))
    with all_or_nothing(given.output) as folder:
        rows = [row for coverage in results for row in coverage.rows(names, truth)]
        write_csv(folder / "coverage.csv", rows)
    print(f"\nwrote coverage.csv into {given.output}")


if __name__ == "__main__":
    main()
