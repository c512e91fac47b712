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
    """The motion of an identified system beside a recording of it.

    **Attributes**

    - `names`: of the m variables that were simulated; the others were taken from the recording.
    - `time`: (samples,) [s].
    - `simulated`, `recorded`: (samples, m) in the variables' units; not finite where a simulation
      left all bounds.
    - `step_error`: (m,) root mean square difference from a simulation with as many steps of
      integration, alternately a third shorter and longer: with the default solver nearly twice the
      error that its steps leave.
    """

    names: tuple[str, ...]
    time: Float[np.ndarray, " samples"]
    simulated: Float[np.ndarray, "samples variables"]
    recorded: Float[np.ndarray, "samples variables"]
    step_error: Float[np.ndarray, " variables"]

    @property
    def error(self) -> Float[np.ndarray, " variables"]:
        """Root mean square difference between simulation and recording, (m,)."""
        return _root_mean_square(self.simulated, self.recorded)

    @property
    def relative_error(self) -> Float[np.ndarray, " variables"]:
        """`error` over the standard deviation of the recorded variable, (m,): 1 is the error of
        its mean."""
        return self.error / np.std(self.recorded, axis=0)

    def horizon(self, limit: float = 0.5) -> float:
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
    - `substeps`: steps of integration between two samples, 2 or more.
    - `solver`: of `diffrax`; by default `Tsit5`, of fifth order. A stiff system needs an implicit
      one, such as `Kvaerno5`, or more substeps.

    **Returns** the simulated motion beside the recorded one. A simulation that grows beyond all
    bounds holds values that are not finite.

    **Raises**

    - `DescriptionError`: the equations cannot be solved for the highest derivatives, or a name in
      `recorded` is no variable.
    - `ValueError`: another number of coefficients, or fewer than two substeps.

    >>> import numpy as np, sympy as sp
    >>> from sympy.physics.mechanics import dynamicsymbols
    >>> from jaxcslc.systems import (
    ...     Constant, System, SystemRecording, Variable, simulate_system, system_patterns
    ... )
    >>> x, u = dynamicsymbols("x u")
    >>> T = sp.Symbol("T")
    >>> equations = {"balance": sp.Eq(u - x, T * x.diff())}
    >>> lag = System("lag", equations, (Variable(x), Variable(u)), (Constant(T),))
    >>> t = np.linspace(0, 2, 201)
    >>> recording = SystemRecording(t, {"x": np.exp(-t / 0.5), "u": 0 * t})
    >>> simulation = simulate_system(lag, np.array([0.5]), system_patterns(lag, recording))
    >>> bool(simulation.relative_error[0] < 1e-3)
    True
    """
    network = system.network if network is None else network
    states = _states(system, network, recorded)
    k = jnp.asarray(k)
    if k.shape != (network.size,):
        raise ValueError(f"k: expected shape ({network.size},), got {k.shape}")
    if substeps < 2:
        raise ValueError(f"substeps is {substeps}; expected 2 or more")
    motion = jnp.asarray(patterns.q), jnp.asarray(patterns.qd), jnp.asarray(patterns.qdd)
    time = np.asarray(patterns.time, float)
    require_float64(time, *motion)
    _check_linear(system, network, k, states, motion)
    if solver is None:
        import diffrax  # with its own dependencies, half a second

        solver = diffrax.Tsit5()
    simulated, uneven = (
        np.asarray(_solved(network, k, states, jnp.asarray(time), steps, motion, solver))
        for steps in (_steps(time, substeps, 0.0), _steps(time, substeps, 1.0 / 3.0))
    )
    return Simulation(
        tuple(system.variables[index].name for index in states.indices),
        time,
        simulated,
        np.asarray(patterns.q)[:, list(states.indices)],
        _root_mean_square(simulated, uneven),
    )


def _root_mean_square(
    path: Float[np.ndarray, "samples variables"], other: Float[np.ndarray, "samples variables"]
) -> Float[np.ndarray, " variables"]:
    """Return the RMS difference over the samples; infinite or NaN where one left all bounds."""
    with np.errstate(over="ignore", invalid="ignore"):
        return np.sqrt(np.mean((path - other) ** 2, axis=0))


@dataclasses.dataclass(frozen=True)
class _States:
    """Simulated variables and their orders: constants of compiled functions.

    - `indices`: of the variables; `orders`: of their highest derivatives, 1 or 2.
    - `others`: indices of the variables that the recording prescribes.
    """

    indices: tuple[int, ...]
    orders: tuple[int, ...]
    others: tuple[int, ...]

    @property
    def second(self) -> np.ndarray:
        """Positions, among the simulated variables, of those whose rate is a state too."""
        return np.flatnonzero(np.array(self.orders) == 2)


def _states(system: System, network: SystemNetwork, recorded: Sequence[str]) -> _States:
    names = [variable.name for variable in system.variables]
    for name in recorded:
        if name not in names:
            raise DescriptionError(
                f"{system.name}: recorded: no variable is called {name!r}; expected some of"
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
            f"{system.name}: {network.joint_count} equations for the highest derivatives of"
            f" {len(orders)} variables ({listed}): expected as many; variables that the recording"
            " prescribes are named by `recorded`"
        )
    others = tuple(index for index in range(len(names)) if index not in orders)
    return _States(tuple(orders), tuple(orders.values()), others)


def _residual(
    network: SystemNetwork,
    k: Array,
    states: _States,
    motion: tuple[Array, Array, Array],
    highest: Float[Array, " states"],
) -> Float[Array, " equations"]:
    """The error of the equations at one sample.

    - `motion`: values and derivatives of all variables, (v,) each; the highest derivatives of
      states are `highest` in place of what it has.
    """
    q, qd, qdd = motion
    indices, second = np.array(states.indices), np.array(states.orders) == 2
    qd = qd.at[indices].set(jnp.where(second, qd[indices], highest))
    qdd = qdd.at[indices].set(jnp.where(second, highest, 0.0))
    return network.residual(k, q, qd, qdd)


def _highest(
    network: SystemNetwork, k: Array, states: _States, motion: tuple[Array, Array, Array]
) -> Float[Array, " states"]:
    """The highest derivatives of the states."""
    residual = lambda highest: _residual(network, k, states, motion, highest)
    still = jnp.zeros(len(states.indices))
    return -jnp.linalg.solve(jax.jacfwd(residual)(still), residual(still))


def _check_linear(
    system: System,
    network: SystemNetwork,
    k: Array,
    states: _States,
    motion: tuple[Array, Array, Array],
) -> None:
    """Checks on the recording that highest derivatives appear linearly, and that they can be
    solved for."""
    matrix, change = _matrices(network, k, states, motion)
    if np.any(np.asarray(change) > _LINEAR):
        raise DescriptionError(
            f"{system.name}: highest derivatives appear in another way than linearly; such"
            " equations can be identified, but not simulated"
        )
    condition = np.linalg.cond(np.asarray(matrix))
    if not np.all(condition < 1.0 / np.finfo(float).eps):
        where = float(np.mean(~(condition < 1.0 / np.finfo(float).eps)))
        raise DescriptionError(
            f"{system.name}: the equations cannot be solved for the highest derivatives at"
            f" {100 * where:.3g} % of the samples: what multiplies them is singular"
        )


@eqx.filter_jit
def _matrices(
    network: SystemNetwork, k: Array, states: _States, motion: tuple[Array, Array, Array]
) -> tuple[Array, Array]:
    """Return, at all samples, the matrices that multiply highest derivatives, rows of unit length.

    The second result is by how much they differ where the derivatives are others.
    """
    indices, second = np.array(states.indices), np.array(states.orders) == 2

    def at(sample: tuple[Array, Array, Array]) -> tuple[Array, Array]:
        slope = jax.jacfwd(lambda highest: _residual(network, k, states, sample, highest))
        recorded = jnp.where(second, sample[2][indices], sample[1][indices])
        matrix, other = slope(jnp.zeros(len(indices))), slope(recorded + 1.0)
        size = jnp.linalg.norm(matrix, axis=1, keepdims=True)
        size = jnp.where(size > 0.0, size, 1.0)
        return matrix / size, jnp.max(jnp.abs(other - matrix) / size)

    return jax.lax.map(at, motion, batch_size=256)


def _steps(
    time: Float[np.ndarray, " samples"], substeps: int, shift: float
) -> Float[Array, " steps"]:
    """Instants that integration steps to.

    - `shift`: by which part of a step every second one between two samples is earlier.
    """
    part = np.arange(substeps) - shift * (np.arange(substeps) % 2)
    steps = time[:-1, None] + np.diff(time)[:, None] * part / substeps
    return jnp.asarray(np.append(steps.ravel(), time[-1]))


@eqx.filter_jit
def _solved(
    network: SystemNetwork,
    k: Array,
    states: _States,
    time: Array,
    steps: Array,
    motion: tuple[Array, Array, Array],
    solver: Any,
) -> Array:
    import diffrax

    indices, second = np.array(states.indices), states.second
    others = np.array(states.others, dtype=int)
    m = len(indices)
    inputs = diffrax.LinearInterpolation(time, jnp.stack([x[:, others] for x in motion], axis=1))

    def derivative(t: Any, state: Array, args: None) -> Array:
        del args
        q, qd, qdd = jnp.zeros((3, motion[0].shape[1])).at[:, others].set(inputs.evaluate(t))
        q, qd = q.at[indices].set(state[:m]), qd.at[indices[second]].set(state[m:])
        highest = _highest(network, k, states, (q, qd, qdd))
        rate = highest.at[second].set(state[m:])
        return jnp.concatenate([rate, highest[second]])

    start = jnp.concatenate([motion[0][0, indices], motion[1][0, indices[second]]])
    solution = diffrax.diffeqsolve(
        diffrax.ODETerm(derivative),
        solver,
        t0=time[0],
        t1=time[-1],
        dt0=None,
        y0=start,
        saveat=diffrax.SaveAt(ts=time),
        stepsize_controller=diffrax.StepTo(steps),
        max_steps=len(steps),
        throw=False,
    )
    assert solution.ys is not None
    return solution.ys[:, :m]
