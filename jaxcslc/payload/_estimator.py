"""Recursive identification of a payload from encoder readings and torque commands.

`possible_body` keeps the estimate physically consistent, and `torque_noise` weights the
equations.
"""

import equinox as eqx
import jax
import jax.numpy as jnp
import numpy as np
from jax.core import Tracer
from jaxtyping import Array, Bool, Float

from ..bodies import pseudo_inertia
from ..control import LowPassChain
from ..least_squares import Identification
from ..network import CSLC
from ..recordings import Patterns
from ._change_detection import (
    PRIOR_DEVIATION,
    PayloadEstimate,
    PayloadState,
    RecursiveEquations,
    absence_evidence,
    disagreement,
    likelihood_ratio,
    payload_evidence,
)


def torque_noise(
    network: CSLC,
    k: Float[Array | np.ndarray, " coefficients"],
    patterns: Patterns,
    *,
    block: float = 0.25,
) -> Float[np.ndarray, " joints"]:
    """Spectral density of the torque's slow errors at each joint [N² m² s].

    The difference between an unloaded arm's torque and its model is not white: most of it is model
    error, which lasts as long as a pose or a direction of motion. A payload is identified by
    averaging over time, and the mean over T seconds has the variance density / T; it is measured
    over blocks of `block` seconds. White noise of standard deviation σ at a sampling interval h has
    the density σ² h.

    **Arguments**

    - `network`, `k`: (p,) the unloaded arm.
    - `patterns`: of another recording than that which `k` was identified from. Masked samples are
      left out, and blocks of which more than half is masked.
    - `block`: longer than the errors are correlated, shorter than a tenth of the recording [s].

    **Returns**

    (n,) [N² m² s].

    **Raises**

    - `ValueError`: a joint has fewer than four such blocks; names it.

    >>> import jax.numpy as jnp, numpy as np, jaxcslc as jc
    >>> from jaxcslc.payload import torque_noise
    >>> arm = jc.Manipulator.from_modified_dh([(0, 0, 0, 0)], gravity=(0, 0, -9.81))
    >>> network, t = jc.derive(arm, lengths="numeric"), 0.002 * np.arange(5000)[:, None]
    >>> every, noise = np.ones(t.shape, bool), np.random.default_rng(0).normal(size=t.shape)
    >>> patterns = jc.Patterns(t[:, 0], t, 0 * t, 0 * t, 0.1 * noise, every, every)
    >>> bool(abs(torque_noise(network, jnp.zeros(3), patterns)[0] / (0.1**2 * 0.002) - 1) < 0.5)
    True
    """
    residual = np.asarray(patterns.torque) - np.asarray(
        network.torque(jnp.asarray(k), patterns.q, patterns.qd, patterns.qdd)
    )
    time = np.asarray(patterns.time)
    mask = np.asarray(patterns.mask)
    number = np.floor((time - time[0]) / block).astype(int)
    size = np.bincount(number)
    density = np.empty(residual.shape[1])
    for joint in range(len(density)):
        counted = mask[:, joint]
        samples = np.bincount(number, weights=counted)
        total = np.bincount(number[counted], weights=residual[counted, joint], minlength=len(size))
        enough = samples >= 0.5 * np.max(size)
        if np.count_nonzero(enough) < 4:
            raise ValueError(
                f"joint {joint + 1}: {np.count_nonzero(enough)} blocks of {block:g} s in which it"
                " moves; expected four or more: record for longer"
            )
        # The mean is over the unmasked part of a block, which is that much shorter.
        length = block * samples[enough] / np.max(size)
        density[joint] = np.mean(length * (total[enough] / samples[enough]) ** 2)
    return density


# J(body) is linear in the ten parameters: the matrices that they multiply, and the inverse map.
_BASIS = np.stack([pseudo_inertia(unit) for unit in np.eye(10)])
_BACK = np.linalg.pinv(_BASIS.reshape(10, 16).T)
_DENSITY = 2700.0  # of aluminium [kg/m³]: the size of the initial body
# The target for the complementarity, as a fraction of the present one, and its smallest value in
# squared standard errors: iterations converge at this distance from the boundary.
_CENTRING = 0.2
_SMALLEST_TARGET = 1e-4
_STEP_FRACTION = 0.95


def possible_body(
    estimate: Float[Array, "10"], information: Float[Array, "10 10"], *, steps: int = 12
) -> Float[Array, "10"]:
    """The physically possible body nearest to an estimate, in the metric of the estimate.

    A body is possible if and only if its pseudo-inertia J is positive definite (Wensing, Kim and
    Slotine 2018). This minimises ½ (x − x̂)' Λ (x − x̂) under that condition, by a primal-dual
    interior-point method on the 4 by 4 matrix, from a ball of the estimate's mass and centre. It
    is `jaxcslc.bodies.nearest_body` for `jit`, `vmap` and control loops. Every iterate is
    possible, and so is the result after any number of steps. A dozen steps leave the squared
    distance within 0.01 of the minimum; for bodies of nearly no mass, within a few units.

    Two other methods were slower: after forty steps Newton's method on a logarithmic barrier was
    0.2 to 10 squared standard errors from the minimum, and Levenberg-Marquardt over a Cholesky
    factor of J, which loses rank where measured bodies lie, 0.1 to 10.

    **Arguments**

    - `estimate`: x̂, (10,) in the order of `BODY`.
    - `information`: Λ, (10, 10), positive definite: the inverse of the covariance.
    - `steps`: number of iterations.

    **Returns**

    The ten parameters, (10,).

    >>> import jax.numpy as jnp, numpy as np
    >>> from jaxcslc.bodies import pseudo_inertia
    >>> from jaxcslc.payload import possible_body
    >>> estimate = jnp.array([-0.01, 0.02, 0.02, 0, 0, 0, 0.1, 0, 0, 2.0])  # Ixx below zero
    >>> body = possible_body(estimate, 1e6 * jnp.eye(10))
    >>> bool(np.all(np.linalg.eigvalsh(pseudo_inertia(np.asarray(body))) > 0))
    True
    """
    basis, back = jnp.asarray(_BASIS, estimate.dtype), jnp.asarray(_BACK, estimate.dtype)
    flat, unit = basis.reshape(10, 16), jnp.eye(4, dtype=estimate.dtype)
    # In units of the initial body, its pseudo-inertia is the identity.
    half = jnp.linalg.cholesky(jnp.tensordot(_ball(estimate, information), basis, 1))
    units = back @ jnp.einsum("ab,ibc,dc->iad", half, basis, half).reshape(10, 16).T
    metric = units.T @ information @ units
    goal = jnp.linalg.solve(units, estimate)
    start = back @ unit.reshape(16)
    dual_scale = jnp.max(jnp.abs(metric @ (start - goal)))

    def iterate(state: tuple[Array, Array], _: None) -> tuple[tuple[Array, Array], None]:
        x, dual = state
        primal = jnp.tensordot(x, basis, 1)
        lower = jnp.linalg.cholesky(primal)
        inverse = jax.scipy.linalg.cho_solve((lower, True), unit)
        target = jnp.maximum(_CENTRING * jnp.sum(primal * dual) / 4.0, _SMALLEST_TARGET)
        # Newton's step for Λ (x − x̂) = ⟨basis, Z⟩ and J Z = target: Helmberg et al. (1996).
        curvature = jnp.einsum("iab,jba->ij", basis, inverse @ basis @ dual)
        gradient = metric @ (x - goal) - target * flat @ inverse.reshape(16)
        step = jnp.linalg.solve(metric + 0.5 * (curvature + curvature.T), -gradient)
        primal_step = jnp.tensordot(step, basis, 1)
        dual_step = target * inverse - dual - inverse @ primal_step @ dual
        dual_step = 0.5 * (dual_step + dual_step.T)
        # One length for both: the dual's residual depends on the primal.
        length = jnp.minimum(
            _step_length(lower, primal_step), _step_length(jnp.linalg.cholesky(dual), dual_step)
        )
        return (x + length * step, dual + length * dual_step), None

    initial = (start, jnp.maximum(dual_scale, 1e-3) * unit)
    (solution, _), _ = jax.lax.scan(iterate, initial, length=steps)
    return units @ solution


def _step_length(lower: Float[Array, "4 4"], step: Float[Array, "4 4"]) -> Float[Array, ""]:
    """The part of a step that stays inside the cone, at a distance from its boundary."""
    white = jax.scipy.linalg.solve_triangular(lower, step, lower=True)
    white = jax.scipy.linalg.solve_triangular(lower, white.T, lower=True)
    least = jnp.min(jnp.linalg.eigvalsh(white))
    return jnp.where(
        least < -_STEP_FRACTION, _STEP_FRACTION / jnp.maximum(-least, _STEP_FRACTION), 1.0
    )


def _ball(estimate: Float[Array, "10"], information: Float[Array, "10 10"]) -> Float[Array, "10"]:
    """An aluminium ball of about the estimate's mass around about its centre."""
    mass = jnp.maximum(estimate[9], 1.0 / jnp.sqrt(information[9, 9]))
    centre = estimate[6:9] / mass
    # ∫ x² dm of a ball is a fifth of m r².
    spread = 0.2 * mass * jnp.maximum((mass / (4.0 / 3.0 * np.pi * _DENSITY)) ** (2 / 3), 1e-3)
    about = jnp.sum(centre**2) * jnp.ones(3) - centre**2
    x, y, z = centre
    return jnp.concatenate(
        [
            2.0 * spread + mass * about,
            -mass * jnp.stack([x * y, x * z, y * z]),
            mass * centre,
            mass[None],
        ]
    )


Joints = Float[Array | np.ndarray, " joints"]
_SIZE = len(PRIOR_DEVIATION)
# After this time of motion a payload is decided on even if its mass is not accurate.
_LONGEST_UNDECIDED = 1.0  # s
# Evidence or disagreement of so many thresholds needs no detection time: neither noise nor a moment
# of stiction causes it.
_CERTAIN = 20.0
# A mass of so many standard errors is above zero.
_SIGNIFICANT = 4.0
# All joints below their thresholds for so long is a standstill, where payloads change [s].
_STANDSTILL = 0.1


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
      `evidence_threshold` for `detection_time`, the estimate is from these equations. It is
      published as soon as the mass is accurate to `mass_tolerance` or above zero by four standard
      errors, or, for an arm that hardly senses the mass, after a second of motion.
    - **Putting down.** While a payload is carried, the cumulative sum of the logarithms of how much
      better no payload predicts a sample than the payload so far, against the same threshold.
    - **Another payload.** A second estimator with a short forgetting time is compared with the
      first. If they disagree by more than `detection_threshold` for `detection_time`, the equations
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
    - `short_forgetting_time`: the same for change detection [s].
    - `evidence_threshold`: natural logarithm of the likelihood ratio at which a payload has been
      picked up or put down. Noise as `noise` says exceeds it with a probability of exp(−threshold)
      from one standstill to the next, at most.
    - `detection_threshold`: χ² of ten degrees of freedom that noise does not exceed.
    - `detection_time`: how long either has to be exceeded, in motion [s]; twenty times the
      threshold counts at once.
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
    short_forgetting_time: float
    evidence_threshold: float
    detection_threshold: float
    detection_time: float
    mass_tolerance: float
    update_every: int = eqx.field(static=True)

    def __init__(
        self,
        network: CSLC,
        fixed: Identification | Float[Array | np.ndarray, " coefficients"],
        noise: Joints,
        *,
        velocity_threshold: Joints | float = 0.05,
        filter: LowPassChain | None = None,
        forgetting_time: float = 10.0,
        short_forgetting_time: float = 0.3,
        evidence_threshold: float = 10.0,
        detection_threshold: float = 60.0,
        detection_time: float = 0.1,
        mass_tolerance: float = 0.05,
        update_every: int = 10,
    ) -> None:
        """An estimator for one arm.

        **Arguments**

        - `network`: of the arm, with or without payload.
        - `fixed`: the arm's coefficients: an `Identification`, whose covariance is used, or exact
          ones, (p,).
        - `noise`: (n,) from `torque_noise`.
        - the others: as the attributes. The filter has four lags of 12 Hz if omitted. (Y of the
          filtered motion is not the filtered Y: at 8 Hz, masses were 0.3 to 0.5 % too small.)

        **Raises**

        - `ValueError`: a wrong number of coefficients or joints, or noise that is not above 0.
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
        self.short_forgetting_time = short_forgetting_time
        self.evidence_threshold = evidence_threshold
        self.detection_threshold, self.detection_time = detection_threshold, detection_time
        self.mass_tolerance, self.update_every = mass_tolerance, update_every

    @eqx.filter_jit
    def begin(self, q: Joints) -> PayloadState:
        """The state before the first sample, without payload, with the joints at rest.

        **Arguments**

        - `q`: encoder readings, (n,) [rad or m].
        """
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
        """The state after another sample, with the new `estimate`.

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
        """The state after an update of the estimate."""
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
        """The state with the equations of another sample, and with the evidence for a change."""
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
            short_term=updated(state.short_term, self.short_forgetting_time),
            candidate=candidate.reset(dropped),
            candidate_time=jnp.where(dropped, 0.0, state.candidate_time + elapsed),
            absence=absence,
            estimate=before._replace(evidence=evidence),
        )

    def _decided(self, state: PayloadState) -> PayloadState:
        """The state with a new estimate, after decisions on whether there is a payload."""
        before = state.estimate
        exceeded = (before.evidence > self.evidence_threshold) & ~state.undecided
        certain = before.evidence > _CERTAIN * self.evidence_threshold
        evident = exceeded & ((state.evidence_time > self.detection_time) | certain)
        gone, appeared = evident & before.carrying, evident & ~before.carrying
        long_term = state.long_term.replaced(state.candidate, evident)
        motion_time = jnp.where(evident, state.candidate_time, state.motion_time)

        change = disagreement(long_term, state.short_term)
        # A payload that is just beginning to be identified is not tested for changes.
        exceeded = (change > self.detection_threshold) & (motion_time > self.short_forgetting_time)
        exceeded = exceeded & before.carrying & ~evident
        disagreement_time = jnp.where(exceeded, state.disagreement_time, 0.0)
        certain = exceeded & (change > _CERTAIN * self.detection_threshold)
        changed = (disagreement_time > self.detection_time) | certain
        # Both have equations from before the change as well: none are kept.
        long_term = long_term.reset(changed)
        short_term = state.short_term.reset(changed | evident)
        motion_time = jnp.where(changed, 0.0, motion_time)
        disagreement_time = jnp.where(changed, 0.0, disagreement_time)

        estimate = self._estimate(long_term, before, change)
        undecided = state.undecided | changed | appeared
        accurate = (estimate.mass_error < self.mass_tolerance) & (motion_time > self.detection_time)
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
        estimate = jax.tree_util.tree_map(
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
        """The estimate from equations; decisions are those of the estimate before."""
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
        never = jnp.full((), -1.0, mass.dtype)
        decisions = (
            (jnp.asarray(False), never, never)
            if before is None
            else (before.carrying, before.picked_up, before.put_down)
        )
        return PayloadEstimate(
            body,
            covariance,
            mass,
            mass_error,
            centre,
            centre_error,
            *decisions,
            change,
            jnp.zeros_like(mass) if before is None else before.evidence,
        )
