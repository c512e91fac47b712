from typing import NamedTuple

import equinox as eqx
import jax
import jax.numpy as jnp
import numpy as np
from jax.core import Tracer
from jaxtyping import Array, Bool, Float, Int

from ..control import LowPassChain
from ..identification.solver import Identification
from ..network import CSLC
from ._memory import Memory
from ._possible import possible_body


Joints = Float[Array | np.ndarray, " joints"]
# How large bodies are that nothing is known of: their deviations, prior to any motion. In kg m²,
# kg m and kg; weak beside what a second of motion says of an arm's payload.
_PRIOR = np.array([0.2] * 6 + [1.0] * 3 + [5.0])
_SIZE = len(_PRIOR)
_LONG_ENOUGH = 1.0  # of motion [s]
_CERTAIN = 20.0  # times the alarm


class PayloadEstimate(NamedTuple):
    """What is known of a payload at an instant.

    In the frame of the link that carries it.
    """

    body: Float[Array, "10"]
    """Its ten inertial parameters in the order of `BODY`: a body that can exist."""
    covariance: Float[Array, "10 10"]
    """Of what the motion says of them, the condition that they can exist left aside."""
    mass: Float[Array, ""]
    """[kg]."""
    mass_error: Float[Array, ""]
    """Its standard error [kg]."""
    centre: Float[Array, "3"]
    """Centre of gravity [m]."""
    centre_error: Float[Array, "3"]
    """Its standard error [m]; infinite while the mass may be zero."""
    carrying: Bool[Array, ""]
    """Whether there is a payload, as decided last; see `PayloadEstimator`."""
    picked_up: Float[Array, ""]
    """When the latest payload was found to have been picked up [s since `begin`]; −1 for never."""
    put_down: Float[Array, ""]
    """When it was found to have been put down [s since `begin`]; −1 for never."""
    change: Float[Array, ""]
    """How far the latest motion disagrees with the estimate: χ² of ten degrees of freedom."""


class PayloadState(NamedTuple):
    """What a `PayloadEstimator` remembers."""

    position: Float[Array, " joints"]
    """The latest reading."""
    torque: Float[Array, " joints"]
    """What was asked for then."""
    motion: Float[Array, "lags joints"]
    """Of the filter on readings."""
    effort: Float[Array, "lags joints"]
    """Of the filter on torques."""
    samples: Int[Array, ""]
    """Since `begin`."""
    time: Float[Array, ""]
    """Since `begin` [s]."""
    waited: Float[Array, ""]
    """Since the latest update [s]."""
    since: Float[Array, ""]
    """Since the memory was last emptied, of motion [s]."""
    disagreeing: Float[Array, ""]
    """How long the short memory has disagreed without a break, of motion [s]."""
    memory: Memory
    """All that was seen of the present payload."""
    latest: Memory
    """What was seen lately."""
    undecided: Bool[Array, ""]
    """Whether it is not yet known what is carried: at first, and after a change."""
    estimate: PayloadEstimate


class PayloadEstimator(eqx.Module):
    """A payload's ten inertial parameters, learnt while it is carried (thesis 8.2.4).

    From encoder readings and the torques that were asked for, sample by sample, with the arm's own
    coefficients held at what was identified before:

    - **Motion.** Readings and torques go through alike causal filters (`LowPassChain`), so that
      the filtered torque belongs to the filtered motion, whatever their common delay.
    - **Recursive least squares** on Y_p x = torque − Y k, with forgetting: the information matrix
      and its right-hand side, from a weak prior around no payload at all. A joint that moves
      more slowly than `slowest` may stick, and does not count.
    - **Errors.** An equation weighs by the spectral density of the torque's slow errors
      (`torque_noise`), so that a second of samples which all err alike is not taken for five
      hundred. The covariance of the arm's coefficients, if known, is carried along.
    - **Possible.** The body handed out at every sample can exist (`possible_body`).
    - **Picking up, putting down.** A second, short memory is compared with the estimate; where
      they differ by more than chance allows for longer than `patience`, what was learnt is dropped
      and learning begins anew. The estimate handed out stays as it was until the mass is known to
      within `decided`, or, of an arm that hardly feels the mass, for a second of motion; then it
      is known which it was, too. An arm at rest tells nothing, for friction holds the payload.

    It is float64 work. Everything but words is a leaf. `step` is pure: `jit` it, `scan` over it,
    `vmap` over arms.

    **Attributes**

    - `network`: with payload (`CSLC.with_payload`).
    - `k`, `covariance`: (p,) the arm's own, and (p, p).
    - `noise`: (n,) [N² m² s].
    - `slowest`: (n,) [rad/s or m/s].
    - `filter`: of readings and torques.
    - `forgetting_time`: over which what was seen loses a factor e of its weight [s]; from update to
      update the forgetting factor is exp(−interval / forgetting time).
    - `alertness`: the same for the short memory [s].
    - `alarm`: χ² of ten degrees of freedom that chance does not bring about.
    - `patience`: for how long it has to be exceeded, of motion [s]; twenty times as much counts at
      once.
    - `decided`: standard error of the mass at which it is decided whether there is a payload, and
      a third of what one weighs at least [kg].
    - `every`: samples from update to update.

    >>> import jax, jax.numpy as jnp, numpy as np, jaxcslc as jc
    >>> from jaxcslc.payload import PayloadEstimator
    >>> arm = jc.Manipulator.from_modified_dh([(0, 0, 0, 0)], gravity=(0, -9.81, 0))
    >>> network = jc.derive(arm.with_friction(), lengths="numeric").with_payload()
    >>> ball = jc.LinkParameters(2.0, np.array([0.5, 0.0, 0.0]), 0.01 * np.eye(3))
    >>> nothing = jc.LinkParameters(0.0, np.zeros(3), np.zeros((3, 3)))
    >>> k = network.coefficients_from([nothing], payload=ball)
    >>> t = 0.002 * np.arange(1500)[:, None]
    >>> q, qd, qdd = -np.cos(3 * t), 3 * np.sin(3 * t), 9 * np.cos(3 * t)  # from rest
    >>> torque = network.torque(k, q, qd, qdd)
    >>> estimator = PayloadEstimator(network, k[network.layout.unloaded], noise=np.array([1e-4]))
    >>> def onwards(state, signal):
    ...     return estimator.step(state, *signal, 0.002), None
    >>> state, _ = jax.lax.scan(onwards, estimator.begin(jnp.asarray(q[0])), (q, torque))
    >>> moment = state.estimate.body[6]  # an arm of one joint feels m x, not the mass
    >>> bool(abs(moment - 1.0) < 0.02)
    True
    """

    network: CSLC
    k: Float[Array, " coefficients"]
    covariance: Float[Array, "coefficients coefficients"]
    noise: Float[Array, " joints"]
    slowest: Float[Array, " joints"]
    filter: LowPassChain
    forgetting_time: float
    alertness: float
    alarm: float
    patience: float
    decided: float
    every: int = eqx.field(static=True)

    def __init__(
        self,
        network: CSLC,
        known: Identification | Float[Array | np.ndarray, " coefficients"],
        noise: Joints,
        *,
        slowest: Joints | float = 0.05,
        filter: LowPassChain | None = None,
        forgetting_time: float = 10.0,
        alertness: float = 0.3,
        alarm: float = 60.0,
        patience: float = 0.1,
        decided: float = 0.05,
        every: int = 10,
    ) -> None:
        """**Arguments**

        - `network`: of the arm, with or without payload.
        - `known`: the arm's own coefficients: an `Identification`, whose covariance counts, or
          (p,) exact ones.
        - `noise`: (n,) of `torque_noise`.
        - the rest: as the attributes; four lags of 12 Hz for the filter. (Y of the filtered motion
          is not the filtered Y: at 8 Hz, masses came out 0.3 to 0.5 % too small.)

        **Raises**

        - `ValueError`: another number of coefficients or joints than the network's, or noise that
          is not above 0; names it.
        """
        self.network = network if network.payload is not None else network.with_payload()
        own, n = self.network.layout.unloaded.stop, self.network.joint_count
        identified = isinstance(known, Identification)
        self.k = jnp.asarray(known.k if identified else known)
        if self.k.shape != (own,):
            raise ValueError(f"known: expected {own} coefficients, got {self.k.shape}")
        self.covariance = known.covariance if identified else jnp.zeros((own, own))
        self.noise = jnp.asarray(noise, float)
        if self.noise.shape != (n,):
            raise ValueError(f"noise: expected {n} values, one a joint, got {self.noise.shape}")
        if not isinstance(self.noise, Tracer) and not np.all(np.asarray(self.noise) > 0):
            raise ValueError(f"noise is {np.asarray(self.noise).tolist()}; expected more than 0")
        self.slowest = jnp.broadcast_to(jnp.asarray(slowest, float), (n,))
        self.filter = LowPassChain(12.0, lags=4) if filter is None else filter
        if self.filter.lags < 3:
            raise ValueError(f"filter has {self.filter.lags} lags; accelerations need 3 or more")
        self.forgetting_time, self.alertness = forgetting_time, alertness
        self.alarm, self.patience, self.decided = alarm, patience, decided
        self.every = every

    def begin(self, q: Joints) -> PayloadState:
        """The state before the first sample, without payload, the joints at rest at `q` (n,)."""
        q = jnp.asarray(q, self.k.dtype)
        none, zero = jnp.zeros_like(q), jnp.zeros((), q.dtype)
        empty = Memory.empty(_SIZE, self.k.shape[0], q.dtype)
        return PayloadState(
            position=q,
            torque=none,
            motion=self.filter.begin(q),
            effort=self.filter.begin(none),
            samples=jnp.asarray(0),
            time=zero,
            waited=zero,
            since=zero,
            disagreeing=zero,
            memory=empty,
            latest=empty,
            undecided=jnp.asarray(True),
            estimate=self._estimate(empty, None, zero),
        )

    def step(
        self, state: PayloadState, q: Joints, torque: Joints, interval: float | Array
    ) -> PayloadState:
        """What is known after another sample, in `state.estimate`.

        **Arguments**

        - `state`: as the step before left it.
        - `q`: (n,) the encoders' readings [rad or m]; NaN where none has come.
        - `torque`: (n,) asked for upon these readings, held until the next [N m or N].
        - `interval`: since the step before [s].
        """
        q, torque = (jnp.asarray(x, self.k.dtype) for x in (q, torque))
        q = jnp.where(jnp.isnan(q), state.position, q)
        first = state.samples == 0
        # The torque that was asked for at the sample before acted until now; at the first sample
        # the arm was held by the torque that is asked for now.
        motion = self.filter.step(state.motion, state.position, q, interval)
        effort = self.filter.step(state.effort, state.torque, torque, interval, hold="constant")
        effort = jnp.where(first, self.filter.begin(torque), effort)
        motion = jnp.where(first, self.filter.begin(q), motion)
        state = state._replace(
            position=q,
            torque=torque,
            motion=motion,
            effort=effort,
            samples=state.samples + 1,
            time=state.time + interval,
            waited=state.waited + interval,
        )
        due = state.samples % self.every == 0
        return jax.lax.cond(due, lambda: self._updated(state), lambda: state)

    def _updated(self, state: PayloadState) -> PayloadState:
        q, qd, qdd = self.filter.read(state.motion)
        torque = self.filter.read(state.effort).value
        columns = self.network.regressor(q, qd, qdd)
        layout = self.network.layout
        own, felt = columns[:, layout.unloaded], columns[:, layout.payload]
        residual = torque - own @ self.k
        weight = jnp.where(jnp.abs(qd) > self.slowest, state.waited / self.noise, 0.0)
        moving = state.waited * jnp.any(weight > 0)

        def gone_on(memory: Memory, time: float | Array) -> Memory:
            return memory.with_rows(felt, own, residual, weight, jnp.exp(-state.waited / time))

        memory, latest = (
            gone_on(state.memory, self.forgetting_time),
            gone_on(state.latest, self.alertness),
        )
        change = self._disagreement(memory, latest)
        # What is just beginning to be learnt has nothing to disagree with.
        since = state.since + moving
        apart = (change > self.alarm) & (since > self.alertness)
        disagreeing = jnp.where(apart, state.disagreeing + moving, 0.0)
        # What chance or a moment of stiction can never bring about needs no patience.
        alarmed = (disagreeing > self.patience) | (apart & (change > _CERTAIN * self.alarm))
        # Both memories hold what was seen before the change as well: nothing is kept.
        memory, latest = memory.emptied(alarmed), latest.emptied(alarmed)
        since, disagreeing = (jnp.where(alarmed, 0.0, time) for time in (since, disagreeing))
        before = state.estimate
        found = self._estimate(memory, before, change)
        undecided = state.undecided | alarmed
        weighed = found.mass_error < self.decided
        known = (weighed & (since > self.patience)) | (since > _LONG_ENOUGH)
        something = found.body @ memory.information @ found.body > self.alarm
        loaded = jnp.where(weighed, found.mass > 3.0 * self.decided, something)
        settled = undecided & known
        up, down = settled & loaded, settled & ~loaded & before.carrying
        found = found._replace(
            carrying=jnp.where(settled, loaded, before.carrying),
            picked_up=jnp.where(up, state.time, before.picked_up),
            put_down=jnp.where(down, state.time, before.put_down),
        )
        undecided = (undecided & ~known) | ~jnp.all(jnp.isfinite(found.body))
        held = before._replace(change=change)
        estimate = jax.tree_util.tree_map(
            lambda old, new: jnp.where(undecided, old, new), held, found
        )
        return state._replace(
            memory=memory,
            latest=latest,
            waited=jnp.zeros_like(state.waited),
            since=since,
            disagreeing=disagreeing,
            undecided=undecided,
            estimate=estimate,
        )

    def _disagreement(self, memory: Memory, latest: Memory) -> Float[Array, ""]:
        """χ² of what the short memory says against the estimate of the long one."""
        prior = jnp.asarray(1.0 / _PRIOR**2)
        information = memory.information + jnp.diag(prior)
        mean = jnp.linalg.solve(information, memory.moment)
        score = latest.moment - latest.information @ mean
        # Var(score) = Λ_s + Λ_s P Λ_s; the χ² of a singular one is that of its range.
        spread = latest.information + latest.information @ jnp.linalg.solve(
            information, latest.information
        )
        scale = 1.0 / jnp.sqrt(jnp.diagonal(spread) + 1e-9)
        white = spread * scale[:, None] * scale[None, :] + 1e-9 * jnp.eye(_SIZE)
        return (scale * score) @ jnp.linalg.solve(white, scale * score)

    def _estimate(
        self, memory: Memory, before: PayloadEstimate | None, change: Array
    ) -> PayloadEstimate:
        """What a memory says; what was decided is as before."""
        prior = jnp.asarray(1.0 / _PRIOR**2)
        information = memory.information + jnp.diag(prior)
        mean = jnp.linalg.solve(information, memory.moment)
        inverse = jnp.linalg.inv(information)
        # Errors of the arm's coefficients are taken for payload: x̂ moves by −P C δk.
        through = inverse @ memory.mixed
        covariance = inverse + through @ self.covariance @ through.T
        body = possible_body(mean, information)
        mass, moment = body[9], body[6:9]
        centre = moment / mass
        mass_error = jnp.sqrt(covariance[9, 9])
        # Delta method: δc = (δh − c δm) / m.
        jacobian = jnp.concatenate([jnp.eye(3), -centre[:, None]], axis=1) / mass
        spread = jacobian @ covariance[6:, 6:] @ jacobian.T
        centre_error = jnp.where(
            mass > 2.0 * mass_error, jnp.sqrt(jnp.diagonal(spread)), jnp.full(3, jnp.inf)
        )
        never = jnp.full((), -1.0, mass.dtype)
        decided = (
            (jnp.asarray(False), never, never)
            if before is None
            else (before.carrying, before.picked_up, before.put_down)
        )
        return PayloadEstimate(
            body, covariance, mass, mass_error, centre, centre_error, *decided, change
        )
