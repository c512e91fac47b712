"""Can a recording tell static friction, and does knowing it help? (8.2.1, 7.2.2)

A simulated PUMA 560 with static friction (Eqn 2.5-4), exact positions or encoders, is identified
from a training recording in each of several ways, and judged on a comparison recording, as in
`disturbance_budget.py`: ε on the links' true motion where a joint moves. The floor is what the true
coefficients leave of it without static friction.

- **masked**: no static friction in the model; pairs slower than a hundredth of a joint's greatest
  speed left out, regressor and torque low-passed alike at 15 Hz.
- **all pairs**: static friction and its slopes in the model (`fit_slopes`), every pair counts.
- **moving pairs**: the same, pairs of a joint at rest left out: it is held, by any torque that
  friction can bear.
- **away from reversals**: the same, and two samples on either side of each reversal left out.
- **windows**: simulated motion fitted to recorded positions over windows of at most 0.2 s, across
  reversals (`output_error.py`), starting from the masked fit. No accelerations are estimated.

Intervals are of 95 %: of windows for residuals that are independent, as encoders' steps are; of the
others from the scatter of stretches of time.

**The simulator's step.** It holds a joint that comes to rest within a step until the step ends,
which takes some 5 mrad/s from the wrist's velocity at each turn when a step is 0.5 ms, its default.
Regression on motion does not see it; whoever integrates the equations does. `--time-step` is
shorter here.
"""

import argparse
import dataclasses
import sys
from collections.abc import Sequence
from pathlib import Path
from typing import Any, NamedTuple

import jax
import numpy as np
from jaxtyping import Float
from tqdm import tqdm

import jaxcslc as jc
import sim
from jaxcslc.identification import text_table, write_csv
from jaxcslc.motion import as_recorded, choose_spacing
from scripts.studies.static_friction.output_error import fit_windows, windows_of


jax.config.update("jax_enable_x64", True)

# Slower than this a joint may be stuck, where no model of sliding friction can know its torque.
MOVING = 1e-3  # rad/s, of true motion
SLOWEST = 5e-3  # rad/s, of smoothed motion
MARGIN = 2  # samples on either side of a reversal
LENGTH = 100  # samples of a window, at most
BLOCKS = 30  # stretches of time that residuals hang together in
CUTOFF = 15.0  # Hz
# To start windows from: static friction of a tenth of dry friction, gone to exp(-3) at a tenth of
# the greatest speed.
START = 0.1
WITHIN = 1.96
WAYS = ("masked", "all pairs", "moving pairs", "away from reversals", "windows")


class Found(NamedTuple):
    """A network with coefficients, and what is known of its static friction."""

    network: jc.CSLC
    k: Float[np.ndarray, " coefficients"]
    magnitude: Float[np.ndarray, " joints"] | None = None
    magnitude_error: Float[np.ndarray, " joints"] | None = None
    slope: Float[np.ndarray, " joints"] | None = None
    slope_error: Float[np.ndarray, " joints"] | None = None


class Study:
    """One machine, its networks and its truth."""

    def __init__(self, encoders: bool, samples: int, time_step: float) -> None:
        names = ("static friction", *(["quantisation"] if encoders else []))
        self.machine = dataclasses.replace(
            sim.disturbed(sim.puma560(), *names), time_step=time_step
        )
        self.trajectories = (sim.training(samples=samples), sim.comparison())
        robot = jc.puma560()
        self.masked = jc.derive(robot)
        self.network = jc.derive(robot.with_friction("viscous", "dry", "static"))
        self.magnitude = np.array(self.machine.static) - np.array(self.machine.dry)
        self.slope = 1.0 / np.array(self.machine.static_velocity)
        self.spacing: tuple[int, ...] | None = None

    def ways(self, recording: jc.Recording, names: Sequence[str]) -> dict[str, Found]:
        """What each way makes of a training recording."""
        if self.spacing is None:
            resolution = np.array(self.machine.encoder_resolution)
            self.spacing = choose_spacing(recording.time, recording.position, resolution=resolution)
        splines = jc.AveragedSplines(self.spacing)
        trim = max(self.spacing)

        def prepared(**given: Any) -> jc.Patterns:
            return jc.prepare(
                recording, smoothing=splines, torque_alignment="mean", trim=trim, **given
            )

        usual = jc.LeastSquares(joint_weights="residual", errors="independent", cutoff=CUTOFF).fit(
            self.masked, prepared(threshold_fraction=0.01)
        )
        selections: dict[str, dict[str, Any]] = {
            "all pairs": {"thresholds": 0.0},
            "moving pairs": {"thresholds": SLOWEST},
            "away from reversals": {"thresholds": SLOWEST, "reversal_margin": MARGIN},
        }
        found: dict[str, Found] = {}
        for name in names:
            if name == "masked":
                found[name] = Found(self.masked, np.asarray(usual.k))
            elif name == "windows":
                found[name] = self._windows(recording, splines, trim, np.asarray(usual.k))
            else:
                patterns = prepared(**selections[name])
                fit = jc.fit_slopes(
                    self.network,
                    patterns,
                    solver=jc.LeastSquares(errors="independent"),
                    blocks=BLOCKS,
                )
                own = slice(self.masked.size, None)
                k, error = np.asarray(fit.fit.k), np.asarray(fit.fit.standard_error)
                slopes = np.asarray(fit.slopes), np.asarray(fit.slope_error)
                found[name] = Found(fit.network, k, k[own], error[own], *slopes)
        return found

    def _windows(
        self,
        recording: jc.Recording,
        splines: jc.AveragedSplines,
        trim: int,
        usual: Float[np.ndarray, " coefficients"],
    ) -> Found:
        q, qd, _ = splines.smooth(recording.time, recording.position)
        windows = windows_of(qd, length=LENGTH, slowest=SLOWEST, trim=trim)
        dry = usual[-self.masked.joint_count :]
        start = self.network.with_static_slopes(3.0 / (START * np.max(np.abs(qd), axis=0)))
        fit = fit_windows(
            start, np.concatenate([usual, START * np.abs(dry)]), recording, windows, (q, qd)
        )
        own = slice(self.masked.size, None)
        network = self.network.with_static_slopes(fit.slopes)
        return Found(network, fit.k, fit.k[own], fit.error[own], fit.slopes, fit.slope_error)

    def judged(self, performed: sim.SimulatedRecording) -> jc.Patterns:
        """The links' true motion where they move, and the torque that made it."""
        recording, truth = performed
        motion = jc.Recording(
            recording.time, truth.position, truth.torque, truth.velocity, truth.acceleration
        )
        return as_recorded(motion, thresholds=MOVING)

    def row(self, seed: int, way: str, found: Found, patterns: jc.Patterns) -> dict[str, Any]:
        """Figures of one way and seed."""
        machine = self.machine
        true = self.masked.coefficients_from(
            machine.links, viscous=machine.viscous, dry=machine.dry
        )
        row: dict[str, Any] = {
            "seed": seed,
            "way": way,
            "epsilon": _epsilon(found.network, found.k, patterns),
            "floor": _epsilon(self.masked, true, patterns),
        }
        for name, value, error, truth in (
            ("magnitude", found.magnitude, found.magnitude_error, self.magnitude),
            ("slope", found.slope, found.slope_error, self.slope),
        ):
            known = value is not None and error is not None
            unknown = np.full(truth.size, np.nan)
            ratios = unknown if value is None else value / truth
            errors = unknown if error is None else error / truth
            for i, (ratio, own) in enumerate(zip(ratios, errors, strict=True), start=1):
                row[f"{name} {i} over truth"], row[f"{name} {i} error"] = float(ratio), float(own)
            held = np.abs(ratios - 1.0) <= WITHIN * errors
            row[f"{name}s held"] = int(np.sum(held)) if known else np.nan
        return row


def _epsilon(network: jc.CSLC, k: Any, patterns: jc.Patterns) -> float:
    return float(np.asarray(jc.compare(network, patterns, {"": k}).epsilon)[0])


def summary(rows: Sequence[dict[str, Any]], ways: Sequence[str], joints: int) -> str:
    """A line a way: ε, and how static friction compares with the truth, over all seeds."""
    header = ["way", "ε [N m]", "floor", "magnitudes/truth", "held", "slopes/truth", "held"]
    lines: list[list[str]] = []
    for way in ways:
        own = [row for row in rows if row["way"] == way]
        line = [way, f"{np.mean([row['epsilon'] for row in own]):.4f}"]
        line += [f"{np.mean([row['floor'] for row in own]):.4f}"]
        for name in ("magnitude", "slope"):
            ratios = np.array(
                [[row[f"{name} {i} over truth"] for i in range(1, joints + 1)] for row in own]
            )
            held = np.array([row[f"{name}s held"] for row in own])
            if np.any(np.isnan(held)):
                line += ["", ""]
            else:
                line += [f"{np.min(ratios):.3g} to {np.max(ratios):.3g}"]
                line += [f"{int(np.sum(held))}/{ratios.size}"]
        lines.append(line)
    return text_table(header, lines)


def main(arguments: Sequence[str] | None = None) -> int:
    parser = argparse.ArgumentParser(description=(__doc__ or "").partition("\n")[0])
    parser.add_argument("-o", "--output", type=Path, default=Path("build/static_friction"))
    parser.add_argument("--seeds", type=int, default=3, help="how many, from 0 on")
    parser.add_argument("--samples", type=int, default=3300, help="of training, 2 ms apart")
    parser.add_argument("--encoders", action="store_true", help="positions in encoder steps")
    parser.add_argument("--time-step", type=float, default=2e-5, help="of the simulator [s]")
    parser.add_argument("--ways", nargs="+", default=list(WAYS), metavar="WAY",
                        help=f"some of: {', '.join(map(repr, WAYS))}")  # fmt: skip
    given = parser.parse_args(arguments)
    if given.seeds < 1:
        parser.error(f"--seeds is {given.seeds}; expected 1 or more")
    for way in given.ways:
        if way not in WAYS:
            parser.error(f"no way is called {way!r}; expected some of {', '.join(WAYS)}")
    try:
        study = Study(given.encoders, given.samples, given.time_step)
    except (sim.MachineError, ValueError) as error:
        parser.error(str(error))
    rows: list[dict[str, Any]] = []
    for seed in tqdm(range(given.seeds), desc="seeds", disable=None):
        # Two numbers a seed: the encoders of the two recordings start elsewhere.
        trained, performed = (
            sim.simulate(study.machine, trajectory, seed=2 * seed + i)
            for i, trajectory in enumerate(study.trajectories)
        )
        patterns = study.judged(performed)
        for way, found in study.ways(trained.recording, given.ways).items():
            rows.append(study.row(seed, way, found, patterns))
            tqdm.write(f"seed {seed}, {way}: epsilon {rows[-1]['epsilon']:.4f} N m", sys.stderr)
    print(f"{given.seeds} seeds, {'encoders' if given.encoders else 'exact positions'}")
    print(summary(rows, given.ways, study.machine.joint_count))
    given.output.mkdir(parents=True, exist_ok=True)
    write_csv(given.output / "seeds.csv", rows)
    print(f"wrote {given.output / 'seeds.csv'}")
    return 0


if __name__ == "__main__":
    raise SystemExit(main())
