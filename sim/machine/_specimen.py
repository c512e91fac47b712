import dataclasses

import numpy as np

from jaxcslc.manipulator import LinkParameters

from ._machine import Machine


def specimen(machine: Machine, seed: int, *, links: float = 0.1, friction: float = 0.3) -> Machine:
    """Another machine of the same design: what the next one off the line may be like.

    Masses, centres of gravity, inertias and motor inertias differ from the given machine's by up
    to `links` times their value, friction by up to `friction` times (the thesis finds mass and
    gravity coefficients alike in its two PUMA 560s and friction very different). One factor for a
    link's whole tensor keeps it that of a possible body.

    **Arguments**

    - `machine`: the design.
    - `seed`: which specimen.
    - `links`, `friction`: largest relative deviation, from 0 to below 1.

    **Raises**

    - `ValueError`: a deviation outside that range.

    ```python
    >>> import sim
    >>> sim.specimen(sim.puma560(), 1).dry == sim.puma560().dry
    False

    ```
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
    rub = [factor(friction) for _ in machine.dry]
    return dataclasses.replace(
        machine,
        robot=dataclasses.replace(
            machine.robot, links=tuple(other(link) for link in machine.robot.links)
        ),
        viscous=tuple(value * factor(friction) for value in machine.viscous),
        dry=tuple(value * by for value, by in zip(machine.dry, rub, strict=True)),
        static=tuple(value * by for value, by in zip(machine.static, rub, strict=True)),
    )
