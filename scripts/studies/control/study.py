"""What identified coefficients are worth in control (2.7): controllers times coefficients.

Simulated PUMA 560s with every disturbance of Section 7.2, each a specimen of its own (`specimen`),
follow a go-to, from one pose to another that is drawn for each, and a circle of 0.1 m radius that
the flange goes around in an inclined plane; each in a slow, a middle and a quick version. All
machines run side by side.

- **Controllers.** PID; PID with the abbreviated gravity compensation of joints 2 and 3 (7.4.2);
  computed torque (Eqn. 2.7-1), whole and without friction, without the velocity term, and with
  gravity alone.
- **Coefficients.** The machine's own (truth); CSLC, identified from the machine's own training
  recording by settings chosen once; Armstrong's with regressed friction (Ar+Rg) and with that of
  Leahy and Saridis (Ar+LS); and the truth with every coefficient times 0.7 or 1.3 by a coin.
- **Gains.** Every computed torque has the natural frequency and the damping given, whatever its
  coefficients. Friction is that of the reference: quantised encoders say little of the sign of a
  slow velocity. "PID" has gains for the same frequency and damping by the diagonal of Armstrong's
  M at the start, and the largest integral gain that leaves a double integrator's poles real,
  4/27 ω³ M (for ζ = 1). "PID, thesis" and PID with gravity have the gains of the thesis's
  comparison trajectory, which correspond to some 30 rad/s.
- **Figures.** Errors of the links, not of the encoders: root mean square and largest, of each joint
  and of the flange. Effort is of the torque demanded.

`--ideal` prints what a perfect model without disturbances does beside the response that the gains
prescribe; `--stability N` lets the arm make N random motions a controller instead of the study,
many of them faster than the drives can follow, each loop kept within joint ranges by `WithinRange`.
Rows of finished machines are kept in `rows.jsonl`, by the options that made them: a call that was
interrupted goes on from there, with the coefficients in `coefficients.npz`. Remove both after a
change of the code.
"""

import argparse
import functools
import json
from collections.abc import Mapping, Sequence
from pathlib import Path
from typing import Any, NamedTuple

import jax
import jax.numpy as jnp
import numpy as np
from jaxtyping import Float
from tqdm import tqdm

import jaxcslc as jc
import sim
from jaxcslc.control import (
    PID,
    ComputedTorque,
    Loop,
    LowPassChain,
    WithinRange,
    abbreviated_gravity,
)
from jaxcslc.identification import write_csv
from scripts.studies.control.checks import ideal_rows, stability_rows
from scripts.studies.control.results import WORDS, draw, ratio_rows, summary_rows, table
from sim.recording._fingerprint import fingerprint


jax.config.update("jax_enable_x64", True)

Rows = list[dict[str, Any]]

INTERVAL = 0.002
REST = 50  # samples after a motion that count as well
DURATIONS = (3.0, 2.0, 1.25)  # s
MOTIONS = ("go-to", "circle")
SETS = ("truth", "CSLC", "Ar+Rg", "Ar+LS", "30 % wrong")
CONTROLLERS = {
    "PID": "",
    "PID, thesis": "",
    "PID + gravity": "",
    "computed torque": "full",
    "no friction": "no friction",
    "no velocity term": "no velocity term",
    "gravity only": "gravity only",
}
ONCE = ("PID", "PID, thesis")  # know no coefficients
START = np.array([0.0, -np.pi / 2, np.pi / 2, 0.0, 0.0, 0.0])  # the comparison trajectory's
MARGIN = 0.2  # of a joint's range at either end, that targets keep away from
CENTRE, RADIUS, NORMAL = (0.6, 0.15, -0.1), 0.1, (1.0, 0.0, 1.0)
NEAR = np.array([0.0, -0.5, 2.9, 0.0, 0.8, 0.0])
STEADY = [
    *[("computed torque", name) for name in ("truth", "CSLC", "30 % wrong")],
    *[(name, "CSLC") for name in ("PID", "PID, thesis", "PID + gravity")],
]
KEPT_FREE = 0.15  # rad of joint ranges that the random motions' loops keep away from
APPROACH = 5.0  # 1/s, at which they come near them
EVERY = 5  # samples of a trace


class Loopings(NamedTuple):
    """What all feedback loops have in common."""

    network: jc.CSLC
    limit: np.ndarray
    frequency: float
    damping: float
    corner: float
    published: np.ndarray

    def loop(self, controller: str, k: Any, start: np.ndarray) -> Loop:
        """One machine's loop."""
        n = self.network.joint_count
        low_pass = LowPassChain(self.corner, lags=2)
        if controller == "PID":
            M = np.diag(np.asarray(self.network.mass_matrix(jnp.asarray(self.published), start)))
            w = self.frequency
            pid = PID(n, position_gain=w**2 * M, velocity_gain=2 * self.damping * w * M,
                      integral_gain=4 / 27 * w**3 * M, torque_limit=self.limit)  # fmt: skip
            return Loop(pid, low_pass)
        if controller.startswith("PID"):
            own = sim.comparison().controller
            assert isinstance(own, sim.PID)
            weight = controller == "PID + gravity"
            gravity = abbreviated_gravity(self.network, k, (2, 3)) if weight else None
            pid = PID(n, position_gain=own.position_gain, velocity_gain=own.velocity_gain,
                      integral_gain=own.integral_gain, torque_limit=self.limit,
                      gravity=gravity)  # fmt: skip
            return Loop(pid, low_pass)
        computed = ComputedTorque(
            self.network, k, self.frequency, self.damping, compensation=CONTROLLERS[controller],
            torque_limit=self.limit, friction_at="reference", pose=start,
        )  # fmt: skip
        return Loop(computed, low_pass)

    def kept(self, controller: str, k: Any, machine: sim.Machine) -> Loop:
        """The same, kept within the machine's joint ranges by the same coefficients."""
        loop = self.loop(controller, k, START)
        ends = np.array(machine.position_range) + KEPT_FREE * np.array([1.0, -1.0])
        within = WithinRange(
            loop.controller, self.network, k, ends, torque_limit=self.limit, rate=APPROACH
        )
        return Loop(within, loop.filter)


def machine_of(seed: int) -> sim.Machine:
    return sim.disturbed(sim.specimen(sim.puma560(), seed))


def coefficients(network: jc.CSLC, seeds: int, samples: int) -> dict[str, np.ndarray]:
    """Every set's coefficients of every seed's machine, (seeds, p) each."""
    machines = [machine_of(seed) for seed in range(seeds)]
    recorded = sim.record(
        [sim.Job(machine, sim.training(samples=samples, robot=machine.robot), seed)
         for seed, machine in enumerate(machines)],
        progress=True,
    )  # fmt: skip
    book = jc.puma560()
    assert book.links is not None
    published = network.coefficients_from(book.links, viscous=book.viscous, dry=book.dry)
    settings = jc.choose_settings(network, recorded[0].recording).settings
    found: dict[str, list[Any]] = {name: [] for name in SETS}
    each = zip(machines, recorded, strict=True)
    for seed, (machine, made) in enumerate(
        tqdm(each, total=seeds, desc="identification", disable=None)
    ):
        patterns = settings.patterns(made.recording)
        true = network.coefficients_from(machine.links, viscous=machine.viscous, dry=machine.dry)
        coin = np.random.default_rng([seed, 30]).choice([0.7, 1.3], network.size)
        own = (
            true,
            settings.fit(network, patterns).k,
            jc.regress_friction(network, patterns, published),
            published,
            coin * np.asarray(true),
        )
        for name, k in zip(SETS, own, strict=True):
            found[name].append(np.asarray(k))
    return {name: np.stack(vectors) for name, vectors in found.items()}


def kept_coefficients(
    network: jc.CSLC, seeds: int, samples: int, path: Path
) -> dict[str, np.ndarray]:
    """The same, from a file if it has them; otherwise it has them afterwards."""
    if path.exists():
        with np.load(path) as file:
            if file["samples"] == samples and len(file[SETS[0]]) >= seeds:
                return {name: file[name] for name in SETS}
    vectors = coefficients(network, seeds, samples)
    np.savez(path, allow_pickle=False, samples=np.array(samples), **vectors)
    return vectors


def path_of(motion: str, duration: float, seeds: Sequence[int]) -> tuple[np.ndarray, Any]:
    """Where a motion starts, and its path: a go-to has a pose of its own for each seed."""
    machine = sim.puma560()
    if motion == "circle":
        path = sim.circle(
            machine,
            CENTRE,
            RADIUS,
            near=NEAR,
            duration=duration,
            normal=NORMAL,
            point=(0.0, 0.0, sim.FLANGE),
            interval=INTERVAL,
        )
        return path.start, path
    ends = np.stack([sim.go_to(machine, seed, 1.0, margin=MARGIN)[1].end for seed in seeds])
    one = np.ones((len(seeds), 1))
    return START, sim.ViaPoints(ends[:, None], duration * one, 0.0 * one)


def side_by_side(loops: Sequence[Loop]) -> Loop:
    """Loops of one structure, every array with a first axis of machines."""
    return jax.tree.map(lambda *leaves: jnp.stack([jnp.asarray(leaf) for leaf in leaves]), *loops)


def performed(
    looping: Loopings, vectors: Mapping[str, np.ndarray], motion: str, duration: float,
    controller: str, seeds: Sequence[int],
) -> Rows:  # fmt: skip
    """All coefficient sets of all seeds under one controller, on one motion."""
    sets = ["none"] if controller in ONCE else list(SETS)
    which = [(name, seed) for name in sets for seed in seeds]
    start, path = path_of(motion, duration, [seed for _, seed in which])
    loops = [
        looping.loop(controller, vectors["truth" if name == "none" else name][seed], start)
        for name, seed in which
    ]
    servo = sim.Servo(side_by_side(loops), path, INTERVAL, per_machine=True)
    trajectory = sim.Trajectory(
        f"{motion}, {duration:g} s, {controller}", start, servo,
        round(duration / INTERVAL) + 1 + REST, INTERVAL,
    )  # fmt: skip
    machines = [machine_of(seed) for _, seed in which]
    results = sim.close_loop(machines, trajectory, [seed for _, seed in which], progress=True)
    rows: Rows = []
    for i, ((name, seed), result) in enumerate(zip(which, results, strict=True)):
        row: dict[str, Any] = {"motion": motion, "duration": duration, "controller": controller,
                               "coefficients": name, "seed": seed}  # fmt: skip
        if isinstance(result, sim.SimulationError):
            rows.append({**row, "failed": str(result)})
            continue
        if isinstance(path, sim.ViaPoints):
            alone: Any = sim.ViaPoints(path.poses[i], path.durations[i], path.stays[i])
            origin = result.recording.position[0]
        else:
            alone, origin = path, start
        time = result.truth.time
        wanted = alone.reference(time[:, None], np.tile(origin, (time.size, 1))).q
        rows.append({**row, **figures(result, wanted, looping.limit, trace=seed == 0)})
    return rows


def figures(
    result: sim.ClosedLoop, wanted: Float[np.ndarray, "samples joints"], limit: np.ndarray, *,
    trace: bool,
) -> dict[str, Any]:  # fmt: skip
    """Errors of the links and the flange, and effort."""
    hand = sim.Hand.of(sim.puma560().robot, (0.0, 0.0, sim.FLANGE))
    joint = 1e3 * (wanted - result.truth.position)
    asked, torque = np.asarray(hand.locate(wanted)[0]), result.recording.torque
    off = 1e3 * (np.asarray(hand.locate(result.truth.position)[0]) - asked)
    distance = np.linalg.norm(off, axis=1)
    square = np.mean(torque**2, axis=0)
    found: dict[str, Any] = {
        "hand rms [mm]": rms(distance),
        "hand largest [mm]": float(distance.max()),
        "torque rms [N m]": float(np.sqrt(square.sum())),
        "squared torque [N² m² s]": float(square.sum() * result.truth.time[-1]),
        "saturated": float(np.mean(np.abs(torque) >= 0.999 * limit)),
    }
    for i in range(wanted.shape[1]):
        found[f"joint {i + 1} rms [mrad]"] = rms(joint[:, i])
        found[f"joint {i + 1} largest [mrad]"] = float(np.abs(joint[:, i]).max())
        found[f"joint {i + 1} torque rms [N m]"] = float(np.sqrt(square[i]))
    if trace:
        values = {"time": result.truth.time, "asked": asked, "off": off, "joint": joint}
        found["trace"] = {name: each[::EVERY].round(6).tolist() for name, each in values.items()}
    return found


def rms(values: np.ndarray) -> float:
    return float(np.sqrt(np.mean(values**2)))


class Finished:
    """Rows in a file, a line each, found again by what made them."""

    def __init__(self, path: Path, made_of: str) -> None:
        self.path, self.made_of = path, made_of
        self.found: dict[tuple[Any, ...], dict[str, Any]] = {}
        text = path.read_text(encoding="utf-8") if path.exists() else ""
        whole = text[: text.rfind("\n") + 1]
        if whole != text:  # the last line is half-written, and the next would follow on it
            path.write_text(whole, encoding="utf-8")
        for line in whole.splitlines():
            try:
                row = json.loads(line)
                if row.pop("made_of") == made_of:
                    self._take([row])
            except (ValueError, KeyError, TypeError) as error:
                raise ValueError(f"{path}: {error!r}; expected rows of this script") from error

    @property
    def rows(self) -> Rows:
        return list(self.found.values())

    def _take(self, rows: Rows) -> None:
        for row in rows:
            self.found[tuple(row[key] for key in (*WORDS, "seed"))] = row

    def seeds(self, motion: str, duration: float, controller: str) -> set[int]:
        """Those that have been done with every coefficient set."""
        sets = ["none"] if controller in ONCE else SETS
        each = [
            {key[-1] for key in self.found if key[:-1] == (motion, duration, controller, name)}
            for name in sets
        ]
        return set[int].intersection(*each)

    def add(self, rows: Rows) -> None:
        self._take(rows)
        self.path.parent.mkdir(parents=True, exist_ok=True)
        with self.path.open("a", encoding="utf-8") as file:
            for row in rows:
                file.write(json.dumps({**row, "made_of": self.made_of}) + "\n")


def study(given: argparse.Namespace, looping: Loopings) -> int:
    folder: Path = given.output
    made_of = fingerprint(given.frequency, given.damping, given.corner, given.samples,
                          CENTRE, RADIUS, NORMAL, MARGIN, REST)  # fmt: skip
    finished = Finished(folder / "rows.jsonl", made_of)
    todo = [
        (motion, duration, controller, sorted(set(range(given.seeds)) - have))
        for controller in given.controllers
        for motion in MOTIONS
        for duration in given.durations
        if not set(range(given.seeds)) <= (have := finished.seeds(motion, duration, controller))
    ]
    if todo:
        vectors = kept_coefficients(
            looping.network, given.seeds, given.samples, folder / "coefficients.npz"
        )
        for motion, duration, controller, seeds in tqdm(todo, desc="cases", disable=None):
            finished.add(performed(looping, vectors, motion, duration, controller, seeds))
    rows = [row for row in finished.rows
            if row["seed"] < given.seeds and row["duration"] in given.durations
            and row["controller"] in given.controllers]  # fmt: skip
    failed = [row for row in rows if "failed" in row]
    for row in failed:
        print(f"seed {row['seed']}, {row['coefficients']}: {row['failed']}")
    summary, ratios = summary_rows(rows), ratio_rows(rows)
    if not summary:
        print(f"all {len(rows)} motions failed; nothing to summarise")
        return 1
    print(
        f"{given.seeds} machines, natural frequency {given.frequency:g} rad/s, medians over seeds:"
    )
    print(table(summary, ["motion", "duration", "controller", "coefficients",
                          "hand rms, median [mm]", "hand rms, 5 % [mm]", "hand rms, 95 % [mm]",
                          "hand largest [mm]", "torque rms [N m]", "saturated"]))  # fmt: skip
    if ratios:
        print("\nerror of the flange with CSLC coefficients, over that with others:")
        print(table(ratios, list(ratios[0])))
        write_csv(folder / "ratios.csv", ratios)
    plain = [{key: value for key, value in row.items() if key != "trace"} for row in rows]
    good = [row for row in plain if "failed" not in row]
    write_csv(folder / "seeds.csv", good)
    write_csv(folder / "summary.csv", summary)
    draw(
        [row for row in rows if "failed" not in row],
        folder,
        given.controllers,
        SETS,
        CENTRE,
        NORMAL,
    )
    print(f"wrote tables and pictures into {folder}")
    return 0


def main(arguments: Sequence[str] | None = None) -> int:
    parser = argparse.ArgumentParser(
        description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter
    )
    parser.add_argument("-o", "--output", type=Path, default=Path("build/control_study"))
    parser.add_argument("--seeds", type=int, default=20, help="how many machines")
    parser.add_argument("--durations", type=float, nargs="+", default=list(DURATIONS),
                        metavar="S", help="of a motion, each as a speed [s]")  # fmt: skip
    parser.add_argument("--controllers", nargs="+", default=list(CONTROLLERS), metavar="NAME",
                        help=f"some of: {', '.join(map(repr, CONTROLLERS))}")  # fmt: skip
    parser.add_argument("--frequency", type=float, default=20.0, help="natural, of errors [rad/s]")
    parser.add_argument("--damping", type=float, default=1.0, help="ratio, of errors")
    parser.add_argument("--corner", type=float, default=60.0, help="of the rates' filter [Hz]")
    parser.add_argument("--samples", type=int, default=3300, help="of training, 2 ms apart")
    parser.add_argument("--ideal", action="store_true", help="the ideal case instead of the study")
    parser.add_argument("--stability", type=int, nargs="?", const=1000, metavar="N",
                        help="N random motions a controller instead of the study")  # fmt: skip
    given = parser.parse_args(arguments)
    if given.seeds < 1:
        parser.error(f"--seeds is {given.seeds}; expected 1 or more")
    if min(given.durations) < 0.1:
        parser.error(f"--durations: {min(given.durations):g} s is too short; expected 0.1 s")
    for name in given.controllers:
        if name not in CONTROLLERS:
            parser.error(f"no controller is called {name!r}; expected some of {list(CONTROLLERS)}")
    if given.stability is not None and given.stability < 1:
        parser.error(f"--stability is {given.stability}; expected 1 or more")
    cache = Path(__file__).parents[3] / ".cache" / "jax"
    jax.config.update("jax_compilation_cache_dir", str(cache))
    jax.config.update("jax_persistent_cache_min_compile_time_secs", 0.2)
    network, book = jc.derive(jc.puma560()), jc.puma560()
    assert book.links is not None
    try:
        looping = Loopings(
            network, np.array(sim.puma560().maximum_torque), given.frequency, given.damping,
            given.corner,
            np.asarray(network.coefficients_from(book.links, viscous=book.viscous, dry=book.dry)),
        )  # fmt: skip
        looping.loop("computed torque", looping.published, START)  # refuses bad gains
        given.output.mkdir(parents=True, exist_ok=True)
        if given.ideal:
            rows = ideal_rows(network, given.frequency, given.damping)
            print("a perfect model without disturbances, beside the response of the gains:")
            print(table(rows, list(rows[0])))
            write_csv(given.output / "ideal.csv", rows)
            return 0
        if given.stability is not None:
            seeds = min(given.seeds, given.stability)
            vectors = kept_coefficients(
                network, seeds, given.samples, given.output / "coefficients.npz"
            )
            machines = [machine_of(seed) for seed in range(seeds)]
            cases = {
                f"{controller}, {name}": functools.partial(
                    lambda controller, k, i: looping.kept(controller, k[i], machines[i]),
                    controller, vectors[name],
                )
                for controller, name in STEADY
                if controller in given.controllers
            }  # fmt: skip
            rows = stability_rows(cases, machines, given.stability, START, side_by_side)
            print(table(rows, list(rows[0])))
            write_csv(given.output / "stability.csv", rows)
            return 0
        return study(given, looping)
    except KeyboardInterrupt:
        print(f"\ninterrupted; the same command goes on from {given.output / 'rows.jsonl'}")
        return 130
    except (sim.MachineError, ValueError) as error:
        parser.error(str(error))


if __name__ == "__main__":
    raise SystemExit(main())
