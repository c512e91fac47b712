"""The demo: an arm identified from its files, then the thesis's experiment on two PUMA 560s.

The first part is what a user does: `jaxcslc example panda`, `jaxcslc identify`. The second follows
Chapter 7 of the thesis.

Each of PUMA A and PUMA B, simulated with every disturbance of Section 7.2, performs the training
and the comparison trajectory within its motors' limits of linearity, once per seed. Networks are
trained on the first and judged on the second, all seeds side by side: by backpropagation, and by
backpropagation and PERAL in turns. Next to them are the direct solve, direct measurement (Ar+LS,
Ar+Rg), the truth and the thesis. Tables, figures and an index page go into one folder. A quick run
has short recordings of one seed, settings that are not selected, and no trained network.

Recordings and trainings are kept until the run ends; an interrupted one goes on from there.
"""

import argparse
import shutil
from collections.abc import Mapping, Sequence
from pathlib import Path
from typing import Any

from matplotlib.figure import Figure
from tqdm import tqdm

import jaxcslc as jc
import sim
from jaxcslc.report import all_or_nothing, degree_of_excitation, write_csv
from scripts.studies import command
from scripts.studies.figures import save_picture
from scripts.studies.puma560.figures import (
    CAPTIONS,
    linearity_experiment,
    plant_figures,
    reversal_figure,
    spline_figures,
    torque_figure,
    training_figure,
)
from scripts.studies.puma560.machines import (
    TWIN,
    WEAK,
    WITHIN,
    IdentifiedMachine,
    fitted,
    identified,
    machines,
    variants,
)
from scripts.studies.puma560.motor_limits import demand_rows, violation_rows
from scripts.studies.puma560.own_arm import FOLDER, OwnArm, identify_example
from scripts.studies.puma560.page import EXPERIMENT, MODELS, experiment_page, front_page
from scripts.studies.puma560.sign_check import sign_check
from scripts.studies.puma560.tables import (
    agreement_rows,
    coefficient_table_rows,
    error_rows,
    hand_rows,
    interval_rows,
    letter_rows,
    mask_rows,
    peak_rows,
    training_rows,
)
from scripts.studies.puma560.thresholds import threshold_fit_rows, threshold_rows
from scripts.studies.rows import made_of
from scripts.studies.tables import rows_table
from scripts.studies.thresholds import refine_thresholds
from scripts.studies.truth import true_coefficients


jc.enable_x64()

Tables = dict[str, tuple[str, list[dict[str, Any]]]]
# By machine: of each seed, the training recording and the comparison recording, if there is one.
Recordings = dict[str, list[list[sim.SimulatedRecording]]]
_QUICK_SAMPLES = 1500


def store_of(options: argparse.Namespace) -> Path:
    """Return where recordings and trainings are kept until the run ends."""
    numbers = {name: getattr(options, name) for name in ("seed", "seeds", "samples", "quick")}
    digest = made_of(numbers, sorted(Path(__file__).parent.glob("*.py")))
    return options.output / f"unfinished-{digest[:12]}"


def recorded(
    options: argparse.Namespace,
    simulated: Mapping[str, sim.Machine],
    others: Mapping[str, sim.Machine],
) -> Recordings:
    """Training and comparison recordings of every machine, and training recordings of others.

    Those that `store_of(options)` holds are not simulated again.
    """
    # Machines that share a trajectory are simulated side by side.
    training, compared = sim.adjusted_training(samples=options.samples), sim.comparison()
    seeds = range(options.seed, options.seed + options.seeds)
    jobs = {
        name: [
            [sim.Job(machine, training, seed), sim.Job(machine, compared, seed + 1)]
            for seed in seeds
        ]
        for name, machine in simulated.items()
    }
    # Motors that saturate cannot follow the adjusted trajectory within the joints' ranges.
    for name, machine in others.items():
        smaller = sim.training(samples=options.samples, robot=machine.robot)
        jobs[name] = [[sim.Job(machine, training if name == TWIN else smaller, options.seed)]]
    in_order = [job for part in jobs.values() for pair in part for job in pair]
    recordings = iter(sim.record(in_order, store=store_of(options), progress=True))
    return {
        name: [[next(recordings) for _ in pair] for pair in part] for name, part in jobs.items()
    }


def machine_tables(network: jc.CSLC, puma: IdentifiedMachine) -> Tables:
    """Captions and rows of the tables of one machine, by the name of their file."""
    letter = puma.letter.lower()
    refined = refine_thresholds(network, puma.training.recording, puma.settings)
    return {
        f"errors_{letter}": (
            f"Comparison trajectory of {puma.name}: mean error moduli and ε [N m]",
            error_rows(network, puma),
        ),
        f"hand_{letter}": (
            f"{puma.name}: mean acceleration errors of the flange, of the true machine, that the"
            " torque errors of each joint and of all joints would cause [m/s²]",
            hand_rows(network, puma),
        ),
        f"coefficients_{letter}": (
            f"Coefficients of {puma.name}",
            coefficient_table_rows(network, puma),
        ),
        **trained_tables(network, puma, letter),
        f"thresholds_{letter}": (
            f"{puma.name}: speeds from which static friction is insignificant",
            threshold_rows(puma, refined),
        ),
        f"threshold_fits_{letter}": (
            f"{puma.name}: the fit under other thresholds",
            threshold_fit_rows(network, puma, refined),
        ),
        f"backlash_mask_{letter}": (
            f"{puma.name}: Eqn. 2.5-7 against the simulator's record of backlash",
            mask_rows(puma),
        ),
    }


def trained_tables(network: jc.CSLC, puma: IdentifiedMachine, letter: str) -> Tables:
    """Captions and rows of the trainings of one machine; none of a quick run."""
    if puma.side_by_side is None:
        return {}
    return {
        f"training_{letter}": (
            f"{puma.name}: networks trained on {puma.side_by_side.seeds} recordings side by side."
            " Medians over recordings; ε as in the thesis",
            training_rows(puma),
        ),
        f"letter_{letter}": (
            f"{puma.name}: the training of 7.5 with the thesis's masks and end",
            letter_rows(network, puma),
        ),
    }


def all_figures(
    network: jc.CSLC, both: Sequence[IdentifiedMachine], responses: Sequence[sim.MotorLinearity]
) -> dict[str, Figure]:
    """Every figure, by its number in the thesis."""
    first, second = both
    return {
        "7.6-1": torque_figure(network, first),
        "7.6-2": torque_figure(network, second),
        "7.6-4": reversal_figure(network, first),
        **training_figure(both),
        **spline_figures(first),
        **plant_figures(first, responses),
    }


def machine_note(network: jc.CSLC, puma: IdentifiedMachine) -> str:
    """Settings, condition, signs and excitation of a machine's fit."""
    return (
        f"{puma.name}: {puma.settings}. Rank {int(puma.fit.rank)} of {network.size}, condition"
        f" {float(puma.fit.condition):.3g}. {sign_check(network, puma.fit.k)}."
        f" Excitation: {degree_of_excitation(network, puma.patterns)}"
    )


def experiment(options: argparse.Namespace) -> int:
    """Records, identifies, and writes every table and figure."""
    network = jc.derive(jc.puma560())
    simulated = machines()
    others = variants(*simulated.values())
    print("1 of 3: simulating the thesis's arms", flush=True)
    recordings = recorded(options, simulated, others)
    print("2 of 3: identifying and training them", flush=True)
    both = [
        identified(
            network,
            name,
            machine,
            recordings[name],
            quick=options.quick,
            store=store_of(options),
        )
        for name, machine in tqdm(simulated.items(), desc="fitting", unit="machine", disable=None)
    ]
    first = both[0]
    responses = linearity_experiment(
        first.machine,
        lambda masses: tqdm(masses, desc="linearity", unit="mass", disable=None),
        quick=options.quick,
    )
    twin, within, weak = (recordings[name][0][0].recording for name in (TWIN, WITHIN, WEAK))
    _, _, twin_fit = fitted(network, twin, quick=options.quick)
    agreement, agreement_text = agreement_rows(
        network, first, twin_fit, true_coefficients(network, others[TWIN])
    )
    notes = [machine_note(network, puma) for puma in both]
    notes.append(f"PUMA A and a machine with its links and PUMA B's friction: {agreement_text}")
    tables: Tables = {}
    for puma in both:
        tables |= machine_tables(network, puma)
    tables["intervals"] = (
        "How many of the 95 % intervals contain the true coefficient, by what they allow for",
        interval_rows(both),
    )
    tables["peaks"] = ("Peak torques of the comparison trajectory", peak_rows(both))
    tables["demands"] = (
        "Greatest demands beside the motors' limits of linearity (7.2.3)",
        demand_rows(both, responses),
    )
    tables["weak_motors"] = (
        "PUMA A: what it costs if training demands exceed the limits of linearity. Mean error"
        " moduli and ε on the same comparison recording [N m]",
        violation_rows(network, first, others[WEAK], (within, weak)),
    )
    tables["one_design"] = ("PUMA A and its twin: variation and sensitivity", agreement)
    figures = all_figures(network, both, responses)
    with all_or_nothing(options.output) as folder:
        for puma in both:
            prefix = puma.name.lower().replace(" ", "_")
            jc.save_recording(puma.training.recording, folder / f"{prefix}_training.csv")
            jc.save_recording(puma.comparison.recording, folder / f"{prefix}_comparison.csv")
        for name, (_, rows) in tables.items():
            write_csv(folder / f"{name}.csv", rows)
        for number, figure in figures.items():
            save_picture(figure, folder / f"figure_{number}.png")
        print("3 of 3: identifying an arm from its files", flush=True)
        arm = identify_example(folder / FOLDER, quick=options.quick)
        captions = {name: CAPTIONS[name] for name in figures}
        every = experiment_page(tables, captions, notes)
        (folder / EXPERIMENT).write_text(every, encoding="utf-8")
        (folder / "index.html").write_text(front_page(arm, tables, captions), encoding="utf-8")
        shutil.rmtree(options.output / FOLDER, ignore_errors=True)  # files alone are replaced
    shutil.rmtree(store_of(options))
    print(summary(arm, tables))
    print(f"Open {options.output / 'index.html'}. All tables and figures: {EXPERIMENT} next to it.")
    return 0


def summary(arm: OwnArm, tables: Tables) -> str:
    """Return what the terminal shows of a run."""
    rows = [
        {"torque error ε [N m]": f"PUMA {letter.upper()}"}
        | {name: row[model] for model, name, _ in MODELS if model in row}
        for letter in "ab"
        for row in tables[f"errors_{letter}"][1]
        if row[""] == "mean ε"
    ]
    lines = ["An arm from its files: jaxcslc example panda, jaxcslc identify"]
    lines += [f"  {arm.report.page().headline}", *(f"  {text}" for text in arm.sentences)]
    lines += ["The thesis's experiment on two simulated arms, on motion that was not fitted"]
    lines += [f"  {line}" for line in rows_table(rows).splitlines()]
    return "\n".join(lines)


def main(argv: Sequence[str] | None = None) -> int:
    parser = command.new_parser(__doc__, "demo")
    parser.add_argument("--seed", type=int, default=1, help="of encoders, starts and timing")
    parser.add_argument("--seeds", type=int, default=32, help="recordings to train on, of seeds"
                        " from --seed on; tables and figures are of the first")  # fmt: skip
    parser.add_argument("--samples", type=int, default=3300, help="of the training trajectory")
    options = command.parse(parser, argv, samples=_QUICK_SAMPLES, seeds=1)
    command.require_least(parser, options, seed=0, seeds=1, samples=600)
    seconds = 60.0 if options.quick else 240.0
    return command.run(parser, lambda: experiment(options), store_of(options), seconds=seconds)


if __name__ == "__main__":
    raise SystemExit(main())
