"""Kinds of wrong recordings and wrong robot files, 44 of them, each in three sizes, mild to gross.

Each kind is a function of `SPOILERS`. It makes a `Spoilt`: recordings, and the kinds of findings
that name what is wrong. Faults of the arm itself are simulated (`robots.Fault`), others change the
recording.
"""

import dataclasses
from collections.abc import Callable
from typing import Any

import numpy as np
import scipy

import jaxcslc as jc
from scripts.studies.checks.robots import FILES, Arm, Conditions, Fault, Run, arm, record


@dataclasses.dataclass(frozen=True)
class Spoilt:
    """Recordings with one thing wrong, and findings that name it.

    - `recordings`: usually one.
    - `kinds`: of findings, each of which is right.
    - `joints`: joints, from 0, that the finding must name; none if it is about all.
    - `file`: arm whose file is used, if not its own.
    """

    recordings: tuple[jc.Recording, ...]
    kinds: tuple[str, ...]
    joints: tuple[int, ...] = ()
    file: str = ""


@dataclasses.dataclass(frozen=True)
class Case:
    """What a spoiler gets: an arm, a clean run of it, a size from 0 to 2, and random numbers."""

    arm: Arm
    run: Run
    size: int
    seed: int
    rng: np.random.Generator

    @property
    def joints(self) -> int:
        """Number of joints."""
        return self.run.q.shape[1]

    @property
    def recording(self) -> jc.Recording:
        """The clean recording."""
        return self.run.recording

    def of_size(self, *sizes: Any) -> Any:
        """Return the value of this case's size."""
        return sizes[self.size]

    def joint(self, *, loaded: bool = True) -> int:
        """Return a joint; with gravity or inertia worth the name if `loaded`."""
        rigid = np.std(self.run.gravity + self.run.motion, axis=0)
        whole = np.std(self.recording.torque, axis=0)
        some = np.flatnonzero(rigid > 0.6 * whole) if loaded else np.arange(self.joints)
        return int(self.rng.choice(some))

    def faulty(self, fault: Fault) -> jc.Recording:
        """Return the recording of the arm with a fault."""
        return record(self.arm.name, Conditions(), self.seed, fault).recording


def _changed(recording: jc.Recording, **arrays: Any) -> jc.Recording:
    return dataclasses.replace(recording, **arrays)


def _with_columns(
    values: np.ndarray, joints: Any, change: Callable[[np.ndarray], np.ndarray]
) -> np.ndarray:
    changed = np.array(values)
    changed[:, joints] = change(changed[:, joints])
    return changed


def _torque(case: Case, change: Callable[[np.ndarray], np.ndarray], joints: Any) -> jc.Recording:
    return _changed(case.recording, torque=_with_columns(case.recording.torque, joints, change))


def _position(case: Case, change: Callable[[np.ndarray], np.ndarray], joints: Any) -> jc.Recording:
    changed = _with_columns(case.recording.position, joints, change)
    return _changed(case.recording, position=changed)


_EVERY = slice(None)
_GAIN = ("torque scale", "torque unit")


# The torque channel.


def _no_gravity(case: Case) -> Spoilt:
    part = case.of_size(0.8, 0.95, 1.0)
    torque = case.recording.torque - part * case.run.gravity
    return Spoilt((_changed(case.recording, torque=torque),), ("gravity compensation",))


def _all_scaled(case: Case) -> Spoilt:
    factor = case.of_size(1.3, 2.0, 6.0)
    return Spoilt((_torque(case, lambda x: factor * x, _EVERY),), _GAIN)


def _torque_constant(case: Case) -> Spoilt:
    """A factor that neither data nor the file's masses can show."""
    factor = case.of_size(1.05, 1.1, 1.2)
    return Spoilt((_torque(case, lambda x: factor * x, _EVERY),), _GAIN)


def _one_scaled(case: Case) -> Spoilt:
    joint, factor = case.joint(), case.of_size(1.1, 1.3, 1.6)
    return Spoilt((_torque(case, lambda x: factor * x, joint),), _GAIN, (joint,))


def _gear_ratio(case: Case) -> Spoilt:
    joint, factor = case.joint(), case.of_size(0.5, 2.0, 0.01)
    return Spoilt((_torque(case, lambda x: factor * x, joint),), _GAIN, (joint,))


def _millinewtons(case: Case) -> Spoilt:
    factor = case.of_size(10.0, 100.0, 1000.0)
    return Spoilt((_torque(case, lambda x: factor * x, _EVERY),), _GAIN)


def _millinewtons_at_one(case: Case) -> Spoilt:
    joint, factor = case.joint(), case.of_size(10.0, 100.0, 1000.0)
    return Spoilt((_torque(case, lambda x: factor * x, joint),), _GAIN, (joint,))


def _currents(case: Case) -> Spoilt:
    lowest, highest = case.of_size((1.5, 3.0), (4.0, 15.0), (50.0, 200.0))
    constants = case.rng.uniform(lowest, highest, case.joints)
    return Spoilt((_torque(case, lambda x: x / constants, _EVERY),), _GAIN)


def _one_sign(case: Case) -> Spoilt:
    joint = case.joint()
    return Spoilt((_torque(case, lambda x: -x, joint),), ("sign",), (joint,))


def _all_signs(case: Case) -> Spoilt:
    return Spoilt((_torque(case, lambda x: -x, _EVERY),), ("sign",))


def _unsigned(case: Case) -> Spoilt:
    negative = np.mean(case.recording.torque < 0.0, axis=0)
    both = np.flatnonzero((negative > 0.1) & (negative < 0.9))
    joints = np.sort(case.rng.permutation(both)[: case.of_size(1, 2, both.size)])
    return Spoilt((_torque(case, np.abs, joints),), ("unsigned torque",), (int(joints[0]),))


def _held(case: Case) -> Spoilt:
    every = case.of_size(2, 4, 10)
    rows = np.arange(case.recording.samples) // every * every
    torque = case.recording.torque[rows]
    return Spoilt((_changed(case.recording, torque=torque),), ("rate",))


def _filtered(case: Case) -> Spoilt:
    cutoff = case.of_size(8.0, 3.0, 1.0)
    b, a = scipy.signal.butter(1, cutoff, fs=1.0 / float(case.recording.time[1]))
    torque = scipy.signal.lfilter(b, a, case.recording.torque, axis=0)
    kinds = ("torque lag", "filtered torque")
    return Spoilt((_changed(case.recording, torque=torque),), kinds)


def _late(case: Case) -> Spoilt:
    return _lagging(case, case.of_size(0.008, 0.03, 0.1))


def _early(case: Case) -> Spoilt:
    return _lagging(case, case.of_size(-0.008, -0.03, -0.1))


def _lagging(case: Case, lag: float) -> Spoilt:
    time = case.recording.time
    late = [np.interp(time - lag, time, column) for column in case.recording.torque.T]
    torque = np.stack(late, axis=1)
    return Spoilt((_changed(case.recording, torque=torque),), ("torque lag",))


def _zero_drift(case: Case) -> Spoilt:
    joint, part = case.joint(), case.of_size(0.1, 0.3, 1.0)
    time = case.recording.time / case.recording.time[-1]
    ramp = part * float(np.std(case.recording.torque[:, joint])) * time
    return Spoilt((_torque(case, lambda x: x + ramp, joint),), ("drift",), (joint,))


def _clipped(case: Case) -> Spoilt:
    joint, part = case.joint(), case.of_size(0.95, 0.85, 0.7)
    limit = float(np.quantile(np.abs(case.recording.torque[:, joint]), part))
    clipped = _torque(case, lambda x: np.clip(x, -limit, limit), joint)
    return Spoilt((clipped,), ("clipping",), (joint,))


def _saturated(case: Case) -> Spoilt:
    """A sensor at its end of range, with noise on it."""
    joint, part = case.joint(), case.of_size(0.95, 0.85, 0.7)
    clean = case.recording.torque - case.run.noise
    limit = float(np.quantile(np.abs(clean[:, joint]), part))
    torque = _with_columns(clean, joint, lambda x: np.clip(x, -limit, limit)) + case.run.noise
    return Spoilt((_changed(case.recording, torque=torque),), ("clipping",), (joint,))


def _outliers(case: Case) -> Spoilt:
    torque, size = case.recording.torque.copy(), np.std(case.recording.torque, axis=0)
    hit = case.rng.random(torque.shape) < case.of_size(5e-4, 2e-3, 1e-2)
    sign = case.rng.choice([-1.0, 1.0], torque.shape)
    torque += np.where(hit, sign * case.of_size(10.0, 30.0, 100.0) * size, 0.0)
    return Spoilt((_changed(case.recording, torque=torque),), ("outliers",))


def _of_a_model(case: Case) -> Spoilt:
    """Torques that a controller computed from its model: without friction, and without noise."""
    part = case.of_size(0.05, 0.01, 0.0)
    torque = case.run.gravity + case.run.motion + part * case.run.friction
    return Spoilt((_changed(case.recording, torque=torque),), ("model torque",))


def _torques_swapped(case: Case) -> Spoilt:
    first, order = _pair(case)
    torque = case.recording.torque[:, order]
    return Spoilt((_changed(case.recording, torque=torque),), ("swapped joints",), first)


def _pair(case: Case) -> tuple[tuple[int, int], np.ndarray]:
    first = case.joint()
    others = [joint for joint in range(case.joints) if joint != first]
    second = int(case.rng.choice(others))
    order = np.arange(case.joints)
    order[[first, second]] = second, first
    return (min(first, second), max(first, second)), order


# Positions.


def _zero(case: Case) -> Spoilt:
    # The zero of the first joint changes nothing, and that of the last is its body's.
    joint = int(case.rng.integers(1, case.joints - 1))
    offset = np.radians(case.of_size(5.0, 12.0, 30.0))
    return Spoilt((_position(case, lambda x: x + offset, joint),), ("zero position",), (joint,))


def _wrapped(case: Case) -> Spoilt:
    joint = int(case.rng.integers(0, case.joints - 1))
    recording = case.faulty(Fault(wrapped=joint))
    position = _with_columns(
        recording.position, joint, lambda x: (x + np.pi) % (2.0 * np.pi) - np.pi
    )
    return Spoilt((_changed(recording, position=position),), ("wrapped angle",), (joint,))


def _degrees(case: Case) -> Spoilt:
    return Spoilt((_position(case, np.degrees, _EVERY),), ("angle unit",))


def _degrees_at_one(case: Case) -> Spoilt:
    joint = case.joint()
    return Spoilt((_position(case, np.degrees, joint),), ("angle unit",), (joint,))


def _stretched(case: Case) -> Spoilt:
    """A wrong gear ratio before the encoder: about the middle of the motion, to keep its zero."""
    joint, factor = case.joint(), case.of_size(1.1, 1.5, 2.0)
    kinds = ("position scale",)
    return Spoilt((_position(case, lambda x: factor * x, joint),), kinds, (joint,))


def _position_sign(case: Case) -> Spoilt:
    joint = case.joint()
    return Spoilt((_position(case, lambda x: -x, joint),), ("sign",), (joint,))


def _positions_swapped(case: Case) -> Spoilt:
    first, order = _pair(case)
    position = case.recording.position[:, order]
    return Spoilt((_changed(case.recording, position=position),), ("swapped joints",), first)


def _joints_swapped(case: Case) -> Spoilt:
    first, order = _pair(case)
    position, torque = (x[:, order] for x in (case.recording.position, case.recording.torque))
    changed = _changed(case.recording, position=position, torque=torque)
    return Spoilt((changed,), ("swapped joints",), first)


def _stop(case: Case) -> Spoilt:
    joint = case.joint()
    recording = case.faulty(Fault(stop=(joint, case.of_size(0.92, 0.85, 0.75))))
    return Spoilt((recording,), ("stop",), (joint,))


# Rows and times.


def _clock(case: Case) -> Spoilt:
    factor = case.of_size(1.05, 1.3, 2.0)
    return Spoilt((_changed(case.recording, time=factor * case.recording.time),), ("clock",))


def _time_unit(case: Case) -> Spoilt:
    factor = case.of_size(1e3, 1e6, 1e9)
    return Spoilt((_changed(case.recording, time=factor * case.recording.time),), ("time unit",))


def _duplicated(case: Case) -> Spoilt:
    """Rows that are there twice, each with a time of its own."""
    part = case.of_size(0.02, 0.1, 0.3)
    twice = case.rng.random(case.recording.samples) < part
    rows = np.sort(np.append(np.arange(case.recording.samples), np.flatnonzero(twice)))
    time = float(case.recording.time[1]) * np.arange(rows.size)
    position, torque = (x[rows] for x in (case.recording.position, case.recording.torque))
    return Spoilt((jc.Recording(time, position, torque),), ("stale rows",))


def _dropped(case: Case) -> Spoilt:
    keep = case.rng.random(case.recording.samples) > case.of_size(0.005, 0.05, 0.2)
    return Spoilt((case.recording.rows(keep),), ("gap",))


def _unnoticed(case: Case) -> Spoilt:
    """Lost rows, and times that were counted afterwards."""
    keep = np.ones(case.recording.samples, bool)
    for start in case.rng.integers(500, case.recording.samples - 500, case.of_size(1, 2, 4)):
        keep[start : start + 100] = False
    interval = float(case.recording.time[1])
    found = case.recording.rows(keep)
    found = _changed(found, time=interval * np.arange(found.samples))
    return Spoilt((found,), ("jump", "outliers"))


def _gap(case: Case) -> Spoilt:
    start, length = 6.0, case.of_size(0.3, 1.0, 4.0)
    time = case.recording.time
    return Spoilt((case.recording.rows((time < start) | (time > start + length)),), ("gap",))


def _jitter(case: Case) -> Spoilt:
    interval = float(case.recording.time[1])
    late = case.rng.uniform(0.0, case.of_size(0.2, 0.5, 0.9) * interval, case.recording.samples)
    return Spoilt((_changed(case.recording, time=case.recording.time + late),), ("jitter",))


def _stale(case: Case) -> Spoilt:
    fresh = case.rng.random(case.recording.samples) > case.of_size(0.01, 0.1, 0.3)
    fresh[0] = True
    source = np.maximum.accumulate(np.where(fresh, np.arange(fresh.size), 0))
    position, torque = (x[source] for x in (case.recording.position, case.recording.torque))
    return Spoilt((jc.Recording(case.recording.time, position, torque),), ("stale rows",))


# The arm and its file.


def _tilt(case: Case) -> Spoilt:
    angle = np.radians(case.of_size(5.0, 15.0, 90.0))
    direction = float(case.rng.uniform(0.0, 2.0 * np.pi))
    tilt = angle * np.cos(direction), angle * np.sin(direction)
    return Spoilt((case.faulty(Fault(tilt=tilt)),), ("mounting",))


def _upside_down(case: Case) -> Spoilt:
    return Spoilt((case.faulty(Fault(tilt=(np.pi, 0.0))),), ("mounting",))


def _other_file(case: Case) -> Spoilt:
    # A length of the other file is wrong as well.
    return Spoilt((case.recording,), ("wrong robot", "length"), file=FILES[case.arm.name].other)


def _friction_drift(case: Case) -> Spoilt:
    drift = case.of_size(0.3, 0.6, 1.5)
    return Spoilt((case.faulty(Fault(drift=drift)),), ("drift",))


def _tool(case: Case) -> Spoilt:
    whole = sum(float(link.mass) for link in case.arm.links)
    mass = case.of_size(0.03, 0.08, 0.2) * whole
    return Spoilt((case.faulty(Fault(tool=mass)),), ("tool change",))


def _contact(case: Case) -> Spoilt:
    whole = 9.81 * sum(float(link.mass) for link in case.arm.links)
    push = case.of_size(0.1, 0.3, 1.0) * whole
    return Spoilt((case.faulty(Fault(push=push)),), ("contact",))


SPOILERS: dict[str, Callable[[Case], Spoilt]] = {
    "gravity taken out": _no_gravity,
    "all torques scaled": _all_scaled,
    "one torque scaled": _one_scaled,
    "gear ratio": _gear_ratio,
    "torque unit": _millinewtons,
    "torque unit of one joint": _millinewtons_at_one,
    "currents": _currents,
    "sign of one torque": _one_sign,
    "signs of all torques": _all_signs,
    "unsigned torque": _unsigned,
    "held torque": _held,
    "filtered torque": _filtered,
    "late torque": _late,
    "early torque": _early,
    "torque zero drifts": _zero_drift,
    "clipped torque": _clipped,
    "saturated torque": _saturated,
    "outliers": _outliers,
    "torque of a model": _of_a_model,
    "torques swapped": _torques_swapped,
    "zero position": _zero,
    "wrapped angle": _wrapped,
    "degrees": _degrees,
    "degrees at one joint": _degrees_at_one,
    "position scale": _stretched,
    "sign of one position": _position_sign,
    "positions swapped": _positions_swapped,
    "joints swapped": _joints_swapped,
    "joint on a stop": _stop,
    "clock": _clock,
    "time unit": _time_unit,
    "duplicated rows": _duplicated,
    "dropped samples": _dropped,
    "unnoticed gaps": _unnoticed,
    "gap": _gap,
    "jitter": _jitter,
    "stale rows": _stale,
    "tilted base": _tilt,
    "upside down": _upside_down,
    "another robot's file": _other_file,
    "friction drifts": _friction_drift,
    "tool added": _tool,
    "contact": _contact,
    "torque constant": _torque_constant,
}
"""Kinds of spoilt recordings by name."""

SIZES = ("mild", "middle", "gross")


def spoilt(name: str, kind: str, size: int, seed: int) -> Spoilt:
    """Return the recording of an arm that a kind of fault spoils."""
    run = record(name, Conditions(), seed)
    rng = np.random.default_rng([seed, size, list(SPOILERS).index(kind)])
    return SPOILERS[kind](Case(arm(name, seed), run, size, seed, rng))
