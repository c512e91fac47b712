"""Pre-sliding (Dahl 1968) friction: states of contacts along a motion, and their term."""

from typing import Any

import equinox as eqx
import jax
import jax.numpy as jnp
import numpy as np
from jaxtyping import Array, Float

from ..derivation import Coefficient
from ..network import (
    CSLC,
    JAX_FUNCTIONS,
    AbstractFunctions,
    AbstractManipulatorTerm,
    Coefficients,
    Columns,
    Joints,
    JointTerm,
    Regressor,
    Rows,
)
from ..recordings import Patterns


@jax.jit
def pre_sliding(
    q: Float[Array | np.ndarray, "samples joints"],
    length: Float[Array | np.ndarray, " joints"],
    start: Float[Array | np.ndarray, " joints"],
) -> Float[Array, "samples joints"]:
    """Compute the pre-sliding state of each joint, from -1 to 1 (Dahl 1968).

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
    >>> from jaxcslc.friction import pre_sliding
    >>> there_and_back = np.array([[0.0], [0.1], [0.0]])
    >>> w = pre_sliding(there_and_back, np.array([0.1]), np.zeros(1))
    >>> np.round(np.asarray(w)[:, 0], 3).tolist()  # 1 - 1/e, and back from there
    [0.0, 0.632, -0.4]
    """
    q = jnp.asarray(q)
    change = jnp.diff(q, axis=0)

    def along(w: Array, change: Array) -> tuple[Array, Array]:
        w = state_after(w, change, scale)
        return w, w

    first, scale = jnp.asarray(start, q.dtype), jnp.asarray(length, q.dtype)
    return jnp.concatenate([first[None], jax.lax.scan(along, first, change)[1]])


def state_after(
    w: Any, change: Any, length: Any, functions: AbstractFunctions = JAX_FUNCTIONS
) -> Any:
    """The state of a contact after its joint has gone one way by `change` [rad or m].

    Arguments are of one shape, or whatever else `functions` works on.
    """
    sign = functions.sign(change)
    return sign + (w - sign) * functions.exp(-functions.absolute(change) / length)


def checked_lengths(network: CSLC, lengths: Any) -> Float[np.ndarray, " joints"]:
    """Lengths of pre-sliding as an array, (n,).

    **Raises** `ValueError` for other than n numbers from 0 up, or of joints without dry friction.
    """
    joints, values = network.joint_count, np.asarray(lengths, float)
    if values.shape != (joints,) or not np.all(np.isfinite(values) & (values >= 0.0)):
        raise ValueError(f"lengths: expected {joints} finite numbers from 0 up")
    without = {*np.flatnonzero(values).tolist()}
    if without:
        without -= {*dry_term(network).joints}
    if without:
        label = network.output_names[min(without)]
        raise ValueError(f"lengths: {label} has no friction of kind 'dry', which they are of")
    return values


def split_friction(
    network: CSLC, k: Array, lengths: Float[Array | np.ndarray, " joints"]
) -> tuple[Array, Float[Array, " joints"], Float[Array, " joints"]]:
    """Coefficients without the dry friction of joints with a length, and that friction.

    **Arguments**

    - `network`: n joints, some with dry friction; `k`: (p,) its coefficients.
    - `lengths`: (n,) of pre-sliding [rad or m]; 0 where friction follows the sign of velocity.

    **Returns**

    - (p,) coefficients, 0 for dry friction that has a state.
    - (n,) what the state of each joint is multiplied by [N m or N]; 0 where friction has none.
    - (n,) lengths to divide by, 1 where there is none.
    """
    dry = dry_term(network)
    part, joints = network.layout.of(dry), np.array(dry.joints)
    lengths = jnp.asarray(lengths)
    yields = lengths > 0.0
    sizes = jnp.zeros(network.joint_count, k.dtype).at[joints].set(k[part])
    others = k.at[part].set(jnp.where(yields[joints], 0.0, k[part]))
    return others, jnp.where(yields, sizes, 0.0), jnp.where(yields, lengths, 1.0)


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

    def part(self, quantity: str, k: Coefficients, *motion: Joints) -> Float[Array, "..."]:
        return self.dry.part(quantity, k, *motion)

    def _velocity(self, qd: Joints) -> Joints:
        """Return the velocity with the sign of the state at joints that have one."""
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


def dry_term(network: CSLC) -> JointTerm:
    """The term of dry friction.

    **Raises** `ValueError` if there is none.
    """
    for term in network.terms:
        if isinstance(term, JointTerm) and term.kind == "dry":
            return term
    raise ValueError(f"{network.name!r} has no friction of kind 'dry', which pre-sliding is of")


def along_motion(
    network: CSLC,
    patterns: Patterns,
    lengths: Float[np.ndarray, " joints"],
    start: Float[np.ndarray, " joints"] | None = None,
) -> CSLC:
    """The network for the motion of patterns: its dry friction has states where it has lengths.

    What a state starts with is forgotten within a few lengths; so is that joints seem to move from
    one recording to the next where patterns of several are joined.

    **Arguments**

    - `network`: n joints, some with dry friction.
    - `patterns`: whose positions states are along.
    - `lengths`: (n,) of pre-sliding [rad or m]; the network itself is returned if all are 0.
    - `start`: (n,) states at the first sample; zeros if None.
    """
    if not np.any(lengths):
        return network
    return with_state(network, np.asarray(patterns.q), lengths, start)[0]


def has_states(network: CSLC) -> bool:
    """Return whether the network is for one motion, as `along_motion` returns it."""
    return any(isinstance(term, YieldingFriction) for term in network.terms)


def state_at(
    patterns: Patterns, lengths: Float[np.ndarray, " joints"], sample: int
) -> Float[np.ndarray, " joints"]:
    """(n,) states of contacts at a sample of a motion that begins without strain; 0 of joints
    without a length [rad or m]."""
    yields = lengths > 0.0
    before = np.asarray(patterns.q)[: sample + 1]
    state = pre_sliding(before, np.where(yields, lengths, 1.0), np.zeros(len(lengths)))
    return np.where(yields, np.asarray(state)[-1], 0.0)


def with_state(
    network: CSLC,
    q: Float[Array | np.ndarray, "samples joints"],
    lengths: Float[np.ndarray, " joints"],
    start: Float[Array | np.ndarray, " joints"] | None = None,
) -> tuple[CSLC, Float[Array, "samples joints"]]:
    """The network whose dry friction has its state along a motion, and the state.

    **Arguments**

    - `network`: n joints, some with dry friction.
    - `q`: positions along the motion, (samples, n) [rad or m].
    - `lengths`: (n,) of pre-sliding [rad or m]; 0 where friction follows the sign of velocity.
    - `start`: (n,) the state at the first sample; zeros if None.

    **Returns** the network, for this motion in one piece, and the state (samples, n).
    """
    slides = lengths <= 0.0
    first = np.zeros(len(lengths)) if start is None else start
    state = pre_sliding(q, np.where(slides, 1.0, lengths), first)
    numbers = np.asarray(state) if isinstance(q, np.ndarray) else state
    dry = dry_term(network)
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
