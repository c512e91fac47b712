"""Fits of friction beside slopes: friction in proportion to the load, and friction alone."""

import dataclasses

import equinox as eqx
import jax.numpy as jnp
import numpy as np
from jaxtyping import Array, Float

from ..least_squares import Fixed, Identification, LeastSquares, settled
from ..network import CSLC, DIRECTIONAL_LOAD, LoadedRigidBody
from ..recordings import Patterns
from ._slopes import SlopeFit, fit_slopes


# The search ends with a step that moves no coefficient by this part of its standard error. Smaller
# ones may go on for ever: a sample whose load is near zero changes the sign that it counts with.
_TOLERANCE = 0.02
_STEPS = 20
# The first steps leave slopes as they are and drop nothing: they begin at a fit without the load,
# whose rigid torque, and whose static friction, compensate for it.
_FIRST_STEPS = 2


class LoadFit(eqx.Module):
    """Coefficients with friction that grows with the load.

    **Attributes**

    - `network`: whose friction follows the rigid torque of `fit.k`, and without such friction of
      the joints of `dropped`: `network.torque(fit.k, ...)` predicts.
    - `fit`: the coefficients of `network`. Their errors allow for the load's being fitted too.
    - `slopes`: of static friction, fitted along, where the network has it.
    - `steps`: of the search; `converged`: whether it ended by its own rule.
    - `dropped`: joints, counted from 1, whose coefficient is not between 0 and 1.
    - `warnings`: one sentence for each of them, and one if the search did not converge.
    """

    network: CSLC
    fit: Identification
    slopes: SlopeFit | None
    steps: int = eqx.field(static=True)
    converged: bool = eqx.field(static=True)
    dropped: tuple[int, ...] = eqx.field(static=True)
    warnings: tuple[str, ...] = eqx.field(static=True)


def fit_load(network: CSLC, patterns: Patterns, *, solver: LeastSquares | None = None) -> LoadFit:
    """Fit all coefficients together, those of load-dependent friction included.

    Torque is then no linear function of the coefficients: friction kl sign(qd) |R| of a joint
    depends on kl and on those of the rigid torque R = Y k. Gauss and Newton's method: at k, the
    columns of the joint's rigid torque count 1 + kl sign(qd R) times, and kl sign(qd) |R| is added
    to its torque. Each step is a fit of linear equations with all options of the solver, and the
    last one's covariance is that of the coefficients.

    Below 0 the coefficient would be a friction that drives, from 1 on it would block the joint
    under any load (and accelerations would not be unique): a joint whose coefficient leaves this
    range loses its term, and the fit is repeated.

    **Arguments**

    - `network`: n joints, p coefficients; some joint has the friction term `"load"`.
    - `patterns`: as of `LeastSquares.fit`.
    - `solver`: options of the fit; the defaults of `LeastSquares` if None.

    **Returns** a `LoadFit`.

    **Raises**

    - `ValueError`: no joint has such friction, or as `LeastSquares.fit`.
    - `RuntimeError`: as `LeastSquares.fit`.

    >>> import numpy as np, jaxcslc as jc
    >>> from jaxcslc.friction import fit_load
    >>> network = jc.derive(jc.examples.pendulum("dry", "load"))
    >>> k = np.array([0.5, 0.3, -0.1, 0.2, 0.15])
    >>> result = fit_load(network, jc.examples.swing(network.with_load(k), k))
    >>> result.converged, result.fit.k.round(6).tolist()
    (True, [0.5, 0.3, -0.1, 0.2, 0.15])
    >>> k[-1] = -0.15  # friction that would drive
    >>> result = fit_load(network, jc.examples.swing(network.with_load(k), k))
    >>> result.dropped, result.network.names
    ((1,), ('kM1', 'kG1', 'kG2', 'kd1'))
    """
    if not network.load_terms:
        raise ValueError(f"{network.name!r} has no friction of kind 'load' to be fitted")
    solver = LeastSquares() if solver is None else solver
    bare = network.without_load()
    fit = solver.fit(bare, patterns)
    known = dict(zip(bare.names, np.asarray(fit.k).tolist(), strict=True))
    k = np.array([known.get(name, 0.0) for name in network.names])
    slopes: SlopeFit | None = None
    dropped: dict[int, str] = {}
    converged, steps = False, 0
    while not converged and steps < _STEPS and network.load_terms:
        steps += 1
        before = dict(zip(network.names, k.tolist(), strict=True))
        equations = linearised(network, k, patterns)
        if steps <= _FIRST_STEPS:
            fit = solver.fit(*equations)
        else:
            slopes, fit = _fitted(*equations, solver, slopes)
        if slopes is not None:
            network = _with_slopes_of(network, slopes)
        k = np.asarray(fit.k)
        last = np.array([before[name] for name in network.names])
        converged = steps > _FIRST_STEPS and settled(fit, last, _TOLERANCE)
        if steps > _FIRST_STEPS and (dropped_now := _impossible(network, fit)):
            names = network.names
            for kind, sentences in dropped_now.items():
                dropped |= sentences
                network = network.without_law(kind, tuple(sentences))
            k = np.array([k[names.index(name)] for name in network.names])
            converged = False
    if not network.load_terms:
        slopes, fit = _fitted(network, patterns, solver, slopes)
        network = network if slopes is None else slopes.network
        converged = True
    else:
        network = network.with_load(np.asarray(fit.k))
    if slopes is not None:
        slopes = dataclasses.replace(slopes, network=network, fit=fit)
    warnings = [dropped[joint] for joint in sorted(dropped)]
    if not converged:
        warnings.append(f"friction of kind 'load': not converged after {steps} steps")
    return LoadFit(network, fit, slopes, steps, converged, tuple(sorted(dropped)), tuple(warnings))


def linearised(
    network: CSLC, k: Float[Array | np.ndarray, " coefficients"], patterns: Patterns
) -> tuple[CSLC, Patterns]:
    """Network and patterns whose linear equations are those of `network` to first order at `k`.

    Both as they are for a network without friction that follows the load.
    """
    terms = network.load_terms
    if not terms:
        return network, patterns
    k = np.asarray(k, float)
    load = k[network.layout.inertial]
    motion = [np.asarray(x, float).T for x in (patterns.q, patterns.qd, patterns.qdd)]
    friction = np.zeros_like(motion[0].T)
    factors = np.zeros((2, network.joint_count))
    for term in terms:
        magnitudes = k[network.layout.term_slice(term)]
        factors += np.asarray(term.factors(jnp.asarray(magnitudes)))
        columns = dataclasses.replace(term, load=load).columns(*motion)
        for joint in term.joints:
            friction[:, joint] += magnitudes[list(term.support[joint])] @ np.asarray(columns[joint])
    rigid = LoadedRigidBody.of(terms[0].rigid, load, factors)
    equations = CSLC(algebra=network.algebra, terms=(rigid, *network.with_load(k).terms[1:]))
    return equations, dataclasses.replace(patterns, torque=np.asarray(patterns.torque) + friction)


def _fitted(
    network: CSLC, patterns: Patterns, solver: LeastSquares, before: SlopeFit | None
) -> tuple[SlopeFit | None, Identification]:
    """The fit of linear equations, with slopes of static friction where there is any."""
    if "static" not in network.robot.friction_terms:
        fit = solver.fit(network, patterns)
        return (None if before is None else dataclasses.replace(before, fit=fit)), fit
    start = None if before is None else np.asarray(before.slopes)
    slopes = fit_slopes(network, patterns, solver=solver, start=start)
    if before is not None and before.dropped:
        slopes = slopes.after(before)
    return slopes, slopes.fit


def _with_slopes_of(network: CSLC, slopes: SlopeFit) -> CSLC:
    """The network with these slopes, and without static friction where they dropped it."""
    laws = network.friction_per_joint
    if lost := tuple(joint for joint in slopes.dropped if "static" in laws[joint - 1]):
        network = network.without_law("static", lost)
    if network.static_slopes is None:
        return network
    return network.with_static_slopes(np.asarray(slopes.slopes))


def _impossible(network: CSLC, fit: Identification) -> dict[str, dict[int, str]]:
    """Find coefficients that no friction has: by kind, the joints, from 1, and a sentence each."""
    k, determined = np.asarray(fit.k), np.asarray(fit.determined)
    impossible: dict[str, dict[int, str]] = {}
    for term in network.load_terms:
        part = network.layout.term_slice(term)
        for joint in term.joints:
            indices = part.start + np.array(term.support[joint])
            name, values = network.output_names[joint], k[indices]
            why = ""
            if term.kind == DIRECTIONAL_LOAD and not determined[indices].all():
                why = "the motion does not distinguish it from a multiple of rigid torques"
            elif not np.all((values > 0.0) & (values < 1.0)):
                listed = " and ".join(f"{value:.3g}" for value in values)
                which = "its coefficient" if len(values) == 1 else "one of its coefficients"
                why = f"{which} {listed} is not between 0 and 1"
            if why:
                sentences = impossible.setdefault(term.kind, {})
                sentences[joint + 1] = f"{name}: friction of kind {term.kind!r} dropped, {why}"
    return impossible


def regress_friction(
    network: CSLC, patterns: Patterns, k: Float[Array | np.ndarray, " k"]
) -> Float[Array, " k"]:
    """Regress friction alone, with fixed rigid-body coefficients (Eqn. 7.6-1).

    The thesis calls the result Ar+Rg, for Armstrong's coefficients: the torque that rigid-body
    coefficients do not explain is regressed against the friction inputs of each joint, over the
    samples in the mask.

    **Arguments**

    - `network`: p coefficients.
    - `patterns`: motion and torque of the training recording.
    - `k`: (p,); its friction coefficients are not used.

    **Returns** (p,): `k` with the regressed friction coefficients.

    >>> import jaxcslc as jc
    >>> network = jc.derive(jc.examples.pendulum())
    >>> patterns = jc.examples.swing(network, [0.5, 0.3, -0.1, 0.2, 0.05])
    >>> wrong = np.array([0.5, 0.3, -0.1, 9.0, 9.0])
    >>> jc.regress_friction(network, patterns, wrong).round(6).tolist()
    [0.5, 0.3, -0.1, 0.2, 0.05]
    """
    rigid = network.without_friction(jnp.asarray(k))
    names = [network.names[index] for index in network.layout.friction]
    if not names:
        return rigid
    solver = LeastSquares(joint_weights="equal", errors="independent")
    fixed = Fixed.except_for(network, rigid, names)
    equations = solver.equations(network, patterns)  # on the host: nothing to compile
    return solver.fit_equations(equations, patterns.samples, fixed, throw=False).k
