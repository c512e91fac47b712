"""Durations: what friction or a payload alone need, and recordings one after the other.

- **durations**: seconds of a motion, repeated as often as needed, until predicted standard errors
  are 5 % of the wanted coefficients' sizes. Friction and payload, with the rigid body known from
  an earlier recording of 6.6 s: a motion designed for them, one designed for all coefficients,
  and a random Fourier series.
- **sequence**: recordings of 3 s until 5 % on every coefficient, each designed for what is worst
  after those before, against one motion repeated (`study.py` has more seeds).
"""

import argparse
import json
from collections.abc import Callable, Sequence
from typing import Any

import numpy as np

import jaxcslc as jc
from jaxcslc._text_table import text_table
from jaxcslc.excitation import (
    Design,
    Effort,
    Goal,
    Knowledge,
    Planner,
    design_motion,
    family_named,
    random_parameters,
    wanted_indices,
)
from scripts.studies import command
from scripts.studies.excitation.motions import knowledge, limits, network, noise


jc.enable_x64()

GOAL = 0.05
PIECE = 3.0  # [s]
MOST = 20  # recordings of a sequence


def rigid_body_known(design: Design) -> Knowledge:
    """The knowledge of the rigid body that a motion brings, and of nothing else."""
    known, size = design.prediction, design.network.size
    rigid = np.arange(size)[design.network.layout.inertial]
    information = np.zeros((size, size))
    part = known.covariance[np.ix_(rigid, rigid)]
    information[np.ix_(rigid, rigid)] = inverse_of(part)
    error = np.full(size, np.inf)
    error[rigid] = known.standard_error[rigid]
    return Knowledge(known.k, information, error)


def inverse_of(covariance: np.ndarray) -> np.ndarray:
    """The inverse, in units of standard errors, where it loses the fewest digits."""
    unit = np.sqrt(np.diag(covariance))
    return np.linalg.inv(covariance / np.outer(unit, unit)) / np.outer(unit, unit)


def seconds_of(planner: Planner, parameters: Any, wanted: Sequence[str]) -> float:
    """Seconds of a motion until the goal."""
    motion = planner.family.motion(np.asarray(parameters), planner.time)
    indices = wanted_indices(planner.problem.information.network, wanted)
    worst = float(np.max(planner.prediction(motion).sized_error[indices]))
    return planner.family.duration * (worst / GOAL) ** 2


def durations(wanted: Sequence[str], net: Any, known: Knowledge, steps: int) -> dict[str, float]:
    """Seconds until the goal, by motion."""
    family = family_named("splines", PIECE)
    ways: dict[str, tuple[Sequence[str] | None, str]] = {
        "designed for it": (wanted, "worst"),
        "designed for all": (None, "error"),
    }
    seconds: dict[str, float] = {}
    for name, (names, criterion) in ways.items():
        goal = Goal(criterion, names)
        planner = Planner.of(net, limits(), noise(), family, goal=goal, knowledge=known)
        design = planner.design(Effort(1, 4, steps))
        seconds[name] = seconds_of(planner, design.parameters, wanted)
    fourier = family_named("fourier", PIECE)
    planner = Planner.of(net, limits(), noise(), fourier, knowledge=known)
    draws = []
    for seed in range(9):
        rng = np.random.default_rng(seed)
        parameters = random_parameters(planner.check, planner.rest_pose(rng), rng)
        parameters = planner.check.scaled(parameters)[0]
        draws.append(seconds_of(planner, parameters, wanted))
    seconds["random Fourier, median of 9"] = float(np.median(draws))
    return seconds


def seconds_to_goal(seed: int, steps: int, say: Callable[[str], None]) -> dict[str, Any]:
    """Seconds of recordings until the goal: each designed for what those before leave open, and
    one motion repeated, designed for all coefficients or for the worst.

    **Arguments**

    - `seed`: of the random motions that designs begin with.
    - `steps`: of each design, in a round.
    """

    def design_after(known: Knowledge, criterion: str, number: int) -> Design:
        return design_motion(
            network(),
            limits(),
            noise(),
            goal=Goal(criterion),
            knowledge=known,
            duration=PIECE,
            effort=Effort(1, 4, steps, seed=100 * seed + number),
        )

    known, worst = knowledge(), []
    first = design_after(known, "overall", 0)
    seconds = {
        "in sequence": np.inf,
        "overall, repeated": first.seconds_for(GOAL),
        "worst, repeated": design_after(known, "worst", 0).seconds_for(GOAL),
    }
    design = first
    for number in range(1, MOST + 1):
        covariance = design.prediction.covariance
        error = np.sqrt(np.diag(covariance))
        known = Knowledge(known.k, inverse_of(covariance), error, known.is_model)
        worst.append(float(np.max(design.prediction.sized_error)))
        say(f"{PIECE * number:g} s: worst {100 * worst[-1]:.3g} %")
        if worst[-1] <= GOAL:
            seconds["in sequence"] = PIECE * number
            break
        design = design_after(known, "worst", number)
    return {"seconds": seconds, "worst": worst}


def study(options: argparse.Namespace) -> int:
    say = lambda text: print(text, flush=True)
    first = design_motion(
        network(),
        limits(),
        noise(),
        knowledge=knowledge(),
        duration=6.6,
        effort=Effort(1, 3, options.steps),
    )
    rows: dict[str, dict[str, float]] = {}
    known = rigid_body_known(first)
    rows["friction"] = durations(["viscous", "dry"], network(), known, options.steps)
    say(json.dumps(rows))
    if not options.quick:
        loaded, friction = network().with_payload(), network().layout.friction
        assert known.information is not None
        known.information[friction, friction] = 1 / first.prediction.standard_error[friction] ** 2
        loaded_knowledge = known.with_payload(loaded, 2.0)
        rows["mass of a payload of 2 kg"] = durations(
            ["pm"], loaded, loaded_knowledge, options.steps
        )
        say(json.dumps(rows))
    header = list(next(iter(rows.values())))
    cells = [[name, *(f"{row[x]:.3g}" for x in header)] for name, row in rows.items()]
    print(text_table([f"seconds to {100 * GOAL:g} %", *header], cells))
    seconds = seconds_to_goal(0, options.steps, say)["seconds"]
    print("; ".join(f"{name}: {value:.3g} s" for name, value in seconds.items()))
    return 0


def main(argv: Sequence[str] | None = None) -> int:
    parser = command.new_parser(__doc__, "excitation")
    parser.add_argument("--steps", type=int, default=40, help="of each design, in a round")
    options = command.parse(parser, argv, steps=5)
    return command.run(parser, lambda: study(options), seconds=900)


if __name__ == "__main__":
    raise SystemExit(main())
