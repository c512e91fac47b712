import equinox as eqx
import jax
import jax.numpy as jnp
import numpy as np
from jaxtyping import Array, Float

from ....network import CSLC
from ....network.terms import JointTerm
from ._friction_mean import mean_inputs
from ._linearisation import ANGLE, RATE, DenseLinearisation


Samples = Float[Array | np.ndarray, "samples joints"]
Rows = Float[Array | np.ndarray, "equations joints"]


class MotionEquations(eqx.Module):
    """The equation of motion at every sample but the ends, as a function of positions alone.

    Velocity is the derivative of the parabola through three positions, acceleration its second
    difference: the average of the acceleration over the two intervals with a triangle.

    **Attributes**

    - `network`: n joints, p coefficients.
    - `intervals`: (samples - 1,) between samples [s].
    """

    network: CSLC
    intervals: Float[Array, " intervals"]

    @eqx.filter_jit
    def torque(
        self,
        k: Float[Array | np.ndarray, " coefficients"],
        slopes: Float[Array | np.ndarray, " joints"],
        q: Samples,
        turn: Rows,
        direction: Rows,
    ) -> Rows:
        """(equations, n). `slopes` are logarithms, unused without static friction."""
        k, slopes, turn, direction = map(jnp.asarray, (k, slopes, turn, direction))
        motion = self._motion(q)
        torque = self._smooth(k, *motion[:3])
        friction, _ = self._friction(k, slopes, motion, turn, direction)
        return torque + friction

    @eqx.filter_jit
    def linearised(
        self,
        k: Float[Array | np.ndarray, " coefficients"],
        slopes: Float[Array | np.ndarray, " joints"],
        q: Samples,
        turn: Rows,
        direction: Rows,
    ) -> DenseLinearisation:
        """The same with derivatives."""
        n = self.network.joint_count
        k, slopes, turn, direction = map(jnp.asarray, (k, slopes, turn, direction))
        motion = self._motion(q)
        position, velocity, acceleration, before, after = motion

        smooth, by_q, by_v, by_a = self._smooth_derivatives(k, position, velocity, acceleration)

        def friction(slopes: Array, q: Array, v: Array, b: Array, a: Array, turn: Array) -> Array:
            return self._friction(k, slopes, (q, v, v, b, a), turn, direction)[0]

        point = (position, velocity, before, after, turn)
        # Equation and joint by themselves: one product with ones has all derivatives but slopes'.
        value, pulled_back = jax.vjp(lambda *point: friction(slopes, *point), *point)
        f_q, f_v, f_b, f_a, f_turn = pulled_back(jnp.ones_like(position))
        _, by_slope = jax.jvp(
            lambda slopes: friction(slopes, *point), (slopes,), (jnp.ones_like(slopes),)
        )

        eye = jnp.eye(n)
        h1, h2 = self._two_intervals()
        # v = (h2 u1 + h1 u2) / (h1 + h2), a = 2 (u2 - u1) / (h1 + h2), u: mean velocities.
        total = h1 + h2
        weights_v = (-h2 / (h1 * total), h2 / (h1 * total) - h1 / (h2 * total), h1 / (h2 * total))
        weights_a = (2 / (h1 * total), -2 / (h1 * h2), 2 / (h2 * total))
        of_velocity = by_v + f_v[:, :, None] * eye[None]
        of_acceleration = by_a + (f_b * h1 + f_a * h2)[:, :, None] * eye[None]
        of_position = by_q + f_q[:, :, None] * eye[None]
        blocks = [
            of_velocity * wv[:, :, None] + of_acceleration * wa[:, :, None]
            for wv, wa in zip(weights_v, weights_a, strict=True)
        ]
        blocks[1] = blocks[1] + of_position
        return DenseLinearisation(
            smooth + value,
            jnp.concatenate(blocks, axis=2),
            jnp.concatenate(
                [
                    *self._columns(slopes, motion, turn, direction),
                    by_slope[:, :, None] * eye[None],
                ],
                axis=2,
            ),
            f_turn,
        )

    @eqx.filter_jit
    def smooth(
        self,
        k: Float[Array | np.ndarray, " coefficients"],
        q: Rows,
        velocity: Rows,
        acceleration: Rows,
    ) -> Rows:
        """Torque of all terms but friction, at instants of any motion, (equations, n)."""
        return self._smooth(*map(jnp.asarray, (k, q, velocity, acceleration)))

    @eqx.filter_jit
    def friction(
        self,
        k: Float[Array | np.ndarray, " coefficients"],
        slopes: Float[Array | np.ndarray, " joints"],
        q: Samples,
        turn: Rows,
        direction: Rows,
        shift: Rows,
    ) -> Rows:
        """Torque of friction as in `torque`, for velocities that are larger by `shift`."""
        k, slopes, turn, direction = map(jnp.asarray, (k, slopes, turn, direction))
        position, velocity, *others = self._motion(q)
        motion = (position, velocity + jnp.asarray(shift), *others)
        return self._friction(k, slopes, motion, turn, direction)[0]

    def _two_intervals(self) -> tuple[Array, Array]:
        return self.intervals[:-1, None], self.intervals[1:, None]

    def _motion(self, q: Samples) -> tuple[Array, Array, Array, Array, Array]:
        """Position, velocity, acceleration, changes of velocity before and after each sample."""
        q = jnp.asarray(q)
        mean = jnp.diff(q, axis=0) / self.intervals[:, None]
        h1, h2 = self._two_intervals()
        velocity = (h2 * mean[:-1] + h1 * mean[1:]) / (h1 + h2)
        acceleration = 2 * (mean[1:] - mean[:-1]) / (h1 + h2)
        return q[1:-1], velocity, acceleration, acceleration * h1, acceleration * h2

    def _smooth(self, k: Array, q: Array, qd: Array, qdd: Array) -> Array:
        """The torque of all terms but joint laws."""
        network = self.network
        total = jnp.zeros_like(q)
        for term in network.terms:
            if not isinstance(term, JointTerm):
                total = total + term.torque(k[network.layout.of(term)], q, qd, qdd)
        return total

    def _smooth_derivatives(self, k: Array, q: Array, qd: Array, qdd: Array) -> tuple[Array, ...]:
        """Torque, and (equations, n, n) each, by position, velocity and acceleration.

        The last one is the mass matrix; the others are forward differences of one compiled
        function. (Compiling the derivatives of a PUMA 560's tables took a minute.)
        """
        n, network = q.shape[1], self.network
        steps = jnp.asarray(np.repeat([ANGLE, RATE], n))
        shifts = (jnp.eye(2 * n) * steps[:, None]).reshape(2 * n, 2, 1, n)
        torque = self._smooth(k, q, qd, qdd)
        shifted = self._smooth(
            k,
            q[None] + shifts[:, 0],
            qd[None] + shifts[:, 1],
            jnp.broadcast_to(qdd, (2 * n, *q.shape)),
        )
        by_q, by_v = ((shifted - torque[None]) / steps[:, None, None]).reshape(2, n, *q.shape)
        mass = jnp.zeros((*q.shape, n))
        for term in network.terms:
            if not isinstance(term, JointTerm):
                mass = mass + term.mass_matrix(k[network.layout.of(term)], q)
        return torque, jnp.moveaxis(by_q, 0, -1), jnp.moveaxis(by_v, 0, -1), mass

    def _friction(
        self,
        k: Array,
        slopes: Array,
        motion: tuple[Array, ...],
        turn: Array,
        direction: Array,
    ) -> tuple[Array, list[tuple[JointTerm, tuple[Array, ...]]]]:
        q, velocity, _, before, after = motion
        network = self._with(slopes)
        h1, h2 = self._two_intervals()
        share = jnp.broadcast_to(h1 / (h1 + h2), q.shape)
        total, laws = jnp.zeros_like(q), []
        for old, term in zip(self.network.terms, network.terms, strict=True):
            if not (isinstance(term, JointTerm) and isinstance(old, JointTerm)):
                continue
            inputs = mean_inputs(term.law, q, velocity, before, after, share, turn, direction)
            laws.append((old, inputs))
            of_term = k[self.network.layout.of(old)].reshape(len(inputs), len(term.joints))
            for values, k_of_joints in zip(inputs, of_term, strict=True):
                row = jnp.zeros(network.joint_count).at[np.array(term.joints)].set(k_of_joints)
                total = total + values * row[None]
        return total, laws

    def _columns(
        self, slopes: Array, motion: tuple[Array, ...], turn: Array, direction: Array
    ) -> list[Array]:
        q, qd, qdd, *_ = motion
        k = jnp.zeros(self.network.size)
        laws = {
            term.kind: inputs
            for term, inputs in self._friction(k, slopes, motion, turn, direction)[1]
        }
        columns = []
        for term in self.network.terms:
            if term.kind not in laws:
                columns.append(term.regressor(q, qd, qdd))
                continue
            assert isinstance(term, JointTerm)
            eye = jnp.eye(self.network.joint_count)[:, np.array(term.joints)]
            columns += [
                values[:, np.array(term.joints)][:, None, :] * eye[None]
                for values in laws[term.kind]
            ]
        return columns

    def _with(self, slopes: Array) -> CSLC:
        if self.network.static_slopes is None:
            return self.network
        return self.network.with_static_slopes(jnp.exp(slopes))
