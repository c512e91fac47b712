"""PUMA A and PUMA B, identified from the training trajectory and prepared for judging."""

import dataclasses
from collections.abc import Mapping, Sequence
from pathlib import Path

from jaxtyping import Array, Float

import jaxcslc as jc
import sim
from jaxcslc.identification import SystematicError, systematic_error
from scripts.studies.motor.linearity import limited
from scripts.studies.training.thesis_route import ThesisRoute, thesis_route
from scripts.studies.truth import published_coefficients, true_coefficients


# Joint 2's limit of linearity [N m]; the other joints have it in proportion to their greatest
# torques (7.2.3). No demand of either trajectory exceeds it, as the thesis presumes of its own.
LINEAR_UP_TO = 150.0
TRAINED = "CSLC trained"
TWIN, WEAK = "twin", "weak motors"
# Slower than this a joint may stick, where no model of sliding friction predicts its torque; the
# thesis leaves the ends of the comparison trajectory out for that (7.4.2).
MOVING = 0.01  # rad/s
# A quick run does not select its settings.
_QUICK = jc.Settings(
    jc.Preparation(jc.AveragedSplines(13), torque_alignment="mean"), jc.LeastSquares(cutoff=8.0)
)
# What 7.4 and 7.5 train on: the demand of the previous sample, and no pair in possible backlash.
_ROUTES = {
    "backlash and static friction": jc.Preparation(
        jc.AveragedSplines(17), torque_alignment="previous", backlash=True
    ),
    "static friction": jc.Preparation(jc.AveragedSplines(17), torque_alignment="previous"),
}


@dataclasses.dataclass(frozen=True)
class IdentifiedMachine:
    """One machine's recordings, and the coefficients identified from the first.

    **Attributes**

    - `settings`: of the fit, chosen within the training recording as `jaxcslc identify` does.
    - `patterns`: of the training recording, under these settings.
    - `comparison_patterns`: of the comparison recording as the thesis judges, whatever the
      settings: smoothed encoder readings, the mean of the demands before and after, no joint
      at rest.
    - `validation_patterns`: of the same recording under `settings`, as `jaxcslc identify
      --validate` judges.
    - `systematic`: errors of the fit that no residual shows, as `jc.identify` computes them.
    - `vectors`: coefficients by model.
    - `routes`: trainings as in 7.5, by what their masks leave out; the first is the thesis's. None
      in a quick run.
    """

    name: str
    machine: sim.Machine
    training: sim.SimulatedRecording
    comparison: sim.SimulatedRecording
    settings: jc.Settings
    patterns: jc.Patterns
    comparison_patterns: jc.Patterns
    validation_patterns: jc.Patterns
    fit: jc.Identification
    systematic: SystematicError
    vectors: Mapping[str, Float[Array, " coefficients"]]
    routes: Mapping[str, ThesisRoute]

    @property
    def letter(self) -> str:
        """A or B."""
        return self.name[-1]


def machines() -> dict[str, sim.Machine]:
    """PUMA A and PUMA B, with every disturbance of Section 7.2.

    Their motors are linear as far as the trajectories need them.
    """
    return {
        name: limited(sim.disturbed(machine), LINEAR_UP_TO)
        for name, machine in (("PUMA A", sim.puma_a()), ("PUMA B", sim.puma_b()))
    }


def variants(a: sim.Machine, b: sim.Machine) -> dict[str, sim.Machine]:
    """Two more machines: what each shows is compared with PUMA A.

    - `TWIN`: the links of A and the friction of B.
    - `WEAK`: A with the limits of linearity of `sim.DISTURBANCES`, which the trajectories exceed.
    """
    return {
        TWIN: dataclasses.replace(b, robot=a.robot),
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
    """A comparison recording as the thesis judges: `IdentifiedMachine.comparison_patterns`."""
    return jc.prepare(
        recording, smoothing=jc.AveragedSplines(17), torque_alignment="mean", thresholds=MOVING
    )


def identified(
    network: jc.CSLC,
    name: str,
    machine: sim.Machine,
    recordings: Sequence[sim.SimulatedRecording],
    *,
    quick: bool,
    store: Path | None = None,
) -> IdentifiedMachine:
    """Fits a machine's coefficients to its first recording and prepares the second for judging.

    - `store`: a folder for trainings in progress.
    """
    training, comparison = recordings
    settings, patterns, fit = fitted(network, training.recording, quick=quick)
    published = published_coefficients(network)
    # Compiling a training takes longer than all else of a quick run.
    preparations = {} if quick else _ROUTES
    routes = {
        masks: thesis_route(
            network,
            training.recording,
            preparation,
            published,
            every=3,
            checkpoints=None if store is None else store / f"{name}, {masks}",
        )
        for masks, preparation in preparations.items()
    }
    vectors = {
        "Ar+LS": published,
        "Ar+Rg": jc.regress_friction(network, patterns, published),
        **({TRAINED: next(iter(routes.values())).k} if routes else {}),
        "CSLC": fit.k,
        "true": true_coefficients(network, machine),
    }
    return IdentifiedMachine(
        name,
        machine,
        training,
        comparison,
        settings,
        patterns,
        judged_patterns(comparison.recording),
        settings.patterns(comparison.recording),
        fit,
        systematic_error(network, training.recording, settings, fit),
        vectors,
        routes,
    )
