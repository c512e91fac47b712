import abc
from collections.abc import Callable, Mapping, Sequence
from functools import cached_property
from typing import Any

import equinox as eqx
import jax
import jax.numpy as jnp
import numpy as np
from jax.core import Tracer
from jaxtyping import Array, Float

from .._environment import array_namespace, require_float64
from ..derivation import Coefficient
from ._layout import Layout, layout_of
from ._least_patterns import least_patterns
from .terms import AbstractTerm


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
        """What an output is called: `"joint"`, `"equation"`."""

    @property
    @abc.abstractmethod
    def output_quantity(self) -> str:
        """What the outputs are, as a heading says it: `"torque"`, `"equations"`."""

    @property
    @abc.abstractmethod
    def output_labels(self) -> tuple[str, ...]:
        """What tells the outputs apart: of a robot, its joints."""

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
        """Which entries of `k` are which coefficients."""
        return layout_of(self.terms)

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

    def torque(self, k: Vector, q: Motion, qd: Motion, qdd: Motion) -> Float[Array, "..."]:
        """The output of the whole network, (..., n): of a robot, every joint's torque [N m].

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
        """The matrix that `k` is multiplied by: `regressor @ k == torque`, (..., n, p)."""
        _, q, qd, qdd = self._checked(None, q, qd, qdd)
        return jnp.concatenate([term.regressor(q, qd, qdd) for term in self.terms], axis=-1)

    @cached_property
    def support(self) -> tuple[tuple[int, ...], ...]:
        """For each output, the coefficients that it can depend on, in ascending order."""
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
        """Whether `columns` computes NumPy's arrays by NumPy, so that nothing is compiled.

        False where a term cannot, and while JAX traces the network's own numbers.
        """
        traced = any(isinstance(leaf, Tracer) for leaf in jax.tree.leaves(self))
        return not traced and all(term.has_host_columns for term in self.terms)

    def columns(self, q: MotionRows, qd: MotionRows, qdd: MotionRows) -> Columns:
        """The regressor without what is always zero: for each output, (its support, samples).

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
        """`columns`, which each term writes where they belong: there is nothing to join."""
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
        shares = [share(term, k[layout.of(term)]) for term in terms]
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
