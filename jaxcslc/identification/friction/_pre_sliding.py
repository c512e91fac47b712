import dataclasses
from typing import Any

import equinox as eqx
import jax
import jax.numpy as jnp
import numpy as np
from jaxtyping import Array, Bool, Float

from ...derivation import Coefficient
from ...motion import Patterns
from ...network import CSLC
from ...network.terms import AbstractManipulatorTerm, JointTerm
from ...network.terms._term import Coefficients, Columns, Joints, Matrices, Regressor, Rows
from .._held_out import RelativeError
from ..solver import Identification, LeastSquares, torque_of


# Lengths that are tried, as parts of a joint's range of motion; then each is moved by a factor, and
# by its root, and so on.
_LENGTHS, _FACTOR, _HALVINGS = np.geomspace(1e-4, 0.3, 12), 1.4, 6
# Longest step of integration [s].
_LONGEST_STEP = 1e-3
# Stretches that are predicted by fits to the others.
_FOLDS = 8


@jax.jit
def pre_sliding(
    q: Float[Array | np.ndarray, "samples joints"],
    length: Float[Array | np.ndarray, " joints"],
    start: Float[Array | np.ndarray, " joints"],
) -> Float[Array, "samples joints"]:
    """How far the contact of each joint has yielded, from -1 to 1 (Dahl 1968).

    Below break-away, friction is a spring: it grows with displacement until the contact slides. The
    state w of a joint, friction as a part of dry friction, follows

        dw/dt = (q' - |q'| w) / length

    which depends on the path alone: along one that goes one way, the distance of w from the sign of
    the motion falls by exp(-|dq| / length), exactly. Between samples each joint goes one way.

    **Arguments**

    - `q`: positions along a motion, (samples, n) [rad or m].
    - `length`: (n,) displacement in which friction changes by 63 % [rad or m], above 0.
    - `start`: (n,) the state at the first sample; zeros for contacts without strain.

    **Returns** w at every sample, (samples, n); the last one continues the motion.

    >>> import numpy as np
    >>> from jaxcslc.identification import pre_sliding
    >>> there_and_back = np.array([[0.0], [0.1], [0.0]])
    >>> w = pre_sliding(there_and_back, np.array([0.1]), np.zeros(1))
    >>> np.round(np.asarray(w)[:, 0], 3).tolist()  # 1 - 1/e, and back from there
    [0.0, 0.632, -0.4]
    """
    q = jnp.asarray(q)
    change = jnp.diff(q, axis=0)

    def along(w: Array, change: Array) -> tuple[Array, Array]:
        sign = jnp.sign(change)
        w = sign + (w - sign) * jnp.exp(-jnp.abs(change) / length)
        return w, w

    first = jnp.asarray(start, q.dtype)
    return jnp.concatenate([first[None], jax.lax.scan(along, first, change)[1]])


class PreSlidingFit(eqx.Module):
    """Coefficients with dry friction that yields before it slides.

    **Attributes**

    - `network`: as it was fitted, with dry friction in proportion to sign(qd).
    - `fit`: its coefficients; those of dry friction are for motion that slides. Standard errors are
      for lengths that are known.
    - `lengths`: (n,) [rad or m]; 0 where friction follows the sign of velocity.
    - `relative`: by joint, counted from 1: held-out error with a pre-sliding state over that
      without.
    - `tried_lengths`: (n,) [rad or m] that `relative` is of; 0 where no length fitted better.

    >>> import numpy as np, jaxcslc as jc
    >>> from jaxcslc.identification import fit_pre_sliding, pre_sliding
    >>> robot = jc.Manipulator.from_modified_dh([(0, 0, 0, 0)], gravity=(0, 0, -9.81))
    >>> network = jc.derive(robot.with_friction("dry"), lengths="numeric")
    >>> t = np.linspace(0, 20, 2000)[:, None]
    >>> q, qd, qdd = 0.1 * np.sin(2 * t), 0.2 * np.cos(2 * t), -0.4 * np.sin(2 * t)
    >>> w = np.asarray(pre_sliding(q, np.array([0.02]), np.zeros(1)))
    >>> noise = 0.01 * np.random.default_rng(0).normal(size=t.shape)
    >>> pairs, torque = np.ones(t.shape, bool), 0.5 * qdd + 0.4 * w + noise
    >>> result = fit_pre_sliding(network, jc.Patterns(t[:, 0], q, qd, qdd, torque, pairs, pairs))
    >>> np.round(result.lengths, 3).tolist(), np.round(np.asarray(result.fit.k), 2).tolist()
    ([0.02], [0.5, 0.4])
    """

    network: CSLC
    fit: Identification
    lengths: Float[np.ndarray, " joints"]
    relative: dict[int, RelativeError]
    tried_lengths: Float[np.ndarray, " joints"]

    def torque(
        self,
        q: Float[Array | np.ndarray, "samples joints"],
        qd: Float[Array | np.ndarray, "samples joints"],
        qdd: Float[Array | np.ndarray, "samples joints"],
        start: Float[Array | np.ndarray, " joints"] | None = None,
    ) -> tuple[Float[Array, "samples joints"], Float[Array, " joints"]]:
        """Torque along a motion, (samples, n) [N m or N], and the state at its end, (n,).

        - `q`, `qd`, `qdd`: (samples, n).
        - `start`: (n,) the state at its first sample; zeros if None.
        """
        first = np.zeros(self.network.joint_count) if start is None else start
        network, state = _with_state(self.network, jnp.asarray(q), self.lengths, first)
        motion = (jnp.asarray(x) for x in (q, qd, qdd))
        return network.torque(jnp.asarray(self.fit.k), *motion), state[-1]

    def motion(
        self,
        q: Float[Array | np.ndarray, " joints"],
        qd: Float[Array | np.ndarray, " joints"],
        torque: Float[Array | np.ndarray, "intervals joints"],
        interval: float,
        start: Float[Array | np.ndarray, " joints"] | None = None,
    ) -> tuple[Float[Array, "instants joints"], ...]:
        """Motion under torques that are held for an interval each: positions, velocities, states.

        Runge and Kutta's method of fourth order, states of contacts among what it integrates: no
        joint sticks, its contact holds it.

        **Arguments**

        - `q`, `qd`: (n,) positions and velocities to start from [rad, rad/s or m, m/s].
        - `torque`: (intervals, n) [N m or N]; `interval`: its length [s].
        - `start`: (n,) states of contacts; zeros if None.

        **Returns** each at the beginning of every interval and at the end, (intervals + 1, n).

        **Raises** `ValueError` for a joint with dry friction without a length.
        """
        dry = _dry_term(self.network)
        if step := [j + 1 for j in dry.joints if self.lengths[j] <= 0.0]:
            raise ValueError(
                f"pre-sliding: joint {step[0]} has dry friction without a length; expected a length"
                " of every joint with dry friction"
            )
        first = np.zeros(self.network.joint_count) if start is None else start
        state = tuple(jnp.asarray(x, float) for x in (q, qd, first))
        return _integrated(self, state, jnp.asarray(torque), interval)


@eqx.filter_jit
def _integrated(
    result: PreSlidingFit, start: tuple[Array, ...], torque: Array, interval: float
) -> tuple[Array, ...]:
    """The motion of `PreSlidingFit.motion`."""
    network, dry = result.network, _dry_term(result.network)
    part = network.layout.of(dry)
    friction = jnp.zeros(network.joint_count).at[np.array(dry.joints)].set(result.fit.k[part])
    others = jnp.asarray(result.fit.k).at[part].set(0.0)
    length = jnp.where(result.lengths > 0.0, result.lengths, 1.0)
    steps = max(1, int(np.ceil(interval / _LONGEST_STEP - 1e-9)))
    h = interval / steps

    def rates(state: tuple[Array, ...], force: Array) -> tuple[Array, ...]:
        q, qd, w = state
        acceleration = network.forward_dynamics(others, q, qd, force - friction * w)
        return qd, acceleration, (qd - jnp.abs(qd) * w) / length

    def moved(state: tuple[Array, ...], rate: tuple[Array, ...], h: float) -> tuple[Array, ...]:
        return tuple(x + h * change for x, change in zip(state, rate, strict=True))

    def step(state: tuple[Array, ...], force: Array) -> tuple[Array, ...]:
        first = rates(state, force)
        second = rates(moved(state, first, h / 2), force)
        third = rates(moved(state, second, h / 2), force)
        last = rates(moved(state, third, h), force)
        mean = (
            (a + 2 * b + 2 * c + d) / 6
            for a, b, c, d in zip(first, second, third, last, strict=True)
        )
        return moved(state, tuple(mean), h)

    def through(state: tuple[Array, ...], force: Array) -> tuple[tuple[Array, ...], Any]:
        after = jax.lax.fori_loop(0, steps, lambda _, state: step(state, force), state)
        return after, after

    _, path = jax.lax.scan(through, start, torque)
    return tuple(jnp.concatenate([x[None], xs]) for x, xs in zip(start, path, strict=True))


def fit_pre_sliding(
    network: CSLC,
    patterns: Patterns,
    *,
    solver: LeastSquares | None = None,
    judged: Bool[Array | np.ndarray, "samples joints"] | None = None,
    chance: float = 0.05,
) -> PreSlidingFit:
    """Lengths of pre-sliding, joint by joint, with all coefficients.

    Dry friction counts by its state along the motion. For lengths that are known torque is linear
    in the coefficients; lengths are searched for by the sum of each joint's squared residuals: a
    grid, then smaller and smaller factors. A joint keeps its length where stretches that were left
    out of the fit are predicted better by 1 % and by more than chance explains (Student's t,
    one-sided).

    **Arguments**

    - `network`: n joints, some with friction of kind `"dry"`.
    - `patterns`: of one motion without gaps, slow pairs included: a mask of slow motion leaves out
      what says most of pre-sliding. Masked pairs count as motion.
    - `solver`: options of the fit; the defaults of `LeastSquares` if None.
    - `judged`: (samples, n) pairs that lengths are searched for and judged on; those of the fit if
      None. Slow pairs count here at no cost to coefficients that a mask protects from them.
    - `chance`: the part of such gains that is chance.

    **Returns** a `PreSlidingFit`.

    **Raises**

    - `ValueError`: no joint has dry friction, or as `LeastSquares.fit`.
    - `RuntimeError`: as `LeastSquares.fit`.
    """
    joints = _dry_term(network).joints
    solver = LeastSquares() if solver is None else solver
    q = np.asarray(patterns.q)
    reach = np.maximum(np.ptp(q, axis=0), 1e-12)
    search = dataclasses.replace(solver, errors="independent")  # standard errors choose no length
    mask, dry = (
        np.asarray(patterns.mask if judged is None else judged),
        np.isin(np.arange(network.joint_count), joints),
    )

    def squares(lengths: Float[np.ndarray, " joints"]) -> Float[np.ndarray, " joints"]:
        with_state, _ = _with_state(network, q, lengths)
        k = search.fit(with_state, patterns).k
        error = np.asarray(patterns.torque) - torque_of(with_state, patterns, k)
        return np.sum(np.where(mask, error, 0.0) ** 2, axis=0)

    lengths = np.zeros(network.joint_count)
    least = squares(lengths)

    def tried(candidate: Float[np.ndarray, " joints"]) -> None:
        nonlocal lengths, least
        values = squares(np.where(dry, candidate, 0.0))
        better = dry & (values < least)
        lengths, least = np.where(better, candidate, lengths), np.where(better, values, least)

    for part in _LENGTHS:
        tried(part * reach)
    factor = _FACTOR
    for _ in range(_HALVINGS):
        tried(lengths * factor)
        tried(lengths / factor)
        factor = np.sqrt(factor)
    relative = _held_out(network, patterns, solver, lengths, joints, mask)
    kept = [
        relative[j + 1].beyond_chance(chance) if j + 1 in relative else False
        for j in range(len(dry))
    ]
    supported = np.where(kept, lengths, 0.0)
    fit = solver.fit(_with_state(network, q, supported)[0], patterns)
    return PreSlidingFit(network, fit, supported, relative, lengths)


def _held_out(
    network: CSLC,
    patterns: Patterns,
    solver: LeastSquares,
    lengths: Float[np.ndarray, " joints"],
    joints: tuple[int, ...],
    judged: Bool[np.ndarray, "samples joints"],
) -> dict[int, RelativeError]:
    """Errors of stretches under fits to the others, with lengths over those without."""
    fold = np.arange(patterns.samples) * _FOLDS // patterns.samples
    with_state, _ = _with_state(network, np.asarray(patterns.q), lengths)
    after, before = (solver.held_out_errors(some, patterns, fold) for some in (with_state, network))
    return {
        joint + 1: RelativeError.of(
            *(
                [values[fold == number, joint : joint + 1] for number in range(_FOLDS)]
                for values in (after, before, judged)
            )
        )
        for joint in joints
        if lengths[joint] > 0.0
    }


def _dry_term(network: CSLC) -> JointTerm:
    for term in network.terms:
        if isinstance(term, JointTerm) and term.kind == "dry":
            return term
    raise ValueError(f"{network.name!r} has no friction of kind 'dry', which pre-sliding is of")


def _with_state(
    network: CSLC,
    q: Float[Array | np.ndarray, "samples joints"],
    lengths: Float[np.ndarray, " joints"],
    start: Float[Array | np.ndarray, " joints"] | None = None,
) -> tuple[CSLC, Float[Array, "samples joints"]]:
    """The network whose dry friction has its state along a motion, and the state."""
    slides = lengths <= 0.0
    first = np.zeros(len(lengths)) if start is None else start
    state = pre_sliding(q, np.where(slides, 1.0, lengths), first)
    numbers = np.asarray(state) if isinstance(q, np.ndarray) else state
    dry = _dry_term(network)
    terms = (
        YieldingFriction(
            dry=dry,
            state=numbers,
            slides=tuple(slides.tolist()),
            kind=dry.kind,
            coefficients=dry.coefficients,
        )
        if term is dry
        else term
        for term in network.terms
    )
    return CSLC(algebra=network.algebra, terms=tuple(terms)), state


class YieldingFriction(AbstractManipulatorTerm):
    """Dry friction in proportion to a state that was computed along one motion.

    **Attributes**

    - `dry`: the term that it stands for.
    - `state`: (samples, n) along the motion; `slides`: joints that follow the sign of velocity.
    """

    dry: JointTerm
    state: Float[Array | np.ndarray, "samples joints"]
    slides: tuple[bool, ...] = eqx.field(static=True)
    kind: str = eqx.field(static=True)
    coefficients: tuple[Coefficient, ...] = eqx.field(static=True)

    @property
    def parts(self) -> tuple[str, ...]:
        return self.dry.parts

    @property
    def has_host_columns(self) -> bool:
        return isinstance(self.state, np.ndarray)

    @property
    def support(self) -> tuple[tuple[int, ...], ...]:
        return self.dry.support

    def columns(self, q: Rows, qd: Rows, qdd: Rows) -> Columns:
        self._check(q.shape[1])
        return tuple(
            rows if self.slides[joint] or not len(rows) else self.state[:, joint][None]
            for joint, rows in enumerate(self.dry.columns(q, qd, qdd))
        )

    def regressor(self, q: Joints, qd: Joints, qdd: Joints) -> Regressor:
        return self.dry.regressor(q, self._velocity(qd), qdd) * self._size(qd)[..., None]

    def torque(self, k: Coefficients, q: Joints, qd: Joints, qdd: Joints) -> Joints:
        return self.dry.torque(k, q, self._velocity(qd), qdd) * self._size(qd)

    def mass_matrix(self, k: Coefficients, q: Joints) -> Matrices:
        return self.dry.mass_matrix(k, q)

    def velocity_term(self, k: Coefficients, q: Joints, qd: Joints) -> Joints:
        return self.dry.velocity_term(k, q, qd)

    def gravity_term(self, k: Coefficients, q: Joints) -> Joints:
        return self.dry.gravity_term(k, q)

    def _velocity(self, qd: Joints) -> Joints:
        """One whose sign is the state's."""
        self._check(qd.shape[0])
        slides = jnp.broadcast_to(jnp.array(self.slides), qd.shape)
        return jnp.where(slides, qd, self.state)

    def _size(self, qd: Joints) -> Joints:
        slides = jnp.broadcast_to(jnp.array(self.slides), qd.shape)
        return jnp.where(slides, 1.0, jnp.abs(self.state))

    def _check(self, samples: int) -> None:
        if samples != len(self.state):
            raise ValueError(
                f"pre-sliding: the motion has {samples} samples at a time, its state"
                f" {len(self.state)}; expected one motion in one piece"
            )

    def __hash__(self) -> int:
        return id(self.state)
