"""Parameters of elastic gears."""

from collections.abc import Sequence
from typing import Any, NamedTuple

import equinox as eqx
import numpy as np
from jaxtyping import Float


class TransmissionParameters(NamedTuple):
    """Parameters of the gears of f joints.

    **Attributes**

    - `compliance`: (f,) one over stiffness [rad/(N m) or m/N].
    - `lag`: (f,) damping over stiffness [s].
    - `play`: (f,) how far a link moves while its rotor stands still [rad or m].
    - `rotor_inertia`: (f,) at the joint [kg m² or kg].
    """

    compliance: Float[np.ndarray, " links"]
    lag: Float[np.ndarray, " links"]
    play: Float[np.ndarray, " links"]
    rotor_inertia: Float[np.ndarray, " links"]

    @classmethod
    def of(cls, values: Float[np.ndarray, " parameters"]) -> "TransmissionParameters":
        """Split (4 f,) values one after the other."""
        return cls(*values.reshape(4, -1))

    @property
    def values(self) -> Float[np.ndarray, " parameters"]:
        """(4 f,) one after the other."""
        return np.concatenate(self)


# Quantile of a normal distribution for intervals of 95 %.
_QUANTILE = 1.959964

Links = Float[np.ndarray, " links"]


class Transmission(eqx.Module):
    """Gears that give way between rotors and links, as they were estimated.

    A link is behind its rotor by u. Beyond the play, a spring bears its share of the torque, and a
    damper the remainder: torque = stiffness (u beyond play) + damping u'.

    **Attributes**

    - `joints`: whose links move apart from their rotors, from 1.
    - `compliance`: (f,) one over stiffness [rad/(N m) or m/N]; `compliance_error`: its standard
      deviation.
    - `lag`: (f,) damping over stiffness [s]; `lag_error`.
    - `play`: (f,) how far a link moves while its rotor stands still [rad or m]; `play_error`. An
      estimate of none may be below 0.
    - `rotor_inertia`: (f,) at the joint [kg m² or kg], a part of the network's coefficients;
      `rotor_inertia_error`.
    - `link_position`: (samples, f) of the links [rad or m].

    >>> import numpy as np
    >>> from jaxcslc.likelihood import Transmission
    >>> one, error = np.ones(1), np.full(1, 1e-6)
    >>> gears = Transmission(
    ...     joints=(2,), compliance=4e-4 * one, compliance_error=error, lag=3e-3 * one,
    ...     lag_error=1e2 * error, play=1e-3 * one, play_error=error, rotor_inertia=0.5 * one,
    ...     rotor_inertia_error=1e3 * error, link_position=np.zeros((10, 1)),
    ... )
    >>> gears.stiffness_interval.round().tolist(), gears.damping.round(2).tolist()
    ([[2488.0, 2512.0]], [7.5])
    """

    joints: tuple[int, ...] = eqx.field(static=True)
    compliance: Links
    compliance_error: Links
    lag: Links
    lag_error: Links
    play: Links
    play_error: Links
    rotor_inertia: Links
    rotor_inertia_error: Links
    link_position: Float[np.ndarray, "samples links"]

    @property
    def stiffness(self) -> Links:
        """(f,) [N m/rad or N/m]."""
        return 1.0 / self.compliance

    @property
    def stiffness_interval(self) -> Float[np.ndarray, "links 2"]:
        """(f, 2) of 95 %; infinite above where gears may be rigid."""
        reach = _QUANTILE * self.compliance_error
        low, high = np.maximum(self.compliance - reach, 1e-300), self.compliance + reach
        return np.stack([1.0 / high, np.where(low > 1e-300, 1.0 / low, np.inf)], axis=1)

    @property
    def play_interval(self) -> Float[np.ndarray, "links 2"]:
        """(f, 2) of 95 % [rad or m]."""
        reach = _QUANTILE * self.play_error
        return np.stack([self.play - reach, self.play + reach], axis=1)

    @property
    def damping(self) -> Links:
        """(f,) [N m s/rad or N s/m]."""
        return self.lag * self.stiffness

    @property
    def parameters(self) -> Float[np.ndarray, " parameters"]:
        """(4 f,) as `TransmissionParameters`."""
        return np.concatenate([self.compliance, self.lag, self.play, self.rotor_inertia])

    def document(self) -> list[dict[str, Any]]:
        """Return what a report's file says of it, joint by joint, as plain data."""
        return [
            {
                "joint": joint,
                "stiffness": float(self.stiffness[i]),
                "stiffness_interval": [
                    float(value) if np.isfinite(value) else None
                    for value in self.stiffness_interval[i]
                ],
                "damping": float(self.damping[i]),
                "play": float(self.play[i]),
                "play_error": float(self.play_error[i]),
                "rotor_inertia": float(self.rotor_inertia[i]),
                "rotor_inertia_error": float(self.rotor_inertia_error[i]),
            }
            for i, joint in enumerate(self.joints)
        ]


def transmission_lines(entries: Sequence[dict[str, Any]] | None) -> list[str]:
    """Say in words what gears are, a line for each joint.

    **Arguments**

    - `entries`: a `Transmission.document`, or None.

    >>> entry = {"joint": 2, "stiffness": 2500.0, "stiffness_interval": [2450.0, None]}
    >>> entry |= {"play": 1e-3, "play_error": 1e-5, "damping": 8.0}
    >>> (line,) = transmission_lines([entry | {"rotor_inertia": 0.5, "rotor_inertia_error": 0.01}])
    >>> line[:55]
    'transmission of joint 2: stiffness 2500 (2450 or more),'
    """
    lines: list[str] = []
    for entry in entries or []:
        low, high = entry["stiffness_interval"]
        interval = f"{low:.4g} or more" if high is None else f"{low:.4g} to {high:.4g}"
        lines.append(
            f"transmission of joint {entry['joint']}: stiffness {entry['stiffness']:.4g}"
            f" ({interval}), play {entry['play']:.3g} ± {entry['play_error']:.2g}, damping"
            f" {entry['damping']:.3g}, rotor inertia {entry['rotor_inertia']:.3g} ±"
            f" {entry['rotor_inertia_error']:.2g}"
        )
    return lines
