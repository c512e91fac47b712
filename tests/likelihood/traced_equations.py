"""Equations of motion in JAX, whose derivatives JAX takes: an oracle of `MotionEquations`."""

import equinox as eqx
import jax
import jax.numpy as jnp
import numpy as np
from jaxtyping import Array, Float

from jaxcslc.likelihood import JointColumns, Linearisation
from jaxcslc.network import CSLC, JAX_FUNCTIONS, JointLaw, JointTerm


Values = Array | np.ndarray
Intervals = Float[Values, " intervals"]
Coefficients = Float[Values, " coefficients"]
Slopes = Float[Values, " joints"]
Samples = Float[Values, "samples joints"]
Rows = Float[Values, "equations joints"]
# Samples of an equation.
_STENCIL = 3
# Gauss-Legendre nodes on (0, 1): exact for a triangle times a parabola.
_NODES = (np.polynomial.legendre.leggauss(2)[0] + 1) / 2
# Speed that stands in for one of the wrong sign, next to a reversal [rad/s or m/s].
_SLOWEST = 1e-9


def mean_inputs(
    law: JointLaw,
    q: Rows,
    velocity: Rows,
    change_before: Rows,
    change_after: Rows,
    share: Rows,
    turn: Rows,
    direction: Rows,
) -> tuple[Rows, ...]:
    """Return a joint law's inputs, averaged as the acceleration of a second difference is.

    The second difference of positions is the acceleration averaged with a triangle over the two
    intervals that meet at a sample. Friction in the same equation is averaged alike: without that,
    an equation next to a reversal is wrong by up to twice the dry friction. Velocity is linear in
    each interval; its sign is that of `direction` from `turn` on and the other one before, so
    that the average is smooth in all motion. Which sign holds is decided elsewhere (`Signs`).

    **Arguments**

    - `law`: array fields (n,).
    - `q`, `velocity`: at the sample, (equations, n).
    - `change_before`, `change_after`: of velocity over the interval before the sample and over
      the one after it, (equations, n) each.
    - `share`: of the interval before in both, a half at even sampling.
    - `turn`: when the joint turns, -1 at the previous sample to 1 at the next one; -1 for joints
      that move one way.
    - `direction`: 1 or -1, the sign of velocity after `turn`.

    **Returns**

    (equations, n) for each of the law's symbols.
    """
    one = jnp.ones_like(turn)
    first, second = jnp.minimum(turn, 0.0), jnp.maximum(turn, 0.0)
    start, end = jnp.stack([-one, first, second]), jnp.stack([first, second, one])
    sign = jnp.stack([-one, jnp.where(turn > 0.0, -1.0, 1.0), one]) * direction[None]
    nodes = jnp.asarray(_NODES)[:, None, None, None]
    x = start[None] + (end - start)[None] * nodes  # (nodes, parts, equations, n)
    shape = x.shape

    def spread(values: Values) -> Array:
        return jnp.broadcast_to(values, shape)

    earlier = x < 0.0
    change = jnp.where(earlier, spread(change_before), spread(change_after))
    mass = spread(end - start) * (1.0 - jnp.abs(x))
    mass = mass * jnp.where(earlier, spread(share), spread(1.0 - share))
    sign = spread(sign)
    qd = sign * jnp.maximum(sign * (spread(velocity) + x * change), _SLOWEST)
    law = jax.tree.map(lambda values: spread(jnp.asarray(values)), law)
    inputs = law.inputs(JAX_FUNCTIONS, spread(q), qd)
    return tuple(jnp.sum(mass * spread(values), axis=(0, 1)) for values in inputs)


class TracedEquations(eqx.Module):
    """Equations of motion of one network in JAX: values, whose derivatives JAX takes.

    Methods have the arguments of `MotionCode`. Functions are compiled for every number of samples.

    **Attributes**

    - `network`: n joints, p coefficients.
    """

    network: CSLC

    def torque(
        self,
        intervals: Intervals,
        k: Coefficients,
        slopes: Slopes,
        q: Samples,
        turn: Rows,
        direction: Rows,
    ) -> Float[np.ndarray, "equations joints"]:
        """Return torque, (equations, n)."""
        return np.asarray(self._torque(intervals, k, slopes, q, turn, direction))

    def linearised(
        self,
        intervals: Intervals,
        k: Coefficients,
        slopes: Slopes,
        q: Samples,
        turn: Rows,
        direction: Rows,
    ) -> Linearisation:
        """Return torque with derivatives."""
        values = self._derivatives(intervals, k, slopes, q, turn, direction)
        torque, by_q, by_k, by_slope, by_turn = map(np.asarray, values)
        count, n = torque.shape
        rows = np.arange(count)
        # Changes of every third sample: of each equation they move one position.
        by_position = np.stack(
            [by_q[(rows + i) % _STENCIL, :, rows] for i in range(_STENCIL)], axis=1
        )  # (equations, 3, changed joint, joint)
        columns = np.zeros((count, n, len(k) + n))
        columns[:, :, : len(k)] = np.moveaxis(by_k, 0, -1)
        columns[:, np.arange(n), len(k) + np.arange(n)] = by_slope
        stencil = np.moveaxis(by_position, 3, 1).reshape(count, n, _STENCIL * n)
        return Linearisation(torque, stencil, JointColumns.of(columns), by_turn)

    @eqx.filter_jit
    def smooth(
        self, k: Coefficients, q: Rows, velocity: Rows, acceleration: Rows
    ) -> Float[Array, "equations joints"]:
        """Return torque of all terms but friction, at instants, (equations, n)."""
        network, total = self.network, jnp.zeros(q.shape)
        k, q, velocity, acceleration = map(jnp.asarray, (k, q, velocity, acceleration))
        for term in network.terms:
            if not isinstance(term, JointTerm):
                total = total + term.torque(
                    k[network.layout.term_slice(term)], q, velocity, acceleration
                )
        return total

    @eqx.filter_jit
    def friction(
        self,
        intervals: Intervals,
        k: Coefficients,
        slopes: Slopes,
        q: Samples,
        turn: Rows,
        direction: Rows,
        shift: Rows | float = 0.0,
    ) -> Float[Array, "equations joints"]:
        """Return torque of friction alone, for velocities that are larger by `shift`."""
        k, slopes, q, turn, direction = map(jnp.asarray, (k, slopes, q, turn, direction))
        position, velocity, acceleration = _motion(intervals, q)
        network = self.network
        if network.static_slopes is not None:
            network = network.with_static_slopes(jnp.exp(slopes))
        h1, h2 = intervals[:-1, None], intervals[1:, None]
        share = jnp.broadcast_to(h1 / (h1 + h2), position.shape)
        motion = position, velocity + jnp.asarray(shift), acceleration * h1, acceleration * h2
        total = jnp.zeros(position.shape)
        for term in network.terms:
            if not isinstance(term, JointTerm):
                continue
            inputs = mean_inputs(term.law, *motion, share, turn, direction)
            of_term = k[network.layout.term_slice(term)].reshape(len(inputs), len(term.joints))
            joints = np.array(term.joints)
            for values, of_joints in zip(inputs, of_term, strict=True):
                total = total.at[:, joints].add(values[:, joints] * of_joints[None])
        return total

    @eqx.filter_jit
    def _torque(
        self,
        intervals: Values,
        k: Values,
        slopes: Values,
        q: Values,
        turn: Values,
        direction: Values,
    ) -> Array:
        of_friction = self.friction(intervals, k, slopes, q, turn, direction)
        return self.smooth(k, *_motion(intervals, jnp.asarray(q))) + of_friction

    @eqx.filter_jit
    def _derivatives(
        self,
        intervals: Values,
        k: Values,
        slopes: Values,
        q: Values,
        turn: Values,
        direction: Values,
    ) -> tuple[Array, ...]:
        """Return torque; its changes with every third position of one joint, (3, n, equations, n);
        what coefficients are multiplied by, (p, equations, n); changes with slopes and turns."""
        k, slopes, q, turn = map(jnp.asarray, (k, slopes, q, turn))

        def torque(k: Array, slopes: Array, q: Array, turn: Array) -> Array:
            return self._torque(intervals, k, slopes, q, turn, direction)

        def changed(index: int, change: Array) -> Array:
            point = k, slopes, q, turn
            changes = tuple(
                change if number == index else jnp.zeros_like(values)
                for number, values in enumerate(point)
            )
            return jax.jvp(torque, point, changes)[1]

        samples, n = q.shape
        third = jnp.eye(_STENCIL)[:, jnp.arange(samples) % _STENCIL]
        changes = jnp.einsum("is,jm->ijsm", third, jnp.eye(n))
        by_q = jax.vmap(jax.vmap(lambda change: changed(2, change)))(changes)
        by_k = jax.vmap(lambda unit: torque(unit, slopes, q, turn))(jnp.eye(len(k)))
        by_slope, by_turn = changed(1, jnp.ones_like(slopes)), changed(3, jnp.ones_like(turn))
        return torque(k, slopes, q, turn), by_q, by_k, by_slope, by_turn


def _motion(intervals: Values, q: Array) -> tuple[Array, Array, Array]:
    """Return position, velocity and acceleration at each sample but the ends."""
    intervals = jnp.asarray(intervals)
    h1, h2 = intervals[:-1, None], intervals[1:, None]
    mean = jnp.diff(q, axis=0) / intervals[:, None]
    velocity = (h2 * mean[:-1] + h1 * mean[1:]) / (h1 + h2)
    return q[1:-1], velocity, 2 * (mean[1:] - mean[:-1]) / (h1 + h2)
