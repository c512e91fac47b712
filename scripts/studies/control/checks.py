"""Two checks of computed torque: its ideal case, and its bounds on random motions."""

import dataclasses
from collections.abc import Callable, Mapping, Sequence
from typing import Any, NamedTuple

import jax.numpy as jnp
import numpy as np
from jaxtyping import Array, Float
from scipy.linalg import expm

import jaxcslc as jc
import sim
from jaxcslc.control import AbstractController, ComputedTorque, Reference, error_gains


Rows = list[dict[str, Any]]

# The ideal case: torque is renewed this often, for the response of the gains is continuous.
FINE = 1e-4  # s
WATCHED = 0.6  # s
MEAN = np.array([0.2, -0.8, 0.9, 0.1, 0.6, -0.3])
SWING = np.array([0.6, 0.4, 0.5, 0.5, 0.5, 0.6])
PERIOD = 1.5
FIRST = np.array([0.1, -0.08, 0.12, 0.2, -0.15, 0.1])  # rad, off the path at first

# Random motions: top speeds that a motion has a part of, and what it pauses at its end.
TOP = np.array([4.0, 3.5, 5.0, 8.0, 8.0, 8.0])  # rad/s
PARTS = (0.8, 1.6)
PAUSE = 0.1  # s
INTERVAL = 0.002  # s
IN_TURN = 10  # motions that a machine makes one after the other
STEEPEST = 15 / 8  # of minimum jerk's rate


class ExactState(NamedTuple):
    """The last reading, and the controller's state."""

    before: Float[Array, " joints"]
    controller: Any


class ExactLoop(AbstractController):
    """A controller behind exact encoders: its velocity is the difference of two readings."""

    controller: ComputedTorque

    def begin(self, q: Array | np.ndarray) -> ExactState:
        q = jnp.asarray(q)
        return ExactState(q, self.controller.begin(q))

    def step(
        self,
        state: ExactState,
        reference: Reference,
        q: Array | np.ndarray,
        interval: float | Array,
        qd: Array | np.ndarray | None = None,
    ) -> tuple[Array, ExactState]:
        q = jnp.asarray(q)
        qd = (q - state.before) / interval
        torque, inner = self.controller.step(state.controller, reference, q, interval, qd)
        return jnp.asarray(torque), ExactState(q, inner)


def prescribed(
    frequency: float, damping: float, error: Float[np.ndarray, " joints"], samples: int
) -> Float[np.ndarray, "samples joints"]:
    """e" + 2 ζ ω e' + ω² e = 0 from rest, every `FINE` seconds."""
    position, velocity = (float(gain) for gain in error_gains(frequency, damping))
    transition = expm(FINE * np.array([[0.0, 1.0], [-position, -velocity]]))
    state, response = np.array([1.0, 0.0]), np.empty(samples)
    for sample in range(samples):
        response[sample] = state[0]
        state = transition @ state
    return response[:, None] * error


def ideal_rows(network: jc.CSLC, frequency: float, damping: float) -> Rows:
    """A perfect model without disturbances beside the response of the gains.

    Links, viscous friction and torque limits of the PUMA 560, no dry friction, exact encoders; an
    oscillation of all joints that the arm starts off by some tenth of a radian.
    """
    puma = sim.puma560()
    none = (0.0,) * puma.joint_count
    machine = dataclasses.replace(
        sim.undisturbed(puma), dry=none, static=none, start_spread=0.0, time_step=FINE,
        maximum_torque=(np.inf,) * puma.joint_count,
    )  # fmt: skip
    k = network.coefficients_from(machine.links, viscous=machine.viscous)
    path = sim.Oscillation(MEAN, SWING, PERIOD)
    samples = round(WATCHED / FINE)
    loop = ExactLoop(ComputedTorque(network, k, frequency, damping))
    trajectory = sim.Trajectory("ideal case", MEAN - SWING - FIRST, loop, samples, FINE, path=path)
    _, truth = sim.simulate(machine, trajectory)
    reference = path.reference(truth.time[:, None], np.zeros(truth.position.shape)).q
    error = reference - truth.position
    off = np.abs(error - prescribed(frequency, damping, FIRST, samples)) / np.abs(FIRST)
    return [
        {
            "joint": str(i + 1),
            "first error [mrad]": 1e3 * float(FIRST[i]),
            "error after 0.1 s [mrad]": 1e3 * float(error[round(0.1 / FINE), i]),
            "prescribed [mrad]": 1e3
            * float(prescribed(frequency, damping, FIRST, samples)[round(0.1 / FINE), i]),
            "largest deviation [% of first]": 100 * float(off[:, i].max()),
        }
        for i in range(len(FIRST))
    ]


def random_motions(
    machine: sim.Machine, count: int, start: np.ndarray
) -> tuple[sim.ViaPoints, Float[np.ndarray, " machines"]]:
    """Motions between random poses of the whole joint range, some in turn for each machine."""
    machines = -(-count // IN_TURN)
    poses = np.stack(
        [sim.go_to(machine, motion, 1.0)[1].end for motion in range(machines * IN_TURN)]
    ).reshape(machines, IN_TURN, -1)
    rng = np.random.default_rng(count)
    distance = np.abs(np.diff(poses, axis=1, prepend=np.tile(start, (machines, 1, 1))))
    part = rng.uniform(*PARTS, distance.shape[:2])
    durations = STEEPEST * np.max(distance / TOP, axis=2) / part
    path = sim.ViaPoints(poses, durations, np.full(durations.shape, PAUSE))
    return path, path.arrivals[:, -1] + PAUSE


def stability_rows(
    cases: Mapping[str, Callable[[int], Any]],
    machines: Sequence[sim.Machine],
    count: int,
    start: np.ndarray,
    stacked: Callable[[Sequence[Any]], Any],
) -> Rows:
    """Return whether torques and joints stay within bounds over many random motions.

    **Arguments**

    - `cases`: by name, a function from the number of a machine to its loop.
    - `machines`: used in turn.
    - `count`: motions a case, rounded up to whole machines.
    - `start`: where all motions begin.
    - `stacked`: makes one loop of several.
    """
    path, needed = random_motions(machines[0], count, start)
    numbers = [i % len(machines) for i in range(len(needed))]
    used = [machines[i] for i in numbers]
    limit = np.array([machine.maximum_torque for machine in used])
    rows: Rows = []
    for name, loop_of in cases.items():
        loops = stacked([loop_of(i) for i in numbers])
        samples = round(float(needed.max()) / INTERVAL) + 1
        trajectory = sim.Trajectory(
            f"random motions, {name}", start, loops, samples, INTERVAL, path=path, per_machine=True
        )
        results = sim.close_loop(used, trajectory, list(range(len(used))), progress=True)
        good = [result for result in results if not isinstance(result, sim.SimulationError)]
        errors = [str(result) for result in results if isinstance(result, sim.SimulationError)]
        ratio, margin, off, saturated = [0.0], [np.inf], [0.0], [0.0]
        for i, result in enumerate(results):
            if isinstance(result, sim.SimulationError):
                continue
            share = np.abs(result.recording.torque) / limit[i]
            ratio.append(float(share.max()))
            saturated.append(float(np.mean(share > 0.999)))
            low, high = np.array(used[i].position_range).T
            q = result.truth.position
            margin.append(float(np.minimum(q - low, high - q).min()))
            # A machine rests at its last pose until the last of all has come to rest.
            off.append(float(np.abs(q[-1] - path.poses[i, -1]).max()))
        rows.append(
            {
                "case": name,
                "motions": IN_TURN * len(used),
                "without error": IN_TURN * len(good),
                "largest demand over limit": max(ratio),
                "saturated [%]": 100 * float(np.sum(saturated)) / max(len(good), 1),
                "machines that saturate": str(sum(share > 0 for share in saturated)),
                "nearest to a range end [rad]": min(margin),
                "largest error at rest [mrad]": 1e3 * max(off),
                "errors": "; ".join(errors[:3]) or "none",
            }
        )
    return rows
