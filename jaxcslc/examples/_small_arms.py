"""Small robots, another system, and exact motions of them, for docstrings, notebooks and tests."""

from __future__ import annotations

from collections.abc import Sequence
from typing import TYPE_CHECKING

import numpy as np


if TYPE_CHECKING:
    from ..manipulator import Manipulator
    from ..network import CSLC
    from ..recordings import Patterns, Recording
    from ..systems import System, SystemRecording


def pendulum(*friction: str) -> Manipulator:
    """Return a link that swings about a horizontal axis.

    `friction` are its friction terms, viscous and dry ones where none is named.

    >>> import jaxcslc as jc
    >>> jc.derive(jc.examples.pendulum(), lengths="numeric").names
    ('kB1', 'kB2', 'kB3', 'kv1', 'kd1')
    """
    return _arm([(0, 0, 0, 0)], (0, -9.81, 0), friction)


def turntable(*friction: str) -> Manipulator:
    """Return a link that turns about a vertical axis, so that gravity does not load it.

    `friction` are its friction terms, viscous and dry ones where none is named.

    >>> import jaxcslc as jc
    >>> jc.derive(jc.examples.turntable("viscous"), lengths="numeric").names
    ('kB1', 'kv1')
    """
    return _arm([(0, 0, 0, 0)], (0, 0, -9.81), friction)


def planar_arm(*friction: str) -> Manipulator:
    """Return an arm of two links of 0.5 m in a vertical plane.

    `friction` are the terms of both joints, viscous and dry ones where none is named.

    >>> import jaxcslc as jc
    >>> jc.examples.planar_arm().joint_count
    2
    """
    return _arm([(0, 0, 0, 0), (0, 0.5, 0, 0)], (0, -9.81, 0), friction)


def swing(
    network: CSLC,
    k: Sequence[float] | np.ndarray,
    *,
    samples: int = 1000,
    time_step: float = 0.01,
    torque_noise: float = 0.0,
) -> Patterns:
    """Return patterns of a sinusoidal motion with the torques of coefficients `k`.

    Joint i (from 0) moves by sin((1 + 0.3 i) t + 0.5 i) rad, for `samples` samples, `time_step`
    apart [s]. All pairs count. Torques are exact, or have normal noise of standard deviation
    `torque_noise` [N m].

    >>> import jaxcslc as jc
    >>> network = jc.derive(jc.examples.pendulum(), lengths="numeric")
    >>> patterns = jc.examples.swing(network, [0.5, 0.3, -0.1, 0.2, 0.05])
    >>> jc.LeastSquares().fit(network, patterns).k.round(6).tolist()
    [0.5, 0.3, -0.1, 0.2, 0.05]
    """
    from ..recordings import Patterns

    t = np.arange(samples)[:, None] * time_step
    joint = np.arange(network.joint_count)
    rate = 1 + 0.3 * joint
    phase = rate * t + 0.5 * joint
    q, qd, qdd = np.sin(phase), rate * np.cos(phase), -(rate**2) * np.sin(phase)
    torque = np.asarray(network.torque(np.asarray(k, dtype=float), q, qd, qdd))
    torque = torque + torque_noise * np.random.default_rng(0).normal(size=q.shape)
    pairs = np.ones(q.shape, dtype=bool)
    return Patterns(t[:, 0], q, qd, qdd, torque, pairs, pairs)


def swing_recording(
    network: CSLC, k: Sequence[float] | np.ndarray, *, samples: int = 1000, time_step: float = 0.01
) -> Recording:
    """Return the recording of the motion of `swing`, without noise or quantisation.

    >>> import jaxcslc as jc
    >>> network = jc.derive(jc.examples.pendulum(), lengths="numeric")
    >>> recording = jc.examples.swing_recording(network, [0.5, 0.3, -0.1, 0.2, 0.05])
    >>> recording.position.shape
    (1000, 1)
    """
    from ..recordings import Recording

    patterns = swing(network, k, samples=samples, time_step=time_step)
    return Recording(patterns.time, patterns.q, patterns.torque)


def tank(samples: int = 1000) -> tuple[System, SystemRecording]:
    """Return a tank that drains by the root of its level, and an exact recording of it.

    Its area is 3 m², its outlet 0.5. The level moves by sin(t), `samples` samples 0.05 s apart.

    >>> import jaxcslc as jc
    >>> tank, recording = jc.examples.tank()
    >>> tank.network.names, sorted(recording.columns)
    (('area', 'outlet'), ['inflow', 'level'])
    """
    import sympy
    from sympy.physics.mechanics import dynamicsymbols

    from ..systems import Constant, System, SystemRecording, Variable

    level, inflow = dynamicsymbols("level inflow")
    area, outlet = sympy.symbols("area outlet")
    balance = sympy.Eq(inflow, area * level.diff() + outlet * sympy.sqrt(level))
    variables = (Variable(level, "m"), Variable(inflow, "m³/s"))
    constants = (Constant(area, "m²", sign="positive"), Constant(outlet))
    time = np.arange(samples) * 0.05
    height = 2.0 + np.sin(time)
    columns = {"level": height, "inflow": 3.0 * np.cos(time) + 0.5 * np.sqrt(height)}
    return System("tank", {"volume": balance}, variables, constants), SystemRecording(time, columns)


def _arm(
    rows: Sequence[Sequence[float | int]],
    gravity: Sequence[float | int],
    friction: Sequence[str],
) -> Manipulator:
    from ..manipulator import Manipulator

    arm = Manipulator.from_modified_dh(rows, gravity=gravity)
    return arm.with_friction(*friction) if friction else arm
