"""A robot with its transmission as an MJCF document."""

import math
from collections.abc import Sequence
from typing import NamedTuple
from xml.sax.saxutils import quoteattr

import mujoco
import numpy as np
from jaxtyping import Float

from jaxcslc.manipulator import Joint, LinkParameters, Manipulator
from sim.machine._bodies import MachineError, possible_links


# Impedance of the friction constraint: the largest that MuJoCo accepts. A joint that sticks then
# creeps at about `torque / inertia * 1e-4 * time_step`: for a PUMA's wrist near breakaway 3e-7
# rad/s, a fortieth of an encoder count in the 6.6 s of a recording.
_IMPEDANCE = 0.9999
# MuJoCo refuses bodies without mass or moments. These are below a float64's rounding
# beside any real link.
_SMALLEST_MASS = 1e-12
_SMALLEST_MOMENT = 1e-13


def mjcf(
    robot: Manipulator,
    links: Sequence[LinkParameters] | None = None,
    *,
    viscous: Sequence[float] | None = None,
    breakaway: Sequence[float] | None = None,
    stiffness: Sequence[float] | None = None,
    backlash: Sequence[float] | None = None,
    transmission_damping: Sequence[float] | None = None,
    time_step: float = 5e-4,
) -> str:
    """A manipulator in MuJoCo's XML: bodies placed by the modified D-H rows (Eqn. 2.6-1).

    Body i is the frame of link i; its joint turns about or slides along its own z axis, and a
    motor of gear 1 drives it. The model has no stops, contacts or visual geometry, only the
    dynamics.

    Where a stiffness is finite, the motor drives a rotor instead, a body of the world with the
    motor's inertia; its joint comes after those of the links. A fixed tendon of the
    difference between rotor and link, whose spring is slack over a range of lengths, is the
    transmission. (The rotor turns without moving along with the link before it: 2.5.2 neglects
    the gyroscopic couple.)

    **Arguments**

    - `robot`: any serial chain of revolute and prismatic joints whose lengths have values.
    - `links`: its link parameters, one a joint; `robot.links` if omitted. Tensors that no rigid
        body can have are replaced by ones that can, with the same dynamics: see `possible_links`.
    - `viscous`: viscous friction of each joint [N m s/rad or N s/m], then of each
        rotor; none if omitted.
    - `breakaway`: breakaway torque of the same joints and rotors, which also opposes the motion
        of a sliding one [N m or N]; none if omitted.
    - `stiffness`: of each joint's transmission [N m/rad or N/m]; infinite if omitted.
    - `backlash`: the width of each dead band [rad or m]; 0 if omitted.
    - `transmission_damping`: of each tendon [N m s/rad or N s/m]; 0 if omitted.
    - `time_step`: of the integrator, a fourth-order Runge-Kutta method [s].

    **Returns** the text of an MJCF file.

    **Raises**

    - `MachineError`: link parameters are missing or cannot be made into rigid bodies, or friction
        does not have one value a joint and rotor.
    - `jaxcslc.RobotError`: a length has no value.

    >>> import mujoco
    >>> import jaxcslc
    >>> import sim
    >>> model = mujoco.MjModel.from_xml_string(sim.mjcf(jaxcslc.puma560()))
    >>> model.nv, float(model.dof_armature[1])
    (6, 4.71)
    """
    n = robot.joint_count
    links = robot.links if links is None else tuple(links)
    if links is None or len(links) != n:
        count = "none" if links is None else str(len(links))
        raise MachineError(f"robot {robot.name!r}: expected {n} link parameters, got {count}")
    stiffness = [math.inf] * n if stiffness is None else stiffness
    soft = [i for i in range(n) if stiffness[i] < math.inf]
    for name, values in (("viscous", viscous), ("breakaway", breakaway)):
        if values is not None and len(values) != n + len(soft):
            unit = "joint" if not soft else "joint and rotor"
            raise MachineError(
                f"{name} has {len(values)} values; expected {n + len(soft)}, one a {unit}"
            )
    robot.length_values()  # names the length that has no value

    def friction(dof: int) -> str:
        """Attributes of a degree of freedom's joint."""
        text = "" if viscous is None else f' damping="{float(viscous[dof])!r}"'
        if breakaway is not None and breakaway[dof] > 0:
            # The time constant is MuJoCo's shortest: a joint that friction can stop within a
            # step is stopped, whatever the step.
            text += (
                f' frictionloss="{float(breakaway[dof])!r}"'
                f' solreffriction="{2 * float(time_step)!r} 1"'
                f' solimpfriction="{_IMPEDANCE} {_IMPEDANCE} 1"'
            )
        return text

    def joint_line(name: str, i: int, inertia: float, dof: int) -> str:
        kind = "hinge" if robot.joints[i].kind == "R" else "slide"
        return (
            f'<joint name="{name}" type="{kind}" axis="0 0 1" armature="{inertia!r}"'
            f"{friction(dof)}/>"
        )

    lines = [
        f"<mujoco model={quoteattr(robot.name)}>",
        '  <compiler angle="radian"/>',
        f'  <option timestep="{float(time_step)!r}" gravity="{_numbers(robot.gravity)}"'
        ' integrator="RK4" solver="Newton" iterations="50" tolerance="1e-14">',
        '    <flag contact="disable"/>',
        "  </option>",
        "  <worldbody>",
    ]
    bodies = rigid_bodies(robot, links)
    for i, (joint, link, body) in enumerate(zip(robot.joints, links, bodies, strict=True)):
        motor = 0.0 if i in soft else float(link.motor_inertia)
        lines += _link_lines(i, joint, body, joint_line(f"joint_{i + 1}", i, motor, i))
    lines += ["  " * (i + 2) + "</body>" for i in reversed(range(n))]
    for dof, i in enumerate(soft, start=n):
        lines += [
            f'    <body name="rotor_{i + 1}">',
            f'      <inertial pos="0 0 0" mass="{_SMALLEST_MASS}"'
            f' diaginertia="{_numbers([_SMALLEST_MOMENT] * 3)}"/>',
            f"      {joint_line(f'rotor_{i + 1}', i, float(links[i].motor_inertia), dof)}",
            "    </body>",
        ]
    lines += [
        "  </worldbody>",
        *_transmission_lines(soft, stiffness, backlash, transmission_damping),
    ]
    lines += ["  <actuator>"]
    actuated = [f"rotor_{i + 1}" if i in soft else f"joint_{i + 1}" for i in range(n)]
    lines += [f'    <motor name="drive_{i + 1}" joint="{actuated[i]}"/>' for i in range(n)]
    lines += ["  </actuator>", "</mujoco>"]
    return "\n".join(lines) + "\n"


def _link_lines(i: int, joint: Joint, body: "RigidBody", joint_line: str) -> list[str]:
    """Begin of the body of a link, from 0, in the body before it."""
    a, d = float(joint.a.value or 0.0), float(joint.d.value or 0.0)
    position = (a, -math.sin(joint.alpha) * d, math.cos(joint.alpha) * d)
    ca, sa = math.cos(joint.alpha / 2), math.sin(joint.alpha / 2)
    ct, st = math.cos(joint.theta / 2), math.sin(joint.theta / 2)
    rotation = (ca * ct, sa * ct, -sa * st, ca * st)
    pad = "  " * (i + 2)
    return [
        f'{pad}<body name="link_{i + 1}" pos="{_numbers(position)}" quat="{_numbers(rotation)}">',
        f'{pad}  <inertial pos="{_numbers(body.centre)}" mass="{body.mass!r}"'
        f' quat="{_numbers(body.axes)}" diaginertia="{_numbers(body.moments)}"/>',
        f"{pad}  {joint_line}",
    ]


def _transmission_lines(
    soft: Sequence[int],
    stiffness: Sequence[float],
    backlash: Sequence[float] | None,
    damping: Sequence[float] | None,
) -> list[str]:
    """Tendons between rotors and links of flexible transmissions."""
    lines: list[str] = []
    for i in soft:
        half = 0.0 if backlash is None else float(backlash[i]) / 2
        loss = 0.0 if damping is None else float(damping[i])
        lines += [
            f'    <fixed name="gears_{i + 1}" springlength="{-half!r} {half!r}"'
            f' stiffness="{float(stiffness[i])!r}" damping="{loss!r}">',
            f'      <joint joint="rotor_{i + 1}" coef="1"/>',
            f'      <joint joint="joint_{i + 1}" coef="-1"/>',
            "    </fixed>",
        ]
    return ["  <tendon>", *lines, "  </tendon>"] if lines else []


class RigidBody(NamedTuple):
    """A link as MuJoCo has it: mass [kg], centre of gravity [m], principal moments [kg m²], and the
    quaternion (w, x, y, z) of their axes."""

    mass: float
    centre: Float[np.ndarray, "3"]
    moments: Float[np.ndarray, "3"]
    axes: Float[np.ndarray, "4"]


def rigid_bodies(robot: Manipulator, links: Sequence[LinkParameters]) -> list[RigidBody]:
    """The bodies of a robot's links.

    **Raises** `MachineError`: link parameters that cannot be made into rigid bodies.
    """
    return [
        RigidBody(
            max(float(link.mass), _SMALLEST_MASS),
            np.asarray(link.centre_of_gravity, dtype=np.float64),
            *_principal_moments(np.asarray(link.inertia, dtype=np.float64)),
        )
        for link in possible_links(robot, links)
    ]


def _principal_moments(
    inertia: Float[np.ndarray, "3 3"],
) -> tuple[Float[np.ndarray, "3"], Float[np.ndarray, "4"]]:
    """Principal moments [kg m²] and the quaternion (w, x, y, z) of their axes."""
    if np.count_nonzero(inertia - np.diag(np.diag(inertia))) == 0:
        moments, quaternion = np.diag(inertia).copy(), np.array([1.0, 0.0, 0.0, 0.0])
    else:
        moments, axes = np.linalg.eigh(inertia)
        axes[:, 2] *= np.sign(np.linalg.det(axes))
        quaternion = np.empty(4)
        mujoco.mju_mat2Quat(quaternion, axes.ravel())
    moments = np.maximum(moments, _SMALLEST_MOMENT)
    # A lamina's largest moment is the sum of the others, and rounding may put it beyond.
    largest = int(np.argmax(moments))
    others = float(np.sum(np.delete(moments, largest)))
    moments[largest] = min(float(moments[largest]), others)
    return moments, quaternion


def _numbers(values: Sequence[float] | np.ndarray) -> str:
    return " ".join(repr(float(value)) for value in values)
