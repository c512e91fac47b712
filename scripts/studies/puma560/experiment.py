"""The thesis's experiment: two PUMA 560s identified, judged and drawn as in Chapter 7.

Each of PUMA A and PUMA B, simulated with every disturbance of Section 7.2, performs the training
and the comparison trajectory. Coefficients are fitted to the first and judged on the second, beside
direct measurement (Ar+LS, Ar+Rg), the truth and the thesis. Tables, figures and an index page go
into one folder.
"""

import argparse
from collections.abc import Mapping, Sequence
from typing import Any

import jax
from matplotlib.figure import Figure
from tqdm import tqdm

import jaxcslc as jc
import sim
from jaxcslc.assessment import sign_check
from jaxcslc.identification import degree_of_excitation
from jaxcslc.identification.report import all_or_nothing, write_csv
from jaxcslc.plotting import save_picture
from scripts.studies import command
from scripts.studies.puma560.figures import (
    CAPTIONS,
    plant_figures,
    reversal_figure,
    spline_figures,
    torque_figure,
)
from scripts.studies.puma560.machines import IdentifiedMachine, identified, machines
from scripts.studies.puma560.page import index_page
from scripts.studies.puma560.tables import (
    agreement_rows,
    coefficient_table_rows,
    error_rows,
    mask_rows,
    peak_rows,
    threshold_rows,
)
from scripts.studies.tables import rows_table


jax.config.update("jax_enable_x64", True)

Tables = dict[str, tuple[str, list[dict[str, Any]]]]
_QUICK_SAMPLES = 1500


def recorded(
    options: argparse.Namespace, simulated: Mapping[str, sim.Machine]
) -> dict[str, list[sim.SimulatedRecording]]:
    """Training and comparison recording of every machine."""
    samples = options.samples
    jobs = [
        sim.Job(machine, trajectory, options.seed + offset)
        for machine in simulated.values()
        # See `sim.training` for why each compensates its own gravity.
        for offset, trajectory in enumerate(
            (sim.training(samples=samples, robot=machine.robot), sim.comparison())
        )
    ]
    recordings = sim.record(jobs, progress=True)
    return {name: recordings[2 * i : 2 * i + 2] for i, name in enumerate(simulated)}


def all_tables(
    network: jc.CSLC, both: Sequence[IdentifiedMachine], agreement: list[dict[str, Any]]
) -> Tables:
    """Captions and rows of every table, by the name of its file."""
    tables: Tables = {}
    for puma in both:
        letter = puma.letter.lower()
        tables[f"errors_{letter}"] = (
            f"Comparison trajectory of {puma.name}: mean error moduli and ε [N m]",
            error_rows(network, puma),
        )
        tables[f"coefficients_{letter}"] = (
            f"Coefficients of {puma.name}",
            coefficient_table_rows(network, puma),
        )
        tables[f"thresholds_{letter}"] = (
            f"{puma.name}: speeds from which static friction is insignificant",
            threshold_rows(network, puma),
        )
        tables[f"backlash_mask_{letter}"] = (
            f"{puma.name}: Eqn. 2.5-7 against the simulator's record of backlash",
            mask_rows(puma),
        )
    tables["peaks"] = ("Peak torques of the comparison trajectory", peak_rows(both))
    tables["one_design"] = ("PUMA A and its twin: variation and sensitivity", agreement)
    return tables


def all_figures(
    network: jc.CSLC, both: Sequence[IdentifiedMachine], *, quick: bool
) -> dict[str, Figure]:
    """Every figure, by its number in the thesis."""
    first, second = both
    return {
        "7.6-1": torque_figure(network, first),
        "7.6-2": torque_figure(network, second),
        "7.6-4": reversal_figure(network, first),
        **spline_figures(first),
        **plant_figures(
            first,
            lambda masses: tqdm(masses, desc="linearity", unit="mass", disable=None),
            quick=quick,
        ),
    }


def experiment(options: argparse.Namespace) -> int:
    """Records, identifies, and writes every table and figure."""
    network = jc.derive(jc.puma560())
    print(network)
    simulated = machines()
    recordings = recorded(options, simulated)
    results = {
        name: identified(network, name, machine, recordings[name], quick=options.quick)
        for name, machine in tqdm(simulated.items(), desc="fitting", unit="machine", disable=None)
    }
    both = [results["PUMA A"], results["PUMA B"]]
    agreement, agreement_text = agreement_rows(network, results["PUMA A"], results["twin"])
    notes = [
        f"{puma.name}: {puma.settings}. {puma.fit}. {sign_check(network, puma.fit.k)}"
        f" positive. Excitation: {degree_of_excitation(network, puma.patterns)}"
        for puma in both
    ]
    notes.append(f"PUMA A and a machine with its links and PUMA B's friction: {agreement_text}")
    tables = all_tables(network, both, agreement)
    figures = all_figures(network, both, quick=options.quick)
    with all_or_nothing(options.output) as folder:
        for puma in both:
            prefix = puma.name.lower().replace(" ", "_")
            jc.save_recording(puma.training.recording, folder / f"{prefix}_training.csv")
            jc.save_recording(puma.comparison.recording, folder / f"{prefix}_comparison.csv")
        for name, (_, rows) in tables.items():
            write_csv(folder / f"{name}.csv", rows)
        for number, figure in figures.items():
            save_picture(figure, folder / f"figure_{number}.png")
        page = index_page(tables, CAPTIONS, notes)
        (folder / "index.html").write_text(page, encoding="utf-8")
    for name in ("errors_a", "errors_b", "peaks"):
        caption, rows = tables[name]
        print(f"\n{caption}\n{rows_table(rows)}")
    print("\n" + "\n".join(notes))
    print(f"\nwrote every table and figure into {options.output}; see index.html")
    return 0


def main(argv: Sequence[str] | None = None) -> int:
    parser = command.new_parser(__doc__, "demo")
    parser.add_argument("--seed", type=int, default=1, help="of encoders, starts and timing")
    parser.add_argument("--samples", type=int, default=3300, help="of the training trajectory")
    options = command.parse(parser, argv, samples=_QUICK_SAMPLES)
    command.require_least(parser, options, seed=0, samples=600)
    seconds = 60.0 if options.quick else 180.0
    return command.run(parser, lambda: experiment(options), seconds=seconds)


if __name__ == "__main__":
    raise SystemExit(main())
