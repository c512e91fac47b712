"""A thousand simulated PUMA 560s, each recorded, trained and solved, all side by side.

Machines are drawn at random around the thesis's PUMA A and B: link parameters, friction, backlash
in compliant gears, and encoder resolution. MJX simulates the training recording of 7.4.1 and the
comparison recording of 7.4.2 of all of them at once, on a GPU where there is one. Recordings are
prepared on the CPU's cores (averaged splines, masks of slow pairs). Then each machine's network is
identified twice from its training recording:

- **trained** from zero weights by the thesis's schedule (7.5): backpropagation until the error cost
  falls below that of the published coefficients (Ar+LS), then bouts with PERAL;
- **solved** by least squares.

Both are judged by ε on the comparison recording, beside the published and the true coefficients.
Machines whose joints leave their ranges, as a real arm's could not, are counted and left out.

    python -m scripts.studies.training.thousand
    python -m scripts.studies.training.thousand --machines 64 --least 1e-4 --every 3

Each group of machines is written to `rows.jsonl` when it is finished; an interrupted run goes on
from there.
"""

import argparse
import dataclasses
import time
from collections.abc import Iterator, Sequence
from concurrent.futures import ThreadPoolExecutor
from contextlib import contextmanager
from pathlib import Path
from typing import Any

import equinox as eqx
import jax
import jax.numpy as jnp
import numpy as np
from jaxtyping import Array, Float

import jaxcslc as jc
import sim
from jaxcslc.adaptive import AdaptiveNetwork, inverse_dynamics
from jaxcslc.identification.report import all_or_nothing, write_csv, write_json
from jaxcslc.plotting import save_picture
from jaxcslc.training import Examples, examples, half_rms, train
from scripts.studies import command
from scripts.studies.rows import Rows, made_of
from scripts.studies.tables import rows_table
from scripts.studies.training.thesis_route import plan_of
from scripts.studies.training.thousand_picture import errors_picture
from scripts.studies.truth import published_coefficients, true_coefficients


jax.config.update("jax_enable_x64", True)

OPTIONS = ("first", "seconds", "every", "least", "bout", "epochs", "rigid")
TRAINED, SOLVED, PUBLISHED, TRUE = "trained", "solved", "Ar+LS", "true coefficients"
METHODS = (TRAINED, SOLVED, TRUE, PUBLISHED)
QUANTILES = (0.0, 0.1, 0.5, 0.9, 1.0)
CODE = [Path(__file__), Path(__file__).with_name("thesis_route.py")]

# Factors of a machine's encoder resolutions, drawn as powers of two: half to four times that of
# Section 7.1. Factors of its backlashes are drawn from none to twice that of `sim.DISTURBANCES`.
_RESOLUTION_OCTAVES = (-1.0, 2.0)
_LARGEST_BACKLASH = 2.0
_ELASTIC = ("compliance", "backlash")
_DISTURBANCES = ("quantisation", "static friction")
# Joints that move, as in the experiment of Chapter 7.
_MOVING = 0.05  # rad/s
_INTERVAL = 0.002  # s, of the trajectories
# Machines that one pass of the direct solve holds at a time: their equations take 0.4 GB.
_SOLVED_TOGETHER = 64
_CHUNK = 250  # epochs between looks at whether all trainings have ended

PREPARATIONS = {
    "training": jc.Preparation(torque_alignment="mean", threshold_fraction=0.01),
    "comparison": jc.Preparation(
        jc.AveragedSplines(17), torque_alignment="mean", thresholds=_MOVING
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
    def measured(self, stage: str) -> Iterator[None]:
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

    def _add(self, event: str, seconds: float, **_: Any) -> None:
        if self._stage is not None and event.startswith("/jax/core/compile"):
            self.compiling[self._stage] += seconds

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
    for i, result in sim.record_each(jobs, backend="mjx"):
        failed = isinstance(result, sim.SimulationError)
        results[seeds[i]] = str(result) if failed else result.recording
    return results


def prepared(recordings: Sequence[jc.Recording], preparation: jc.Preparation) -> jc.Patterns:
    """Patterns of recordings of one length, with a leading axis of recordings."""
    with ThreadPoolExecutor() as pool:
        parts = list(pool.map(preparation.patterns, recordings))
    return jax.tree.map(lambda *values: np.stack(values), *parts)


@eqx.filter_jit
def examples_of_all(network: AdaptiveNetwork, patterns: jc.Patterns) -> Examples:
    """Examples with a leading axis of machines."""
    return jax.vmap(lambda p: examples(network, p, p.torque, p.mask))(patterns)


@eqx.filter_jit
def solved(cslc: jc.CSLC, patterns: jc.Patterns) -> Float[Array, "machines coefficients"]:
    """Coefficients of each machine by least squares."""
    solver = jc.LeastSquares(joint_weights="equal", errors="independent")
    return jax.lax.map(
        lambda one: solver.fit(cslc, one, throw=False).k, patterns, batch_size=_SOLVED_TOGETHER
    )


@eqx.filter_jit
def errors_of(
    network: AdaptiveNetwork, of_all: Examples, weights: Float[Array, "machines coefficients"]
) -> Float[Array, " machines"]:
    """The thesis's ε of each machine [N m]."""
    return jax.vmap(lambda part, w: part.costs(network, w, half_rms)[0])(of_all, weights)


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
    of_training = {s: r for s, r in results.items() if isinstance(r, jc.Recording)}
    of_comparison = {s: r for s, r in others.items() if isinstance(r, jc.Recording)}
    kept = [seed for seed in seeds if seed not in failed]
    rows = [
        {"machine": seed, "design": design(seed), "failed": why} for seed, why in failed.items()
    ]
    if not kept:
        return rows
    with stages.measured("prepare"):
        learnt, judged = (
            prepared([recordings[seed] for seed in kept], PREPARATIONS[name])
            for name, recordings in (("training", of_training), ("comparison", of_comparison))
        )
        thinned = jax.tree.map(lambda x: x[:, :: options.every], learnt)
    with stages.measured("examples"):
        training_set, comparison_set = (examples_of_all(network, x) for x in (thinned, judged))
        jax.block_until_ready((training_set, comparison_set))
    published = jnp.broadcast_to(published_coefficients(cslc), (len(kept), network.size))
    true = jnp.stack([true_coefficients(cslc, machines[seed]) for seed in kept])
    with stages.measured("train"):
        trained = train(
            network,
            training_set,
            jnp.zeros((len(kept), network.size)),
            plan_of(errors_of(network, training_set, published), options.least, bout=options.bout),
            epochs=options.epochs,
            keep_weights=False,
            chunk=_CHUNK,
            progress=True,
            throw=False,
        )
    with stages.measured("solve"):
        direct = jax.block_until_ready(solved(cslc, learnt))
    weights = {TRAINED: trained.weights, SOLVED: direct, PUBLISHED: published, TRUE: true}
    with stages.measured("judge"):
        errors, on_training = (
            {name: np.asarray(errors_of(network, part, weights[name])) for name in METHODS}
            for part in (comparison_set, training_set)
        )
    rule, outcomes = np.asarray(trained.history.rule), trained.outcomes()
    for i, seed in enumerate(kept):
        rows.append(
            {
                "machine": seed,
                "design": design(seed),
                "failed": "",
                **{f"{name}, ε": float(errors[name][i]) for name in METHODS},
                **{f"{name}, training ε": float(on_training[name][i]) for name in METHODS},
                "epochs of backpropagation": int(np.sum(rule[i] == 0)),
                "epochs of PERAL": int(np.sum(rule[i] == 1)),
                "ended": outcomes[i],
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
        sim.training(samples=round(training / _INTERVAL)),
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
    wanted = range(options.first, options.first + options.machines)
    missing = [seed for seed in wanted if (seed,) not in finished]
    stages = Stages()
    start = time.perf_counter()
    for begin in range(0, len(missing), options.together):
        group = missing[begin : begin + options.together]
        print(f"machines {group[0]} to {group[-1]}, {jax.devices()[0].device_kind}", flush=True)
        finished.add(*group_rows(group, cslc, network, options, stages))
    total = time.perf_counter() - start
    every = [finished[(seed,)] for seed in wanted]
    rows = [row for row in every if not row["failed"]]
    if stages.seconds:
        print(rows_table(stages.rows()))
        print(f"{total:.1f} s in all")
    print(f"{len(rows)} of {len(every)} machines; the others' joints left their ranges")
    if not rows:
        return 1
    quantiles = quantile_rows(rows)
    print(rows_table(quantiles))
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
                "machines": {"recorded": len(every), "kept": len(rows)},
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
    parser.add_argument("--together", type=int, default=1024, help="machines side by side")
    parser.add_argument("--seconds", type=float, nargs=2, default=[6.6, 2.5],
                        metavar=("TRAINING", "COMPARISON"), help="of the recordings")  # fmt: skip
    parser.add_argument("--every", type=int, default=1,
                        help="one pattern in so many is trained on")  # fmt: skip
    parser.add_argument("--least", type=float, default=1e-5,
                        help="reduction of an epoch that ends a training [N m]")  # fmt: skip
    parser.add_argument("--bout", type=int, default=100, help="epochs of a rule before it turns")
    parser.add_argument("--epochs", type=int, default=6000, help="at most")
    parser.add_argument("--rigid", action="store_true", help="without compliance and backlash")
    options = command.parse(parser, argv, machines=4, rigid=True, every=3, epochs=1000, least=1e-4)
    command.require_least(
        parser, options, machines=1, together=1, every=1, bout=1, epochs=1, first=0
    )
    if min(options.seconds) < 0.2:
        parser.error(f"--seconds is {options.seconds}; expected 0.2 or more of each recording")
    if options.quick:
        command.compile_quickly()
    patterns = options.seconds[0] / _INTERVAL / options.every
    a_machine = 1.0 + 4e-6 * options.epochs * patterns
    return command.run(
        parser,
        lambda: study(options),
        options.output / "rows.jsonl",
        seconds=60.0 + a_machine * options.machines,
    )


if __name__ == "__main__":
    raise SystemExit(main())
