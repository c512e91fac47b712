"""What each disturbance of a PUMA 560 costs, and what each counter-measure buys (7.2 to 7.6).

Every disturbance of Section 7.2 alone, none, and all together, over many seeds. Each seed is a
training recording, which the network is identified from, and a comparison recording, which it is
judged on: with its counter-measure, with it alone switched off, and beside the true coefficients.

- **The pipeline.** Averaged splines with sections, their spacings chosen by `choose_spacing` on
  the first training recording of a case; the torque that belongs to a sample the mean of the two
  intervals that meet there; samples slower than a hundredth of a joint's greatest speed left out;
  regressor and torque low-passed alike at 15 Hz; joints weighted by their residuals. Measures that
  need to know of a disturbance (backlash mask, full inertia tensors, torque offsets, limit of
  linearity) are on where the machine has it.
- **Switched off:** central differences of the counts in place of splines; no threshold of speed; no
  backlash mask (Eqn. 2.5-7); no low pass; principal axes in place of full tensors; no torque
  offsets; pairs of more demand than the limit of linearity kept; the torque of the sample alone.
  The delay of the drives is compensated in neither case. 'undisturbed' is with and without the
  threshold of speed. 'all disturbances' is with all measures and without any, and 'all, but' with
  all but one: all of them of the network of principal axes without offsets, so that their
  coefficients are the same ones.
- **ε** (7.5) is on the links' true motion where a joint moves. Where gears give way, rotors move
  otherwise than links, which no coefficient of a rigid machine can follow: the torque that a
  prediction is compared with is what rigid gears would have needed for the links' motion. What
  true coefficients leave of it, the floor, is static friction, and what a network has no terms for.
- **Coefficient error** is the root mean square, over all coefficients of the network fitted, of
  how far each is from its true value times its output sensitivity on the training recording
  (7.6) [N m]. A network of principal axes has the true moments as its true values.

Rows of finished seeds are kept in `rows.jsonl`; a call that was interrupted goes on from there.
"""

import argparse
import dataclasses
import functools
import hashlib
import json
import time
from collections.abc import Iterator, Mapping, Sequence
from pathlib import Path
from typing import Any

import jax
import numpy as np
from jaxtyping import Bool, Float
from scipy.stats import t as student
from tqdm import tqdm

import jaxcslc as jc
import sim
from jaxcslc.assessment import mask_quality, output_sensitivity
from jaxcslc.identification import all_or_nothing, text_table, write_csv
from jaxcslc.motion import CentralDifferences, as_recorded, choose_spacing
from jaxcslc.plotting import save_picture
from scripts.studies.disturbances.pictures import budget_picture
from sim.recording._fingerprint import fingerprint


jax.config.update("jax_enable_x64", True)

CUTOFF = 15.0  # Hz
THRESHOLD_FRACTION = 0.01
# Slower than this a joint may be stuck, where no model of sliding friction can know its torque.
MOVING = 1e-3  # rad/s
# Recordings made side by side: enough to keep cores busy, few enough to lose little.
SEEDS_AT_ONCE = 16
ALL = "all disturbances"
UNDISTURBED = "undisturbed"
FIGURES = {"epsilon": "ε [N m]", "coefficient_error": "coefficient error [N m]"}
MACHINES = {"a": sim.puma_a, "b": sim.puma_b, "armstrong": sim.puma560}


@dataclasses.dataclass(frozen=True)
class Measures:
    """Which counter-measures are on."""

    splines: bool = True
    threshold: bool = True
    mean_torque: bool = True
    low_pass: bool = True
    backlash_mask: bool = False
    linear_only: bool = False
    full_tensors: bool = False
    offsets: bool = False


AGAINST = {
    "quantisation": "splines",
    "static friction": "threshold",
    "asymmetric friction": "offsets",
    "tilted axes": "full_tensors",
    "motor linearity": "linear_only",
    "sample timing": "mean_torque",
    "compliance": "low_pass",
    "backlash": "backlash_mask",
}
"""The field of `Measures` that is the counter-measure to each disturbance."""
# They change which coefficients there are: errors with and without them are not of the same ones.
OTHER_NETWORK = ("full_tensors", "offsets")
CASES = (UNDISTURBED, *AGAINST, ALL)
ON, OFF = "on", "off"


@dataclasses.dataclass(frozen=True)
class Line:
    """One line of the budget: a measure off and on in one case."""

    case: str
    name: str
    measure: str
    off: str
    """The variant of the fit without the measure."""


def disturbances_of(case: str) -> tuple[str, ...]:
    return tuple(AGAINST) if case == ALL else () if case == UNDISTURBED else (case,)


def variants(case: str) -> dict[str, Measures]:
    """The fits of one recording of a case, by name."""
    if case == UNDISTURBED:
        return {ON: Measures(), OFF: Measures(threshold=False)}
    if case in AGAINST:
        on = dataclasses.replace(Measures(), **{AGAINST[case]: True})
        return {ON: on, OFF: dataclasses.replace(on, **{AGAINST[case]: False})}
    fields = [field for field in AGAINST.values() if field not in OTHER_NETWORK]
    on = Measures(**dict.fromkeys(fields, True))
    found = {ON: on, OFF: Measures(**dict.fromkeys(fields, False))}
    return found | {field: dataclasses.replace(on, **{field: False}) for field in fields}


def lines(case: str) -> list[Line]:
    """What is printed of a case."""
    names = {UNDISTURBED: "threshold", ALL: "all measures"}
    measure = AGAINST[case].replace("_", " ") if case in AGAINST else names[case]
    found = [Line(case, case, measure, OFF)]
    for field in variants(case):
        if field not in (ON, OFF):
            said = field.replace("_", " ")
            found.append(Line(case, f"all, but {said}", said, field))
    return found


@functools.cache
def network_of(measures: Measures) -> jc.CSLC:
    """The network that has the terms of some measures.

    Full tensors need base parameters: with symbolic lengths, there would be coefficients that
    numeric lengths make dependent.
    """
    robot = jc.puma560()
    if measures.offsets:
        robot = robot.with_friction("viscous", "dry", "offset")
    if measures.full_tensors:
        return jc.derive(robot.with_inertia("full"), lengths="numeric")
    return jc.derive(robot)


def true_coefficients(network: jc.CSLC, machine: sim.Machine) -> Float[np.ndarray, " coefficients"]:
    """What a network's coefficients are on a machine.

    Friction of 1 ± a times v|q̇| + d has the offset a d; what it adds to viscous friction is even
    in velocity, which no term of the network is.
    """
    friction: dict[str, Any] = {"viscous": machine.viscous, "dry": machine.dry}
    if "offset" in network.robot.friction:
        pairs = zip(machine.asymmetry, machine.dry, strict=True)
        friction["offset"] = [a * dry for a, dry in pairs]
    return np.asarray(network.coefficients_from(machine.links, **friction))


def linear_pairs(
    recording: jc.Recording, limit: Sequence[float], mean: bool
) -> Bool[np.ndarray, "samples joints"]:
    """Where every demand that has a part in a sample's torque is within the limit of linearity."""
    within = np.abs(recording.torque) <= np.asarray(limit)
    return within & np.concatenate([within[:1], within[:-1]]) if mean else within


def prepared(
    recording: jc.Recording, machine: sim.Machine, spacing: tuple[int, ...], measures: Measures
) -> jc.Patterns:
    """What the fit sees under some measures. Ends are trimmed alike under all of them."""
    trim = max(spacing)
    patterns = jc.prepare(
        recording,
        smoothing=jc.AveragedSplines(spacing) if measures.splines else CentralDifferences(),
        torque_alignment="mean" if measures.mean_torque else "sample",
        thresholds=None if measures.threshold else 0.0,
        threshold_fraction=THRESHOLD_FRACTION,
        backlash=measures.backlash_mask,
        trim=trim,
    )
    if not measures.linear_only:
        return patterns
    within = linear_pairs(recording, machine.linear_torque, measures.mean_torque)[trim:-trim]
    return dataclasses.replace(patterns, backlash_mask=np.asarray(patterns.backlash_mask) & within)


@dataclasses.dataclass(frozen=True)
class Learnt:
    """What one training recording gave, variant by variant, and what its backlash mask did."""

    spacing: tuple[int, ...]
    k: dict[str, Float[np.ndarray, " coefficients"]]
    coefficient_error: dict[str, float]
    mask: dict[str, int]


def learn(
    case: str, machine: sim.Machine, trained: sim.SimulatedRecording, spacing: tuple[int, ...]
) -> Learnt:
    """Identify by every variant of a case."""
    recording, truth = trained
    chosen = variants(case)
    reference = prepared(recording, machine, spacing, chosen[ON])
    k: dict[str, Float[np.ndarray, " coefficients"]] = {}
    errors: dict[str, float] = {}
    for name, measures in chosen.items():
        network = network_of(terms(measures))
        patterns = reference if name == ON else prepared(recording, machine, spacing, measures)
        cutoff = CUTOFF if measures.low_pass else None
        fit = jc.LeastSquares(joint_weights="residual", errors="independent", cutoff=cutoff).fit(
            network, patterns
        )
        k[name] = np.asarray(fit.k)
        # Of the best motion there is: differences of counts would make coefficients look heavy.
        sensitivity = np.asarray(output_sensitivity(network, reference))
        effect = (k[name] - true_coefficients(network, machine)) * sensitivity
        errors[name] = float(np.sqrt(np.mean(effect**2)))
    mask: dict[str, int] = {}
    if any(machine.backlash):
        # The mask of backlash alone, without the pairs that other measures leave out.
        alone = dataclasses.replace(chosen[ON], linear_only=False)
        kept = np.asarray(prepared(recording, machine, spacing, alone).backlash_mask)
        trim = max(spacing)
        quality = mask_quality(kept, truth.apart[trim:-trim]).together
        parts = {"disturbed": quality.disturbed, "left_out": quality.left_out}
        parts |= {"caught": quality.caught, "pairs": np.array([quality.samples])}
        mask = {part: int(value[0]) for part, value in parts.items()}
    return Learnt(spacing, k, errors, mask)


def terms(measures: Measures) -> Measures:
    """The same network's measures alone: as many networks as there are kinds, and no more."""
    return Measures(full_tensors=measures.full_tensors, offsets=measures.offsets)


def true_patterns(performed: sim.SimulatedRecording, machine: sim.Machine) -> jc.Patterns:
    """The links' true motion where they move, and the torque that rigid gears would have needed.

    The sum of the two equations of `sim.Truth`, with the links' acceleration for the rotors'.
    """
    recording, truth = performed
    assert machine.robot.links is not None
    inertia = np.array([float(link.motor_inertia) for link in machine.robot.links])
    torque = truth.torque - inertia * (truth.rotor_acceleration - truth.acceleration)
    motion = jc.Recording(
        recording.time, truth.position, torque, truth.velocity, truth.acceleration
    )
    return as_recorded(motion, thresholds=MOVING)


def judge(
    case: str, machine: sim.Machine, learnt: Learnt, performed: sim.SimulatedRecording
) -> dict[str, Any]:
    """The figures of one seed, variant by variant."""
    patterns = true_patterns(performed, machine)
    fits: dict[str, dict[str, float]] = {}
    for name, measures in variants(case).items():
        network = network_of(terms(measures))
        vectors = {"fit": learnt.k[name], "true": true_coefficients(network, machine)}
        epsilon, floor = np.asarray(jc.compare(network, patterns, vectors).epsilon).tolist()
        error = learnt.coefficient_error[name]
        fits[name] = {"epsilon": epsilon, "coefficient_error": error, "floor": floor}
    return {"spacing": list(learnt.spacing), "fits": fits, "mask": learnt.mask}


class Rows:
    """Finished rows in a file: one line each, of a case and a seed, and of what made it."""

    def __init__(self, path: Path, made_of: Mapping[str, str]) -> None:
        self._path, self._made_of = path, made_of
        self.found: dict[tuple[str, int], dict[str, Any]] = {}
        if not path.exists():
            return
        text = path.read_bytes()
        whole = text[: text.rfind(b"\n") + 1]  # the last line may be half-written
        if whole != text:
            path.write_bytes(whole)
        for number, line in enumerate(whole.decode("utf-8").splitlines(), start=1):
            try:
                row = json.loads(line)
                case, seed, made = row["case"], row["seed"], row["made_of"]
            except (ValueError, KeyError, TypeError) as error:
                raise ValueError(
                    f"{path}, line {number}: {error!r}; expected a row of this script"
                ) from error
            if made_of.get(case) == made:
                self.found[case, seed] = row

    def spacing(self, case: str) -> tuple[int, ...] | None:
        """What a case's first recording chose, if it is known."""
        for (name, _), row in self.found.items():
            if name == case and "spacing" in row:
                return tuple(row["spacing"])
        return None

    def add(self, case: str, seed: int, found: Mapping[str, Any]) -> None:
        row = {"case": case, "seed": seed, "made_of": self._made_of[case], **found}
        self._path.parent.mkdir(parents=True, exist_ok=True)
        with self._path.open("a", encoding="utf-8") as file:
            file.write(json.dumps(row) + "\n")
        self.found[case, seed] = row


def code_digest() -> str:
    """Of this script and the packages that it runs: rows of other code are not these rows."""
    digest = hashlib.sha256()
    roots = [Path(module.__file__ or "").parent for module in (jc, sim)]
    files = [path for root in roots for path in root.rglob("*") if path.suffix in (".py", ".toml")]
    for path in sorted([Path(__file__), *files]):
        digest.update(path.read_bytes())
    return digest.hexdigest()


@dataclasses.dataclass
class Clock:
    """Seconds spent in simulation and in everything after it."""

    simulation: float = 0.0
    identification: float = 0.0


def run(
    machines: Mapping[str, sim.Machine], trajectories: Sequence[sim.Trajectory], seeds: int,
    rows: Rows, clock: Clock,
) -> None:  # fmt: skip
    """Make every row that is missing, a few seeds of all cases at a time."""
    wanted = [(case, seed) for seed in range(seeds) for case in machines]
    missing = [row for row in wanted if row not in rows.found]
    spacings = {case: rows.spacing(case) for case in machines}
    with tqdm(
        total=len(wanted), initial=len(wanted) - len(missing), desc="rows", unit="row", disable=None
    ) as bar:
        for start in range(0, len(wanted), SEEDS_AT_ONCE * len(machines)):
            block = wanted[start : start + SEEDS_AT_ONCE * len(machines)]
            part = [row for row in block if row not in rows.found]
            for case, seed, found in results(machines, trajectories, part, spacings, clock):
                rows.add(case, seed, found)
                bar.update()


def results(
    machines: Mapping[str, sim.Machine],
    trajectories: Sequence[sim.Trajectory],
    part: Sequence[tuple[str, int]],
    spacings: dict[str, tuple[int, ...] | None],
    clock: Clock,
) -> Iterator[tuple[str, int, dict[str, Any]]]:
    """Figures of each case and seed as soon as they are there, or what went wrong."""
    # Two numbers a seed: the encoders of the two recordings start elsewhere.
    jobs = [
        sim.Job(machines[case], trajectory, 2 * seed + i)
        for i, trajectory in enumerate(trajectories)
        for case, seed in part
    ]
    learnt: dict[tuple[str, int], Learnt] = {}
    waiting: dict[tuple[str, int], sim.SimulatedRecording] = {}
    failed: set[tuple[str, int]] = set()
    before = time.perf_counter()
    for number, result in sim.record_each(jobs):
        clock.simulation += (now := time.perf_counter()) - before
        row = (case, _) = part[number % len(part)]
        if row not in failed:
            try:
                if isinstance(result, sim.SimulationError):
                    raise result
                if number < len(part):
                    recording, machine = result.recording, machines[case]
                    spacing = spacings[case] or choose_spacing(
                        recording.time,
                        recording.position,
                        resolution=np.array(machine.encoder_resolution),
                    )
                    spacings[case] = spacing
                    learnt[row] = learn(case, machine, result, spacing)
                else:
                    waiting[row] = result
                if row in learnt and row in waiting:
                    yield *row, judge(case, machines[case], learnt.pop(row), waiting.pop(row))
            except (sim.SimulationError, ValueError, RuntimeError) as error:
                failed.add(row)
                yield *row, {"failed": str(error).partition("\n")[0]}
        clock.identification += (before := time.perf_counter()) - now


@dataclasses.dataclass(frozen=True)
class Summary:
    """One figure of one line over the seeds."""

    line: Line
    figure: str
    off: Float[np.ndarray, " seeds"]
    on: Float[np.ndarray, " seeds"]
    floor: float

    def gain(self) -> tuple[float, float]:
        """Off less on, seed by seed: mean, and half of its 95 % confidence interval (t)."""
        difference = self.off - self.on
        count = difference.size
        if count < 2:
            return float(np.mean(difference)), float("nan")
        half = student.ppf(0.975, count - 1) * np.std(difference, ddof=1) / np.sqrt(count)
        return float(np.mean(difference)), float(half)

    def row(self) -> dict[str, Any]:
        """For a CSV file."""
        gain, half = self.gain()
        row: dict[str, Any] = {
            "case": self.line.case,
            "line": self.line.name,
            "measure": self.line.measure,
            "figure": FIGURES[self.figure],
            "seeds": self.on.size,
        }
        for name, values in (("off", self.off), ("on", self.on)):
            mean, deviation, low, high = spread(values)
            row |= {f"{name} mean": mean, f"{name} standard deviation": deviation}
            row |= {f"{name} 5 %": low, f"{name} 95 %": high}
        row |= {
            "floor": self.floor,
            "gain": gain,
            "gain low": gain - half,
            "gain high": gain + half,
        }
        return row | {"helped": int(np.sum(self.off > self.on))}


def spread(values: Float[np.ndarray, " seeds"]) -> tuple[float, float, float, float]:
    """Mean, standard deviation, and what 5 and 95 % of the seeds are below."""
    deviation = float(np.std(values, ddof=1)) if values.size > 1 else float("nan")
    low, high = np.quantile(values, (0.05, 0.95)).tolist()
    return float(np.mean(values)), deviation, low, high


def summarise(cases: Sequence[str], kept: Sequence[Mapping[str, Any]]) -> list[Summary]:
    """Every line and figure over the seeds that came to an end."""
    found: list[Summary] = []
    for figure in FIGURES:
        for line in (line for case in cases for line in lines(case)):
            fits = [row["fits"] for row in kept if row["case"] == line.case and "fits" in row]
            if not fits:
                continue
            off, on = (np.array([fit[name][figure] for fit in fits]) for name in (line.off, ON))
            floor = float(np.mean([fit[ON]["floor"] for fit in fits]))
            found.append(Summary(line, figure, off, on, floor if figure == "epsilon" else np.nan))
    return found


def table(summaries: Sequence[Summary], figure: str) -> str:
    """Mean ± standard deviation (5 to 95 % of the seeds) of one figure."""

    def cell(values: Float[np.ndarray, " seeds"]) -> str:
        mean, deviation, low, high = spread(values)
        return f"{mean:.4f} ± {deviation:.4f} ({low:.4f} to {high:.4f})"

    def entries(summary: Summary) -> list[str]:
        gain, half = summary.gain()
        helped = f"{np.sum(summary.off > summary.on)}/{summary.on.size}"
        floor = [f"{summary.floor:.4f}"] if figure == "epsilon" else []
        return [
            summary.line.name,
            summary.line.measure,
            cell(summary.off),
            cell(summary.on),
            *floor,
            f"{gain:+.4f} ± {half:.4f}",
            helped,
        ]

    header = ["disturbance", "counter-measure", "off", "on"]
    header += ["floor"] if figure == "epsilon" else []
    header += ["gain, 95 % confidence", "helped"]
    chosen = [entries(summary) for summary in summaries if summary.figure == figure]
    return text_table(header, chosen, left=("counter-measure",))


def mask_text(kept: Sequence[Mapping[str, Any]]) -> list[str]:
    """What the backlash mask caught and gave up, over all seeds and joints of a case."""
    said: list[str] = []
    for case in dict.fromkeys(row["case"] for row in kept if row.get("mask")):
        counts = [row["mask"] for row in kept if row["case"] == case and row.get("mask")]
        total = {name: sum(count[name] for count in counts) for name in counts[0]}
        good = total["pairs"] - total["disturbed"]
        caught = total["caught"] / max(total["disturbed"], 1)
        given_up = (total["left_out"] - total["caught"]) / max(good, 1)
        said.append(
            f"backlash mask, {case}: gears apart in {total['disturbed'] / total['pairs']:.1%} of"
            f" the pairs, of which it leaves out {caught:.1%}, and {given_up:.1%} of the others"
        )
    return said


def write(
    folder: Path, summaries: Sequence[Summary], kept: Sequence[Mapping[str, Any]], title: str
) -> None:
    """Tables of seeds and of the summary, and a picture of each figure."""
    rows = [
        {"case": row["case"], "seed": row["seed"], "variant": name, **figures}
        for row in kept
        for name, figures in row.get("fits", {}).items()
    ]
    write_csv(folder / "seeds.csv", rows)
    write_csv(folder / "summary.csv", [summary.row() for summary in summaries])
    for figure, quantity in FIGURES.items():
        chosen = [summary for summary in summaries if summary.figure == figure]
        off, on = (padded([getattr(summary, name) for summary in chosen]) for name in ("off", "on"))
        names = [
            f"{summary.line.name}: {summary.line.measure}"
            if summary.line.off == OFF
            else summary.line.name
            for summary in chosen
        ]
        picture = budget_picture(names, off, on, title=title, quantity=quantity)
        save_picture(picture, folder / f"{figure}.png")


def padded(rows: Sequence[Float[np.ndarray, " seeds"]]) -> Float[np.ndarray, "lines seeds"]:
    """Rows of a matrix, NaN where a case has fewer seeds."""
    most = max(row.size for row in rows)
    return np.stack([np.pad(row, (0, most - row.size), constant_values=np.nan) for row in rows])


def main(arguments: Sequence[str] | None = None) -> int:
    parser = argparse.ArgumentParser(description=(__doc__ or "").partition("\n")[0])
    parser.add_argument("-o", "--output", type=Path, default=Path("build/disturbance_budget"))
    parser.add_argument("--seeds", type=int, default=100, help="how many, from 0 on")
    parser.add_argument("--cases", nargs="+", default=list(CASES), metavar="CASE",
                        help=f"some of: {', '.join(CASES)}")  # fmt: skip
    parser.add_argument("--machine", choices=list(MACHINES), default="armstrong",
                        help="links and friction")  # fmt: skip
    parser.add_argument(
        "--samples", type=int, default=3300, help="of a training recording, 2 ms apart"
    )
    given = parser.parse_args(arguments)
    if given.seeds < 1:
        parser.error(f"--seeds is {given.seeds}; expected 1 or more")
    for case in given.cases:
        if case not in CASES:
            parser.error(f"no case is called {case!r}; expected some of {', '.join(CASES)}")
    cases = [case for case in CASES if case in given.cases]

    cache = Path(__file__).parents[3] / ".cache" / "jax"
    jax.config.update("jax_compilation_cache_dir", str(cache))
    jax.config.update("jax_persistent_cache_min_compile_time_secs", 0.2)

    clock = Clock()
    kept_in = given.output / "rows.jsonl"
    try:
        whole = MACHINES[given.machine]()
        machines = {case: machine_of(whole, case) for case in cases}
        trajectories = (sim.training(samples=given.samples), sim.comparison())
        code = code_digest()
        made_of = {case: fingerprint(machine, trajectories, code)
                   for case, machine in machines.items()}  # fmt: skip
        rows = Rows(kept_in, made_of)
        run(machines, trajectories, given.seeds, rows, clock)
    except KeyboardInterrupt:
        print(f"\ninterrupted; the same command goes on from the rows in {kept_in}")
        return 130
    except (sim.MachineError, ValueError) as error:
        parser.error(str(error))

    kept = [rows.found[case, seed] for case in cases for seed in range(given.seeds)]
    failed = [row for row in kept if "failed" in row]
    for row in failed[:5]:
        print(f"failed: {row['case']}, seed {row['seed']}: {row['failed']}")
    if len(failed) == len(kept):
        print(f"all {len(kept)} rows failed; nothing to summarise")
        return 1
    summaries = summarise(cases, kept)
    title = f"{whole.robot.name}: what disturbances cost, {given.seeds} seeds"
    for figure, quantity in FIGURES.items():
        print(f"\n{title}: {quantity}, mean ± standard deviation (5 to 95 % of the seeds)")
        print(table(summaries, figure))
    print()
    for text in mask_text(kept):
        print(text)
    if failed:
        print(f"{len(failed)} of {len(kept)} rows failed and are left out")
    with all_or_nothing(given.output) as folder:
        write(folder, summaries, kept, title)
    print(f"simulation took {clock.simulation:.0f} s, the rest {clock.identification:.0f} s")
    print(f"wrote tables and pictures into {given.output}")
    return 0


def machine_of(whole: sim.Machine, case: str) -> sim.Machine:
    """A machine with the disturbances of a case."""
    names = disturbances_of(case)
    return sim.disturbed(whole, *names) if names else sim.undisturbed(whole)


if __name__ == "__main__":
    raise SystemExit(main())
