"""Is dry friction that grows with the load worth a term, joint by joint, on real arms?

The torque of a joint's gears presses their teeth, so dry friction may have a part
kl sgn(qd) |rigid torque|, with kl of a few percent. It is linear in kl for a fixed rigid torque:
that of the latest coefficients, until nothing changes. Both models have viscous and dry friction
and are fitted to motion through a 20 Hz Butterworth filter. Errors are root mean squares over
judged samples with the term over those without it [%]: on eighths of the fitted motion, each
predicted by a fit to the others, and on the motion that is judged.

A form that differs between driving and braking is no term: its difference is the rigid torque
itself, of which the motion determines no multiple. It is a torque constant.
"""

import argparse
from collections.abc import Sequence
from pathlib import Path
from typing import NamedTuple

import jax
import numpy as np
from jaxtyping import Bool, Float

import jaxcslc as jc
from jaxcslc.identification.report import text_table
from jaxcslc.identification.solver import Equations, Unknowns, regressor_of
from scripts.studies import command
from scripts.studies.real_robots.arms import DATA, READERS, Arm, read


jax.config.update("jax_enable_x64", True)

SETTINGS = jc.Settings(
    jc.Preparation(jc.Butterworth(20.0), smooth_torque=True, threshold_fraction=0.01),
    jc.LeastSquares(errors="independent"),
)
FOLDS = 8
_STEPS, _SAME = 20, 1e-6


class Motion(NamedTuple):
    """A recording's patterns and regressor (samples, n, p)."""

    patterns: jc.Patterns
    regressor: Float[np.ndarray, "samples joints coefficients"]

    @classmethod
    def of(cls, network: jc.CSLC, recording: jc.Recording) -> "Motion":
        patterns = SETTINGS.patterns(recording)
        return cls(patterns, np.asarray(regressor_of(network, patterns)))

    def with_load(self, network: jc.CSLC, k: Float[np.ndarray, " coefficients"]) -> np.ndarray:
        """The regressor with a column more for each joint: the sign times the load."""
        rigid = np.zeros(network.size)
        rigid[network.layout.inertial] = k[network.layout.inertial]
        load = np.sign(np.asarray(self.patterns.qd)) * np.abs(self.regressor @ rigid)
        return np.concatenate([self.regressor, load[:, :, None] * np.eye(load.shape[1])], axis=2)

    def errors(self, network: jc.CSLC, k: Float[np.ndarray, " unknowns"]) -> np.ndarray:
        """What coefficients leave of torques, (samples, n); those of loads come last, if any."""
        loaded = len(k) > network.size
        regressor = self.with_load(network, k[: network.size]) if loaded else self.regressor
        return np.asarray(self.patterns.torque) - regressor @ k


def fit(
    network: jc.CSLC, motion: Motion, used: Bool[np.ndarray, " samples"], *, load: bool
) -> Float[np.ndarray, " unknowns"]:
    """Coefficients of some samples, those of loads behind those of the network."""
    n, p = network.joint_count, network.size
    names = (*network.names, *(f"kl{joint + 1}" for joint in range(n)))
    supports = tuple((*support, p + joint) for joint, support in enumerate(network.support))
    plain, richer = Unknowns.of(network), Unknowns(names, supports)
    patterns = motion.patterns
    mask = np.asarray(patterns.mask) & used[:, None]

    def solved(unknowns: Unknowns, regressor: np.ndarray) -> np.ndarray:
        torque, time = np.asarray(patterns.torque), np.asarray(patterns.time)
        equations = Equations.of(unknowns, regressor, torque, mask, time=time, cutoff=None)
        return SETTINGS.solver.coefficients(equations)

    k = solved(plain, motion.regressor)
    for _ in range(_STEPS if load else 0):
        before, k = k, solved(richer, motion.with_load(network, k[:p]))
        if len(before) == len(k) and np.max(np.abs(k - before)) < _SAME * np.max(np.abs(k)):
            break
    return k


def lines_of(name: str, arm: Arm) -> list[list[str]]:
    """Of the table: errors with the term over those without, and the coefficients."""
    kinds = [
        tuple(kind for kind in kinds if kind != "static") for kinds in arm.robot.friction_per_joint
    ]
    network = jc.derive(arm.robot, lengths="numeric").with_joint_friction(kinds)
    training = Motion.of(network, arm.training)
    samples = training.patterns.samples
    fold, every = np.arange(samples) * FOLDS // samples, np.ones(samples, bool)
    rms: list[np.ndarray] = []
    for load in (False, True):
        parts = [
            training.errors(network, fit(network, training, fold != part, load=load))[fold == part]
            for part in range(FOLDS)
        ]
        rms.append(_rms(np.concatenate(parts), training.patterns))
    rows = [[name, "held out", *_percent(rms[1] / rms[0])]]
    free, loaded = (fit(network, training, every, load=load) for load in (False, True))
    for test, recording in arm.tests.items():
        motion = Motion.of(network, recording)
        without, with_load = (
            _rms(motion.errors(network, k), motion.patterns) for k in (free, loaded)
        )
        rows.append([name, test, *_percent(with_load / without)])
    rows.append([name, "kl", *(f"{value:.3f}" for value in loaded[network.size :])])
    return rows


def _percent(ratio: Float[np.ndarray, " joints"]) -> list[str]:
    return [f"{100 * (value - 1):+.0f}" for value in ratio]


def _rms(errors: Float[np.ndarray, "samples joints"], patterns: jc.Patterns) -> np.ndarray:
    mask = np.asarray(patterns.mask)
    return np.sqrt(np.sum(np.where(mask, errors, 0.0) ** 2, axis=0) / mask.sum(axis=0))


def study(options: argparse.Namespace) -> int:
    """Prints the table."""
    rows: list[list[str]] = []
    for name in command.progress(options.arms, desc="arms", unit="arm"):
        arm = read(name, options.data)
        if options.quick:
            part = 0.4 * float(np.ptp(arm.training.time))
            arm = arm._replace(training=arm.training.between(0.0, part))
        rows += lines_of(name, arm)
    joints = max(map(len, rows)) - 2
    rows = [row + [""] * (joints + 2 - len(row)) for row in rows]
    print(text_table(["arm", "motion", *(str(joint + 1) for joint in range(joints))], rows))
    return 0


def main(argv: Sequence[str] | None = None) -> int:
    parser = command.new_parser(__doc__, "load_friction")
    parser.add_argument("--arms", nargs="+", default=list(READERS), help=", ".join(READERS))
    parser.add_argument("--data", type=Path, default=DATA, help="folder of the recordings")
    options = command.parse(parser, argv, arms=["KUKA KR300"])
    command.require_some_of(parser, "arm", options.arms, tuple(READERS))
    return command.run(parser, lambda: study(options), seconds=60.0 * len(options.arms))


if __name__ == "__main__":
    raise SystemExit(main())
