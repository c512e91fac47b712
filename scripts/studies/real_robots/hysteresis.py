"""Does torque have hysteresis, joint by joint, on real arms?

Gears that are twisted by the torque they carry may lose some of it: torque then has a part kh w,
with a state w of the kind of pre-sliding friction that is driven by the rigid torque R:
dw/dt = (dR/dt - |dR/dt| w) / width (Dahl 1968). Both models have the robot's friction without
static friction, torque offsets of all joints, and motion through a 20 Hz Butterworth filter.
Widths are parts of the range of R; each joint has the one with the smallest error in held-out
eighths of the fitted motion. Errors are root mean squares, with the state over those without [%]:
held out, and on the motion that is judged.
"""

from collections.abc import Sequence

import jax.numpy as jnp
import numpy as np
from jaxtyping import Float

import jaxcslc as jc
from jaxcslc.friction import contact_states
from scripts.studies.real_robots import by_arm
from scripts.studies.real_robots.arms import Arm
from scripts.studies.real_robots.load_friction import FOLDS, percent
from scripts.studies.real_robots.methods import evenly, with_offsets, without_static
from scripts.studies.real_robots.pre_sliding import SETTINGS


jc.enable_x64()

# Widths of the state, in parts of the range of a joint's rigid torque.
WIDTHS = (0.03, 0.1, 0.3, 1.0)


def lines_of(name: str, arm: Arm) -> list[list[str]]:
    """Return the lines of the table: errors with the state over those without, and widths."""
    network = with_offsets(without_static(arm))
    patterns = SETTINGS.patterns(evenly(arm.training))
    plain = SETTINGS.solver.fit(network, patterns)
    weight = 1.0 / np.asarray(plain.torque_error)
    k = np.asarray(network.without_friction(jnp.asarray(plain.k)))
    rigid = np.asarray(network.torque(k, patterns.q, patterns.qd, patterns.qdd))
    reach = np.ptp(rigid, axis=0)
    fold = np.arange(patterns.samples) * FOLDS // patterns.samples
    without = _held_out(_rows(network, patterns), patterns, fold, weight)
    held_out = np.array(
        [
            _held_out(_rows(network, patterns, k, width * reach), patterns, fold, weight)
            for width in WIDTHS
        ]
    )
    best = np.argmin(held_out, axis=0)
    lines = [[name, "held out", *percent(np.min(held_out, axis=0) / without)]]
    widths = np.array(WIDTHS)[best]
    plain_k, states_k = (
        _fitted(_rows(network, patterns, *driven), patterns, weight)
        for driven in ((), (k, widths * reach))
    )
    for test, recording in arm.tests.items():
        motion = SETTINGS.patterns(evenly(recording))
        torque = np.asarray(motion.torque)
        errors = [
            np.sqrt(np.mean((torque - _rows(network, motion, *driven) @ values) ** 2, axis=0))
            for driven, values in (((), plain_k), ((k, widths * reach), states_k))
        ]
        lines.append([name, test, *percent(errors[1] / errors[0])])
    return [*lines, [name, "width", *(f"{width:g}" for width in widths)]]


def _rows(
    network: jc.CSLC,
    patterns: jc.Patterns,
    k: Float[np.ndarray, " coefficients"] | None = None,
    width: Float[np.ndarray, " joints"] | None = None,
) -> Float[np.ndarray, "samples joints unknowns"]:
    """The regressor, with the state of each joint's rigid torque under `k` if there is one."""
    motion = patterns.q, patterns.qd, patterns.qdd
    rows = np.asarray(network.regressor(*motion))
    if k is None or width is None:
        return rows
    rigid = np.asarray(network.torque(k, *motion))
    state = np.asarray(contact_states(rigid, width, np.zeros(network.joint_count)))
    return np.concatenate([rows, state[:, :, None] * np.eye(network.joint_count)], axis=2)


def _fitted(
    rows: Float[np.ndarray, "samples joints unknowns"],
    patterns: jc.Patterns,
    weight: Float[np.ndarray, " joints"],
    some: slice | np.ndarray = slice(None),
) -> Float[np.ndarray, " unknowns"]:
    """Weighted least squares of some samples."""
    weighted = (rows[some] * weight[:, None]).reshape(-1, rows.shape[2])
    size = np.sqrt(np.sum(weighted**2, axis=0))
    size = np.where(size > 0.0, size, 1.0)
    torque = (np.asarray(patterns.torque)[some] * weight).ravel()
    return np.linalg.lstsq(weighted / size, torque, rcond=1e-8)[0] / size


def _held_out(
    rows: Float[np.ndarray, "samples joints unknowns"],
    patterns: jc.Patterns,
    fold: np.ndarray,
    weight: Float[np.ndarray, " joints"],
) -> Float[np.ndarray, " joints"]:
    """RMS errors of stretches under fits to all others."""
    torque = np.asarray(patterns.torque)
    errors = [
        torque[fold == one] - rows[fold == one] @ _fitted(rows, patterns, weight, fold != one)
        for one in range(FOLDS)
    ]
    return np.sqrt(np.mean(np.concatenate(errors) ** 2, axis=0))


def main(argv: Sequence[str] | None = None) -> int:
    return by_arm.print_held_out(__doc__, "hysteresis", lines_of, argv, quick=["KUKA KR300"])


if __name__ == "__main__":
    raise SystemExit(main())
