"""Simulation of identified arms: without feedback, under a controller, or with a correction.

Joints with dry friction stick; directions of joints at rest solve a linear complementarity problem
(Júdice and Pires 1994).
"""

import abc
from collections.abc import Callable
from typing import Any, TypeAlias

import equinox as eqx
import jax
import jax.numpy as jnp
import numpy as np
from jaxtyping import Array, Bool, Float

from ..friction import split_friction, state_after
from ..least_squares import Settings
from ..network import CSLC, JointTerm
from ..recordings import Derivatives, Recording, uniform_interval


# Stretches of a step: each but the last ends where a joint comes to rest. Later stops within the
# step count as at its end.
_STRETCHES = 3
# Break-away, up and down together, below which a joint never sticks [N m or N]; viscous friction at
# the speed that break-away is read at is less.
_LEAST = 1e-7
# By which friction at rest exceeds break-away by rounding, in units of the rounding of torques.
_ROUNDINGS = 64.0
# Pivots at most, for each joint. It takes two or three in all, unless rounding does not let it end.
_PIVOTS = 32

_Stretch: TypeAlias = tuple[Array, Array, Array, Array, Array]
"""State within a step: travelled way, velocity, time left, direction from rest, friction."""


class Friction(eqx.Module):
    """Dry friction of joints, which jumps where their velocity changes its sign.

    **Attributes**

    - `forwards`, `backwards`: (starts, n) torque of a joint that begins to move in the positive and
      in the negative direction [N m or N].
    """

    forwards: Float[Array, "starts joints"]
    backwards: Float[Array, "starts joints"]

    @property
    def holds(self) -> Bool[Array, "starts joints"]:
        """Joints that can stick."""
        return self.forwards - self.backwards > _LEAST

    def leaving(self, direction: Float[Array, "starts joints"]) -> Float[Array, "starts joints"]:
        """Torque of joints that leave rest in a direction [N m or N]; 0 of those that do not."""
        return jnp.where(
            direction > 0.0, self.forwards, jnp.where(direction < 0.0, self.backwards, 0.0)
        )

    def directions(
        self,
        mass: Float[Array, "starts joints joints"],
        drive: Float[Array, "starts joints"],
        resting: Bool[Array, "starts joints"],
    ) -> Float[Array, "starts joints"]:
        """Compute the directions of joints at rest: 1 or -1, or 0 for those that stick.

        Friction holds a joint while it need not exceed break-away. What it needs to be follows from
        the accelerations of all joints, which follow from who sticks: a linear complementarity
        problem with bounds, whose solution is unique as the mass matrix is positive definite. By
        principal pivoting (Júdice and Pires, 'A block principal pivoting algorithm for large-scale
        strictly monotone linear complementarity problems', Computers & Operations Research 21,
        1994): joints against whose state the accelerations speak change it, all at once; if that
        does not end, the first one alone, which does end (Murty 1974).

        - `drive`: torque less what motion and gravity need and less friction of joints that move.
        - `resting`: joints of velocity 0 that can stick.
        """
        joints = drive.shape[1]
        # Directions are discrete, so nothing is differentiated here.
        mass, drive, up, down = jax.lax.stop_gradient((mass, drive, self.forwards, self.backwards))
        rounding = _ROUNDINGS * jnp.finfo(drive.dtype).eps
        size = jnp.abs(drive) + jnp.abs(up) + jnp.abs(down)

        def changed(carry: tuple[Array, Array, Array]) -> tuple[Array, Array, Array]:
            direction, _, count = carry
            sticks = resting & (direction == 0.0)
            net = drive - self.leaving(direction)
            qdd = acceleration(mass, net, sticks)
            products = mass * qdd[:, None]
            needed = drive - jnp.sum(products, axis=2)
            slack = rounding * (size + jnp.sum(jnp.abs(products), axis=2))
            moves = jnp.where(needed > up + slack, 1.0, jnp.where(needed < down - slack, -1.0, 0.0))
            wrong = (sticks & (moves != 0.0)) | (direction * qdd < 0.0)
            first = wrong & (jnp.cumsum(wrong, axis=1) == 1)
            change = jnp.where(count < joints, wrong, first)
            new = jnp.where(sticks, moves, 0.0)
            return jnp.where(change, new, direction), jnp.any(wrong), count + 1

        def goes_on(carry: tuple[Array, Array, Array]) -> Array:
            return carry[1] & (carry[2] < _PIVOTS * joints)

        start = jnp.zeros_like(drive), jnp.any(resting), jnp.array(0)
        return jax.lax.while_loop(goes_on, changed, start)[0]


def acceleration(
    mass: Float[Array, "starts joints joints"],
    net: Float[Array, "starts joints"],
    sticks: Bool[Array, "starts joints"],
) -> Float[Array, "starts joints"]:
    """Compute accelerations under net torques; 0 for joints that stick [rad/s² or m/s²].

    By elimination without exchanges of rows, which positive definite matrices do not need. Over all
    starts at once, that is a third of the time of a factorisation of one matrix after another.
    """
    free = ~sticks
    # Inertia of joints that stick stays on the diagonal: that of no body gives no number.
    together = (free[:, :, None] & free[:, None, :]) | jnp.eye(net.shape[1], dtype=bool)[None]
    matrix = jnp.where(together, mass, 0.0)
    rows = jnp.concatenate([matrix, jnp.where(free, net, 0.0)[..., None]], axis=2)
    rows = jnp.moveaxis(rows, 0, 2)
    for pivot in range(net.shape[1]):
        row = rows[pivot] / rows[pivot, pivot][None]
        others = rows[:, pivot].at[pivot].set(0.0)
        rows = (rows - others[:, None] * row[None]).at[pivot].set(row)
    return rows[:, -1].T


def through_stops(
    mass: Float[Array, "starts joints joints"],
    drive: Float[Array, "starts joints"],
    resisting: Float[Array, "starts joints"],
    friction: Friction,
    direction: Float[Array, "starts joints"],
    qd: Float[Array, "starts joints"],
    duration: float,
) -> tuple[Float[Array, "starts joints"], Float[Array, "starts joints"]]:
    """Return how far joints move in a step in which they come to rest, stick and move on, and their
    velocities at its end.

    Between such moments accelerations are constant. Where a joint stops, all joints at rest stick
    or leave by a new balance.

    - `drive`: torque less what motion and gravity need; `resisting`: friction of joints that go on.
    - `friction`: of joints that stop; `direction`: of those that leave rest, 0 for others.
    """
    holds = friction.holds

    def stretch(count: Array, carry: _Stretch) -> _Stretch:
        moved, v, left, direction, resisting = carry
        sticks = holds & (v == 0.0) & (direction == 0.0)
        end = v + left * acceleration(mass, drive - resisting, sticks)
        # One that would leave rest against its direction does so by rounding, or by what changes
        # within the step.
        end = jnp.where(holds & (v == 0.0) & (direction * end < 0.0), 0.0, end)
        stops = holds & (v * end < 0.0)
        part = jnp.where(stops, v / jnp.where(stops, v - end, 1.0), 1.0)
        least = jnp.where(count < _STRETCHES - 1, jnp.min(part, axis=1, keepdims=True), 1.0)
        new = jnp.where(stops & (part <= least), 0.0, v + least * (end - v))
        moved = moved + 0.5 * least * left * (v + new)
        left = left * (1.0 - least)
        resting = holds & (new == 0.0) & (left > 0.0)
        leaving = friction.directions(mass, jnp.where(resting, drive, drive - resisting), resting)
        direction = jnp.where(resting, leaving, direction)
        resisting = jnp.where(resting, friction.leaving(leaving), resisting)
        return moved, new, left, direction, resisting

    def if_left(count: Array, carry: _Stretch) -> _Stretch:
        return jax.lax.cond(jnp.any(carry[2] > 0.0), stretch, lambda _, same: same, count, carry)

    left = jnp.full((len(qd), 1), duration, qd.dtype)
    start = jnp.zeros_like(qd), qd, left, direction, resisting
    moved, end, *_ = jax.lax.fori_loop(0, _STRETCHES, if_left, start)
    return moved, end


# Longest step of integration [s].
_LONGEST_STEP = 2e-3
# Speed at which friction of either direction is read off [rad/s or m/s].
_SLOWEST = 1e-9


State: TypeAlias = tuple[Array, Array, Array]
"""Positions, velocities and states of contacts, (starts, n) each."""
Advance: TypeAlias = Callable[[State, Array], State]
"""The motion of an interval: from its first state, by the torque that is held, to its last."""


@eqx.filter_jit
def simulate(
    network: CSLC,
    k: Float[Array | np.ndarray, " coefficients"],
    q: Float[Array | np.ndarray, "starts joints"],
    qd: Float[Array | np.ndarray, "starts joints"],
    torque: Float[Array | np.ndarray, "intervals starts joints"],
    interval: float,
    *,
    presliding_distance: Float[Array | np.ndarray, " joints"] | None = None,
    contact: Float[Array | np.ndarray, "starts joints"] | None = None,
) -> Float[Array, "instants starts joints"]:
    """Motion under torques that are held for an interval each, without feedback.

    Midpoint rule, in stretches where a joint comes to rest within a step. A joint at rest sticks
    while friction need not exceed break-away, as the accelerations of all joints make it: one that
    moves can drag others along, and some stick because others do.
    A joint whose dry friction yields before it slides never sticks: its contact holds it.

    **Arguments**

    - `network`: n joints, p coefficients; `k`: (p,).
    - `q`, `qd`: positions and velocities to start from, (starts, n) [rad, rad/s or m, m/s].
    - `torque`: (intervals, starts, n) [N m or N].
    - `interval`: its length [s].
    - `presliding_distance`: (n,) [rad or m], 0 where dry friction follows the sign of velocity;
      None if it does everywhere.
    - `contact`: (starts, n) states of contacts to start from (`contact_states`); zeros if None.

    **Returns** positions at the beginning of each interval and at the end, (intervals + 1, starts,
    n). They are not finite where the model's mass matrix is that of no body.

    >>> import numpy as np, jaxcslc as jc
    >>> from jaxcslc.instruments import simulate
    >>> network = jc.derive(jc.examples.turntable("dry"))
    >>> start, push = np.zeros((2, 1)), np.full((100, 2, 1), 1.5)
    >>> push[:, 1] = 0.4  # less than dry friction
    >>> path = simulate(network, np.array([2.0, 0.5]), start, start, push, 0.01)
    >>> np.round(path[-1, :, 0], 4).tolist()  # (1.5 - 0.5) / 2.0 / 2
    [0.25, 0.0]
    """
    advance = held_step(network, jnp.asarray(k), interval, presliding_distance)

    def through(state: State, force: Array) -> tuple[State, Array]:
        after = advance(state, force)
        return after, after[0]

    start = jnp.asarray(q), jnp.asarray(qd), jnp.asarray(0 * q if contact is None else contact)
    _, path = jax.lax.scan(through, start, jnp.asarray(torque))
    return jnp.concatenate([start[0][None], path])


def held_step(
    network: CSLC,
    k: Array,
    interval: float,
    presliding_distance: Float[Array | np.ndarray, " joints"] | None = None,
) -> Advance:
    """The motion of one interval of `simulate`: from the state at its beginning and the torque that
    is held, (starts, n) each, to the state at its end.

    States of contacts change only where `presliding_distance` says that friction has them. Along
    each half of a step they follow the path exactly. A contact is a spring of friction / distance,
    as stiff as 1e5 N m/rad on real arms, which the explicit rule would let vibrate ever more: so
    friction at the middle of a step is that of the implicit rule, to first order in the step's
    acceleration.
    """
    if network.load_terms:
        raise ValueError("simulation: friction of kind 'load' is not supported; remove the term")
    steps = max(1, int(np.ceil(interval / _LONGEST_STEP - 1e-9)))
    h = interval / steps
    others, dry, length = (
        (k, None, None)
        if presliding_distance is None
        else split_friction(network, k, presliding_distance)
    )

    def contact_after(w: Array, change: Array) -> Array:
        return w if length is None else state_after(w, change, length[None])

    def contact_torque(w: Array) -> Array | float:
        return 0.0 if dry is None else dry[None] * w

    def contact_stiffness(w: Array, sign: Array) -> Array | float:
        if dry is None or length is None:
            return 0.0
        return ((dry / length)[None] * (1.0 - sign * w))[:, :, None] * jnp.eye(w.shape[1])[None]

    def step(state: State, force: Array) -> State:
        q, qd, w = state
        friction = Friction(
            _joint_torque(network, others, q, jnp.full_like(qd, _SLOWEST)),
            _joint_torque(network, others, q, jnp.full_like(qd, -_SLOWEST)),
        )
        resting = friction.holds & (qd == 0.0)
        half_way = contact_after(w, 0.5 * h * qd)

        def drive_at(q: Array, qd: Array) -> Array:
            """Torque less all but inertia and friction of joints."""
            return force - _other_torque(network, others, q, qd) - contact_torque(half_way)

        def mass_at(q: Array, direction: Array) -> Array:
            stiffness = contact_stiffness(half_way, direction)
            return network.mass_matrix(k, q) + 0.25 * h**2 * stiffness

        resisting = jnp.where(resting, 0.0, _joint_torque(network, others, q, qd))
        drive = drive_at(q, qd)
        sign = jnp.where(qd == 0.0, jnp.sign(drive - resisting), jnp.sign(qd))
        mass = mass_at(q, sign)
        leaving = friction.directions(mass, drive - resisting, resting)
        sign = jnp.where(resting, leaving, sign)
        resisting = resisting + friction.leaving(leaving)
        first = acceleration(mass, drive - resisting, resting & (leaving == 0.0))
        # A contact is stiffer on the way back: by the stiffness of the way there, a joint that
        # turns would turn with more energy than it came with.
        back = sign * (qd + h * first) < 0.0
        middle = q + 0.5 * h * qd, qd + 0.5 * h * first
        mass, drive = mass_at(middle[0], jnp.where(back, -sign, sign)), drive_at(*middle)
        slides = jnp.where(
            friction.holds, sign * jnp.maximum(sign * middle[1], _SLOWEST), middle[1]
        )
        resisting = _joint_torque(network, others, middle[0], slides)
        moved, after = through_stops(mass, drive, resisting, friction, leaving, qd, h)
        return q + moved, after, contact_after(half_way, 0.5 * h * after)

    def advance(state: State, force: Array) -> State:
        return jax.lax.fori_loop(0, steps, lambda _, carry: step(carry, force), state)

    return advance


def _joint_torque(network: CSLC, k: Array, q: Array, qd: Array) -> Array:
    """Compute the torque of friction laws and springs of single joints."""
    return _sum(network, k, (q, qd, jnp.zeros_like(q)), of_joints=True)


def _other_torque(network: CSLC, k: Array, q: Array, qd: Array) -> Array:
    """Compute the torque of all other terms, without acceleration."""
    return _sum(network, k, (q, qd, jnp.zeros_like(q)), of_joints=False)


def _sum(network: CSLC, k: Array, motion: tuple[Array, ...], *, of_joints: bool) -> Array:
    total = jnp.zeros_like(motion[0])
    for term in network.terms:
        if isinstance(term, JointTerm) == of_joints:
            total = total + term.torque(k[network.layout.term_slice(term)], *motion)
    return total


# Simulated motion further off than the joint's span, and than this, is lost [rad or m].
_NEAR = 0.1


class AbstractSimulatedMotion(eqx.Module):
    """Simulator of the arm of a recording, for motion that is free of the encoders' noise.

    To add one, subclass this and implement `begin` and `after`.
    """

    def simulate(
        self,
        network: CSLC,
        k: Float[np.ndarray, " coefficients"],
        recording: Recording,
        settings: Settings,
    ) -> Derivatives:
        """Positions, velocities and accelerations at the samples of a recording.

        Accelerations are the means over the two intervals that meet at a sample, as torques
        aligned by `"mean"` are.

        **Arguments**

        - `network`: n joints, p coefficients; `k`: (p,), those of bodies that can exist.
        - `recording`: sampled uniformly.
        - `settings`: by which torques are aligned.

        **Returns** `q`, `qd`, `qdd`, (samples, n) each.

        **Raises** `ValueError`: a recording that cannot be simulated so.
        """
        interval = uniform_interval(recording.time)
        start, memory, rows = self.begin(recording, settings)
        path = _path(self, network, jnp.asarray(k), start, memory, rows, interval)
        q, qd, change = (np.asarray(values)[:, 0] for values in path)
        return q, qd, _at_samples(change[1:] / interval)

    @abc.abstractmethod
    def begin(
        self, recording: Recording, settings: Settings
    ) -> tuple[tuple[Array | np.ndarray, Array | np.ndarray], Any, Any]:
        """Return positions and velocities (1, n) to start from, the memory that `after` has there,
        and what it gets of each interval, a pytree of arrays.

        **Raises** `ValueError` as `simulate`.
        """

    @abc.abstractmethod
    def after(
        self, advance: Advance, state: State, memory: Any, row: Any, interval: float
    ) -> tuple[State, Array, Any]:
        """Return the state after an interval, the change of velocity by torques, and the memory.

        - `advance`: the motion of an interval under a torque; `row`: of `begin`.
        """


class ControlledMotion(AbstractSimulatedMotion):
    """The arm under its controller, which follows the reference that it followed then.

    What is recorded has no part in it: such motion is independent of all noise (Janot, Vandanjon
    and Gautier 2014). It begins at rest, at the first recorded position, as controllers do. Where
    the controller is not known, another one of about its bandwidth may stand for it, such as
    `jaxcslc.control.PID`: motion is then a little further from that of the recording.

    **Attributes**

    - `controller`: with `begin(q)` and `step(state, reference, q, interval)` as those of
      `jaxcslc.control` have them; it gets positions (1, n) and returns the torque that is held
      until the next sample.
    - `reference`: of the controller, a pytree of arrays (samples, n) such as a
      `jaxcslc.control.Reference`; the controller gets a row of each at a time, (1, n).

    >>> import numpy as np, jaxcslc as jc
    >>> from jaxcslc.control import PID, Reference
    >>> network = jc.derive(jc.examples.turntable("viscous"))
    >>> t = np.arange(500)[:, None] * 0.002
    >>> reference = Reference(1.0 - np.cos(t), np.sin(t), np.cos(t))
    >>> pid = PID(1, position_gain=2000.0, velocity_gain=100.0)
    >>> recording = jc.Recording(t[:, 0], reference.q, reference.q)
    >>> motion = jc.instruments.ControlledMotion(pid, reference)
    >>> q, qd, qdd = motion.simulate(network, np.array([0.5, 0.1]), recording, jc.Settings())
    >>> bool(np.max(np.abs(q - reference.q)) < 1e-3)
    True
    """

    controller: Any
    reference: Any

    def begin(
        self, recording: Recording, settings: Settings
    ) -> tuple[tuple[np.ndarray, np.ndarray], Any, Any]:
        """Return rest at the first position, the controller's memory, and rows of the reference."""
        del settings
        for values in jax.tree.leaves(self.reference):
            if np.shape(values)[:1] != (recording.samples,):
                raise ValueError(
                    f"the reference has an array of shape {np.shape(values)}; expected a first"
                    f" axis of {recording.samples} samples, those of the recording"
                )
        first = recording.position[:1]
        rows = jax.tree.map(lambda values: values[:-1], self.reference)
        return (first, np.zeros_like(first)), self.controller.begin(jnp.asarray(first)), rows

    def after(
        self, advance: Advance, state: State, memory: Any, row: Any, interval: float
    ) -> tuple[State, Array, Any]:
        """Return the state after an interval, its change of velocity, and the controller's
        memory."""
        desired = jax.tree.map(lambda values: jnp.broadcast_to(values, state[0].shape), row)
        torque, memory = self.controller.step(memory, desired, state[0], interval)
        end = advance(state, torque)
        return end, end[1] - state[1], memory


class CorrectedMotion(AbstractSimulatedMotion):
    """The arm under the recorded torques, and a correction towards the recorded positions.

    For recordings of which neither controller nor reference is known: an observer of positions
    and velocities without a lag where the model is right. Without the correction the arm would
    drift away; a slow one lets little noise of positions pass, and no derivative of them is taken.
    Torque noise passes as it is: motion is nearly free of the encoders' noise, and not of the
    drives'. Such instruments are right where torques are demands, or precise.

    **Attributes**

    - `bandwidth`: of the correction, critically damped [Hz]: errors of the model below it are
      corrected, noise of positions above it stays out.

    **Raises** `ValueError`: a bandwidth that is not a positive number.

    >>> import numpy as np, jaxcslc as jc
    >>> network = jc.derive(jc.examples.turntable("viscous"))
    >>> recording = jc.examples.swing_recording(network, [0.5, 0.2], time_step=0.002)
    >>> motion, wrong = jc.instruments.CorrectedMotion(), np.array([0.52, 0.2])
    >>> q, qd, qdd = motion.simulate(network, wrong, recording, jc.Settings())
    >>> bool(np.max(np.abs(q - recording.position)) < 1e-3)
    True
    """

    bandwidth: float = 2.0

    def __check_init__(self) -> None:
        if not 0.0 < self.bandwidth < np.inf:
            raise ValueError(f"bandwidth is {self.bandwidth} Hz; expected a positive number")

    def begin(
        self, recording: Recording, settings: Settings
    ) -> tuple[tuple[np.ndarray, np.ndarray], None, Any]:
        """Return the first smoothed state, and torques and readings of each interval."""
        q, qd, _ = settings.preparation.derivatives(recording)
        middle = recording.time[:-1, None] + 0.5 * uniform_interval(recording.time)
        held = settings.preparation.torque_alignment != "sample"
        torque = applied_torque(recording, settings, middle, held=held)
        return (q[:1], qd[:1]), None, (torque, recording.position[1:, None])

    def after(
        self, advance: Advance, state: State, memory: None, row: Any, interval: float
    ) -> tuple[State, Array, None]:
        """Return the corrected state after an interval, and the change of velocity by torques.

        Gains of a critically damped observer: both its poles are at `kept`, the part of an error
        that a sample leaves.
        """
        kept = float(np.exp(-2.0 * np.pi * self.bandwidth * interval))
        force, reading = row
        q, qd, contact = advance(state, force)
        error = reading - q
        corrected = q + (1.0 - kept**2) * error, qd + (1.0 - kept) ** 2 / interval * error
        return (*corrected, contact), qd - state[1], memory


@eqx.filter_jit
def _path(
    motion: AbstractSimulatedMotion,
    network: CSLC,
    k: Array,
    start: tuple[Array | np.ndarray, Array | np.ndarray],
    memory: Any,
    rows: Any,
    interval: float,
) -> tuple[Array, Array, Array]:
    """Positions and velocities at all samples, and changes of velocity by torques in the interval
    before each, (samples, starts, n) each.

    - `start`: positions and velocities, (starts, n) each; `memory`: of `motion.after` there.
    - `rows`: a pytree of arrays, with what `motion.after` gets of each interval.
    """
    advance = held_step(network, k, interval)

    def through(carry: tuple[State, Any], row: Any) -> tuple[tuple[State, Any], tuple[Array, ...]]:
        state, change, memory = motion.after(advance, *carry, row, interval)
        return (state, memory), (*state[:2], change)

    q, qd = (jnp.asarray(values) for values in start)
    first = q, qd, jnp.zeros_like(qd)
    carry = first, jax.tree.map(jnp.asarray, memory)
    _, path = jax.lax.scan(through, carry, jax.tree.map(jnp.asarray, rows))
    q, qd, change = (
        jnp.concatenate([initial[None], then]) for initial, then in zip(first, path, strict=True)
    )
    return q, qd, change


def _at_samples(
    acceleration: Float[np.ndarray, "intervals joints"],
) -> Float[np.ndarray, "samples joints"]:
    """Means of the intervals that meet at each sample; the first and the last have one."""
    ends = acceleration[:1], acceleration[-1:]
    return np.concatenate([ends[0], 0.5 * (acceleration[1:] + acceleration[:-1]), ends[1]])


def applied_torque(
    recording: Recording,
    settings: Settings,
    instants: Float[np.ndarray, "intervals starts"],
    *,
    held: bool,
) -> Float[np.ndarray, "intervals starts joints"]:
    """The torque at instants [s], without the lag of its measurement: held from sample to sample,
    or interpolated."""
    time = np.asarray(recording.time)
    late = instants + settings.preparation.torque_lag
    torque = np.asarray(recording.torque)
    if not held:
        return interpolated(time, torque, late)
    row = np.clip(np.searchsorted(time, late, side="right") - 1, 0, len(time) - 1)
    return torque[row]


def interpolated(
    time: Float[np.ndarray, " samples"],
    values: Float[Array | np.ndarray, "samples joints"],
    instants: Float[np.ndarray, "instants starts"],
) -> Float[np.ndarray, "instants starts joints"]:
    columns = np.asarray(values).T
    return np.stack([np.interp(instants, time, column) for column in columns], axis=-1)


def simulated_derivatives(
    motion: AbstractSimulatedMotion,
    network: CSLC,
    k: Float[np.ndarray, " coefficients"],
    recording: Recording,
    settings: Settings,
) -> Derivatives:
    """Return simulated motion that follows that of a recording.

    **Raises** `RuntimeError`: motion that has left the recorded one behind.
    """
    q, qd, qdd = motion.simulate(network, k, recording, settings)
    span = np.ptp(recording.position, axis=0)
    off = np.abs(q - recording.position)
    wrong = ~(off <= np.maximum(span, _NEAR))
    if wrong.any():
        sample, joint = np.argwhere(wrong)[0]
        raise RuntimeError(
            f"the simulated arm does not follow the recording: joint {joint + 1} is"
            f" {off[sample, joint]:.3g} off at {recording.time[sample]:.4g} s, more than"
            " the joint's span; expected the recording's controller and reference, a correction of"
            " more bandwidth, or a better start"
        )
    return q, qd, qdd
