"""Physically consistent link parameters of a fit, and the coefficients that they imply.

The programme itself is in `_nearest_bodies`.
"""

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, replace
from itertools import zip_longest
from typing import TYPE_CHECKING

import equinox as eqx
import numpy as np
from jaxtyping import Float

from .._display import html_rows
from .._environment import require
from .._text_table import counted
from ..least_squares import masked_rms, torque_of
from ..manipulator import TENSOR_ENTRIES, LinkParameters, Manipulator, seen_from
from ..network import CSLC
from ..recordings import Patterns
from ._body import bodies_of, body_of, constrained, link_of
from ._nearest_bodies import WEAK, Confidence, NearestBodies, by_discrepancy
from ._prior import Fitted, LinkKnowledge


if TYPE_CHECKING:
    import pandas


# The part of its prior that every body holds at least.
LEAST = 1e-3


class POSSIBILITY(eqx.Enumeration):
    """Outcome of the search for possible parameters; the members are the messages."""

    successful = ""
    inexact = (
        "The solver stopped before it reached its accuracy: the parameters are possible, but"
        " there may be nearer ones."
    )


_FAILED = "The solver failed to find possible parameters: check units, covariance and prior."


@dataclass(frozen=True, eq=False)
class PhysicalParameters:
    """Physically possible link parameters, and the coefficients that they imply.

    **Attributes**

    - `names`: of the coefficients.
    - `links`: one a joint, `fixed` bodies included: positive mass, positive definite
      pseudo-inertia, motor inertia of zero or more.
    - `links_without_fixed`: the same without the `fixed` bodies.
    - `bodies`: the latter in the frames of the robot's file: of its bodies in URDF and MJCF, of
      its links in TOML.
    - `body_names`: of the file's bodies, or the links' numbers.
    - `friction`: friction coefficients by kind, as `CSLC.coefficients_from` takes them.
    - `k`: (p,) the coefficients that all of these imply.
    - `prior_weight`: of the links that decide what the data do not.
    - `distance`: root mean square change of the determined coefficients against the fit, in
      standard errors.
    - `torque_distance`: (n,) root mean square change of each joint's torque over the patterns
      [N m or N]; NaN where no patterns were given.
    - `result`: a member of `POSSIBILITY`.

    >>> import jaxcslc as jc
    >>> network = jc.derive(jc.examples.pendulum())
    >>> patterns = jc.examples.swing(network, [0.5, 0.3, -0.1, 0.2, 0.05])
    >>> parameters = jc.physical_parameters(network, jc.LeastSquares().fit(network, patterns))
    >>> bool(parameters.links[0].mass > 0), parameters.to_pandas().shape[0]
    (True, 1)
    """

    names: tuple[str, ...]
    links: tuple[LinkParameters, ...]
    links_without_fixed: tuple[LinkParameters, ...]
    bodies: tuple[LinkParameters, ...]
    body_names: tuple[str, ...]
    friction: Mapping[str, Float[np.ndarray, "..."]]
    k: Float[np.ndarray, " coefficients"]
    prior_weight: float
    distance: float
    torque_distance: Float[np.ndarray, " joints"]
    result: POSSIBILITY

    @classmethod
    def of_bodies(
        cls,
        network: CSLC,
        bodies: Sequence[LinkParameters],
        k: Float[np.ndarray, " coefficients"],
        *,
        prior_weight: float,
        distance: float,
        torque_distance: Float[np.ndarray, " joints"],
    ) -> "PhysicalParameters":
        """Return the parameters of bodies that were computed before.

        **Arguments**

        - `network`: p coefficients, n joints.
        - `bodies`, `k`, `prior_weight`, `distance`, `torque_distance`: the attributes.

        **Raises** `ValueError` for another number of bodies, joints or coefficients.
        """
        robot, n = network.robot, network.joint_count
        for name, count, expected in (
            ("bodies", len(bodies), robot.joint_count),
            ("torque_distance", len(torque_distance), n),
            ("k", len(k), network.size),
        ):
            if count != expected:
                raise ValueError(f"{name}: expected {expected} entries, got {count}")
        source = robot.source
        placements = source.placements if source is not None and source.placements else None
        without_fixed = tuple(
            body if placements is None else seen_from(body, placements[i])
            for i, body in enumerate(bodies)
        )
        links = tuple(
            constrained(
                kind,
                body
                if carried is None
                else link_of(body_of(body) + body_of(carried), float(body.motor_inertia)),
            )
            for kind, body, carried in zip(
                robot.inertia,
                without_fixed,
                fixed_bodies(robot) or (None,) * robot.joint_count,
                strict=True,
            )
        )
        return cls(
            network.names,
            links,
            without_fixed,
            tuple(bodies),
            body_names(robot),
            _friction(network, k),
            k,
            prior_weight,
            distance,
            torque_distance,
            POSSIBILITY.successful,
        )

    def to_pandas(self) -> "pandas.DataFrame":
        """Return a table with one row per body, in the frames of the robot's file.

        Columns are mass, centre of gravity, the tensor there and motor inertia, in SI units.
        """
        pandas = require("pandas", "tables")

        numbers = not any(name for name in self.body_names if not name.isdigit())
        index = [int(name) for name in self.body_names] if numbers else list(self.body_names)
        return pandas.DataFrame(
            [_row(body) for body in self.bodies],
            index=pandas.Index(index, name="link" if numbers else "body"),
        )

    def __repr__(self) -> str:
        masses = ", ".join(f"{float(link.mass):.3g}" for link in self.links)
        torque = ", ".join(f"{value:.3g}" for value in self.torque_distance)
        measured = not np.all(np.isnan(self.torque_distance))
        change = f", torque changed by [{torque}]" if measured else ""
        return (
            f"PhysicalParameters({counted(len(self.links), 'link')} of [{masses}] kg,"
            f" {self.distance:.3g} standard errors from the fit{change})"
        )

    def _repr_html_(self) -> str:
        """Return a table of the bodies in SI units, for notebooks."""
        pairs = zip(self.body_names, self.bodies, strict=True)
        return html_rows(repr(self), [{"body": name} | _row(body) for name, body in pairs])


def physical_parameters(
    network: CSLC,
    fit: Fitted,
    prior: Sequence[LinkParameters] | None = None,
    *,
    fixed: Sequence[LinkParameters | None] | None = None,
    patterns: Patterns | None = None,
    motors: bool = True,
    confidence: Confidence | None = None,
    prior_weight: float | None = None,
    least: float = LEAST,
    knowledge: Sequence[LinkKnowledge] = (),
) -> PhysicalParameters:
    """Return the physically consistent masses, centres and inertia tensors nearest to a fit.

    Identified coefficients are combinations of link parameters, and may be combinations that no
    robot has. Every body has a positive definite pseudo-inertia matrix
    ∫ (x, 1)(x, 1)ᵀ dm, and every such matrix is a body's (Wensing, Kim and Slotine 2018); torque
    is linear in its entries. So the possible parameters nearest to a fit are the solution of a
    semidefinite programme (Sousa and Cortesão 2014): it minimises

        (k - k(θ))ᵀ C⁻¹ (k - k(θ)) + w² Σ |J̃ᵢ - 1|² + Σ w'² |other - prior|²

    where C is the fit's covariance, on the combinations that it determines, and J̃ᵢ is link i's
    pseudo-inertia in units of the prior's: with J₀ = L Lᵀ, J̃ = L⁻¹ J L⁻ᵀ. Its distance from 1 is
    the second-order part of the distances between bodies that depend on neither units nor frames
    (Lee, Wensing and Park 2020). Motor inertias and friction that is positive by construction are
    bounded by zero; they are the `other`, in units of their size.

    Links with zeros, equal moments or principal axes (`LinkInertia`) keep them. Principal axes
    make the problem bilinear: it is then solved by a bounded search that starts at the prior.
    Moments and masses that are listed as zero, which no body has, stay at the prior: the torque
    does not depend on them.

    **Arguments**

    - `network`: p coefficients.
    - `fit`: of `LeastSquares`; `k`, `covariance` and `undetermined` are used.
    - `prior`: links that decide what the data do not determine; `network.robot.links` if omitted,
      or else balls of equal mass between the joints. Impossible links are made possible first.
    - `fixed`: for each link a known body that is part of it, such as a gripper, or None. The link
      without it is possible too.
    - `patterns`: over which `torque_distance` is measured.
    - `motors`: whether joints have motor inertia where the network has it; False fixes it at zero,
      as for a file format without it.
    - `confidence`: errors of the prior, which then enters with its own weight.
    - `prior_weight`: w, how many standard errors a change of a body by its whole prior counts. If
      omitted, the largest up to 10 whose bodies are as near to the fit as errors of the data let
      the truth be (the discrepancy principle, Morozov 1966), or 0.01 where the prior is balls.
      Motor inertias that the prior lacks, and friction, have a weight of 0.01 at most.
    - `least`: every body holds at least this part of its prior: the eigenvalues of J̃ are no less.
    - `knowledge`: what is known of single parameters of links, from `Prior.link_values`.

    **Returns**

    - The parameters, and their distance from the fit.

    **Raises**

    - `ValueError`: for a number of links or coefficients that is not the network's, for a weight
      or part out of range, for a fit that is not finite, and for bodies fixed to links with
      principal axes.
    - `RuntimeError`: if the solver fails, as where no body has what is known of it.
    - `ImportError`: without the conic solver (the extra `inertia`), where it is needed.

    >>> import jaxcslc as jc
    >>> network = jc.derive(jc.examples.pendulum())
    >>> [c.expression for c in network.coefficients[:3]]
    ['Izz1 + Im1', '-g*m1*ry1', 'g*m1*rx1']
    >>> patterns = jc.examples.swing(network, [-0.1, 0.3, 0.0, 0.2, 0.05])  # inertia below zero
    >>> torque = patterns.torque + 0.1 * np.random.default_rng(0).normal(size=(1000, 1))
    >>> fit = jc.LeastSquares().fit(network, replace(patterns, torque=torque))
    >>> bool(fit.k[0] < 0), bool(jc.physical_parameters(network, fit).k[0] > 0)
    (True, True)
    """
    n = network.robot.joint_count
    for name, links in (("prior", prior), ("fixed", fixed)):
        if links is not None and len(links) != n:
            raise ValueError(f"{name}: expected {n} entries, one a joint, got {len(links)}")
    if prior_weight is not None and not 0 < prior_weight < np.inf:
        raise ValueError(f"prior_weight: expected a number above 0, got {prior_weight!r}")
    if not 0 < least < 1:
        raise ValueError(f"least: expected a number between 0 and 1, got {least!r}")
    problem = NearestBodies.from_fit(
        network,
        fit,
        prior=prior,
        fixed=fixed,
        weight=prior_weight or WEAK,
        motors=motors,
        knowledge=knowledge,
        confidence=confidence,
    )
    if prior_weight is None and confidence is None:
        problem, optimum = by_discrepancy(problem, least)
    else:
        optimum = problem.solve(least)
    if optimum is None:
        raise RuntimeError(f"physical_parameters: {_FAILED}")
    bodies, others, converged = optimum

    inertia = network.robot.inertia
    motor_mask = np.array([motors and kind.motor for kind in inertia], bool)
    motor_count = int(motor_mask.sum())
    motor_inertias = np.zeros(n)
    motor_inertias[motor_mask] = others[:motor_count]
    links = tuple(
        constrained(kind, link_of(body, float(motor)))
        for kind, body, motor in zip(inertia, bodies + problem.fixed, motor_inertias, strict=True)
    )
    without_fixed = tuple(
        link_of(body, float(motor))
        for body, motor in zip(bodies_of(links) - problem.fixed, motor_inertias, strict=True)
    )
    k = np.einsum("ple,le->p", problem.body_columns, bodies_of(links))
    k += problem.other_columns @ (others / problem.scales)
    return PhysicalParameters(
        network.names,
        links,
        without_fixed,
        in_file_frames(network.robot, without_fixed),
        body_names(network.robot),
        _friction(network, k),
        k,
        problem.weight,
        problem.distance(k),
        _torque_distance(network, k - problem.k, patterns),
        POSSIBILITY.successful if converged else POSSIBILITY.inexact,
    )


def distances_from(
    fit: Fitted,
    network: CSLC,
    parameters: PhysicalParameters,
    patterns: Patterns,
) -> PhysicalParameters:
    """Return parameters with their distances from another fit than they were computed from.

    - `patterns`: motion (samples, n) that `torque_distance` is measured over.
    """
    problem = NearestBodies.from_fit(
        network, fit, fixed=fixed_bodies(network.robot), weight=parameters.prior_weight
    )
    return replace(
        parameters,
        distance=problem.distance(parameters.k),
        torque_distance=_torque_distance(network, parameters.k - problem.k, patterns),
    )


def possible_coefficients(
    network: CSLC,
    fit: Fitted,
    fixed: Sequence[LinkParameters | None] | None,
    knowledge: Sequence[LinkKnowledge],
    prior_weight: float,
    prior: Sequence[LinkParameters] | None = None,
    confidence: Confidence | None = None,
) -> Float[np.ndarray, " coefficients"]:
    """Return the coefficients of `physical_parameters`, without the parameters.

    **Raises** as `physical_parameters`.
    """
    problem = NearestBodies.from_fit(
        network,
        fit,
        fixed=fixed,
        weight=prior_weight,
        knowledge=knowledge,
        confidence=confidence,
        prior=prior,
    )
    optimum = problem.solve(LEAST)
    if optimum is None:
        raise RuntimeError(f"physically consistent parameters: {_FAILED}")
    return problem.coefficients(optimum)


def fixed_bodies(robot: Manipulator) -> tuple[LinkParameters | None, ...] | None:
    """Return the bodies that the robot's file has fixed to its links; None if there are none.

    They are the `fixed` argument of `physical_parameters`.
    """
    carried = robot.source.carried if robot.source is not None else ()
    return carried if any(body is not None for body in carried) else None


def in_file_frames(
    robot: Manipulator, links: Sequence[LinkParameters]
) -> tuple[LinkParameters, ...]:
    """Links in the frames that the robot's file has for them."""
    if robot.source is None or not robot.source.placements:
        return tuple(links)
    placements = robot.source.placements
    return tuple(
        seen_from(link, np.linalg.inv(pose)) for link, pose in zip(links, placements, strict=True)
    )


def file_bodies(robot: Manipulator) -> tuple[LinkParameters, ...] | None:
    """Return the bodies of the robot's file as `PhysicalParameters.bodies` has them; None without.

    They are in the file's frames, without what the file fixes to them.
    """
    if robot.links is None:
        return None
    carried = () if robot.source is None else robot.source.carried
    links = [
        link
        if other is None or float(link.mass) <= float(other.mass)
        else link_of(body_of(link) - body_of(other), float(link.motor_inertia))
        for link, other in zip_longest(robot.links, carried)
    ]
    return in_file_frames(robot, links)


def body_names(robot: Manipulator) -> tuple[str, ...]:
    """Return the names of the bodies in the robot's file.

    Without names, they are the numbers of links, from 1.
    """
    names = robot.source.links if robot.source is not None else ()
    if len(names) == robot.joint_count and all(names):
        return names
    return tuple(str(i) for i in range(1, robot.joint_count + 1))


def _friction(
    network: CSLC, k: Float[np.ndarray, " coefficients"]
) -> dict[str, Float[np.ndarray, "..."]]:
    """The coefficients beside the inertial ones, as the arguments of `coefficients_from`."""
    tables: dict[str, np.ndarray] = {}
    for term in network.input_terms:
        table = tables.setdefault(term.keyword, np.zeros(term.value_shape))
        table[term.value_index] = k[network.layout.term_slice(term)]
    return tables


def _torque_distance(
    network: CSLC, change: Float[np.ndarray, " coefficients"], patterns: Patterns | None
) -> Float[np.ndarray, " joints"]:
    """Root mean square torque of a change of coefficients over the patterns of the mask."""
    if patterns is None:
        return np.full(network.joint_count, np.nan)
    return masked_rms(torque_of(network, patterns, change), np.asarray(patterns.mask))


def _row(link: LinkParameters) -> dict[str, float]:
    centre, tensor = np.asarray(link.centre_of_gravity), np.asarray(link.inertia)
    row = {"mass": float(link.mass)}
    row |= {f"r{axis}": float(value) for axis, value in zip("xyz", centre, strict=True)}
    for a, b in TENSOR_ENTRIES:
        row[f"I{'xyz'[a]}{'xyz'[b]}"] = float(tensor[a, b])
    return row | {"motor_inertia": float(link.motor_inertia)}
