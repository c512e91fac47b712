"""Tables of the experiment, beside those of the thesis."""

from collections.abc import Sequence
from typing import Any

import numpy as np

import jaxcslc as jc
import sim
from jaxcslc.assessment import agreement, mask_quality, output_sensitivity
from jaxcslc.identification import coefficient_rows, refine_thresholds
from scripts.studies.puma560.machines import IdentifiedMachine


Rows = list[dict[str, Any]]

# What the thesis reports of its real machines: ε of Figs. 7.6-3 and 7.6-4, peaks of 7.4.2.
_THESIS_EPSILON = {
    "PUMA A": {"Ar+LS": 1.8155, "Ar+Rg": 0.698, "CSLC": 0.2498},
    "PUMA B": {"Ar+LS": 1.105, "Ar+Rg": 0.979, "CSLC": 0.3085},
}
_THESIS_PEAKS = (13.6, 42.8, 8.59, 1.44, 1.77, 1.76)  # N m


def error_rows(network: jc.CSLC, puma: IdentifiedMachine) -> Rows:
    """Fig. 7.6-3 (or its twin for B), with the thesis's ε as the last row."""
    rows: Rows = list(jc.compare(network, puma.comparison_patterns, puma.vectors).rows())
    return [*rows, {"": "mean ε, thesis", **_THESIS_EPSILON[puma.name], "true": float("nan")}]


def peak_rows(machines: Sequence[IdentifiedMachine]) -> Rows:
    """Peak torques of the comparison trajectory beside 7.4.2."""
    rows: Rows = []
    for joint, reported in enumerate(_THESIS_PEAKS):
        row: dict[str, Any] = {"joint": joint + 1, "thesis [N m]": reported}
        for puma in machines:
            row[f"{puma.name} [N m]"] = float(
                np.abs(puma.comparison.recording.torque[:, joint]).max()
            )
        rows.append(row)
    return rows


def threshold_rows(network: jc.CSLC, puma: IdentifiedMachine) -> Rows:
    """Thresholds from the residuals beside Fig. B.6 and the simulator's static friction."""
    refined = refine_thresholds(network, puma.training.recording, puma.settings)
    thesis = sim.thesis_coefficients(puma.letter).insignificant_from
    thresholds = refined.rounds[-1].tolist()
    return [
        {
            "joint": joint + 1,
            "from residuals [rad/s]": thresholds[joint],
            "seen in residuals": str(bool(refined.static_friction.significant[joint])),
            "thesis [rad/s]": float(thesis[joint]),
            "five γ of the plant [rad/s]": 5 * puma.machine.static_velocity[joint],
        }
        for joint in range(network.joint_count)
    ]


def mask_rows(puma: IdentifiedMachine) -> Rows:
    """The mask of Eqn. 2.5-7 against the simulator's record of gears apart."""
    settings = puma.settings.with_options(backlash=True)
    masked = settings.patterns(puma.training.recording)
    start = int(np.searchsorted(puma.training.truth.time, masked.time[0] - 1e-9))
    apart = puma.training.truth.apart[start : start + masked.samples]
    return list(mask_quality(np.asarray(masked.backlash_mask), apart).rows())


def agreement_rows(
    network: jc.CSLC, puma: IdentifiedMachine, other: IdentifiedMachine
) -> tuple[Rows, str]:
    """Agreement of the coefficients of two machines with the same links and other friction."""
    sensitivity = output_sensitivity(network, puma.patterns)
    result = agreement(
        network,
        puma.fit,
        other.fit,
        sensitivity=sensitivity,
        truth=(puma.vectors["true"], other.vectors["true"]),
    )
    return list(result.rows()), str(result)


def coefficient_table_rows(network: jc.CSLC, puma: IdentifiedMachine) -> Rows:
    """Figs. B.1 to B.5: identified beside true coefficients, Armstrong's and the thesis's."""
    return coefficient_rows(
        network,
        puma.fit,
        {
            "true": np.asarray(puma.vectors["true"]),
            "Ar+LS": np.asarray(puma.vectors["Ar+LS"]),
            "thesis": sim.thesis_coefficients(puma.letter).coefficients,
        },
        sensitivity=output_sensitivity(network, puma.patterns),
    )
