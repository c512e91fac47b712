"""A thousand simulated PUMA 560s, each recorded, trained and solved, all side by side.

Machines are drawn at random around the thesis's PUMA A and B: link parameters, friction, backlash
in compliant gears, and encoder resolution. MJX simulates the training recording of 7.4.1 and the
comparison recording of 7.4.2 of all of them at once, on a GPU where there is one. Recordings are
prepared on the CPU (averaged splines, masks of slow pairs). Then each machine's network is
identified twice from its training recording:

- **trained** from zero weights by backpropagation until the error cost falls below that of the
  published coefficients (Ar+LS), then by backpropagation and PERAL in turns (`side_by_side`);
- **solved** by least squares on the same patterns.

Both are judged by ε on the comparison recording, beside the published and the true coefficients.
The amplitudes are smaller than in the experiment, since these machines differ more. A sixth more
machines is drawn than asked for. Those whose joints leave their ranges, as a real arm's could not,
are counted and replaced by the next.

    python -m scripts.studies.training.thousand
    python -m scripts.studies.training.thousand --machines 64 --route backpropagation

Rows are kept in `rows.jsonl`; the same command prints them again.
"""

import argparse
import dataclasses
import time
from collections.abc import Generator, Sequence
from contextlib import contextmanager
from pathlib import Path
from typing import Any

import jax
import jax.numpy as jnp
import numpy as np

import jaxcslc as jc
import sim
from jaxcslc.report import all_or_nothing, write_csv, write_json
from jaxcslc.training import AdaptiveNetwork, inverse_dynamics
from scripts.studies import command
from scripts.studies.figures import save_picture
from scripts.studies.rows import Rows, made_of
from scripts.studies.stored import store
from scripts.studies.tables import cells_of, rows_table
from scripts.studies.training.learning_pictures import errors_picture
from scripts.studies.training.side_by_side import (
    EPOCHS,
    LEAST_REDUCTION,
    ROUTES,
    epsilon,
    stacked,
    train_side_by_side,
)
from scripts.studies.truth import published_coefficients, true_coefficients


jc.enable_x64()

OPTIONS = ("first", "seconds", "route", "least", "epochs", "rigid")
TRAINED, SOLVED, PUBLISHED, TRUE = "trained", "solved", "Ar+LS", "true coefficients"
METHODS = (TRAINED, SOLVED, TRUE, PUBLISHED)
QUANTILES = (0.0, 0.1, 0.5, 0.9, 1.0)
CODE = [Path(__file__), Path(__file__).with_name("side_by_side.py")]

# Factors of a machine's encoder resolutions, drawn as powers of two: half to four times that of
# Section 7.1. Factors of its backlashes are drawn from none to twice that of `sim.DISTURBANCES`.
_RESOLUTION_OCTAVES = (-1.0, 2.0)
_LARGEST_BACKLASH = 2.0
_ELASTIC = ("compliance", "backlash")
_DISTURBANCES = ("quantisation", "static friction")
_INTERVAL = 0.002  # s, of the trajectories
# Those of `sim.adjusted_training`, by factors of 0.4 to 0.9. Joints of 4 in 48 machines leave their
# ranges; with factors of one, those of 615 in 1,024 do.
_AMPLITUDE = (-20.0, -17.8, 16.3, -7.2, -4.6, -9.4)  # N m
_PERIOD = (4.1, 2.7, 1.7, 1.1, 0.7, 1.3)  # s
_START = (0.62, -1.55, 1.23, 0.39, 0.0, 0.18)  # rad
_MORE = 6  # one machine more is drawn for so many

# On two cores, all stages together: four machines with elastic gears take 20 s, compiled before.
_SECONDS_PER_MACHINE = 5.0
# As in `scripts.studies.puma560.machines`.
PREPARATIONS = {
    "training": jc.Preparation(
        jc.AveragedSplines(17), torque_alignment="previous", threshold_fraction=0.01
    ),
    "comparison": jc.Preparation(
        jc.AveragedSplines(17), torque_alignment="previous", thresholds=0.0, trim=100
    ),
}


def machine_of(seed: int, *, rigid: bool = False) -> sim.Machine:
    """A PUMA 560 drawn at random: around PUMA A if the seed is even, otherwise around PUMA B.

    **Arguments**

    - `seed`: which machine.
    - `rigid`: without compliance and backlash, which need integration steps a fifth as long.
    """
    design = (sim.puma_a, sim.puma_b)[seed % 2]()
    names = _DISTURBANCES if rigid else (*_DISTURBANCES, *_ELASTIC)
    machine = sim.disturbed(sim.specimen(design, seed), *names)
    rng = np.random.default_rng([seed, 1])  # not the draws of `specimen`
    resolution = 2.0 ** rng.uniform(*_RESOLUTION_OCTAVES, machine.joint_count)
    backlash = rng.uniform(0.0, _LARGEST_BACKLASH, machine.joint_count)
    return dataclasses.replace(
        machine,
        encoder_resolution=tuple((machine.encoder_resolution * resolution).tolist()),
        backlash=tuple((machine.backlash * backlash).tolist()),
    )


class Stages:
    """Seconds of a study's stages, and of these what JAX needs to trace and compile programs.

    **Attributes**

    - `seconds`: of each stage.
    - `compiling`: of each stage.
    """

    def __init__(self) -> None:
        self.seconds: dict[str, float] = {}
        self.compiling: dict[str, float] = {}
        self._stage: str | None = None
        jax.monitoring.register_event_duration_secs_listener(self._add)

    @contextmanager
    def measured(self, stage: str) -> Generator[None]:
        """Adds the time inside of the `with` to a stage, and prints it."""
        self._stage, start = stage, time.perf_counter()
        compiled = self.compiling.setdefault(stage, 0.0)
        try:
            yield
        finally:
            self._stage, taken = None, time.perf_counter() - start
        self.seconds[stage] = self.seconds.get(stage, 0.0) + taken
        compiled = self.compiling[stage] - compiled
        print(f"{stage}: {taken:.1f} s, of which {compiled:.1f} s compiling", flush=True)

    def _add(self, event: str, duration_secs: float, **_: Any) -> None:
        if self._stage is not None and event.startswith("/jax/core/compile"):
            self.compiling[self._stage] += duration_secs

    def rows(self) -> list[dict[str, Any]]:
        """A row for each stage."""
        return [
            {"stage": name, "seconds": seconds, "of which compiling": self.compiling[name]}
            for name, seconds in self.seconds.items()
        ]


def recorded(
    machines: dict[int, sim.Machine], trajectory: sim.Trajectory
) -> dict[int, jc.Recording | str]:
    """The recordings of machines by their seeds, or why there is none."""
    jobs = [sim.Job(machine, trajectory, seed) for seed, machine in machines.items()]
    seeds, results = list(machines), dict[int, jc.Recording | str]()
    for i, result in sim.record_each(jobs, backend="mjx", side_by_side=len(jobs)):
        failed = isinstance(result, sim.SimulationError)
        results[seeds[i]] = str(result) if failed else result.recording
    return results


def group_rows(
    seeds: Sequence[int],
    cslc: jc.CSLC,
    network: AdaptiveNetwork,
    options: argparse.Namespace,
    stages: Stages,
) -> list[dict[str, Any]]:
    """A row for each of the machines, all computed side by side."""
    with stages.measured("draw machines"):
        machines = {seed: machine_of(seed, rigid=options.rigid) for seed in seeds}
    training, comparison = trajectories(options.seconds)
    with stages.measured("record training"):
        results = recorded(machines, training)
    failed = {seed: result for seed, result in results.items() if isinstance(result, str)}
    with stages.measured("record comparison"):
        others = recorded(machines, comparison)
    failed |= {seed: result for seed, result in others.items() if isinstance(result, str)}
    of_training = {s: r for s, r in results.items() if not isinstance(r, str)}
    of_comparison = {s: r for s, r in others.items() if not isinstance(r, str)}
    kept = [seed for seed in seeds if seed not in failed][: options.machines]
    rows: list[dict[str, Any]] = [
        {"machine": seed, "design": design(seed), "failed": why} for seed, why in failed.items()
    ]
    if not kept:
        return rows
    with stages.measured("prepare"):
        learnt, judged = (
            [PREPARATIONS[name].patterns(recordings[seed]) for seed in kept]
            for name, recordings in (("training", of_training), ("comparison", of_comparison))
        )
    with stages.measured("examples"):
        training_set = stacked(network, learnt, equations=True)
        comparison_set = stacked(network, judged)
        jax.block_until_ready((training_set, comparison_set))
    published = jnp.asarray(published_coefficients(cslc))
    true = jnp.stack([true_coefficients(cslc, machines[seed]) for seed in kept])
    with stages.measured("train"):
        trained = train_side_by_side(
            cslc,
            training_set,
            published,
            ROUTES[options.route],
            least_reduction=options.least,
            epochs=options.epochs,
            timed=False,
        )
    with stages.measured("solve"):
        assert training_set.equations is not None
        direct = jax.block_until_ready(training_set.equations.solution())
    weights = {TRAINED: trained.weights, SOLVED: direct, PUBLISHED: published, TRUE: true}
    with stages.measured("judge"):
        errors, on_training = (
            {name: epsilon(network, part, weights[name]) for name in METHODS}
            for part in (comparison_set, training_set)
        )
    backpropagation, peral = trained.epochs()
    endings = trained.training.endings()
    for i, seed in enumerate(kept):
        rows.append(
            {
                "machine": seed,
                "design": design(seed),
                "failed": "",
                **{f"{name}, ε": float(errors[name][i]) for name in METHODS},
                **{f"{name}, training ε": float(on_training[name][i]) for name in METHODS},
                "epochs of backpropagation": int(backpropagation[i]),
                "epochs of PERAL": int(peral[i]),
                "ended": endings[i],
            }
        )
    return rows


def design(seed: int) -> str:
    """The machine that one with this seed is drawn around."""
    return f"PUMA {'AB'[seed % 2]}"


def trajectories(seconds: tuple[float, float]) -> tuple[sim.Trajectory, sim.Trajectory]:
    """Training and comparison, of so many seconds each."""
    training, comparison = seconds
    return (
        sim.training(
            samples=round(training / _INTERVAL),
            amplitude=_AMPLITUDE,
            period=_PERIOD,
            start=_START,
        ),
        sim.comparison(duration=comparison),
    )


def quantile_rows(rows: Sequence[dict[str, Any]]) -> list[dict[str, Any]]:
    """Quantiles over machines of each method's ε, and of trained over solved."""
    values = {f"{name}, ε [N m]": [row[f"{name}, ε"] for row in rows] for name in METHODS}
    values["trained over solved"] = [row[f"{TRAINED}, ε"] / row[f"{SOLVED}, ε"] for row in rows]
    values["solved over true coefficients"] = [
        row[f"{SOLVED}, ε"] / row[f"{TRUE}, ε"] for row in rows
    ]
    epochs = [row["epochs of backpropagation"] + row["epochs of PERAL"] for row in rows]
    values["epochs"] = list(map(float, epochs))
    return [
        {"": name}
        | {
            {0.0: "lowest", 0.5: "median", 1.0: "highest"}.get(q, f"{100 * q:g} %"): float(
                np.quantile(numbers, q)
            )
            for q in QUANTILES
        }
        for name, numbers in values.items()
    ]


def study(options: argparse.Namespace) -> int:
    """Makes the rows that are missing, prints tables and writes the files."""
    cslc = jc.derive(jc.puma560())
    network = inverse_dynamics(cslc)
    digest = made_of({name: getattr(options, name) for name in OPTIONS}, CODE)
    finished = Rows(options.output / "rows.jsonl", ("machine",), digest)
    drawn = options.machines + -(-options.machines // _MORE)
    wanted = range(options.first, options.first + drawn)
    missing = [] if (options.first,) in finished else list(wanted)
    stages = Stages()
    start = time.perf_counter()
    if missing:
        print(f"{len(missing)} machines, {jax.devices()[0].device_kind}", flush=True)
        finished.add(*group_rows(missing, cslc, network, options, stages))
    total = time.perf_counter() - start
    every = [finished[(seed,)] for seed in wanted if (seed,) in finished]
    rows = [row for row in every if not row["failed"]][: options.machines]
    if stages.seconds:
        print(rows_table(stages.rows()))
        print(f"{total:.1f} s in all")
    left = sum(bool(row["failed"]) for row in every)
    print(f"{len(rows)} machines; joints of {left} of {drawn} left their ranges")
    if not rows:
        return 1
    quantiles = quantile_rows(rows)
    print(rows_table(quantiles))
    if stages.seconds:  # not those of an earlier run
        sample = f"{len(rows):,} machines, {jax.devices()[0].device_kind}"
        names = {f"{name}, ε [N m]": name for name in METHODS}
        errors = [names.get(cells[0], cells[0]) for cells in cells_of(quantiles)]
        table = [
            [name, *cells[1:]] for name, cells in zip(errors, cells_of(quantiles), strict=True)
        ]
        store(options, "thousand", sample, {"errors": table, "stages": cells_of(stages.rows())})
    for ended in sorted({row["ended"] for row in rows}):
        print(f"{sum(row['ended'] == ended for row in rows)} trainings ended: {ended}")
    with all_or_nothing(options.output) as folder:
        write_csv(folder / "machines.csv", rows)
        arguments = vars(options) | {"output": str(options.output)}
        write_json(
            folder / "thousand.json",
            {
                "quantiles": quantiles,
                "stages": stages.rows(),
                "seconds": total,
                "device": jax.devices()[0].device_kind,
                "machines": {"drawn": drawn, "left their ranges": left, "kept": len(rows)},
                "command": arguments,
            },
        )
        series = {name: np.array([row[f"{name}, ε"] for row in rows]) for name in METHODS}
        ratio = series[TRAINED] / series[SOLVED]
        save_picture(errors_picture(series, ratio), folder / "thousand.png")
    print(f"wrote {options.output}")
    return 0


def main(argv: Sequence[str] | None = None) -> int:
    parser = command.new_parser(__doc__, "thousand")
    parser.add_argument("--machines", type=int, default=1024, help="how many")
    parser.add_argument("--first", type=int, default=0, help="the first machine's seed")
    parser.add_argument("--seconds", type=float, nargs=2, default=[6.6, 2.5],
                        metavar=("TRAINING", "COMPARISON"), help="of the recordings")  # fmt: skip
    parser.add_argument("--route", default="backpropagation and PERAL", choices=ROUTES,
                        help="rules of the trainings")  # fmt: skip
    parser.add_argument("--least", type=float, default=LEAST_REDUCTION,
                        help="reduction of the cost per epoch that ends it [(N m)^2]")  # fmt: skip
    parser.add_argument("--epochs", type=int, default=EPOCHS, help="at most")
    parser.add_argument("--rigid", action="store_true", help="without compliance and backlash")
    command.add_store(parser)
    options = command.parse(parser, argv, machines=4, rigid=True, epochs=1000)
    command.require_least(parser, options, machines=1, epochs=1, first=0)
    if min(options.seconds) < 0.2:
        parser.error(f"--seconds is {options.seconds}; expected 0.2 or more of each recording")
    if options.quick:
        command.compile_quickly()
    return command.run(
        parser,
        lambda: study(options),
        options.output / "rows.jsonl",
        seconds=60.0 + _SECONDS_PER_MACHINE * options.machines,
    )


if __name__ == "__main__":
    raise SystemExit(main())
