"""PUMA A and PUMA B, identified from the training trajectory and prepared for judging."""

import dataclasses
from collections.abc import Sequence

import jax

import jaxcslc as jc
import sim
from scripts.studies.truth import published_coefficients, true_coefficients


# Slower than this a joint may stick, where no model of sliding friction predicts its torque; the
# thesis leaves the ends of the comparison trajectory out for that (7.4.2).
_MOVING = 0.01  # rad/s
# A quick run does not select its settings.
_QUICK = jc.Settings(
    jc.Preparation(jc.AveragedSplines(13), torque_alignment="mean"), jc.LeastSquares(cutoff=8.0)
)


@dataclasses.dataclass(frozen=True)
class IdentifiedMachine:
    """One machine's recordings, and the coefficients identified from the first.

    **Attributes**

    - `patterns`: of the training recording.
    - `comparison_patterns`: of the comparison recording, for judging.
    - `vectors`: coefficients by model.
    """

    name: str
    machine: sim.Machine
    training: sim.SimulatedRecording
    comparison: sim.SimulatedRecording
    settings: jc.Settings
    patterns: jc.Patterns
    comparison_patterns: jc.Patterns
    fit: jc.Identification
    vectors: dict[str, jax.Array]

    @property
    def letter(self) -> str:
        """A or B."""
        return self.name[-1]


def machines() -> dict[str, sim.Machine]:
    """PUMA A, PUMA B, and a twin with the links of A and the friction of B."""
    a, b = sim.disturbed(sim.puma_a()), sim.disturbed(sim.puma_b())
    return {"PUMA A": a, "PUMA B": b, "twin": dataclasses.replace(b, robot=a.robot)}


def identified(
    network: jc.CSLC,
    name: str,
    machine: sim.Machine,
    recordings: Sequence[sim.SimulatedRecording],
    *,
    quick: bool,
) -> IdentifiedMachine:
    """Fits a machine's coefficients to its first recording and prepares the second for judging."""
    training, comparison = recordings
    settings = _QUICK if quick else jc.choose_settings(network, training.recording).settings
    patterns = settings.patterns(training.recording)
    fit = settings.fit(network, patterns)
    published = published_coefficients(network)
    # Judged as the thesis does, on what was measured: smoothed encoder readings. The torque is the
    # demand, unsmoothed.
    comparison_patterns = jc.prepare(
        comparison.recording,
        smoothing=jc.AveragedSplines(17),
        torque_alignment="mean",
        thresholds=_MOVING,
    )
    vectors = {
        "Ar+LS": published,
        "Ar+Rg": jc.regress_friction(network, patterns, published),
        "CSLC": fit.k,
        "true": true_coefficients(network, machine),
    }
    return IdentifiedMachine(
        name, machine, training, comparison, settings, patterns, comparison_patterns, fit, vectors
    )
