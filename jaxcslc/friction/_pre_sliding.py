"""Pre-sliding (Dahl 1968) friction: states of contacts along a motion, their term and its fit.

A contact yields before it slides; the distance in which it does is fitted joint by joint.
"""

import dataclasses
from collections.abc import Callable, Mapping
from typing import Any

import equinox as eqx
import jax
import jax.numpy as jnp
import numpy as np
from jaxtyping import Array, Bool, Float, Int

from .._bounded_search import bounded_minima
from ..derivation import Coefficient
from ..least_squares import Identification, LeastSquares, columns_of, torque_by, torque_of
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
from ..uncertainty import RelativeError, fold_numbers, unlike_halves


@jax.jit
def contact_states(
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
    >>> from jaxcslc.friction import contact_states
    >>> there_and_back = np.array([[0.0], [0.1], [0.0]])
    >>> w = contact_states(there_and_back, np.array([0.1]), np.zeros(1))
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
    """Return the state of a contact after its joint has gone one way by `change` [rad or m].

    Arguments are of one shape, or whatever else `functions` works on.
    """
    sign = functions.sign(change)
    return sign + (w - sign) * functions.exp(-functions.absolute(change) / length)


def checked_distance(network: CSLC, presliding_distance: Any) -> Float[np.ndarray, " joints"]:
    """Distances of pre-sliding as an array, (n,).

    **Raises** `ValueError` for other than n numbers from 0 up, or of joints without dry friction.
    """
    joints, values = network.joint_count, np.asarray(presliding_distance, float)
    if values.shape != (joints,) or not np.all(np.isfinite(values) & (values >= 0.0)):
        raise ValueError(f"presliding_distance: expected {joints} finite numbers from 0 up")
    without = {*np.flatnonzero(values).tolist()}
    if without:
        without -= {*dry_term(network).joints}
    if without:
        label = network.output_names[min(without)]
        raise ValueError(
            f"presliding_distance: {label} has no friction of kind 'dry'; expected it for"
            " pre-sliding"
        )
    return values


def split_friction(
    network: CSLC, k: Array, presliding_distance: Float[Array | np.ndarray, " joints"]
) -> tuple[Array, Float[Array, " joints"], Float[Array, " joints"]]:
    """Split off the dry friction of joints whose contacts yield before they slide.

    **Returns** coefficients without it (p,), the friction that each joint's state is multiplied by
    (n,) [N m or N], 0 of joints without a state, and distances to divide by (n,), 1 of such joints.
    """
    dry = dry_term(network)
    part, joints = network.layout.term_slice(dry), np.array(dry.joints)
    presliding_distance = jnp.asarray(presliding_distance)
    yields = presliding_distance > 0.0
    sizes = jnp.zeros(network.joint_count, k.dtype).at[joints].set(k[part])
    others = k.at[part].set(jnp.where(yields[joints], 0.0, k[part]))
    return others, jnp.where(yields, sizes, 0.0), jnp.where(yields, presliding_distance, 1.0)


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

    @property
    def at_any_motion(self) -> AbstractManipulatorTerm:
        return self.dry

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
    """Return the term of dry friction.

    **Raises** `ValueError` if there is none.
    """
    for term in network.terms:
        if isinstance(term, JointTerm) and term.kind == "dry":
            return term
    raise ValueError(f"{network.name!r} has no friction of kind 'dry'; expected it for pre-sliding")


def along_motion(
    network: CSLC,
    patterns: Patterns,
    presliding_distance: Float[np.ndarray, " joints"],
    start: Float[np.ndarray, " joints"] | None = None,
) -> CSLC:
    """Return the network for the motion of patterns: contacts have states where they have a
    distance.

    A state forgets its start within a few such distances, and so that joints seem to move from one
    recording to the next where patterns of several are joined.

    - `start`: (n,) states at the first sample; zeros if None.
    """
    if not np.any(presliding_distance):
        return network
    return with_state(network, np.asarray(patterns.q), presliding_distance, start)[0]


def has_states(network: CSLC) -> bool:
    """Return whether the network is for one motion, as `along_motion` returns it."""
    return any(isinstance(term, YieldingFriction) for term in network.terms)


def state_at(
    patterns: Patterns, presliding_distance: Float[np.ndarray, " joints"], sample: int
) -> Float[np.ndarray, " joints"]:
    """(n,) states of contacts at a sample of a motion that begins without strain; 0 of joints
    without a length [rad or m]."""
    yields = presliding_distance > 0.0
    before = np.asarray(patterns.q)[: sample + 1]
    state = contact_states(
        before, np.where(yields, presliding_distance, 1.0), np.zeros(len(presliding_distance))
    )
    return np.where(yields, np.asarray(state)[-1], 0.0)


def with_state(
    network: CSLC,
    q: Float[Array | np.ndarray, "samples joints"],
    presliding_distance: Float[np.ndarray, " joints"],
    start: Float[Array | np.ndarray, " joints"] | None = None,
) -> tuple[CSLC, Float[Array, "samples joints"]]:
    """Return the network whose dry friction has its state along positions, and that state."""
    slides = presliding_distance <= 0.0
    first = np.zeros(len(presliding_distance)) if start is None else start
    state = contact_states(q, np.where(slides, 1.0, presliding_distance), first)
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


# Distances that are tried, as parts of a joint's range of motion. Between neighbours of the best
# one, the minimum is found to this part of itself: coefficients of a PUMA 560 then are within 0.004
# standard errors of those of the exact minimum; to a hundredth, within 0.8.
_DISTANCES, _TOLERANCE = np.geomspace(1e-4, 0.3, 12), 1e-4


class PreSlidingFit(eqx.Module):
    """Coefficients with dry friction that yields before it slides.

    **Attributes**

    - `network`: as it was fitted, with dry friction in proportion to sign(qd).
    - `fit`: its coefficients; those of dry friction are for motion that slides. Standard errors are
      for distances that are known.
    - `presliding_distance`: (n,) [rad or m]; 0 where friction follows the sign of velocity.
    - `relative`: by joint, counted from 1: held-out error with a pre-sliding state over that
      without.
    - `tried_distance`: (n,) [rad or m] that `relative` is of; 0 where no length fitted better.
    - `elsewhere`: as `relative`, of motion unlike what was fitted: slow or fast, near or far from
      the mean position, whichever is predicted worse. Files do not hold it.
    """

    network: CSLC
    fit: Identification
    presliding_distance: Float[np.ndarray, " joints"]
    relative: dict[int, RelativeError]
    tried_distance: Float[np.ndarray, " joints"]
    elsewhere: dict[int, RelativeError] = eqx.field(default_factory=dict)

    @property
    def joint_names(self) -> tuple[str, ...]:
        """Names of the joints whose friction has a length of pre-sliding."""
        pairs = zip(self.network.output_names, self.presliding_distance, strict=True)
        return tuple(name for name, length in pairs if length > 0.0)

    def torque(
        self,
        q: Float[Array | np.ndarray, "samples joints"],
        qd: Float[Array | np.ndarray, "samples joints"],
        qdd: Float[Array | np.ndarray, "samples joints"],
        start: Float[Array | np.ndarray, " joints"] | None = None,
    ) -> tuple[Float[Array, "samples joints"], Float[Array, " joints"]]:
        """Torque along a motion, and the state at its end.

        **Arguments**

        - `q`, `qd`, `qdd`: (samples, n) [rad, rad/s, rad/s², or m, m/s, m/s²].
        - `start`: (n,) the state at its first sample, from -1 to 1; zeros if None.

        **Returns** torque (samples, n) [N m or N], and the state at the last sample, (n,).
        """
        first = np.zeros(self.network.joint_count) if start is None else start
        network, state = with_state(self.network, jnp.asarray(q), self.presliding_distance, first)
        motion = (jnp.asarray(x) for x in (q, qd, qdd))
        return network.torque(jnp.asarray(self.fit.k), *motion), state[-1]


def fit_pre_sliding(
    network: CSLC,
    patterns: Patterns,
    *,
    solver: LeastSquares | None = None,
    judged: Bool[Array | np.ndarray, "samples joints"] | None = None,
    chance: float = 0.05,
    informed: Callable[[Any], Any] | None = None,
) -> PreSlidingFit:
    """Distances of pre-sliding, joint by joint, with all coefficients.

    Dry friction counts by its state along the motion. For distances that are known torque is linear
    in the coefficients; distances are searched for by the sum of each joint's squared residuals: a
    grid, then Brent's method. A joint keeps its length where held-out stretches are predicted
    better by 1 % and by more than chance explains (Student's t, one-sided), and motion unlike what
    was fitted no worse (slow by fast and the other way round, positions near the middle and far).

    **Arguments**

    - `network`: n joints, some with friction of kind `"dry"`.
    - `patterns`: of one motion without gaps, slow pairs included: a mask of slow motion leaves out
      what says most of pre-sliding. Masked pairs count as motion.
    - `solver`: options of the fit; the defaults of `LeastSquares` if None.
    - `judged`: (samples, n) pairs that distances are searched for and judged on; those of the fit
      if None. Slow pairs count here at no cost to coefficients that a mask protects from them.
    - `chance`: the part of such gains that is chance.
    - `informed`: adds what is known of bodies to the fits that lengths are judged by: what half a
      motion leaves open would hide the gain of a length.

    **Returns** a `PreSlidingFit`.

    **Raises**

    - `ValueError`: no joint has dry friction, or as `LeastSquares.fit`.
    - `RuntimeError`: as `LeastSquares.fit`.

    >>> import numpy as np, jaxcslc as jc
    >>> from jaxcslc.friction import fit_pre_sliding, contact_states
    >>> network = jc.derive(jc.examples.turntable("dry"))
    >>> patterns = jc.examples.swing(network, [0.5, 0.0], samples=2000)
    >>> w = np.asarray(contact_states(patterns.q, np.array([0.05]), np.zeros(1)))
    >>> noise = 0.01 * np.random.default_rng(0).normal(size=w.shape)
    >>> torque = patterns.torque + 0.4 * w + noise
    >>> result = fit_pre_sliding(network, dataclasses.replace(patterns, torque=torque))
    >>> result.presliding_distance.round(3).tolist(), result.fit.k.round(2).tolist()
    ([0.05], [0.5, 0.4])
    """
    joints = dry_term(network).joints
    solver = LeastSquares() if solver is None else solver
    q = np.asarray(patterns.q)
    reach = np.maximum(np.ptp(q, axis=0), 1e-12)
    search = dataclasses.replace(solver, errors="independent")  # standard errors choose no length
    mask, dry = (
        np.asarray(patterns.mask if judged is None else judged),
        np.isin(np.arange(network.joint_count), joints),
    )

    def squares(presliding_distance: Float[np.ndarray, " joints"]) -> Float[np.ndarray, " joints"]:
        yielding, _ = with_state(network, q, presliding_distance)
        k = search.fit(yielding, patterns).k
        error = np.asarray(patterns.torque) - torque_of(yielding, patterns, k)
        return np.sum(np.where(mask, error, 0.0) ** 2, axis=0)

    grid = np.outer([0.0, *_DISTANCES], np.where(dry, reach, 0.0))
    best = np.argmin([squares(presliding_distance) for presliding_distance in grid], axis=0)
    presliding_distance = grid[best, np.arange(len(reach))]
    (moving,) = np.nonzero(presliding_distance)

    def moved(logarithms: np.ndarray, which: np.ndarray) -> np.ndarray:
        """Squares of joints whose distances are moved, all of them in one fit."""
        presliding_distance[moving[which]] = np.exp(logarithms)
        return squares(presliding_distance)[moving[which]]

    # A fit for each joint's length, as `scipy.optimize.minimize_scalar` asks for, would be several
    # times as many fits.
    middle, width = np.log(presliding_distance[moving]), np.log(_DISTANCES[1] / _DISTANCES[0])
    tolerance = np.full(len(moving), _TOLERANCE)
    presliding_distance[moving] = np.exp(
        bounded_minima(moved, middle - width, middle + width, tolerance)
    )
    relative, *halves = (
        _held_out(network, patterns, solver, presliding_distance, joints, mask, fold, informed)
        for fold in (fold_numbers(patterns.samples), *unlike_halves(patterns, mask))
    )
    elsewhere = {
        joint: max((half[joint] for half in halves), key=lambda some: some.change)
        for joint in relative
    }
    kept = [
        joint in relative
        and relative[joint].beyond_chance(chance)
        and elsewhere[joint].change <= 0.0
        for joint in range(1, len(dry) + 1)
    ]
    supported = np.where(kept, presliding_distance, 0.0)
    fit = solver.fit(with_state(network, q, supported)[0], patterns)
    return PreSlidingFit(network, fit, supported, relative, presliding_distance, elsewhere)


def _held_out(
    network: CSLC,
    patterns: Patterns,
    solver: LeastSquares,
    presliding_distance: Float[np.ndarray, " joints"],
    joints: tuple[int, ...],
    judged: Bool[np.ndarray, "samples joints"],
    fold: Int[np.ndarray, " samples"],
    informed: Callable[[Any], Any] | None,
) -> dict[int, RelativeError]:
    """Errors of folds under fits to the others, with distances over those without."""
    yielding, _ = with_state(network, np.asarray(patterns.q), presliding_distance)
    after, before = (
        solver.held_out_errors(x, patterns, fold)
        if informed is None
        else informed_errors(x, patterns, solver, fold, informed)
        for x in (yielding, network)
    )
    return {
        joint + 1: RelativeError.of_joint(after, before, judged, fold, joint + 1)
        for joint in joints
        if presliding_distance[joint] > 0.0
    }


def informed_errors(
    network: CSLC,
    patterns: Patterns,
    solver: LeastSquares,
    fold: Int[np.ndarray, " samples"],
    informed: Callable[[Any], Any],
) -> Float[np.ndarray, "samples joints"]:
    """Return errors of folds under fits to the others, with what is known of bodies."""
    columns = columns_of(network, patterns)
    errors = np.array(patterns.torque, float)
    for number, fit in enumerate(solver.fits_without_folds(network, patterns, fold, columns)):
        here = fold == number
        part = tuple(of_joint[:, here] for of_joint in columns)
        errors[here] -= torque_by(network.support, part, np.asarray(informed(fit).k))
    return errors


# Entries of the file, and attributes.
_SAVED = {"lengths": "presliding_distance", "tried_lengths": "tried_distance"}


def pre_sliding_document(result: PreSlidingFit) -> dict[str, Any]:
    """Return a `PreSlidingFit` as plain data, without its network."""
    return {
        **{entry: getattr(result, name) for entry, name in _SAVED.items()},
        "relative": {
            str(joint): [error.change, error.change_error, error.parts]
            for joint, error in result.relative.items()
        },
        "fit": result.fit.document(),
    }


def pre_sliding_from(document: Any, network: CSLC, where: str) -> PreSlidingFit:
    """Read the fit that `pre_sliding_document` wrote; `where` it was read.

    **Raises** `ValueError` for something else; the message names the entry.
    """
    if not isinstance(document, Mapping) or not isinstance(document.get("fit"), Mapping):
        raise ValueError(f"{where}: expected a JSON object with a fit")
    fit = Identification.from_document(document["fit"], f"{where}, fit")
    if fit.names != network.names:
        raise ValueError(f"{where}, fit: expected the coefficients of {network.name!r}")
    try:
        presliding_distance, tried = (np.array(document[name], float) for name in _SAVED)
        relative = {
            int(joint): RelativeError(
                float(change), np.inf if spread is None else float(spread), int(parts)
            )
            for joint, (change, spread, parts) in document["relative"].items()
        }
    except (AttributeError, KeyError, TypeError, ValueError):
        raise ValueError(f"{where}: expected lengths, tried_lengths and relative") from None
    shape = (network.joint_count,)
    if (
        presliding_distance.shape != shape
        or tried.shape != shape
        or not np.all(presliding_distance >= 0.0)
    ):
        raise ValueError(f"{where}: lengths: expected {shape[0]} numbers from 0 up")
    return PreSlidingFit(network, fit, presliding_distance, relative, tried)
