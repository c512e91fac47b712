import numpy as np
from jaxtyping import Float

from ..machine import MachineError
from ._kinematics import Hand


_ITERATIONS = 100
_TOLERANCE = 1e-12  # [m and rad]: a few roundings of an arm of metres
_ACCEPTED = 1e-9
_LARGEST_STEP = 0.3  # [rad or m]


def reach(
    hand: Hand,
    place: Float[np.ndarray, "3"],
    rotation: Float[np.ndarray, "3 3"] | None,
    near: Float[np.ndarray, " joints"],
) -> Float[np.ndarray, " joints"]:
    """Joint positions that bring the hand to a place, by Newton's method from near there.

    Damped in proportion to what is missing (Sugihara 2011): far off it is gradient descent, which
    passes singular poses, and close by it converges quadratically. Of several solutions, with
    joints to spare, it finds one close to where it begins.

    **Arguments**

    - `hand`: which point of the last link.
    - `place`: in frame 0 [m].
    - `rotation`: of the last link's frame in frame 0; any, if None.
    - `near`: where to begin [rad or m].

    **Raises**

    - `MachineError`: it cannot be reached from there.
    """
    q = near
    for _ in range(_ITERATIONS):
        missing, jacobian = _missing(hand, place, rotation, q)
        size = float(np.abs(missing).max())
        if size < _TOLERANCE:
            return q
        damping = min(size * size, 1e-2) * 1e-2 * np.eye(len(missing))
        step = jacobian.T @ np.linalg.solve(
            jacobian @ jacobian.T + damping + 1e-15 * np.eye(len(missing)), missing
        )
        q = q + step * min(1.0, _LARGEST_STEP / max(float(np.abs(step).max()), 1e-300))
    missing, _ = _missing(hand, place, rotation, q)
    if np.abs(missing).max() < _ACCEPTED:
        return q
    where = ", ".join(f"{value:.4g}" for value in place)
    turned = "" if rotation is None else f" and {np.linalg.norm(missing[3:]):.3g} rad"
    raise MachineError(
        f"the hand cannot be brought to ({where}) m as asked: it stays"
        f" {np.linalg.norm(missing[:3]):.3g} m{turned} away"
    )


def _missing(
    hand: Hand,
    place: Float[np.ndarray, "3"],
    rotation: Float[np.ndarray, "3 3"] | None,
    q: Float[np.ndarray, " joints"],
) -> tuple[np.ndarray, np.ndarray]:
    """By how much the hand is off [m, rad], and its Jacobian."""
    found, jacobian = hand.locate(q)
    if rotation is None:
        return place - found, np.asarray(jacobian)
    turned, axes = hand.turn(q)
    # Half the antisymmetric part of what is left to turn: sin(angle) times its axis.
    left = rotation @ turned.T
    angle = 0.5 * np.array(
        [left[2, 1] - left[1, 2], left[0, 2] - left[2, 0], left[1, 0] - left[0, 1]]
    )
    return np.concatenate([place - found, angle]), np.concatenate([jacobian, axes])
