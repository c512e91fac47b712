import math

from jaxcslc.manipulator import puma560 as puma560_robot

from ._machine import Machine


_RANGE_DEGREES = (
    # Widths as commonly published; not in the thesis. Where they lie follows from the frames of
    # Fig. 2.6-3: joints 2 and 3 are centred on the arm stretched straight up, (-90°, 90°).
    (-160.0, 160.0),
    (-223.0, 43.0),
    (-52.0, 232.0),
    (-110.0, 170.0),
    (-100.0, 100.0),
    (-266.0, 266.0),
)
# Static friction of the real machines is not given. These are a choice: a quarter more than dry
# friction at rest, gone to within 1 % at the speeds from which Fig. B.6-1 calls it insignificant
# (exp(-5) = 0.007).
_STATIC_TO_DRY = 1.25
_INSIGNIFICANT_FROM = (0.16, 0.083, 0.12, 0.78, 0.82, 1.6)  # Fig. B.6-1 [rad/s]


def puma560() -> Machine:
    """The PUMA 560 as a machine: Armstrong's links, Leahy and Saridis's friction, real encoders.

    - Links, motor inertias, viscous and dry friction: `jaxcslc.puma560()`.
    - Encoder resolutions: Section 7.1.
    - Torque limits: Armstrong, Khatib and Burdick (1986).
    - Static friction, a choice: `static` is 1.25 times `dry`, and `static_velocity` a fifth of the
        thresholds that the thesis found for PUMA A (Fig. B.6-1).
    - Position ranges: as commonly published.

    ```python
    >>> import sim
    >>> sim.puma560().static
    (6.69375, 7.6725, 4.39875, 1.20375, 1.00125, 1.0575)

    ```
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
