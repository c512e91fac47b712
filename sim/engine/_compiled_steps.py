import ctypes
from collections.abc import Sequence
from concurrent.futures import ThreadPoolExecutor
from functools import cache
from pathlib import Path
from typing import TYPE_CHECKING, Any

import numpy as np
from jaxtyping import Float

from jaxcslc.codegen import CFunction
from sim.engine._hardware import JointHardware


if TYPE_CHECKING:
    from mujoco import MjData, MjModel
    from mujoco.batch import Batch

# MuJoCo's functions by their names in `advance.c`.
_FUNCTIONS = {
    "kinematics": "mj_kinematics",
    "com_pos": "mj_comPos",
    "inertia": "mj_crb",
    "com_vel": "mj_comVel",
    "rne": "mj_rne",
}


class _Group(ctypes.Structure):
    """`Group` of `advance.c`."""

    _fields_ = (
        *((name, ctypes.c_void_p) for name in _FUNCTIONS),
        *((name, ctypes.c_long) for name in ("machines", "joints", "dofs", "steps")),
        ("step", ctypes.c_double),
        *((name, ctypes.c_void_p) for name in ("rotor", "models", "state")),
        *((name, ctypes.c_long) for name in ("row", "position", "velocity", "warmstart")),
        *((name, ctypes.c_void_p) for name in ("viscous", "dry", "static_loss", "gamma")),
        *((name, ctypes.c_void_p) for name in ("asymmetry", "stale", "before", "torque")),
        ("acceleration", ctypes.c_void_p),
        ("next", ctypes.c_long),
    )


class CompiledSteps:
    """Integration steps of machines side by side in C, from demand to demand without Python.

    To rounding they are those of MuJoCo's `mj_step` for models of `model_of`. MuJoCo computes mass
    matrix and bias forces of the links, `advance.c` the remainder: for a PUMA 560 with every
    disturbance a step takes 3.1 µs, `mj_step` 14 µs. Made by `compiled_steps`.
    """

    def __init__(
        self,
        functions: tuple[Any, dict[str, int]],
        batch: "Batch",
        hardware: JointHardware,
        threads: int,
    ) -> None:
        from mujoco import MjData

        self._batch, friction = batch, hardware.friction
        machines, dofs = friction.viscous.shape
        joints = len(hardware.flexible)
        self._advance, addresses = functions
        self._before, self._torque = np.zeros((2, machines, joints))
        self._acceleration = np.zeros((machines, dofs))
        arrays = {
            "rotor": np.ascontiguousarray(hardware.rotor, np.dtype("long")),
            "viscous": friction.viscous,
            "dry": friction.dry,
            "static_loss": friction.static,
            "gamma": friction.static_velocity,
            "asymmetry": friction.asymmetry,
            "stale": hardware.stale,
            "before": self._before,
            "torque": self._torque,
            "acceleration": self._acceleration,
        }
        # C reads and writes them at their addresses: they live as long as this object.
        self._arrays = {name: np.ascontiguousarray(values) for name, values in arrays.items()}
        self._models: Sequence[MjModel] = ()
        self._addresses = np.zeros(machines, np.uintp)
        row = batch.state.ctypes.data

        def offset(part: str) -> int:
            """Where a part of a state row begins."""
            return (batch.bind(part).ctypes.data - row) // batch.state.itemsize

        self._group = _Group(
            machines=machines,
            joints=joints,
            dofs=dofs,
            steps=hardware.stale.shape[1],
            step=hardware.step,
            models=self._addresses.ctypes.data,
            state=row,
            row=batch.nstate,
            position=offset("qpos"),
            velocity=offset("qvel"),
            warmstart=offset("qacc_warmstart"),
            **addresses,
            **{name: values.ctypes.data for name, values in self._arrays.items()},
        )
        self._data = [MjData(batch.model) for _ in range(threads)]
        self._pool = ThreadPoolExecutor(threads - 1) if threads > 1 else None

    def use(self, models: Sequence["MjModel"]) -> None:
        """Gives each machine a model, from now on."""
        self._models = models
        self._addresses[:] = [model._address for model in models]  # pyright: ignore[reportAttributeAccessIssue]

    def advance(
        self,
        before: Float[np.ndarray, "machines joints"],
        torque: Float[np.ndarray, "machines joints"],
        acceleration: Float[np.ndarray, "machines dofs"],
    ) -> None:
        """Integrates the equations of motion of all machines from demand to demand.

        **Arguments**

        - `before`, `torque`: the drives' torque for the previous and the present demand.
        - `acceleration`: of the degrees of freedom at the beginning.
        """
        self._before[:], self._torque[:] = before, torque
        self._acceleration[:] = acceleration
        self._group.next = 0
        first, *others = self._data
        running = [] if self._pool is None else [self._pool.submit(self._run, x) for x in others]
        try:
            self._run(first)
        finally:
            for one in running:
                one.result()

    def _run(self, data: "MjData") -> None:
        """Advances machines that no other thread has taken, until none is left."""
        address = data._address  # pyright: ignore[reportAttributeAccessIssue]
        self._advance(ctypes.byref(self._group), address)


def batch_threads(threads: int, machines: int) -> int:
    """How many of `threads` MuJoCo's batch should have.

    Its threads wait actively. When it only evaluates accelerations once a sample, 4 µs a machine,
    that costs more than a second thread gains for 8 machines, and less for 64.
    """
    return threads if _functions() is None else max(1, min(threads, machines // 16))


def compiled_steps(batch: "Batch", hardware: JointHardware, threads: int) -> CompiledSteps | None:
    """Integration steps in C, or None where there is no C compiler.

    **Arguments**

    - `batch`: of MuJoCo, whose states are advanced.
    - `hardware`: of the machines.
    - `threads`: how many to use.
    """
    functions = _functions()
    return None if functions is None else CompiledSteps(functions, batch, hardware, threads)


@cache
def _functions() -> tuple[Any, dict[str, int]] | None:
    """The compiled function `advance`, and the addresses of MuJoCo's that it calls."""
    from mujoco import _functions as bindings

    source = Path(__file__).with_name("advance.c").read_text("utf-8")
    headers = Path(bindings.__file__).with_name("include")
    kinds = ctypes.c_void_p, ctypes.c_void_p
    # Compiled in 0.1 s in place of 0.3 s, for steps that are 2 % slower.
    advance = CFunction(source, "advance", kinds, ("-O1", "-I", str(headers)))
    if not advance.is_available:
        return None
    try:
        # The library that the bindings have loaded is found through them, whatever its name.
        loaded = ctypes.CDLL(bindings.__file__)
        addresses = {
            name: ctypes.cast(getattr(loaded, function), ctypes.c_void_p).value or 0
            for name, function in _FUNCTIONS.items()
        }
    except (AttributeError, OSError):
        return None
    return advance.bound(), addresses
