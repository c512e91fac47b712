"""Limits of linearity of the motors (7.2.3): do the trajectories stay within them, and if not?"""

import dataclasses
from collections.abc import Sequence
from typing import Any

import numpy as np

import jaxcslc as jc
import sim
from scripts.studies.disturbances.fits import linear_pairs
from scripts.studies.puma560.machines import IdentifiedMachine


Rows = list[dict[str, Any]]


def demand_rows(
    machines: Sequence[IdentifiedMachine], measured: Sequence[sim.MotorLinearity]
) -> Rows:
    """Return the greatest demands of both trajectories next to the limits.

    **Arguments**

    - `measured`: experiments of 7.2.3, that of Fig. 7.2-2 first. The range of mean demands is that
        in which a motor was seen to be linear. Joints without an experiment have the equivalent
        of the first one's range, in proportion to their greatest torques.
    """
    most = np.array(machines[0].machine.maximum_torque)
    datum = measured[0]
    covered = most * datum.torque.max() / most[datum.joint - 1]
    for response in measured:
        covered[response.joint - 1] = response.torque.max()
    rows: Rows = []
    for joint in range(most.size):
        row: dict[str, Any] = {"joint": joint + 1}
        for puma in machines:
            for name in ("training", "comparison"):
                demand = getattr(puma, name).recording.torque[:, joint]
                row[f"{puma.name}, {name} [N m]"] = float(np.abs(demand).max())
        row["seen to be linear up to [N m]"] = float(covered[joint])
        row["limit of linearity [N m]"] = machines[0].machine.linear_torque[joint]
        rows.append(row)
    return rows


def violation_rows(
    network: jc.CSLC,
    puma: IdentifiedMachine,
    limited: sim.Machine,
    recordings: tuple[jc.Recording, jc.Recording],
) -> Rows:
    """Return what it costs if the training trajectory leaves the motors' range of linearity.

    Mean error moduli and ε on the same comparison recording, of coefficients identified from the
    training recordings of the machine within its limits and of one with lower limits.

    **Arguments**

    - `limited`: the machine with lower limits.
    - `recordings`: of one training trajectory, by the machine within its limits and by `limited`.
    """
    unlimited, training = recordings
    patterns = puma.settings.patterns(training)
    mean = puma.settings.preparation.torque_alignment == "mean"
    within = linear_pairs(training, limited.linear_torque, mean)
    trim = puma.settings.preparation.trimmed(training)
    within = within[trim : within.shape[0] - trim]
    without = dataclasses.replace(
        patterns, backlash_mask=np.asarray(patterns.backlash_mask) & within
    )
    vectors = {
        "within the limits": puma.settings.fit(network, puma.settings.patterns(unlimited)).k,
        "beyond them": puma.settings.fit(network, patterns).k,
        "beyond them, such pairs left out": puma.settings.fit(network, without).k,
    }
    rows: Rows = list(jc.compare(network, puma.comparison_patterns, vectors).rows())
    beyond = 100 * (1 - within.mean(axis=0))
    for joint, row in enumerate(rows[:-1]):
        row["limit [N m]"] = limited.linear_torque[joint]
        row["training pairs beyond it [%]"] = float(beyond[joint])
    rows[-1] |= {"limit [N m]": "", "training pairs beyond it [%]": float(beyond.mean())}
    return rows
