"""Requests to `identify`, and the one table of what is not combined.

Each row of `EXCLUSIONS` names features and holds the text of the error. What an estimator can be
combined with, it declares itself (`AbstractEstimator.supports`). `check_request` is called once,
before any work.
"""

import dataclasses
from collections.abc import Callable, Mapping
from typing import Any, Literal, NamedTuple, get_args

import numpy as np

from .._environment import ExplainedError
from ..bodies import Choice, Prior
from ..least_squares import Previous, Settings
from ..likelihood import MaximumLikelihood
from ..network import CSLC
from ..recordings import Recording
from ..selection import PRE_SLIDING


@dataclasses.dataclass(frozen=True, eq=False)
class Request:
    """Arguments of `identify`, as one record.

    - `network`: with the friction that is fitted, once that is chosen.
    - `training`: by name.
    - `estimator`: its name; `supports`: features that it can be combined with.
    """

    network: CSLC
    training: Mapping[str, Recording]
    validation: Recording | None = None
    settings: Settings | None = None
    estimator: str = "least-squares"
    supports: frozenset[str] = frozenset()
    likelihood: MaximumLikelihood | None = None
    offsets: bool = False
    previous: Previous | None = None
    groups: tuple[str, ...] | None = None
    friction: Literal["auto", "offset"] | None = None
    options: Mapping[str, Any] = dataclasses.field(default_factory=dict)
    folds: int | None = None
    checks: bool = True
    systematic: bool = True
    possible: Choice = "auto"
    prior: Prior | None = None
    file_prior: bool = True
    memory: float = 2.0
    simulate: bool = False

    @property
    def longest(self) -> str:
        """The name of the longest training recording."""
        return max(self.training, key=lambda name: self.training[name].samples)

    @property
    def has_file_prior(self) -> bool:
        """Return whether inertial parameters of the robot's file are a prior."""
        known = self.network.robot.links is not None
        return self.file_prior and known and self.previous is None

    @property
    def load_kinds(self) -> str:
        """Kinds of friction that follows the load, in words."""
        return " and ".join(repr(term.kind) for term in self.network.load_terms)

    @property
    def likelihood_options(self) -> MaximumLikelihood:
        """Options of maximum likelihood."""
        return self.likelihood or MaximumLikelihood()


# Features that estimators may support.
PREVIOUS, OFFSETS, SEVERAL, BODIES, LIKELIHOOD, LOAD_FRICTION = (
    "previous",
    "offsets",
    "several recordings",
    "physically consistent parameters",
    "options of maximum likelihood",
    "friction of the load",
)

FEATURES: Mapping[str, Callable[[Request], bool]] = {
    PREVIOUS: lambda r: r.previous is not None,
    OFFSETS: lambda r: r.offsets,
    SEVERAL: lambda r: len(r.training) > 1,
    BODIES: lambda r: r.possible == "always",
    LIKELIHOOD: lambda r: r.likelihood is not None,
    LOAD_FRICTION: lambda r: bool(r.network.load_terms),
    # It is not asked for, but tried where no row excludes it.
    PRE_SLIDING: lambda r: False,
    "recordings": lambda r: bool(r.training),
    "groups": lambda r: r.groups is not None,
    "chosen friction": lambda r: r.friction is not None,
    "no bodies": lambda r: r.possible == "never",
    "prior": lambda r: r.prior is not None,
    "prior of links": lambda r: r.prior is not None and bool(r.prior.links),
    "prior of the likelihood": lambda r: r.likelihood_options.prior is not None,
    "bodies of the likelihood": lambda r: r.likelihood_options.possible,
    "distances": lambda r: bool(r.likelihood_options.presliding_distance),
    "simulation": lambda r: r.simulate,
    "known masses": lambda r: any(inertia.has_known for inertia in r.network.robot.inertia),
    "dry friction": lambda r: any("dry" in kinds for kinds in r.network.friction_per_joint),
}
"""Features by name: whether a request has them."""


class Exclusion(NamedTuple):
    """Features that are not combined.

    - `features`: names in `FEATURES`; after `"not "`, of one that a request lacks; after
      `"unsupported "`, of one that it has and that its estimator does not support.
    - `text`: of the error, a format of the request `r`.
    - `page`: of the documentation that explains it.
    """

    features: tuple[str, ...]
    text: str
    page: str = "choose"


EXCLUSIONS = (
    Exclusion(("not recordings",), "identify: got no recording; expected one or more"),
    Exclusion(
        ("known masses",),
        "identify: {r.network.name!r} has known masses or centres of gravity in its algebra,"
        " which only LeastSquares.fit supports; state them as [links] of the prior instead",
    ),
    *(
        Exclusion(
            features,
            "groups and previous (--reidentify and --previous): got one of them; expected both or"
            " neither",
        )
        for features in ((PREVIOUS, "not groups"), ("groups", f"not {PREVIOUS}"))
    ),
    *(
        Exclusion((PREVIOUS, feature), f"{name} cannot be combined with previous=")
        for feature, name in (
            ("chosen friction", "friction={r.friction!r}"),
            (BODIES, 'possible="always"'),
            ("prior", "prior="),
        )
    ),
    Exclusion(
        ("no bodies", "prior of links"),
        'a prior with [links] needs possible="auto" or "always" (--physical)',
        page="uncertainty",
    ),
    Exclusion(
        ("bodies of the likelihood",),
        "likelihood: for physically consistent parameters, use possible='always' of identify",
    ),
    Exclusion(
        (f"unsupported {LIKELIHOOD}",),
        "estimator {r.estimator!r}: takes no options of maximum likelihood (likelihood=)",
    ),
    *(
        Exclusion(
            (f"unsupported {feature}",),
            f"estimator {{r.estimator!r}}: cannot be combined with {feature}; expected"
            " least-squares",
        )
        for feature in (PREVIOUS, OFFSETS)
    ),
    Exclusion(
        (f"unsupported {SEVERAL}",),
        "estimator {r.estimator!r}: expected one recording, got {recordings}",
    ),
    Exclusion(
        (f"unsupported {BODIES}",),
        "estimator {r.estimator!r}: cannot be combined with possible='always'",
    ),
    Exclusion((PREVIOUS, SEVERAL), "identify: previous= expects one recording, got several"),
    Exclusion(
        (OFFSETS, f"not {SEVERAL}"),
        "identify: offsets= expects several recordings; for one use the friction term 'offset'",
    ),
    *(
        Exclusion(
            features, f"identify: friction of kind {{r.load_kinds}} cannot be combined with {what}"
        )
        for features, what in (
            ((f"unsupported {LOAD_FRICTION}",), "the estimator {r.estimator!r}"),
            ((LOAD_FRICTION, SEVERAL), "several recordings in one fit"),
            ((LOAD_FRICTION, "simulation"), "simulation without feedback"),
        )
    ),
    *(
        Exclusion((PRE_SLIDING, feature), why)
        for feature, why in (
            (SEVERAL, "several recordings are fitted together"),
            (f"unsupported {PRE_SLIDING}", "the estimator {r.estimator!r} does not support it"),
            ("distances", "its distances are given"),
            ("prior", "coefficients are known beforehand"),
            ("prior of the likelihood", "coefficients are known beforehand"),
            ("not dry friction", "no joint has friction of kind 'dry'"),
        )
    ),
)
"""Features that are not combined, in the order in which it is looked for."""


def check_request(request: Request) -> None:
    """Check what is asked of `identify`.

    **Raises** `ValueError`: a choice that there is not, features that are not combined, a
    validation recording that is fitted, too, or a prior that is not of the network.
    """
    if request.friction not in ("auto", "offset", None):
        raise ValueError(
            f"friction: expected 'auto', 'offset' or None, got {request.friction!r}; None keeps"
            " the network's terms"
        )
    if request.possible not in get_args(Choice):
        raise ValueError(
            f"possible: expected {', '.join(get_args(Choice))}, got {request.possible!r}"
        )
    for row in EXCLUSIONS:
        if all(_has(request, name) for name in row.features):
            raise ExplainedError(_text(row, request), row.page)
    judged = request.validation
    for name, fitted in request.training.items() if judged is not None else ():
        if all(
            np.array_equal(getattr(fitted, what), getattr(judged, what))
            for what in ("position", "torque")
        ):
            raise ValueError(
                f"validation: the same samples as {name}, which is fitted; expected another"
                " recording, or none"
            )
    if request.prior is not None:
        request.prior.coefficient_values(request.network)
        request.prior.link_values(request.network.robot)


def excluded(request: Request, feature: str) -> str | None:
    """Return why a request cannot have a feature besides those that it has; None if it can."""
    for row in EXCLUSIONS:
        named = any(name.endswith(feature) for name in row.features)
        if named and all(_has(request, name, feature) for name in row.features):
            return _text(row, request)
    return None


def _has(request: Request, name: str, besides: str | None = None) -> bool:
    """Return whether a request has a feature of a row, `besides` counting as one that it has."""
    word, _, feature = name.partition(" ")
    if word == "not":
        return not _has(request, feature, besides)
    if word == "unsupported":
        return feature not in request.supports and _has(request, feature, besides)
    return name == besides or FEATURES[name](request)


def _text(row: Exclusion, request: Request) -> str:
    return row.text.format(r=request, recordings=len(request.training))
