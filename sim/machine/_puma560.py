"""The simulated PUMA 560, and specimens of a machine that differ as built ones do."""

import dataclasses
import math

import numpy as np

from jaxcslc.manipulator import LinkParameters, puma560 as puma560_robot
from sim.machine._machine import Machine


_RANGE_DEGREES = (
    # Widths as commonly published; not in the thesis. The centres follow from the frames of
    # Fig. 2.6-3: joints 2 and 3 are centred on the arm stretched straight up, (-90°, 90°).
    (-160.0, 160.0),
    (-223.0, 43.0),
    (-52.0, 232.0),
    (-110.0, 170.0),
    (-100.0, 100.0),
    (-266.0, 266.0),
)
# The thesis does not give static friction. These are choices: 1.25 times dry friction at rest, and
# an excess that falls to below 1 % (exp(-5) = 0.007) at the speeds from which Fig. B.6-1 calls it
# insignificant.
_STATIC_TO_DRY = 1.25
_INSIGNIFICANT_FROM = (0.16, 0.083, 0.12, 0.78, 0.82, 1.6)  # Fig. B.6-1 [rad/s]


def puma560() -> Machine:
    """The PUMA 560 as a machine: Armstrong's links, Leahy and Saridis's friction, real encoders.

    - Links, motor inertias, viscous and dry friction: `jaxcslc.puma560()`.
    - Encoder resolutions: Section 7.1.
    - Torque limits: Armstrong, Khatib and Burdick (1986).
    - Static friction, a choice: `static` is 1.25 times `dry`, and `static_velocity` a fifth of the
        thresholds of PUMA A (Fig. B.6-1).
    - Position ranges: as commonly published.

    >>> import sim
    >>> sim.puma560().static
    (6.69375, 7.6725, 4.39875, 1.20375, 1.00125, 1.0575)
    """
    robot = puma560_robot()
    assert robot.viscous is not None and robot.dry is not None
    return Machine(
        robot=robot,
        viscous=robot.viscous,
        dry=robot.dry,
        static=tuple(_STATIC_TO_DRY * dry for dry in robot.dry),
        static_velocity=tuple(speed / 5 for speed in _INSIGNIFICANT_FROM),
        encoder_resolution=(
            0.10035e-3,
            0.073156e-3,
            0.117e-3,
            0.082663e-3,
            0.087376e-3,
            0.081885e-3,
        ),
        maximum_torque=(97.6, 186.4, 89.4, 24.2, 20.1, 21.3),
        position_range=tuple(
            (math.radians(low), math.radians(high)) for low, high in _RANGE_DEGREES
        ),
    )


def specimen(machine: Machine, seed: int, *, links: float = 0.1, friction: float = 0.3) -> Machine:
    """Another machine of the same design, with random link and friction parameters.

    Masses, centres of gravity, inertias and motor inertias differ from the design's by up
    to `links` times their value, friction by up to `friction` times (the thesis finds mass and
    gravity coefficients alike in its two PUMA 560s and friction very different). A link's whole
    tensor has one factor, so that it stays physically possible.

    **Arguments**

    - `machine`: the design.
    - `seed`: which specimen.
    - `links`, `friction`: largest relative deviation, from 0 to below 1.

    **Raises** `ValueError`: a deviation outside that range.

    >>> import sim
    >>> sim.specimen(sim.puma560(), 1).dry == sim.puma560().dry
    False
    """
    for name, value in (("links", links), ("friction", friction)):
        if not 0 <= value < 1:
            raise ValueError(f"specimen, {name}: expected from 0 to below 1, got {value}")
    rng = np.random.default_rng(seed)

    def factor(spread: float) -> float:
        return float(1 + spread * rng.uniform(-1, 1))

    def other(link: LinkParameters) -> LinkParameters:
        centre = np.asarray(link.centre_of_gravity) * [factor(links) for _ in range(3)]
        return LinkParameters(
            link.mass * factor(links),
            centre,
            np.asarray(link.inertia) * factor(links),
            link.motor_inertia * factor(links),
        )

    assert machine.robot.links is not None  # a machine has them
    dry_factors = [factor(friction) for _ in machine.dry]
    return dataclasses.replace(
        machine,
        robot=dataclasses.replace(
            machine.robot, links=tuple(other(link) for link in machine.robot.links)
        ),
        viscous=tuple(value * factor(friction) for value in machine.viscous),
        dry=tuple(value * scale for value, scale in zip(machine.dry, dry_factors, strict=True)),
        static=tuple(
            value * scale for value, scale in zip(machine.static, dry_factors, strict=True)
        ),
    )
