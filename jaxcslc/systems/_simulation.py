"""Simulation of an identified system with the inputs of a recording."""

import dataclasses
from collections.abc import Sequence
from typing import TYPE_CHECKING, Any

import equinox as eqx
import jax
import jax.numpy as jnp
import numpy as np
from jaxtyping import Array, Float

from .._environment import require_float64
from ..recordings import Patterns
from ._description import DescriptionError
from ._network import SystemNetwork
from ._system import System


if TYPE_CHECKING:
    import diffrax


# Of the equations' largest change with highest derivatives: more counts as a dependence that is
# not linear.
_LINEAR = 1e-9


@dataclasses.dataclass(frozen=True)
class Simulation:
    """The motion of an identified system next to a recording of it.

    **Attributes**

    - `names`: of the m variables that were simulated; the others were taken from the recording.
    - `time`: (samples,) [s].
    - `simulated`, `recorded`: (samples, m) in the variables' units; not finite where a simulation
      left all bounds.
    """

    names: tuple[str, ...]
    time: Float[np.ndarray, " samples"]
    simulated: Float[np.ndarray, "samples variables"]
    recorded: Float[np.ndarray, "samples variables"]

    @property
    def error(self) -> Float[np.ndarray, " variables"]:
        """Root mean square difference between simulation and recording, (m,)."""
        with np.errstate(over="ignore", invalid="ignore"):  # where a simulation left all bounds
            return np.sqrt(np.mean((self.simulated - self.recorded) ** 2, axis=0))

    @property
    def relative_error(self) -> Float[np.ndarray, " variables"]:
        """`error` over the standard deviation of the recorded variable, (m,): 1 is the error of
        its mean."""
        return self.error / np.std(self.recorded, axis=0)

    def follows_for(self, limit: float = 0.5) -> float:
        """Return how long the simulation follows the recording [s].

        **Arguments**

        - `limit`: the largest difference of any variable that counts as following, as a part of
          the variable's standard deviation.

        **Returns** the time from the start to the first larger difference; the whole duration if
        there is none.
        """
        with np.errstate(invalid="ignore"):
            off = np.abs(self.simulated - self.recorded) / np.std(self.recorded, axis=0)
        away = ~np.all(off <= limit, axis=1)  # and what is not finite
        end = int(np.argmax(away)) if away.any() else len(away) - 1
        return float(self.time[end] - self.time[0])

    def __str__(self) -> str:
        width = max(map(len, self.names))
        lines = [f"simulated for {self.time[-1] - self.time[0]:.4g} s from the first sample"]
        lines += [
            f"{name:<{width}}  RMS difference {error:.3g}, {100 * relative:.3g} % of its deviation"
            for name, error, relative in zip(
                self.names, self.error, self.relative_error, strict=True
            )
        ]
        return "\n".join(lines)


def simulate_system(
    system: System,
    k: Float[Array | np.ndarray, " coefficients"],
    patterns: Patterns,
    *,
    network: SystemNetwork | None = None,
    recorded: Sequence[str] = (),
    substeps: int = 4,
    solver: "diffrax.AbstractSolver | None" = None,
) -> Simulation:
    """Simulates a system from the first sample of a recording, with the recording's inputs.

    The equations are solved for the highest derivatives of the states (thesis C.2; the mass matrix
    of a mechanical system is what they are multiplied by), and integrated by diffrax. Inputs are
    interpolated linearly between samples.

    Equations in which highest derivatives appear in another way than linearly, and systems with
    more or fewer equations than states, cannot be simulated.

    **Arguments**

    - `k`: (p,) coefficients of the system's network.
    - `patterns`: a prepared recording, as by `system_patterns`: its first sample is the start, its
      values of the inputs drive the simulation, and its values of the states are compared.
    - `network`: the system's, with other values of the constants that are searched; by default
      `system.network`.
    - `recorded`: names of variables that are taken from the recording although equations contain
      their derivatives, such as a shaft's speed that a drive prescribes.
    - `substeps`: steps of integration between two samples.
    - `solver`: of `diffrax`; by default `Tsit5`, of fifth order. A stiff system needs an implicit
      one, such as `Kvaerno5`, or more substeps.

    **Returns** the simulated motion next to the recorded one. A simulation that grows beyond all
    bounds holds values that are not finite.

    **Raises**

    - `DescriptionError`: the equations cannot be solved for the highest derivatives, or a name in
      `recorded` is no variable.
    - `ValueError`: another number of coefficients, or fewer than one substep.

    >>> import numpy as np, jaxcslc as jc
    >>> from jaxcslc.systems import simulate_system, system_patterns
    >>> tank, recording = jc.examples.tank()
    >>> simulation = simulate_system(tank, np.array([3.0, 0.5]), system_patterns(tank, recording))
    >>> bool(simulation.relative_error[0] < 1e-3)
    True
    """
    network = system.network if network is None else network
    k = jnp.asarray(k)
    if k.shape != (network.size,):
        raise ValueError(f"k: expected shape ({network.size},), got {k.shape}")
    if substeps < 1:
        raise ValueError(f"substeps is {substeps}; expected 1 or more")
    model = _Model.of(network, k, recorded)
    motion = jnp.asarray(patterns.q), jnp.asarray(patterns.qd), jnp.asarray(patterns.qdd)
    time = np.asarray(patterns.time, float)
    require_float64(time, *motion)
    _check_linear(model, motion)
    if solver is None:
        import diffrax  # with its own dependencies, half a second

        solver = diffrax.Tsit5()
    within = time[:-1, None] + np.diff(time)[:, None] * np.arange(substeps) / substeps
    steps = np.append(within.ravel(), time[-1])
    return Simulation(
        tuple(system.variables[index].name for index in model.states),
        time,
        np.asarray(_solved(model, jnp.asarray(time), jnp.asarray(steps), motion, solver)),
        np.asarray(patterns.q)[:, list(model.states)],
    )


Motion = tuple[Array, Array, Array]
"""Values, first and second derivatives of all variables."""


class _Model(eqx.Module):
    """The identified equations, to be solved for the highest derivatives of the states.

    - `states`: indices of the variables that are simulated.
    - `second`: for each of them, whether its second derivative is the highest.
    - `others`: indices of the variables that the recording prescribes.
    """

    network: SystemNetwork
    k: Array
    states: tuple[int, ...] = eqx.field(static=True)
    second: tuple[bool, ...] = eqx.field(static=True)
    others: tuple[int, ...] = eqx.field(static=True)

    @classmethod
    def of(cls, network: SystemNetwork, k: Array, recorded: Sequence[str]) -> "_Model":
        names = network.variables
        for name in recorded:
            if name not in names:
                raise DescriptionError(
                    f"{network.name}: recorded: no variable is called {name!r}; expected some of"
                    f" {', '.join(names)}"
                )
        orders = {
            index: order
            for index, (name, order) in enumerate(zip(names, network.highest, strict=True))
            if order > 0 and name not in recorded
        }
        if len(orders) != network.joint_count:
            listed = ", ".join(names[index] for index in orders) or "none"
            raise DescriptionError(
                f"{network.name}: {network.joint_count} equations for the highest derivatives of"
                f" {len(orders)} variables ({listed}): expected as many; variables that the"
                " recording prescribes are named by `recorded`"
            )
        others = tuple(index for index in range(len(names)) if index not in orders)
        return cls(network, k, tuple(orders), tuple(x == 2 for x in orders.values()), others)

    def residual(
        self, motion: Motion, highest: Float[Array, " states"]
    ) -> Float[Array, " equations"]:
        """Return the error of the equations at one sample.

        - `motion`: (v,) each; the highest derivatives of states are `highest` instead.
        """
        q, qd, qdd = motion
        at, second = np.array(self.states), np.array(self.second)
        qd = qd.at[at].set(jnp.where(second, qd[at], highest))
        qdd = qdd.at[at].set(jnp.where(second, highest, 0.0))
        return self.network.residual(self.k, q, qd, qdd)

    def highest(self, motion: Motion) -> Float[Array, " states"]:
        """Return the highest derivatives of the states."""
        residual = lambda highest: self.residual(motion, highest)
        still = jnp.zeros(len(self.states))
        return -jnp.linalg.solve(jax.jacfwd(residual)(still), residual(still))


def _check_linear(model: _Model, motion: Motion) -> None:
    """Check that highest derivatives appear linearly along a recording, and can be solved for."""
    matrix, change = _matrices(model, motion)
    if np.any(np.asarray(change) > _LINEAR):
        raise DescriptionError(
            f"{model.network.name}: highest derivatives appear in another way than linearly; such"
            " equations can be identified, but not simulated"
        )
    solvable = np.linalg.cond(np.asarray(matrix)) < 1.0 / np.finfo(float).eps
    if not np.all(solvable):
        raise DescriptionError(
            f"{model.network.name}: the equations cannot be solved for the highest derivatives at"
            f" {100 * np.mean(~solvable):.3g} % of the samples: what multiplies them is singular"
        )


@eqx.filter_jit
def _matrices(model: _Model, motion: Motion) -> tuple[Array, Array]:
    """Return, at all samples, the matrices that multiply highest derivatives, rows of unit length.

    The second result is by how much they differ where the derivatives are others.
    """
    at, second = np.array(model.states), np.array(model.second)

    def of_sample(sample: Motion) -> tuple[Array, Array]:
        slope = jax.jacfwd(lambda highest: model.residual(sample, highest))
        recorded = jnp.where(second, sample[2][at], sample[1][at])
        matrix, other = slope(jnp.zeros(len(at))), slope(recorded + 1.0)
        size = jnp.linalg.norm(matrix, axis=1, keepdims=True)
        size = jnp.where(size > 0.0, size, 1.0)
        return matrix / size, jnp.max(jnp.abs(other - matrix) / size)

    return jax.lax.map(of_sample, motion, batch_size=256)


@eqx.filter_jit
def _solved(model: _Model, time: Array, steps: Array, motion: Motion, solver: Any) -> Array:
    """Return the states at all samples, integrated in these steps."""
    import diffrax

    at, second = np.array(model.states), np.flatnonzero(model.second)
    others = np.array(model.others, dtype=int)
    inputs = diffrax.LinearInterpolation(time, jnp.stack([x[:, others] for x in motion], axis=1))

    def derivative(t: Any, state: Array, args: None) -> Array:
        del args
        q, qd, qdd = jnp.zeros((3, motion[0].shape[1])).at[:, others].set(inputs.evaluate(t))
        q, qd = q.at[at].set(state[: len(at)]), qd.at[at[second]].set(state[len(at) :])
        highest = model.highest((q, qd, qdd))
        rate = highest.at[second].set(state[len(at) :])
        return jnp.concatenate([rate, highest[second]])

    solution = diffrax.diffeqsolve(
        diffrax.ODETerm(derivative),
        solver,
        t0=time[0],
        t1=time[-1],
        dt0=None,
        y0=jnp.concatenate([motion[0][0, at], motion[1][0, at[second]]]),
        saveat=diffrax.SaveAt(ts=time),
        stepsize_controller=diffrax.StepTo(steps),
        max_steps=len(steps),
        throw=False,
    )
    assert solution.ys is not None
    return solution.ys[:, : len(at)]
