"""The thesis's machines A and B, whose coefficients are nearest to the published ones."""

import dataclasses
import functools
import tomllib
from dataclasses import dataclass
from importlib.resources import files

import numpy as np
from jaxtyping import Float

from jaxcslc.manipulator import LinkParameters
from sim.machine._bodies import MachineError
from sim.machine._machine import Machine
from sim.machine._nearest_links import nearest_links
from sim.machine._puma560 import puma560


_STATIC_TO_DRY = 1.25  # a choice, as in `puma560`: the thesis gives no static friction
_SPEEDS_TO_INSIGNIFICANCE = 5  # exp(-5) = 0.007


@dataclass(frozen=True, eq=False)
class ThesisCoefficients:
    """Coefficients that the thesis identified on one of its PUMA 560s (Appendix B), as printed.

    Mass and gravity coefficients are in the order of `jaxcslc.derive(jaxcslc.puma560())`.
    """

    mass: Float[np.ndarray, "26"]
    """kM [kg m²] (Figs. B.1-1 and B.1-2)."""
    mass_sensitivity: Float[np.ndarray, "26"]
    """Mean torque of a unit of each, over joints and training set [N m a unit] (7.6)."""
    gravity: Float[np.ndarray, "5"]
    """kG [N m] (Figs. B.3-1 and B.3-2)."""
    gravity_sensitivity: Float[np.ndarray, "5"]
    """[N m a unit]."""
    viscous: Float[np.ndarray, "6"]
    """kv [N m s/rad] (Figs. B.4-1 and B.4-2)."""
    viscous_sensitivity: Float[np.ndarray, "6"]
    """[N m a unit]. Dry friction's is one sixth, whatever the motion (B.5)."""
    viscous_regressed: Float[np.ndarray, "6"]
    """kv of Ar+Rg: regressed with Armstrong's mass and gravity terms."""
    dry: Float[np.ndarray, "6"]
    """kd [N m] (Figs. B.5-1 and B.5-2)."""
    dry_regressed: Float[np.ndarray, "6"]
    """kd of Ar+Rg."""
    insignificant_from: Float[np.ndarray, "6"]
    """Speeds from which static friction is insignificant [rad/s] (Figs. B.6-1 and B.6-2)."""

    @property
    def coefficients(self) -> Float[np.ndarray, "43"]:
        """Coefficients in the order of the PUMA 560's network."""
        return np.concatenate([self.mass, self.gravity, self.viscous, self.dry])

    @property
    def sensitivity(self) -> Float[np.ndarray, "43"]:
        """Sensitivity of each of `coefficients` [N m per unit]."""
        dry = np.full(len(self.dry), 1 / len(self.dry))
        parts = [self.mass_sensitivity, self.gravity_sensitivity, self.viscous_sensitivity, dry]
        return np.concatenate(parts)


@functools.cache
def thesis_coefficients(machine: str) -> ThesisCoefficients:
    """Appendix B's identified coefficients of PUMA `"A"` or `"B"`, as printed.

    **Raises** `MachineError`: there is no such machine.

    >>> from sim import thesis_coefficients
    >>> float(thesis_coefficients("A").gravity[3])
    -45.71
    """
    document = tomllib.loads((files("sim") / "thesis_machines.toml").read_text(encoding="utf-8"))
    if machine not in document:
        raise MachineError(f"the thesis has no PUMA {machine!r}; expected 'A' or 'B'")
    values = {name: np.array(row) for name, row in document[machine].items()}
    for row in values.values():
        row.flags.writeable = False
    return ThesisCoefficients(**values)


def puma_a() -> Machine:
    """The physically possible machine nearest to the thesis's PUMA A.

    Its links are those of the possible PUMA 560 whose coefficients are nearest to the printed ones
    of Appendix B, weighted by the printed output sensitivities: see `nearest_links`. No machine
    has the printed coefficients: `docs/puma_a_b.md` lists the changes, their reasons and their
    effect on the torque.

    - Viscous and dry friction: Figs. B.4-1 and B.5-1 as printed.
    - Static friction: a choice, as in `puma560`. `static` is 1.25 times `dry`, and
        `static_velocity` a fifth of the speeds of Fig. B.6-1.
    - Everything else: `puma560`'s.

    >>> from sim import puma_a
    >>> puma_a().dry
    (9.169, 9.778, 5.392, 1.047, 1.007, 1.001)
    """
    return _puma("A")


def puma_b() -> Machine:
    """The physically possible machine nearest to the thesis's PUMA B: see `puma_a`.

    >>> from sim import puma_b
    >>> puma_b().viscous
    (6.097, 7.182, 3.006, 0.3536, 0.3239, 0.402)
    """
    return _puma("B")


def _puma(name: str) -> Machine:
    design, thesis = puma560(), thesis_coefficients(name)
    return dataclasses.replace(
        design,
        robot=dataclasses.replace(design.robot, name=f"PUMA {name}", links=_links(name)),
        viscous=tuple(thesis.viscous.tolist()),
        dry=tuple(thesis.dry.tolist()),
        static=tuple((_STATIC_TO_DRY * thesis.dry).tolist()),
        static_velocity=tuple((thesis.insignificant_from / _SPEEDS_TO_INSIGNIFICANCE).tolist()),
    )


@functools.cache
def _links(name: str) -> tuple[LinkParameters, ...]:
    thesis = thesis_coefficients(name)
    return nearest_links(
        puma560().robot,
        np.concatenate([thesis.mass, thesis.gravity]),
        np.concatenate([thesis.mass_sensitivity, thesis.gravity_sensitivity]),
    )
