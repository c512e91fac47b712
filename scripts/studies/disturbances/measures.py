"""Disturbances of Section 7.2, the counter-measure to each, and the networks they need."""

import dataclasses
import functools
from typing import Any

import numpy as np
from jaxtyping import Float

import jaxcslc as jc
import sim
from scripts.studies import truth


@dataclasses.dataclass(frozen=True)
class Measures:
    """Which counter-measures are on."""

    splines: bool = True
    threshold: bool = True
    mean_torque: bool = True
    low_pass: bool = True
    backlash_mask: bool = False
    linear_only: bool = False
    full_tensors: bool = False
    offsets: bool = False

    def network_terms(self) -> "Measures":
        """Return those measures alone that decide which coefficients the network has."""
        return Measures(full_tensors=self.full_tensors, offsets=self.offsets)


AGAINST = {
    "quantisation": "splines",
    "static friction": "threshold",
    "asymmetric friction": "offsets",
    "tilted axes": "full_tensors",
    "motor linearity": "linear_only",
    "sample timing": "mean_torque",
    "compliance": "low_pass",
    "backlash": "backlash_mask",
}
"""The field of `Measures` that is the counter-measure to each disturbance."""
ALL = "all disturbances"
UNDISTURBED = "undisturbed"
CASES = (UNDISTURBED, *AGAINST, ALL)
ON, OFF = "on", "off"

# They change which coefficients there are: errors with and without them cannot be compared.
_OTHER_NETWORK = ("full_tensors", "offsets")


@dataclasses.dataclass(frozen=True)
class Line:
    """One line of the budget: a measure off and on in one case."""

    case: str
    name: str
    measure: str
    off: str
    """The variant of the fit without the measure."""


def variants(case: str) -> dict[str, Measures]:
    """The measures of each fit to one recording of a case, by the variant's name."""
    if case == UNDISTURBED:
        return {ON: Measures(), OFF: Measures(threshold=False)}
    if case in AGAINST:
        on = dataclasses.replace(Measures(), **{AGAINST[case]: True})
        return {ON: on, OFF: dataclasses.replace(on, **{AGAINST[case]: False})}
    fields = [field for field in AGAINST.values() if field not in _OTHER_NETWORK]
    on = Measures(**dict.fromkeys(fields, True))
    off = Measures(**dict.fromkeys(fields, False))
    all_but = {field: dataclasses.replace(on, **{field: False}) for field in fields}
    return {ON: on, OFF: off, **all_but}


def lines(case: str) -> list[Line]:
    """The lines of a case in the budget."""
    names = {UNDISTURBED: "threshold", ALL: "all measures"}
    measure = AGAINST[case].replace("_", " ") if case in AGAINST else names[case]
    all_but = [
        Line(case, f"all, but {field.replace('_', ' ')}", field.replace("_", " "), field)
        for field in variants(case)
        if field not in (ON, OFF)
    ]
    return [Line(case, case, measure, OFF), *all_but]


def machine_of(whole: sim.Machine, case: str) -> sim.Machine:
    """A machine with the disturbances of a case."""
    if case == UNDISTURBED:
        return sim.undisturbed(whole)
    return sim.disturbed(whole, *(AGAINST if case == ALL else (case,)))


@functools.cache
def network_of(terms: Measures) -> jc.CSLC:
    """The network with the terms that some measures need.

    Full tensors need base parameters: with symbolic lengths, there would be coefficients that
    numeric lengths make dependent.
    """
    robot = jc.puma560()
    if terms.offsets:
        robot = robot.with_friction("viscous", "dry", "offset")
    if terms.full_tensors:
        return jc.derive(robot.with_inertia("full"), lengths="numeric")
    return jc.derive(robot)


def true_coefficients(network: jc.CSLC, machine: sim.Machine) -> Float[np.ndarray, " coefficients"]:
    """A network's true coefficients on a machine.

    Friction of 1 ± a times v|q̇| + d has the offset a d; what it adds to viscous friction is even
    in velocity, which no term of the network is.
    """
    friction: dict[str, Any] = {}
    if "offset" in network.robot.friction:
        pairs = zip(machine.asymmetry, machine.dry, strict=True)
        friction["offset"] = [a * dry for a, dry in pairs]
    return np.asarray(truth.true_coefficients(network, machine, **friction))
