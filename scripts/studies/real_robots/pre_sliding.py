"""Does dry friction yield before it slides, joint by joint, on real arms?

Both models have the robot's friction without static friction, and are fitted to motion through a
20 Hz Butterworth filter, slow pairs included. One of them has dry friction with a state along the
motion (`jaxcslc.friction.fit_pre_sliding`). Errors are root mean squares over all samples,
with states over those without [%]: on eighths of the fitted motion, each predicted by a fit to the
others, and on the motion that is judged. A joint whose held-out error falls by no more than chance
explains keeps the sign of velocity.
"""

import dataclasses
from collections.abc import Sequence

import numpy as np

import jaxcslc as jc
from jaxcslc.friction import fit_pre_sliding
from scripts.studies.real_robots import by_arm
from scripts.studies.real_robots.arms import Arm
from scripts.studies.real_robots.load_friction import SETTINGS as MASKED, percent, rms
from scripts.studies.real_robots.methods import evenly, without_static


jc.enable_x64()

SETTINGS = dataclasses.replace(
    MASKED, preparation=dataclasses.replace(MASKED.preparation, threshold_fraction=0.0)
)


def lines_of(name: str, arm: Arm) -> list[list[str]]:
    """Return the lines of the table: held-out errors, errors on the motion that is judged, and
    lengths.
    """
    network = without_static(arm)
    patterns, solver = SETTINGS.patterns(evenly(arm.training)), SETTINGS.solver
    result = fit_pre_sliding(network, patterns, solver=solver)
    plain = solver.fit(network, patterns)
    joints = range(1, network.joint_count + 1)
    relative = [result.relative.get(joint) for joint in joints]
    rows = [[name, "held out", *("none" if x is None else str(x) for x in relative)]]
    for test, recording in arm.tests.items():
        motion = SETTINGS.patterns(evenly(recording))
        states, torque = (motion.q, motion.qd, motion.qdd), np.asarray(motion.torque)
        without = rms(torque - np.asarray(network.torque(plain.k, *states)), motion)
        with_states = rms(torque - np.asarray(result.torque(*states)[0]), motion)
        rows.append([name, test, *percent(with_states / without)])
    lengths = (f"{1e3 * length:.2g}" if length else "none" for length in result.presliding_distance)
    rows.append([name, "length [mrad]", *lengths])
    return rows


def main(argv: Sequence[str] | None = None) -> int:
    return by_arm.print_held_out(__doc__, "pre_sliding", lines_of, argv, quick=["Stäubli TX40"])


if __name__ == "__main__":
    raise SystemExit(main())
