"""Comparison of physically consistent bodies with the unconstrained fit, on held-out motion.

`judged_bodies` is what `identify` calls. It decides whose coefficients the report has.
"""

import dataclasses
import html
from collections.abc import Callable, Mapping, Sequence
from typing import Any, Literal, NamedTuple

import numpy as np
from jaxtyping import Array, Bool, Float

from .._display import html_of
from .._environment import MissingExtraError
from ..least_squares import (
    FoldFit,
    HostColumns,
    Identification,
    columns_of,
    torque_by,
)
from ..network import CSLC
from ..recordings import Patterns
from ..uncertainty import (
    HeldOut,
    RelativeError,
    Source,
    SystematicError,
    fold_numbers,
    judged_errors,
    standard_uncertainty,
)
from ._file_prior import FilePrior
from ._physical_parameters import (
    PhysicalParameters,
    distances_from,
    fixed_bodies,
    physical_parameters,
    possible_coefficients,
)
from ._prior import LinkKnowledge, Prior


# A coefficient that moves by more combined standard errors is warned of: one in sixteen thousand
# normal errors does.
_FAR = 4.0
# A mass that is this many times the file's, or this part of it, is not the link's own.
_OTHER_MASS = 2.0
# Coefficients that a warning names of each body.
_MOST_NAMES = 3


def movement_of(
    fit: Identification, parameters: PhysicalParameters, systematic: SystematicError | None
) -> Float[np.ndarray, " coefficients"]:
    """Compute how far each coefficient moves, in standard errors, systematic ones included.

    It is zero where the motion does not determine the coefficient.
    """
    error = standard_uncertainty(fit, systematic)
    change = parameters.k - np.asarray(fit.k)
    known = np.isfinite(error) & (error > 0.0)
    return np.where(known, change / np.where(known, error, 1.0), 0.0)


def moved_bodies(
    network: CSLC,
    fit: Identification,
    parameters: PhysicalParameters,
    systematic: SystematicError | None = None,
    *,
    motors: bool = True,
) -> tuple[str, ...]:
    """Return a sentence about bodies whose coefficients are those of no body, and what to do; or
    none.

    - `systematic`: of the fit.
    - `motors`: whether motor inertia was allowed for.
    """
    movement = movement_of(fit, parameters, systematic)
    far: dict[int, list[int]] = {}
    for index, coefficient in enumerate(network.algebra.coefficients):
        if abs(movement[index]) > _FAR:
            # Base parameters are named after the first link; later ones are what it carries.
            link = min(addend.term.link for addend in coefficient.addends)
            far.setdefault(link, []).append(index)
    if not far:
        return ()
    bodies: list[str] = []
    for link, indices in sorted(far.items()):
        indices.sort(key=lambda i: -abs(movement[i]))
        names = ", ".join(network.names[i] for i in indices[:_MOST_NAMES])
        more = "" if len(indices) <= _MOST_NAMES else f" and {len(indices) - _MOST_NAMES} more"
        name = parameters.body_names[link]
        name = f"link {name}" if name.isdigit() else name
        bodies.append(f"{name} by {abs(movement[indices[0]]):.3g} standard errors ({names}{more})")
    without_motor = [
        name
        for name, inertia in zip(network.robot.joint_names, network.robot.inertia, strict=True)
        if not (motors and inertia.motor)
    ]
    remedies = [
        "record motion that excites these links more",
        "say what is known of them with --prior",
        "add the friction terms that the residuals show",
    ]
    if without_motor:
        remedies.insert(0, f"let {', '.join(without_motor)} have a motor inertia")
    return (
        "physically consistent parameters: these links differ from the fit by more than its errors"
        f" explain: {'; '.join(bodies)}. The fit is not physically consistent there:"
        f" {', '.join(remedies)}",
    )


def other_masses(network: CSLC, parameters: PhysicalParameters) -> tuple[str, ...]:
    """Return a sentence about masses that compensate each other far from the file's, or none.

    Written into a robot's file they surprise: the torque that they give is right, but they are not
    those of the links.
    """
    links = network.robot.links
    if links is None:
        return ()
    texts: list[str] = []
    for name, link, file in zip(parameters.body_names, parameters.links, links, strict=True):
        mass, expected = float(link.mass), float(file.mass)
        if expected > 0.0 and not expected / _OTHER_MASS < mass < expected * _OTHER_MASS:
            named = f"link {name}" if name.isdigit() else name
            texts.append(f"{named} {mass:.3g} kg instead of {expected:.3g}")
    if not texts:
        return ()
    return (
        f"physically consistent parameters: masses far from the robot's file: {', '.join(texts)}."
        " They give the identified torques, but motion of the joints determines only combinations"
        " of masses, centres and motor inertias. State what is known with --prior: motor inertias"
        " first, where the file has none",
    )


Choice = Literal["auto", "always", "never"]
# Bodies are used if at most one in five such gains is chance. True coefficients are those of
# bodies, which speaks for them beforehand. Those of a KR300, which stretches of the training motion
# preferred by 1.6 standard errors, predicted other motion a fifth better than the fit; on no
# recording of a real arm were they worse.
_CHANCE = 0.2


class JudgedPart(NamedTuple):
    """A stretch of motion, or a recording, and the fit of all others.

    - `support`: the coefficients that each joint's torque depends on.
    - `columns`: of the part's regressor, for each joint those of its support.
    - `torque`, `mask`: of the part.
    - `fit`: of the others, whose coefficients need not be those of physically consistent bodies.
    - `base`: the same without the robot's file as prior; `fit` if None.
    """

    support: tuple[tuple[int, ...], ...]
    columns: HostColumns
    torque: Float[np.ndarray, "samples joints"]
    mask: Bool[np.ndarray, "samples joints"]
    fit: Identification | FoldFit
    base: Identification | FoldFit | None = None

    @classmethod
    def of(cls, network: CSLC, patterns: Patterns, fit: Identification | FoldFit) -> "JudgedPart":
        """Return patterns, all of which a fit was not made from, as one part."""
        columns = columns_of(network, patterns)
        torque, mask = np.asarray(patterns.torque), np.asarray(patterns.mask)
        return cls(network.support, columns, torque, mask, fit)

    def stretches(self, fits: Sequence[Identification | FoldFit]) -> tuple["JudgedPart", ...]:
        """Cut the part into stretches of equal length, with a fit for each."""
        fold = fold_numbers(len(self.torque), len(fits))
        ends = np.searchsorted(fold, np.arange(len(fits) + 1)).tolist()
        return tuple(
            JudgedPart(
                self.support,
                tuple(of_joint[:, start:end] for of_joint in self.columns),
                self.torque[start:end],
                self.mask[start:end],
                fit,
            )
            for start, end, fit in zip(ends, ends[1:], fits, strict=False)
        )

    def errors(
        self, k: Float[Array | np.ndarray, " coefficients"]
    ) -> Float[np.ndarray, "samples joints"]:
        """Compute the residual torque that coefficients leave in this part."""
        return self.torque - torque_by(self.support, self.columns, np.asarray(k))


class InformedFit(NamedTuple):
    """A fit, and what the robot's file adds to it.

    - `fit`: with the file as prior, if there is one.
    - `base`: the same without it; `fit` if None.
    - `file`: the robot's file as prior; None where it is no prior.
    """

    fit: Identification
    base: Identification | None = None
    file: FilePrior | None = None


@dataclasses.dataclass(frozen=True, eq=False)
class PossibleFit:
    """Physically consistent bodies and the fit that they are nearest to, judged on held-out motion.

    **Attributes**

    - `parameters`: of the bodies.
    - `free`: the fit, whose coefficients need not be those of physically consistent bodies.
    - `held_out`: errors of the bodies' coefficients on parts of the motion that were held out in
      turn.
    - `free_held_out`: the same of the fit's.
    - `change`: mean over parts and joints of the logarithm of the ratio of the two errors, the
      bodies' over the fit's; -0.1 is an error that is a tenth smaller.
    - `change_error`: the standard error of `change`, from its spread over the parts.
    - `used`: whether the bodies' coefficients are those of the report.
    - `movement`: (p,) change of each coefficient in standard errors, systematic errors included;
      zero where the motion does not determine it.
    - `warnings`: about bodies that are far from the fit, a sentence each.

    >>> import jaxcslc as jc
    >>> network = jc.derive(jc.examples.pendulum())
    >>> recording = jc.examples.swing_recording(network, [0.5, 0.3, -0.1, 0.2, 0.05])
    >>> possible = jc.identify(network, recording, settings=jc.Settings()).possible
    >>> possible.used, bool(possible.parameters.bodies[0].mass > 0)
    (False, True)
    """

    parameters: PhysicalParameters
    free: Identification
    held_out: HeldOut
    free_held_out: HeldOut
    change: float
    change_error: float
    used: bool
    movement: Float[np.ndarray, " coefficients"]
    warnings: tuple[str, ...] = ()

    @property
    def fit(self) -> Identification:
        """The fit to use: with the bodies' coefficients, if they are used.

        Standard errors are those of the unconstrained fit, as an upper bound: true coefficients are
        those of bodies, a convex set, and what is nearest in it to a fit is no further from the
        truth than the fit, measured by the fit's covariance.
        """
        if not self.used:
            return self.free
        return self.free.with_k(self.parameters.k)

    @property
    def other_coefficients(self) -> dict[str, Float[Array | np.ndarray, " coefficients"]]:
        """The coefficients that are not used, by name: `"unconstrained"` or
        `"consistent"`."""
        if self.used:
            return {"unconstrained": self.free.k}
        return {"consistent": self.parameters.k}

    def document(self) -> dict[str, Any]:
        """Return the entries of a report's file, as plain data."""
        links = zip(self.parameters.body_names, self.parameters.bodies, strict=True)
        return {
            "used": self.used,
            "k": self.parameters.k,
            "free_k": np.asarray(self.free.k),
            "distance": self.parameters.distance,
            "prior_weight": self.parameters.prior_weight,
            "held_out": self.held_out.source,
            "held_out_rms": self.held_out.held_out,
            "free_held_out_rms": self.free_held_out.held_out,
            "change": self.change,
            "change_error": self.change_error,
            "movement": self.movement,
            "bodies": [
                {
                    "name": name,
                    "mass": body.mass,
                    "centre_of_gravity": body.centre_of_gravity,
                    "inertia": body.inertia,
                    "motor_inertia": body.motor_inertia,
                }
                for name, body in links
            ],
        }

    def __repr__(self) -> str:
        used = "physically consistent" if self.used else "unconstrained"
        change = RelativeError(self.change, self.change_error, 0)
        return f"PossibleFit({used} coefficients used; held-out error {change}; {self.parameters})"

    def _repr_html_(self) -> str:
        """Return a table of the bodies, for notebooks."""
        return f"<p>{html.escape(repr(self))}</p>{html_of(self.parameters)}"

    def __str__(self) -> str:
        return possible_text(self.document())


def possible_text(document: Mapping[str, Any]) -> str:
    """Return what a report says of physically consistent bodies.

    **Arguments**

    - `document`: a `PossibleFit.document`.
    """
    rms = (np.array(document[name], float) for name in ("held_out_rms", "free_held_out_rms"))
    ratio = ", ".join(f"{value:.3g}" for value in np.divide(*rms))
    relative = RelativeError(document["change"], document["change_error"], 0)
    return (
        f"physically consistent parameters: {document['held_out']} RMS over that of the"
        f" unconstrained fit, per joint: {ratio}; on average {relative}. Used:"
        f" {'physically consistent' if document['used'] else 'unconstrained'} coefficients\n   "
        f" distance from the unconstrained fit: {document['distance']:.3g} standard errors (root"
        " mean square, independent residuals)"
    )


def possible_fit(
    network: CSLC,
    informed: InformedFit,
    training: Patterns,
    parts: Sequence[JudgedPart],
    *,
    source: Source = "cross-validation",
    systematic: SystematicError | None = None,
    always: bool = False,
    knowledge: Sequence[LinkKnowledge] = (),
    parameters: PhysicalParameters | None = None,
    step: Callable[[str], None] = lambda _: None,
) -> PossibleFit:
    """Return the consistent bodies nearest to a fit, and whether they predict torque better than it
    does.

    Both are judged on the same parts of the motion, each predicted by fits to the others, one with
    and one without consistent bodies. The bodies are used where the mean logarithm of the ratio of
    their errors is below zero by more than the spread over parts explains (Student's t, one-sided,
    20 %), and by 1 % at least.

    - `parts`: two or more, of which `training` consists; `source`: what they are.
    - `systematic`: of the fit, for the errors that movements are counted in.
    - `parameters`: bodies that an estimator has fitted itself; those nearest to the fit if None.

    **Raises** as `physical_parameters`.
    """
    fit, base, file = informed
    step("fitting physically consistent parameters")
    fixed = fixed_bodies(network.robot)
    if parameters is None:
        parameters = physical_parameters(
            network,
            fit if base is None else base,
            None if file is None else file.bodies,
            fixed=fixed,
            patterns=training,
            knowledge=knowledge,
            confidence=None if file is None else file.confidence,
        )
    else:
        parameters = distances_from(fit, network, parameters, training)
    step("testing physically consistent parameters")
    free_errors = [part.errors(part.fit.k) for part in parts]
    # The weight of the whole fit's bodies, found once: searched for in each part, it would cost
    # four times as much.
    weight = parameters.prior_weight
    coefficients: dict[int, np.ndarray] = {}  # several parts may be of one fit
    for part in parts:
        if id(part.fit) not in coefficients:
            coefficients[id(part.fit)] = possible_coefficients(
                network,
                part.fit if part.base is None else part.base,
                fixed,
                knowledge,
                weight,
                None if file is None else file.bodies,
                None if file is None else file.confidence,
            )
    errors = [part.errors(coefficients[id(part.fit)]) for part in parts]
    masks = [part.mask for part in parts]
    relative = RelativeError.of(errors, free_errors, masks)
    held_out = held_out_of_parts(network, fit, parameters.k, parts, source, errors)
    free_held_out = held_out_of_parts(network, fit, fit.k, parts, source, free_errors)
    return PossibleFit(
        parameters,
        fit,
        held_out,
        free_held_out,
        relative.change,
        relative.change_error,
        always or relative.beyond_chance(_CHANCE),
        movement_of(fit, parameters, systematic),
        moved_bodies(network, fit, parameters, systematic),
    )


def judged_bodies(
    network: CSLC,
    informed: InformedFit,
    training: Patterns,
    parts: Callable[[], Sequence[JudgedPart]],
    *,
    choice: Choice,
    prior: Prior | None,
    source: Source = "cross-validation",
    systematic: SystematicError | None = None,
    parameters: PhysicalParameters | None = None,
    step: Callable[[str], None] = lambda _: None,
) -> tuple[PossibleFit | None, HeldOut | None, tuple[str, ...]]:
    """Return consistent bodies, held-out errors of the coefficients to use, and warnings.

    Bodies are None if they were not asked for or, with `"auto"`, could not be computed; errors are
    None if nothing made parts necessary.

    - `parts`: fits without them know what `prior` and the robot's file say.

    **Raises** as `possible_fit`, except for `"auto"`.
    """
    prior = prior or Prior()
    known = prior.coefficient_values(network)
    if choice == "never" and not known and informed.file is None:
        return None, None, ()
    judged = parts()
    always = choice == "always" or bool(prior.links)
    warnings: tuple[str, ...] = ()
    if choice != "never":
        try:
            bodies = possible_fit(
                network,
                informed,
                training,
                judged,
                source=source,
                systematic=systematic,
                always=always,
                knowledge=prior.link_values(network.robot),
                parameters=parameters,
                step=step,
            )
        except (ValueError, RuntimeError, MissingExtraError) as error:
            if always:
                raise
            warnings = (f"physically consistent parameters were not computed: {error}",)
        else:
            held_out = bodies.held_out if bodies.used else bodies.free_held_out
            return bodies, held_out, bodies.warnings
    fit = informed.fit
    return None, held_out_of_parts(network, fit, fit.k, judged, source), warnings


def held_out_of_parts(
    network: CSLC,
    fit: Identification,
    k: Float[Array | np.ndarray, " coefficients"],
    parts: Sequence[JudgedPart],
    source: Source,
    errors: Sequence[np.ndarray] | None = None,
) -> HeldOut:
    """Compute held-out errors of coefficients `k`; training errors are those of `k` on all parts.

    - `errors`: of fits without each part; those of `JudgedPart.fit` if None.
    """
    if errors is None:
        errors = [part.errors(part.fit.k) for part in parts]
    mask = np.concatenate([part.mask for part in parts])
    training = np.concatenate([part.errors(k) for part in parts])
    return judged_errors(
        *(training, mask, np.concatenate(errors), mask, int(fit.rank)),
        network=network,
        source=source,
    )
