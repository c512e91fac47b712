"""The computer that controls a machine: sampling, demands, faults, and what it records."""

import functools
from collections.abc import Callable
from dataclasses import dataclass
from typing import Any, NamedTuple

import equinox as eqx
import jax
import jax.numpy as jnp
import numpy as np
from jaxtyping import Float

from jaxcslc.control import AbstractController, Reference
from sim.machine._bodies import MachineError
from sim.machine._events import Faults
from sim.trajectory._paths import AbstractPath
from sim.trajectory._trajectories import Trajectory


Array = np.ndarray | jax.Array


class ComputerState(NamedTuple):
    """The memory of a `Computer`.

    **Attributes**

    - `origin`: joint positions at which the path begins, (*batch, joints) [rad or m].
    - `shown`, `received`: the latest readings that the encoders showed, and that arrived.
    - `controller`: state of the controller.
    """

    origin: Array
    shown: Array
    received: Array
    controller: Any


@dataclass(frozen=True, eq=False)
class Computer:
    """The machine's control computer: from encoder readings to torque commands, once a sample.

    A controller that is `array_generic` gets NumPy arrays as they are. Any other one is compiled
    once for a number of machines, and runs on the CPU whatever JAX's default device is; controllers
    that differ only in their arrays share a program. On JAX's tracers, as under MJX, the
    controller is part of what is traced.

    **Attributes**

    - `controller`, `path`, `per_machine`: as in `Trajectory`.
    - `interval`: between samples [s].
    """

    controller: AbstractController
    path: AbstractPath | None
    interval: float
    per_machine: bool

    @classmethod
    def of(cls, trajectory: Trajectory) -> "Computer":
        """The computer that runs a trajectory."""
        return cls(
            trajectory.controller,
            trajectory.path,
            trajectory.sample_interval,
            trajectory.per_machine,
        )

    def begin(self, reading: Float[Array, "*batch joints"]) -> ComputerState:
        """The state before the first sample, with the joints at rest.

        **Raises** `MachineError`: one controller for each machine, but another number of them.
        """
        self._check_count(reading)
        if not isinstance(reading, np.ndarray):
            state = _begin(self.controller, self.per_machine, reading)
        elif self._uncompiled:
            state = self.controller.begin(reading)
        else:
            arrays, program = self._compiled
            with jax.default_device(_cpu()):
                # Committed to the device, as the results of a step are, which compiles once only.
                state = jax.device_put(program.begin(arrays, reading), _cpu())
        return ComputerState(reading, reading, reading, state)

    def command(
        self,
        state: ComputerState,
        time: Float[Array, ""] | float,
        reading: Float[Array, "*batch joints"],
        faults: Faults,
    ) -> tuple[Float[Array, "*batch joints"], ComputerState]:
        """The torque command of a sample, constant until the next [N m or N].

        **Arguments**

        - `state`: as `begin` or the previous command returned it.
        - `time`: of the sample [s].
        - `reading`: of healthy encoders [rad or m].
        - `faults`: at this sample.
        """
        reading, shown, received = faults.read(reading, state.shown, state.received)
        reference = self._reference(time, state.origin)
        if not isinstance(reading, np.ndarray):
            torque, inner = _step(
                self.controller,
                self.per_machine,
                self.interval,
                state.controller,
                reference,
                reading,
            )
        elif self._uncompiled:
            # Off the class: a bound method of an `eqx.Module` takes longer to make than to call.
            step = type(self.controller).step
            torque, inner = step(
                self.controller, state.controller, reference, reading, self.interval
            )
        else:
            arrays, program = self._compiled
            with jax.default_device(_cpu()):
                torque, inner = program.step(
                    arrays, state.controller, reference.q, reference.qd, reference.qdd, reading
                )
            torque = np.asarray(torque)
        return torque, ComputerState(state.origin, shown, received, inner)

    def _reference(self, time: Any, origin: Array) -> Reference:
        if self.path is None:
            return Reference.at_rest(origin)
        xp = origin.__array_namespace__()
        now = xp.broadcast_to(xp.asarray(time, dtype=origin.dtype), (*origin.shape[:-1], 1))
        return self.path.reference(now, origin)

    def _check_count(self, reading: Array) -> None:
        if not self.per_machine:
            return
        machines = reading.shape[0] if reading.ndim == 2 else None
        for leaf in jax.tree_util.tree_leaves(self.controller):
            if eqx.is_array(leaf) and leaf.shape[:1] != (machines,):
                raise MachineError(
                    f"controller with an array of shape {leaf.shape} for readings of shape"
                    f" {reading.shape}; expected a first axis of machines in both"
                )

    @functools.cached_property
    def _uncompiled(self) -> bool:
        return self.controller.array_generic and not self.per_machine

    @functools.cached_property
    def _compiled(self) -> tuple[tuple[Array, ...], "_Program"]:
        """The controller's arrays, and the compiled program of its constant part."""
        leaves, structure = jax.tree_util.tree_flatten(self.controller)
        is_array = tuple(eqx.is_array(leaf) for leaf in leaves)
        arrays = tuple(leaf for leaf in leaves if eqx.is_array(leaf))
        constants = tuple(None if eqx.is_array(leaf) else leaf for leaf in leaves)
        program = _program(structure, constants, is_array, self.per_machine, self.interval)
        return jax.device_put(arrays, _cpu()), program


class _Program(NamedTuple):
    """A controller's two methods, compiled; they take its arrays as a tuple, which is fast."""

    begin: Callable[..., Any]
    step: Callable[..., Any]


@functools.lru_cache(maxsize=64)
def _program(
    structure: Any,
    constants: tuple[Any, ...],
    is_array: tuple[bool, ...],
    per_machine: bool,
    interval: float,
) -> _Program:
    """The program of all controllers that differ only in their arrays."""

    def rebuilt(arrays: tuple[Array, ...]) -> Any:
        remaining = iter(arrays)
        leaves = [
            next(remaining) if array else constant
            for array, constant in zip(is_array, constants, strict=True)
        ]
        return jax.tree_util.tree_unflatten(structure, leaves)

    def begin(arrays: tuple[Array, ...], reading: Array) -> Any:
        return _begin(rebuilt(arrays), per_machine, reading)

    def step(
        arrays: tuple[Array, ...], state: Any, q: Array, qd: Array, qdd: Array, reading: Array
    ) -> tuple[Array, Any]:
        reference = Reference(q, qd, qdd)
        return _step(rebuilt(arrays), per_machine, interval, state, reference, reading)

    return _Program(jax.jit(begin), jax.jit(step))


def _begin(controller: Any, per_machine: bool, reading: Array) -> Any:
    def one(controller: Any, reading: Array) -> Any:
        return controller.begin(reading)

    return _strong((_vmap(one, controller) if per_machine else one)(controller, reading))


def _step(
    controller: Any,
    per_machine: bool,
    interval: float,
    state: Any,
    reference: Reference,
    reading: Array,
) -> tuple[Array, Any]:
    def one(controller: Any, state: Any, reference: Reference, reading: Array) -> tuple[Array, Any]:
        return controller.step(state, reference, reading, interval)

    function = _vmap(one, controller) if per_machine else one
    return _strong(function(controller, state, reference, reading))


def _vmap(function: Callable[..., Any], controller: Any) -> Callable[..., Any]:
    """Over the arrays of the controller and those of everything else."""
    arrays, constants = eqx.partition(controller, eqx.is_array)

    def one(arrays: Any, *others: Any) -> Any:
        return function(eqx.combine(arrays, constants), *others)

    return lambda _, *others: jax.vmap(one)(arrays, *others)


def _strong(tree: Any) -> Any:
    """Arrays whose types no later operation changes: a state keeps its type from step to step."""
    return jax.tree_util.tree_map(lambda leaf: jnp.asarray(leaf, jnp.asarray(leaf).dtype), tree)


def _cpu() -> Any:
    return jax.devices("cpu")[0]
