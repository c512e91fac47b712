import functools
from collections.abc import Callable
from dataclasses import dataclass
from typing import Any, NamedTuple

import equinox as eqx
import jax
import jax.numpy as jnp
import numpy as np
from jaxtyping import Float

from jaxcslc.control import Reference

from ..machine import MachineError
from ._arrays import Array, clock
from ._controllers import AbstractController
from ._paths import AbstractPath


class ServoState(NamedTuple):
    """What a `Servo` remembers."""

    origin: Array
    """Where the path begins, (*batch, joints) [rad or m]."""

    loop: Any
    """What its loop remembers."""


@dataclass(frozen=True, eq=False)
class Servo(AbstractController):
    """A feedback loop of `jaxcslc.control` that follows a path, as a controller of the simulator.

    A loop is anything with two pure methods on JAX arrays, such as `jaxcslc.control.Loop`:

    - `begin(q)`: what it remembers at first, the joints at rest where the encoders read `q`.
    - `step(state, reference, q, interval)`: the torque demanded, and what to remember, from the
      `jaxcslc.control.Reference` and the readings `q`, one interval after the step before.

    On NumPy arrays a step is one program, compiled once for a number of machines, that runs on the
    CPU whatever JAX's default device is. Under JAX's tracers, as in a recording under MJX, the
    loop is part of what is traced.

    ```python
    >>> import numpy as np
    >>> import sim
    >>> class Spring:
    ...     def begin(self, q):
    ...         return ()
    ...     def step(self, state, reference, q, interval):
    ...         return 50.0 * (reference.q - q), state
    >>> hold = sim.Servo(Spring(), sim.MinimumJerk(np.ones(6), 2.0))
    >>> hold.demand(hold.begin(np.zeros((1, 6))), 1.0, np.zeros((1, 6)))[0]
    array([[25., 25., 25., 25., 25., 25.]])

    ```
    """

    loop: Any
    """A pytree whose arrays, and nothing else, may change without compiling anew."""

    path: AbstractPath
    """Where the joints should be, from where the encoders find the arm at first."""

    interval: float = 0.002
    """Between samples [s]; the trajectory's."""

    per_machine: bool = False
    """Whether each machine has a loop of its own: every array in `loop` then has a leading axis of
    machines, and the loop sees one machine's readings at a time, (joints,). Otherwise one loop
    sees those of all, (machines, joints)."""

    def __post_init__(self) -> None:
        if not self.interval > 0:
            raise MachineError(f"servo has an interval of {self.interval} s; expected above zero")

    def begin(self, position: Float[Array, "*batch joints"]) -> ServoState:
        """At rest where the encoders say.

        **Raises**

        - `MachineError`: one loop a machine, but not as many as machines.
        """
        self._check_count(position)
        if not isinstance(position, np.ndarray):
            return ServoState(position, _begin(self.loop, self.per_machine, position))
        arrays, program = self._compiled
        with jax.default_device(_cpu()):
            # Committed to the device, as the results of a step are, which compiles once only.
            return ServoState(position, jax.device_put(program.begin(arrays, position), _cpu()))

    def demand(
        self, state: ServoState, time: float | Array, position: Float[Array, "*batch joints"]
    ) -> tuple[Float[Array, "*batch joints"], ServoState]:
        """As the abstract method."""
        wanted = self.path.reference(clock(time, position), state.origin)
        if not isinstance(position, np.ndarray):
            torque, loop = _step(
                self.loop, self.per_machine, self.interval, state.loop, wanted, position
            )
            return torque, ServoState(state.origin, loop)
        arrays, program = self._compiled
        with jax.default_device(_cpu()):
            torque, loop = program.step(
                arrays, state.loop, wanted.q, wanted.qd, wanted.qdd, position
            )
        return np.asarray(torque), ServoState(state.origin, loop)

    def _check_count(self, position: Array) -> None:
        if not self.per_machine:
            return
        machines = position.shape[0] if position.ndim == 2 else None
        for leaf in jax.tree_util.tree_leaves(self.loop):
            if _is_array(leaf) and leaf.shape[:1] != (machines,):
                raise MachineError(
                    f"loop with an array of shape {leaf.shape} for readings of shape"
                    f" {position.shape}; expected a first axis of machines in both"
                )

    @functools.cached_property
    def _compiled(self) -> tuple[tuple[Array, ...], "_Program"]:
        """The loop's arrays, and what is compiled for the rest of it."""
        leaves, structure = jax.tree_util.tree_flatten(self.loop)
        arrays = tuple(leaf for leaf in leaves if _is_array(leaf))
        rest = tuple(None if _is_array(leaf) else leaf for leaf in leaves)
        which = tuple(_is_array(leaf) for leaf in leaves)
        program = _program(structure, rest, which, self.per_machine, self.interval)
        return jax.device_put(arrays, _cpu()), program


class _Program(NamedTuple):
    """A loop's two methods, compiled, on its arrays as a tuple: quicker to hand over."""

    begin: Callable[..., Any]
    step: Callable[..., Any]


@functools.lru_cache(maxsize=64)
def _program(
    structure: Any,
    rest: tuple[Any, ...],
    which: tuple[bool, ...],
    per_machine: bool,
    interval: float,
) -> _Program:
    """Shared by the loops that differ in nothing but their arrays."""

    def whole(arrays: tuple[Array, ...]) -> Any:
        remaining = iter(arrays)
        leaves = [next(remaining) if own else leaf for own, leaf in zip(which, rest, strict=True)]
        return jax.tree_util.tree_unflatten(structure, leaves)

    def begin(arrays: tuple[Array, ...], position: Array) -> Any:
        return _begin(whole(arrays), per_machine, position)

    def step(
        arrays: tuple[Array, ...], state: Any, q: Array, qd: Array, qdd: Array, position: Array
    ) -> tuple[Array, Any]:
        wanted = Reference(q, qd, qdd)
        return _step(whole(arrays), per_machine, interval, state, wanted, position)

    return _Program(jax.jit(begin), jax.jit(step))


def _begin(loop: Any, per_machine: bool, position: Array) -> Any:
    def one(loop: Any, position: Array) -> Any:
        return loop.begin(position)

    return _strong((_vmap(one, loop) if per_machine else one)(loop, position))


def _step(
    loop: Any,
    per_machine: bool,
    interval: float,
    state: Any,
    wanted: Reference,
    position: Array,
) -> tuple[Array, Any]:
    def one(loop: Any, state: Any, wanted: Reference, position: Array) -> tuple[Array, Any]:
        return loop.step(state, wanted, position, interval)

    return _strong((_vmap(one, loop) if per_machine else one)(loop, state, wanted, position))


def _vmap(function: Callable[..., Any], loop: Any) -> Callable[..., Any]:
    """Over the arrays of the loop and those of everything else."""
    arrays, rest = eqx.partition(loop, _is_array)

    def one(arrays: Any, *others: Any) -> Any:
        return function(eqx.combine(arrays, rest), *others)

    return lambda _, *others: jax.vmap(one)(arrays, *others)


def _strong(tree: Any) -> Any:
    """Arrays whose types no later operation changes: a state keeps its type from step to step."""
    return jax.tree_util.tree_map(lambda leaf: jnp.asarray(leaf, jnp.asarray(leaf).dtype), tree)


def _is_array(leaf: Any) -> bool:
    return isinstance(leaf, (jax.Array, np.ndarray))


def _cpu() -> Any:
    return jax.devices("cpu")[0]
