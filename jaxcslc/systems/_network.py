"""A system as a network of exactly its form: the fourth stage (thesis C.2)."""

from typing import Any

import equinox as eqx
import jax.numpy as jnp
import numpy as np
from jaxtyping import Array, Float

from .._text_table import counted
from ..derivation import Coefficient
from ..network import AbstractLinearNetwork, AbstractTerm, content_hash
from ._system import Formulas, System


Motion = Float[Array | np.ndarray, "... variables"]
Outputs = Float[Array, "*batch outputs"]
Batch = Float[Array, "*batch variables"]
Rows = Float[Array | np.ndarray, "variables samples"]


class SystemTerm(AbstractTerm):
    """Coefficients of a system, and the functions of the variables that multiply them.

    **Attributes**

    - `nonlinear`: values of the searched constants, in the order of `System.nonlinear`.
    - `entries`: (equation, coefficient) of each function that is not zero.
    - `formulas`: these functions.
    - `output_count`: n.
    """

    nonlinear: Float[Array | np.ndarray, " nonlinear"]
    coefficients: tuple[Coefficient, ...] = eqx.field(static=True)
    entries: tuple[tuple[int, int], ...] = eqx.field(static=True)
    formulas: Formulas = eqx.field(static=True)
    output_count: int = eqx.field(static=True)
    kind: str = eqx.field(static=True, default="system")

    @property
    def parts(self) -> tuple[str, ...]:
        return ()

    @property
    def support(self) -> tuple[tuple[int, ...], ...]:
        return tuple(
            tuple(sorted(j for output, j in self.entries if output == i))
            for i in range(self.output_count)
        )

    def __hash__(self) -> int:
        return content_hash(self.formulas, self.nonlinear)

    def _values(self, *motion: Batch) -> dict[tuple[int, int], Any]:
        """Return the value of each of `entries`."""
        return dict(zip(self.entries, self.formulas(motion, self.nonlinear), strict=True))

    def columns(
        self, q: Rows, qd: Rows, qdd: Rows
    ) -> tuple[Float[Array | np.ndarray, "_ samples"], ...]:
        values = self._values(*(jnp.asarray(x).T for x in (q, qd, qdd)))
        empty = jnp.zeros((0, q.shape[1]), q.dtype)
        return tuple(
            jnp.stack([values[i, j] for j in support]) if support else empty
            for i, support in enumerate(self.support)
        )

    def regressor(
        self, q: Batch, qd: Batch, qdd: Batch
    ) -> Float[Array, "*batch outputs coefficients"]:
        values = self._values(q, qd, qdd)
        zero = jnp.zeros(q.shape[:-1], q.dtype)
        rows = [
            jnp.stack([values.get((i, j), zero) for j in range(self.size)], axis=-1)
            for i in range(self.output_count)
        ]
        return jnp.stack(rows, axis=-2)

    def torque(self, k: Float[Array, " coefficients"], q: Batch, qd: Batch, qdd: Batch) -> Outputs:
        totals = [jnp.zeros(q.shape[:-1], q.dtype) for _ in range(self.output_count)]
        for (i, j), value in self._values(q, qd, qdd).items():
            totals[i] = totals[i] + k[j] * value
        return jnp.stack(totals, axis=-1)


class SystemNetwork(AbstractLinearNetwork):
    """A system as a network of exactly its form: the fourth stage (thesis C.2).

    Inputs are the known variables, weights the minimal set of unknown constants, outputs the known
    sides of the equations: linear in the weights, so that a sum of squares has a single minimum.
    Solver, reports and learning rules take it as they take a `CSLC`. Motion has one column a
    variable of the system, in their order: `q` values, `qd` and `qdd` derivatives; derivatives of
    inputs are not used.

    Built by `System.network`.

    **Attributes**

    - `system`: what it was made from.
    - `terms`: one `SystemTerm`.
    - `known_sides`: what the equations equate the network's outputs to.

    >>> import numpy as np, jaxcslc as jc
    >>> network = jc.examples.tank()[0].network
    >>> network.names, network.variables
    (('area', 'outlet'), ('level', 'inflow'))
    >>> k, q, qd = np.array([3.0, 0.5]), np.array([4.0, 0.0]), np.array([1.0, 0.0])
    >>> float(network.torque(k, q, qd, 0.0 * q)[0])
    4.0
    """

    terms: tuple[SystemTerm]
    system: System = eqx.field(static=True)
    known_sides: Formulas = eqx.field(static=True)

    @classmethod
    def of(cls, system: System) -> "SystemNetwork":
        """Return the network of a system."""
        separation = system.separation
        entries = tuple(
            (i, j)
            for i, row in enumerate(separation.regressor)
            for j, expression in enumerate(row)
            if expression != 0
        )
        term = SystemTerm(
            nonlinear=np.array(system.middles, float),
            coefficients=separation.coefficients,
            entries=entries,
            formulas=Formulas.of(system, [separation.regressor[i][j] for i, j in entries]),
            output_count=len(separation.outputs),
        )
        return cls((term,), system, Formulas.of(system, separation.known))

    @property
    def name(self) -> str:
        return self.system.name

    @property
    def output_kind(self) -> str:
        return "equation"

    @property
    def output_quantity(self) -> str:
        return "known sides"

    @property
    def output_labels(self) -> tuple[str, ...]:
        """Names of the equations."""
        return self.system.outputs

    @property
    def output_units(self) -> tuple[str, ...]:
        return tuple(self.system.output_units.get(name, "") for name in self.system.outputs)

    @property
    def motion_count(self) -> int:
        """Number of columns of the motion, one per variable."""
        return len(self.system.variables)

    @property
    def variables(self) -> tuple[str, ...]:
        """Names of the variables: of the columns of the motion."""
        return tuple(variable.name for variable in self.system.variables)

    @property
    def highest(self) -> tuple[int, ...]:
        """Order of the highest derivative of each variable in the equations: 0, 1 or 2."""
        used = (*self.terms[0].formulas.symbols, *self.known_sides.symbols)
        return tuple(
            max((order for index, order in used if index == variable), default=0)
            for variable in range(self.motion_count)
        )

    @property
    def nonlinear(self) -> Float[Array | np.ndarray, " nonlinear"]:
        """Values of the searched constants, in the order of `System.nonlinear`."""
        return self.terms[0].nonlinear

    def with_nonlinear(self, values: Float[Array | np.ndarray, " nonlinear"]) -> "SystemNetwork":
        """Return the network with other values of the searched constants.

        Can be jitted, vmapped and differentiated.
        """
        if jnp.shape(values) != self.nonlinear.shape:
            raise ValueError(
                f"nonlinear: expected shape {self.nonlinear.shape}, got {jnp.shape(values)}"
            )
        new = values if isinstance(values, Array) else np.asarray(values, float)
        return eqx.tree_at(lambda network: network.terms[0].nonlinear, self, new)

    def known(self, q: Motion, qd: Motion, qdd: Motion) -> Float[Array, "..."]:
        """Return the known sides of the equations, (..., n): what `torque` is fitted to."""
        _, *motion = self._checked(None, q, qd, qdd)
        return jnp.stack(self.known_sides(motion, self.nonlinear), axis=-1)

    def residual(
        self, k: Float[Array | np.ndarray, " coefficients"], q: Motion, qd: Motion, qdd: Motion
    ) -> Float[Array, "..."]:
        """Return the error of the equations, (..., n): the known side less `torque`."""
        return self.known(q, qd, qdd) - self.torque(k, q, qd, qdd)

    @property
    def order_per_joint(self) -> tuple[int, ...]:
        """Number of independent combinations of coefficients in each equation (5.2.5)."""
        return self.system.separation.order_per_output

    @property
    def order(self) -> int:
        """Network order (thesis 4.2): the combinations of coefficients of the equation with most.

        As many independent patterns determine these from that equation alone. Where equations
        share coefficients, all together need fewer patterns: `least_patterns`.
        """
        return max(self.order_per_joint)

    def __repr__(self) -> str:
        return (
            f"SystemNetwork({self.name}: {counted(self.joint_count, 'equation')},"
            f" {counted(self.motion_count, 'variable')}, {counted(self.size, 'coefficient')})"
        )
