"""Errors of open-loop simulation that starts from states of a recording."""

import contextlib
import dataclasses
from collections.abc import Mapping, Sequence
from types import MappingProxyType
from typing import Any

import numpy as np
from jaxtyping import Array, Bool, Float

from .._text_table import text_table
from ..friction import contact_states, state_after
from ..least_squares import Settings
from ..manipulator import RobotError, link_poses
from ..network import CSLC
from ..recordings import Recording
from ._simulation import applied_torque, interpolated, simulate


Numbers = Array | np.ndarray


HORIZONS = (0.1, 0.2, 0.5, 1.0, 2.0, 5.0)
# States of the recording that simulations start from.
_STARTS = 24


@dataclasses.dataclass(frozen=True, eq=False)
class HorizonError:
    """Error of simulated motion, some time after it started from a state of recorded motion.

    **Attributes**

    - `horizons`: (h,) times after the start [s].
    - `error`: by coefficients, (h, n) median over starts of the absolute error of each joint [rad
      or m]; infinite where simulations diverge.
    - `distance`: by coefficients, (h,) median distance of the origin of the last joint's frame from
      where it was recorded [m]; empty for a robot with lengths of no value.
    - `starts`: (h,) how many simulations are that long.
    - `units`: of each joint's position.

    `print` shows a table.
    """

    horizons: Float[np.ndarray, " horizons"]
    error: Mapping[str, Float[np.ndarray, "horizons joints"]]
    distance: Mapping[str, Float[np.ndarray, " horizons"]]
    starts: tuple[int, ...]
    units: tuple[str, ...]

    def document(self) -> dict[str, Any]:
        """Return the errors as plain data."""
        return {
            "horizons": self.horizons.tolist(),
            "error": {
                name: [[x if np.isfinite(x) else None for x in row] for row in errors.tolist()]
                for name, errors in self.error.items()
            },
            "distance": {
                name: [x if np.isfinite(x) else None for x in values.tolist()]
                for name, values in self.distance.items()
            },
            "starts": list(self.starts),
            "units": list(self.units),
        }

    def __str__(self) -> str:
        joints = range(len(self.units))
        header = ["horizon [s]", "starts", "coefficients"]
        header += [f"joint {joint + 1} [{self.units[joint]}]" for joint in joints]
        header += ["last frame [mm]"] if self.distance else []
        cells = [
            [f"{horizon:g}", str(self.starts[row]), name]
            + [f"{error[row, joint]:.3g}" for joint in joints]
            + [f"{1e3 * values[row]:.3g}" for x, values in self.distance.items() if x == name]
            for row, horizon in enumerate(self.horizons)
            for name, error in self.error.items()
        ]
        return text_table(header, cells)


def prediction_error(
    network: CSLC,
    coefficients: Mapping[str, Float[Array | np.ndarray, " coefficients"]],
    recording: Recording,
    settings: Settings | None = None,
    *,
    horizons: Sequence[float] = HORIZONS,
    presliding_distance: Mapping[str, Float[np.ndarray, " joints"]] = MappingProxyType({}),
) -> HorizonError:
    """Simulates an arm open loop from states of a recording, and compares positions.

    What users of simulators ask for. Without feedback, errors grow: a constant torque error e of a
    joint of inertia M moves it by e t² / 2 M, and gravity makes them grow faster where the arm is
    not stable.

    **Arguments**

    - `network`: n joints, p coefficients, with slopes of static friction.
    - `coefficients`: (p,) by name, such as those of a report and those of the robot's file.
    - `recording`: states to start from, torques to apply, and motion to compare with. Torques are
      held from sample to sample, or interpolated if the settings' alignment is `"sample"`.
    - `settings`: by which it is smoothed; the defaults of `Settings` if None.
    - `horizons`: times after the start [s]; those that the recording is too short for are left out.
    - `presliding_distance`: (n,) [rad or m], by the name of coefficients whose contacts yield
      before they slide (`PreSlidingFit.presliding_distance`). Their states start as the
      motion of the recording before leaves them, from contacts without strain at its beginning.

    **Returns** a `HorizonError`.

    **Raises** `ValueError`: a recording that is shorter than the shortest horizon, or of another
    number of joints.

    >>> import numpy as np, jaxcslc as jc
    >>> from jaxcslc.instruments import prediction_error
    >>> network = jc.derive(jc.examples.pendulum("viscous"))
    >>> k = np.array([0.5, 0.3, -0.1, 0.2])
    >>> recording = jc.examples.swing_recording(network, k, time_step=0.005)
    >>> error = prediction_error(network, {"true": k, "heavy": 1.2 * k}, recording)
    >>> bool(error.error["true"][-1, 0] < 0.01 * error.error["heavy"][-1, 0])
    True
    """
    n = network.joint_count
    if recording.position.shape[1] != n:
        raise ValueError(
            f"the recording has {recording.position.shape[1]} joints; expected {n}, those of"
            f" {network.name!r}"
        )
    settings = settings or Settings()
    patterns = settings.patterns(recording)
    time = np.asarray(patterns.time)
    interval = float(np.median(np.diff(time)))
    length = float(time[-1] - time[0])
    possible = [horizon for horizon in horizons if interval <= horizon < length]
    if not possible:
        raise ValueError(
            f"the recording lasts {length:.3g} s; expected more than {min(horizons):g} s, the"
            " shortest horizon"
        )
    first = np.linspace(time[0], time[-1] - min(possible), _STARTS)
    # Torques and positions at even instants, from each start to the end of the longest horizon.
    instants = first[None, :] + interval * np.arange(round(max(possible) / interval) + 1)[:, None]
    held = settings.preparation.torque_alignment != "sample"
    torque = applied_torque(recording, settings, instants[:-1] + 0.5 * interval, held=held)
    truth = interpolated(time, patterns.q, instants)
    states = truth[0], interpolated(time, patterns.qd, instants[:1])[0]
    rows = np.array([round(horizon / interval) for horizon in possible])
    within = instants[rows] <= time[-1] + 1e-9
    error: dict[str, np.ndarray] = {}
    distance: dict[str, np.ndarray] = {}
    for name, k in coefficients.items():
        contact = presliding_distance.get(name)
        started = None if contact is None else _contacts(time, patterns.q, contact, first)
        path = simulate(
            network, k, *states, torque, interval, presliding_distance=contact, contact=started
        )
        path = np.asarray(path)[rows]
        error[name] = _median(np.abs(path - truth[rows]), within)
        with contextlib.suppress(RobotError):  # lengths without values
            off = _origins(network, path) - _origins(network, truth[rows])
            distance[name] = _median(np.linalg.norm(off, axis=-1), within)
    units = tuple("m" if unit == "N" else "rad" for unit in network.output_units)
    return HorizonError(
        np.array(possible),
        MappingProxyType(error),
        MappingProxyType(distance),
        tuple(map(int, within.sum(axis=1))),
        units,
    )


def file_coefficients(network: CSLC) -> dict[str, Float[Array, " coefficients"]]:
    """`{"file": k}` of the robot's links and friction before identification; empty without."""
    robot = network.robot
    if not robot.links:
        return {}
    values: dict[str, Any] = {"viscous": robot.viscous, "dry": robot.dry}
    friction: dict[str, Any] = {
        kind: value
        for kind, value in values.items()
        if value is not None and all(kind in kinds for kinds in network.friction_per_joint)
    }
    return {"file": network.coefficients_from(robot.links, **friction)}


def _median(
    error: Float[np.ndarray, "..."], within: Bool[np.ndarray, "horizons starts"]
) -> Float[np.ndarray, "..."]:
    """Return medians of (horizons, starts, ...) over starts whose recording is long enough."""
    error = np.where(np.isfinite(error), error, np.inf)
    return np.stack([np.median(row[used], axis=0) for row, used in zip(error, within, strict=True)])


def _origins(
    network: CSLC, q: Float[np.ndarray, "horizons starts joints"]
) -> Float[np.ndarray, "horizons starts 3"]:
    """Return the origins of the last joint's frame [m]."""
    flat = np.where(np.isfinite(q), q, np.nan).reshape(-1, q.shape[-1])
    flat = np.asarray(network.positions_of_all_joints(flat))
    origins = np.asarray(link_poses(network.robot, flat))[:, -1, :3, 3]
    return origins.reshape(*q.shape[:-1], 3)


def _contacts(
    time: Float[np.ndarray, " samples"],
    q: Float[Array | np.ndarray, "samples joints"],
    presliding_distance: Float[np.ndarray, " joints"],
    instants: Float[np.ndarray, " starts"],
) -> Float[np.ndarray, "starts joints"]:
    """States of contacts at instants of a motion, positions between samples by a straight line."""
    length = np.where(presliding_distance > 0.0, presliding_distance, 1.0)
    state = np.asarray(contact_states(q, length, np.zeros(len(length))))
    before = np.clip(np.searchsorted(time, instants, side="right") - 1, 0, len(time) - 1)
    change = interpolated(time, q, instants[None])[0] - np.asarray(q)[before]
    return np.asarray(state_after(state[before], change, length[None]))
