"""Errors of the experiment's models at the hand: what 7.5 weighs torque errors by, and leaves open.

Each of PUMA A and PUMA B performs both trajectories, as in the experiment. Errors of Armstrong's
coefficients (Ar+LS), with regressed friction (Ar+Rg), of the direct solve (CSLC) and of the true
coefficients are judged on the comparison trajectory by the acceleration that they cause at the
flange, J M^-1 e, with the machine's true M.

    .venv/bin/python -m scripts.studies.puma560.hand
"""

import argparse
import shutil
from collections.abc import Mapping, Sequence
from typing import Any

import jax
import numpy as np
from jaxtyping import Array, Float

import jaxcslc as jc
import sim
from jaxcslc.assessment import hand_errors
from jaxcslc.identification.report import write_csv
from scripts.studies import command
from scripts.studies.puma560.experiment import recorded, store_of
from scripts.studies.puma560.machines import fitted, judged_patterns, machines
from scripts.studies.tables import rows_table
from scripts.studies.truth import published_coefficients, true_coefficients


jax.config.update("jax_enable_x64", True)

Rows = list[dict[str, Any]]
_QUICK_SAMPLES = 1500
# The flange in the last link's frame, whose origin is the wrist centre [m]: d6 of Fu, Gonzalez and
# Lee, Robotics (1987), chapter 2.
FLANGE = (0.0, 0.0, 0.05625)


def hand_rows(
    network: jc.CSLC,
    patterns: jc.Patterns,
    vectors: Mapping[str, Float[Array | np.ndarray, " coefficients"]],
) -> Rows:
    """Mean acceleration errors of the flange [m/s^2], by joint and in all.

    **Arguments**

    - `patterns`: of a comparison recording.
    - `vectors`: coefficients by model, `"true"` among them, which M is of.
    """
    return list(hand_errors(network, patterns, vectors, vectors["true"], point=FLANGE).rows())


def machine_rows(
    network: jc.CSLC,
    machine: sim.Machine,
    recordings: Sequence[sim.SimulatedRecording],
    *,
    quick: bool,
) -> Rows:
    """`hand_rows` of one machine, without trained networks."""
    training, comparison = (recording.recording for recording in recordings)
    _, patterns, fit = fitted(network, training, quick=quick)
    published = published_coefficients(network)
    vectors = {
        "Ar+LS": published,
        "Ar+Rg": jc.regress_friction(network, patterns, published),
        "CSLC": fit.k,
        "true": true_coefficients(network, machine),
    }
    return hand_rows(network, judged_patterns(comparison), vectors)


def run(options: argparse.Namespace) -> int:
    """Writes and prints one table per machine."""
    network, simulated = jc.derive(jc.puma560()), machines()
    recordings = recorded(options, simulated, {})
    options.output.mkdir(parents=True, exist_ok=True)
    for name, machine in simulated.items():
        rows = machine_rows(network, machine, recordings[name], quick=options.quick)
        write_csv(options.output / f"hand_{name[-1].lower()}.csv", rows)
        print(f"\n{name}: mean acceleration error of the flange [m/s^2]\n{rows_table(rows)}")
    shutil.rmtree(store_of(options))
    return 0


def main(argv: Sequence[str] | None = None) -> int:
    parser = command.new_parser(__doc__, "hand")
    parser.add_argument("--seed", type=int, default=1, help="of encoders, starts and timing")
    parser.add_argument("--samples", type=int, default=3300, help="of the training trajectory")
    options = command.parse(parser, argv, samples=_QUICK_SAMPLES)
    command.require_least(parser, options, seed=0, samples=600)
    seconds = 30.0 if options.quick else 60.0
    return command.run(parser, lambda: run(options), store_of(options), seconds=seconds)


if __name__ == "__main__":
    raise SystemExit(main())
