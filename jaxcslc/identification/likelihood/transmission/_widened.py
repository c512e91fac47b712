import dataclasses
from collections.abc import Sequence

import numpy as np
from jaxtyping import Float

from .._objective import Point
from .._problem import Problem, SearchStart
from ._elastic_equations import ElasticEquations
from ._first_gears import FirstGears, smoothed_windup
from ._model import TransmissionModel
from ._parameters import TransmissionParameters
from ._transmission import Transmission


# Least compliance and inertia of a rotor beside those at first, and the standard deviation
# beforehand of the latter.
_LEAST, _ROTOR = 1e-3, 1.0
# Positions of links are not read: standard deviation of what would be readings [rad or m].
_UNREAD = 1e3

Recordings = Float[np.ndarray, "recordings joints"]


def with_transmission(
    problem: Problem,
    start: SearchStart,
    links: Sequence[int],
    first: FirstGears,
) -> tuple[Problem, SearchStart]:
    """The problem of rotors and links that move apart, from that of rigid gears.

    Links are further columns behind the joints, whose positions nothing reads. Gears have no
    play at first.

    **Arguments**

    - `links`: which move apart from their rotors, from 0.
    - `first`: gears to start from.
    """
    equations, readings, point = problem.equations, problem.readings, start.point
    network, n, f = equations.network, point.q.shape[1], len(links)
    index, zeros = np.array(links), np.zeros(len(links))
    friction = np.zeros(network.size, bool)
    friction[network.layout.friction] = True
    inertia = first.rotor_inertia
    parameters = TransmissionParameters(first.compliance, first.lag, zeros, inertia)
    least = TransmissionParameters(
        _LEAST * first.compliance, zeros, np.full(f, -np.inf), _LEAST * inertia
    )
    size = np.std(readings.torque.averaged[:, index], axis=0)
    scale = parameters._replace(play=first.compliance * size)
    expected = TransmissionParameters(zeros, zeros, zeros, inertia).values
    weight = TransmissionParameters(zeros, zeros, zeros, (_ROTOR * inertia) ** -2.0).values
    record = readings.torque
    of_links = tuple(np.zeros((len(torque), f)) for torque in record.torques)
    wide_record = dataclasses.replace(
        record,
        torques=tuple(
            np.concatenate(pair, axis=1) for pair in zip(record.torques, of_links, strict=True)
        ),
    )
    apart = ElasticEquations(
        equations,
        index,
        readings.time,
        friction,
        np.max(start.position_noise, axis=0)[index],
    )

    def narrow(point: Point) -> Point:
        return dataclasses.replace(
            point,
            q=point.q[:, :n],
            offset=point.offset[:, :n],
            transmission=np.zeros(0),
        )

    def known(point: Point, of_dry: Point) -> tuple[np.ndarray, np.ndarray]:
        mean, precision = problem.known(narrow(point), narrow(of_dry))
        return (
            _widened_border(mean, expected, problem, n, f, 0.0),
            _widened_border(precision, weight, problem, n, f, 1.0),
        )

    def breakaway(point: Point) -> np.ndarray:
        return np.concatenate([problem.breakaway(narrow(point)), np.zeros(f)])

    wide = dataclasses.replace(
        problem,
        equations=apart,
        readings=dataclasses.replace(
            readings,
            position=_wider(readings.position, f, 0.0),
            torque=wide_record,
        ),
        stuck=_wider(problem.stuck, f, 0.0),
        scale=_widened_border(problem.scale, scale.values, problem, n, f, 0.0),
        known=known,
        breakaway=breakaway,
        encoder_step=_wider(problem.encoder_step, f, 0.0),
        least_position_noise=_wider(problem.least_position_noise, f, _UNREAD),
        scatter=_wider(problem.scatter, f, 0.0),
        transmission=TransmissionModel(n, index, least.values),
    )
    wide_point = dataclasses.replace(
        point,
        k=np.where(problem.scale[: network.size] > 0.0, first.k, point.k),
        offset=_wider(point.offset, f, 0.0),
        q=np.concatenate([point.q, point.q[:, index] - first.windup], axis=1),
        transmission=parameters.values,
    )
    levels = _wider(start.torque_noise, f, 1.0), _wider(start.position_noise, f, _UNREAD)
    return wide, SearchStart(wide_point, *levels)


def _wider(values: np.ndarray, links: int, value: float) -> np.ndarray:
    return np.concatenate([values, np.full((len(values), links), value, values.dtype)], axis=1)


def _widened_border(
    values: Float[np.ndarray, " border"],
    of_gears: Float[np.ndarray, " parameters"],
    problem: Problem,
    joints: int,
    links: int,
    unread: float,
) -> Float[np.ndarray, " wide_border"]:
    """With the parameters of gears behind the slopes, and offsets of links, which are 0."""
    size = problem.equations.network.size + joints
    offsets = values[size:].reshape(-1, joints)
    return np.concatenate([values[:size], of_gears, _wider(offsets, links, unread).ravel()])


def near_transmission(
    problem: Problem,
    start: SearchStart,
    gears: Transmission,
    edge: Recordings | None = None,
) -> tuple[Problem, SearchStart, Float[np.ndarray, "recordings series"]]:
    """The same with gears that are known, and links where these have them.

    **Arguments** as of `with_transmission`, and

    - `gears`: with positions of links at the point's samples, or at others.
    - `edge`: (recordings, n) widths of intervals' edges in steps; returned for links too.
    """
    links = [joint - 1 for joint in gears.joints]
    point = start.point
    if len(gears.link_position) == len(point.q):
        windup = point.q[:, links] - gears.link_position
    else:
        windup = smoothed_windup(problem, point.k, gears)
    first = FirstGears(gears.compliance, gears.lag, gears.rotor_inertia, point.k, windup)
    wide, apart = with_transmission(problem, start, links, first)
    apart = apart._replace(point=dataclasses.replace(apart.point, transmission=gears.parameters))
    edges = np.zeros_like(start.position_noise) if edge is None else edge
    return wide, apart, _wider(edges, len(links), 0.0)
