"""Agreement of two machines of one design, coefficient by coefficient (Section 7.6)."""

import dataclasses

import numpy as np
from jaxtyping import Array, Float

from jaxcslc import CSLC, Identification


@dataclasses.dataclass(frozen=True)
class Agreement:
    """How far two machines of one design agree, coefficient by coefficient (Section 7.6).

    `print` shows one line; `rows()` returns one row a coefficient.

    **Attributes**

    - `names`, `groups`: of the p coefficients.
    - `first`, `second`: (p,) identified coefficients.
    - `difference`: (p,) second minus first.
    - `standard_error`: (p,) of the difference: the root of the sum of both squares; infinite
      where one recording does not determine the coefficient.
    - `true_difference`: (p,) of the machines' true coefficients; zero without `truth`.
    - `truth_known`: whether true coefficients were passed.
    - `sensitivity`: (p,) of the torque [N m per unit].
    """

    names: tuple[str, ...]
    groups: tuple[str, ...]
    first: Float[np.ndarray, " coefficients"]
    second: Float[np.ndarray, " coefficients"]
    standard_error: Float[np.ndarray, " coefficients"]
    true_difference: Float[np.ndarray, " coefficients"]
    truth_known: bool
    sensitivity: Float[np.ndarray, " coefficients"]

    @property
    def difference(self) -> Float[np.ndarray, " coefficients"]:
        return self.second - self.first

    @property
    def z(self) -> Float[np.ndarray, " coefficients"]:
        """(p,) error of the identified difference in standard errors; NaN where a recording does
        not determine the coefficient."""
        finite = np.isfinite(self.standard_error) & (self.standard_error > 0)
        error = np.where(finite, self.standard_error, np.nan)
        return (self.difference - self.true_difference) / error

    @property
    def product(self) -> Float[np.ndarray, " coefficients"]:
        """(p,) difference times sensitivity: its mean effect on the torque, over joints and
        patterns [N m]."""
        return np.abs(self.difference) * self.sensitivity

    @property
    def largest_product(self) -> dict[str, float]:
        """The largest `product` of every group [N m]."""
        groups = np.array(self.groups)
        return {
            group: float(np.max(self.product[groups == group]))
            for group in dict.fromkeys(self.groups)
        }

    def share_within(self, errors: float, *groups: str) -> float:
        """Share of the determined coefficients, of `groups` or of all, with |z| <= `errors`.

        For normal errors 0.68 lie within one and 0.95 within two. NaN where none is determined.
        """
        counted = np.isfinite(self.z)
        if groups:
            counted &= np.isin(np.array(self.groups), groups)
        return float(np.mean(np.abs(self.z[counted]) <= errors)) if np.any(counted) else np.nan

    def rows(self) -> list[dict[str, str | float]]:
        """One row a coefficient, in the network's order."""
        columns = {
            "first": self.first,
            "second": self.second,
            "difference": self.difference,
            **({"true_difference": self.true_difference} if self.truth_known else {}),
            "standard_error": self.standard_error,
            "z": self.z,
            "sensitivity": self.sensitivity,
            "product": self.product,
        }
        return [
            {
                "name": name,
                "group": group,
                **{column: float(values[i]) for column, values in columns.items()},
            }
            for i, (name, group) in enumerate(zip(self.names, self.groups, strict=True))
        ]

    def __str__(self) -> str:
        products = ", ".join(
            f"{group} {value:.3g}" for group, value in self.largest_product.items()
        )
        one, two = (100 * self.share_within(errors) for errors in (1.0, 2.0))
        return (
            f"largest variation times sensitivity [N m]: {products}; {one:.0f} % of the"
            f" coefficients agree within one standard error, {two:.0f} % within two"
        )


def agreement(
    network: CSLC,
    first: Identification,
    second: Identification,
    *,
    sensitivity: Float[Array | np.ndarray, " _"],
    truth: tuple[Float[Array | np.ndarray, " _"], Float[Array | np.ndarray, " _"]] | None = None,
) -> Agreement:
    """Compare the identified coefficients of two machines of one design (Section 7.6).

    The thesis judges a difference by its effect on the torque. Standard errors judge it too:
    recordings are independent, so the variance of a difference is the sum of both variances.

    **Arguments**

    - `network`: p coefficients.
    - `first`, `second`: the fits of both machines with this network.
    - `sensitivity`: (p,) from `output_sensitivity`, of either training recording or the mean of
      both.
    - `truth`: true coefficients of the first and second machine, from a simulator. Differences are
      then compared with the true difference instead of zero.

    **Returns** an `Agreement`.

    **Raises**

    - `ValueError`: if a vector is not (p,), or a fit is of another network.
    """
    vectors = {
        "first.k": first.k,
        "second.k": second.k,
        "sensitivity": sensitivity,
        **({} if truth is None else {"truth of the first": truth[0]}),
        **({} if truth is None else {"truth of the second": truth[1]}),
    }
    for name, vector in vectors.items():
        if vector.shape != (network.size,):
            raise ValueError(f"{name}: expected shape ({network.size},), got {vector.shape}")
    for name, fit in (("first", first), ("second", second)):
        if fit.names != network.names:
            raise ValueError(f"{name}: expected a fit of this network, got one of {fit.names}")
    true = (0.0, 0.0) if truth is None else (np.asarray(truth[0]), np.asarray(truth[1]))
    return Agreement(
        names=network.names,
        groups=tuple(coefficient.group for coefficient in network.coefficients),
        first=np.asarray(first.k),
        second=np.asarray(second.k),
        standard_error=np.hypot(
            np.asarray(first.standard_error), np.asarray(second.standard_error)
        ),
        true_difference=np.broadcast_to(true[1] - true[0], (network.size,)).astype(float),
        truth_known=truth is not None,
        sensitivity=np.asarray(sensitivity),
    )
