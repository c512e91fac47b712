"""The thesis's experiment: two PUMA 560s identified, judged and drawn as in Chapter 7.

Each of PUMA A and PUMA B, simulated with every disturbance of Section 7.2, performs the training
and the comparison trajectory. Coefficients are fitted to the first and judged on the second, beside
direct measurement (Ar+LS, Ar+Rg), the truth and the thesis. Tables, figures and an index page go
into one folder.
"""

import argparse
import dataclasses
from collections.abc import Mapping, Sequence
from html import escape
from pathlib import Path
from typing import Any

import jax
import numpy as np
from scipy.interpolate import CubicSpline
from tqdm import tqdm

import jaxcslc as jc
import sim
from jaxcslc.assessment import agreement, mask_quality, output_sensitivity, sign_check
from jaxcslc.identification import (
    all_or_nothing,
    coefficient_rows,
    degree_of_excitation,
    predicted_torque,
    refine_thresholds,
    text_table,
    write_csv,
)
from jaxcslc.plotting import save_picture, torque_picture
from scripts.studies.motor.pictures import motor_curve_picture, motor_response_picture
from scripts.studies.puma560.machine_pictures import friction_picture, hysteresis_picture
from scripts.studies.puma560.motion_pictures import (
    averaged_spline_picture,
    motion_picture,
    reversal_picture,
    spline_subsets_picture,
)


jax.config.update("jax_enable_x64", True)

Rows = list[dict[str, Any]]

# Slower than this a joint may be stuck, where no model of sliding friction can know its torque; the
# thesis leaves the ends of the comparison trajectory out for that (7.4.2).
_MOVING = 0.01  # rad/s
# What the thesis reports of its real machines: ε of Figs. 7.6-3 and 7.6-4, peaks of 7.4.2.
_THESIS_EPSILON = {
    "PUMA A": {"Ar+LS": 1.8155, "Ar+Rg": 0.698, "CSLC": 0.2498},
    "PUMA B": {"Ar+LS": 1.105, "Ar+Rg": 0.979, "CSLC": 0.3085},
}
_THESIS_PEAKS = (13.6, 42.8, 8.59, 1.44, 1.77, 1.76)  # N m


@dataclasses.dataclass(frozen=True)
class Study:
    """One machine's recordings and what came of them."""

    name: str
    machine: sim.Machine
    training: sim.SimulatedRecording
    comparison: sim.SimulatedRecording
    settings: Any
    patterns: jc.Patterns
    judged: jc.Patterns
    fit: jc.Identification
    vectors: dict[str, jax.Array]


def study(
    network: jc.CSLC,
    name: str,
    machine: sim.Machine,
    recordings: Sequence[sim.SimulatedRecording],
) -> Study:
    """Fit a machine's coefficients to its first recording and prepare the second for judging."""
    training, comparison = recordings
    settings = jc.choose_settings(network, training.recording).settings
    patterns = settings.patterns(training.recording)
    fit = settings.fit(network, patterns)
    book = jc.puma560()  # what direct measurement says of every PUMA 560
    assert book.links is not None
    published = network.coefficients_from(book.links, viscous=book.viscous, dry=book.dry)
    # Judged as the thesis does, on what was measured: smoothed encoder readings. The torque is the
    # demand, unsmoothed.
    judged = jc.prepare(
        comparison.recording,
        smoothing=jc.AveragedSplines(17),
        torque_alignment="mean",
        thresholds=_MOVING,
    )
    vectors = {
        "Ar+LS": published,
        "Ar+Rg": jc.regress_friction(network, patterns, published),
        "CSLC": fit.k,
        "true": network.coefficients_from(machine.links, viscous=machine.viscous, dry=machine.dry),
    }
    return Study(name, machine, training, comparison, settings, patterns, judged, fit, vectors)


def error_rows(network: jc.CSLC, one: Study) -> Rows:
    """Fig. 7.6-3 (or its twin for B), with the thesis's ε as the last row."""
    rows: Rows = list(jc.compare(network, one.judged, one.vectors).rows())
    return [*rows, {"": "mean ε, thesis", **_THESIS_EPSILON[one.name], "true": float("nan")}]


def peak_rows(studies: Sequence[Study]) -> Rows:
    """Peak torques of the comparison trajectory beside 7.4.2."""
    rows: Rows = []
    for joint, reported in enumerate(_THESIS_PEAKS):
        row: dict[str, Any] = {"joint": joint + 1, "thesis [N m]": reported}
        for one in studies:
            row[f"{one.name} [N m]"] = float(
                np.abs(one.comparison.recording.torque[:, joint]).max()
            )
        rows.append(row)
    return rows


def threshold_rows(network: jc.CSLC, one: Study) -> Rows:
    """Thresholds found in the residuals beside Fig. B.6 and what the simulator was given."""
    found = refine_thresholds(network, one.training.recording, one.settings)
    thesis = sim.thesis_coefficients(one.name[-1]).insignificant_from
    thresholds = found.settings.thresholds
    assert thresholds is not None  # they are what was refined
    return [
        {
            "joint": joint + 1,
            "found [rad/s]": thresholds[joint],
            "seen in residuals": str(bool(found.static_friction.found[joint])),
            "thesis [rad/s]": float(thesis[joint]),
            "five γ of the plant [rad/s]": 5 * one.machine.static_velocity[joint],
        }
        for joint in range(network.joint_count)
    ]


def mask_rows(one: Study) -> Rows:
    """How Eqn. 2.5-7 does against the simulator's own record of when the gears were apart."""
    settings = dataclasses.replace(one.settings, backlash=True)
    masked = settings.patterns(one.training.recording)
    start = int(np.searchsorted(one.training.truth.time, masked.time[0] - 1e-9))
    apart = one.training.truth.apart[start : start + masked.samples]
    return list(mask_quality(np.asarray(masked.backlash_mask), apart).rows())


def one_design(network: jc.CSLC, one: Study, other: Study) -> tuple[Rows, str]:
    """Two machines with the same links and other friction: do their coefficients agree?"""
    sensitivity = output_sensitivity(network, one.patterns)
    found = agreement(
        network,
        one.fit,
        other.fit,
        sensitivity=sensitivity,
        truth=(one.vectors["true"], other.vectors["true"]),
    )
    return list(found.rows()), str(found)


def torque_figure(network: jc.CSLC, one: Study) -> Any:
    """Figs. 7.6-1 and 7.6-2."""
    return torque_picture(
        np.asarray(one.judged.time),
        np.asarray(one.judged.torque),
        {
            model: np.asarray(predicted_torque(network, one.judged, one.vectors[model]))
            for model in ("Ar+LS", "Ar+Rg", "CSLC")
        },
        title=f"{one.name}: torques of the comparison trajectory",
        units=("N m",) * 6,
        mask=one.judged.mask,
    )


def clean_turn(velocity: np.ndarray) -> int:
    """The sample before the quickest reversal of a joint's velocity: one that does not stick."""
    turns = np.flatnonzero(np.diff(np.sign(velocity)))
    turns = turns[(turns > 100) & (turns < velocity.size - 100)]
    quickness = np.minimum(np.abs(velocity[turns - 20]), np.abs(velocity[turns + 20]))
    return int(turns[np.argmax(quickness)])


def spline_figures(one: Study) -> dict[str, Any]:
    """Figs. 7.3-1 and 7.3-2, on joint 3's encoder where it turns round."""
    recording, truth = one.training
    resolution = one.machine.encoder_resolution[2]
    turn = clean_turn(truth.rotor_velocity[:, 2])
    near = slice(turn - 60, turn + 60)
    shown = slice(turn - 18, turn + 19)
    time = recording.time[near]
    counts = (recording.position[near, 2] - recording.position[turn, 2]) / resolution
    true = (truth.rotor_position[near, 2] - recording.position[turn, 2]) / resolution
    fine = np.linspace(recording.time[shown][0], recording.time[shown][-1], 400)
    splines = [CubicSpline(time[start::3], counts[start::3])(fine) for start in range(3)]
    ms = 1e3 * (fine - recording.time[turn])
    samples = 1e3 * (recording.time[shown] - recording.time[turn])
    readings = counts[42:79]
    return {
        "7.3-1": spline_subsets_picture(samples, readings, ms, splines),
        "7.3-2": averaged_spline_picture(
            samples, readings, ms, np.mean(splines, axis=0), CubicSpline(time, true)(fine)
        ),
    }


def reversal_figure(network: jc.CSLC, one: Study) -> Any:
    """Fig. 7.6-4: joint 1's torque where its velocity changes sign in the training trajectory."""
    recording, truth = one.training
    everywhere = jc.prepare(
        recording, smoothing=jc.AveragedSplines(17), torque_alignment="mean", thresholds=0.0
    )
    q1d, time = np.asarray(everywhere.qd[:, 0]), np.asarray(everywhere.time)
    turn = clean_turn(q1d)
    near = slice(max(turn - 40, 0), turn + 40)
    before, after = q1d[turn], q1d[turn + 1]
    reversal = float(time[turn] + (time[turn + 1] - time[turn]) * before / (before - after))
    changes = np.flatnonzero(np.diff(np.sign(truth.velocity[:, 0])))
    true_turn = float(truth.time[changes[np.argmin(np.abs(truth.time[changes] - reversal))]])
    predicted = np.asarray(predicted_torque(network, everywhere, one.vectors["CSLC"]))
    return reversal_picture(
        time[near],
        np.asarray(everywhere.torque)[near, 0],
        predicted[near, 0],
        reversal=reversal,
        true_reversal=true_turn,
    )


def plant_figures(one: Study, progress: Any) -> dict[str, Any]:
    """Figs. 2.5-1, 2.5-3, 7.2-1, 7.2-2 and 7.4-2."""
    machine, truth = one.machine, one.training.truth
    joint = 3  # the fourth: the wrist's dead band is the widest
    speed = np.concatenate([np.linspace(-1.0, -1e-6, 400), np.linspace(1e-6, 1.0, 400)])
    columns = np.tile(speed[:, None], (1, 6))
    friction = sim.Friction.of(dataclasses.replace(machine, asymmetry=())).torque(columns)[:, 0]
    swing = sim.comparison().controller
    assert isinstance(swing, sim.PID)
    still = np.array([0.0, 0.0, np.pi / 2, 0.0, 0.0, 0.0])
    small = 8e-3 * (np.arange(6) == joint)  # a loop is as wide as the dead band
    swing = dataclasses.replace(swing, path=sim.Oscillation(still, small, 1.0))
    wobble = sim.Trajectory("wobble", still - small, swing, 1501)
    quiet = dataclasses.replace(machine, encoder_resolution=(0.0,) * 6)
    loop = sim.simulate(quiet, wobble).truth
    last = slice(1000, None)
    demand = np.linspace(0.0, 1.2 * machine.maximum_torque[0], 400)
    drives = sim.Drives.of(machine)
    given = drives.torque(np.tile(demand[:, None], (1, 6)))[:, 0]
    straight = dataclasses.replace(sim.puma560(), linear_torque=())
    response = sim.motor_linearity(straight, progress=progress)
    return {
        "2.5-1": friction_picture(
            speed,
            friction,
            viscous=machine.viscous[0],
            dry=machine.dry[0],
            static=machine.static[0],
        ),
        "2.5-3": hysteresis_picture(
            1e3 * loop.rotor_position[last, joint],
            1e3 * loop.position[last, joint],
            backlash=1e3 * machine.backlash[joint],
        ),
        "7.2-1": motor_curve_picture(demand, given, limit=machine.linear_torque[0]),
        "7.2-2": motor_response_picture(response.mass, response.torque),
        "7.4-2": motion_picture(
            truth.time,
            truth.rotor_position[:, 4],
            truth.rotor_velocity[:, 4],
            truth.rotor_acceleration[:, 4],
        ),
    }


_CAPTIONS = {
    "2.5-1": "Friction of PUMA A's joint 1 by the three-part model (Eqn. 2.5-4).",
    "2.5-3": "Link against rotor of PUMA A's joint 4, swung by 8 mrad: backlash.",
    "7.2-1": "Response of the motor of joint 1 beyond its limit of linearity.",
    "7.2-2": "Mean torque of joint 2 against the mass hung from the flange.",
    "7.3-1": "Three cubic splines through three subsets of joint 3's encoder readings.",
    "7.3-2": "Their average, and where the rotor truly was.",
    "7.4-2": "Motion of joint 5 in the training trajectory.",
    "7.6-1": "Measured and predicted torques of the comparison trajectory, PUMA A.",
    "7.6-2": "The same, PUMA B.",
    "7.6-4": "Joint 1 of PUMA A where its velocity changes sign in the training trajectory.",
}


def html_table(rows: Rows) -> str:
    """Rows as an HTML table; numbers to four digits."""
    names = list(rows[0])

    def cell(value: Any) -> str:
        return escape(f"{value:.4g}" if isinstance(value, float) else str(value))

    head = "".join(f"<th>{escape(name)}</th>" for name in names)
    body = "".join(
        "<tr>" + "".join(f"<td>{cell(row.get(name, ''))}</td>" for name in names) + "</tr>\n"
        for row in rows
    )
    return f"<table><thead><tr>{head}</tr></thead>\n<tbody>{body}</tbody></table>\n"


def index_page(tables: Mapping[str, tuple[str, Rows]], notes: Sequence[str]) -> str:
    """One page with every table and figure."""
    style = (
        "body{font:16px/1.5 sans-serif;max-width:70em;margin:2em auto;padding:0 1em}"
        "table{border-collapse:collapse;font-size:13px;margin:.5em 0}"
        "td,th{border-bottom:1px solid #ccc;padding:.15em .6em;text-align:right}"
        "img{max-width:100%}.wide{overflow-x:auto}"
    )
    parts = [
        "<!doctype html><html lang='en'><meta charset='utf-8'>",
        f"<title>PUMA 560 experiment</title><style>{style}</style>",
        "<h1>The identification experiment on two simulated PUMA 560s</h1>",
        *(f"<p>{escape(note)}</p>" for note in notes),
        "<h2>Tables</h2>",
    ]
    for name, (caption, rows) in tables.items():
        parts.append(
            f"<h3 id='{name}'>{escape(caption)}</h3><div class='wide'>{html_table(rows)}</div>"
            f"<p><a href='{name}.csv'>{name}.csv</a></p>"
        )
    parts.append("<h2>Figures</h2>")
    for number, caption in _CAPTIONS.items():
        parts.append(
            f"<figure><img src='figure_{number}.png' alt='{escape(caption)}'>"
            f"<figcaption>Fig. {number}. {escape(caption)}</figcaption></figure>"
        )
    return "\n".join(parts) + "\n"


def coefficient_table(network: jc.CSLC, one: Study) -> Rows:
    """Figs. B.1 to B.5: what was found beside Armstrong's, the thesis's and the true values."""
    return coefficient_rows(
        network,
        one.fit,
        {
            "true": np.asarray(one.vectors["true"]),
            "Ar+LS": np.asarray(one.vectors["Ar+LS"]),
            "thesis": sim.thesis_coefficients(one.name[-1]).coefficients,
        },
        sensitivity=output_sensitivity(network, one.patterns),
    )


def main() -> None:
    parser = argparse.ArgumentParser(description=(__doc__ or "").partition("\n")[0])
    parser.add_argument("-o", "--output", type=Path, default=Path("build/demo"))
    parser.add_argument("--seed", type=int, default=1, help="of encoders, starts and timing")
    parser.add_argument("--samples", type=int, default=3300, help="of the training trajectory")
    arguments = parser.parse_args()
    cache = Path(__file__).parents[3] / ".cache" / "jax"
    jax.config.update("jax_compilation_cache_dir", str(cache))
    jax.config.update("jax_persistent_cache_min_compile_time_secs", 0.2)

    network = jc.derive(jc.puma560())
    print(network)
    a, b = sim.disturbed(sim.puma_a()), sim.disturbed(sim.puma_b())
    twin = dataclasses.replace(b, robot=a.robot)  # A's links, B's friction
    machines = {"PUMA A": a, "PUMA B": b, "twin": twin}
    trajectories = {  # see `sim.training` for why each compensates its own gravity
        name: (
            sim.training(samples=arguments.samples, robot=machine.robot),
            sim.comparison(),
        )
        for name, machine in machines.items()
    }
    jobs = [
        sim.Job(machine, trajectory, arguments.seed + offset)
        for name, machine in machines.items()
        for offset, trajectory in enumerate(trajectories[name])
    ]
    recorded = sim.record(jobs, progress=True)
    studies = {
        name: study(network, name, machine, recorded[2 * i : 2 * i + 2])
        for i, (name, machine) in enumerate(
            tqdm(machines.items(), desc="fitting", unit="machine", disable=None)
        )
    }
    both = [studies["PUMA A"], studies["PUMA B"]]
    design_rows, design = one_design(network, studies["PUMA A"], studies["twin"])
    tables: dict[str, tuple[str, Rows]] = {}
    notes = [
        f"{one.name}: {one.settings}. {one.fit}. {sign_check(network, one.fit.k)}"
        f" positive. Excitation: {degree_of_excitation(network, one.patterns)}"
        for one in both
    ]
    notes.append(f"PUMA A and a machine with its links and PUMA B's friction: {design}")
    for one in both:
        tag = one.name[-1].lower()
        tables[f"errors_{tag}"] = (
            f"Comparison trajectory of {one.name}: mean error moduli and ε [N m]",
            error_rows(network, one),
        )
        tables[f"coefficients_{tag}"] = (
            f"Coefficients of {one.name}",
            coefficient_table(network, one),
        )
        tables[f"thresholds_{tag}"] = (
            f"{one.name}: speeds from which static friction is insignificant",
            threshold_rows(network, one),
        )
        tables[f"backlash_mask_{tag}"] = (
            f"{one.name}: Eqn. 2.5-7 against the simulator's record of backlash",
            mask_rows(one),
        )
    tables["peaks"] = ("Peak torques of the comparison trajectory", peak_rows(both))
    tables["one_design"] = ("PUMA A and its twin: variation and sensitivity", design_rows)
    figures = {
        "7.6-1": torque_figure(network, both[0]),
        "7.6-2": torque_figure(network, both[1]),
        "7.6-4": reversal_figure(network, both[0]),
        **spline_figures(both[0]),
        **plant_figures(
            both[0], lambda masses: tqdm(masses, desc="linearity", unit="mass", disable=None)
        ),
    }
    with all_or_nothing(arguments.output) as folder:
        for one in both:
            for kind in ("training", "comparison"):
                name = f"{one.name.lower().replace(' ', '_')}_{kind}.csv"
                jc.save_recording(getattr(one, kind).recording, folder / name)
        for name, (_, rows) in tables.items():
            write_csv(folder / f"{name}.csv", rows)
        for number, figure in figures.items():
            save_picture(figure, folder / f"figure_{number}.png")
        (folder / "index.html").write_text(index_page(tables, notes), encoding="utf-8")
    for name in ("errors_a", "errors_b", "peaks"):
        caption, rows = tables[name]
        print(f"\n{caption}")
        cells = [
            [f"{v:.4g}" if isinstance(v, float) else str(v) for v in row.values()] for row in rows
        ]
        print(text_table(list(rows[0]), cells))
    print("\n" + "\n".join(notes))
    print(f"\nwrote every table and figure into {arguments.output}; see index.html")


if __name__ == "__main__":
    main()
