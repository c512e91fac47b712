"""Compare the library's training of Chapter 7 with its transcription, epoch by epoch.

Both train the PUMA 560's CSLC on one simulated recording, from zero weights (7.5). The library
derives the network, `scripts.studies.training.thesis_route` sets the plan and `jaxcslc.training`
trains. The transcription reads the links from Appendix B and works in NumPy alone. Shared are the
recording, its smoothed motion (7.3) with aligned torques, and the coefficients by direct
measurement, whose ε sets the hand-over. Masks are computed by both and must be equal.

The exit status is 1 if masks, rules of epochs, or ε to 1e-9 N m differ.

    python -m scripts.studies.transcription.study
    python -m scripts.studies.transcription.study --backlash --least 1e-3
"""

import argparse
import json
import time
from collections.abc import Sequence
from pathlib import Path
from typing import Any, NamedTuple

import jax.numpy as jnp
import numpy as np

import jaxcslc as jc
import sim
from jaxcslc.recordings import TorqueAlignment
from jaxcslc.report import all_or_nothing, write_csv, write_json
from jaxcslc.training import (
    Training,
    examples,
    inverse_dynamics,
    subnetwork_masks,
    train as train_by_library,
)
from scripts.studies import command
from scripts.studies.tables import rows_table
from scripts.studies.training.thesis_route import plan_of
from scripts.studies.transcription.network import (
    appendix_network,
    appendix_signals,
    counted,
    outputs,
    possible_backlash,
    slow,
)
from scripts.studies.transcription.training import Problem, Route, Turns, cost_of, train
from scripts.studies.truth import published_coefficients


jc.enable_x64()

APPENDIX = Path(__file__).parents[3] / "tests" / "data" / "appendix_b.json"
MACHINES = {"A": sim.puma_a, "B": sim.puma_b}
RULE_NAMES = ("backpropagation", "PERAL")
# Agreement of ε that the comparison asks for [N m].
TOLERANCE = 1e-9
# A hundredth of each joint's greatest speed (7.5).
_FRACTION = 0.01


class Comparison(NamedTuple):
    """Both trainings on one recording.

    **Attributes**

    - `same_masks`: whether the library leaves out the pairs that the transcription leaves out.
    - `library`, `transcription`: the trainings.
    - `seconds`: that each took, compilation included.
    """

    same_masks: bool
    library: Training
    transcription: Route
    seconds: tuple[float, float]

    @property
    def library_rules(self) -> list[int]:
        """The rule of every epoch of the library's training."""
        rules = np.asarray(self.library.history.rule)
        return rules[rules >= 0].tolist()

    @property
    def same_rules(self) -> bool:
        """Return whether every epoch was learnt by the same rule, and none is missing."""
        return self.library_rules == self.transcription.rule

    @property
    def first_difference(self) -> int | None:
        """The first epoch whose ε differs by more than the tolerance; None without any."""
        common = min(len(self.library_rules), len(self.transcription.cost))
        errors = np.asarray(self.library.history.cost)[:common]
        different = np.abs(errors - self.transcription.cost[:common]) > TOLERANCE
        return int(np.argmax(different)) if np.any(different) else None

    @property
    def difference(self) -> float:
        """The difference of ε at the end [N m]."""
        return abs(float(self.library.cost) - self.transcription.final)

    @property
    def agree(self) -> bool:
        """Whether masks and rules are the same, and ε is, after every epoch and at the end."""
        same = self.same_masks and self.same_rules and self.first_difference is None
        return same and self.difference <= TOLERANCE


def compare(
    recording: jc.Recording,
    *,
    least: float,
    epochs: int,
    bout: int = 100,
    alignment: TorqueAlignment = "mean",
    backlash: bool = False,
    slow_pairs: str = "everything",
) -> Comparison:
    """Train on a recording by the library and by the transcription.

    **Arguments**

    - `least`: reduction of ε in an epoch at which training ends [N m].
    - `epochs`: at most.
    - `bout`: epochs of a rule before it is the other's turn.
    - `alignment`: which demands are a sample's torque.
    - `backlash`: whether pairs in possible backlash are left out (2.5-7).
    - `slow_pairs`: `"everything"`, if no subnetwork learns from slow pairs, or `"friction"`, if
      the friction subnetworks do not (7.2.2).
    """
    cslc = jc.derive(jc.puma560())
    network = inverse_dynamics(cslc)
    patterns = jc.prepare(
        recording,
        torque_alignment=alignment,
        threshold_fraction=_FRACTION,
        backlash=backlash,
    )
    q, qd, qdd = (np.asarray(values) for values in (patterns.q, patterns.qd, patterns.qdd))
    torque = np.asarray(patterns.torque)

    appendix = json.loads(APPENDIX.read_text("utf-8"))
    parts = appendix_network(appendix, cslc.names)
    in_backlash = possible_backlash(qd, qdd, torque) & backlash
    friction_only = slow_pairs == "friction"
    counts = counted(parts, in_backlash, slow(qd, _FRACTION), friction_only=friction_only)
    problem = Problem(parts, appendix_signals(appendix, q, qd, qdd), torque.T.copy(), counts)
    measured = np.asarray(published_coefficients(cslc))
    hand_over = cost_of(problem.t - outputs(parts, problem.signals, measured), problem.judged)

    masks = subnetwork_masks(network, patterns) if friction_only else np.asarray(patterns.mask)
    same_masks = np.array_equal(
        np.moveaxis(counts, 1, 2) > 0, np.broadcast_to(masks, (len(parts), *torque.shape))
    )
    training_set = examples(network, patterns, torque, masks)
    start = time.perf_counter()
    library = train_by_library(
        network,
        training_set,
        jnp.zeros(network.size),
        plan_of(hand_over, least, bout=bout),
        epochs=epochs,
        keep_weights=False,
        throw=False,
    )
    between = time.perf_counter()
    transcription = train(
        problem, np.zeros(network.size), Turns(hand_over, least, bout), epochs=epochs
    )
    seconds = between - start, time.perf_counter() - between
    return Comparison(same_masks, library, transcription, seconds)


def rows_of(comparison: Comparison) -> list[dict[str, Any]]:
    """Return one row for each training."""
    trainings = (
        ("library", comparison.library_rules, float(comparison.library.cost)),
        ("transcription", comparison.transcription.rule, comparison.transcription.final),
    )
    return [
        {
            "training": name,
            **{f"epochs of {rule}": rules.count(at) for at, rule in enumerate(RULE_NAMES)},
            "ε at the end [N m]": f"{final:.12f}",
            "seconds": seconds,
        }
        for (name, rules, final), seconds in zip(trainings, comparison.seconds, strict=True)
    ]


def study(options: argparse.Namespace) -> int:
    """Train, print how both agree and write the table."""
    machine = MACHINES[options.machine]()
    robot = machine.robot if options.gravity == "own" else None
    trajectory = sim.training(samples=options.samples, robot=robot)
    comparison = compare(
        sim.simulate(machine, trajectory, seed=options.seed).recording,
        least=options.least,
        epochs=options.epochs,
        bout=options.bout,
        alignment=options.alignment,
        backlash=options.backlash,
        slow_pairs=options.slow_pairs,
    )
    rows = rows_of(comparison)
    print(rows_table(rows))
    print(f"the same masks: {comparison.same_masks}")
    print(f"the same rule in every epoch: {comparison.same_rules}")
    print(f"first epoch whose ε differs by more than {TOLERANCE:g} N m: "
          f"{comparison.first_difference}")  # fmt: skip
    print(f"difference of ε at the end: {comparison.difference:.2g} N m")
    (outcome,) = comparison.library.outcomes()
    print(f"the library's training ended: {outcome}")
    with all_or_nothing(options.output) as folder:
        write_csv(folder / "transcription.csv", rows)
        arguments = vars(options) | {"output": str(options.output)}
        write_json(folder / "transcription.json", {"rows": rows, "command": arguments})
    print(f"wrote {options.output}")
    return 0 if comparison.agree else 1


def main(argv: Sequence[str] | None = None) -> int:
    parser = command.new_parser(__doc__, "transcription")
    parser.add_argument("--machine", choices=sorted(MACHINES), default="A")
    parser.add_argument("--seed", type=int, default=1, help="of the recording")
    parser.add_argument("--samples", type=int, default=3300, help="of the recording")
    parser.add_argument("--least", type=float, default=1e-5,
                        help="reduction of an epoch that ends training [N m]")  # fmt: skip
    parser.add_argument("--epochs", type=int, default=20_000, help="at most")
    parser.add_argument("--bout", type=int, default=100, help="epochs of a rule before it turns")
    parser.add_argument("--gravity", choices=["armstrong", "own"], default="armstrong",
                        help="whose gravity the training torques compensate (7.4.1)")  # fmt: skip
    parser.add_argument("--alignment", choices=["sample", "previous", "mean"], default="mean",
                        help="which demands are a sample's torque")  # fmt: skip
    parser.add_argument("--backlash", action="store_true",
                        help="leave out pairs in possible backlash")  # fmt: skip
    parser.add_argument("--slow-pairs", choices=["everything", "friction"], default="everything",
                        help="the subnetworks that do not learn from slow pairs")  # fmt: skip
    options = command.parse(parser, argv, samples=800, least=1e-2, epochs=400)
    command.require_least(parser, options, samples=500, epochs=1, bout=1)
    # A trial run compiles for most of its time.
    seconds = 60.0 if options.quick else 600.0
    return command.run(parser, lambda: study(options), seconds=seconds)


if __name__ == "__main__":
    raise SystemExit(main())
