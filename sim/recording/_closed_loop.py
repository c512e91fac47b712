"""Machines side by side on one trajectory, with the states of their controllers."""

from collections.abc import Callable, Mapping, Sequence
from typing import Any, NamedTuple

import numpy as np
from tqdm import tqdm

from jaxcslc.recordings import Recording
from sim.engine._simulate import SimulationError, Truth, perform, thread_count
from sim.machine._machine import Machine
from sim.trajectory._trajectories import Trajectory


class ClosedLoop(NamedTuple):
    """A recording, the true state, and observations of the controller."""

    recording: Recording
    """Encoder readings, and the torques demanded in response."""

    truth: Truth

    observed: dict[str, np.ndarray]
    """Whatever `observe` returned, (samples, ...)."""


def close_loop(
    machines: Sequence[Machine],
    trajectory: Trajectory,
    seeds: Sequence[int],
    *,
    observe: Callable[[Any], Mapping[str, Any]] | None = None,
    threads: int | None = None,
    progress: bool = False,
) -> list[ClosedLoop | SimulationError]:
    """Simulates machines on one trajectory side by side, and records their controllers' states.

    As `record`, but with one trajectory, without a store, and with C MuJoCo. Each machine moves as
    it would alone, to rounding: one program computes all torques.

    **Arguments**

    - `machines`: with the same number of joints, the same joints with friction, the same flexible
        transmissions and the same time step.
    - `trajectory`: the motion and its controller.
    - `seeds`: one a machine.
    - `observe`: gets the controller's state after each sample; returns arrays with a first axis of
        machines, by name.
    - `threads`: of C MuJoCo; as many as the process has cores, if omitted.
    - `progress`: show a progress bar on standard error.

    **Returns**

    For each machine its `ClosedLoop`, or the error that ended the simulation.

    **Raises**

    - `MachineError`: a machine or trajectory that cannot exist; before anything runs.
    - `ValueError`: fewer than one thread; an observation without a first axis of machines.

    >>> import dataclasses, sim
    >>> trajectory = dataclasses.replace(sim.comparison(), samples=20)
    >>> machines = [sim.specimen(sim.puma560(), seed) for seed in range(3)]
    >>> see = lambda state: {"integral": state.integral}
    >>> results = sim.close_loop(machines, trajectory, [0, 1, 2], observe=see)
    >>> results[2].observed["integral"].shape
    (20, 6)
    """
    seen: dict[str, list[np.ndarray]] = {}
    count = len(machines)

    def look(state: Any) -> None:
        if observe is not None:
            for name, values in observe(state).items():
                array = np.array(values)  # a copy: it may be a view of an array that changes
                if array.shape[:1] != (count,):
                    raise ValueError(
                        f"observe: {name!r} has shape {array.shape}; expected a first axis of"
                        f" {count} machines"
                    )
                seen.setdefault(name, []).append(array)

    with tqdm(
        total=trajectory.samples * count,
        desc=trajectory.name,
        unit=" samples",
        unit_scale=True,
        disable=None if progress else True,
    ) as bar:
        results = perform(
            machines,
            trajectory,
            seeds,
            threads=thread_count(threads, count),
            advanced=bar.update,
            observe=None if observe is None else look,
        )
    observed = {name: np.stack(values, axis=1) for name, values in seen.items()}
    return [
        result
        if isinstance(result, SimulationError)
        else ClosedLoop(*result, {name: values[i] for name, values in observed.items()})
        for i, result in enumerate(results)
    ]
