"""Knowledge before an identification: of coefficients, and of single parameters of links.

`Prior` is read from TOML files. `linear_knowledge` turns what is known of links into equations of
the programme in `_nearest_bodies`; `with_knowledge` adds what is known of coefficients to a fit.
"""

import dataclasses
import math
from collections.abc import Callable, Iterator, Mapping, Sequence
from pathlib import Path
from typing import Any, NamedTuple, Protocol, overload, runtime_checkable

import equinox as eqx
import jax.numpy as jnp
import numpy as np
import scipy
from jaxtyping import Array, Float, Int

from .._plain_data import toml_document
from .._rank import null_vectors, pseudo_inverse
from ..least_squares import RESULTS, FoldFit, Identification
from ..manipulator import Manipulator
from ..network import AbstractLinearNetwork
from ._body import MASS, MOMENT


KNOWN_PARAMETERS = ("mass", "rx", "ry", "rz", "motor_inertia")
"""Parameters of a link that equations linear in a body's ten numbers can fix or bound."""


@dataclasses.dataclass(frozen=True)
class Known:
    """Knowledge of a number: a value with its standard error, and bounds.

    **Attributes**

    - `value`: None if only bounds are known.
    - `error`: standard error of the value; with 0, the default, the number is fixed.
    - `low`, `high`: bounds; infinite where there is none.

    **Raises**

    - `ValueError`: neither a value nor a bound, a negative error, an error without a value, or
      bounds that leave no room for the value.

    >>> from jaxcslc.bodies import Known
    >>> print(Known(2.4, 0.1)), print(Known(0.5)), print(Known(low=0.0))
    2.4 ± 0.1
    fixed at 0.5
    at least 0
    (None, None, None)
    """

    value: float | None = None
    error: float = 0.0
    low: float = -math.inf
    high: float = math.inf

    def __post_init__(self) -> None:
        bounded = self.low > -math.inf or self.high < math.inf
        if self.value is None and not bounded:
            raise ValueError("expected a value or a bound")
        if not 0.0 <= self.error < math.inf:
            raise ValueError(f"error: expected 0 or more, got {self.error}")
        if self.value is None and self.error:
            raise ValueError("error: expected a value that it is of")
        if not self.low < self.high:
            raise ValueError(f"low: expected less than high, got {self.low} and {self.high}")
        if self.value is not None and not self.low <= self.value <= self.high:
            raise ValueError(f"value: expected a number {self._bounds}, got {self.value}")

    @property
    def fixed(self) -> bool:
        """True if the number is a value without error."""
        return self.value is not None and self.error == 0.0

    @property
    def is_value(self) -> bool:
        """True if there is a value and no bound."""
        return self.value is not None and self._bounds == ""

    def document(self) -> dict[str, float]:
        """Return the entries that are set, as plain data."""
        entries = {"value": self.value, "low": self.low, "high": self.high}
        known = {k: v for k, v in entries.items() if v is not None and math.isfinite(v)}
        return known | ({"error": self.error} if self.error else {})

    def __str__(self) -> str:
        if self.value is None:
            return self._bounds
        value = f"fixed at {self.value:g}" if self.fixed else f"{self.value:g} ± {self.error:g}"
        return f"{value}, {self._bounds}" if self._bounds else value

    @property
    def _bounds(self) -> str:
        if self.low == -math.inf:
            return "" if self.high == math.inf else f"at most {self.high:g}"
        least = f"at least {self.low:g}"
        return least if self.high == math.inf else f"from {self.low:g} to {self.high:g}"


class LinkKnowledge(NamedTuple):
    """Knowledge of one parameter of a link.

    - `link`: its number, from 0.
    - `parameter`: one of `KNOWN_PARAMETERS`.
    - `known`: its value, error and bounds.
    """

    link: int
    parameter: str
    known: Known


class LinearKnowledge(NamedTuple):
    """Equations and inequalities in the unknowns of a programme.

    - `soft`, `target`: rows that should equal the target, in units of their standard error.
    - `rows`, `values`: rows that do equal the values.
    - `above`, `least`: rows that are no less than `least`.
    """

    soft: Float[np.ndarray, "soft unknowns"]
    target: Float[np.ndarray, " soft"]
    rows: Float[np.ndarray, "fixed unknowns"]
    values: Float[np.ndarray, " fixed"]
    above: Float[np.ndarray, "bounds unknowns"]
    least: Float[np.ndarray, " bounds"]


def linear_knowledge(
    knowledge: Sequence[LinkKnowledge],
    row_of: Callable[[LinkKnowledge, float], Float[np.ndarray, " unknowns"]],
    masses: Float[np.ndarray, " links"],
    unknowns: int,
) -> LinearKnowledge:
    """Equations of all that is known.

    - `row_of`: the row whose product with the unknowns is the parameter less a value, of a centre
      of gravity times the mass; the value's share is in its last entry, behind the unknowns.
    - `masses`: of the links, which make errors of centres of gravity those of first moments.
    """
    soft, rows, above = ([np.zeros((0, unknowns + 1))] for _ in range(3))
    for entry in knowledge:
        known = entry.known
        if known.value is not None:
            row = row_of(entry, known.value)[None]
            if known.fixed:
                rows.append(row)
            else:
                size = masses[entry.link] if entry.parameter.startswith("r") else 1.0
                soft.append(row / (known.error * size))
        if known.low > -math.inf:
            above.append(row_of(entry, known.low)[None])
        if known.high < math.inf:
            above.append(-row_of(entry, known.high)[None])
    parts = [np.concatenate(part) for part in (soft, rows, above)]
    return LinearKnowledge(*(array for part in parts for array in (part[:, :-1], -part[:, -1])))


def body_form(
    parameter: str, value: float, placement: Float[np.ndarray, "4 4"]
) -> Float[np.ndarray, "10"]:
    """The form in a body's ten numbers that vanishes if a coordinate of its centre has a value.

    - `parameter`: `"rx"`, `"ry"` or `"rz"`, in the frame that `placement` has in the link's.
    """
    axis = "xyz".index(parameter[1])
    rotation, origin = placement[:3, :3], placement[:3, 3]
    form = np.zeros(10)
    # The first moment in the other frame is Rᵀ(h - m p).
    form[MOMENT] = rotation[:, axis]
    form[MASS] = -rotation[:, axis] @ origin - value
    return form


@dataclasses.dataclass(frozen=True)
class Prior:
    """Knowledge of a robot before it is identified: of coefficients, and of its links.

    **Attributes**

    - `coefficients`: `Known` values by the names that the network gives them.
    - `links`: by link, `Known` values of `mass` [kg], of the centre of gravity `rx`, `ry`, `rz` [m]
      and of `motor_inertia` [kg m² or kg]. A link is named by its body or joint in the robot's
      file, or by its number from 1. Centres are in the frames of the file's bodies, which are
      meant without what the file fixes to them.

    What is known of links changes bodies, not the unconstrained fit: a coefficient is a combination
    of many links' parameters.

    **Raises**

    - `ValueError`: a parameter of a link that is none of these.

    >>> import jaxcslc as jc
    >>> from jaxcslc.bodies import Known, Prior
    >>> prior = Prior({"kv1": Known(2.0, 0.1)}, {"3": {"mass": Known(low=1.0, high=4.0)}})
    >>> print(prior)
    kv1 2 ± 0.1; link 3: mass from 1 to 4
    """

    coefficients: Mapping[str, Known] = dataclasses.field(default_factory=dict[str, Known])
    links: Mapping[str, Mapping[str, Known]] = dataclasses.field(
        default_factory=dict[str, Mapping[str, Known]]
    )

    def __post_init__(self) -> None:
        for link, parameters in self.links.items():
            for name in parameters:
                if name not in KNOWN_PARAMETERS:
                    raise ValueError(
                        f"prior, links, {link}: unknown parameter {name!r}; expected some of"
                        f" {', '.join(KNOWN_PARAMETERS)}"
                    )

    def coefficient_values(self, network: AbstractLinearNetwork) -> dict[int, Known]:
        """Return the knowledge of coefficients, by index.

        **Raises**

        - `ValueError`: a name that no coefficient has.
        """
        for name in self.coefficients:
            if name not in network.names:
                raise ValueError(
                    f"prior, coefficients: {network.name!r} has no {name!r}; expected some of"
                    f" {network.names[0]} to {network.names[-1]} (jaxcslc derive lists them)"
                )
        return {network.names.index(name): known for name, known in self.coefficients.items()}

    def link_values(self, robot: Manipulator) -> tuple[LinkKnowledge, ...]:
        """Return the knowledge of links, in the order of the joints.

        **Raises**

        - `ValueError`: a name that no link has, or a motor inertia of a joint that has none.
        """
        bodies = robot.source.links if robot.source is not None else ()
        entries: list[LinkKnowledge] = []
        for name, parameters in self.links.items():
            candidates = [
                index
                for index in range(robot.joint_count)
                if name == str(index + 1)
                or (index < len(bodies) and name == bodies[index])
                or name == robot.joint_names[index]
            ]
            if len(candidates) != 1:
                names = bodies or robot.joint_names
                raise ValueError(
                    f"prior, links: {name!r} names {len(candidates) or 'no'} link"
                    f"{'s' if candidates else ''} of {robot.name!r}; expected one of"
                    f" {', '.join(names)}, or a number from 1 to {robot.joint_count}"
                )
            for parameter, known in parameters.items():
                if parameter == "motor_inertia" and not robot.inertia[candidates[0]].motor:
                    raise ValueError(
                        f"prior, links, {name}: motor_inertia is known, and {robot.name!r} has none"
                        " at this joint"
                    )
                entries.append(LinkKnowledge(candidates[0], parameter, known))
        return tuple(entries)

    def document(self) -> dict[str, Any]:
        """Return the knowledge as plain data, as `load_prior` reads it."""
        return {
            "coefficients": {name: known.document() for name, known in self.coefficients.items()},
            "links": {
                link: {name: known.document() for name, known in parameters.items()}
                for link, parameters in self.links.items()
            },
        }

    def __str__(self) -> str:
        return "; ".join(self._parts()) or "nothing"

    def _parts(self) -> Iterator[str]:
        if self.coefficients:
            yield ", ".join(f"{name} {known}" for name, known in self.coefficients.items())
        for link, parameters in self.links.items():
            listed = ", ".join(f"{name} {known}" for name, known in parameters.items())
            yield f"{'link ' if link.isdigit() else ''}{link}: {listed}"


def load_prior(path: str | Path) -> Prior:
    """Read what is known before an identification from a TOML file.

    Tables `[coefficients]` and `[links.NAME]`, see `Prior`. An entry is a number, which is fixed;
    or `{ value = 2.4, error = 0.1 }`, a value and its standard error; or `{ low = 0, high = 3 }`,
    either of which may be left out; or all of them.

    **Arguments**

    - `path`: of the file.

    **Returns** a `Prior`.

    **Raises**

    - `ValueError`: the file holds something else; the message names file and entry.

    >>> import tempfile
    >>> from jaxcslc.bodies import load_prior
    >>> with tempfile.TemporaryDirectory() as folder:
    ...     path = Path(folder) / "priors.toml"
    ...     _ = path.write_text("[links.3]\\nmass = { value = 2.4, error = 0.1 }\\n")
    ...     print(load_prior(path))
    link 3: mass 2.4 ± 0.1
    """
    path = Path(path)
    return prior_from(toml_document(path, "file of priors", ValueError), str(path))


def prior_from(document: Mapping[str, Any], where: str) -> Prior:
    """Return what is known before, from tables as `Prior.document` returns them, read at `where`.

    **Raises** `ValueError`: they hold something else; the message names the entry.
    """
    if unknown := sorted(document.keys() - {"coefficients", "links"}):
        raise ValueError(f"{where}: unknown entry {unknown[0]!r}; expected coefficients or links")
    coefficients = _known_values(document.get("coefficients", {}), f"{where}, coefficients")
    tables = _table(document.get("links", {}), f"{where}, links")
    links = {
        name: _known_values(values, f"{where}, links, {name}") for name, values in tables.items()
    }
    try:
        return Prior(coefficients, links)
    except ValueError as error:
        raise ValueError(f"{where}: {error}") from None


def _known_values(values: Any, where: str) -> dict[str, Known]:
    return {
        name: _known(value, f"{where}, {name}") for name, value in _table(values, where).items()
    }


def _table(value: Any, where: str) -> dict[str, Any]:
    if not isinstance(value, dict):
        raise ValueError(f"{where}: expected a table, got {value!r}")
    return value


def _known(value: Any, where: str) -> Known:
    entries = value if isinstance(value, dict) else {"value": value}
    if unknown := sorted(entries.keys() - {"value", "error", "low", "high"}):
        raise ValueError(f"{where}: unknown entry {unknown[0]!r}; expected value, error, low, high")
    for name, number in entries.items():
        usable = isinstance(number, int | float) and not isinstance(number, bool)
        if not usable or not abs(number) <= _LARGEST:
            raise ValueError(
                f"{where}: {name}: expected a finite number up to {_LARGEST:g}, got {number!r}"
            )
        if name == "error" and 0 < number < 1 / _LARGEST:
            raise ValueError(
                f"{where}: error: expected {1 / _LARGEST:g} or more, got {number!r}; without an"
                " error the value is fixed"
            )
    try:
        return Known(**{name: float(number) for name, number in entries.items()})
    except (OverflowError, ValueError) as error:
        raise ValueError(f"{where}: {error}") from None


# In SI units no robot's numbers come near; beyond, squares of them make solvers overflow.
_LARGEST = 1e12
# A coefficient that shares this part of a unit null vector is not determined by itself.
_SHARE = 1e-6
# Singular values below this part of the largest are rounding of the fit's covariance.
_SMALLEST = 1e-9
# Noise-free coefficients have a covariance of rounding. Standard errors are taken as no less than
# this part of the coefficient (of that which an average body would cause): finer is beyond solvers.
FINEST = 1e-6


@runtime_checkable
class Fitted(Protocol):
    """Coefficients and their uncertainty: what an `Identification` and its file share."""

    @property
    def k(self) -> Float[Array | np.ndarray, " coefficients"]: ...
    @property
    def covariance(self) -> Float[Array | np.ndarray, "coefficients coefficients"]: ...
    @property
    def undetermined(self) -> Float[Array | np.ndarray, "rows coefficients"]: ...


class KnownRows(NamedTuple):
    """Knowledge of combinations of coefficients, in units of its standard error.

    - `matrix`, `target`: `matrix @ k` should equal the target.
    - `correlation`: times that errors of a fit exceed those of independent samples, as variances,
      where it is weighed against this knowledge.
    - `bias`: (p,) systematic error of a fit, of either sign and of this size by one standard
      deviation, where it is weighed; None without.
    """

    matrix: Float[np.ndarray, "rows coefficients"]
    target: Float[np.ndarray, " rows"]
    correlation: float
    bias: Float[np.ndarray, " coefficients"] | None = None

    def rows_of(self, fit: Fitted) -> Float[np.ndarray, "rank coefficients"]:
        """Return the rows of a fit (`information_rows`) that have the weight of its errors."""
        white = information_rows(fit, np.asarray(fit.k, float)) / np.sqrt(self.correlation)
        return _with_bias(white, self.bias)


@overload
def with_knowledge(
    fit: Identification, known: Mapping[int, Known], rows: KnownRows | None = None
) -> Identification: ...
@overload
def with_knowledge(
    fit: FoldFit, known: Mapping[int, Known], rows: KnownRows | None = None
) -> FoldFit: ...
def with_knowledge(
    fit: Identification | FoldFit, known: Mapping[int, Known], rows: KnownRows | None = None
) -> Identification | FoldFit:
    """Add prior knowledge of coefficients to a fit.

    Least squares with a row more for each value, in units of its error. The equations of the
    recording enter by the fit and its covariance for independent errors, which say of them all that
    least squares need to know. So the new coefficients minimise

        (k - k₀)ᵀ C⁻¹ (k - k₀) + Σ ((kᵢ - valueᵢ) / errorᵢ)²

    where k₀ and C are the fit's, C⁻¹ on the combinations that it determines; fixed coefficients
    have their values, and bounds hold. Where nothing determines a combination, the change of the
    fit is the least one, coefficients in units of their size. Standard errors follow what the fit's
    errors and those of the values do to the result; at bounds that are reached they are those
    without bounds.

    **Arguments**

    - `fit`: an `Identification` or a fit without a fold.
    - `known`: by index of a coefficient.
    - `rows`: what is known of combinations, as by the robot's file.

    **Returns** a fit of the same kind.
    """
    if not known and rows is None:
        return fit
    k = np.asarray(fit.k, float)
    fixed = np.array([i for i, entry in known.items() if entry.fixed], int)
    free = np.setdiff1d(np.arange(len(k)), fixed)
    values = np.array([known[i].value for i in fixed], float)
    white = information_rows(fit, k) if rows is None else rows.rows_of(fit)
    soft = [(i, entry) for i, entry in known.items() if entry.error > 0.0]
    prior = np.zeros((len(soft), len(k)))
    target = np.zeros(len(soft))
    for row, (i, entry) in enumerate(soft):
        prior[row, i] = 1.0 / entry.error
        target[row] = float(entry.value or 0.0) / entry.error
    if rows is not None:
        prior = np.concatenate([prior, rows.matrix])
        target = np.concatenate([target, rows.target])
    start = k.copy()
    start[fixed] = values
    matrix = np.concatenate([white, prior])
    missing = np.concatenate([white @ (k - start), target - prior @ start])
    inverse = pseudo_inverse(matrix[:, free], _SMALLEST)
    null = null_vectors(matrix[:, free], _SMALLEST)
    change = inverse @ missing
    start[free] += change
    start = _within_bounds(start, matrix, missing, free, known, change)

    # What errors of the fit and of the values do to the coefficients that are not fixed.
    of_white, of_values = np.split(inverse, [len(white)], axis=1)
    follow = np.zeros((len(free), len(k)))
    follow[:, free] = np.eye(len(free)) - of_values @ prior[:, free]
    follow[:, fixed] = of_white @ white[:, fixed]

    def covariance_of(covariance: Any) -> Float[np.ndarray, "coefficients coefficients"]:
        whole = np.zeros((len(k), len(k)))
        part = follow @ np.asarray(covariance) @ follow.T + of_values @ of_values.T
        whole[np.ix_(free, free)] = part
        return whole

    undetermined = np.zeros((len(k), len(k)))
    undetermined[np.ix_(np.arange(len(null)), free)] = null
    if isinstance(fit, FoldFit):
        return FoldFit(start, covariance_of(fit.covariance), undetermined)
    scale = np.linalg.norm(matrix, axis=0)
    shares = undetermined * np.where(scale > 0, scale, 1.0)
    lengths = np.linalg.norm(shares, axis=1, keepdims=True)
    shares = shares / np.where(lengths > 0, lengths, 1.0)
    determined = np.sqrt(np.sum(shares**2, axis=0)) < _SHARE
    covariance = covariance_of(fit.covariance)
    error = np.where(determined, np.sqrt(np.maximum(np.diag(covariance), 0.0)), np.inf)
    deficient = RESULTS.rank_deficient if len(null) else RESULTS.successful
    rank = len(free) - len(null)
    changed = (
        *(start, error, covariance, covariance_of(fit.independent_covariance)),
        *(undetermined, determined, np.asarray(rank), deficient),
    )
    return eqx.tree_at(
        lambda f: (
            *(f.k, f.standard_error, f.covariance, f.independent_covariance),
            *(f.undetermined, f.determined, f.rank, f.result),
        ),
        fit,
        tuple(jnp.asarray(x) if isinstance(x, np.ndarray) else x for x in changed),
        is_leaf=lambda x: x is fit.result,
    )


def information_rows(
    fit: Fitted, k: Float[np.ndarray, " coefficients"]
) -> Float[np.ndarray, "rank coefficients"]:
    """Return rows whose product with a change of coefficients `k` is that of the fit's equations.

    Up to a rotation, in units of the residual.

    A change is one within the covariance's range and one that the fit leaves open. The former
    counts by the inverse of the covariance, the latter not at all. Neither rank is guessed.
    """
    independent = getattr(fit, "independent_covariance", fit.covariance)
    covariance, open_rows = np.asarray(independent, float), np.asarray(fit.undetermined, float)
    open_rows = open_rows[np.linalg.norm(open_rows, axis=1) > 0.0]
    rank = len(k) - len(open_rows)
    error = np.sqrt(np.maximum(np.diag(covariance), 0.0))
    # Of coefficients that nothing depends on, values and errors are rounding.
    rounding = error + np.abs(k) < _SMALLEST * np.max(error + np.abs(k), initial=0.0)
    units = np.where(rounding, 1.0, error + FINEST * np.abs(k))
    scaled = covariance / np.outer(units, units)
    values, vectors = np.linalg.eigh((scaled + scaled.T) / 2 + FINEST**2 * np.eye(len(k)))
    basis = np.linalg.qr((open_rows / units).T)[0] if len(open_rows) else np.zeros((len(k), 0))
    parts = np.linalg.inv(np.concatenate([vectors[:, len(k) - rank :], basis], axis=1))
    # Of an indefinite covariance, what is below rounding is rounding.
    rows = parts[:rank] / np.sqrt(np.maximum(values[len(k) - rank :], FINEST**2))[:, None]
    return np.where(rounding, 0.0, rows / units)


def _with_bias(
    white: Float[np.ndarray, "rank coefficients"], bias: Float[np.ndarray, " coefficients"] | None
) -> Float[np.ndarray, "rank coefficients"]:
    """Return rows in units of an error that includes a bias of unknown sign.

    The covariance C of their changes becomes C + b bᵀ, with b the bias in units of the error: the
    rows are multiplied by (1 + b bᵀ)^(-1/2).
    """
    if bias is None:
        return white
    moved = white @ bias
    square = float(moved @ moved)
    if square == 0.0:
        return white
    return white - np.outer(moved, moved @ white) * (1.0 - 1.0 / np.sqrt(1.0 + square)) / square


def _within_bounds(
    k: Float[np.ndarray, " coefficients"],
    matrix: Float[np.ndarray, "rows coefficients"],
    missing: Float[np.ndarray, " rows"],
    free: Int[np.ndarray, " free"],
    known: Mapping[int, Known],
    change: Float[np.ndarray, " free"],
) -> Float[np.ndarray, " coefficients"]:
    """The minimum within bounds, if that without them is not."""
    low, high = np.full(len(k), -np.inf), np.full(len(k), np.inf)
    for i, entry in known.items():
        low[i], high[i] = entry.low, entry.high
    if np.all((k >= low) & (k <= high)):
        return k
    before = k[free] - change
    scale = np.linalg.norm(matrix[:, free], axis=0)
    scale = np.where(scale > 0, scale, 1.0)
    solution = scipy.optimize.lsq_linear(
        matrix[:, free] / scale,
        missing,
        ((low[free] - before) * scale, (high[free] - before) * scale),
        method="bvls",
    )
    k = k.copy()
    k[free] = np.clip(before + solution.x / scale, low[free], high[free])
    return k
