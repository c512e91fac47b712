"""The rigid-body term from the tables of its closed form, and the preprocessing layer."""

from collections.abc import Sequence
from functools import lru_cache
from itertools import chain, pairwise

import equinox as eqx
import jax.numpy as jnp
import numpy as np
from jaxtyping import Array, Float

from jaxcslc._environment import array_namespace
from jaxcslc.codegen import Motion, StraightLine, motion_outputs
from jaxcslc.derivation import Algebra, Coefficient, PositionRing, ProductTable

from ._closed_form import ClosedForm, Monomial, position_variables
from ._expressed_bodies import AbstractRigidBody, code
from ._input_term import by_joint
from ._term import Coefficients, Joints, Rows


Samples = Float[Array | np.ndarray, "*batch"]


class RigidBodyTables(AbstractRigidBody):
    """The CSLC as the thesis draws it: preprocessed inputs, links, context-sensitive layers.

    Straight-line code over one array per quantity and joint, so that a batch is the only axis
    there is.
    """

    mass: ProductTable = eqx.field(static=True)
    velocity: ProductTable = eqx.field(static=True)
    gravity: ProductTable = eqx.field(static=True)
    ring: PositionRing = eqx.field(static=True)
    coefficients: tuple[Coefficient, ...] = eqx.field(static=True)
    joint_count: int = eqx.field(static=True)
    kind: str = eqx.field(static=True, default="rigid_body")

    @classmethod
    def from_algebra(cls, algebra: Algebra) -> "RigidBodyTables":
        return cls(
            mass=algebra.mass,
            velocity=algebra.velocity,
            gravity=algebra.gravity,
            ring=algebra.ring,
            coefficients=algebra.coefficients,
            joint_count=algebra.robot.joint_count,
        )

    @property
    def has_tables(self) -> bool:
        return True

    @property
    def support(self) -> tuple[tuple[int, ...], ...]:
        return _support(self.mass, self.velocity, self.gravity, self.joint_count)

    def expressed(self, motion: Motion) -> ClosedForm:
        return ClosedForm(motion, self)

    def christoffel_symbols(
        self, k: Float[Array, " coefficients"], q: Float[Array, "*batch joints"]
    ) -> dict[tuple[int, ...], Samples]:
        """The symbols c_ijk, j <= k, that are not identically zero (Eqn. 2.4-5)."""
        motion = Motion(self.joint_count)
        symbols = self.expressed(motion).christoffel_symbols(motion.graph.inputs("k", self.size))
        symbols_code = StraightLine(motion, tuple(symbols.values()))
        return dict(zip(symbols, motion_outputs(symbols_code, k, by_joint(q)), strict=True))

    def _values(
        self, quantity: str, k: Coefficients | None, *motion: Joints
    ) -> Float[Array, "*batch values"]:
        return jnp.stack(self._outputs(quantity, k, *map(by_joint, motion)), axis=-1)

    def _column_rows(self, q: Rows, qd: Rows, qdd: Rows) -> Float[Array, "rows samples"]:
        return jnp.stack(self._outputs("columns", None, list(q), list(qd), list(qdd)))

    def _outputs(
        self, quantity: str, k: Coefficients | None, *motion: Sequence[Samples]
    ) -> list[Samples]:
        """Arrays of a quantity, all of the motion's shape."""
        # All at once but sines and cosines: in stages they take three times as long to compile.
        return motion_outputs(code(self, quantity), k, *motion, stage=None)


@lru_cache(maxsize=64)  # tables are compared by identity
def _support(
    mass: ProductTable, velocity: ProductTable, gravity: ProductTable, joints: int
) -> tuple[tuple[int, ...], ...]:
    """Return, for each joint, the coefficients of the elements that enter its torque."""
    reach: list[set[int]] = [set() for _ in range(joints)]
    for table, outputs in ((mass, 2), (velocity, 1), (gravity, 1)):
        for link in table.links:
            for joint in table.columns[link.column][:outputs]:
                reach[joint] |= {coefficient for coefficient, _ in link.weights}
    return tuple(tuple(sorted(coefficients)) for coefficients in reach)


def product_rows(
    monomials: Sequence[Monomial], variables: Float[Array, " variables *batch"]
) -> Float[Array, " monomials *batch"]:
    """`products` as one array: one gathered product for each degree.

    A Panda's tables have 9,500 monomials. Written out, they are that many operations, which XLA
    compiles for 50 s on one core; this is two operations for each of some fifteen degrees, and
    half a second.
    """
    degrees: list[list[Monomial]] = [[(0,) * len(variables)]]
    parents: dict[Monomial, tuple[Monomial, int]] = {}
    pending = list(monomials)
    while pending:
        monomial = pending.pop()
        if monomial in parents or not any(monomial):
            continue
        last = max(index for index, power in enumerate(monomial) if power)
        shorter = (*monomial[:last], monomial[last] - 1, *monomial[last + 1 :])
        parents[monomial] = shorter, last
        pending.append(shorter)
    for monomial in sorted(parents, key=lambda monomial: (sum(monomial), monomial)):
        if sum(monomial) == len(degrees):
            degrees.append([])
        degrees[-1].append(monomial)
    levels = [jnp.ones_like(variables[:1])]
    for shorter, level in pairwise(degrees):
        index = {monomial: row for row, monomial in enumerate(shorter)}
        factors = [(index[before], last) for before, last in map(parents.__getitem__, level)]
        before, last = np.array(factors).T
        levels.append(levels[-1][before] * variables[last])
    rows = {monomial: row for row, monomial in enumerate(chain.from_iterable(degrees))}
    order = np.array([rows[monomial] for monomial in monomials], int)
    return jnp.concatenate(levels)[order]


def input_rows(
    ring: PositionRing, monomials: Sequence[Monomial], q: Sequence[Samples]
) -> Float[Array, " monomials *batch"]:
    """The preprocessing layer as one array: quick to compile, however many monomials there are.

    **Arguments**

    - `ring`: of the positions, `algebra.ring` of a network.
    - `monomials`: powers of the ring's variables, such as `algebra.mass.inputs`.
    - `q`: positions, one array a joint [rad or m].

    **Returns** their values, a row a monomial.

    >>> import jax.numpy as jnp, jaxcslc as jc
    >>> from jaxcslc.network import input_rows
    >>> algebra = jc.derive(jc.puma560()).algebra
    >>> input_rows(algebra.ring, algebra.mass.inputs, list(jnp.zeros((6, 100)))).shape
    (59, 100)
    """
    xp = array_namespace(*q)
    variables = position_variables(ring, q, xp.cos, xp.sin)
    return product_rows(monomials, jnp.stack(variables))
