"""Knowledge of single parameters of links, and its equations in a programme's unknowns.

`_prior` reads it from files; `_nearest_bodies` uses the equations.
"""

import dataclasses
import math
from collections.abc import Callable, Sequence
from typing import NamedTuple

import numpy as np
from jaxtyping import Float


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
    from 0 to inf
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
            raise ValueError(f"value: expected from {self.low} to {self.high}, got {self.value}")

    @property
    def fixed(self) -> bool:
        """True if the number is a value without error."""
        return self.value is not None and self.error == 0.0

    def document(self) -> dict[str, float]:
        """Return the entries that are set, as plain data."""
        entries = {"value": self.value, "low": self.low, "high": self.high}
        known = {k: v for k, v in entries.items() if v is not None and math.isfinite(v)}
        return known | ({"error": self.error} if self.error else {})

    def __str__(self) -> str:
        bounds = ""
        if self.low > -math.inf or self.high < math.inf:
            bounds = f"from {self.low:g} to {self.high:g}"
        if self.value is None:
            return bounds
        value = f"fixed at {self.value:g}" if self.fixed else f"{self.value:g} ± {self.error:g}"
        return f"{value}, {bounds}" if bounds else value


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
    form[6:9] = rotation[:, axis]
    form[9] = -rotation[:, axis] @ origin - value
    return form
