"""Twelve ways in which recordings are spoilt, and the kind of finding that names each cause."""

import dataclasses
from collections.abc import Callable
from typing import Any

import numpy as np

import jaxcslc as jc
from scripts.studies.checks.recordings import Conditions, record


@dataclasses.dataclass(frozen=True)
class Spoilt:
    """Recordings with one thing wrong, and the finding that names it.

    - `recordings`: one, or two that disagree.
    - `kinds`: of findings, any of which is right.
    - `joint`: the joint that must be named, counted from 1, or None.
    """

    recordings: tuple[jc.Recording, ...]
    kinds: tuple[str, ...]
    joints: tuple[int, ...] = ()


def changed(recording: jc.Recording, **arrays: Any) -> jc.Recording:
    """The recording with other times, positions or torques."""
    return dataclasses.replace(recording, **arrays)


def _units(arm: str, clean: jc.Recording, rng: np.random.Generator) -> Spoilt:
    which = rng.integers(5)
    if which == 0:
        factor = rng.choice([1e3, 1e6, 1e9])
        return Spoilt((changed(clean, time=clean.time * factor),), ("time unit",))
    if which == 1:
        return Spoilt((changed(clean, position=np.degrees(clean.position)),), ("angle unit",))
    if which == 2:
        return Spoilt((changed(clean, torque=1e3 * clean.torque),), ("torque unit",))
    constants = rng.uniform(4.0, 15.0, clean.joints)
    if which == 3:
        return Spoilt((changed(clean, torque=clean.torque / constants),), ("torque unit",))
    joint = int(rng.integers(clean.joints))
    position = clean.position.copy()
    position[:, joint] = np.degrees(position[:, joint])
    return Spoilt((changed(clean, position=position),), ("angle unit",), (joint + 1,))


def _sign(arm: str, clean: jc.Recording, rng: np.random.Generator) -> Spoilt:
    joint = int(rng.integers(clean.joints))
    name = str(rng.choice(["position", "torque"]))
    values = getattr(clean, name).copy()
    values[:, joint] *= -1
    return Spoilt((changed(clean, **{name: values}),), ("sign",), (joint + 1,))


def _lag(arm: str, clean: jc.Recording, rng: np.random.Generator) -> Spoilt:
    lag = rng.choice([-1, 1]) * rng.uniform(0.01, 0.04)
    return Spoilt((lagging(clean, lag),), ("torque lag",))


def lagging(recording: jc.Recording, lag: float) -> jc.Recording:
    """The same with torques measured so much later [s]."""
    at = recording.time - lag
    torque = np.stack([np.interp(at, recording.time, x) for x in recording.torque.T], axis=1)
    return changed(recording, torque=torque)


def _gap(arm: str, clean: jc.Recording, rng: np.random.Generator) -> Spoilt:
    length = clean.time[-1] - clean.time[0]
    start = clean.time[0] + rng.uniform(0.3, 0.6) * length
    gap = rng.uniform(0.03, 0.15) * length
    keep = (clean.time < start) | (clean.time > start + gap)
    return Spoilt((clean.rows(keep),), ("gap",))


def _spikes(arm: str, clean: jc.Recording, rng: np.random.Generator) -> Spoilt:
    if rng.random() < 0.7:
        torque = clean.torque.copy()
        hit = rng.random(torque.shape) < rng.choice([0.0005, 0.002])
        torque[hit] += rng.choice([-1, 1], hit.sum()) * rng.choice([30.0, 300.0, 1000.0])
        return Spoilt((changed(clean, torque=torque),), ("outliers",))
    position = clean.position.copy()
    hit = rng.random(position.shape) < 0.001
    position[hit] += rng.choice([-1, 1], hit.sum()) * rng.uniform(0.02, 0.2)
    return Spoilt((changed(clean, position=position),), ("outliers",))


def _stale(arm: str, clean: jc.Recording, rng: np.random.Generator) -> Spoilt:
    part = rng.choice([0.01, 0.1, 0.3])
    row = np.arange(clean.samples)
    fresh = rng.random(clean.samples) > part
    fresh[0] = True
    source = np.maximum.accumulate(np.where(fresh, row, 0))
    velocity = None if clean.velocity is None else clean.velocity[source]
    return Spoilt(
        (jc.Recording(clean.time, clean.position[source], clean.torque[source], velocity),),
        ("stale rows",),
    )


def _jitter(arm: str, clean: jc.Recording, rng: np.random.Generator) -> Spoilt:
    interval = float(np.median(np.diff(clean.time)))
    late = rng.uniform(0.0, rng.uniform(0.3, 0.9) * interval, clean.samples)
    return Spoilt((changed(clean, time=clean.time + late),), ("jitter",))


def _clipping(arm: str, clean: jc.Recording, rng: np.random.Generator) -> Spoilt:
    torque = clean.torque.copy()
    joint = int(rng.integers(clean.joints))
    limit = np.quantile(np.abs(torque[:, joint]), rng.uniform(0.8, 0.95))
    torque[:, joint] = np.clip(torque[:, joint], -limit, limit)
    return Spoilt((changed(clean, torque=torque),), ("clipping",), (joint + 1,))


def _wrong_robot(arm: str, clean: jc.Recording, rng: np.random.Generator) -> Spoilt:
    """A recording of another arm of as many joints."""
    other = {"PUMA 560": "six", "six": "PUMA 560", "geared": "seven"}[arm]
    return Spoilt((record(other, Conditions(), int(rng.integers(1 << 30))),), ("wrong robot",))


def _swapped(arm: str, clean: jc.Recording, rng: np.random.Generator) -> Spoilt:
    first, second = sorted(rng.choice(clean.joints, 2, replace=False).tolist())
    order = np.arange(clean.joints)
    order[[first, second]] = second, first
    changes = {"position": clean.position[:, order]}
    if rng.random() < 0.5:
        changes["torque"] = clean.torque[:, order]
    return Spoilt((changed(clean, **changes),), ("swapped joints",), (first + 1, second + 1))


def _two_rates(arm: str, clean: jc.Recording, rng: np.random.Generator) -> Spoilt:
    if rng.random() < 0.5:
        other = record(arm, Conditions(duration=10.0), int(rng.integers(1 << 30)))
        return Spoilt((clean, other.rows(slice(None, None, 5))), ("rate",))
    # Positions that a slower source delivers, beside torques of every row.
    held = np.arange(clean.samples) // 4 * 4
    return Spoilt((changed(clean, position=clean.position[held]),), ("rate",))


def _wrong_payload(arm: str, clean: jc.Recording, rng: np.random.Generator) -> Spoilt:
    conditions = Conditions(duration=12.0, payload=float(rng.uniform(0.8, 2.0)))
    return Spoilt((clean, record(arm, conditions, int(rng.integers(1 << 30)))), ("payload",))


Spoiler = Callable[[str, jc.Recording, np.random.Generator], Spoilt]
SPOILT: dict[str, Spoiler] = {
    "units": _units,
    "sign": _sign,
    "lag": _lag,
    "gap": _gap,
    "spikes": _spikes,
    "stale rows": _stale,
    "jitter": _jitter,
    "clipping": _clipping,
    "wrong robot": _wrong_robot,
    "swapped joints": _swapped,
    "two rates": _two_rates,
    "wrong payload": _wrong_payload,
}
