"""Rotor and link as two bodies: stiffness, play and coefficients against the truth.

- **Two masses**: one joint with gears of 8 Hz (the link while the rotor stands still), 4 mrad of
  play and none, integrated step by step; encoder counts of 5e-5 rad, torque noise of 0.05 N m.
- **Soft PUMA**: a PUMA 560 whose first three joints have gears eight times as soft as those of the
  simulator's compliance, which makes 5 to 9 Hz, with 2 mrad of play; counts of its encoders, torque
  noise of 0.1 N m.

Each is fitted by maximum likelihood with rotors and links apart, and with rigid gears: positions at
every sample, and at every third. Torque errors are those of rigid bodies, between fitted and true
coefficients, on motion drawn at random, at the worst joint.

Rows of finished seeds are kept in `rows.jsonl`; an interrupted run goes on from there.
"""

import argparse
import dataclasses
import math
import time
from collections.abc import Iterator, Mapping, Sequence
from pathlib import Path
from typing import Any

import numpy as np
from jaxtyping import Float

import jaxcslc as jc
import sim
from jaxcslc._text_table import text_table
from jaxcslc.report import write_csv
from scripts.studies import command
from scripts.studies.likelihood.elastic_gears import fit_with_gears
from scripts.studies.likelihood.two_masses import network_of_two_masses, two_masses
from scripts.studies.rows import Rows, made_of


jc.enable_x64()

TOYS: Mapping[str, float] = {"two masses, play 4 mrad": 4e-3, "two masses, no play": 0.0}
ARM = "soft PUMA"
_COUNT, _TOY_NOISE, _NOISE = 5e-5, 0.05, 0.1
_SOFT, _PLAY, _JOINTS = 8.0, 2e-3, (1, 2, 3)
_RIGID: dict[str, dict[str, Any]] = {"rigid": {"every": 1}, "rigid, every 3": {"every": 3}}


@dataclasses.dataclass(frozen=True)
class Truth:
    """What a recording is of: coefficients, and (f,) of gears."""

    network: jc.CSLC
    k: Float[np.ndarray, " coefficients"]
    compliance: Float[np.ndarray, " links"]
    play: Float[np.ndarray, " links"]
    rotor_inertia: Float[np.ndarray, " links"]
    lag: Float[np.ndarray, " links"]


def toy(play: float, seed: int, samples: int) -> tuple[jc.Recording, Truth]:
    """Two masses."""
    true = two_masses(play, samples, seed=seed)
    recording = true.recording(_COUNT, _TOY_NOISE, np.random.default_rng(seed))
    gears = (1.0 / true.stiffness, play, true.rotor_inertia, true.damping / true.stiffness)
    return recording, Truth(network_of_two_masses(), true.k, *(np.array([x]) for x in gears))


def soft_puma(seed: int, samples: int) -> tuple[jc.Recording, Truth]:
    """A PUMA 560 with soft gears."""
    base, compliance = sim.puma560(), sim.DISTURBANCES["compliance"]
    soft, rigid = len(_JOINTS), 6 - len(_JOINTS)
    stiffness = np.array(compliance["stiffness"][:soft]) / _SOFT
    damping = np.array(compliance["transmission_damping"][:soft]) / math.sqrt(_SOFT)
    machine = dataclasses.replace(
        base,
        static=base.dry,
        stiffness=(*stiffness.tolist(), *(math.inf,) * rigid),
        transmission_damping=(*damping.tolist(), *(0.0,) * rigid),
        backlash=(*(_PLAY,) * soft, *(0.0,) * rigid),
        time_step=2e-4,
    )
    recording, _ = sim.simulate(
        machine, sim.training(samples=samples, robot=machine.robot), seed=seed
    )
    noise = _NOISE * np.random.default_rng(seed).normal(size=(samples, 6))
    network = jc.derive(jc.puma560().with_friction("viscous", "dry"))
    k = network.coefficients_from(machine.links, viscous=machine.viscous, dry=machine.dry)
    inertia = np.array([float(link.motor_inertia) for link in machine.links[:soft]])
    noisy = dataclasses.replace(recording, torque=np.asarray(recording.torque) + noise)
    gears = (1.0 / stiffness, np.full(soft, _PLAY), inertia, damping / stiffness)
    return noisy, Truth(network, np.asarray(k), *gears)


def rows_of(
    name: str, recording: jc.Recording, truth: Truth, seed: int
) -> Iterator[dict[str, Any]]:
    """One row an estimator."""
    joints = tuple(range(1, len(truth.compliance) + 1))
    for estimator in ("apart", *_RIGID):
        started = time.process_time()
        options, gears = jc.MaximumLikelihood(**_RIGID.get(estimator, {})), None
        if estimator == "apart":
            apart = fit_with_gears(options, truth.network, recording, joints)
            fit, gears = apart.fit, apart.gears
        else:
            fit = options.fit(truth.network, recording)
        row: dict[str, Any] = {
            "case": name,
            "seed": seed,
            "estimator": estimator,
            "error": torque_error(truth, np.asarray(fit.k)),
            "inside": inside(fit, truth),
            "converged": fit.converged,
            "seconds": time.process_time() - started,
        }
        if gears is not None:
            row |= {
                "joints": list(gears.joints),
                "stiffness": (gears.stiffness * truth.compliance).tolist(),
                "play": gears.play.tolist(),
                "inertia": (gears.rotor_inertia / truth.rotor_inertia).tolist(),
                "stiffness_inside": float(
                    np.mean(
                        np.abs(gears.compliance - truth.compliance) < 2 * gears.compliance_error
                    )
                ),
                "play_inside": float(
                    np.mean(np.abs(gears.play - truth.play) < 2 * gears.play_error)
                ),
                "lag_inside": float(np.mean(np.abs(gears.lag - truth.lag) < 2 * gears.lag_error)),
            }
        yield row


def torque_error(truth: Truth, k: Float[np.ndarray, " coefficients"]) -> float:
    """RMS at the worst joint, of rigid bodies on motion drawn at random [N m]."""
    rng, n = np.random.default_rng(0), truth.network.joint_count
    q, qd, qdd = rng.uniform(-1, 1, (3, 300, n)) * np.array([1.0, 2.0, 8.0])[:, None, None]
    errors = np.asarray(truth.network.torque(k - truth.k, q, qd, qdd))
    return float(np.sqrt(np.mean(errors**2, axis=0)).max())


def inside(fit: jc.LikelihoodFit, truth: Truth) -> float:
    """Return how many intervals of 95 % hold the true coefficient, in percent."""
    low, high = np.asarray(fit.fit.confidence_interval()).T
    return 100 * float(np.mean((low <= truth.k) & (truth.k <= high)))


def table(rows: Sequence[dict[str, Any]], name: str) -> str:
    """Return the table of one case: torque errors, intervals, gears."""
    lines: list[list[str]] = []
    of_case = [row for row in rows if row["case"] == name]
    for estimator in dict.fromkeys(row["estimator"] for row in of_case):
        part = [row for row in of_case if row["estimator"] == estimator]
        error = [row["error"] for row in part]
        apart = [row for row in part if "stiffness" in row]
        stiffness = [abs(value - 1.0) for row in apart for value in row["stiffness"]]
        gears = [""] * 4
        if apart:
            gears = [
                f"{100 * np.median(stiffness):.2g} %, {100 * np.max(stiffness):.2g} %",
                f"{100 * np.mean([row['stiffness_inside'] for row in apart]):.0f} %",
                *(
                    f"{100 * np.mean([row[name] for row in apart]):.0f} %"
                    for name in ("play_inside", "lag_inside")
                ),
            ]
        lines.append(
            [
                estimator,
                *(f"{f(error):.3g}" for f in (np.median, np.max)),
                f"{np.mean([row['inside'] for row in part]):.0f} %",
                *gears,
                f"{sum(row['converged'] for row in part)} of {len(part)}",
                f"{np.median([row['seconds'] for row in part]):.1f}",
            ]
        )
    header = [
        name,
        "torque error [N m], median",
        "greatest",
        "intervals with truth",
        "stiffness off by, median, greatest",
        "intervals with truth",
        "of play",
        "of damping over stiffness",
        "converged",
        "s",
    ]
    return text_table(header, lines)


def study(options: argparse.Namespace) -> int:
    """Makes what is missing, prints the tables and writes the rows."""
    digest = made_of({"samples": options.samples}, [Path(__file__)])
    finished = Rows(options.output / "rows.jsonl", ("case", "seed", "estimator"), digest)
    cases = [
        (name, seed)
        for seed in range(options.first, options.first + options.seeds)
        for name in (*TOYS, ARM)
        if name in TOYS or seed < options.first + options.arms
    ]
    for name, seed in command.progress(cases, desc="cases", unit="case"):
        if (name, seed, list(_RIGID)[-1]) in finished:
            continue
        if name in TOYS:
            recording, truth = toy(TOYS[name], seed, options.samples // 2)
        else:
            recording, truth = soft_puma(seed, options.samples)
        for row in rows_of(name, recording, truth, seed):
            finished.add(row)
    rows = [row for row in finished.all() if (row["case"], row["seed"]) in cases]
    for name in dict.fromkeys(name for name, _ in cases):
        print(table(rows, name), end="\n\n")
    write_csv(options.output / "seeds.csv", rows)
    print(f"wrote {options.output / 'seeds.csv'}")
    return 0


def main(argv: Sequence[str] | None = None) -> int:
    parser = command.new_parser(__doc__, "two_mass")
    parser.add_argument("--seeds", type=int, default=10, help="how many, of two masses")
    parser.add_argument("--arms", type=int, default=3, help="how many of them, of arms too")
    parser.add_argument("--first", type=int, default=0, help="the first seed")
    parser.add_argument("--samples", type=int, default=3300, help="of arms, 2 ms apart")
    options = command.parse(parser, argv, seeds=1, arms=0, samples=1600)
    command.require_least(parser, options, seeds=1, arms=0, first=0, samples=600)
    return command.run(
        parser,
        lambda: study(options),
        options.output / "rows.jsonl",
        seconds=10.0 * options.seeds + 150.0 * options.arms * options.samples / 3300,
    )


if __name__ == "__main__":
    raise SystemExit(main())
