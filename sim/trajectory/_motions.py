"""Motions of the hand: circles, and moves to a point."""

from collections.abc import Sequence

import numpy as np
from jaxtyping import Float

from sim.machine._bodies import MachineError
from sim.machine._machine import Machine
from sim.trajectory._kinematics import Hand, reach
from sim.trajectory._paths import MinimumJerk, SampledPath, minimum_jerk


# A joint faster than this is near a singular pose [rad/s or m/s].
_QUICKEST = 50.0
# The largest rate of `minimum_jerk`, in its middle.
_PEAK = 15 / 8
_FEWEST_ROWS = 8


def circle(
    machine: Machine,
    centre: Sequence[float],
    radius: float,
    *,
    near: Float[np.ndarray, " joints"],
    duration: float,
    normal: Sequence[float] = (0.0, 0.0, 1.0),
    turns: float = 1.0,
    point: tuple[float, float, float] = (0.0, 0.0, 0.0),
    keep_orientation: bool = True,
    interval: float = 0.002,
) -> SampledPath:
    """Joint motion that moves the hand around a circle, from rest to rest.

    The angle along the circle follows `minimum_jerk`. At every row the hand is on the circle to
    rounding (`reach`); between rows joints move along the quintic spline through them, whose
    derivatives are the path's velocities and accelerations.

    **Arguments**

    - `machine`: whose geometry and joint ranges count.
    - `centre`: of the circle, in frame 0 [m].
    - `radius`: [m].
    - `near`: joint positions that select the orientation of the hand, one of several solutions, and
        the start on the circle: its point nearest to the hand there [rad or m].
    - `duration`: from rest to rest [s].
    - `normal`: of the circle's plane, in frame 0. Turns are positive about it.
    - `turns`: how many times around.
    - `point`: the moving point, in the last link's frame [m].
    - `keep_orientation`: the hand keeps its orientation; needs six joints. Otherwise the
        orientation is free.
    - `interval`: between rows [s].

    **Returns** a path that begins at its `start`. Each row is the solution nearest to the previous
    one, so that a redundant arm need not end in its initial configuration.

    **Raises** `MachineError`: the circle cannot be reached, a joint leaves its range or passes a
    singular pose; with the time.

    >>> import numpy as np
    >>> import sim
    >>> near = np.array([0.0, -0.5, 2.9, 0.0, 0.8, 0.0])
    >>> path = sim.circle(sim.puma560(), (0.6, 0.15, -0.1), 0.1, near=near, duration=0.5)
    >>> point, _ = sim.Hand.of(sim.puma560().robot).locate(path.q)
    >>> bool(np.allclose(np.linalg.norm(point - [0.6, 0.15, -0.1], axis=1), 0.1))
    True
    """
    from scipy.interpolate import make_interp_spline  # loading it takes a while

    if not (radius > 0 and interval > 0 and duration >= _FEWEST_ROWS * interval):
        raise MachineError(
            f"circle of radius {radius} m in {duration} s: expected more than zero, and a duration"
            f" of {_FEWEST_ROWS} intervals of {interval} s or more"
        )
    n = machine.joint_count
    if near.shape != (n,):
        raise MachineError(f"circle: near has {near.size} joints; the machine has {n}")
    if keep_orientation and n < 6:
        raise MachineError(
            f"circle: {n} joints cannot keep the hand from turning; expected six or more, or"
            " keep_orientation=False"
        )
    hand = Hand.of(machine.robot, point)
    middle = np.array(centre, dtype=np.float64)
    towards = np.asarray(hand.locate(near)[0]) - middle
    first, second = _plane(np.array(normal, dtype=np.float64), towards)
    rows = round(duration / interval) + 1
    time = interval * np.arange(rows)
    angle = 2 * np.pi * turns * minimum_jerk(np.linspace(0.0, 1.0, rows))[:, None]
    targets = middle + radius * (np.cos(angle) * first + np.sin(angle) * second)
    rotation = np.asarray(hand.turn(near)[0]) if keep_orientation else None

    q, guess = np.empty((rows, n)), near
    for row, target in enumerate(targets):
        try:
            q[row] = reach(hand, target, rotation, guess)
        except MachineError as error:
            raise MachineError(f"circle, {time[row]:.4g} s: {error}") from None
        guess = q[row]
    _check(machine, q, time)
    still = [(order, np.zeros(n)) for order in (1, 2)]
    spline = make_interp_spline(time, q, k=5, bc_type=(still, still))
    qd, qdd = (np.asarray(spline(time, nu=order)) for order in (1, 2))
    return SampledPath(q, qd, qdd, interval)


def go_to(
    machine: Machine,
    seed: int,
    speed: float | Float[np.ndarray, " joints"],
    *,
    margin: float = 0.05,
) -> tuple[Float[np.ndarray, " joints"], MinimumJerk]:
    """A motion between two configurations drawn at random, from rest to rest.

    **Arguments**

    - `machine`: whose joint ranges the two are drawn from, uniformly; from −π to π where there is
        no range.
    - `seed`: the same seed gives the same motion.
    - `speed`: the largest speed of each joint; one of them reaches it [rad/s or m/s].
    - `margin`: part of a range that is excluded at either end.

    **Returns**

    Where it starts [rad or m], and the path.

    **Raises** `MachineError`: a speed that is not positive; a margin of half a range or more.

    >>> import numpy as np
    >>> import sim
    >>> start, path = sim.go_to(sim.puma560(), seed=1, speed=1.0)
    >>> half = path.reference(np.array([path.duration / 2]), start)
    >>> float(np.abs(half.qd).max().round(6))
    1.0
    """
    fastest = np.broadcast_to(np.asarray(speed, dtype=np.float64), (machine.joint_count,))
    if not np.all(fastest > 0):
        raise MachineError(f"speed is {speed}; expected more than zero")
    if not 0 <= margin < 0.5:
        raise MachineError(f"margin is {margin}; expected from 0 to less than 0.5")
    low, high = np.array(machine.position_range).T
    low, high = np.where(np.isfinite(low), low, -np.pi), np.where(np.isfinite(high), high, np.pi)
    share = margin + (1 - 2 * margin) * np.random.default_rng(seed).uniform(size=(2, low.size))
    start, end = low + share * (high - low)
    return start, MinimumJerk(end, float(np.max(_PEAK * np.abs(end - start) / fastest)))


def _plane(
    normal: Float[np.ndarray, "3"], towards: Float[np.ndarray, "3"]
) -> tuple[np.ndarray, np.ndarray]:
    """Two directions across a normal, the first as nearly as can be towards something."""
    length = float(np.linalg.norm(normal))
    if not length > 0:
        raise MachineError("circle: its normal is zero; expected a direction")
    normal = normal / length
    across = [vector - normal * (normal @ vector) for vector in (towards, *np.eye(3))]
    first = next(vector for vector in across if np.linalg.norm(vector) > 1e-6)
    first = first / float(np.linalg.norm(first))
    return first, np.cross(normal, first)


def _check(machine: Machine, q: Float[np.ndarray, "rows joints"], time: np.ndarray) -> None:
    low, high = np.array(machine.position_range).T
    outside = np.argwhere((q < low) | (q > high))
    if outside.size:
        row, joint = outside[0]
        raise MachineError(
            f"circle, {time[row]:.4g} s: joint {joint + 1} is at {q[row, joint]:.4g}, outside its"
            f" range from {low[joint]:.4g} to {high[joint]:.4g}"
        )
    over = np.argwhere(np.abs(np.diff(q, axis=0)) > _QUICKEST * (time[1] - time[0]))
    if over.size:
        row, joint = over[0]
        raise MachineError(
            f"circle, {time[row]:.4g} s: joint {joint + 1} turns over, faster than {_QUICKEST:g} a"
            " second; expected a circle that keeps away from such poses"
        )
