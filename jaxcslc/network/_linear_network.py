"""Base class of networks that are linear in their coefficients, and the fewest patterns of one.

`CSLC` and the networks of `jaxcslc.systems` derive from it. `least_patterns` is the number of
patterns that determines all coefficients at once. `jaxcslc.training.network_order` is the
thesis's measure of one output alone.
"""

import abc
import bisect
from collections.abc import Callable, Mapping, Sequence
from functools import cached_property
from typing import Any

import equinox as eqx
import jax
import jax.numpy as jnp
import numpy as np
from jax.core import Tracer
from jaxtyping import Array, Float

from .._display import html_rows
from .._environment import array_namespace, require_float64
from .._rank import numerical_rank
from .._text_table import readable
from ..derivation import Coefficient
from ._layout import Layout, term_layout
from .terms import AbstractTerm


Support = tuple[tuple[int, ...], ...]
ColumnsOf = Callable[[Any, Any, Any], Sequence[Any]]

_SEED = 42  # of random motions
# Random motions are tried one after the other: functions that switch, as signs do, are not zero for
# a part of them only, and the best motion counts.
_MOTIONS = 4
# rad and rad/s, or what else the columns of the motion are: far from zero, and within one turn.
_SMALLEST, _LARGEST = 0.2, 3.0
# Formulas need not be real everywhere; this many draws of patterns are made to find enough.
_DRAWS = 50


def least_patterns(columns: ColumnsOf, support: Support, motion_count: int) -> int:
    """The least number of patterns whose stacked regressor has the rank that any number has.

    The rank of N patterns is that of random ones: entries are analytic functions of the motion
    apart from switches, so that almost all motions have the highest rank. In any stretch of
    patterns, every column of the motion is as often positive as negative, so that both
    directions of switches occur.

    - `columns`: as `AbstractLinearNetwork.columns`, in float64.
    - `support`: for each output, its coefficients.
    - `motion_count`: number of columns of the motion.

    **Raises** `ValueError` for columns that are not finite at random motions.
    """
    # Each output's rank grows with every generic pattern until it is complete.
    enough = max(map(len, support), default=0)
    if not enough:
        return 0
    rng = np.random.default_rng(_SEED)
    motions = [_regressor(columns, support, motion_count, enough, rng) for _ in range(_MOTIONS)]
    rank = max(map(_rank, motions))
    counts = (
        1 + bisect.bisect_left(range(1, enough), rank, key=lambda n, rows=rows: _rank(rows[:n]))
        for rows in motions
        if _rank(rows) == rank
    )
    return min(counts)


def _rank(rows: Float[np.ndarray, "patterns outputs coefficients"]) -> int:
    """The rank of a stacked regressor."""
    return numerical_rank(rows.reshape(-1, rows.shape[-1]))


def _regressor(
    columns: ColumnsOf, support: Support, motion_count: int, count: int, rng: np.random.Generator
) -> Float[np.ndarray, "patterns outputs coefficients"]:
    """Regressors of random patterns where they are finite."""
    size = 1 + max(index for row in support for index in row)
    parts: list[Any] = []
    for _ in range(_DRAWS):
        motion = np.ascontiguousarray(_random_motion(count, motion_count, rng))
        values = columns(*motion)
        rows = np.zeros((count, len(support), size))
        for output, (entries, indices) in enumerate(zip(values, support, strict=True)):
            rows[:, output, list(indices)] = np.asarray(entries).T
        parts.append(rows[np.all(np.isfinite(rows), axis=(1, 2))])
        if sum(map(len, parts)) >= count:
            return np.concatenate(parts)[:count]
    raise ValueError("least patterns: the outputs are not finite at random motions")


def _random_motion(
    count: int, motion_count: int, rng: np.random.Generator
) -> Float[np.ndarray, "3 motion patterns"]:
    """Draw q, qd and qdd, of opposite signs in every two patterns that follow each other."""
    shape = (3, motion_count, count)
    signs = rng.choice((-1.0, 1.0), (3, motion_count, (count + 1) // 2))
    signs = np.stack([signs, -signs], axis=-1).reshape(3, motion_count, -1)[..., :count]
    return signs * rng.uniform(_SMALLEST, _LARGEST, shape)


Vector = Float[Array | np.ndarray, " coefficients"]
Motion = Float[Array | np.ndarray, "... motion"]
MotionRows = Float[Array | np.ndarray, "motion samples"]
Columns = tuple[Float[Array | np.ndarray, "_ samples"], ...]


class AbstractLinearNetwork(eqx.Module):
    """A network whose outputs are linear in its coefficients: a sum of terms.

    What the solver, its reports and the learning rules need of a network, whatever it describes:
    the inverse dynamics of a robot (`CSLC`) or any other equation (`jaxcslc.systems`). Motion is
    `q`, `qd`, `qdd`, each (..., m) with any leading batch axes; outputs are (..., n). A robot's
    outputs are the torques of its joints, and its motion has a column a joint: m = n. Every method
    is a pure function that can be jitted, vmapped and differentiated, in the precision of its
    inputs.

    **Attributes**

    - `terms`: the addends; `k` holds their coefficients one after the other.
    - `name`: of what it describes, for messages.
    - `output_units`: of each output.
    """

    # Of `AbstractTerm`; subclasses say of which: a checker takes fields for invariant.
    terms: eqx.AbstractVar[tuple[Any, ...]]

    @property
    @abc.abstractmethod
    def name(self) -> str: ...

    @property
    @abc.abstractmethod
    def output_kind(self) -> str:
        """Word for an output, such as `"joint"` or `"equation"`."""

    @property
    @abc.abstractmethod
    def output_quantity(self) -> str:
        """Quantity of the outputs, as a heading says it: `"torque"`, `"equations"`."""

    @property
    @abc.abstractmethod
    def output_labels(self) -> tuple[str, ...]:
        """Labels that tell the outputs apart: of a robot, its joints."""

    @property
    @abc.abstractmethod
    def output_units(self) -> tuple[str, ...]: ...

    @property
    @abc.abstractmethod
    def motion_count(self) -> int:
        """Number of columns of the motion, m."""

    @property
    def joint_count(self) -> int:
        """Number of outputs, n: of a robot, its joints."""
        return len(self.output_labels)

    @property
    def output_names(self) -> tuple[str, ...]:
        """`"joint 1"` to `"joint n"`, or as the outputs are called."""
        return tuple(f"{self.output_kind} {label}" for label in self.output_labels)

    @cached_property
    def layout(self) -> Layout:
        """Assignment of the entries of `k` to terms and coefficients."""
        return term_layout(self.terms)

    @property
    def coefficients(self) -> tuple[Coefficient, ...]:
        """Names, expressions and units, in the order of `k`."""
        return self.layout.coefficients

    @property
    def names(self) -> tuple[str, ...]:
        """Coefficient names in the order of `k`."""
        return self.layout.names

    @property
    def size(self) -> int:
        """Number of coefficients, p."""
        return self.layout.size

    @property
    def known_values(self) -> Mapping[str, float]:
        """Values of the coefficients that are numbers, by name; `LeastSquares` keeps them."""
        return {}

    def _repr_html_(self) -> str:
        """Return a table of the coefficients, for notebooks."""
        rows = [
            {"coefficient": x.name, "unit": x.unit, "expression": readable(x.expression)}
            for x in self.coefficients
        ]
        return html_rows(repr(self), rows)

    def torque(self, k: Vector, q: Motion, qd: Motion, qdd: Motion) -> Float[Array, "..."]:
        """Return the output of the network, (..., n): for a robot, every joint's torque [N m].

        - `k`: (p,); `q`, `qd`, `qdd`: (..., m).

        >>> import jax.numpy as jnp, jaxcslc as jc
        >>> network = jc.derive(jc.puma560())
        >>> k = network.coefficients_from(jc.puma560().links)
        >>> rest = jnp.zeros(6)
        >>> bool(jnp.allclose(network.torque(k, rest, rest, rest), network.gravity_term(k, rest)))
        True
        """
        k, q, qd, qdd = self._checked(k, q, qd, qdd)
        shape = (*q.shape[:-1], self.joint_count)
        return self._sum(self.terms, k, lambda term, k: term.torque(k, q, qd, qdd), shape)

    def regressor(self, q: Motion, qd: Motion, qdd: Motion) -> Float[Array, "..."]:
        """Return the matrix that `k` is multiplied by: `regressor @ k == torque`, (..., n, p)."""
        _, q, qd, qdd = self._checked(None, q, qd, qdd)
        return jnp.concatenate([term.regressor(q, qd, qdd) for term in self.terms], axis=-1)

    @cached_property
    def support(self) -> tuple[tuple[int, ...], ...]:
        """Indices of the coefficients that each output can depend on, ascending."""
        indices = self.layout.split(np.arange(self.size))
        supports = [term.support for term in self.terms]
        return tuple(
            tuple(
                int(of_term[index])
                for of_term, support in zip(indices, supports, strict=True)
                for index in support[joint]
            )
            for joint in range(self.joint_count)
        )

    @cached_property
    def least_patterns(self) -> int:
        """Number of patterns that determine `k`, at the least: N.

        N patterns give N rows per output, and one coefficient may occur in several outputs. So N
        is at least p divided by n, and at least what the coefficients of any one output alone
        need. It is computed: the least N at which the stacked regressor of N random patterns
        reaches the rank that any number of patterns has. For coefficients that occur in one
        output each, it is the thesis's network order (4.2); for others it is smaller, since the
        order is what one output alone needs. Noise and poor motion need more patterns.

        **Raises** `ValueError` for a network without `has_host_columns` unless JAX computes in
        float64.

        >>> import jaxcslc as jc
        >>> network = jc.derive(jc.puma560())
        >>> network.size, network.order, network.least_patterns  # thesis 5.2.5 has the order
        (43, 28, 8)
        """
        if not self.has_host_columns:
            require_float64()
        return least_patterns(self.columns, self.support, self.motion_count)

    @property
    def has_host_columns(self) -> bool:
        """True if `columns` computes NumPy's arrays by NumPy, so that nothing is compiled.

        False where a term cannot, and while JAX traces the network's own numbers.
        """
        traced = any(isinstance(leaf, Tracer) for leaf in jax.tree.leaves(self))
        return not traced and all(term.has_host_columns for term in self.terms)

    def columns(self, q: MotionRows, qd: MotionRows, qdd: MotionRows) -> Columns:
        """Return the regressor without what is always zero: for each output, (its support,
        samples).

        Outputs first and samples last, unlike `regressor`: the layout to factorise many patterns
        in (a PUMA 560 has 100 such rows where the regressor has 6 x 43).

        - `q`, `qd`, `qdd`: (m, samples), JAX's arrays, or NumPy's if the network
          `has_host_columns`.
        """
        host = isinstance(q, np.ndarray) and np.issubdtype(q.dtype, np.floating)
        if host and self.has_host_columns:
            return self._host_columns(np.asarray(q), np.asarray(qd), np.asarray(qdd))
        columns = [term.columns(q, qd, qdd) for term in self.terms]
        xp = array_namespace(*(rows for of_term in columns for rows in of_term))
        return tuple(xp.concatenate(rows) for rows in zip(*columns, strict=True))

    def _host_columns(
        self,
        q: Float[np.ndarray, "motion samples"],
        qd: Float[np.ndarray, "motion samples"],
        qdd: Float[np.ndarray, "motion samples"],
    ) -> Columns:
        """Compute `columns` by terms that write where they belong: there is nothing to join."""
        columns = tuple(np.empty((len(support), q.shape[1]), q.dtype) for support in self.support)
        starts = [0] * len(columns)
        for term in self.terms:
            ends = [start + len(part) for start, part in zip(starts, term.support, strict=True)]
            parts = zip(columns, starts, ends, strict=True)
            term.write_columns([rows[start:end] for rows, start, end in parts], q, qd, qdd)
            starts = ends
        return columns

    def _sum(
        self,
        terms: Sequence[AbstractTerm],
        k: Array,
        share: Callable[[Any, Array], Array],
        shape: tuple[int, ...],
    ) -> Array:
        """The shares of terms, each of its own coefficients; zeros if there are none."""
        layout = self.layout
        shares = [share(term, k[layout.term_slice(term)]) for term in terms]
        return sum(shares[1:], shares[0]) if shares else jnp.zeros(shape, k.dtype)

    def _checked(self, k: Any, *motion: Any) -> tuple[Array, ...]:
        """Arrays of the right sizes, integers made floats; sizes are static, so errors are."""
        arrays = [jnp.asarray(x) for x in motion]
        for array in arrays:
            if array.ndim == 0 or array.shape[-1] != self.motion_count:
                raise ValueError(
                    f"expected arrays of shape (..., {self.motion_count}) for {self.name!r},"
                    f" got {array.shape}"
                )
        dtype = jnp.result_type(float, *arrays) if not arrays else jnp.result_type(*arrays)
        if not jnp.issubdtype(dtype, jnp.floating):
            dtype = jnp.result_type(float)
        coefficients = jnp.zeros(0, dtype) if k is None else jnp.asarray(k)
        if k is not None and coefficients.shape != (self.size,):
            raise ValueError(f"k: expected shape ({self.size},), got {coefficients.shape}")
        shape = jnp.broadcast_shapes(*(array.shape for array in arrays))
        return (
            coefficients.astype(dtype),
            *(jnp.broadcast_to(array.astype(dtype), shape) for array in arrays),
        )
