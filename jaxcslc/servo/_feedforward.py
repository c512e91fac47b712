"""C99 that gives an arm of servos the commands for a wanted motion.

The rigid-body part is that of `jaxcslc.export`; the servos' part is appended to it.
"""

import dataclasses
from collections.abc import Sequence

import numpy as np

from ..export import CCode, c_code
from ..manipulator import Manipulator, RobotError
from ..network import derive
from ._drive import ServoDrive


SLOW = 0.02
"""Velocity below which friction is compensated in part [rad/s or m/s].

Commands would otherwise jump by twice the friction whenever a joint turns round. A joint that is
to pass a command step of 20 ms at this velocity moves by less than a tick of 12 bits.
"""

_CONSTANTS = (
    *("gain", "damping", "viscous", "coulomb", "load_friction", "armature", "offset"),
    "dead_zone",
)


def servo_feedforward(
    robot: Manipulator, drives: Sequence[ServoDrive], *, name: str | None = None
) -> CCode:
    """Write C99 for the commands with which servos follow a wanted motion.

    A servo needs a position error to make torque. The commands are the wanted readings plus that
    error: (torque of the links, armature and friction, plus damping times velocity) over the gain,
    plus the dead zone. With velocities and accelerations of zero this compensates gravity alone.

        void NAME_command(const double reading[n], const double qd[n], const double qdd[n],
                          double command[n])

    A command takes effect after the drive's delay: send the command of the motion that is wanted
    so much later. The other functions are those of `c_code`, without friction.

    **Arguments**

    - `robot`: with masses of links.
    - `drives`: one per joint.
    - `name`: a C identifier; made of the robot's name if omitted.

    **Returns** the code, for `write_c`.

    **Raises**

    - `RobotError`: a robot without masses, or another number of drives.
    - `ValueError`: a name that is no C identifier.

    >>> import jaxcslc as jc
    >>> from jaxcslc.servo import ServoDrive, servo_feedforward
    >>> code = servo_feedforward(jc.puma560(), [ServoDrive(gain=50.0)] * 6, name="arm")
    >>> "void arm_command(" in code.header
    True
    """
    if robot.links is None:
        raise RobotError(f"robot {robot.name!r} has no masses; expected those of each link")
    n = robot.joint_count
    if len(drives) != n:
        raise RobotError(f"{len(drives)} drives; expected {n}, one per joint")
    links = [dataclasses.replace(link, motor_inertia=0.0) for link in robot.links]
    network = derive(robot.with_friction(), lengths="numeric")
    code = c_code(network, np.asarray(network.coefficients_from(links)), name=name)
    signature = (
        f"void {code.name}_command(const double reading[{n}], const double qd[{n}],"
        f" const double qdd[{n}],\n    double command[{n}])"
    )
    summary = (
        "/* Commands of servos for wanted readings, velocities and accelerations. Send each as much"
        "\n * earlier as the servo's delay: "
        + ", ".join(f"{drive.delay:.4g}" for drive in drives)
        + " s. */"
    )
    tables = "\n".join(
        f"    static const double {label}[{n}] = {{"
        + ", ".join(f"{getattr(drive, label):.17g}" for drive in drives)
        + "};"
        for label in _CONSTANTS
    )
    definition = f"""{summary}
{signature}
{{
{tables}
    double q[{n}], tau[{n}], load[{n}];
    int j;
    for (j = 0; j < {n}; ++j)
        q[j] = reading[j] - offset[j];
    {code.name}_torque(q, qd, qdd, tau);
    {code.name}_gravity(q, load);
    for (j = 0; j < {n}; ++j) {{
        const double friction = coulomb[j] + load_friction[j] * fabs(load[j]);
        const double error = (tau[j] + armature[j] * qdd[j] + (viscous[j] + damping[j]) * qd[j]
            + friction * tanh(qd[j] / {SLOW:g})) / gain[j];
        command[j] = reading[j] + error
            + (error > 0.0 ? dead_zone[j] : error < 0.0 ? -dead_zone[j] : 0.0);
    }}
}}
"""
    declaration = f"{summary}\n{signature};\n\n"
    mark = "#ifdef __cplusplus\n}"
    head, mark, tail = code.header.rpartition(mark)
    return dataclasses.replace(
        code, header=f"{head}{declaration}{mark}{tail}", source=f"{code.source}\n{definition}"
    )
