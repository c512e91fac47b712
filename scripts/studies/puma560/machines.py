"""PUMA A and PUMA B, identified from the training trajectory and prepared for judging."""

import dataclasses
from collections.abc import Mapping, Sequence
from pathlib import Path

import numpy as np
from jaxtyping import Array, Float

import jaxcslc as jc
import sim
from jaxcslc.training import AdaptiveNetwork, inverse_dynamics
from jaxcslc.uncertainty import SystematicError, systematic_error
from scripts.studies.motor.linearity import limited
from scripts.studies.training.side_by_side import (
    ROUTES,
    Trainings,
    epsilon,
    half_squares,
    stacked,
    train_side_by_side,
)
from scripts.studies.training.thesis_route import ThesisRoute, thesis_route
from scripts.studies.truth import published_coefficients, true_coefficients


# Joint 2's limit of linearity [N m]; the other joints have it in proportion to their greatest
# torques (7.2.3). No demand of either trajectory exceeds it, as the thesis presumes of its own.
LINEAR_UP_TO = 150.0
TRAINED = "CSLC trained"
SOLVED, CHOSEN = "CSLC solved", "CSLC"
# The route whose coefficients the tables call trained: the thesis's hand-over.
SHOWN_ROUTE = "backpropagation and PERAL"
TWIN, WITHIN, WEAK = "twin", "within the limits", "weak motors"
# Slower than this a joint may stick, where no model of sliding friction predicts its torque; the
# thesis leaves the ends of the comparison trajectory out for that (7.4.2).
MOVING = 0.01  # rad/s
# A quick run does not select its settings.
_QUICK = jc.Settings(
    jc.Preparation(jc.AveragedSplines(13), torque_alignment="mean"), jc.LeastSquares(cutoff=8.0)
)
# What 7.4 and 7.5 train on: the demand of the previous sample, and no slow pair.
_TRAINED_ON = jc.Preparation(
    jc.AveragedSplines(17), torque_alignment="previous", threshold_fraction=0.01
)
# The same with the thesis's mask of possible backlash (Eqn. 2.5-7), for the route to the letter.
TO_THE_LETTER = dataclasses.replace(_TRAINED_ON, threshold_fraction=None, backlash=True)
# The thesis disregards "the very beginning and end" of the comparison trajectory (7.4.2). In 0.2 s,
# every joint of the minimum-jerk path is up to 0.1 rad/s.
_ENDS = 100  # samples


@dataclasses.dataclass(frozen=True)
class IdentifiedMachine:
    """One machine's recordings, and the coefficients identified from the first.

    **Attributes**

    - `settings`: of the fit, chosen within the training recording as `jaxcslc identify` does.
    - `patterns`: of the training recording, under these settings.
    - `comparison_patterns`: of the comparison recording, whatever the settings: smoothed encoder
      readings, the mean of the demands before and after, no joint at rest.
    - `thesis_patterns`: of the same recording as the thesis judges: the demand of the previous
      sample, without the beginning and the end.
    - `validation_patterns`: of the same recording under `settings`, as `jaxcslc identify
      --validate` judges.
    - `systematic`: errors of the fit that no residual shows, as `jc.identify` computes them.
    - `vectors`: coefficients by model.
    - `to_the_letter`: the training of 7.5 with the thesis's masks and end; None in a quick run.
    - `side_by_side`: trainings of every seed's recording; None in a quick run.
    """

    name: str
    machine: sim.Machine
    training: sim.SimulatedRecording
    comparison: sim.SimulatedRecording
    settings: jc.Settings
    patterns: jc.Patterns
    comparison_patterns: jc.Patterns
    thesis_patterns: jc.Patterns
    validation_patterns: jc.Patterns
    fit: jc.Identification
    systematic: SystematicError
    vectors: Mapping[str, Float[Array, " coefficients"]]
    to_the_letter: ThesisRoute | None
    side_by_side: "SeedTrainings | None"

    @property
    def letter(self) -> str:
        """A or B."""
        return self.name[-1]


@dataclasses.dataclass(frozen=True)
class SeedTrainings:
    """Trainings of one machine's recordings, one per seed, and the direct solve of each.

    **Attributes**

    - `trainings`: by route.
    - `solved`: coefficients of the direct solve, (seeds, p).
    - `solved_cost`: half the summed squared errors that the direct solve leaves on the training
      patterns [(N m)²].
    - `training_error`, `comparison_error`: ε of each seed, by route and by name of the
      coefficients [N m].
    """

    trainings: Mapping[str, Trainings]
    solved: Float[Array, "seeds coefficients"]
    solved_cost: Float[np.ndarray, " seeds"]
    training_error: Mapping[str, Float[np.ndarray, " seeds"]]
    comparison_error: Mapping[str, Float[np.ndarray, " seeds"]]

    @property
    def seeds(self) -> int:
        """Return how many recordings there are."""
        return len(self.solved)


def as_in_the_thesis(recording: jc.Recording) -> jc.Patterns:
    """The patterns of a comparison recording by which the thesis judges (7.4.2)."""
    return jc.prepare(
        recording,
        smoothing=jc.AveragedSplines(17),
        torque_alignment="previous",
        thresholds=0.0,
        trim=_ENDS,
    )


def trained_side_by_side(
    cslc: jc.CSLC,
    training: Sequence[jc.Recording],
    comparison: Sequence[jc.Recording],
    truth: Float[Array, " coefficients"],
    routes: Sequence[str] = ("backpropagation", SHOWN_ROUTE),
    *,
    timed: bool = False,
) -> SeedTrainings:
    """Train and solve a CSLC on each of several recordings of a machine.

    **Arguments**

    - `training`, `comparison`: one recording each per seed.
    - `truth`: the machine's coefficients.
    - `routes`: names in `ROUTES`.
    - `timed`: as `train_side_by_side` has it.
    """
    network: AdaptiveNetwork = inverse_dynamics(cslc)
    learnt = [_TRAINED_ON.patterns(recording) for recording in training]
    training_set = stacked(network, learnt, equations=True)
    judged = stacked(network, [as_in_the_thesis(recording) for recording in comparison])
    measured = published_coefficients(cslc)
    trainings = {
        name: train_side_by_side(cslc, training_set, measured, ROUTES[name], timed=timed)
        for name in routes
    }
    equations = training_set.equations
    assert equations is not None
    solved = equations.solution()
    regressed = np.stack([jc.regress_friction(cslc, part, measured) for part in learnt])
    weights = {name: part.weights for name, part in trainings.items()}
    weights |= {SOLVED: solved, "Ar+LS": measured, "Ar+Rg": regressed, "true": truth}
    training_error, comparison_error = (
        {name: epsilon(network, of, k) for name, k in weights.items()}
        for of in (training_set, judged)
    )
    return SeedTrainings(
        trainings, solved, half_squares(network, training_set, solved), training_error,
        comparison_error,
    )  # fmt: skip


def machines() -> dict[str, sim.Machine]:
    """PUMA A and PUMA B, with every disturbance of Section 7.2.

    Their motors are linear as far as the trajectories need them.
    """
    return {
        name: limited(sim.disturbed(machine), LINEAR_UP_TO)
        for name, machine in (("PUMA A", sim.puma_a()), ("PUMA B", sim.puma_b()))
    }


def variants(a: sim.Machine, b: sim.Machine) -> dict[str, sim.Machine]:
    """Three more machines: what each shows is compared with PUMA A.

    - `TWIN`: the links of A and the friction of B.
    - `WITHIN`: A, on the trajectory of `WEAK`.
    - `WEAK`: A with the limits of linearity of `sim.DISTURBANCES`, which the trajectories exceed.
    """
    return {
        TWIN: dataclasses.replace(b, robot=a.robot),
        WITHIN: a,
        WEAK: dataclasses.replace(a, **sim.DISTURBANCES["motor linearity"]),
    }


def fitted(
    network: jc.CSLC, recording: jc.Recording, *, quick: bool
) -> tuple[jc.Settings, jc.Patterns, jc.Identification]:
    """Settings, patterns and fit of a training recording."""
    settings = _QUICK if quick else jc.choose_settings(network, recording).settings
    patterns = settings.patterns(recording)
    return settings, patterns, settings.fit(network, patterns)


def judged_patterns(recording: jc.Recording) -> jc.Patterns:
    """The patterns of a comparison recording: `IdentifiedMachine.comparison_patterns`."""
    return jc.prepare(
        recording, smoothing=jc.AveragedSplines(17), torque_alignment="mean", thresholds=MOVING
    )


def identified(
    network: jc.CSLC,
    name: str,
    machine: sim.Machine,
    recordings: Sequence[Sequence[sim.SimulatedRecording]],
    *,
    quick: bool,
    store: Path | None = None,
) -> IdentifiedMachine:
    """Fits a machine's coefficients to its first recording and prepares the second for judging.

    - `recordings`: training and comparison of every seed; the first seed's are those of the
      tables, and all are trained on.
    - `store`: a folder for trainings in progress.
    """
    training, comparison = recordings[0]
    settings, patterns, fit = fitted(network, training.recording, quick=quick)
    published = published_coefficients(network)
    truth = true_coefficients(network, machine)
    # Compiling a training takes longer than all else of a quick run.
    side_by_side = to_the_letter = None
    vectors = {
        "Ar+LS": published,
        "Ar+Rg": jc.regress_friction(network, patterns, published),
    }
    if not quick:
        side_by_side = trained_side_by_side(
            network,
            [simulated.recording for simulated, _ in recordings],
            [simulated.recording for _, simulated in recordings],
            truth,
        )
        to_the_letter = thesis_route(
            network,
            training.recording,
            TO_THE_LETTER,
            published,
            checkpoints=None if store is None else store / name,
        )
        vectors[TRAINED] = side_by_side.trainings[SHOWN_ROUTE].weights[0]
        vectors[SOLVED] = side_by_side.solved[0]
    vectors |= {CHOSEN: fit.k, "true": truth}
    return IdentifiedMachine(
        name,
        machine,
        training,
        comparison,
        settings,
        patterns,
        judged_patterns(comparison.recording),
        as_in_the_thesis(comparison.recording),
        settings.patterns(comparison.recording),
        fit,
        systematic_error(network, training.recording, settings, fit),
        vectors,
        to_the_letter,
        side_by_side,
    )
