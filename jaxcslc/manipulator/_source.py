"""Origin of a robot: its file, the limits that the file states, and joints that follow others."""

import math
from dataclasses import dataclass
from typing import Literal

import numpy as np
from jaxtyping import Float

from ._link_parameters import LinkParameters


RobotFormat = Literal["toml", "urdf", "mjcf"]
Mimics = Literal["fix", "couple"]


@dataclass(frozen=True)
class JointLimits:
    """Limits of a joint according to the robot's file; infinite where the file states none.

    **Attributes**

    - `low`, `high`: of its position [rad or m].
    - `speed`: [rad/s or m/s].
    - `torque`: [N m or N].

    >>> from jaxcslc.manipulator import JointLimits
    >>> JointLimits(speed=2.2).torque
    inf
    """

    low: float = -math.inf
    high: float = math.inf
    speed: float = math.inf
    torque: float = math.inf


@dataclass(frozen=True)
class Mimic:
    """A joint that follows another: its position is `multiplier` times the other's plus `offset`.

    **Attributes**

    - `follower`, `leader`: names of the joints; the leader follows none.
    - `multiplier`: [rad/rad, or m/rad of a finger that slides].
    - `offset`: [rad or m].

    >>> from jaxcslc.manipulator import Mimic
    >>> Mimic("right finger", "left finger", -1.0).offset
    0.0
    """

    follower: str
    leader: str
    multiplier: float
    offset: float = 0.0


@dataclass(frozen=True, eq=False)
class Source:
    """The file that a robot was read from, and how its links correspond to the file's bodies.

    **Attributes**

    - `path`, `format`: of the file.
    - `base`, `tips`: the part of the file's tree that was asked for, as bodies' names.
    - `fix`: joints and bodies that were to be fixed.
    - `mimic`: what was to become of joints that mimic others.
    - `fixed_joints`: joints that move in the file and are none of the robot's, taken as at zero.
    - `joints`, `links`: for each joint of the robot, the file's joint and the body that it moves.
    - `placements`: (4, 4) for each link, the pose of the file's body frame in the link's frame,
      lengths in m.
    - `carried`: for each link, all else that is fixed to the body, as one body in the link's
      frame; or None.
    - `limits`: of the joints; empty where the file has none.
    - `mimics`: joints of the robot that follow others; empty unless they were asked for.
    - `notes`: what of the file was not taken as it stands, a sentence each.
    """

    path: str
    format: RobotFormat
    joints: tuple[str, ...]
    links: tuple[str, ...]
    placements: tuple[Float[np.ndarray, "4 4"], ...]
    carried: tuple[LinkParameters | None, ...]
    base: str | None = None
    tips: tuple[str, ...] = ()
    fix: tuple[str, ...] = ()
    fixed_joints: tuple[str, ...] = ()
    limits: tuple[JointLimits, ...] = ()
    mimics: tuple[Mimic, ...] = ()
    mimic: Mimics | None = None
    notes: tuple[str, ...] = ()
