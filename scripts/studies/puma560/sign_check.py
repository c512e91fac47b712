"""Signs of coefficients that are positive by construction (Section 5.2.3)."""

import dataclasses

import numpy as np
from jaxtyping import Array, Float

from jaxcslc import CSLC


_RIGHT, _WITHIN, _WRONG = "right", "within its error", "wrong"


@dataclasses.dataclass(frozen=True)
class SignCheck:
    """Signs of the coefficients that are positive by construction (Section 5.2.3).

    `print` shows one line; `rows()` returns one row a coefficient.

    **Attributes**

    - `names`, `expressions`: of the coefficients that are positive by construction.
    - `values`: their values.
    - `standard_errors`: of the values, or None.
    - `verdicts`: `right`; `within its error` where the value is not positive, but its standard
      error reaches zero: nothing is contradicted; `wrong`.
    """

    names: tuple[str, ...]
    expressions: tuple[str, ...]
    values: tuple[float, ...]
    standard_errors: tuple[float, ...] | None
    verdicts: tuple[str, ...]

    @property
    def passed(self) -> bool:
        """Return whether no value contradicts its sign."""
        return _WRONG not in self.verdicts

    def rows(self) -> list[dict[str, str | float]]:
        """One row a coefficient: name, value, standard error if any, sign, expression."""
        rows: list[dict[str, str | float]] = []
        for i, name in enumerate(self.names):
            row: dict[str, str | float] = {"name": name, "value": self.values[i]}
            if self.standard_errors is not None:
                row["standard_error"] = self.standard_errors[i]
            rows.append(row | {"sign": self.verdicts[i], "expression": self.expressions[i]})
        return rows

    def __str__(self) -> str:
        right = self.verdicts.count(_RIGHT)
        text = f"{right} of {len(self.names)} coefficients that must be positive are"
        for verdict, label in ((_WITHIN, "negative within their error"), (_WRONG, "wrong")):
            pairs = zip(self.names, self.verdicts, strict=True)
            names = [name for name, other in pairs if other == verdict]
            text += f"; {label}: {', '.join(names)}" if names else ""
        return text


def sign_check(
    network: CSLC,
    k: Float[Array | np.ndarray, " _"],
    standard_error: Float[Array | np.ndarray, " _"] | None = None,
) -> SignCheck:
    """Check the signs of coefficients against their algebra (Section 5.2.3).

    A coefficient that is a sum of masses, moments of inertia and squares must be positive
    whatever the robot weighs; a negative estimate is certainly wrong. The thesis
    names kM4, kM6, kM9 and kM11 of the PUMA 560; `Coefficient.positive` adds the
    longer sums that are positive too, and friction, which only ever brakes.

    **Arguments**

    - `network`: p coefficients.
    - `k`: (p,) values.
    - `standard_error`: (p,) of the values; infinite where the patterns do not determine one.

    **Returns** a `SignCheck`.

    **Raises**

    - `ValueError`: if `k` or `standard_error` are not (p,).
    """
    values = np.asarray(k)
    errors = None if standard_error is None else np.asarray(standard_error)
    for name, vector in (("k", values), ("standard_error", errors)):
        if vector is not None and vector.shape != (network.size,):
            raise ValueError(f"{name}: expected shape ({network.size},), got {vector.shape}")
    indices = [i for i, coefficient in enumerate(network.coefficients) if coefficient.positive]
    return SignCheck(
        names=tuple(network.names[i] for i in indices),
        expressions=tuple(network.coefficients[i].expression for i in indices),
        values=tuple(float(values[i]) for i in indices),
        standard_errors=None if errors is None else tuple(float(errors[i]) for i in indices),
        verdicts=tuple(
            _verdict(float(values[i]), 0.0 if errors is None else float(errors[i])) for i in indices
        ),
    )


def _verdict(value: float, error: float) -> str:
    if value > 0:
        return _RIGHT
    return _WITHIN if -value < error else _WRONG
