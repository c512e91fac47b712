"""Study of dry friction that grows with the load: is the term worth it, joint by joint, on real
arms?

The torque of a joint's gears presses their teeth, so dry friction may have a part
kl sgn(qd) |rigid torque|, with kl of a few percent (`jaxcslc.friction.fit_load`). Both models
have the friction that `--friction` names, and are fitted to motion through a 20 Hz Butterworth
filter. Errors are root mean squares over judged samples with the term over those without it [%]: on
eighths of the fitted motion, each predicted by a fit to the others, and on the motion that is
judged. A joint whose kl is not between 0 and 1 has lost the term.
"""

from collections.abc import Sequence

import numpy as np
from jaxtyping import Float

import jaxcslc as jc
from jaxcslc.friction import fit_load, linearised
from jaxcslc.report import predicted_torque
from scripts.studies import command
from scripts.studies.real_robots import by_arm
from scripts.studies.real_robots.arms import Arm
from scripts.studies.real_robots.methods import evenly


jc.enable_x64()

SETTINGS = jc.Settings(
    jc.Preparation(jc.Butterworth(20.0), smooth_torque=True, threshold_fraction=0.01),
    jc.LeastSquares(errors="independent"),
)
FOLDS = 8


def lines_of(name: str, arm: Arm, friction: Sequence[str] | None) -> list[list[str]]:
    """Return the lines of the table: errors with the term over those without, and the coefficients.

    - `friction`: kinds of all joints; None for the robot's, without static friction.
    """
    solver = SETTINGS.solver
    network = jc.derive(arm.robot, lengths="numeric")
    laws = arm.robot.friction_per_joint if friction is None else [friction] * network.joint_count
    kinds = [tuple(kind for kind in of_joint if kind != "static") for of_joint in laws]
    network = network.with_joint_friction(kinds)
    patterns = SETTINGS.patterns(evenly(arm.training))
    richer = network.with_joint_friction([(*of_joint, "load") for of_joint in kinds])
    load = fit_load(richer, patterns, solver=solver)
    plain = solver.fit(network, patterns)
    fold = np.arange(patterns.samples) * FOLDS // patterns.samples
    held_out = [
        rms(solver.held_out_errors(*equations, fold), patterns)
        for equations in (
            (network, patterns),
            linearised(load.network, load.fit.k, patterns),
        )
    ]
    rows = [[name, "held out", *percent(held_out[1] / held_out[0])]]
    for test, recording in arm.tests.items():
        motion = SETTINGS.patterns(evenly(recording))
        torque = np.asarray(motion.torque)
        without, with_load = (
            rms(torque - np.asarray(predicted_torque(model, motion, k)), motion)
            for model, k in ((network, plain.k), (load.network, load.fit.k))
        )
        rows.append([name, test, *percent(with_load / without)])
    names, values = load.network.names, np.asarray(load.fit.k)
    errors = np.asarray(load.fit.standard_error)
    numbers = {
        symbol: f"{value:.3f} ± {error:.3f}"
        for symbol, value, error in zip(names, values, errors, strict=True)
    }
    joints = range(1, network.joint_count + 1)
    rows.append([name, "kl", *(numbers.get(f"kl{joint}", "none") for joint in joints)])
    return rows


def percent(ratio: Float[np.ndarray, " joints"]) -> list[str]:
    return [f"{100 * (value - 1):+.0f}" for value in ratio]


def rms(errors: Float[np.ndarray, "samples joints"], patterns: jc.Patterns) -> np.ndarray:
    mask = np.asarray(patterns.mask)
    return np.sqrt(np.sum(np.where(mask, errors, 0.0) ** 2, axis=0) / mask.sum(axis=0))


def main(argv: Sequence[str] | None = None) -> int:
    parser = by_arm.new_parser(__doc__, "load_friction")
    parser.add_argument("--friction", help="kinds of all joints beside it, as in viscous,dry")
    options = by_arm.parse(parser, argv, arms=["KUKA KR300"])
    friction = None if options.friction is None else options.friction.split(",")
    fitted = 0.4 if options.quick else 1.0

    def rows_of(name: str, arm: Arm) -> list[list[str]]:
        return lines_of(name, arm, friction)

    return command.run(
        parser,
        lambda: by_arm.store_table(
            options,
            "load_friction",
            by_arm.print_table(options, rows_of, ["arm", "motion"], fitted=fitted),
        ),
        seconds=60.0 * len(options.arms),
    )


if __name__ == "__main__":
    raise SystemExit(main())
