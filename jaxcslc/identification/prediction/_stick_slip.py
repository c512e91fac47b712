from typing import TypeAlias

import equinox as eqx
import jax
import jax.numpy as jnp
from jaxtyping import Array, Bool, Float


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
"""How far joints have moved, velocities, time left, directions from rest, friction."""


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
        """Where joints at rest go: 1 or -1, or 0 for those that stick.

        Friction holds a joint while it need not exceed break-away. What it needs to be follows from
        the accelerations of all joints, which follow from who sticks: a linear complementarity
        problem with bounds, whose solution is unique as the mass matrix is positive definite. By
        principal pivoting (Júdice and Pires, 'A block principal pivoting algorithm for large-scale
        strictly monotone linear complementarity problems', Computers & Operations Research 21,
        1994): joints against whose state the accelerations speak change it, all at once; if that
        does not end, the first one alone, which does end (Murty 1974).

        **Arguments**

        - `mass`: (starts, n, n) mass matrices.
        - `drive`: (starts, n) torque less what motion and gravity need and less friction of joints
          that do not rest [N m or N].
        - `resting`: (starts, n) joints of velocity 0 that can stick.

        **Returns** (starts, n), 0 for joints that do not rest.
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
    """Of joints under net torques while some stick, whose acceleration is 0 [rad/s² or m/s²].

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
    """Motion through a step in which joints come to rest, stick, and move on.

    Between such moments accelerations are constant. Where a joint stops, all joints at rest stick
    or leave by a new balance.

    **Arguments**

    - `mass`, `drive`: (starts, n, n) and (starts, n), for the whole step: mass matrices, and torque
      less what motion and gravity need [N m or N].
    - `resisting`: (starts, n) friction of joints that go on as they do [N m or N].
    - `friction`: of joints that stop; `direction`: (starts, n) of joints that leave rest, 0 for
      those that stick.
    - `qd`: (starts, n) velocities at the beginning [rad/s or m/s]; `duration`: of the step [s].

    **Returns** by how much joints move, and velocities at the end.
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
