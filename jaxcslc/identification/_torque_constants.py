"""Torque constants of drives, from recordings with known loads."""

import dataclasses
from collections.abc import Sequence
from itertools import compress
from typing import Any

import numpy as np
from jaxtyping import Float, Int

from .._display import Progress, steps
from ..least_squares import (
    Equations,
    Identification,
    LeastSquares,
    Settings,
    Unknowns,
    gauss_newton,
    regressor_of,
)
from ..network import CSLC
from ..recordings import Patterns, Recording
from ._problem import recording_named


@dataclasses.dataclass(frozen=True, eq=False)
class TorqueConstants:
    """Torque per motor current of each joint, from recordings with and without a known payload.

    **Attributes**

    - `joint_names`: of the n joints.
    - `constants`: (n,) joint torque per unit of what was recorded as torque [N m/A or N/A].
    - `fit`: of the arm's coefficients, the payload's other than its mass, and the constants.
    - `unit`: of the constants; one for each joint of an arm with prismatic joints.

    >>> import numpy as np, jaxcslc as jc
    >>> from jaxcslc.identification import fit_torque_constants
    >>> network = jc.derive(jc.examples.planar_arm()).with_payload()
    >>> k = np.linspace(0.5, 1.5, network.size)
    >>> k[network.layout.payload] = 0.02, 0.02, 0.02, 0, 0, 0, 0.1, 0, 0, 2.0
    >>> def current(k):
    ...     exact = jc.examples.swing(network, k)
    ...     return dataclasses.replace(exact, torque=exact.torque / [0.1, 0.2])
    >>> loaded = current(k)
    >>> k[network.layout.payload] = 0.0
    >>> fit_torque_constants(network, current(k), loaded, 2.0).constants.round(3).tolist()
    [0.1, 0.2]
    """

    joint_names: tuple[str, ...]
    constants: Float[np.ndarray, " joints"]
    fit: Identification
    unit: str | tuple[str, ...] = "N m/A"

    @property
    def standard_error(self) -> Float[np.ndarray, " joints"]:
        """Standard error of the constants; infinite where the recordings do not determine one."""
        return np.asarray(self.fit.standard_error)[-len(self.constants) :]

    def confidence_interval(self, level: float = 0.95) -> Float[np.ndarray, "joints 2"]:
        """Lower and upper end for each constant, from Student's t."""
        return np.asarray(self.fit.confidence_interval(level))[-len(self.constants) :]

    @property
    def undetermined(self) -> tuple[str, ...]:
        """Joints whose constant the recordings do not tell from zero."""
        low, high = self.confidence_interval().T
        unclear = ~(np.isfinite(low) & np.isfinite(high)) | ((low <= 0.0) & (high >= 0.0))
        return tuple(compress(self.joint_names, unclear))

    def rows(self, level: float = 0.95) -> list[dict[str, Any]]:
        """Return one row per joint: constant, standard error and interval."""
        low, high = self.confidence_interval(level).T
        n = len(self.joint_names)
        units = (self.unit,) * n if isinstance(self.unit, str) else self.unit
        columns = (self.joint_names, units, self.constants, self.standard_error, low, high)
        return [
            {
                "joint": name,
                "unit": unit,
                "constant": float(value),
                "standard_error": float(error),
                "low": float(start),
                "high": float(end),
            }
            for name, unit, value, error, start, end in zip(*columns, strict=True)
        ]

    def __str__(self) -> str:
        width = max(map(len, self.joint_names))
        lines = [
            f"{row['joint']:{width}}  {row['constant']:.5g} {row['unit']}, 95 % interval"
            f" {row['low']:.5g} to {row['high']:.5g}"
            for row in self.rows()
        ]
        listed = ", ".join(f"{value:.6g}" for value in self.constants)
        return "\n".join([*lines, "", "[torque]", f"constant = [{listed}]"])


def identify_torque_constants(
    network: CSLC,
    unloaded: Recording,
    loaded: Recording,
    mass: float,
    settings: Settings | None = None,
    *,
    progress: Progress = None,
) -> TorqueConstants:
    """Identifies the torque constants of all joints with a payload of known mass.

    Currents alone determine an arm's coefficients and torque constants except one common factor.
    A payload of known mass, carried through part of the motion, sets it (Gautier and Briot, Global
    identification of joint drive gains and dynamic parameters of robots, J. Dyn. Syst. Meas.
    Control 136, 2014). The payload's other parameters may be unknown. Fitted are the currents,
    which have the noise: least squares of torque over constant, by Gauss and Newton.

    **Arguments**

    - `network`: of the arm, n joints.
    - `unloaded`, `loaded`: recordings without and with the payload, whose `torque` holds currents.
    - `mass`: of the payload [kg].
    - `settings`: of preparation and fit; the library's defaults if None.
    - `progress`: as of `identify`.

    **Returns** the constants.

    **Raises**

    - `ValueError`: a mass that is not positive; recordings that cannot be used, by name; or
      recordings that do not determine the constant of some joint, with what is needed; or
      recordings in the wrong order, by which friction would drive the arm.
    - `RuntimeError`: a fit that fails, as of `LeastSquares.fit`.

    An example stands at `TorqueConstants`.
    """
    settings = (settings or Settings()).for_network(network)
    with steps(progress, "torque constants") as step:
        step("preparing patterns")
        patterns: list[Patterns] = []
        for name, recording in (("unloaded", unloaded), ("loaded", loaded)):
            with recording_named(f"{name} recording"):
                patterns.append(settings.patterns(recording))
        step("fitting torque constants")
        first, second = patterns
        return fit_torque_constants(network, first, second, mass, solver=settings.solver)


def fit_torque_constants(
    network: CSLC,
    unloaded: Patterns,
    loaded: Patterns,
    mass: float,
    *,
    solver: LeastSquares | None = None,
) -> TorqueConstants:
    """Fit torque constants like `identify_torque_constants`, to patterns whose torques are
    currents.

    **Arguments** and **Raises** as there; `solver`: options of the fit.
    """
    if not 0.0 < mass < np.inf:
        raise ValueError(f"mass of the payload is {mass} kg; expected more than 0")
    whole = network.with_payload() if network.payload is None else network
    solver = solver or LeastSquares()
    equations = [
        CurrentEquations.of(whole, patterns, carried, solver.cutoff)
        for patterns, carried in ((unloaded, 0.0), (loaded, mass))
    ]
    samples = [len(patterns.time) for patterns in (unloaded, loaded)]

    def fitted(k: np.ndarray) -> Identification:
        first, second = (some.about(k) for some in equations)
        return solver.fit_equations(first.followed_by(second, samples[0]), sum(samples))

    n = whole.joint_count
    fit = gauss_newton(fitted, np.zeros(whole.size - 1 + n))
    result = TorqueConstants(
        whole.output_names, np.asarray(fit.k)[-n:], fit, _units(whole.output_units)
    )
    if result.undetermined:
        raise ValueError(
            f"the recordings do not determine the torque constant of"
            f" {', '.join(result.undetermined)}: give it, or use motions, with and without the"
            " payload, in which the payload's weight or inertia loads that joint"
        )
    braking = [g for g in ("viscous", "dry") if g in whole.layout.groups]  # no offsets: they drive
    columns = whole.layout.indices(*braking)
    if sum(some.power(np.asarray(fit.k), columns) for some in equations) < 0.0:
        raise ValueError(
            "with these constants friction drives the arm instead of braking it; expected the"
            " recording without the payload first, and then the one with it"
        )
    return result


def _units(torques: Sequence[str]) -> str | tuple[str, ...]:
    """Return the units of constants: one for all joints, or one each with prismatic joints."""
    units = tuple(f"{unit}/A" for unit in torques)
    return units[0] if len(set(units)) == 1 else units


@dataclasses.dataclass(frozen=True, eq=False)
class CurrentEquations:
    """Equations of one recording in the arm's coefficients, the payload's and the constants.

    - `unknowns`: all of them but the payload's mass, which is known.
    - `regressor`: of the coefficients; `mass_torque`: of the known mass.
    """

    unknowns: Unknowns
    regressor: Float[np.ndarray, "samples joints coefficients"]
    mass_torque: Float[np.ndarray, "samples joints"]
    patterns: Patterns
    cutoff: float | None

    @classmethod
    def of(
        cls, network: CSLC, patterns: Patterns, mass: float, cutoff: float | None
    ) -> "CurrentEquations":
        """Return the equations of a network with payload that carries this mass, or nothing."""
        whole = np.array(regressor_of(network, patterns))
        payload = network.layout.payload
        (mass_index,) = network.layout.indices("pm").tolist()
        mass_torque = mass * whole[:, :, mass_index]
        if mass == 0.0:
            whole[:, :, payload] = 0.0
        names = tuple(name for i, name in enumerate(network.names) if i != mass_index)
        joints = network.joint_count
        support = tuple(
            (*(i - (i > mass_index) for i in indices if i != mass_index), len(names) + joint)
            for joint, indices in enumerate(network.support)
        )
        constants = tuple(f"constant of {name}" for name in network.output_names)
        unknowns = Unknowns((*names, *constants), support)
        assert len(unknowns.names) == network.size - 1 + joints
        return cls(unknowns, np.delete(whole, mass_index, axis=2), mass_torque, patterns, cutoff)

    def power(
        self, k: Float[np.ndarray, " unknowns"], columns: Int[np.ndarray, " columns"]
    ) -> float:
        """Return the power that torques of some coefficients take from the motion, summed up."""
        torque = self.regressor[:, :, columns] @ k[columns]
        fitted = np.asarray(self.patterns.mask)
        return float(np.sum(np.where(fitted, torque * np.asarray(self.patterns.qd), 0.0)))

    def about(self, k: Float[np.ndarray, " unknowns"]) -> Equations:
        """The equations of currents, linear about some unknowns.

        With torque tau(k) and constants c, the error in current is i - tau(k) / c; times c, to
        first order about c0 and the current i0 that they predict, c0 (i - i0) - tau(k) + i0 c. With
        the measured current instead of i0, for a constant of 0 (not known yet), it is i c - tau(k).
        """
        current = np.asarray(self.patterns.torque)
        joints = current.shape[1]
        constants = k[-joints:]
        torque = self.regressor @ k[:-joints] + self.mass_torque
        column = np.divide(torque, constants, out=current.copy(), where=constants != 0.0)
        constant_part = constants * (current - column)
        diagonal = -column[:, :, None] * np.eye(joints)
        return Equations.of(
            self.unknowns,
            np.concatenate([self.regressor, diagonal], axis=2),
            constant_part - self.mass_torque,
            np.asarray(self.patterns.mask),
            time=np.asarray(self.patterns.time),
            cutoff=self.cutoff,
        )
