"""What missing terms and a wrong time of torques may do to coefficients."""

from collections.abc import Mapping

import numpy as np
from jaxtyping import Bool, Float

from ...solver import components_for
from ...systematic import SystematicError, missing_terms
from .._linear import Linear
from .._point import Point
from ..band import Factored


Inputs = Float[np.ndarray, "equations joints inputs"]


def systematic_errors(
    linear: Linear,
    factored: Factored,
    point: Point,
    counted: Bool[np.ndarray, "equations joints"],
    effective: Float[np.ndarray, " joints"],
) -> SystematicError:
    """Return what a wrong time of torques and missing terms may do to coefficients.

    As `systematic_error` of least squares, without the causes that are smoothing's: each of
    `missing_terms` is added to the equations, for all joints that lack it, and so is the derivative
    of recorded torques by time (`"torque timing"`). With inputs C, what is left of them beside
    positions and coefficients is C' (Frisch and Waugh 1933); their coefficients are
    (C'ᵀ W C)⁻¹ Cᵀ W r for residuals r, and the fit changes by as much as it explains of C. Of the
    square of this change its variance is taken off, from the lowest cosine components of C'ᵀ W r as
    for the fit itself: a term that the recording does not show makes no part.

    **Arguments**

    - `linear`, `factored`: the equations at the minimum `point`.
    - `counted`: equations that count fully.
    - `effective`: (n,) how many independent equations each joint's are worth.

    **Returns** by cause, (p,) of each coefficient.
    """
    p, components = len(point.k), int(np.sum(components_for(np.asarray(effective))))
    parts: dict[str, np.ndarray] = {}
    for cause, inputs in _inputs(linear, point, counted).items():
        change = _change(linear, factored, inputs, components) * linear.objective.scale
        parts[cause] = np.abs(change[:p])
    return SystematicError(parts)


def _inputs(
    linear: Linear, point: Point, counted: Bool[np.ndarray, "equations joints"]
) -> Mapping[str, Inputs]:
    """Return inputs of terms by cause."""
    motion = linear.objective.motion
    record, equations = motion.record, motion.equations
    step = equations.intervals[:, None]
    velocity = np.diff(point.q, axis=0) / step
    velocity = (velocity[1:] * step[:-1] + velocity[:-1] * step[1:]) / (step[1:] + step[:-1])
    predicted = record.averaged - linear.present["torque"]
    n = predicted.shape[1]
    result: dict[str, Inputs] = {"torque timing": record.rate[:, :, None]}
    terms = missing_terms(equations.network, velocity, predicted, counted, np.zeros(n))
    for cause, columns in terms.items():
        inputs = np.zeros((len(predicted), n, sum(part.shape[1] for part in columns)))
        first = 0
        for joint, part in enumerate(columns):
            inputs[:, joint, first : first + part.shape[1]] = part
            first += part.shape[1]
        if first:
            result[cause] = inputs
    return result


def _change(
    linear: Linear, factored: Factored, inputs: Inputs, components: int
) -> Float[np.ndarray, " border"]:
    """Return by how much inputs change the border, beyond noise; in its scale."""
    objective, weights = linear.objective, linear.weights
    # Inputs of a joint that rests, or of torques that never bend, say nothing.
    size = np.sqrt(np.sum(weights["torque"][:, :, None] * inputs**2, axis=(0, 1)))
    inputs = inputs[:, :, size > 0.0] / size[size > 0.0]
    count = inputs.shape[2]
    explained = np.zeros((count, len(objective.scale)))
    scores = np.zeros((len(weights["position"]), count))
    gram = np.zeros((count, count))
    of_inputs = [linear.zeros(torque=inputs[:, :, number]) for number in range(count)]
    steps = linear.steps(factored, of_inputs) if of_inputs else []
    for number, (step, of_input) in enumerate(zip(steps, of_inputs, strict=True)):
        left = linear.after(step, of_input)
        explained[number] = step.border
        weighted = weights["torque"] * left["torque"]
        gram[number] = np.einsum("ij,ijk->k", weighted, inputs)
        scores[1:-1, number] += np.sum(weighted * linear.residuals["torque"], axis=1)
        scores[:, number] += np.sum(
            weights["position"] * left["position"] * linear.residuals["position"], axis=1
        )
    inverse = np.linalg.pinv(0.5 * (gram + gram.T), rcond=1e-9, hermitian=True)
    values = inverse @ np.einsum(
        "ijk,ij->k", inputs, weights["torque"] * linear.residuals["torque"]
    )
    phase = (np.arange(len(scores)) + 0.5) / len(scores)
    cosines = np.sqrt(2.0) * np.cos(np.pi * np.arange(1, components + 1)[:, None] * phase)
    noise = cosines @ scores @ inverse @ explained
    variance = np.mean(noise**2, axis=0)
    return np.sqrt(np.maximum((values @ explained) ** 2 - variance, 0.0))
