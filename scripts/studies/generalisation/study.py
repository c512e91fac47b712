"""Do other networks generalise? Section 4.3's claim, on recordings of a simulated PUMA 560.

Sigmoidal multilayer networks and networks of radial basis functions of several sizes learn the
torques of the training recording from positions, velocities and accelerations (18 inputs, 6
outputs), and foretell those of the comparison recording, as does the CSLC fitted to the very same
patterns. Every seed has recordings, a stop set and starting weights of its own.

- **Patterns.** Recordings are smoothed and masked with the settings that `choose_settings` finds on
  the first training recording for the CSLC. Of 20 stretches of time of each training recording, 4
  are its stop set (3.6.1). The comparison recording is prepared as in `puma560_experiment.py`, and
  is judged where a joint moves.
- **Sigmoidal**: hyperbolic-tangent hidden nodes, linear outputs, Adam on mini-batches.
- **Radial basis**: Gaussians; centres by k-means, outputs by ridge regression, with the width and
  the ridge that the stop set likes best; then everything is trained by Adam as above.
- **Stop set.** The weights kept are those of the epoch of least stop-set error; what the last epoch
  would have given is in the table too. The rate falls to zero along half a cosine, so the last
  epochs change little.
- **Pruned** (3.6.2): a trained network without the links to which the training-set error is not
  sensitive (`jaxcslc.training`'s `prune`), trained again; several rounds of both. In each round the
  mean square error may grow to (1 + tolerance) times itself before the network is trained again.
- Inputs and torques are standardised by the training patterns. In 'sin cos' networks each position
  is replaced by its sine and cosine, 24 inputs in all: a part of what the CSLC is told.
- **In range**: those comparison patterns whose inputs, each for itself, lie in the range that the
  training patterns span. The others ask for extrapolation.
- **ε** (7.5): half the root mean square over joints of a pattern's errors, averaged over patterns.
- **Mean torque**: no network, but each joint's mean torque of the training patterns, for a measure
  of what not to know anything costs.
- **Order** (4.2): the highest product, over all routes from inputs to outputs, of the number of
  links to each node, biases included. Radial basis functions neither rise nor fall everywhere,
  which Section 4.2 asks for, so their networks have none.

Rows of finished networks are kept in `rows.jsonl`; a call that was interrupted goes on from there.
"""

import argparse
import dataclasses
import json
from collections.abc import Mapping, Sequence
from pathlib import Path
from typing import Any

import equinox as eqx
import jax
import jax.numpy as jnp
import numpy as np
from jaxtyping import Bool
from matplotlib.figure import Figure
from tqdm import tqdm

import jaxcslc as jc
import sim
from jaxcslc.identification import all_or_nothing, text_table, write_csv
from jaxcslc.plotting import save_picture
from scripts.studies.generalisation.networks import (
    PARTS,
    Data,
    Part,
    Sigmoidal,
    epsilon,
    errors,
    flat,
    order_of,
    pruned,
    stacked,
    start_radial,
    trained,
)
from scripts.studies.generalisation.pictures import generalisation_picture


jax.config.update("jax_enable_x64", True)

MOVING = 0.01  # rad/s
STRETCHES, GROUP = 20, 5  # one of every five stretches is in the stop set
MACHINES = {
    "puma560": sim.puma560,
    "a": lambda: sim.disturbed(sim.puma_a()),
    "b": lambda: sim.disturbed(sim.puma_b()),
}
CSLC, MEAN = "CSLC", "mean torque"


@dataclasses.dataclass(frozen=True)
class Kind:
    """A network to be trained."""

    family: str
    hidden: tuple[int, ...]
    trigonometric: bool = False
    pruned: bool = False

    @property
    def name(self) -> str:
        return f"{self.family} {'-'.join(str(h) for h in self.hidden)}"


TANH, RBF, SIN_COS = "tanh", "radial basis", "sin cos"
STANDARD = (
    *(Kind(TANH, (h,)) for h in (4, 8, 16, 32, 64)),
    *(Kind(f"{TANH} two layers", (h, h)) for h in (8, 16, 32)),
    Kind(f"{TANH} pruned", (32,), pruned=True),
    *(Kind(f"{TANH} {SIN_COS}", (h,), trigonometric=True) for h in (16, 64)),
    *(Kind(RBF, (h,)) for h in (16, 64, 256)),
    *(Kind(f"{RBF} {SIN_COS}", (h,), trigonometric=True) for h in (16, 64)),
)
# Not trained unless they are asked for.
MORE = (
    *(Kind(TANH, (h,)) for h in (2, 128)),
    Kind(f"{TANH} two layers", (64, 64)),
    *(Kind(f"{TANH} pruned", (h,), pruned=True) for h in (16, 64)),
    Kind(f"{TANH} pruned {SIN_COS}", (32,), trigonometric=True, pruned=True),
    Kind(f"{RBF} {SIN_COS}", (256,), trigonometric=True),
)
QUICK = (
    Kind(TANH, (4,)),
    Kind(f"{TANH} pruned", (4,), pruned=True),
    Kind(f"{RBF} {SIN_COS}", (8,), trigonometric=True),
)


def stop_set(samples: int, seed: int) -> Bool[np.ndarray, " samples"]:
    """One stretch of time drawn from each group of five; as many patterns for every seed."""
    rng = np.random.default_rng(seed)
    length = samples // STRETCHES
    chosen = np.zeros(samples, dtype=bool)
    for first in range(0, STRETCHES, GROUP):
        start = (first + int(rng.integers(GROUP))) * length
        chosen[start : start + length] = True
    return chosen


def inputs_of(patterns: jc.Patterns, trigonometric: bool) -> np.ndarray:
    q = np.asarray(patterns.q)
    positions = [np.sin(q), np.cos(q)] if trigonometric else [q]
    return np.concatenate([*positions, patterns.qd, patterns.qdd], axis=1)


def in_range(
    judged: jc.Patterns, patterns: jc.Patterns, some: Bool[np.ndarray, " samples"]
) -> Bool[np.ndarray, " judged"]:
    """Which patterns have each of their inputs within the range of the others' same input."""
    known, asked = inputs_of(patterns, False)[some], inputs_of(judged, False)
    return np.all((asked >= known.min(axis=0)) & (asked <= known.max(axis=0)), axis=1)


def data_of(
    training: Sequence[jc.Patterns],
    stop: Sequence[np.ndarray],
    comparison: Sequence[jc.Patterns],
    trigonometric: bool,
) -> Data:
    """Everything in float32, as networks are usually trained."""

    def part(x: np.ndarray, torque: Any, counts: np.ndarray) -> Part:
        return Part(jnp.asarray(x, "float32"), jnp.asarray(torque, "float32"), jnp.asarray(counts))

    rows: list[Data] = []
    for patterns, stopping, judged in zip(training, stop, comparison, strict=True):
        known = ~stopping
        x, later = (inputs_of(p, trigonometric) for p in (patterns, judged))
        torque, counts = np.asarray(patterns.torque), np.asarray(patterns.mask)
        middle, spread = x[known].mean(axis=0), x[known].std(axis=0)
        x, later = (x - middle) / spread, (later - middle) / spread
        counted = np.asarray(judged.mask)
        seen = in_range(judged, patterns, known)[:, None]
        taught = np.where(counts & known[:, None], torque, np.nan)
        rows.append(
            Data(
                training=part(x[known], torque[known], counts[known]),
                stop=part(x[stopping], torque[stopping], counts[stopping]),
                comparison=part(later, judged.torque, counted),
                in_range=part(later, judged.torque, counted & seen),
                mean=jnp.asarray(np.nanmean(taught, axis=0), "float32"),
                scale=jnp.asarray(np.nanstd(taught, axis=0), "float32"),
            )
        )
    return stacked(rows)


def train(kind: Kind, data: Data, given: argparse.Namespace, bar: Any) -> dict[str, Any]:
    """One network, all seeds: its row."""
    seeds, _, inputs = data.training.x.shape
    keys = jax.random.split(jax.random.key(0), seeds)
    sizes = (inputs, *kind.hidden, data.mean.shape[1])
    order: list[int | None] = [None] * seeds
    if kind.family.startswith(RBF):
        start = eqx.filter_jit(eqx.filter_vmap(lambda d, k: start_radial(d, kind.hidden[0], k)))
        network = start(data, keys)
        rate = 3e-3
    else:
        start = eqx.filter_jit(eqx.filter_vmap(lambda key: Sigmoidal(sizes, key)))
        network = start(keys)
        rate = 1e-2 if len(kind.hidden) == 1 else 5e-3
    kept = jax.tree.map(jnp.ones_like, network)
    best, last = trained(network, data, kept, given, rate, bar)
    for _ in range(given.rounds if kind.pruned else 0):
        network, kept = pruned(best, data, sizes, given.tolerance)
        best, last = trained(network, data, kept, given, rate, bar)
    masks = [flat(kept, seed) > 0 for seed in range(seeds)]
    if isinstance(best, Sigmoidal):
        order = [order_of(best.link_ends(), mask) for mask in masks]
    stopped, last_of_all = (
        {name: np.asarray(values).tolist() for name, values in errors(some, data).items()}
        for some in (best, last)
    )
    weights = [int(mask.sum()) for mask in masks]
    return row_of(kind.name, kind.family, inputs, weights, order, stopped, last_of_all)


def fitted(
    network: jc.CSLC,
    settings: jc.Settings,
    training: Sequence[jc.Patterns],
    stop: Sequence[np.ndarray],
    comparison: Sequence[jc.Patterns],
) -> dict[str, Any]:
    """The CSLC's row: fitted to the patterns that the networks are trained on."""
    found: dict[str, list[float]] = {name: [] for name in PARTS}
    for patterns, stopping, judged in zip(training, stop, comparison, strict=True):
        known = dataclasses.replace(
            patterns, backlash_mask=patterns.backlash_mask & ~stopping[:, None]
        )
        k = settings.fit(network, known).k
        here = jc.identification.torque_errors(network, patterns, k)
        there = jc.identification.torque_errors(network, judged, k)
        counts, counted = np.asarray(patterns.mask), np.asarray(judged.mask)
        seen = in_range(judged, patterns, ~stopping)[:, None]
        cases = (
            (here, counts & ~stopping[:, None]),
            (here, counts & stopping[:, None]),
            (there, counted),
            (there, counted & seen),
        )
        for name, (error, some) in zip(PARTS, cases, strict=True):
            found[name].append(float(epsilon(error, jnp.asarray(some))))
    seeds, n = len(training), network.joint_count
    size, order = len(network.coefficients), network.order
    return row_of(CSLC, CSLC, 3 * n, [size] * seeds, [order] * seeds, found, found)


def constant(data: Data) -> dict[str, Any]:
    """The row of no network at all: each joint's mean torque of the training patterns."""
    found = {
        name: [
            float(epsilon(part.torque[seed] - mean[None], part.counts[seed]))
            for seed, mean in enumerate(data.mean)
        ]
        for name in PARTS
        for part in [getattr(data, name)]
    }
    seeds, joints = data.mean.shape
    return row_of(MEAN, MEAN, 0, [joints] * seeds, [None] * seeds, found, found)


def row_of(
    name: str,
    family: str,
    inputs: int,
    weights: Sequence[int],
    order: Sequence[int | None],
    stopped: Mapping[str, Sequence[float]],
    last: Mapping[str, Sequence[float]],
) -> dict[str, Any]:
    """A row of the table; what differs between seeds is a list over them."""
    return {
        "network": name,
        "family": family,
        "inputs": inputs,
        "weights": list(weights),
        "order": list(order),
        **stopped,
        "not stopped": last["comparison"],
        "training, not stopped": last["training"],
    }


def summary(rows: Sequence[Mapping[str, Any]]) -> list[dict[str, Any]]:
    """Medians and quartiles over seeds; ratios to the CSLC's error of the same seed."""
    yardstick = next(row for row in rows if row["network"] == CSLC)
    document: list[dict[str, Any]] = []
    for row in rows:
        ratio = np.array(row["comparison"]) / np.array(yardstick["comparison"])
        entry: dict[str, Any] = {"network": row["network"], "inputs": row["inputs"]}
        for name in ("weights", "order"):
            entry[name] = "" if None in row[name] else float(np.median(row[name]))
        columns = {
            "training ε [N m]": row["training"],
            "stop set ε [N m]": row["stop"],
            "comparison ε [N m]": row["comparison"],
            "comparison ε in range [N m]": row["in_range"],
            "comparison ε not stopped [N m]": row["not stopped"],
            "training ε not stopped [N m]": row["training, not stopped"],
            "comparison ε over the CSLC's": ratio,
        }
        for name, values in columns.items():
            quartiles = np.quantile(values, [0.5, 0.25, 0.75]).tolist()
            ends = ("", ", lower quartile", ", upper quartile")
            entry |= {f"{name}{end}": one for end, one in zip(ends, quartiles, strict=True)}
        document.append(entry)
    return document


def table(document: Sequence[Mapping[str, Any]]) -> str:
    """What is printed: medians, with quartiles where it matters."""

    def spread(entry: Mapping[str, Any], name: str) -> str:
        low, high = (entry[f"{name}, {end} quartile"] for end in ("lower", "upper"))
        return f"{entry[name]:.3g} ({low:.3g} to {high:.3g})"

    cells = [
        [
            entry["network"],
            *("-" if entry[name] == "" else f"{entry[name]:.0f}" for name in ("weights", "order")),
            f"{entry['training ε [N m]']:.3g}",
            f"{entry['stop set ε [N m]']:.3g}",
            spread(entry, "comparison ε [N m]"),
            "-" if np.isnan(inside := entry["comparison ε in range [N m]"]) else f"{inside:.3g}",
            f"{entry['training ε not stopped [N m]']:.3g}",
            f"{entry['comparison ε not stopped [N m]']:.3g}",
            spread(entry, "comparison ε over the CSLC's"),
        ]
        for entry in document
    ]
    header = ["ε [N m]", "weights", "order", "training", "stop set", "comparison", "in range"]
    header += ["training, not stopped", "comparison, not stopped", "over the CSLC's"]
    return text_table(header, cells)


def picture(rows: Sequence[Mapping[str, Any]], seeds: int) -> Figure:
    """Errors by number of weights, families apart."""

    def family(name: str) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
        of_it = [row for row in rows if row["family"] == name]
        weights = np.array([float(np.median(row["weights"])) for row in of_it])
        training, comparison = (
            np.array([row[part] for row in of_it]) for part in ("training", "comparison")
        )
        return weights, training, comparison

    names = [
        name for name in dict.fromkeys(row["family"] for row in rows) if name not in (CSLC, MEAN)
    ]
    return generalisation_picture(
        {name: family(name) for name in names},
        {CSLC: family(CSLC), MEAN: family(MEAN)},
        title=f"PUMA 560: trained on one recording, judged on another ({seeds} seeds)",
    )


def finished(path: Path, made_of: Mapping[str, Any]) -> dict[str, dict[str, Any]]:
    """Rows of networks that were finished under the same options, by name."""
    found: dict[str, dict[str, Any]] = {}
    for line in path.read_text(encoding="utf-8").splitlines() if path.exists() else []:
        try:
            row = json.loads(line)
        except json.JSONDecodeError:  # cut off while it was written
            continue
        if row.pop("options", None) == made_of:
            found[row["network"]] = row
    return found


def study(given: argparse.Namespace, kinds: Sequence[Kind]) -> list[dict[str, Any]]:
    """Rows of the CSLC and of each network, from the file or made now."""
    machine = MACHINES[given.machine]()
    network = jc.derive(jc.puma560())
    # Different numbers for the two, as in the demonstration: encoders start elsewhere.
    trajectories = (sim.training(samples=given.samples, robot=machine.robot), sim.comparison())
    jobs = [
        sim.Job(machine, trajectory, 2 * seed + offset)
        for seed in range(given.seeds)
        for offset, trajectory in enumerate(trajectories)
    ]
    recordings = [result.recording for result in sim.record(jobs, progress=True)]
    if given.quick:
        settings = jc.Settings(smoothing=jc.AveragedSplines(17), torque_alignment="mean")
    else:
        settings = jc.choose_settings(network, recordings[0]).settings
    training = [settings.patterns(recording) for recording in recordings[::2]]
    comparison = [
        jc.prepare(
            recording,
            smoothing=jc.AveragedSplines(17),
            torque_alignment="mean",
            thresholds=MOVING,
        )
        for recording in recordings[1::2]
    ]
    stop = [stop_set(patterns.samples, seed) for seed, patterns in enumerate(training)]
    names = ("machine", "seeds", "samples", "epochs", "batch", "rounds", "tolerance")
    made_of = {name: getattr(given, name) for name in names}
    kept_in = given.output / "rows.jsonl"
    given.output.mkdir(parents=True, exist_ok=True)
    done = finished(kept_in, made_of)
    plain = data_of(training, stop, comparison, trigonometric=False)
    rows = [fitted(network, settings, training, stop, comparison), constant(plain)]
    rounds = sum(1 + kind.pruned * given.rounds for kind in kinds if kind.name not in done)
    seen = [np.mean(in_range(c, p, ~s)) for c, p, s in zip(comparison, training, stop, strict=True)]
    print(f"settings: {settings}")
    print(f"comparison patterns in range of the training patterns: {100 * np.mean(seen):.1f} %")
    with tqdm(total=rounds * given.epochs, unit="epoch", disable=None) as bar:
        for kind in kinds:
            bar.set_description(kind.name)
            if kind.name not in done:
                data = data_of(training, stop, comparison, kind.trigonometric)
                done[kind.name] = train(kind, data, given, bar)
                with kept_in.open("a", encoding="utf-8") as file:
                    file.write(json.dumps({"options": made_of, **done[kind.name]}) + "\n")
            rows.append(done[kind.name])
    return rows


def main(arguments: Sequence[str] | None = None) -> int:
    parser = argparse.ArgumentParser(description=(__doc__ or "").partition("\n")[0])
    known = {kind.name: kind for kind in (*STANDARD, *MORE)}
    parser.add_argument("-o", "--output", type=Path, default=Path("build/generalisation_study"))
    parser.add_argument("--machine", choices=MACHINES, default="puma560")
    parser.add_argument("--seeds", type=int, default=10, help="recordings and starting weights")
    parser.add_argument("--samples", type=int, default=3300, help="of a training recording")
    parser.add_argument("--epochs", type=int, default=400, help="of a training")
    parser.add_argument("--batch", type=int, default=64, help="patterns of a step")
    parser.add_argument("--rounds", type=int, default=3, help="of pruning and training again")
    parser.add_argument("--tolerance", type=float, default=9.0, help="of pruning, each round")
    parser.add_argument(
        "--networks",
        nargs="+",
        choices=known,
        metavar="NAME",
        default=[kind.name for kind in STANDARD],
        help="some of: " + ", ".join(known),
    )
    parser.add_argument("--quick", action="store_true", help="three small networks, badly trained")
    given = parser.parse_args(arguments)
    if given.quick:
        given.seeds, given.samples, given.epochs, given.rounds = min(given.seeds, 2), 1200, 6, 1
    if not 0.0 <= given.tolerance < np.inf:
        parser.error(f"--tolerance is {given.tolerance}; expected a finite number, 0 or more")
    for name, least in {"seeds": 1, "samples": 600, "epochs": 1, "batch": 1, "rounds": 1}.items():
        if getattr(given, name) < least:
            parser.error(f"--{name} is {getattr(given, name)}; expected {least} or more")
    cache = Path(__file__).parents[3] / ".cache" / "jax"
    jax.config.update("jax_compilation_cache_dir", str(cache))
    jax.config.update("jax_persistent_cache_min_compile_time_secs", 0.2)
    kinds = QUICK if given.quick else tuple(known[name] for name in given.networks)
    try:
        rows = study(given, kinds)
    except KeyboardInterrupt:
        print(f"\ninterrupted; the same command goes on from {given.output / 'rows.jsonl'}")
        return 130
    except sim.SimulationError as error:
        parser.error(str(error))
    document = summary(rows)
    print(f"\n{table(document)}")
    with all_or_nothing(given.output) as folder:
        write_csv(folder / "generalisation.csv", document)
        save_picture(picture(rows, given.seeds), folder / "generalisation.png")
    print(f"\nwrote generalisation.csv and generalisation.png into {given.output}")
    return 0


if __name__ == "__main__":
    raise SystemExit(main())
