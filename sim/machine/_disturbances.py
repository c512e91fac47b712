"""Disturbances by name, at their size on a PUMA 560."""

import dataclasses
from collections.abc import Mapping
from types import MappingProxyType
from typing import Any

from sim.machine._bodies import MachineError
from sim.machine._machine import OFF, Machine
from sim.machine._puma560 import puma560


def _table() -> dict[str, dict[str, Any]]:
    puma = puma560()
    # Locked-rotor frequencies of 20 to 30 Hz at the main joints. The wrist's links are light
    # (link 6 has 4e-5 kg m²): with a spring of such frequencies the wrist's friction would twist
    # the transmission by a whole turn. Damping is 3 % of critical.
    stiffness = (4e4, 5e4, 2e4, 1.5e3, 1e3, 5e2)
    damping = (20.0, 20.0, 5.0, 0.1, 0.05, 0.01)
    share = (0.3,) * 6
    dead_band = (5e-4, 5e-4, 5e-4, 1e-3, 1e-3, 1e-3)
    return {
        "quantisation": {"encoder_resolution": puma.encoder_resolution},
        "static friction": {"static": puma.static, "static_velocity": puma.static_velocity},
        "asymmetric friction": {"asymmetry": (0.02,) * 6},
        "tilted axes": {"tilt": (0.1,) * 6},
        "motor linearity": {"linear_torque": (20.0, 40.0, 16.0, 6.4, 8.0, 11.0)},
        "sample timing": {"timing_jitter": 2e-5, "torque_delay": 1e-4},
        "compliance": {
            "stiffness": stiffness,
            "transmission_damping": damping,
            "link_share": share,
            "time_step": 2e-4,
        },
        # Nearly rigid gears beside the dead band: four times the stiffness, twice the frequency.
        "backlash": {
            "backlash": dead_band,
            "stiffness": tuple(4 * value for value in stiffness),
            "transmission_damping": tuple(2 * value for value in damping),
            "link_share": share,
            "time_step": 1e-4,
        },
    }


DISTURBANCES: Mapping[str, Mapping[str, Any]] = MappingProxyType(_table())
"""The disturbances of Section 7.2 on a PUMA 560: values of fields of `Machine` by the name of the
disturbance. The thesis gives the encoders' resolutions alone. The other values are choices, large
enough to change the results measurably."""


def undisturbed(machine: Machine) -> Machine:
    """A machine without the disturbances that Section 7.2 lists.

    Links, viscous and dry friction and limits stay. The seed decides the start position alone.

    >>> import sim
    >>> sim.undisturbed(sim.puma560()).encoder_resolution
    (0.0, 0.0, 0.0, 0.0, 0.0, 0.0)
    """
    return dataclasses.replace(
        machine,
        encoder_resolution=(0.0,) * machine.joint_count,
        static=machine.dry,
        timing_jitter=0.0,
        torque_delay=0.0,
        **dict.fromkeys(OFF, ()),
    )


def disturbed(machine: Machine, *names: str) -> Machine:
    """A PUMA 560 with some disturbances of Section 7.2, or with all of them, and no others.

    **Arguments**

    - `machine`: links and friction. Static friction becomes 1.25 times the machine's dry friction;
        if the machine has static friction already, that and its velocity are kept.
    - `names`: keys of `DISTURBANCES`; all of them if omitted. Backlash beside compliance is
        a dead band in compliant gears.

    **Raises** `MachineError`: an unknown name, or a machine of another number of joints than six.

    >>> import sim
    >>> machine = sim.disturbed(sim.puma560(), "backlash", "compliance")
    >>> machine.backlash[0], machine.stiffness[0], machine.tilt[0]
    (0.0005, 40000.0, 0.0)
    """
    if machine.joint_count != 6:
        raise MachineError(
            f"robot {machine.robot.name!r} has {machine.joint_count} joints;"
            " expected six, as these disturbances are a PUMA 560's"
        )
    for name in names:
        if name not in DISTURBANCES:
            raise MachineError(
                f"unknown disturbance {name!r}; expected some of {', '.join(DISTURBANCES)}"
            )
    selected = names or tuple(DISTURBANCES)
    changes: dict[str, Any] = {}
    for name in DISTURBANCES:
        if name in selected:
            changes |= DISTURBANCES[name]
    if "backlash" in selected and "compliance" in selected:
        changes |= DISTURBANCES["compliance"]
    if "static friction" in selected and machine.static != machine.dry:
        changes |= {"static": machine.static, "static_velocity": machine.static_velocity}
    elif "static friction" in selected:
        puma = puma560()
        pairs = zip(puma.static, puma.dry, strict=True)
        changes["static"] = tuple(
            dry * static / puma_dry
            for dry, (static, puma_dry) in zip(machine.dry, pairs, strict=True)
        )
    return dataclasses.replace(undisturbed(machine), **changes)
