"""A sonar with two receivers: its transducers, pulse, and what it receives of echo paths."""

import math
from dataclasses import dataclass

import numpy as np
from jaxtyping import Complex, Float
from scipy.signal import lfilter
from scipy.special import j1


# The record begins this long before the first echo and ends this long after it [s]: enough for
# the eleven windows of a profile behind a late onset.
BEFORE = 0.8e-3
AFTER = 4.5e-3


@dataclass(frozen=True)
class Sonar:
    """An emitter and two receivers on a robot, all facing ahead, and the air before them.

    x points ahead, y to the left, z up; the emitter is the origin and the receivers lie on the y
    axis, equally far to its left and right (thesis Fig. 6.3-1). The thesis gives no dimensions:
    the defaults are those of common 40 kHz piezoelectric transducers in 16 mm cans.

    >>> import sim
    >>> round(sim.Sonar().speed_of_sound), round(sim.Sonar().wavelength * 1e3, 1)
    (343, 8.6)
    >>> round(sim.Sonar().absorption, 1)
    1.3
    """

    frequency: float = 40e3
    """Of the carrier [Hz]."""

    cycles: float = 8.0
    """Of the carrier in a pulse: 0.2 ms at 40 kHz, 34 mm of depth."""

    bandwidth: float = 4e3
    """Of each transducer, between its -3 dB points [Hz]: a tenth of the carrier."""

    aperture: float = 8e-3
    """Radius of each transducer's piston [m]. The pressure is down by 6 dB at 22° off the axis."""

    offset: float = 0.1
    """Of either receiver from the emitter [m]: receivers at the sides of a small robot."""

    height: float = 0.3
    """Of the transducers over the floor [m]."""

    temperature: float = 20.0
    """Of the air [°C]."""

    humidity: float = 50.0
    """Of the air, relative [%]."""

    sampling: float = 20e-6
    """Interval at which the demodulated signals are sampled [s], a fifth of the rise time."""

    @property
    def speed_of_sound(self) -> float:
        """[m/s], in dry air at the temperature; humidity would add a thousandth."""
        return 331.3 * math.sqrt(1 + self.temperature / 273.15)

    @property
    def wavelength(self) -> float:
        """[m]."""
        return self.speed_of_sound / self.frequency

    @property
    def wavenumber(self) -> float:
        """[rad/m]."""
        return 2 * math.pi / self.wavelength

    @property
    def absorption(self) -> float:
        """Absorption of the air at the carrier's frequency [dB/m], at standard pressure."""
        return absorption(self.frequency, self.temperature, self.humidity)

    @property
    def receivers(self) -> Float[np.ndarray, "2 3"]:
        """Positions of the receivers [m], left and right."""
        return np.array([[0.0, self.offset, 0.0], [0.0, -self.offset, 0.0]])


@dataclass(frozen=True, eq=False)
class EchoPaths:
    """Sound paths from the emitter by an object to the left and right receiver."""

    length: Float[np.ndarray, "patterns paths 2"]
    """[m]."""

    gain: Complex[np.ndarray, "patterns paths 2"]
    """Pressure at the receiver over pressure 1 m before the emitter, from spreading, reflection
    and diffraction alone. The phase of a tone exp(iωt) is the gain's less wavenumber × length."""

    departure: Float[np.ndarray, "patterns paths 2"]
    """Cosine of the angle between emitter's axis and path."""

    arrival: Float[np.ndarray, "patterns paths 2"]
    """Cosine of the angle between receiver's axis and path."""

    def __add__(self, other: "EchoPaths") -> "EchoPaths":
        """Join both objects' paths, without occlusion."""
        mine, theirs = vars(self), vars(other)
        return EchoPaths(**{name: np.concatenate([mine[name], theirs[name]], 1) for name in mine})


def absorption(frequency: float, temperature: float, humidity: float) -> float:
    """Absorption of sound in air at standard pressure [dB/m], by ISO 9613-1.

    Classical absorption, and the relaxations of oxygen and nitrogen, which water vapour hastens.
    Frequency in Hz, temperature in °C, relative humidity in %. The standard is valid up to
    10 kHz; ANSI S1.26 has the same formula for up to 1 MHz, to within a tenth.
    """
    kelvin = temperature + 273.15
    warmth = kelvin / 293.15
    saturation = 10 ** (4.6151 - 6.8346 * (273.16 / kelvin) ** 1.261)
    vapour = humidity * saturation  # molar concentration [%]
    oxygen = 24 + 4.04e4 * vapour * (0.02 + vapour) / (0.391 + vapour)
    nitrogen = warmth**-0.5 * (9 + 280 * vapour * math.exp(-4.17 * (warmth ** (-1 / 3) - 1)))
    relaxing = 0.01275 * math.exp(-2239.1 / kelvin) / (oxygen + frequency**2 / oxygen)
    relaxing += 0.1068 * math.exp(-3352.0 / kelvin) / (nitrogen + frequency**2 / nitrogen)
    return 8.686 * frequency**2 * (1.84e-11 * warmth**0.5 + warmth**-2.5 * relaxing)


def directivity(sonar: Sonar, cosine: Float[np.ndarray, "*batch"]) -> Float[np.ndarray, "*batch"]:
    """Far-field pressure of a baffled piston over that on its axis, 2 J₁(u)/u, u = k a sin θ.

    Nothing is radiated backwards. The same holds for a receiver, by reciprocity.
    """
    sine = np.sqrt(np.maximum(1 - cosine**2, 0.0))
    u = np.maximum(sonar.wavenumber * sonar.aperture * sine, 1e-6)
    return np.where(cosine > 0, 2 * j1(u) / u, 0.0)


def pulse(sonar: Sonar, t: Float[np.ndarray, "*batch"]) -> Float[np.ndarray, "*batch"]:
    """Envelope of the received pulse at a time after its start [s], 1 for an endless tone.

    A burst of constant amplitude, through two resonators (the emitter and a receiver) whose
    envelopes rise and fall as exp(-π bandwidth t).
    """

    def risen(t: Float[np.ndarray, "*batch"]) -> Float[np.ndarray, "*batch"]:
        x = math.pi * sonar.bandwidth * np.maximum(t, 0.0)
        return 1 - (1 + x) * np.exp(-x)

    return risen(t) - risen(t - sonar.cycles / sonar.frequency)


def amplitude(sonar: Sonar, paths: EchoPaths) -> Complex[np.ndarray, "patterns paths 2"]:
    """Return each path's response to a tone of unit pressure 1 m before the emitter.

    It has gain, absorption, the emitter's and the receiver's directivity, and phase.
    """
    loss = 10 ** (-sonar.absorption * paths.length / 20)
    beams = directivity(sonar, paths.departure) * directivity(sonar, paths.arrival)
    return paths.gain * loss * beams * np.exp(-1j * sonar.wavenumber * paths.length)


def received(
    sonar: Sonar, paths: EchoPaths
) -> tuple[Float[np.ndarray, " patterns"], Complex[np.ndarray, "patterns 2 samples"]]:
    """Return when each record begins after the emission [s], and its two demodulated signals.

    These are sums of the echoes of all paths. Both receivers share a clock.
    """
    size = amplitude(sonar, paths)
    delay = paths.length / sonar.speed_of_sound
    # A path without sound is no echo: it does not affect when the record begins.
    first = np.where(size == 0, np.inf, delay).min(axis=(1, 2))
    start = sonar.sampling * np.floor((first - BEFORE) / sonar.sampling)
    after = sonar.sampling * np.arange(math.ceil((BEFORE + AFTER) / sonar.sampling))
    signal = np.zeros((len(start), 2, len(after)), dtype=np.complex128)
    for path in range(delay.shape[1]):
        since = start[:, None, None] + after - delay[:, path, :, None]
        signal += size[:, path, :, None] * pulse(sonar, since)
    return start, signal


def receiver_noise(
    sonar: Sonar, shape: tuple[int, ...], rng: np.random.Generator
) -> Complex[np.ndarray, "..."]:
    """Noise of unit mean square, limited to a receiver's band; the last axis is time."""
    white = rng.normal(scale=math.sqrt(0.5), size=(*shape, 2)).view(np.complex128)[..., 0]
    kept = math.exp(-math.pi * sonar.bandwidth * sonar.sampling)
    # Filtered from the stationary state on, so that the variance is constant.
    fresh = math.sqrt(1 - kept**2)
    begin = (1 - fresh) * white[..., :1]
    return lfilter([fresh], [1.0, -kept], white, axis=-1, zi=begin)[0]
