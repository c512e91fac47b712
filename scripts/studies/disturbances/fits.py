"""Fits to one training recording under several measures, and their errors on another motion."""

import dataclasses
from collections.abc import Sequence
from typing import Any

import numpy as np
from jaxtyping import Bool, Float

import jaxcslc as jc
import sim
from jaxcslc.recordings import CentralDifferences
from scripts.studies.disturbances.measures import (
    ON,
    Measures,
    network_of,
    true_coefficients,
    variants,
)
from scripts.studies.sensitivity import output_sensitivity
from scripts.studies.truth import moving_patterns


CUTOFF = 15.0  # Hz
THRESHOLD_FRACTION = 0.01


@dataclasses.dataclass(frozen=True)
class Fits:
    """Fits to one training recording by variant, and pairs that its backlash mask leaves out."""

    spacing: tuple[int, ...]
    k: dict[str, Float[np.ndarray, " coefficients"]]
    coefficient_error: dict[str, float]
    mask: dict[str, int]


def linear_pairs(
    recording: jc.Recording, limit: Sequence[float], mean: bool
) -> Bool[np.ndarray, "samples joints"]:
    """Pairs whose demands are all within the limit of linearity.

    **Arguments**

    - `mean`: whether the torque of a sample is the mean of two demands.
    """
    within = np.abs(recording.torque) <= np.asarray(limit)
    return within & np.concatenate([within[:1], within[:-1]]) if mean else within


def prepared(
    recording: jc.Recording, machine: sim.Machine, spacing: tuple[int, ...], measures: Measures
) -> jc.Patterns:
    """The patterns of a fit under some measures. Ends are trimmed alike under all of them."""
    trim = max(spacing)
    patterns = jc.prepare(
        recording,
        smoothing=jc.AveragedSplines(spacing) if measures.splines else CentralDifferences(),
        torque_alignment="mean" if measures.mean_torque else "sample",
        thresholds=None if measures.threshold else 0.0,
        threshold_fraction=THRESHOLD_FRACTION,
        backlash=measures.backlash_mask,
        trim=trim,
    )
    if not measures.linear_only:
        return patterns
    within = linear_pairs(recording, machine.linear_torque, measures.mean_torque)[trim:-trim]
    return dataclasses.replace(patterns, backlash_mask=np.asarray(patterns.backlash_mask) & within)


def identify(
    case: str, machine: sim.Machine, trained: sim.SimulatedRecording, spacing: tuple[int, ...]
) -> Fits:
    """Fits a training recording by every variant of a case."""
    measures_of = variants(case)
    reference = prepared(trained.recording, machine, spacing, measures_of[ON])
    k: dict[str, Float[np.ndarray, " coefficients"]] = {}
    errors: dict[str, float] = {}
    for name, measures in measures_of.items():
        network = network_of(measures.network_terms())
        patterns = (
            reference if name == ON else prepared(trained.recording, machine, spacing, measures)
        )
        cutoff = CUTOFF if measures.low_pass else None
        solver = jc.LeastSquares(joint_weights="residual", errors="independent", cutoff=cutoff)
        fit = solver.fit(network, patterns)
        k[name] = np.asarray(fit.k)
        # Of the best motion there is: differences of counts would raise the sensitivities.
        sensitivity = np.asarray(output_sensitivity(network, reference))
        effect = (k[name] - true_coefficients(network, machine)) * sensitivity
        errors[name] = float(np.sqrt(np.mean(effect**2)))
    mask: dict[str, int] = {}
    if any(machine.backlash):
        mask = backlash_counts(machine, trained, spacing, measures_of[ON])
    return Fits(spacing, k, errors, mask)


def backlash_counts(
    machine: sim.Machine,
    trained: sim.SimulatedRecording,
    spacing: tuple[int, ...],
    measures: Measures,
) -> dict[str, int]:
    """Return how many pairs the backlash mask leaves out, and how many of them are in backlash."""
    alone = dataclasses.replace(measures, linear_only=False)
    mask = np.asarray(prepared(trained.recording, machine, spacing, alone).backlash_mask)
    trim = max(spacing)
    quality = sim.mask_quality(mask, trained.truth.apart[trim:-trim]).together
    counts = {"disturbed": quality.disturbed, "left_out": quality.left_out}
    counts |= {"caught": quality.caught, "pairs": np.array([quality.samples])}
    return {name: int(value[0]) for name, value in counts.items()}


def rigid_patterns(performed: sim.SimulatedRecording, machine: sim.Machine) -> jc.Patterns:
    """The links' true motion where they move, and the torque that rigid gears would have needed.

    The sum of the two equations of `sim.Truth`, with the links' acceleration for the rotors'.
    """
    truth = performed.truth
    assert machine.robot.links is not None
    inertia = np.array([float(link.motor_inertia) for link in machine.robot.links])
    torque = truth.torque - inertia * (truth.rotor_acceleration - truth.acceleration)
    return moving_patterns(performed, torque)


def judge(
    case: str, machine: sim.Machine, fits: Fits, performed: sim.SimulatedRecording
) -> dict[str, Any]:
    """The row of one seed: figures of every variant on the comparison recording."""
    patterns = rigid_patterns(performed, machine)
    figures: dict[str, dict[str, float]] = {}
    for name, measures in variants(case).items():
        network = network_of(measures.network_terms())
        vectors = {"fit": fits.k[name], "true": true_coefficients(network, machine)}
        epsilon, floor = np.asarray(jc.compare(network, patterns, vectors).epsilon).tolist()
        error = fits.coefficient_error[name]
        figures[name] = {"epsilon": epsilon, "coefficient_error": error, "floor": floor}
    return {"spacing": list(fits.spacing), "fits": figures, "mask": fits.mask}
