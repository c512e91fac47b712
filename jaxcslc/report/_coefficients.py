"""Coefficients in reports: description of their model, verdicts, and the table for text and CSV."""

import dataclasses
from collections.abc import Callable, Iterable, Mapping, Sequence
from functools import cached_property
from textwrap import fill
from typing import Any, Literal

import numpy as np
from jaxtyping import Array, Float

from .._text_table import counted, number_text, readable, text_table
from ..bodies import DECIDED
from ..derivation import Coefficient
from ..least_squares import Identification
from ..network import CSLC, AbstractLinearNetwork
from ..uncertainty import SHOWN_SCALE, TORQUE_SCALE, SystematicError, uncertainty_interval
from ._excitation import Excitation
from ._page import Column, Table, Value


@dataclasses.dataclass(frozen=True, eq=False)
class ModelDescription:
    """Names and units of a network's outputs and coefficients, as a report's file holds them.

    **Attributes**

    - `name`: of the robot or the system.
    - `output_kind`, `output_quantity`: what an output is called, and what it is.
    - `output_labels`, `output_names`, `output_units`: of each output.
    - `coefficients`: names, groups, expressions, units and signs.
    - `lines`: the network in words.
    - `legend`: what symbols in expressions mean; None of systems that are no robots.
    """

    name: str
    output_kind: str
    output_quantity: str
    output_labels: tuple[str, ...]
    output_names: tuple[str, ...]
    output_units: tuple[str, ...]
    coefficients: tuple[Coefficient, ...]
    lines: tuple[str, ...] = ()
    legend: str | None = None

    @cached_property
    def names(self) -> tuple[str, ...]:
        """Names of the coefficients, in the order of `k`."""
        return tuple(coefficient.name for coefficient in self.coefficients)

    @property
    def size(self) -> int:
        """Number of coefficients, p."""
        return len(self.coefficients)

    @property
    def per_joint(self) -> bool:
        """True if outputs are torques of joints of a robot."""
        return self.output_kind == "joint"

    @property
    def error_kind(self) -> str:
        """Quantity whose errors are reported: torque, or equations."""
        return "torque" if self.per_joint else self.output_kind

    def table(
        self, columns: Iterable[tuple[Column, Sequence[Value]]], caption: str = "", name: str = ""
    ) -> Table:
        """Return a table with a row per output, which begins with its name and unit."""
        head = (self.output_kind, self.output_names), ("unit", self.output_units)
        texts = [(Column(title, numeric=False), values) for title, values in head]
        return Table.from_columns([*texts, *columns], caption, name)

    @classmethod
    def of(cls, network: AbstractLinearNetwork) -> "ModelDescription":
        """Return the description of a network."""
        robot = isinstance(network, CSLC)
        return cls(
            network.name,
            network.output_kind,
            network.output_quantity,
            network.output_labels,
            network.output_names,
            network.output_units,
            network.coefficients,
            tuple(model_lines(network)) if robot else (str(network),),
            expression_legend(network) if robot else None,
        )

    def document(self) -> dict[str, Any]:
        """Return the entries of a report's `identification.json`."""
        return {
            "joints": self.output_names,
            "expressions": [coefficient.expression for coefficient in self.coefficients],
            "units": [coefficient.unit for coefficient in self.coefficients],
            "model": {
                "kind": self.output_kind,
                "quantity": self.output_quantity,
                "labels": self.output_labels,
                "units": self.output_units,
                "groups": [coefficient.group for coefficient in self.coefficients],
                "positive": [some.name for some in self.coefficients if some.positive],
                "lines": self.lines,
                "legend": self.legend,
            },
        }

    @classmethod
    def from_document(cls, document: Mapping[str, Any], fit: Identification) -> "ModelDescription":
        """Return what `document` was made of; of older files, what they hold."""
        count, joints = len(fit.names), len(fit.torque_error)
        entries = document.get("model")
        model: dict[str, Any] = entries if isinstance(entries, dict) else {}

        def texts(entries: Mapping[str, Any], name: str, size: int | None, default: Any) -> Any:
            value: Any = entries.get(name)
            fits = isinstance(value, list) and size in (None, len(value))
            return tuple(map(str, value if fits else default))

        labels = texts(model, "labels", joints, [str(i + 1) for i in range(joints)])
        kind = str(model.get("kind", "joint"))
        name = document.get("robot", document.get("system", ""))
        columns = (
            fit.names,
            texts(model, "groups", count, [""] * count),
            texts(document, "expressions", count, [""] * count),
            texts(document, "units", count, [""] * count),
        )
        positive = texts(model, "positive", None, ())
        return cls(
            str(name),
            kind,
            str(model.get("quantity", "torque")),
            labels,
            texts(document, "joints", joints, [f"{kind} {label}" for label in labels]),
            texts(model, "units", joints, [""] * joints),
            tuple(
                Coefficient(name, group, expression, unit, name in positive)
                for name, group, expression, unit in zip(*columns, strict=True)
            ),
            texts(model, "lines", None, ()),
            None if model.get("legend") is None else str(model["legend"]),
        )


def model_lines(network: CSLC) -> list[str]:
    """Return lines on the model: its size, and the joints' numbers and names if they have any."""
    robot, groups = network.robot, [coefficient.group for coefficient in network.coefficients]
    sizes = ", ".join(f"{groups.count(group)} {group}" for group in network.layout.groups)
    size = (
        f"robot {robot.name}: {counted(network.joint_count, 'joint')},"
        f" {counted(network.size, 'coefficient')} ({sizes})"
    )
    if not robot.has_joint_names:
        return [size]
    mimics = () if robot.source is None else robot.source.mimics
    leaders = {mimic.follower: f" (follows {mimic.leader})" for mimic in mimics}
    joints = ", ".join(
        f"{i} {name}{leaders.get(name, '')}" for i, name in enumerate(robot.joint_names, start=1)
    )
    lines = fill(f"joints: {joints}", 96, subsequent_indent="    ", break_on_hyphens=False)
    return [size, lines]


def expression_legend(network: CSLC) -> str:
    """Return what symbols in the expressions of a robot's coefficients mean, in which frames.

    >>> import jaxcslc as jc
    >>> expression_legend(jc.derive(jc.examples.pendulum(), lengths="numeric"))[:58]
    'kB: base parameters. For link i: mi mass, rxi ryi rzi cent'
    """
    groups = {
        "mass": "kM: of the mass matrix",
        "gravity": "kG: of gravity",
        "base": "kB: base parameters",
    }
    present = dict.fromkeys(c.group for c in network.coefficients)
    names = "; ".join(text for group, text in groups.items() if group in present)
    forms = {inertia.form for inertia in network.robot.inertia}
    about = "the origin" if forms == {"full"} else "the centre of gravity"
    if len(forms) > 1:
        about = "the origin (principal moments: the centre of gravity)"
    return (
        f"{names}. For link i: mi mass, rxi ryi rzi centre of gravity, Ixxi to Iyzi moments of"
        f" inertia about {about}, Imi motor inertia, in the link's modified Denavit-Hartenberg"
        " frame: z along the axis of joint i, x along the common normal to the next axis"
    )


def legend_text(legend: str) -> str:
    """Return a legend of expressions in lines to print."""
    return fill(legend, 96, subsequent_indent="    ")


VerdictKind = Literal[
    "well determined",
    "well determined up to scale",
    "poorly determined",
    "systematic error",
    "from the file",
    "indistinguishable from zero",
    "wrong sign",
    "not determined",
]

WELL_DETERMINED: tuple[VerdictKind, ...] = ("well determined", "well determined up to scale")
"""Verdicts on coefficients that can be used."""

# A standard error of a tenth of the value, the field's rule of thumb (Khalil and Dombre 2002,
# 12.5).
_WELL = 0.1
# A systematic error of half of that: no further recording of the motion makes it smaller.
_WELL_SYSTEMATIC = 0.05
# Variance inflation above this: most of a coefficient's variance comes from its correlation with
# others (Belsley, Kuh and Welsch 1980).
_CORRELATED = 10.0
# Errors of more times the value are printed beside it.
_FAR = 100.0


@dataclasses.dataclass(frozen=True)
class Verdict:
    """Verdict on how well a recording determines a coefficient.

    **Attributes**

    - `name`: of the coefficient.
    - `kind`:
        - `"well determined"`: standard and systematic error together are at most a tenth of the
          value, the systematic error alone at most a twentieth;
        - `"well determined up to scale"`: the same, but it is proportional to the torque, and
          neither data nor the robot's file confirm the torque's scale to a tenth;
        - `"poorly determined"`: the standard error is more than a tenth, or the condition number
          of the fit makes every value meaningless;
        - `"systematic error"`: the standard error is small enough, the systematic error is not:
          what is needed is another model or smoothing, not more data;
        - `"from the file"`: the robot's file says more of the value than the data;
        - `"indistinguishable from zero"`: the interval, systematic error included, contains zero;
        - `"wrong sign"`: the coefficient is positive for every physically consistent robot and the
          whole interval is negative;
        - `"not determined"`: the patterns do not determine it.
    - `reason`: of the verdict.
    """

    name: str
    kind: VerdictKind
    reason: str

    def __str__(self) -> str:
        return f"{self.name}: {self.kind}, {self.reason}"


def verdicts(
    network: AbstractLinearNetwork | ModelDescription,
    fit: Identification,
    excitation: Excitation | None = None,
    *,
    systematic: SystematicError | None = None,
    share: Float[np.ndarray, " coefficients"] | None = None,
    level: float = 0.95,
) -> tuple[Verdict, ...]:
    """Judges each coefficient of a fit by its standard and systematic errors.

    **Arguments**

    - `network`: p coefficients.
    - `fit`: to this network.
    - `excitation`: of the patterns that were fitted; reasons then name correlation with other
      coefficients where it makes one poorly determined.
    - `systematic`: of the fit, as `systematic_error` computes it; none if omitted.
    - `share`: part of each coefficient that is the robot's file's (`FileWeight`); none if omitted.
    - `level`: of the intervals.

    **Returns** p verdicts, in the order of the coefficients.

    **Raises**

    - `ValueError`: a fit of another network.

    >>> import jaxcslc as jc
    >>> from jaxcslc.report import verdicts
    >>> network = jc.derive(jc.examples.turntable(), lengths="numeric")
    >>> patterns = jc.examples.swing(network, [0.5, 2.0, 0.001], torque_noise=0.1)
    >>> for verdict in verdicts(network, jc.LeastSquares().fit(network, patterns)):
    ...     print(verdict.name, verdict.kind)
    kB1 well determined
    kv1 well determined
    kd1 indistinguishable from zero
    """
    if fit.names != network.names:
        raise ValueError(
            f"the fit has {len(fit.names)} coefficients from {fit.names[0]!r}, the network has"
            f" {network.size} from {network.names[0]!r}; expected a fit of this network"
        )
    interval = uncertainty_interval(fit, systematic, level)
    shift = np.zeros(network.size) if systematic is None else systematic.total
    unscaled = np.zeros(network.size, bool)
    if systematic is not None and SHOWN_SCALE in systematic.within:
        unscaled = systematic.parts[TORQUE_SCALE] > 0.0
    inflation = None if excitation is None else np.asarray(excitation.variance_inflation)
    determined, combinations = np.asarray(fit.determined), _determined_combinations(fit)
    meaningless = not bool(fit.meaningful)
    values, errors = np.asarray(fit.k).tolist(), np.asarray(fit.standard_error).tolist()
    result: list[Verdict] = []
    for i, coefficient in enumerate(network.coefficients):
        name, (low, high) = coefficient.name, interval[i]
        value, error = values[i], errors[i]
        relative = abs(error / value) if value else np.inf
        reason = f"standard error {compared_with_value(error, value)}"
        if inflation is not None and relative > _WELL and inflation[i] > _CORRELATED:
            times = f"{np.sqrt(inflation[i]):.2g} times"
            reason += f" (increased {times} by correlation with other coefficients)"
        kind: VerdictKind = "well determined" if relative <= _WELL else "poorly determined"
        if relative <= _WELL and unscaled[i]:
            kind = "well determined up to scale"
        small = np.hypot(error, shift[i]) <= _WELL * abs(value)
        if relative <= _WELL and not (small and shift[i] <= _WELL_SYSTEMATIC * abs(value)):
            kind = "systematic error"
        if systematic is not None and (shift[i] > error or kind == "systematic error"):
            reason += f"; systematic error {compared_with_value(shift[i], value)}"
            reason += f", mostly from {systematic.main_cause(i)}"
        if share is not None and share[i] > DECIDED:
            kind, reason = "from the file", f"{100 * share[i]:.0f} % is the file's; {reason}"
        elif not determined[i]:
            kind, reason = "not determined", combinations[name]
        elif meaningless:
            kind, reason = (
                "poorly determined",
                f"condition number {number_text(float(fit.condition), 2)}",
            )
        elif coefficient.positive and high < 0.0:
            kind, reason = "wrong sign", "positive for every physically consistent robot"
        elif low <= 0.0 <= high:
            kind = "indistinguishable from zero"
        result.append(Verdict(name, kind, reason))
    return tuple(result)


def compared_with_value(error: float, value: float) -> str:
    """Return an error next to its value as text.

    >>> compared_with_value(0.12, 1.0), compared_with_value(1.4, 1.0)
    ('12 % of the value', '1.4 times the value')
    >>> compared_with_value(float("nan"), 1.0)
    'not known'
    """
    part = error / abs(value) if value else np.inf
    if np.isnan(part):  # of an older fit whose file has no number
        return "not known"
    if part > _FAR:
        return f"{error:.2g} for a value of {value:.2g}"
    if part < 1.05:  # beyond, two digits distinguish it from the value itself
        return f"{min(100 * part, 100.0):{'.2g' if part < 0.995 else '.0f'}} % of the value"
    return f"{part:.2g} times the value"


def _determined_combinations(fit: Identification) -> dict[str, str]:
    """Return, for each undetermined coefficient, the determined combinations as a sentence."""
    sentences: dict[str, str] = {}
    for sentence in fit.unidentifiable:
        group, _, text = sentence.partition(": ")
        for name in group.split(", "):
            sentences[name] = text
    return {name: sentences.get(name, "the patterns do not determine it") for name in fit.names}


class CoefficientRow(dict[str, str | float | bool]):
    """Row of a coefficient, which prints as one line; its columns also are attributes.

    >>> row = {"name": "kd1", "value": 0.5, "unit": "N m", "low": 0.4, "high": 0.6}
    >>> row |= {"standard_error": 0.03, "systematic_error": 0.04}
    >>> friction = CoefficientRow(row | {"verdict": "poorly determined"})
    >>> friction
    kd1 = 0.5 N m, 95 % interval 0.4 to 0.6, poorly determined
    >>> friction.value, friction.error, friction.interval
    (0.5, 0.05, (0.4, 0.6))
    """

    @property
    def value(self) -> float:
        """The identified value, in `unit`."""
        return float(self["value"])

    @property
    def error(self) -> float:
        """Standard and systematic error together, in `unit`: one of `Report.standard_errors`."""
        return float(np.hypot(self["standard_error"], self.get("systematic_error", 0.0)))

    @property
    def interval(self) -> tuple[float, float]:
        """The ends of the 95 % confidence interval, in `unit`."""
        return float(self["low"]), float(self["high"])

    @property
    def unit(self) -> str:
        """The unit, as text."""
        return str(self["unit"])

    @property
    def expression(self) -> str:
        """The closed form in parameters of the links, to read; `["expression"]` has all digits."""
        return readable(str(self["expression"]))

    @property
    def verdict(self) -> str:
        """The verdict, as `verdicts` gives it; its reason is `["reason"]`."""
        return str(self["verdict"])

    def __repr__(self) -> str:
        low, high = self.interval
        return (
            f"{self['name']} = {self.value:.4g} {self.unit},"
            f" 95 % interval {number_text(low)} to {number_text(high)}, {self.verdict}"
        )


# What a line has room for: alone, and beside a value with its errors, interval and verdict.
_LONGEST_EXPRESSION, _LONGEST_BESIDE_VALUE = 60, 30
_HEADERS = {
    "standard_error": "std error",
    "systematic_error": "systematic",
    "from_file": "from file",
}


def coefficient_rows(
    network: AbstractLinearNetwork | ModelDescription,
    fit: Identification | None = None,
    reference: Mapping[str, Float[Array | np.ndarray, " _"]] | None = None,
    *,
    sensitivity: Float[Array | np.ndarray, " _"] | None = None,
    groups: Sequence[str] | None = None,
    excitation: Excitation | None = None,
    systematic: SystematicError | None = None,
    share: Float[np.ndarray, " coefficients"] | None = None,
    level: float = 0.95,
) -> list[dict[str, str | float | bool]]:
    """Return one row per coefficient: name, group, unit, expression; with a fit, value and verdict.

    With a reference and sensitivities the rows are those of Figs. B.1-1 to B.5-2.

    **Arguments**

    - `fit`: adds `value`, `standard_error`, `relative_error`, the interval's ends `low` and
      `high`, and `verdict` and `reason`, as `verdicts` gives them.
    - `reference`: further columns of values, such as Armstrong's, or the true ones.
    - `sensitivity`: adds the column `sensitivity`: mean torque per unit of each coefficient (7.6).
    - `excitation`: adds `variance_inflation`, and reasons that name it; see
      `degree_of_excitation`.
    - `systematic`: adds `systematic_error`, and widens intervals; see `systematic_error`.
    - `share`: adds `from_file`, the part of each coefficient that is the robot's file's.
    - `level`: of the intervals.
    - `groups`: only the coefficients of these groups, such as `["mass"]` for Fig. B.1-1; by
      default all.

    **Raises**

    - `ValueError`: for a group that the network does not have, or a vector of another length.

    >>> import jaxcslc as jc
    >>> from jaxcslc.report import coefficient_rows
    >>> network = jc.derive(jc.puma560())
    >>> len(coefficient_rows(network, groups=["gravity"]))
    5
    """
    present = tuple(dict.fromkeys(coefficient.group for coefficient in network.coefficients))
    for group in groups or ():
        if group not in present:
            raise ValueError(f"groups: expected some of {', '.join(present)}, got {group!r}")
    columns = dict(reference or {}) | ({} if sensitivity is None else {"sensitivity": sensitivity})
    for name, vector in columns.items():
        if vector.shape != (network.size,):
            raise ValueError(f"{name}: expected shape ({network.size},), got {vector.shape}")
    judged = (
        None
        if fit is None
        else verdicts(network, fit, excitation, systematic=systematic, share=share, level=level)
    )
    interval = None if fit is None else uncertainty_interval(fit, systematic, level)
    # On the host once: JAX takes 50 µs for an entry, and compiles a program first.
    inflation = None if excitation is None else np.asarray(excitation.variance_inflation)
    shifts = None if systematic is None else systematic.total
    columns = {name: np.asarray(vector) for name, vector in columns.items()}
    k, errors = ((), ()) if fit is None else map(np.asarray, (fit.k, fit.standard_error))
    rows: list[dict[str, str | float | bool]] = []
    for i, coefficient in enumerate(network.coefficients):
        if groups is not None and coefficient.group not in groups:
            continue
        row: dict[str, str | float | bool] = {
            "name": coefficient.name,
            "group": coefficient.group,
            "unit": coefficient.unit,
            "positive": coefficient.positive,
        }
        if fit is not None and judged is not None and interval is not None:
            value, error = float(k[i]), float(errors[i])
            row["value"], row["standard_error"] = value, error
            if shifts is not None:
                row["systematic_error"] = float(shifts[i])
            row["relative_error"] = abs(error / value) if value else float("inf")
            row["low"], row["high"] = (float(end) for end in interval[i])
            if share is not None:
                row["from_file"] = round(float(share[i]), 3)
            if inflation is not None:
                row["variance_inflation"] = float(inflation[i])
            row["verdict"], row["reason"] = judged[i].kind, judged[i].reason
        for name, vector in columns.items():
            row[name] = float(vector[i])
        row["expression"] = coefficient.expression
        rows.append(row)
    return rows


def coefficient_text(rows: list[dict[str, str | float | bool]]) -> str:
    """Coefficient rows as a table to read; long expressions are cut.

    Reasons of verdicts follow the table, for coefficients that are not well determined.

    >>> import jaxcslc as jc
    >>> from jaxcslc.report import coefficient_rows, coefficient_text
    >>> network = jc.derive(jc.examples.pendulum().with_friction(), lengths="numeric")
    >>> print(coefficient_text(coefficient_rows(network)))
    name  unit   expression
    kB1   kg m²  Izz1 + Im1
    kB2   kg m   m1 rx1
    kB3   kg m   m1 ry1
    """
    hidden = ("group", "positive", "relative_error", "variance_inflation", "reason")
    shown = [name for name in rows[0] if name not in hidden]
    longest = _LONGEST_BESIDE_VALUE if "value" in rows[0] else _LONGEST_EXPRESSION
    form: dict[str, Callable[[Any], str]] = {
        "expression": lambda text: _cell(readable(text), longest),
        "from_file": lambda share: f"{100 * share:.0f} %",
    }
    cells = [[form.get(name, _cell)(row[name]) for name in shown] for row in rows]
    header = [_HEADERS.get(name, name) for name in shown]
    table = text_table(header, cells, left=("unit", "verdict", "expression"))
    doubtful = [row for row in rows if row.get("verdict", "") not in ("", *WELL_DETERMINED)]
    reasons = [f"  {row['name']}: {row['reason']}" for row in doubtful]
    return "\n".join([table, *(["", "not well determined:", *reasons] if reasons else [])])


def _cell(value: str | float | bool, longest: int = 0) -> str:
    """The text of a cell, cut where it has more than `longest` characters; 0 for any number."""
    if isinstance(value, float):
        return number_text(value)
    text = str(value)
    return text[: longest - 2] + " …" if 0 < longest < len(text) else text
