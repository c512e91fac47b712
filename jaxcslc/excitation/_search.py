"""Search for the best motion: an augmented Lagrangian with L-BFGS steps."""

import dataclasses
import functools
from collections.abc import Callable, Mapping
from typing import Any, NamedTuple

import equinox as eqx
import jax
import jax.numpy as jnp
import numpy as np
import scipy
from jaxtyping import Float, Int

from ._criteria import log_criterion
from ._families import AbstractFamily, Parameters, Times
from ._feasibility import without_jumps
from ._information import MotionInformation, Spectra, motion_regressor
from ._limits import QUANTITIES, Joints, Limits


# Settings of searches. `scripts/studies/excitation/study.py` judges them by what designs reach.
_INSIDE = 0.996  # part of limits that is used, for what happens between samples
_BEYOND = 1.001  # by which narrowed limits keep back more
_FIRST_PENALTY, _PENALTY_GROWTH, _LARGEST_PENALTY = 3.0, 4.0, 3e3  # of the Lagrangian
# A round that changes the criterion by no more, and exceeds limits by no more, is the last.
_SETTLED, _KEPT = 0.01, 0.001
_NOWHERE = 1e10  # value where the Lagrangian is no number


class Contacts(NamedTuple):
    """Distances of bodies that count in a motion q0(t): d + J (q(t) - q0(t)) ≥ clearance.

    **Attributes**

    - `sample`: (c,) of the grid, and `pair`: (c,) of bodies.
    - `distance`: (c,) beyond the clearance there [m].
    - `jacobian`: (c, n) of the distance [m/rad]; `position`: (c, n) q0.
    - `multiplier`: (c,) Lagrange multipliers of these samples and pairs.
    """

    sample: Int[np.ndarray, " contacts"]
    pair: Int[np.ndarray, " contacts"]
    distance: Float[np.ndarray, " contacts"]
    jacobian: Float[np.ndarray, "contacts joints"]
    position: Float[np.ndarray, "contacts joints"]
    multiplier: Float[np.ndarray, " contacts"]


class Multipliers(NamedTuple):
    """Lagrange multipliers of the constraints, sample by sample."""

    kinematic: Any  # (4, samples, n)
    torque: Any  # (samples, n)
    power: Any  # (samples, n)
    contacts: Any  # (contacts,)


CONTACTS = 1024  # a fixed number, so that programs are compiled once
_FAR_AWAY = 1e3  # of those that fill it [m]
_LENGTH = 0.02  # what distances are measured in [m]


class DesignProblem(eqx.Module):
    """Problem of a search: what it minimises, and the limits that it must keep.

    **Attributes**

    - `information`: of motions; `prior`, `wanted`, `task`, `criterion`: as of `log_criterion`.
    - `basis`: (4, samples, m) of the family on the grid, with derivatives up to jerk.
    - `middle`, `half`: (4, n) of the ranges of positions and derivatives.
    - `torque`, `power`: (n,) limits.
    - `smooth`: (p,) the prior model's coefficients without friction that jumps, and `reversal`:
      (n,) speeds below which a joint may reverse between two samples.
    - `unit`: (m, n) of the parameters that the search varies, `start` their fixed part: where
      `unit` is zero, parameters keep the value of `start`.
    """

    information: MotionInformation
    prior: Any
    wanted: Any
    task: Any
    basis: Any
    middle: Any
    half: Any
    torque: Any
    power: Any
    smooth: Any
    reversal: Any
    unit: Any
    start: Any
    criterion: str = eqx.field(static=True)

    @classmethod
    def of(
        cls,
        information: MotionInformation,
        family: AbstractFamily,
        time: Times,
        limits: Limits,
        *,
        prior: Any,
        wanted: Int[np.ndarray, " wanted"],
        task: Any,
        criterion: str,
        start: Float[np.ndarray, " joints"] | None,
    ) -> "DesignProblem":
        """Make a problem on a grid of times; `start`: the first pose of motions, any if None."""
        ranges = [limits.symmetric(order) for order in range(4)]
        half = np.stack([half for _, half in ranges])
        unit = np.tile(half[0] / 2, (family.size, 1))
        fixed = np.zeros_like(unit)
        if start is not None:
            unit[0], fixed[0] = 0.0, start
        arrays = {
            "prior": prior,
            "wanted": wanted,
            "task": task,
            "basis": np.stack([family.basis(time, order) for order in range(4)]),
            "middle": np.stack([middle for middle, _ in ranges]),
            "half": _INSIDE * half,
            "torque": _INSIDE * limits.usable_torque,
            "power": _INSIDE * limits.usable_power,
            "smooth": without_jumps(information.network, information.k),
            "reversal": limits.acceleration * information.interval / 2,
            "unit": unit,
            "start": fixed,
        }
        return cls(information, **jax.tree.map(jnp.asarray, arrays), criterion=criterion)

    def parameters(self, x: Any) -> Any:
        """Return parameters (m, n) from the variables of the search."""
        return self.start + self.unit * x.reshape(self.unit.shape)

    def variables(self, parameters: Parameters) -> Float[np.ndarray, " variables"]:
        """Return the variables of the search for given parameters."""
        unit = np.asarray(self.unit)
        return np.where(unit > 0, np.asarray(parameters) / np.where(unit > 0, unit, 1), 0).ravel()

    def motion(self, x: Float[np.ndarray, " variables"]) -> tuple[np.ndarray, ...]:
        """Return positions, velocities and accelerations on the grid."""
        parameters = np.asarray(self.parameters(x))
        return tuple(np.asarray(basis) @ parameters for basis in self.basis[:3])

    def constraints(
        self, x: Any, contacts: Contacts, regressor: Any = None
    ) -> tuple[Any, Multipliers, Any]:
        """Return the motion, constraints (kept where not above zero), and the regressor.

        `regressor` is passed if it is known already.
        """
        derivatives = jnp.einsum("otm,mn->otn", self.basis, self.parameters(x))
        q, qd, qdd, _ = derivatives
        kinematic = jnp.abs(derivatives - self.middle[:, None]) / self.half[:, None] - 1.0
        if regressor is None:
            regressor = self.information.network.regressor(q, qd, qdd)
        torque = self._torque_bound(regressor, qd)
        change = q[contacts.sample] - contacts.position
        distance = contacts.distance + jnp.sum(contacts.jacobian * change, axis=-1)
        values = Multipliers(
            kinematic,
            torque / self.torque[None] - 1.0,
            torque * jnp.abs(qd) / self.power[None] - 1.0,
            -distance / _LENGTH,
        )
        return (q, qd, qdd), values, regressor

    def narrowed(self, used: Mapping[str, Joints]) -> "DesignProblem":
        """Narrow each limit that a motion exceeds, dividing it by the part that the motion uses.

        **Arguments**

        - `used`: parts of limits by name, as `Use.joints` has them.
        """
        factor = {name: 1.0 / np.maximum(_BEYOND * x, 1.0) for name, x in used.items()}
        half = np.stack([factor[name] for name in QUANTITIES])
        changes = {"half": self.half * half}
        for name in ("torque", "power"):
            changes[name] = getattr(self, name) * factor.get(name, 1.0)
        return dataclasses.replace(self, **changes)

    def _torque_bound(self, regressor: Any, qd: Any) -> Any:
        """Bound the absolute torque, (samples, n), with friction of both signs at reversals.

        The bound is continuous there, as line searches need it.
        """
        smooth = regressor @ self.smooth
        jump = regressor @ jnp.asarray(self.information.k) - smooth
        moving = jnp.abs(qd) / jnp.sqrt(qd**2 + self.reversal[None] ** 2)
        return jnp.abs(smooth + moving * jump) + (1.0 - moving) * jnp.abs(jump)

    def lagrangian(
        self, x: Any, spectra: Spectra, multipliers: Multipliers, penalty: Any, contacts: Contacts
    ) -> Any:
        """Return the augmented Lagrangian (Powell, Hestenes, Rockafellar) and log criterion."""
        motion, values, regressor = self.constraints(x, contacts)
        moments = self.information.moments(motion, spectra, regressor)
        objective = log_criterion(self.criterion, moments, self.prior, self.wanted, self.task)
        terms = jax.tree.map(
            lambda value, multiplier: (
                jnp.sum(jnp.maximum(multiplier + penalty * value, 0.0) ** 2 - multiplier**2)
                / (2.0 * penalty)
            ),
            values,
            multipliers,
        )
        return objective + sum(terms), objective


@eqx.filter_jit
def _lagrangian(
    problem: DesignProblem,
    x: Any,
    spectra: Spectra,
    multipliers: Multipliers,
    penalty: Any,
    contacts: Any,
) -> Any:
    """Compute the augmented Lagrangian, its gradient, and the logarithm of the criterion."""
    value = jax.value_and_grad(problem.lagrangian, has_aux=True)
    (total, objective), gradient = value(x, spectra, multipliers, penalty, contacts)
    return total, gradient, objective


@eqx.filter_jit
def _updated(
    problem: DesignProblem,
    x: Any,
    multipliers: Multipliers,
    penalty: Any,
    contacts: Contacts,
    regressor: Any,
) -> tuple[Multipliers, Any]:
    """Multipliers after a minimisation, and the largest violation."""
    _, values, _ = problem.constraints(x, contacts, regressor)
    new = jax.tree.map(lambda v, m: jnp.maximum(m + penalty * v, 0.0), values, multipliers)
    return new, jnp.stack([jnp.max(v) for v in values]).max()


@dataclasses.dataclass
class Search:
    """A search by an augmented Lagrangian, whose steps are SciPy's L-BFGS.

    **Attributes**

    - `problem`: to be minimised.
    - `contacts`: distances of bodies in a motion (samples, n), with multipliers of earlier ones.
      Every step asks for them, as an arm may reach in one step what was far away. None where no
      bodies are watched.
    - `progress`: is called with a few words.
    - `best`: the variables that the search has reached, after an interruption too.
    - `multipliers`, `held`: that the last run ended with, and the contacts that have multipliers.
    """

    problem: DesignProblem
    contacts: Callable[[Float[np.ndarray, "samples joints"], Contacts], Contacts] | None = None
    progress: Callable[[str], None] | None = None
    best: Float[np.ndarray, " variables"] | None = None
    multipliers: Multipliers | None = None
    held: Contacts | None = None

    def run(
        self,
        x: Float[np.ndarray, " variables"],
        rounds: int,
        steps: int,
        penalty: float = _FIRST_PENALTY,
        *,
        warm: bool = False,
    ) -> float:
        """Minimise from `x`, by rounds of multipliers with so many steps each.

        Multipliers begin at zero, or with `warm` at those of the last run. The penalty grows from
        round to round.

        **Returns** the logarithm of the criterion at the end, which limits may still not allow.
        """
        problem = self.problem
        samples, n = problem.basis.shape[1], problem.unit.shape[1]
        multipliers = (warm and self.multipliers) or Multipliers(
            jnp.zeros((4, samples, n)),
            jnp.zeros((samples, n)),
            jnp.zeros((samples, n)),
            jnp.zeros(CONTACTS),
        )
        objective = before = np.inf
        self.best = np.array(x)
        held = (warm and self.held) or padded_contacts(n)
        for number in range(rounds):
            q, _, _ = problem.motion(self.best)
            spectra = problem.information.spectra(q)

            constrained = functools.partial(
                self._constrained, multipliers=multipliers, penalty=penalty, held=held
            )

            def value(
                x: np.ndarray, spectra: Spectra = spectra, constrained: Any = constrained
            ) -> tuple[float, np.ndarray]:
                nonlocal objective
                total, gradient, criterion = _lagrangian(
                    problem, jnp.asarray(x), spectra, *constrained(x)
                )
                objective, gradient = float(criterion), np.asarray(gradient, float)
                if not (np.isfinite(total) and np.isfinite(gradient).all()):
                    return _NOWHERE, np.zeros_like(gradient)
                return float(total), gradient

            def keep(x: np.ndarray) -> None:
                self.best = np.array(x)

            result: Any = scipy.optimize.minimize(
                value,
                self.best,
                jac=True,
                method="L-BFGS-B",
                callback=keep,
                options={"maxiter": steps, "maxcor": 20, "maxfun": 2 * steps},
            )
            self.best = np.asarray(result.x)
            regressor = motion_regressor(problem.information.network, *problem.motion(self.best))
            at_end = constrained(self.best)
            multipliers, worst = _updated(problem, jnp.asarray(self.best), *at_end, regressor)
            held = at_end[-1]._replace(multiplier=np.asarray(multipliers.contacts))
            self.multipliers, self.held = multipliers, held
            if self.progress:
                self.progress(
                    f"round {number + 1} of {rounds}: criterion {np.exp(objective):.4g}, limits"
                    f" exceeded by {100 * max(float(worst), 0.0):.2g} %"
                )
            if abs(objective - before) <= _SETTLED and float(worst) <= _KEPT:
                break
            before = objective
            penalty = min(penalty * _PENALTY_GROWTH, _LARGEST_PENALTY)
        return objective

    def _constrained(
        self,
        x: Float[np.ndarray, " variables"],
        *,
        multipliers: Multipliers,
        penalty: float,
        held: Contacts,
    ) -> tuple[Multipliers, Any, Contacts]:
        """Return multipliers and penalty, and the contacts at `x`; `held`: those of before."""
        contacts = held
        if self.contacts is not None:
            contacts = self.contacts(self.problem.motion(x)[0], held)
        multipliers = multipliers._replace(contacts=jnp.asarray(contacts.multiplier))
        return multipliers, jnp.asarray(penalty), contacts


def padded_contacts(joints: int, found: Contacts | None = None) -> Contacts:
    """Return the contacts found, with as many far away ones as make the fixed number."""
    missing = CONTACTS - (0 if found is None else len(found.sample))
    far = Contacts(
        np.zeros(missing, int),
        np.zeros(missing, int),
        np.full(missing, _FAR_AWAY),
        np.zeros((missing, joints)),
        np.zeros((missing, joints)),
        np.zeros(missing),
    )
    return far if found is None else Contacts(*map(np.concatenate, zip(found, far, strict=True)))
