"""Degree of excitation: how well a motion determines coefficients."""

from collections.abc import Mapping
from typing import Any

import equinox as eqx
import jax
import numpy as np
from jaxtyping import Array, Float

from .._environment import as_jax, require
from .._rank import rank_tolerance
from ..least_squares import Unknowns, pattern_factors
from ..network import AbstractLinearNetwork
from ..recordings import Patterns


# Most coefficients that `worst_combination` names.
_PARTS = 4


class Excitation(eqx.Module):
    """Figures of how well a recording separates the coefficients of a network.

    Computed from the singular values of the regressor over the pairs in `Patterns.mask`, each
    column scaled to unit length: neither units nor the length of the recording enter. For
    orthogonal columns every singular value is 1.

    **Attributes**

    - `condition`: the largest singular value over the smallest, which bounds how much relative
      noise of the torque is amplified in the coefficients; infinite where the patterns leave a
      combination of coefficients undetermined.
    - `smallest`: the smallest singular value, from 0 to 1.
    - `weakest`: (p,) right singular vector of `smallest`: the combination of scaled coefficients
      that the recording determines least, of unit length.
    - `length`: (p,) Euclidean norm of each column; a coefficient times it is the scaled one.
    - `variance_inflation`: (p,) ratio of each coefficient's variance to its variance if all others
      were fixed, from 1 (Belsley, Kuh and Welsch, 'Regression Diagnostics', 1980; about zero, not
      about means). Infinite where the patterns do not determine it.
    - `group_condition`: the condition of each group's columns alone, as if all other coefficients
      were fixed.
    - `names`: of the coefficients.
    """

    condition: Float[Array, ""]
    smallest: Float[Array, ""]
    weakest: Float[Array, " coefficients"]
    length: Float[Array, " coefficients"]
    variance_inflation: Float[Array, " coefficients"]
    group_condition: Mapping[str, Float[Array, ""]]
    names: tuple[str, ...] = eqx.field(static=True)

    def rows(self) -> list[dict[str, str | float]]:
        """Return one row for all coefficients and one per group, with their condition."""
        conditions = {"all": self.condition, **self.group_condition}
        return [
            {"coefficients": group, "condition": float(value)}
            for group, value in conditions.items()
        ]

    @property
    def worst_combination(self) -> str:
        """The combination of coefficients that the recording determines least, as a formula.

        In the coefficients' units, the largest term first and scaled to 1; at most four terms, and
        none of less than a fifth of the first. Not available under `jit`.
        """
        part = np.asarray(self.weakest)
        size = np.abs(part)
        order = [int(i) for i in np.argsort(-size)[:_PARTS] if size[i] > 0.2 * size.max()]
        multiple = part * np.asarray(self.length)
        first = order[0]
        # A column of zeros has no length to scale by: the combination is that coefficient.
        scaled = multiple / multiple[first] if multiple[first] else np.ones_like(multiple)
        text = self.names[first]
        for i in order[1:]:
            number = f"{abs(scaled[i]):.3g}"
            times = "" if number == "1" else f"{number}*"
            text += f" {'-' if scaled[i] < 0 else '+'} {times}{self.names[i]}"
        return text

    def to_pandas(self) -> Any:
        """Return a `pandas.DataFrame`, a row per coefficient: variance inflation and `weakest`."""
        pandas = require("pandas", "tables")

        return pandas.DataFrame(
            {
                "variance_inflation": np.asarray(self.variance_inflation),
                "weakest": np.asarray(self.weakest),
            },
            index=pandas.Index(self.names, name="coefficient"),
        )

    def __str__(self) -> str:
        return (
            f"condition {float(self.condition):.4g}, smallest singular value"
            f" {float(self.smallest):.4g}; least determined: {self.worst_combination}"
        )


def degree_of_excitation(network: AbstractLinearNetwork, patterns: Patterns) -> Excitation:
    """Measure how exciting a recording is for a network (7.4.1; Craig 1986, Armstrong 1989).

    Measured as in Armstrong, 'On finding exciting trajectories for identification experiments
    involving systems with nonlinear dynamics' (1989): condition number and smallest singular
    value of the regressor. `condition` equals that of a fit to the same patterns with joints of
    equal weight, if they determine every coefficient; the torque is not used.

    **Arguments**

    - `network`: n joints, p coefficients.
    - `patterns`: motion; pairs outside `patterns.mask` are excluded.

    **Returns** an `Excitation`.

    >>> import jaxcslc as jc
    >>> from jaxcslc.report import degree_of_excitation
    >>> network = jc.derive(jc.examples.pendulum("viscous"), lengths="numeric")
    >>> patterns = jc.examples.swing(network, [0.5, 0.3, -0.1, 0.2])
    >>> excitation = degree_of_excitation(network, patterns)
    >>> bool(excitation.condition < 100), tuple(excitation.group_condition)
    (True, ('base', 'viscous'))
    """
    # On the host from here: there is less to compute than to compile.
    factors = jax.tree.map(np.asarray, pattern_factors(network, patterns))
    triangle = factors.stacked(Unknowns.of(network), np.ones(network.joint_count))[:, :-1]
    length = np.linalg.norm(triangle, axis=0)
    scaled = triangle / np.where(length > 0, length, 1.0)[None, :]
    _, singular, right = np.linalg.svd(scaled, full_matrices=False)

    groups = tuple(coefficient.group for coefficient in network.coefficients)
    columns = {
        group: np.flatnonzero([other == group for other in groups])
        for group in dict.fromkeys(groups)
    }
    rounding = float(rank_tolerance(network.size, np.sum(factors.counts)))
    counted = singular > rounding * singular[0]
    inverse = np.where(counted, 1.0 / np.where(counted, singular, 1.0), 0.0)
    undetermined = np.sum(np.where(counted[:, None], 0.0, right) ** 2, axis=0) > 1e-12
    inflation = np.sum((inverse[:, None] * right) ** 2, axis=0)
    return Excitation(
        condition=_condition(singular, rounding),
        smallest=as_jax(singular[-1]),
        weakest=as_jax(right[-1]),
        length=as_jax(length),
        variance_inflation=as_jax(np.where(undetermined, np.inf, inflation)),
        group_condition={
            group: _condition(np.linalg.svd(scaled[:, indices], compute_uv=False), rounding)
            for group, indices in columns.items()
        },
        names=network.names,
    )


def _condition(singular: Float[np.ndarray, " values"], rounding: float) -> Float[Array, ""]:
    """Infinite where the smallest singular value is no more than rounding."""
    counted = singular[-1] > rounding * singular[0]
    return as_jax(singular[0] / singular[-1] if counted else np.inf)
