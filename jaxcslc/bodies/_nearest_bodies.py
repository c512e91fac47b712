"""Physically consistent bodies nearest to a fit: semidefinite least squares, of one or all links.

`whitening` turns changes of coefficients into standard errors. Clarabel solves the cone
programme of full tensors; principal axes have the search of `_principal_programme`.
"""

import dataclasses
import math
from collections.abc import Sequence
from dataclasses import dataclass
from typing import Any, NamedTuple

import numpy as np
from jaxtyping import Float

from .._environment import require
from .._rank import numerical_rank
from ..manipulator import LinkParameters, Manipulator, steps_at_zero
from ..network import CSLC
from ._body import (
    ENTRIES,
    MASS,
    MOMENT,
    bodies_of,
    body_map,
    body_of_pseudo_inertia,
    central_tensor,
    constraints_of,
    principal_body,
    pseudo_inertia,
)
from ._principal_programme import BodyChart, nearest_in_charts
from ._prior import (
    FINEST,
    Fitted,
    KnownRows,
    LinearKnowledge,
    LinkKnowledge,
    body_form,
    linear_knowledge,
)


def whitening(
    fit: Fitted, sizes: Float[np.ndarray, " coefficients"]
) -> Float[np.ndarray, "rank coefficients"]:
    """Return the matrix that turns a change of the coefficients into standard errors.

    They are those of independent residuals: the result's squared norm is what the change adds to
    the sum of squared residuals, in units of their variance. A change along a combination that the
    data do not determine costs nothing: the covariance is inverted on its range only. `sizes` are
    those of typical coefficients.

    **Raises** `ValueError`: if the coefficients or their covariance are not finite.
    """
    # A covariance that allows for correlation is of low rank; torques are measured by the other.
    covariance = np.asarray(getattr(fit, "independent_covariance", fit.covariance), float)
    free = np.asarray(fit.undetermined, float)
    if not np.all(np.isfinite(covariance)) or not np.all(np.isfinite(np.asarray(fit.k))):
        raise ValueError("the fit's coefficients or covariance are not finite")
    units = np.sqrt(np.maximum(np.diag(covariance), 0.0)) + FINEST * sizes
    free = _basis(free, units)
    scaled = covariance / np.outer(units, units)
    scaled = (scaled + scaled.T) / 2 + np.diag((FINEST * sizes / units) ** 2)
    # Numbers that changes along undetermined combinations leave as they are. The covariance's range
    # would do as well, but beside a variance of infinity it cannot be told from rounding.
    numbers = np.eye(len(units))
    if free.size:
        numbers = np.linalg.svd(free)[2][len(free) :]
    values, vectors = np.linalg.eigh(numbers @ scaled @ numbers.T)
    # Of a motion that is all rounding, variances are too, and may be below zero.
    values = np.maximum(values, np.finfo(float).eps * len(values) * values[-1:])
    return (vectors.T / np.sqrt(values)[:, None]) @ numbers / units


def _basis(
    rows: Float[np.ndarray, "rows unknowns"], units: Float[np.ndarray, " unknowns"]
) -> Float[np.ndarray, "rank unknowns"]:
    """Return orthonormal rows that span given ones, in units of the unknowns."""
    rows = rows[np.linalg.norm(rows, axis=1) > 0] / units
    if not rows.size:
        return rows
    rows = rows / np.linalg.norm(rows, axis=1, keepdims=True)
    return np.linalg.svd(rows, full_matrices=False)[2][: numerical_rank(rows.T)]


# Entries of a symmetric matrix above its diagonal, column by column, and how a cone scales them so
# that their products add up to the trace of a product.
_UPPER = [(a, b) for b in range(4) for a in range(b + 1)]
_DIAGONAL = np.array([float(a == b) for a, b in _UPPER])
_TRIANGLE = np.where(_DIAGONAL > 0.0, 1.0, np.sqrt(2.0))


def semidefinite_least_squares(
    matrix: Float[np.ndarray, "rows unknowns"],
    target: Float[np.ndarray, " rows"],
    rows: Float[np.ndarray, "constraints unknowns"],
    values: Float[np.ndarray, " constraints"],
    *,
    bodies: int,
    bounded: Float[np.ndarray, " others"],
    least: float,
    above: Float[np.ndarray, "bounds unknowns"] | None = None,
    limits: Float[np.ndarray, " bounds"] | None = None,
) -> tuple[Float[np.ndarray, " unknowns"] | None, bool]:
    """Minimise |matrix x - target|² with x = (X₁, …, Xₘ, y), rows @ x = values, every Xᵢ (4, 4)
    symmetric with eigenvalues ≥ least, y ≥ 0 where `bounded` is not zero, above @ x ≥ limits.

    Where no inequality is active, the optimum is that of a least-squares problem: that is tried
    first, for it is exact where a conic solver is good to some eight digits.

    **Returns** the optimum, None if the solver fails, and whether the solver says that it is one.
    """
    from scipy.linalg import solve_triangular

    origin, span = _solutions(rows @ (expand := _expansion(bodies, len(bounded))), values)
    origin, span = expand @ origin, expand @ span
    stacked = np.concatenate([matrix @ span, (target - matrix @ origin)[:, None]], axis=1)
    triangle: Any = np.linalg.qr(stacked, mode="r")  # says all that the equations say
    size = span.shape[1]
    inverse = solve_triangular(triangle[:size, :size], np.eye(size))
    free = origin + span @ (inverse @ triangle[:size, size])
    lowest = np.min(np.linalg.eigvalsh(free[: ENTRIES * bodies].reshape(-1, 4, 4)))
    within = above is None or limits is None or bool(np.all(above @ free >= limits))
    if lowest >= least and np.all(free[ENTRIES * bodies :][bounded > 0] >= 0) and within:
        return free, True

    # From there, in steps that cost alike: what the data fix moves the bodies little. In the
    # unknowns themselves the condition number would be that of the data.
    steps = span @ inverse
    others = ENTRIES * bodies + np.flatnonzero(bounded)
    slopes, starts = [steps[others]], [free[others]]
    if above is not None and limits is not None:
        slopes.append(above @ steps)
        starts.append(above @ free - limits)
    for body in range(bodies):
        entries = ENTRIES * body + np.array([4 * a + b for a, b in _UPPER])
        slopes.append(_TRIANGLE[:, None] * steps[entries])
        starts.append(_TRIANGLE * (free[entries] - least * _DIAGONAL))
    inequalities = sum(map(len, slopes)) - len(_UPPER) * bodies
    step, solved = _shortest(np.concatenate(slopes), np.concatenate(starts), inequalities, bodies)
    return (None, False) if step is None else (free + steps @ step, solved)


def _shortest(
    slopes: Float[np.ndarray, "rows size"],
    starts: Float[np.ndarray, " rows"],
    inequalities: int,
    bodies: int,
) -> tuple[Float[np.ndarray, " size"] | None, bool]:
    """The shortest x with starts + slopes @ x in a product of cones, by Clarabel.

    - `inequalities`: the first rows, which are ≥ 0; behind them are scaled triangles of matrices.

    **Returns** x, None where the solver fails, and whether the solver says that it is optimal.
    """
    solver = _conic_solver()
    from scipy.sparse import csc_matrix

    size = slopes.shape[1]
    options = solver.DefaultSettings()
    options.verbose = False
    cones = [solver.NonnegativeConeT(inequalities)] if inequalities else []
    cones += [solver.PSDTriangleConeT(4)] * bodies
    # min ½ x'Px + q'x subject to Ax + s = b, s in the cones
    problem = csc_matrix(2.0 * np.eye(size)), np.zeros(size), csc_matrix(-slopes), starts
    try:
        solution = solver.DefaultSolver(*problem, cones, options).solve()
    except BaseException as error:  # of numbers that overflow in it, though they are finite
        if type(error).__name__ != "PanicException":
            raise
        return None, False
    status = str(solution.status)
    x = np.asarray(solution.x)
    if status not in ("Solved", "AlmostSolved", "MaxIterations") or not np.all(np.isfinite(x)):
        return None, False
    return x, status == "Solved"


def _conic_solver() -> Any:
    """Import Clarabel by itself: a modelling library takes a second to import."""
    return require("clarabel", "inertia")


def _expansion(bodies: int, others: int) -> Float[np.ndarray, "unknowns independent"]:
    """Return the matrix from ten independent entries of each symmetric matrix to all sixteen."""
    expand = np.zeros((ENTRIES * bodies + others, 10 * bodies + others))
    for body in range(bodies):
        for entry, (a, b) in enumerate(_UPPER):
            expand[ENTRIES * body + 4 * a + b, 10 * body + entry] = 1.0
            expand[ENTRIES * body + 4 * b + a, 10 * body + entry] = 1.0
    expand[ENTRIES * bodies :, 10 * bodies :] = np.eye(others)
    return expand


def _solutions(
    rows: Float[np.ndarray, "constraints unknowns"], values: Float[np.ndarray, " constraints"]
) -> tuple[Float[np.ndarray, " unknowns"], Float[np.ndarray, "unknowns free"]]:
    """Return the solutions x of rows @ x = values: one of them, and what can be added to it."""
    if not len(rows):
        return np.zeros(rows.shape[1]), np.eye(rows.shape[1])
    lengths = np.linalg.norm(rows, axis=1)
    lengths = np.where(lengths > 0.0, lengths, 1.0)
    rows, values = rows / lengths[:, None], values / lengths
    left, sizes, right = np.linalg.svd(rows)
    rank = numerical_rank(rows.T)
    return right[:rank].T @ ((left.T @ values)[:rank] / sizes[:rank]), right[rank:].T


# A solid ball's spread of mass along an axis is its mass times its squared radius, over this; its
# moment of inertia is the spread along two axes.
_BALL = 5.0
# Of aluminium [kg/m³]: how large the ball is that a body of unknown shape is compared with.
_DENSITY = 2700.0
_LIGHTEST = 1e-3  # kg
# Farthest centre of the ball from the frame's origin [m]: an estimate of first moments without mass
# has none.
_FARTHEST = 1.0
# Sizes of typical numbers of a body [kg m², kg m, kg].
_SIZES = np.array([0.1] * 6 + [0.3] * 3 + [1.0])
# Standard errors that a change by the whole ball counts: it decides what the data leave open.
_WEIGHT = 1e-3


@dataclass(frozen=True, eq=False)
class _Estimate:
    k: Float[np.ndarray, "10"]
    covariance: Float[np.ndarray, "10 10"]
    undetermined: Float[np.ndarray, "rows 10"]


def nearest_body(
    body: Float[np.ndarray, "10"],
    covariance: Float[np.ndarray, "10 10"],
    undetermined: Float[np.ndarray, "rows 10"] | None = None,
    *,
    least: float = 1e-3,
) -> Float[np.ndarray, "10"] | None:
    """Return the physically consistent body nearest to an estimate of its ten numbers (`BODY`).

    The semidefinite programme of `physical_parameters` for one body: nearest in standard errors
    of `covariance`, on the combinations that are determined; along the `undetermined` ones,
    nearest to an aluminium ball of the estimate's mass around its centre. An estimate that can
    exist is its own answer, except for rounding.

    **Arguments**

    - `body`, `covariance`: the estimate, and how uncertain it is.
    - `undetermined`: combinations that the data do not determine; none if omitted.
    - `least`: the body holds at least this part of such a ball (eigenvalues of its
      pseudo-inertia, in units of the ball's).

    **Returns**

    - Ten numbers of the body; None if the solver fails.

    **Raises**

    - `ImportError`: without the conic solver, where the estimate cannot exist.

    >>> import numpy as np
    >>> body = nearest_body(np.array([-0.1, 1, 1, 0, 0, 0, 0.5, 0, 0, 2.0]), np.eye(10))
    >>> bool(np.all(np.linalg.eigvalsh(pseudo_inertia(body)) > 0))
    True
    """
    if undetermined is None:
        undetermined = np.zeros((0, 10))
    ball = _ball(body, covariance, undetermined)
    unit = in_units_of(ball)
    estimate = _Estimate(body, covariance, undetermined)
    white = whitening(estimate, np.linalg.norm(unit, axis=1))
    solution, _ = semidefinite_least_squares(
        np.concatenate([white @ unit, _WEIGHT * np.eye(ENTRIES)]),
        np.concatenate([white @ body, _WEIGHT * np.eye(4).ravel()]),
        np.zeros((0, ENTRIES)),
        np.zeros(0),
        bodies=1,
        bounded=np.zeros(0),
        least=least,
    )
    return None if solution is None else unit @ solution


def in_units_of(body: Float[np.ndarray, "10"]) -> Float[np.ndarray, "10 16"]:
    """Return the matrix from the entries of J̃ to the ten numbers of J = L J̃ Lᵀ.

    L Lᵀ is the pseudo-inertia of `body`.
    """
    scale = np.linalg.cholesky(pseudo_inertia(body))
    columns: list[np.ndarray] = []
    for entry in np.eye(ENTRIES):
        matrix = scale @ entry.reshape(4, 4) @ scale.T
        columns.append(body_of_pseudo_inertia((matrix + matrix.T) / 2))
    return np.stack(columns, axis=1)


def _in_units(
    unit: Float[np.ndarray, "10 16"], body: Float[np.ndarray, "10"]
) -> Float[np.ndarray, "16"]:
    """Return the entries of the symmetric J̃ of a body, for the matrix of `in_units_of`."""
    # The least solution is the symmetric one: entries across the diagonal count alike.
    return np.linalg.lstsq(unit, body)[0]


def _ball(
    body: Float[np.ndarray, "10"],
    covariance: Float[np.ndarray, "10 10"],
    undetermined: Float[np.ndarray, "rows 10"],
) -> Float[np.ndarray, "10"]:
    """A ball around the estimate's centre, of its mass or the mass's error, whichever is more.

    Without what is not determined, or has an error larger than any body: there the estimate is
    arbitrary, and a centre may be kilometres away. The ball is as heavy as its first moments need
    it to be within 1 m.
    """
    error = np.sqrt(np.maximum(np.diag(covariance), 0.0)) / _SIZES
    scaled = body / _SIZES / (1.0 + error**2)
    basis = _basis(undetermined, _SIZES)
    scaled = scaled - basis.T @ (basis @ scaled)
    moment = _SIZES[MOMENT] * scaled[MOMENT]
    mass = max(
        float(_SIZES[MASS] * scaled[MASS]),
        float(_SIZES[MASS] * min(error[MASS], 1.0)),
        float(np.linalg.norm(moment)) / _FARTHEST,
        _LIGHTEST,
    )
    radius = (3.0 * mass / (4.0 * np.pi * _DENSITY)) ** (1.0 / 3.0)
    return principal_body(mass, moment / mass, np.full(3, mass * radius**2 / _BALL))


# A ball is at least this part of the robot's reach in radius, and no smaller than this [m].
_SMALLEST_PART, _SMALLEST_RADIUS = 0.1, 0.02
# A prior that is no body (a massless link, a flat one) gets this much of a ball in the directions
# that it lacks.
_FILL = 0.02


@dataclass(frozen=True)
class PriorBodies:
    """Bodies and motor inertias to keep to where the data say nothing.

    **Attributes**

    - `bodies`: ten numbers a link, all of them possible.
    - `motors`: motor inertias.
    - `motor_scales`: what counts as a change by a whole one.
    """

    bodies: Float[np.ndarray, "links 10"]
    motors: Float[np.ndarray, " links"]
    motor_scales: Float[np.ndarray, " links"]


def reach_of(robot: Manipulator) -> float:
    """Return the sum of a robot's lengths [m]."""
    return sum(abs(length.value or 0.0) for joint in robot.joints for _, _, length in joint.lengths)


def balls(robot: Manipulator, mass: float) -> tuple[LinkParameters, ...]:
    """Solid balls of equal mass, one a link, half way to where the next joint is.

    The assumption for a robot of which only the lengths are known.
    """
    reach = reach_of(robot)
    links: list[LinkParameters] = []
    for inertia, end in zip(robot.inertia, _ends(robot), strict=True):
        radius = max(float(np.linalg.norm(end)) / 2, _SMALLEST_PART * reach, _SMALLEST_RADIUS)
        zero = np.array([f"r{axis}" in inertia.zero for axis in "xyz"])
        centre = np.where(zero, 0.0, end / 2)
        links.append(LinkParameters(mass, centre, 2.0 / _BALL * mass * radius**2 * np.eye(3)))
    return tuple(links)


def ends_of(robot: Manipulator) -> Float[np.ndarray, " links"]:
    """Distances from each joint to the farthest one that its link carries [m]."""
    return np.linalg.norm(_ends(robot), axis=1)


def _ends(robot: Manipulator) -> Float[np.ndarray, "links 3"]:
    ends = np.zeros((robot.joint_count, 3))
    origins = steps_at_zero(robot.joints)[:, :3, 3]
    for origin, parent in zip(origins, robot.parents, strict=True):
        if parent >= 0 and np.linalg.norm(origin) > np.linalg.norm(ends[parent]):
            ends[parent] = origin
    return ends


def prior_of(
    robot: Manipulator,
    links: Sequence[LinkParameters],
    filler: Sequence[LinkParameters],
    fixed: Float[np.ndarray, "links 10"],
) -> PriorBodies:
    """Links without what is fixed to them, made bodies where they are none.

    **Arguments**

    - `robot`: its links' kinds of inertia.
    - `links`: their parameters.
    - `filler`: a physically consistent body for each link, which lends it what it lacks.
    - `fixed`: ten numbers of the body that is fixed to each link.
    """
    bodies = bodies_of(links) - fixed
    lenders = bodies_of(filler)
    possible = np.stack(
        [
            _possible(body, lender) if inertia.form == "full" else _possible_principal(body, lender)
            for body, lender, inertia in zip(bodies, lenders, robot.inertia, strict=True)
        ]
    )
    motors = np.array([float(link.motor_inertia) for link in links])
    # A light link's motor may be heavy: it is of the machine's size, as the lenders are.
    largest = np.maximum(possible, lenders)
    link_scales = np.where([kind == "R" for kind in robot.kinds], largest[:, 2], largest[:, MASS])
    return PriorBodies(possible, motors, np.where(motors > 0, motors, link_scales))


def _possible(
    body: Float[np.ndarray, "10"], lender: Float[np.ndarray, "10"]
) -> Float[np.ndarray, "10"]:
    """The body with its pseudo-inertia's eigenvalues, in units of the lender's, kept from zero."""
    scale = np.linalg.cholesky(pseudo_inertia(lender))
    unit = np.linalg.solve(scale, np.linalg.solve(scale, pseudo_inertia(body)).T)
    values, vectors = np.linalg.eigh((unit + unit.T) / 2)
    # A lender is of this machine's size, not of this link's: a light link needs little.
    least = _FILL * min(1.0, max(float(values[-1]), _FILL))
    if values[0] >= least * 1e-3:
        return body
    values = np.maximum(values, least)
    filled = scale @ (vectors * values) @ vectors.T @ scale.T
    return body_of_pseudo_inertia((filled + filled.T) / 2)


def _possible_principal(
    body: Float[np.ndarray, "10"], lender: Float[np.ndarray, "10"]
) -> Float[np.ndarray, "10"]:
    """Return a physically consistent body that keeps its principal axes.

    Its mass, and its spread along each axis, are kept from zero.
    """
    mass = max(float(body[MASS]), _FILL * float(lender[MASS]))
    centre = body[MOMENT] / mass
    moments = np.diag(central_tensor(body)) if body[MASS] > 0 else body[:3]
    spread = np.sum(moments) / 2 - moments
    some = _FILL * mass / lender[MASS] * np.diag(pseudo_inertia(lender))[:3]
    spread = np.maximum(spread, _FILL * np.maximum(np.max(spread), some))
    return principal_body(mass, centre, spread)


class Confidence(NamedTuple):
    """Errors of bodies that are a prior.

    - `changes`: (n, 10, 10) independent changes of each link, as columns.
    - `motors`: (n,) standard errors of motor inertias.
    - `offsets`: (p,) standard errors of torque offsets about zero; 0 of all other coefficients.
    - `width`: standard error of each change.
    - `rows`: the prior as equations of coefficients, and how a fit is weighed against it.
    """

    changes: Float[np.ndarray, "links 10 10"]
    motors: Float[np.ndarray, " links"]
    offsets: Float[np.ndarray, " coefficients"]
    width: float
    rows: KnownRows


WEAK = 0.01
"""The weight of a prior that decides only what the data do not: standard errors that a change by
the whole of it counts."""


class Optimum(NamedTuple):
    """Bodies without what is fixed to them, the `others` of `NearestBodies` in their units, and
    whether the solver says that they are the optimum."""

    bodies: Float[np.ndarray, "links 10"]
    others: Float[np.ndarray, " others"]
    converged: bool


@dataclass(frozen=True, eq=False)
class NearestBodies:
    """The programme that finds the bodies, motor inertias and friction nearest to a fit.

    Coefficients are `body_columns · (bodies + fixed) + other_columns @ others`. The `others` are
    motor inertias, then all coefficients that are not inertial, in units of `scales`.

    - `k`: the fit's coefficients; `whitening`: turns changes of them into standard errors.
    - `fixed`: bodies that are fixed to links and known.
    - `prior`: bodies to keep to where the data say nothing; `others`: the same of the others.
    - `bounded`: 1 for others that cannot be negative.
    - `changes`: independent changes of bodies, as columns; of the pseudo-inertia in units of the
      prior if None.
    - `weight`: standard errors that a change of a body by its whole unit counts.
    - `known`: 1 for others that the prior knows: motor inertias of the robot's file, and torque
      offsets. A motor inertia that it lacks is no measurement of zero, and counts by `WEAK` at
      most.
    - `informed`: whether bodies of the prior are those of the robot, not balls.
    - `knowledge`: what is known of single parameters.
    """

    robot: Manipulator
    k: Float[np.ndarray, " coefficients"]
    whitening: Float[np.ndarray, "rank coefficients"]
    fixed: Float[np.ndarray, "links 10"]
    prior: PriorBodies
    changes: Float[np.ndarray, "links 10 10"] | None
    body_columns: Float[np.ndarray, "coefficients links 10"]
    other_columns: Float[np.ndarray, "coefficients others"]
    others: Float[np.ndarray, " others"]
    bounded: Float[np.ndarray, " others"]
    scales: Float[np.ndarray, " others"]
    weight: float
    known: Float[np.ndarray, " others"]
    informed: bool
    knowledge: tuple[LinkKnowledge, ...] = ()

    @classmethod
    def from_fit(
        cls,
        network: CSLC,
        fit: Fitted,
        prior: Sequence[LinkParameters] | None = None,
        *,
        fixed: Sequence[LinkParameters | None] | None,
        weight: float,
        motors: bool = True,
        knowledge: Sequence[LinkKnowledge] = (),
        confidence: Confidence | None = None,
    ) -> "NearestBodies":
        """The programme of a fit; arguments are those of `physical_parameters`.

        **Raises**

        - `ValueError`: for a fit of another number of coefficients, or one that is not finite.
        """
        robot, p, inertial = network.robot, network.size, network.layout.inertial
        k = np.asarray(fit.k, float)
        if k.shape != (p,):
            raise ValueError(f"fit: expected {p} coefficients, got an array of shape {k.shape}")
        fixed_bodies = np.zeros((robot.joint_count, 10))
        for i, link in enumerate(fixed or ()):
            if link is not None:
                fixed_bodies[i] = bodies_of([link])[0]
        inertial_of_bodies, of_motors = body_map(network.algebra)
        others = np.setdiff1d(np.arange(p), np.arange(p)[inertial])
        motor_mask = np.array([motors and inertia.motor for inertia in robot.inertia], bool)
        motor_count = int(motor_mask.sum())
        body_columns = np.zeros((p, *inertial_of_bodies.shape[1:]))
        body_columns[inertial] = inertial_of_bodies

        links = prior if prior is not None else robot.links
        if links is None:
            unit_balls = bodies_of(balls(robot, 1.0))
            ball = balls(robot, _mass(fit, np.einsum("ple,le->p", body_columns, unit_balls)))
            prior_bodies = prior_of(robot, ball, ball, 0.0 * fixed_bodies)
        else:
            masses = [float(link.mass) for link in links if float(link.mass) > 0]
            ball = balls(robot, float(np.mean(masses or [1.0])))
            prior_bodies = prior_of(robot, links, ball, fixed_bodies)
        known = prior_bodies.motors > 0
        if confidence is not None:
            known = np.ones(robot.joint_count, bool)
            weight = 1.0 / confidence.width
            prior_bodies = dataclasses.replace(
                prior_bodies, motor_scales=confidence.motors / confidence.width
            )

        errors = np.sqrt(np.maximum(np.diag(np.asarray(fit.covariance, float)), 0.0))[others]
        sizes = np.maximum(np.abs(k[others]), errors)
        scales = np.concatenate(
            [prior_bodies.motor_scales[motor_mask], np.where(sizes > 0, sizes, 1.0)]
        )
        positive = np.array([network.coefficients[i].positive for i in others], bool)
        start = np.where(positive, np.maximum(k[others], 0.0), k[others])
        offsets = np.zeros(len(others)) if confidence is None else confidence.offsets[others]
        start = np.where(offsets > 0.0, 0.0, start)
        scales[motor_count:] = np.where(offsets > 0.0, offsets * weight, scales[motor_count:])
        other_columns = np.zeros((p, len(scales)))
        other_columns[inertial, :motor_count] = of_motors[:, motor_mask]
        other_columns[others, motor_count:] = np.eye(len(others))
        other_columns *= scales
        changes = [
            body_columns[:, i] @ in_units_of(body) for i, body in enumerate(prior_bodies.bodies)
        ]
        typical = np.linalg.norm(np.concatenate([*changes, other_columns], axis=1), axis=1)
        return cls(
            robot=robot,
            k=k,
            whitening=whitening(fit, np.where(typical > 0, typical, 1.0))
            if confidence is None
            else confidence.rows.rows_of(fit),
            fixed=fixed_bodies,
            prior=prior_bodies,
            changes=None if confidence is None else confidence.changes,
            body_columns=body_columns,
            other_columns=other_columns,
            others=np.concatenate([prior_bodies.motors[motor_mask], start]) / scales,
            bounded=np.concatenate([np.ones(motor_count), 1.0 * positive]),
            scales=scales,
            weight=weight,
            known=np.concatenate([1.0 * known[motor_mask], 1.0 * (offsets > 0.0)]),
            informed=links is not None,
            knowledge=tuple(knowledge),
        )

    def solve(self, least: float) -> Optimum | None:
        """Return the nearest bodies with a part `least` of their prior; None if the solver fails.

        Full tensors make a convex programme. Principal axes do not, and have a search of their own.
        """
        if all(inertia.form == "full" for inertia in self.robot.inertia):
            optimum = self._convex(least)
        else:
            optimum = self._in_charts(least)
        if optimum is None:
            return None
        bodies, others, converged = optimum
        others = np.where(self.bounded > 0, np.maximum(others, 0.0), others) * self.scales
        return Optimum(bodies, others, converged)

    def distance(self, k: Float[np.ndarray, " coefficients"]) -> float:
        """Root mean square change of the determined coefficients, in standard errors."""
        change = self.whitening @ (k - self.k)
        return float(np.sqrt(np.mean(change**2))) if change.size else 0.0

    def coefficients(self, optimum: Optimum) -> Float[np.ndarray, " coefficients"]:
        """The coefficients that an optimum implies."""
        k = np.einsum("ple,le->p", self.body_columns, optimum.bodies + self.fixed)
        return k + self.other_columns @ (optimum.others / self.scales)

    @property
    def _other_weights(self) -> Float[np.ndarray, " others"]:
        return np.where(self.known > 0, self.weight, min(self.weight, WEAK))

    def _convex(self, least: float) -> Optimum | None:
        count = len(self.prior.bodies)
        units = [in_units_of(body) for body in self.prior.bodies]
        columns = [self.body_columns[:, i] @ unit for i, unit in enumerate(units)]
        matrix = self.whitening @ np.concatenate([*columns, self.other_columns], axis=1)
        of_fixed = np.einsum("ple,le->p", self.body_columns, self.fixed)
        rows: list[np.ndarray] = []
        values: list[float] = []
        for i, (inertia, unit) in enumerate(zip(self.robot.inertia, units, strict=True)):
            for form in constraints_of(inertia):
                row = np.zeros(matrix.shape[1])
                row[ENTRIES * i : ENTRIES * (i + 1)] = form @ unit
                size = np.linalg.norm(row)
                rows.append(row / size)
                values.append(float(-form @ self.fixed[i] / size))
        known = self._linear_knowledge(units)
        prior, wanted = self._prior_rows(units)
        solution, converged = semidefinite_least_squares(
            np.concatenate([matrix, prior, known.soft]),
            np.concatenate([self.whitening @ (self.k - of_fixed), wanted, known.target]),
            np.concatenate([np.array(rows).reshape(-1, matrix.shape[1]), known.rows]),
            np.concatenate([np.array(values), known.values]),
            bodies=count,
            bounded=self.bounded,
            least=least,
            above=known.above,
            limits=known.least,
        )
        if solution is None:
            return None
        in_units, others = np.split(solution, [ENTRIES * count])
        pairs = zip(units, in_units.reshape(count, ENTRIES), strict=True)
        return Optimum(np.stack([unit @ body for unit, body in pairs]), others, converged)

    def _prior_rows(
        self, units: Sequence[Float[np.ndarray, "10 16"]]
    ) -> tuple[Float[np.ndarray, "rows unknowns"], Float[np.ndarray, " rows"]]:
        """Return the prior as equations of the programme's unknowns, and their right-hand sides."""
        from scipy.linalg import block_diag

        pairs = list(zip(units, self.prior.bodies, strict=True))
        if self.changes is None:
            rows = [np.eye(ENTRIES)] * len(pairs)
            wanted = [_in_units(unit, body) for unit, body in pairs]
        else:
            forms = np.linalg.inv(self.changes)
            rows = [form @ unit for form, unit in zip(forms, units, strict=True)]
            wanted = [form @ body for form, (_, body) in zip(forms, pairs, strict=True)]
        others = self._other_weights
        return (
            block_diag(*(self.weight * row for row in rows), np.diag(others)),
            np.concatenate([self.weight * np.concatenate(wanted), others * self.others]),
        )

    def _linear_knowledge(self, units: Sequence[Float[np.ndarray, "10 16"]]) -> LinearKnowledge:
        """Return the knowledge of parameters in the programme's unknowns."""
        count, source = len(units), self.robot.source
        placements = (np.eye(4),) * count if source is None else source.placements
        motors = [i for i, inertia in enumerate(self.robot.inertia) if inertia.motor]

        def row_of(entry: LinkKnowledge, value: float) -> Float[np.ndarray, " unknowns"]:
            row = np.zeros(ENTRIES * count + len(self.others) + 1)
            if entry.parameter == "motor_inertia":
                index = motors.index(entry.link)
                row[ENTRIES * count + index], row[-1] = self.scales[index], -value
                return row
            form = np.eye(10)[MASS]
            if entry.parameter == "mass":
                row[-1] = -value
            else:
                form = body_form(entry.parameter, value, placements[entry.link])
            row[ENTRIES * entry.link : ENTRIES * (entry.link + 1)] = form @ units[entry.link]
            return row

        masses = self.prior.bodies[:, MASS]
        return linear_knowledge(self.knowledge, row_of, masses, ENTRIES * count + len(self.others))

    def _in_charts(self, least: float) -> Optimum:
        if np.any(self.fixed):
            raise ValueError("fixed: bodies can be fixed to links with full inertia tensors only")
        if self.knowledge:
            raise ValueError(
                "prior, links: parameters can be known of links with full inertia tensors only"
            )
        charts = [
            BodyChart.from_prior(inertia, body, least)
            for inertia, body in zip(self.robot.inertia, self.prior.bodies, strict=True)
        ]
        solution = nearest_in_charts(
            charts,
            np.einsum("rp,ple->rle", self.whitening, self.body_columns),
            self.whitening @ self.other_columns,
            self.whitening @ self.k,
            self.others,
            self.bounded,
            np.concatenate(
                [
                    np.full(sum(len(chart.start) for chart in charts), self.weight),
                    self._other_weights,
                ]
            ),
        )
        return Optimum(*solution)


def _mass(fit: Fitted, of_mass: Float[np.ndarray, " coefficients"]) -> float:
    """The mass of equal bodies that explains the coefficients best, whatever the friction."""
    inertial = of_mass != 0
    white = whitening(fit, np.full(len(of_mass), max(float(np.abs(of_mass).max()), 1e-12)))
    columns = np.concatenate([of_mass[:, None], np.eye(len(of_mass))[:, ~inertial]], axis=1)
    mass = float(np.linalg.lstsq(white @ columns, white @ np.asarray(fit.k, float))[0][0])
    return min(max(mass, 0.1), 1000.0) if np.isfinite(mass) and mass > 0 else 1.0


# A change of a body by a tenth of itself then counts one standard error: no file of a robot, which
# is drawn with screws and cables left out, is better.
_STRONGEST = 10.0
_STEPS_A_DECADE = 2
# How far the prior may move the bodies, in standard errors (root mean square). The truth is one
# away, but with all of it a wrong file (masses halved or doubled, centres elsewhere, spheres) made
# predictions of new motion up to 1.8 times worse; with half of it never more than 2 % worse.
_DISCREPANCY = 0.5


def by_discrepancy(problem: NearestBodies, least: float) -> tuple[NearestBodies, Optimum | None]:
    """The programme with the largest weight of the robot's bodies that the data do not contradict.

    The discrepancy principle (Morozov 1966): the errors of the data say how far from the fit the
    solution may be. The true coefficients are a standard error from it; of bodies that are half of
    that away the data say nothing against any, and those nearest to the robot's file are the best
    guess. Where even the nearest such bodies are d standard errors from the fit, the weight is
    the largest whose bodies are not further than sqrt(d² + 0.5²). Weights are powers of √10 from
    `WEAK` to 10. Bodies that are no robot's, as balls are, keep the weight `WEAK`.
    """
    weak = dataclasses.replace(problem, weight=WEAK)
    nearest = weak.solve(least)
    if nearest is None or not problem.informed:
        return weak, nearest
    limit = math.hypot(weak.distance(weak.coefficients(nearest)), _DISCREPANCY)
    best = weak, nearest
    # Distances grow with the weight: the first one tried is most often the answer.
    low, high, step = 0, round(_STEPS_A_DECADE * math.log10(_STRONGEST / WEAK)), None
    while low < high:
        step = high if step is None else (low + high + 1) // 2
        candidate = dataclasses.replace(problem, weight=WEAK * 10 ** (step / _STEPS_A_DECADE))
        optimum = candidate.solve(least)
        if optimum is not None and candidate.distance(candidate.coefficients(optimum)) <= limit:
            low, best = step, (candidate, optimum)
        else:
            high = step - 1
    return best
