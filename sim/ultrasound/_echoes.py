"""Echoes of objects as patterns of an identification problem (6.3.1): features and classes."""

import math
from dataclasses import dataclass

import numpy as np
from jaxtyping import Bool, Complex, Float, Int

from sim.ultrasound._objects import KINDS
from sim.ultrasound._sonar import Sonar, pulse, received, receiver_noise


COEFFICIENTS = 11
# Length of each of a profile's windows [s], 38 mm in depth; a pulse with its ringing fills three.
WINDOW = 0.22e-3
# Windows before the onset, for what is weaker than the onset's share: the end of a face juts out
# before a corner. The eight others reach 0.3 m behind the onset, as deep as the objects.
EARLY = 3
# An echo begins where the envelope first exceeds this share of its maximum, and the noise's root
# mean square this many times, which noise alone does once in 10^10 samples.
ONSET_SHARE = 0.15
ONSET_NOISE = 5.0
# Lower limit of a profile's coefficients, relative to the total [dB].
FLOOR = -50.0

# The transducers receive nothing from larger angles; such an estimate comes from two echoes.
_WIDEST = math.radians(30)

# Inputs are (value - middle) / half width of the scene's range, so about -1 to 1.
_ANGLE = (0.0, math.radians(15))
_DISTANCE = (1.5, 0.9)  # m
_POWER = (-70.0, 25.0)  # dB
_PROFILE = (0.5 * FLOOR, -0.5 * FLOOR)  # dB


@dataclass(frozen=True, eq=False)
class Echoes:
    """Patterns of a robot's two ultrasound receivers and the objects before it (thesis 6.3.1)."""

    inputs: Float[np.ndarray, "patterns 25"]
    """Angle off the robot's centre line, distance, power, and eleven coefficients each of the left
    and the right receiver's profile; all scaled by constants to about -1 to 1."""

    targets: Float[np.ndarray, "patterns 10"]
    """1 for the kind of the object, -1 for the nine others."""

    kind: Int[np.ndarray, " patterns"]
    """Of the object, as an index of `kinds`."""

    trains: Bool[np.ndarray, " patterns"]
    """Whether a pattern is of the training set, which has as many of each kind."""

    names: tuple[str, ...]
    """Of the 25 inputs, with what one means in the units it was measured in."""

    kinds: tuple[str, ...]
    """Names of the ten kinds of object."""

    @property
    def training(self) -> "Echoes":
        """The patterns of the training set alone."""
        return self._subset(self.trains)

    @property
    def comparison(self) -> "Echoes":
        """The patterns of the comparison set alone."""
        return self._subset(~self.trains)

    def _subset(self, mask: Bool[np.ndarray, " patterns"]) -> "Echoes":
        return Echoes(
            self.inputs[mask],
            self.targets[mask],
            self.kind[mask],
            self.trains[mask],
            self.names,
            self.kinds,
        )


def ultrasound(
    *,
    seed: int = 0,
    patterns: int = 5000,
    training_per_kind: int = 315,
    noise: float = 2e-4,
    sonar: Sonar | None = None,
) -> Echoes:
    """Simulates the ultrasound object identification problem of section 6.3.1.

    A robot at rest emits one pulse a pattern at a single object of one of ten kinds. Range,
    bearing, attitude and size of the object are random; the received signals follow from
    geometrical acoustics, edge diffraction, spreading, the air's absorption, the transducers'
    directivity and noise. `docs/ultrasound.md` has the numbers and the omissions. The thesis's
    recordings [Sillitoe & Elomaa 1994] were not published with it: kinds and numbers are choices.

    **Arguments**

    - `seed`: of objects, noise and order, each from a separate random stream.
    - `patterns`: in all; each kind has as many as the others, or one more.
    - `training_per_kind`: number of training patterns of each kind. The others are for comparison.
    - `noise`: root mean square at a receiver over that of the emitter's tone at 1 m. The default is
      a sound pressure level of 30 dB beside an emitter of 104 dB.
    - `sonar`: dimensions, transducers and air; the defaults if omitted.

    **Raises** `ValueError`: too few patterns, or noise that is no finite number from zero up.

    >>> import sim
    >>> echoes = sim.ultrasound()
    >>> echoes.inputs.shape, echoes.targets.shape
    ((5000, 25), (5000, 10))
    >>> echoes.training.kind.size, echoes.comparison.kind.size
    (3150, 1850)
    >>> echoes.kinds[:4]
    ('wall', 'corner', 'edge', 'pole')
    """
    sonar = Sonar() if sonar is None else sonar
    count = len(KINDS)
    if training_per_kind < 1:
        raise ValueError(f"training_per_kind is {training_per_kind}; expected one or more")
    if patterns < count * training_per_kind:
        raise ValueError(
            f"patterns is {patterns}; expected {count * training_per_kind} or more, for"
            f" {training_per_kind} of each of {count} kinds to train on"
        )
    if not 0 <= noise < math.inf:
        raise ValueError(f"noise is {noise}; expected a finite number, zero or more")
    objects, hiss, order = np.random.default_rng(seed).spawn(3)
    kind = np.arange(patterns) % count
    inputs = np.empty((patterns, 3 + 2 * COEFFICIENTS))
    for number, draw in enumerate(KINDS.values()):
        rows = np.flatnonzero(kind == number)
        start, signal = received(sonar, draw(sonar, objects, rows.size))
        signal = signal + noise * receiver_noise(sonar, signal.shape, hiss)
        inputs[rows] = features(sonar, start, signal, noise)
    shuffled = order.permutation(patterns)
    inputs, kind = inputs[shuffled], kind[shuffled]
    # The first patterns of each kind, in an order that is random already.
    rank = np.empty(patterns, dtype=np.int64)
    for number in range(count):
        rows = np.flatnonzero(kind == number)
        rank[rows] = np.arange(rows.size)
    return Echoes(
        inputs=inputs,
        targets=np.where(kind[:, None] == np.arange(count), 1.0, -1.0),
        kind=kind,
        trains=rank < training_per_kind,
        names=_names(),
        kinds=tuple(KINDS),
    )


def _names() -> tuple[str, ...]:
    profiles = (
        f"{side} profile {window} [{_PROFILE[1]:.0f} dB]"
        for side in ("left", "right")
        for window in range(1, COEFFICIENTS + 1)
    )
    return (
        f"angle [{math.degrees(_ANGLE[1]):.0f}°]",
        f"distance [{_DISTANCE[1]:.1f} m]",
        f"power [{_POWER[1]:.0f} dB]",
        *profiles,
    )


def features(
    sonar: Sonar,
    start: Float[np.ndarray, " patterns"],
    signal: Complex[np.ndarray, "patterns 2 samples"],
    noise: float,
) -> Float[np.ndarray, "patterns 25"]:
    """The network's inputs, from the two received signals alone.

    `start` is when the records begin after the emission [s], `noise` the root mean square of the
    receivers' noise, which a robot can measure without emitting.
    """
    envelope = np.abs(signal)
    arrival, crossing = onset(sonar, start, envelope, noise)
    angle, distance = position(sonar, sonar.speed_of_sound * arrival)
    # Energy from the beginning of the record on, at the end of every sample.
    energy = np.cumsum(envelope**2, axis=-1)
    edges = (crossing - start[:, None])[..., None] + WINDOW * (np.arange(COEFFICIENTS + 1) - EARLY)
    share = np.maximum(np.diff(_between(energy, edges / sonar.sampling), axis=-1), 0.0)
    total = share.sum(axis=-1, keepdims=True)
    profile = _decibel(np.maximum(share / total, 10 ** (FLOOR / 10)))
    power = _decibel(total.sum(axis=(1, 2)) * sonar.sampling)
    lists = (
        (np.clip(angle, -_WIDEST, _WIDEST)[:, None], _ANGLE),
        (distance[:, None], _DISTANCE),
        (power[:, None], _POWER),
        (profile.reshape(len(profile), -1), _PROFILE),
    )
    return np.hstack([(value - middle) / width for value, (middle, width) in lists])


def onset(
    sonar: Sonar,
    start: Float[np.ndarray, " patterns"],
    envelope: Float[np.ndarray, "patterns 2 samples"],
    noise: float,
) -> tuple[Float[np.ndarray, "patterns 2"], Float[np.ndarray, "patterns 2"]]:
    """Return when the echo arrives at each receiver, and when it crosses the threshold [s].

    The crossing comes later than the arrival by the time that a pulse takes to rise as far, if it
    is the pulse that makes the maximum. Of an echo that never exceeds the noise the maximum is
    taken.
    """
    most = envelope.max(axis=-1)
    threshold = np.minimum(np.maximum(ONSET_SHARE * most, ONSET_NOISE * noise), most)
    above = envelope >= threshold[..., None]
    after = np.maximum(above.argmax(axis=-1), 1)
    last, here = (_between(envelope, (after - back)[..., None])[..., 0] for back in (1.0, 0.0))
    part = np.clip((threshold - last) / np.maximum(here - last, 1e-300), 0.0, 1.0)
    crossing = start[:, None] + sonar.sampling * (after - 1 + part)
    rise = np.linspace(0.0, sonar.cycles / sonar.frequency, 400)
    rising = pulse(sonar, rise)
    lag = np.interp(threshold / most * rising[-1], rising, rise)
    return crossing - lag, crossing


def position(
    sonar: Sonar, length: Float[np.ndarray, "patterns 2"]
) -> tuple[Float[np.ndarray, " patterns"], Float[np.ndarray, " patterns"]]:
    """Angle off the centre line, to the left [rad], and distance [m], of a point whose echo went
    these lengths [m]: where the two ellipses about emitter and receivers meet.

    Exact for poles and edges, as things of no width; a wall seems nearer by offset²/(8 distance).
    """
    left, right = length.T
    distance = (left**2 + right**2 - 2 * sonar.offset**2) / (2 * (left + right))
    sine = (right - left) * (right + left - 2 * distance) / (4 * distance * sonar.offset)
    return np.arcsin(np.clip(sine, -1.0, 1.0)), distance


def _decibel(power: Float[np.ndarray, "*batch"]) -> Float[np.ndarray, "*batch"]:
    return 10 * np.log10(power)


def _between(
    values: Float[np.ndarray, "patterns 2 samples"], index: Float[np.ndarray, "patterns 2 windows"]
) -> Float[np.ndarray, "patterns 2 windows"]:
    """Values at fractional sample indices, by linear interpolation."""
    whole = np.clip(np.floor(index).astype(np.int64), 0, values.shape[-1] - 2)
    part = np.clip(index - whole, 0.0, 1.0)
    below = np.take_along_axis(values, whole, axis=-1)
    above = np.take_along_axis(values, whole + 1, axis=-1)
    return below + part * (above - below)
