"""Recursive identification of a payload, and control that compensates it.

`PayloadEstimator` turns encoder readings and torque commands into a `PayloadEstimate`, sample by
sample; `PayloadCompensation` controls an arm with it. `_equations` has their mathematics.
"""

from typing import ClassVar, NamedTuple

import equinox as eqx
import jax
import jax.numpy as jnp
import numpy as np
from jax.core import Tracer
from jaxtyping import Array, Bool, Float, Int

from ..control import (
    AbstractController,
    ComputedTorque,
    LowPassChain,
    OutputFeedback,
    OutputFeedbackState,
    Reference,
)
from ..least_squares import Identification
from ..network import CSLC
from ._equations import (
    PRIOR_DEVIATION,
    RecursiveEquations,
    absence_evidence,
    disagreement,
    likelihood_ratio,
    payload_evidence,
    possible_body,
)


class PayloadEstimate(NamedTuple):
    """The estimate of a payload at one instant, in the frame of the link that carries it.

    **Attributes**

    - `body`: its ten inertial parameters in the order of `BODY`, physically possible.
    - `covariance`: of the unconstrained estimate, (10, 10).
    - `mass`, `mass_error`: and its standard error [kg].
    - `centre`, `centre_error`: centre of gravity and its standard error, (3,) [m]; the error is
      infinite while the mass may be zero.
    - `carrying`: whether there is a payload, as decided last; see `PayloadEstimator`.
    - `picked_up`, `put_down`: when that was detected last [s since `begin`]; −1 for never.
    - `change`: disagreement of the latest motion with the estimate: χ² of ten degrees of freedom.
    - `evidence`: for the next change, the natural logarithm of its likelihood ratio: for a payload
      while there is none, for none while there is one.
    """

    body: Float[Array, "10"]
    covariance: Float[Array, "10 10"]
    mass: Float[Array, ""]
    mass_error: Float[Array, ""]
    centre: Float[Array, "3"]
    centre_error: Float[Array, "3"]
    carrying: Bool[Array, ""]
    picked_up: Float[Array, ""]
    put_down: Float[Array, ""]
    change: Float[Array, ""]
    evidence: Float[Array, ""]


class PayloadState(NamedTuple):
    """The memory of a `PayloadEstimator`.

    **Attributes**

    - `position`: the latest reading, (n,) [rad or m].
    - `torque`: the torque command for it, (n,) [N m or N].
    - `motion`, `effort`: states of the filters on readings and on torques, (lags, n).
    - `samples`, `time`: since `begin` [1], [s].
    - `since_update`: time since the latest update [s].
    - `motion_time`: time in motion since the last reset [s].
    - `rest_time`: time for which all joints have been at rest [s].
    - `disagreement_time`, `evidence_time`: time in motion for which the disagreement, or the
      evidence, has exceeded its threshold [s].
    - `long_term`, `short_term`: equations of the present payload, and of the latest motion.
    - `candidate`, `candidate_time`: equations since the last standstill before which nothing spoke
      for a change, and time in motion since then [s].
    - `absence`: cumulative sum of the evidence against the payload that is carried.
    - `undecided`: whether there is a payload is unknown, after a change.
    - `estimate`: the present `PayloadEstimate`.
    """

    position: Float[Array, " joints"]
    torque: Float[Array, " joints"]
    motion: Float[Array, "lags joints"]
    effort: Float[Array, "lags joints"]
    samples: Int[Array, ""]
    time: Float[Array, ""]
    since_update: Float[Array, ""]
    motion_time: Float[Array, ""]
    rest_time: Float[Array, ""]
    disagreement_time: Float[Array, ""]
    evidence_time: Float[Array, ""]
    long_term: RecursiveEquations
    short_term: RecursiveEquations
    candidate: RecursiveEquations
    candidate_time: Float[Array, ""]
    absence: Float[Array, ""]
    undecided: Bool[Array, ""]
    estimate: PayloadEstimate


Joints = Float[Array | np.ndarray, " joints"]
_SIZE = len(PRIOR_DEVIATION)
# Of decisions on payloads: `scripts/studies/payload/study.py` counts their errors and delays.
_LONGEST_UNDECIDED = 1.0  # of motion; then a payload is decided on without an accurate mass [s]
_DETECTION_TIME = 0.1  # for which evidence or disagreement exceed their thresholds, in motion [s]
_CERTAIN = 20.0  # thresholds that need no detection time: neither noise nor stiction causes them
_SIGNIFICANT = 4.0  # standard errors by which a mass is above zero
_STANDSTILL = 0.1  # of all joints, where payloads change [s]
_SHORT_FORGETTING = 0.3  # forgetting time of the equations that are tested for a change [s]


class PayloadEstimator(eqx.Module):
    """Recursive identification of a payload's ten inertial parameters (thesis 8.2.4).

    From encoder readings and torque commands, sample by sample. The arm's coefficients are fixed
    at those identified before.

    - **Motion.** Readings and torques pass through equal causal filters (`LowPassChain`), so that
      the filtered torque belongs to the filtered motion, whatever their common delay.
    - **Recursive least squares** on Y_p x = torque − Y k, with forgetting: the information matrix
      and its right-hand side, with a weak prior around no payload. Equations of a joint below
      `velocity_threshold`, which may stick, have no weight.
    - **Errors.** Equations are weighted by the spectral density of the torque's slow errors
      (`torque_noise`), so that a second of correlated samples does not count as five hundred
      independent ones. The covariance of the arm's coefficients, if known, is propagated.
    - **Possible.** The estimated body is physically possible at every sample (`possible_body`).
    - **Picking up.** An arm without payload has x = 0 exactly: equations since the last standstill
      are tested against that, by the logarithm of the Bayes factor of a payload. They are
      kept over standstills as long as they speak for a payload, so that several short motions count
      together, and dropped there otherwise (a cumulative sum: Page 1954). If the evidence exceeds
      `evidence_threshold` for 0.1 s, the estimate is from these equations. It is
      published as soon as the mass is accurate to `mass_tolerance` or above zero by four standard
      errors, or, for an arm that barely senses the mass, after a second of motion.
    - **Putting down.** While a payload is carried, the cumulative sum of the logarithms of how much
      better no payload predicts a sample than the payload so far, against the same threshold.
    - **Another payload.** A second estimator with a short forgetting time is compared with the
      first. If they disagree by more than `detection_threshold` for 0.1 s, the equations
      are dropped and the payload is identified again; the published estimate does not change until
      the new one can be published, as above. At rest nothing is identified, since friction holds
      the payload.

    Needs float64. Numbers are leaves; `step` is pure: `jit` it, `scan` over it, `vmap` over arms.

    **Attributes**

    - `network`: with payload (`CSLC.with_payload`).
    - `k`, `covariance`: of the arm, (p,) and (p, p).
    - `noise`: (n,) [N² m² s].
    - `velocity_threshold`: (n,) [rad/s or m/s].
    - `filter`: of readings and torques.
    - `forgetting_time`: over which the weight of an equation falls by a factor e [s]; from update
      to update the forgetting factor is exp(−interval / forgetting time).
    - `evidence_threshold`: natural logarithm of the likelihood ratio at which a payload has been
      picked up or put down. Noise as `noise` says exceeds it with a probability of exp(−threshold)
      from one standstill to the next, at most.
    - `detection_threshold`: χ² of ten degrees of freedom that noise does not exceed. This and the
      evidence have to be exceeded for 0.1 s in motion; twenty times the threshold counts at once.
    - `mass_tolerance`: standard error of the mass at which the presence of a payload is decided,
      and a third of the least mass that is one [kg].
    - `update_every`: samples from update to update.

    >>> import jax, jax.numpy as jnp, numpy as np, jaxcslc as jc
    >>> from jaxcslc.payload import PayloadEstimator
    >>> arm = jc.Manipulator.from_modified_dh([(0, 0, 0, 0)], gravity=(0, -9.81, 0))
    >>> network = jc.derive(arm.with_friction(), lengths="numeric").with_payload()
    >>> ball = jc.LinkParameters(2.0, np.array([0.5, 0.0, 0.0]), 0.01 * np.eye(3))
    >>> massless = jc.LinkParameters(0.0, np.zeros(3), np.zeros((3, 3)))
    >>> k = network.coefficients_from([massless], payload=ball)
    >>> t = 0.002 * np.arange(1500)[:, None]
    >>> q, qd, qdd = -np.cos(3 * t), 3 * np.sin(3 * t), 9 * np.cos(3 * t)  # from rest
    >>> torque = network.torque(k, q, qd, qdd)
    >>> estimator = PayloadEstimator(network, k[network.layout.unloaded], noise=np.array([1e-4]))
    >>> def step(state, sample):
    ...     return estimator.step(state, *sample, 0.002), None
    >>> state, _ = jax.lax.scan(step, estimator.begin(jnp.asarray(q[0])), (q, torque))
    >>> moment = state.estimate.body[6]  # one joint determines m x, not the mass
    >>> bool(abs(moment - 1.0) < 0.02)
    True
    """

    network: CSLC
    k: Float[Array, " coefficients"]
    covariance: Float[Array, "coefficients coefficients"]
    noise: Float[Array, " joints"]
    velocity_threshold: Float[Array, " joints"]
    filter: LowPassChain
    forgetting_time: float
    detection_threshold: float
    evidence_threshold: ClassVar[float] = 10.0
    mass_tolerance: ClassVar[float] = 0.05
    update_every: ClassVar[int] = 10

    def __init__(
        self,
        network: CSLC,
        fixed: Identification | Float[Array | np.ndarray, " coefficients"],
        noise: Joints,
        *,
        velocity_threshold: Joints | float = 0.05,
        filter: LowPassChain | None = None,
        forgetting_time: float = 10.0,
        detection_threshold: float = 60.0,
    ) -> None:
        """Make an estimator for one arm.

        **Arguments**

        - `network`: of the arm, with or without payload.
        - `fixed`: the arm's coefficients: an `Identification`, whose covariance is used, or exact
          ones, (p,).
        - `noise`: (n,) from `torque_noise`.
        - the others: as the attributes. The filter has four lags of 12 Hz if omitted. (Y of the
          filtered motion is not the filtered Y: at 8 Hz, masses were 0.3 to 0.5 % too small.)

        **Raises** `ValueError`: a wrong number of coefficients or joints, or noise that is not
        above 0.
        """
        self.network = network if network.payload is not None else network.with_payload()
        arm, n = self.network.layout.unloaded.stop, self.network.joint_count
        identified = isinstance(fixed, Identification)
        self.k = jnp.asarray(fixed.k if identified else fixed)
        if self.k.shape != (arm,):
            raise ValueError(f"fixed: expected {arm} coefficients, got {self.k.shape}")
        self.covariance = fixed.covariance if identified else jnp.zeros((arm, arm))
        self.noise = jnp.asarray(noise, float)
        if self.noise.shape != (n,):
            raise ValueError(f"noise: expected {n} values, one a joint, got {self.noise.shape}")
        if not isinstance(self.noise, Tracer) and not np.all(np.asarray(self.noise) > 0):
            raise ValueError(f"noise is {np.asarray(self.noise).tolist()}; expected more than 0")
        self.velocity_threshold = jnp.broadcast_to(jnp.asarray(velocity_threshold, float), (n,))
        self.filter = LowPassChain(12.0, lags=4) if filter is None else filter
        if self.filter.lags < 3:
            raise ValueError(f"filter has {self.filter.lags} lags; accelerations need 3 or more")
        self.forgetting_time = forgetting_time
        self.detection_threshold = detection_threshold

    @eqx.filter_jit
    def begin(self, q: Joints) -> PayloadState:
        """Return the state before the first sample, without payload, at rest at readings `q`."""
        q = jnp.asarray(q, self.k.dtype)
        zeros, zero = jnp.zeros_like(q), jnp.zeros((), q.dtype)
        empty = RecursiveEquations.empty(_SIZE, self.k.shape[0], q.dtype)
        return PayloadState(
            position=q,
            torque=zeros,
            motion=self.filter.begin(q),
            effort=self.filter.begin(zeros),
            samples=jnp.asarray(0),
            time=zero,
            since_update=zero,
            motion_time=zero,
            rest_time=zero,
            disagreement_time=zero,
            evidence_time=zero,
            long_term=empty,
            short_term=empty,
            candidate=empty,
            candidate_time=zero,
            absence=zero,
            undecided=jnp.asarray(False),
            estimate=self._estimate(empty, None, zero),
        )

    def step(
        self, state: PayloadState, q: Joints, torque: Joints, interval: float | Array
    ) -> PayloadState:
        """Return the state after another sample, with the new `estimate`.

        **Arguments**

        - `state`: as the previous step returned it.
        - `q`: encoder readings, (n,) [rad or m]; NaN where one is lost.
        - `torque`: the command for these readings, applied until the next, (n,) [N m or N].
        - `interval`: since the previous sample [s].
        """
        q, torque = (jnp.asarray(x, self.k.dtype) for x in (q, torque))
        q = jnp.where(jnp.isnan(q), state.position, q)
        first = state.samples == 0
        # The previous command acted until now. Before the first sample the arm was held by the
        # torque of the first command.
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
            since_update=state.since_update + interval,
        )
        due = state.samples % self.update_every == 0
        return jax.lax.cond(due, lambda: self._updated(state), lambda: state)

    def _updated(self, state: PayloadState) -> PayloadState:
        """Return the state after an update of the estimate."""
        q, qd, qdd = self.filter.read(state.motion)
        torque = self.filter.read(state.effort).value
        rows = self.network.regressor(q, qd, qdd)
        layout = self.network.layout
        arm_rows, payload_rows = rows[:, layout.unloaded], rows[:, layout.payload]
        residual = torque - arm_rows @ self.k
        moving = jnp.abs(qd) > self.velocity_threshold
        weight = jnp.where(moving, state.since_update / self.noise, 0.0)
        sample = RecursiveEquations.of_sample(payload_rows, arm_rows, residual, weight)
        against = absence_evidence(state.long_term, payload_rows, residual, weight)
        return self._decided(self._accumulated(state, sample, against, jnp.any(weight > 0)))

    def _accumulated(
        self,
        state: PayloadState,
        sample: RecursiveEquations,
        against: Float[Array, ""],
        moving: Bool[Array, ""],
    ) -> PayloadState:
        """Return the state with another sample's equations, and the evidence for a change."""
        elapsed = jnp.where(moving, state.since_update, 0.0)
        rest_time = jnp.where(moving, 0.0, state.rest_time + state.since_update)

        def updated(equations: RecursiveEquations, time: float | Array) -> RecursiveEquations:
            return equations.with_sample(sample, jnp.exp(-state.since_update / time))

        before = state.estimate
        absence = jnp.maximum(state.absence + against, 0.0)
        absence = jnp.where(before.carrying & ~state.undecided, absence, 0.0)
        candidate = updated(state.candidate, self.forgetting_time)
        evidence = jnp.where(before.carrying, absence, payload_evidence(candidate))
        dropped = (rest_time > _STANDSTILL) & (evidence <= 0.0)
        exceeded = (evidence > self.evidence_threshold) & ~state.undecided
        return state._replace(
            since_update=jnp.zeros_like(state.since_update),
            motion_time=state.motion_time + elapsed,
            rest_time=rest_time,
            disagreement_time=state.disagreement_time + elapsed,
            evidence_time=jnp.where(exceeded, state.evidence_time + elapsed, 0.0),
            long_term=updated(state.long_term, self.forgetting_time),
            short_term=updated(state.short_term, _SHORT_FORGETTING),
            candidate=candidate.reset(dropped),
            candidate_time=jnp.where(dropped, 0.0, state.candidate_time + elapsed),
            absence=absence,
            estimate=before._replace(evidence=evidence),
        )

    def _decided(self, state: PayloadState) -> PayloadState:
        """Return the state with a new estimate, after decisions on whether there is a payload."""
        before = state.estimate
        exceeded = (before.evidence > self.evidence_threshold) & ~state.undecided
        certain = before.evidence > _CERTAIN * self.evidence_threshold
        evident = exceeded & ((state.evidence_time > _DETECTION_TIME) | certain)
        gone, appeared = evident & before.carrying, evident & ~before.carrying
        long_term = state.long_term.replaced(state.candidate, evident)
        motion_time = jnp.where(evident, state.candidate_time, state.motion_time)

        change = disagreement(long_term, state.short_term)
        # A payload that is just beginning to be identified is not tested for changes.
        exceeded = (change > self.detection_threshold) & (motion_time > _SHORT_FORGETTING)
        exceeded = exceeded & before.carrying & ~evident
        disagreement_time = jnp.where(exceeded, state.disagreement_time, 0.0)
        certain = exceeded & (change > _CERTAIN * self.detection_threshold)
        changed = (disagreement_time > _DETECTION_TIME) | certain
        # Both have equations from before the change as well: none are kept.
        long_term = long_term.reset(changed)
        short_term = state.short_term.reset(changed | evident)
        motion_time = jnp.where(changed, 0.0, motion_time)
        disagreement_time = jnp.where(changed, 0.0, disagreement_time)

        estimate = self._estimate(long_term, before, change)
        undecided = state.undecided | changed | appeared
        accurate = (estimate.mass_error < self.mass_tolerance) & (motion_time > _DETECTION_TIME)
        significant = estimate.mass > _SIGNIFICANT * estimate.mass_error
        decidable = accurate | significant | (motion_time > _LONGEST_UNDECIDED)
        explained = likelihood_ratio(long_term, estimate.body) > self.evidence_threshold
        loaded = jnp.where(accurate, estimate.mass > 3.0 * self.mass_tolerance, explained)
        decided = undecided & decidable
        up, down = decided & loaded, (decided & ~loaded & before.carrying) | gone
        estimate = estimate._replace(
            carrying=jnp.where(decided, loaded, before.carrying & ~gone),
            picked_up=jnp.where(up, state.time, before.picked_up),
            put_down=jnp.where(down, state.time, before.put_down),
        )
        undecided = (undecided & ~decidable) | ~jnp.all(jnp.isfinite(estimate.body))
        unchanged = before._replace(change=change)
        estimate = jax.tree.map(
            lambda old, new: jnp.where(undecided, old, new), unchanged, estimate
        )
        settled = decided | gone
        return state._replace(
            long_term=long_term,
            short_term=short_term,
            candidate=state.candidate.reset(settled),
            candidate_time=jnp.where(settled, 0.0, state.candidate_time),
            absence=jnp.where(settled, 0.0, state.absence),
            motion_time=motion_time,
            disagreement_time=disagreement_time,
            evidence_time=jnp.where(settled, 0.0, state.evidence_time),
            undecided=undecided,
            estimate=estimate,
        )

    def _estimate(
        self, equations: RecursiveEquations, before: PayloadEstimate | None, change: Array
    ) -> PayloadEstimate:
        """Return the estimate from equations; decisions are those of the estimate before."""
        information = equations.posterior_information
        mean = jnp.linalg.solve(information, equations.moment)
        inverse = jnp.linalg.inv(information)
        # Errors of the arm's coefficients δk shift the estimate by −P C δk.
        sensitivity = inverse @ equations.cross
        covariance = inverse + sensitivity @ self.covariance @ sensitivity.T
        body = possible_body(mean, information)
        mass, moment = body[9], body[6:9]
        centre = moment / mass
        mass_error = jnp.sqrt(covariance[9, 9])
        # Delta method: δc = (δh − c δm) / m.
        jacobian = jnp.concatenate([jnp.eye(3), -centre[:, None]], axis=1) / mass
        centre_covariance = jacobian @ covariance[6:, 6:] @ jacobian.T
        centre_error = jnp.where(
            mass > 2.0 * mass_error, jnp.sqrt(jnp.diagonal(centre_covariance)), jnp.full(3, jnp.inf)
        )
        never, zero = jnp.full((), -1.0, mass.dtype), jnp.zeros_like(mass)
        decisions = (jnp.asarray(False), never, never, change, zero)
        if before is not None:
            times = before.carrying, before.picked_up, before.put_down
            decisions = (*times, change, before.evidence)
        return PayloadEstimate(body, covariance, mass, mass_error, centre, centre_error, *decisions)


_TRANSITION = 0.05  # time constant of the change of the model to a new estimate [s]


class PayloadCompensationState(NamedTuple):
    """The memory of a `PayloadCompensation` controller.

    **Attributes**

    - `feedback`: state of the feedback controller.
    - `estimator`: state of the estimator; `estimator.estimate` is the present estimate.
    - `body`: the compensated payload, (10,); it follows the estimate without a jump.
    """

    feedback: OutputFeedbackState
    estimator: PayloadState
    body: Float[Array, "10"]


class PayloadCompensation(AbstractController):
    """Computed-torque control that identifies and compensates a payload on-line (thesis 8.2.4).

    An `OutputFeedback` and a `PayloadEstimator` share the readings. When a payload has been
    detected, its ten parameters become part of the model that the controller inverts; when it has
    been put down they are zero again. They change gradually, since a step in the model is a step
    in the torque.

    One robot, (n,); `jax.vmap` over several.

    **Attributes**

    - `controller`: with the network and the coefficients of the unloaded arm, as the estimator.
    - `estimator`: of the payload.
    - `compensation_gain`: 1 to compensate the estimate, 0 to estimate only.

    >>> import jax, jax.numpy as jnp, numpy as np, jaxcslc as jc
    >>> from jaxcslc.control import ComputedTorque, Reference
    >>> from jaxcslc.payload import PayloadCompensation, PayloadEstimator
    >>> network = jc.derive(jc.puma560())
    >>> k = network.coefficients_from(jc.puma560().links)
    >>> estimator = PayloadEstimator(network, k, noise=np.full(6, 1e-4))
    >>> controller = PayloadCompensation(ComputedTorque(network, k, 20.0), estimator)
    >>> q = jnp.zeros(6)
    >>> step = jax.jit(lambda *inputs: controller.step(*inputs))
    >>> torque, state = step(controller.begin(q), Reference.at_rest(q), q, 0.002)
    >>> bool(state.estimator.estimate.carrying)
    False
    """

    controller: ComputedTorque
    estimator: PayloadEstimator
    compensation_gain: float | Float[Array, ""]

    def __init__(
        self,
        controller: ComputedTorque,
        estimator: PayloadEstimator,
        *,
        compensation_gain: float | Float[Array, ""] = 1.0,
    ) -> None:
        """Make a controller with payload compensation.

        **Arguments** are the attributes.

        **Raises** `ValueError`: controller and estimator have different networks.
        """
        arm_k = controller.k[controller.network.layout.unloaded]
        if arm_k.shape != estimator.k.shape:
            raise ValueError(
                f"the controller's network has {len(arm_k)} coefficients of the arm, the"
                f" estimator's {estimator.k.shape[0]}; expected the same network"
            )
        k = jnp.concatenate([arm_k, jnp.zeros(10)])
        controller = controller.with_coefficients(k, estimator.network)
        self.controller, self.estimator = controller, estimator
        self.compensation_gain = compensation_gain

    def begin(self, q: Float[Array | np.ndarray, " joints"]) -> PayloadCompensationState:
        """Return the state before the first sample, without payload."""
        feedback = OutputFeedback(self.controller).begin(q)
        return PayloadCompensationState(feedback, self.estimator.begin(q), jnp.zeros(10))

    def step(
        self,
        state: PayloadCompensationState,
        reference: Reference,
        q: Float[Array | np.ndarray, " joints"],
        interval: float | Array,
        qd: Float[Array | np.ndarray, " joints"] | None = None,
    ) -> tuple[Float[Array, " joints"], PayloadCompensationState]:
        """Compute the torque command, as `AbstractController.step`, without measured velocities."""
        del qd
        estimate = state.estimator.estimate
        target = jnp.where(estimate.carrying, estimate.body, jnp.zeros(10))
        body = target + (state.body - target) * jnp.exp(-interval / _TRANSITION)
        payload = self.controller.network.layout.payload
        k = self.controller.k.at[payload].set(self.compensation_gain * body)
        feedback = OutputFeedback(self.controller.with_coefficients(k))
        torque, inner = feedback.step(state.feedback, reference, q, interval)
        estimator = self.estimator.step(state.estimator, q, torque, interval)
        return jnp.asarray(torque), PayloadCompensationState(inner, estimator, body)
