"""The robot's file as prior: its inertial parameters as a normal distribution of coefficients.

A file knows masses to some 20 %, and centres and inertias in proportion. `FilePrior` states that
in terms of coefficients, `chosen_prior` weighs it against the data, and `with_knowledge` adds it
to a fit.
"""

import dataclasses
from collections.abc import Mapping
from functools import cached_property
from itertools import compress
from typing import Any, NamedTuple

import numpy as np
import scipy
from jaxtyping import Bool, Float

from ..least_squares import Identification, LeastSquares
from ..manipulator import LinkParameters
from ..network import CSLC
from ..recordings import Patterns
from ._body import MASS, body_map, body_of_pseudo_inertia, pseudo_inertia
from ._misfit import misfit_of
from ._nearest_bodies import Confidence, balls, ends_of, prior_of, reach_of
from ._physical_parameters import body_names
from ._prior import KnownRows, with_knowledge


WIDTH = 0.2
"""Standard deviation of a file's masses, as part of them.

It was at or near the best held-out error on four real arms; see `docs/uncertainty.md`.
"""

DECIDED = 0.5
"""Share from which on a coefficient is the file's more than the data's."""

# A body may be spread by this part of the arm's reach further than the file says: centres of thin
# links are not known better than those of others.
_SPREAD = 0.1
# Radii of gyration are known better than masses, by this factor: a wrong density changes mass and
# inertia together.
_SHAPE = 0.5
# Deviations of a motor inertia that the file has, as part of it; and of one that it lacks, in
# moments of inertia of what the joint carries.
_MOTOR, _NO_MOTOR = 1.0, 3.0
# Of links whose inertia is obviously invented, such as one mass for all: wider by this factor.
_INVENTED = 3.0
# A mass is contradicted where data that determine half of it or more move it by this factor.
_OTHER_MASS, _HALF = 1.65, 0.5
# Mass is spread no further from its centre than to the next joint and this part of the reach.
_WIDEST_SPREAD = 0.3
# A link is wider where data move it this many times further than its width explains.
_FAR = 2.0
# Part of the recordings, of arms whose files are as wrong as files usually are, that may say that a
# link contradicts the data.
_CHANCE = 0.05
_ROUNDS = 10
# Links that data determine fewer combinations of contradict nothing.
_FEWEST = 0.5
# Links are no wider than this: it says nothing of them any more.
_WIDEST = 30.0
# A prior that must not be felt is wider than itself by this factor: what it weighs is a millionth.
_LOOSE = 1e3
# Relative eigenvalues of the prior's covariance below this are rounding.
_ROUNDING = 1e-12
# Masses and moments that agree to this part are the same number.
_DIGITS = 1e-6
# A link this much lighter than the median of the others has no mass in the file.
_MASSLESS = 1e-3


class Deviations(NamedTuple):
    """Deviations of the data from a file, one per link.

    - `sizes`: 0 where data are silent.
    - `limits`: beyond which the size is by a chance of `_CHANCE` for all links together, if the
      file's errors are what the prior says.
    """

    sizes: Float[np.ndarray, " links"]
    limits: Float[np.ndarray, " links"]

    @property
    def beyond_chance(self) -> Bool[np.ndarray, " links"]:
        """True for links that data contradict."""
        return np.abs(self.sizes) > self.limits


@dataclasses.dataclass(frozen=True, eq=False)
class FilePrior:
    """Inertial parameters of a robot's file as a normal distribution of coefficients.

    Changes of a link are in units of itself. A change of 0.2 is one of all of it by 20 %, as by
    another density. It is one of the centre in proportion to the radius of gyration, and one of
    the shape by half as much. Friction is not known by files.

    **Attributes**

    - `coefficients`: names of the p coefficients.
    - `mean`: (p,) coefficients that the file implies; 0 of friction.
    - `changes`: (n, 10, 10) ten independent changes of each link, by the whole of it, as columns;
      the first is the link itself.
    - `links`: (n, p, 10) what these changes do.
    - `bodies`: links of the file, guessed where it has none.
    - `motor_errors`: (n,) standard deviation of each motor inertia.
    - `motors`: (p, n) what one standard deviation of each motor inertia does.
    - `inertial`: (p,) true for coefficients that the file knows something of.
    - `offset_errors`: (p,) standard deviation of each torque offset about zero; 0 of all other
      coefficients, and of offsets of which nothing is known.
    - `widths`: (n,) standard deviation of each link, as a part of it.
    - `correlation`: times that errors of a fit exceed those of independent samples, as variances.
    - `bias`: (p,) systematic error of a fit by smoothing; None where there is none.
    - `names`: of links; `guessed`, `invented`: links without inertia, and with the inertia of
      another link; `implausible`: with mass further out than the link is long, which is cut off.

    >>> import jaxcslc as jc
    >>> from jaxcslc.bodies import FilePrior
    >>> FilePrior.of(jc.derive(jc.examples.pendulum())) is None  # no masses in its description
    True
    """

    coefficients: tuple[str, ...]
    mean: Float[np.ndarray, " coefficients"]
    changes: Float[np.ndarray, "links 10 10"]
    links: Float[np.ndarray, "links coefficients 10"]
    bodies: tuple[LinkParameters, ...]
    motor_errors: Float[np.ndarray, " links"]
    motors: Float[np.ndarray, "coefficients links"]
    inertial: Bool[np.ndarray, " coefficients"]
    offset_errors: Float[np.ndarray, " coefficients"]
    widths: Float[np.ndarray, " links"]
    names: tuple[str, ...]
    guessed: tuple[str, ...] = ()
    invented: tuple[str, ...] = ()
    implausible: tuple[str, ...] = ()
    correlation: float = 1.0
    bias: Float[np.ndarray, " coefficients"] | None = None

    @classmethod
    def of(cls, network: CSLC) -> "FilePrior | None":
        """Return the prior of the usual width; None if the robot's file has no inertia."""
        robot = network.robot
        if robot.links is None or any(inertia.has_known for inertia in robot.inertia):
            return None
        names = body_names(robot)
        masses = np.array([float(link.mass) for link in robot.links])
        if not np.any(masses > 0.0):
            return None
        usual = float(np.median(masses[masses > 0.0]))
        massless = masses < _MASSLESS * usual
        reach = reach_of(robot)
        lenders = balls(robot, usual)
        links = [
            lender if missing else link
            for link, lender, missing in zip(robot.links, lenders, massless, strict=True)
        ]
        spread = _SPREAD * reach
        limits = ends_of(robot) + _WIDEST_SPREAD * reach
        compact = [_compact(link, limit) for link, limit in zip(links, limits, strict=True)]
        implausible = np.array([new is not old for new, old in zip(compact, links, strict=True)])
        links = compact
        prior = prior_of(robot, links, lenders, np.zeros((len(links), 10)))
        of_bodies, of_motors = body_map(network.algebra)
        inertial, p = network.layout.inertial, network.size
        changes = np.stack([_changes(body, spread) for body in prior.bodies])
        of_changes = np.zeros((len(links), p, 10))
        of_changes[:, inertial] = np.einsum("ple,lec->lpc", of_bodies, changes)
        mean, motors = np.zeros(p), np.zeros((p, len(links)))
        mean[inertial] = np.einsum("ple,le->p", of_bodies, prior.bodies) + of_motors @ prior.motors
        errors = _motor_errors(network, prior.bodies, prior.motors)
        motors[inertial] = of_motors * errors
        known = np.zeros(p, bool)
        known[inertial] = True
        invented = _invented(prior.bodies) & ~massless
        widths = WIDTH * np.where(massless | invented | implausible, _INVENTED, 1.0)
        return cls(
            network.names,
            mean,
            changes,
            of_changes,
            tuple(links),
            errors,
            motors,
            known,
            np.zeros(p),
            widths,
            names,
            tuple(compress(names, massless)),
            tuple(compress(names, invented)),
            tuple(compress(names, implausible)),
        )

    def scaled(self, factor: float) -> "FilePrior":
        """Return the prior with all standard deviations multiplied."""
        return dataclasses.replace(
            self,
            widths=self.widths * factor,
            motor_errors=self.motor_errors * factor,
            motors=self.motors * factor,
        )

    def as_tie_break(self, widths: Mapping[str, float]) -> "FilePrior":
        """Return the prior for a fit that contains it already: it decides only what no coefficient
        shows.

        - `widths`: by link, those of `FileWeight`.
        """
        known = zip(self.names, self.widths.tolist(), strict=True)
        of_links = np.array([widths.get(name, width) for name, width in known])
        return dataclasses.replace(self, widths=of_links).scaled(_LOOSE)

    def of_fit(
        self,
        network: CSLC,
        fit: Identification,
        bias: Float[np.ndarray, " coefficients"] | None = None,
    ) -> "FilePrior":
        """Return the prior of what a fit shows to be known of errors: their correlation, and sizes
        of torque offsets.

        An offset is a zero error of a drive or a sensor. It is of the size of the joint's dry
        friction or, where that is small, of its torque error. The prior tells offsets from gravity
        where the motion does not.

        - `network`: of the fit.
        - `fit`: without the prior.
        - `bias`: its systematic error by smoothing; None without. Where it exceeds the noise, as
          of short movements, the file would be overruled by it.
        """
        errors = np.zeros(len(fit.names))
        size = np.asarray(fit.torque_error)
        for joint, (offset, dry) in _offsets_and_dry(network).items():
            errors[offset] = np.hypot(size[joint], 0.0 if dry is None else float(fit.k[dry]))
        prior = self.of_names(fit.names)
        return dataclasses.replace(
            prior, offset_errors=errors, correlation=correlation_of(fit), bias=bias
        )

    @property
    def confidence(self) -> Confidence:
        """Errors of the file's bodies, as the programme of nearest bodies has them."""
        changes = self.changes * (self.widths / WIDTH)[:, None, None]
        return Confidence(changes, self.motor_errors, self.offset_errors, WIDTH, self.rows)

    @property
    def covariance(self) -> Float[np.ndarray, "coefficients coefficients"]:
        """Covariance of the coefficients; 0 of those that the file does not know."""
        roots = self.links * self.widths[:, None, None]
        bodies = np.einsum("lpc,lqc->pq", roots, roots) + self.motors @ self.motors.T
        return bodies + np.diag(self.offset_errors**2)

    def of_names(self, names: tuple[str, ...]) -> "FilePrior":
        """Return the prior of a network of other friction, by the names of its coefficients."""
        size, p = len(names), min(len(names), len(self.mean))
        mean, inertial = np.zeros(size), np.zeros(size, bool)
        mean[:p], inertial[:p] = self.mean[:p], self.inertial[:p]
        links = np.zeros((len(self.links), size, 10))
        links[:, :p] = self.links[:, :p]
        motors = np.zeros((size, len(self.links)))
        motors[:p] = self.motors[:p]
        offsets = dict(zip(self.coefficients, self.offset_errors.tolist(), strict=True))
        bias = self.bias
        if bias is not None:
            of_names = dict(zip(self.coefficients, bias.tolist(), strict=True))
            bias = np.array([of_names.get(name, 0.0) for name in names])
        return dataclasses.replace(
            self,
            coefficients=names,
            mean=mean,
            links=links,
            motors=motors,
            inertial=inertial,
            offset_errors=np.array([offsets.get(name, 0.0) for name in names]),
            bias=bias,
        )

    @cached_property
    def rows(self) -> KnownRows:
        """The prior as equations of coefficients, in units of their standard error."""
        covariance = self.covariance
        sizes = np.sqrt(np.diag(covariance))
        some = np.flatnonzero(sizes > 0.0)
        sizes = sizes[some]
        values, vectors = np.linalg.eigh(covariance[np.ix_(some, some)] / np.outer(sizes, sizes))
        kept = values > _ROUNDING * values[-1:]
        matrix = np.zeros((int(np.sum(kept)), len(self.mean)))
        matrix[:, some] = vectors[:, kept].T / np.sqrt(values[kept])[:, None] / sizes
        return KnownRows(matrix, matrix @ self.mean, self.correlation, self.bias)

    def share(self, fit: Identification) -> Float[np.ndarray, " coefficients"]:
        """Return how much of each coefficient is the file's, from 0 to 1.

        It is what a coefficient follows a change of its value in the file by, where all others
        stay: the diagonal of the resolution matrix (Backus and Gilbert 1968), and 0 of friction.

        - `fit`: without the prior.
        """
        follow = np.eye(len(self.mean)) - self.data_share(fit)
        return np.where(self.inertial, np.clip(np.diag(follow), 0.0, 1.0), 0.0)

    def data_share(self, fit: Identification) -> Float[np.ndarray, "coefficients coefficients"]:
        """Return what coefficients change by with those of a fit without the prior."""
        precision = self.rows.matrix.T @ self.rows.matrix
        return np.eye(len(self.mean)) - self._posterior(fit) @ precision

    def _posterior(self, fit: Identification) -> Float[np.ndarray, "coefficients coefficients"]:
        """Covariance of coefficients under the prior, errors of the fit as if independent."""
        rows = self.rows
        white = rows.rows_of(fit)
        total = white.T @ white + rows.matrix.T @ rows.matrix
        sizes = np.sqrt(np.diag(total))
        sizes = np.where(sizes > 0.0, sizes, 1.0)
        inverse = np.linalg.pinv(total / np.outer(sizes, sizes), hermitian=True)
        return inverse / np.outer(sizes, sizes)

    def _told(
        self, fit: Identification
    ) -> tuple[Float[np.ndarray, " coefficients"], Float[np.ndarray, "coefficients coefficients"]]:
        """Return how far data move coefficients, in units of the prior's precision, and how much of
        this precision they replace."""
        precision = self.rows.matrix.T @ self.rows.matrix
        change = np.asarray(with_knowledge(fit, {}, self.rows).k) - self.mean
        return precision @ change, precision - precision @ self._posterior(fit) @ precision

    def deviations(self, fit: Identification) -> "Deviations":
        """Return how far data move each link, over what its width explains; 0 if they do not.

        The root of the squared deviation over the number of combinations that data determine, as
        widths are estimated from them (MacKay 1992).

        - `fit`: without the prior.
        """
        precise, told = self._told(fit)
        sizes, limits = np.zeros((2, len(self.widths)))
        for i, (link, width) in enumerate(zip(self.links, self.widths, strict=True)):
            root = width * link
            deviation = root.T @ precise
            # Its covariance, if the prior is right.
            covariance = root.T @ told @ root
            number = float(np.trace(covariance))
            if number > _FEWEST:
                sizes[i] = np.sqrt(float(deviation @ deviation) / number)
                # The sum of squares is nearly a chi-square of so many (Satterthwaite 1946).
                freedom = number**2 / float(np.sum(covariance**2))
                level = 1.0 - _CHANCE / len(self.widths)
                limits[i] = np.sqrt(scipy.stats.chi2.ppf(level, freedom) / freedom)
        return Deviations(sizes, limits)

    def mass_factors(self, fit: Identification) -> "Deviations":
        """Return logarithms of the factors of each link's mass, and of all, that the data ask for.

        They are 0 where data are silent.

        - `fit`: without the prior.
        """
        precise, told = self._told(fit)
        # What scaling a link does, in independent changes of its width.
        wholes = np.zeros((len(self.widths), 10))
        wholes[:, 0] = 1.0 / self.widths
        single = np.eye(len(wholes))[:, :, None] * wholes
        directions = (*single, wholes)
        quantile = float(scipy.stats.norm.isf(0.5 * _CHANCE / len(directions)))
        factors, limits = np.zeros((2, len(directions)))
        roots = self.links * self.widths[:, None, None]
        for i, direction in enumerate(directions):
            length = float(np.sum(direction**2))
            along = np.einsum("lpc,lc->p", roots, direction) / np.sqrt(length)
            share = float(along @ told @ along)
            if share > _HALF:
                factor = 1.0 + float(along @ precise) / np.sqrt(length) / share
                factors[i] = np.log(max(factor, 1.0 / _WIDEST))
                limits[i] = quantile / np.sqrt(length * share)
        return Deviations(factors, limits)

    def widened(self, fit: Identification) -> tuple["FilePrior", tuple[str, ...]]:
        """Return the prior, wider for links that data may contradict, and the names of those that
        they contradict beyond chance.

        - `fit`: without the prior.
        """
        masses = self.mass_factors(fit)
        other = np.abs(masses.sizes) > np.log(_OTHER_MASS)
        certain = other & masses.beyond_chance
        named = certain[:-1] | bool(certain[-1])
        wider = np.where(
            other[:-1] | bool(other[-1]),
            np.maximum(np.abs(np.expm1(masses.sizes[:-1])), _INVENTED * WIDTH),
            0.0,
        )
        prior = dataclasses.replace(self, widths=np.maximum(self.widths, wider))
        for _ in range(_ROUNDS):
            deviations = prior.deviations(fit)
            far = deviations.sizes > _FAR
            if not np.any(far):
                break
            named |= far & deviations.beyond_chance
            wider = np.where(far, prior.widths * deviations.sizes, prior.widths)
            prior = dataclasses.replace(prior, widths=np.minimum(wider, _WIDEST))
            if np.all(prior.widths[far] >= _WIDEST):
                break
        return prior, tuple(compress(self.names, named))


@dataclasses.dataclass(frozen=True, eq=False)
class FileWeight:
    """Share of the robot's file in a fit.

    **Attributes**

    - `share`: (p,) part of each coefficient that is the file's, from 0 to 1.
    - `widths`: by link, standard deviation that its inertial parameters were given, as a part of
      them.
    - `misfit`: times that errors of the fit, as variances, exceed those that its residuals show.
    - `contradicted`: links that the data move further than a file is usually wrong by.
    - `guessed`: links without inertia in the file; `invented`: links whose inertia is that of
      another link too; `implausible`: links with mass further out than they are long.

    >>> import numpy as np
    >>> from jaxcslc.bodies import FileWeight
    >>> print(FileWeight(np.array([0.1, 0.9]), {"arm": 0.2}, 1.0))
    robot's file: prior of its inertial parameters, masses to 20 %; it decides 1 of 2 coefficients
    """

    share: Float[np.ndarray, " coefficients"]
    widths: Mapping[str, float]
    misfit: float
    contradicted: tuple[str, ...] = ()
    guessed: tuple[str, ...] = ()
    invented: tuple[str, ...] = ()
    implausible: tuple[str, ...] = ()

    @property
    def width(self) -> float:
        """The width of links that nothing is said against."""
        return min(self.widths.values())

    @property
    def decided(self) -> int:
        """The number of coefficients that are the file's more than the data's."""
        return int(np.sum(self.share > DECIDED))

    @property
    def warnings(self) -> tuple[str, ...]:
        """Sentences about links that the data contradict, or that the file lacks."""
        texts: list[str] = []
        for names, what in (
            (
                self.contradicted,
                "the motion contradicts the masses, centres or inertias of the robot's file. They"
                " have little weight. Check the file, a tool or a payload that it lacks",
            ),
            (
                self.guessed,
                "the robot's file has no mass. A ball of the usual mass was assumed, at three times"
                " the usual error",
            ),
            (
                self.implausible,
                "the inertia of the robot's file has mass further out than the link is long. It was"
                " reduced",
            ),
        ):
            if names:
                texts.append(f"{', '.join(names)}: {what}")
        return tuple(texts)

    def document(self) -> dict[str, Any]:
        """Return the entries of a report's file, as plain data."""
        return {
            "share": self.share,
            "widths": dict(self.widths),
            "misfit": self.misfit,
            "contradicted": list(self.contradicted),
            "guessed": list(self.guessed),
            "invented": list(self.invented),
            "implausible": list(self.implausible),
        }

    def __str__(self) -> str:
        return (
            f"robot's file: prior of its inertial parameters, masses to {100 * self.width:.3g} %;"
            f" it decides {self.decided} of {len(self.share)} coefficients"
        )


class ChosenPrior(NamedTuple):
    """The robot's file as prior of a fit, and how much of the fit it is."""

    prior: FilePrior
    weight: FileWeight

    def of_fit(self, fit: Identification, *, smoothed: bool = True) -> "ChosenPrior":
        """Return the prior of another fit without it, of the same robot.

        Coefficients that are not inertial may differ.

        - `smoothed`: whether the fit has the bias of smoothing.
        """
        prior = self.prior.of_names(fit.names)
        correlation = self.weight.misfit * correlation_of(fit)
        bias = prior.bias if smoothed else None
        prior = dataclasses.replace(prior, correlation=correlation, bias=bias)
        return ChosenPrior(prior, dataclasses.replace(self.weight, share=prior.share(fit)))


def chosen_prior(
    network: CSLC,
    patterns: Patterns,
    solver: LeastSquares,
    fit: Identification,
    bias: Float[np.ndarray, " coefficients"] | None = None,
) -> ChosenPrior | None:
    """Return the robot's file as prior of a fit; None if the file has none.

    Its weight follows from the misfit of both (`misfit_of`), and from what the data contradict.

    - `patterns`: that the fit is of, or a part of them.
    - `fit`: of `solver`, without the prior; `bias`: as of `FilePrior.of_fit`.
    """
    prior = FilePrior.of(network)
    if prior is None:
        return None
    prior = prior.of_fit(network, fit, bias)
    misfit = misfit_of(network, patterns, solver, fit, prior.rows)
    prior = dataclasses.replace(
        prior.scaled(np.sqrt(misfit.prior)), correlation=misfit.data * prior.correlation
    )
    prior, contradicted = prior.widened(fit)
    widths = dict(zip(prior.names, prior.widths.tolist(), strict=True))
    weight = FileWeight(
        *(prior.share(fit), widths, misfit.data, contradicted),
        *(prior.guessed, prior.invented, prior.implausible),
    )
    return ChosenPrior(prior, weight)


def correlation_of(fit: Identification) -> float:
    """Return how many times the variances of a fit exceed those of independent errors.

    The median of the determined coefficients; at least 1.
    """
    known = np.asarray(fit.determined)
    errors = np.diag(np.asarray(fit.covariance))[known]
    independent = np.diag(np.asarray(fit.independent_covariance))[known]
    some = independent > 0.0
    return max(float(np.median(errors[some] / independent[some])), 1.0) if np.any(some) else 1.0


def _offsets_and_dry(network: CSLC) -> dict[int, tuple[int, int | None]]:
    """Return, by joint from 0, the indices of its torque offset and of its dry friction."""
    indices: dict[str, dict[int, int]] = {}
    for kind in ("offset", "dry"):
        joints = [j for j, kinds in enumerate(network.friction_per_joint) if kind in kinds]
        of_kind = network.layout.indices(kind).tolist() if joints else []
        indices[kind] = dict(zip(joints, of_kind, strict=True))
    return {j: (offset, indices["dry"].get(j)) for j, offset in indices["offset"].items()}


def _compact(link: LinkParameters, limit: float) -> LinkParameters:
    """Return a link whose mass is spread no further than the limit [m]; itself if it is not."""
    mass, tensor = float(link.mass), np.asarray(link.inertia, float)
    values, vectors = np.linalg.eigh(np.trace(tensor) / 2 * np.eye(3) - tensor)
    if mass <= 0.0 or values[-1] <= mass * limit**2:
        return link
    values = np.minimum(values, mass * limit**2)
    spread = (vectors * values) @ vectors.T
    smaller = np.trace(spread) * np.eye(3) - spread
    return LinkParameters(mass, link.centre_of_gravity, smaller, link.motor_inertia)


def _changes(body: Float[np.ndarray, "10"], spread: float) -> Float[np.ndarray, "10 10"]:
    """Return ten independent changes of a body by the whole of it, as columns.

    With J = L Lᵀ its pseudo-inertia, changes L E Lᵀ depend on neither units nor frames (Lee,
    Wensing and Park 2020). The factor L separates the centre from the spread about it.

    - `spread`: what the radius of gyration may be larger by [m].
    """
    matrix = pseudo_inertia(body)
    mass, centre = matrix[3, 3], matrix[:3, 3] / matrix[3, 3]
    about = matrix[:3, :3] - mass * np.outer(centre, centre) + mass * spread**2 * np.eye(3)
    scale = np.sqrt(mass) * np.eye(4)
    scale[:3, :3], scale[:3, 3] = np.linalg.cholesky(about), np.sqrt(mass) * centre
    columns = [body]
    for a in range(4):
        for b in range(min(a + 1, 3)):
            entries = np.zeros((4, 4))
            entries[a, b] = entries[b, a] = 1.0 if a == b else np.sqrt(0.5)
            change = body_of_pseudo_inertia(scale @ entries @ scale.T)
            columns.append(change if a == 3 else _SHAPE * change)
    return np.stack(columns, axis=1)


def _motor_errors(
    network: CSLC, bodies: Float[np.ndarray, "links 10"], motors: Float[np.ndarray, " links"]
) -> Float[np.ndarray, " links"]:
    """Standard deviations of motor inertias: of what the file has, or of what joints carry."""
    parents = network.robot.parents
    carried = np.max(bodies[:, :3], axis=1)
    slides = np.array([kind == "P" for kind in network.robot.kinds])
    carried = np.where(slides, bodies[:, MASS], carried)
    for child in reversed(range(len(parents))):
        if parents[child] >= 0:
            carried[parents[child]] += carried[child]
    return np.where(motors > 0.0, _MOTOR * motors, _NO_MOTOR * carried)


def _invented(bodies: Float[np.ndarray, "links 10"]) -> Bool[np.ndarray, " links"]:
    """Links whose mass, and inertia about the centre, another link has too, digit for digit."""
    shapes = np.array([[body[MASS], *_central(body)] for body in bodies])
    alike = np.all(np.abs(shapes[:, None] - shapes) <= _DIGITS * np.abs(shapes), axis=-1)
    return np.sum(alike, axis=1) > 1


def _central(body: Float[np.ndarray, "10"]) -> Float[np.ndarray, " moments"]:
    """Principal moments of the spread about the centre."""
    matrix = pseudo_inertia(body)
    return np.linalg.eigvalsh(
        matrix[:3, :3] - np.outer(matrix[:3, 3], matrix[:3, 3]) / matrix[3, 3]
    )
