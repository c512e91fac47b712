"""Plant under C MuJoCo: machines side by side, stepped in batches by `advance.c`."""

import ctypes
from collections.abc import Sequence
from concurrent.futures import ThreadPoolExecutor
from functools import cache
from pathlib import Path
from typing import TYPE_CHECKING, Any

import numpy as np
from jaxtyping import Bool, Float

from jaxcslc.codegen import CFunction
from jaxcslc.manipulator import LinkParameters
from sim.engine._hardware import JointHardware
from sim.engine._models import check_time_step, model_of
from sim.engine._plan import Plan
from sim.machine._events import carrying
from sim.machine._machine import Machine


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
            """Return where a part of a state row begins."""
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
    """Return how many of `threads` MuJoCo's batch should have.

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
    # Compiled in 0.1 s instead of 0.3 s, for steps that are 2 % slower.
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


class Plant:
    """The mechanics of machines in motion: drives, rotors, gears, links and friction.

    Any number of machines move side by side, on any number of threads. The motion of a
    machine depends neither on the others nor on the number of threads, to the last bit.

    The equations of motion are integrated by a fourth-order Runge-Kutta method. A semi-implicit
    Euler method of the same cost shifts positions against torques by half a step, which
    biases an identification: at a step of an eighth of a millisecond, as an error of 0.01 N m at
    joint 6 in the training trajectory.

    Where there is a C compiler, `CompiledSteps` does the steps; otherwise MuJoCo does, to rounding
    the same. Accelerations and friction at a sample are always MuJoCo's.

    A joint sticks or slips as MuJoCo's friction constraint decides. The part of Eqn. 2.5-4 that
    varies with the speed (`Friction.help`) is constant over a step, at its value for the speed
    expected at the step's middle.

    Every array below has shape `(machines, joints)`, or `(joints,)` for a plant of one machine
    that was not passed as a sequence. A plant is the only mutable object of the simulator.

    >>> import numpy as np
    >>> import sim
    >>> plant = sim.Plant(sim.puma560(), np.zeros(6), interval=0.002)
    >>> plant.drive(np.array([10.0, 0, 0, 0, 0, 0]))
    >>> plant.advance()
    >>> bool(plant.velocity[0] > 0)
    True
    """

    def __init__(
        self,
        machines: Machine | Sequence[Machine],
        position: Float[np.ndarray, "*machines joints"],
        *,
        interval: float,
        threads: int = 1,
        hardware: JointHardware | None = None,
    ) -> None:
        """Machines at rest, their gears in the middle of the dead band.

        **Arguments**

        - `machines`: one, or several of as many joints, with the same flexible transmissions and
            the same time step.
        - `position`: of their joints [rad or m].
        - `interval`: by how much `advance` goes on [s]; divided into equal steps, each at most
            the machines' `time_step`.
        - `threads`: how many to use.
        - `hardware`: of the machines; made from them if omitted.

        **Raises** `MachineError`: machines of different structure, a torque limit below gravity's
        need, a time step too long for a transmission, a torque delay as long as the interval.
        """
        self._alone = isinstance(machines, Machine)
        group = [machines] if isinstance(machines, Machine) else list(machines)
        from mujoco.batch import Batch

        self._plan = Plan.of(group, interval)
        self._hardware = JointHardware.of(group, self._plan) if hardware is None else hardware
        self._rotor = self._hardware.rotor

        at = np.atleast_2d(position)
        self._group, self._start = group, at
        self._compiled: dict[int, tuple[LinkParameters | None, list[MjModel]]] = {}
        count = len(group)
        self._batch = Batch(self._models(None)[0], count, nthread=batch_threads(threads, count))
        self._steps = compiled_steps(self._batch, self._hardware, threads)
        self.carry(None)
        self._q, self._qd = self._batch.bind("qpos"), self._batch.bind("qvel")
        self._control, self._applied = self._batch.bind("ctrl"), self._batch.bind("qfrc_applied")
        self._qdd = self._batch.bind("qacc")
        self._constraint = self._batch.bind("qfrc_constraint")
        self._n = group[0].joint_count
        self._q[:, : self._n] = at
        self._q[:, self._rotor] = at
        self._torque = np.zeros(at.shape)
        self._before = self._torque
        self.drive(np.zeros(position.shape))

    @property
    def position(self) -> Float[np.ndarray, "*machines joints"]:
        """Positions of the links [rad or m]."""
        return self._rows(self._q[:, : self._n])

    @property
    def velocity(self) -> Float[np.ndarray, "*machines joints"]:
        """Velocities of the links [rad/s or m/s]."""
        return self._rows(self._qd[:, : self._n])

    @property
    def acceleration(self) -> Float[np.ndarray, "*machines joints"]:
        """Accelerations of the links at the latest `drive` [rad/s² or m/s²]."""
        return self._rows(self._observed["acceleration"])

    @property
    def rotor_position(self) -> Float[np.ndarray, "*machines joints"]:
        """Positions of the rotors, at the joint [rad or m]."""
        return self._rows(self._q[:, self._rotor])

    @property
    def rotor_velocity(self) -> Float[np.ndarray, "*machines joints"]:
        """Velocities of the rotors, at the joint [rad/s or m/s]."""
        return self._rows(self._qd[:, self._rotor])

    @property
    def torque(self) -> Float[np.ndarray, "*machines joints"]:
        """Torque of the drives just after the latest `drive` [N m or N]."""
        return self._rows(self._observed["torque"])

    @property
    def friction(self) -> Float[np.ndarray, "*machines joints"]:
        """Friction of rotor and link at the latest `drive` [N m or N]."""
        return self._rows(self._observed["friction"])

    @property
    def transmitted(self) -> Float[np.ndarray, "*machines joints"]:
        """Torque through the gears from rotor to link at the latest `drive` [N m or N]."""
        return self._rows(self._observed["transmitted"])

    @property
    def apart(self) -> Bool[np.ndarray, "*machines joints"]:
        """Return whether the teeth are apart now: the joint is in backlash (2.5.3)."""
        return self._rows(self._hardware.apart(self._q))

    @property
    def observed(self) -> dict[str, np.ndarray]:
        """The true state at the latest `drive`, (machines, joints), by the fields of `Truth`.

        Positions and velocities change with the next `advance`: copy what is to be kept.
        """
        return self._observed

    def read(self, late: Float[np.ndarray, " machines"]) -> Float[np.ndarray, "machines joints"]:
        """Encoder readings of machines that read them `late` [s] after now [rad or m]."""
        return self._hardware.read(self._q, self._qd, late)

    def carry(self, body: LinkParameters | None) -> None:
        """Fixes a body to the last link from now on, instead of any previous one, or releases it.

        Positions and velocities do not change; the next `drive` computes the accelerations. The
        models of a body are compiled when it is first carried, and cached.

        **Arguments**

        - `body`: in the last link's frame; None for none.

        **Raises** `MachineError`: as for a machine with such a link.

        >>> import numpy as np
        >>> import jaxcslc, sim
        >>> plant = sim.Plant(sim.undisturbed(sim.puma560()), np.zeros(6), interval=0.002)
        >>> ball = jaxcslc.LinkParameters(2.0, np.array([0.0, 0.0, 0.1]), np.zeros((3, 3)))
        >>> accelerations = []
        >>> for body in (None, ball):
        ...     plant.carry(body)
        ...     plant.drive(np.array([0.0, 0.0, 0.0, 0.0, 5.0, 0.0]))
        ...     accelerations.append(plant.acceleration[4])
        >>> bool(accelerations[1] < accelerations[0])
        True
        """
        models = self._models(body)
        self._batch.set_models(models)
        if self._steps is not None:
            self._steps.use(models)

    def drive(self, demand: Float[np.ndarray, "*machines joints"]) -> None:
        """Gives the drives a torque command, which they follow within their limits [N m or N]."""
        self._before = self._torque
        self._torque = self._hardware.drives.torque(np.atleast_2d(demand))
        torque = self._hardware.acting(0, self._before, self._torque)
        assist = self._hardware.assist(self._qd)
        self._control[:], self._applied[:] = torque, assist
        self._batch.forward()
        self._acceleration = self._qdd.copy()
        self._observed = self._hardware.observed(
            self._q, self._qd, self._acceleration, torque, assist, self._constraint
        )

    def advance(self) -> None:
        """Integrates the equations of motion over one interval."""
        if self._steps is not None:
            self._steps.advance(self._before, self._torque, self._acceleration)
            return
        acceleration = self._acceleration
        for step in range(self._plan.steps):
            before = self._qd.copy()
            if self._hardware.delayed:
                self._control[:] = self._hardware.acting(step, self._before, self._torque)
            self._applied[:] = self._hardware.assist(before, acceleration)
            self._batch.step()
            acceleration = (self._qd - before) / self._plan.step

    def _models(self, body: LinkParameters | None) -> list["MjModel"]:
        """Return each machine's mechanics with a body."""
        if id(body) not in self._compiled:
            # Machines of many recordings are often the same one.
            loaded = {id(machine): carrying(machine, body) for machine in self._group}
            models = {key: model_of(machine, self._plan.step) for key, machine in loaded.items()}
            for machine, row in zip(self._group, self._start, strict=True):
                check_time_step(machine, models[id(machine)], row)
            self._compiled[id(body)] = body, [models[id(machine)] for machine in self._group]
        return self._compiled[id(body)][1]

    def _rows(self, values: np.ndarray) -> np.ndarray:
        return values[0].copy() if self._alone else values.copy()
