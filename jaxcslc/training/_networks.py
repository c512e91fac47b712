"""Networks of common structures: fully connected, the CSLC as the thesis draws it, linear ones.

`signed_start` and `subnetwork_masks` prepare the training of a CSLC (thesis 5.2.3, 7.2.2).
"""

from collections.abc import Callable, Sequence
from itertools import pairwise
from typing import Any

import equinox as eqx
import jax
import jax.numpy as jnp
import numpy as np
from jaxtyping import Array, Bool, Float, Real

from ..derivation import ProductTable
from ..network import CSLC, JAX_FUNCTIONS, LOAD, AbstractLinearNetwork, input_rows
from ..recordings import Patterns
from ._functions import LINEAR_COMBINER, Activation, activation_named
from ._network import AdaptiveNetwork, ContextLayer, Layer, Links, Signals, Subnetwork


Inputs = Real[Array | np.ndarray, "... inputs"]


class Preprocessed(eqx.Module):
    """Patterns (..., inputs), acted upon by a function of theirs, for a network of one part.

    **Attributes**

    - `inputs`: how many the function takes.
    - `function`: (..., inputs) to (..., processed inputs), or none.
    """

    inputs: int = eqx.field(static=True)
    function: Callable[[Array], Array] | None = None

    def __call__(self, patterns: Inputs) -> Signals:
        values = jnp.asarray(patterns)
        if values.ndim == 0 or values.shape[-1] != self.inputs:
            raise ValueError(f"inputs: expected shape (..., {self.inputs}), got {values.shape}")
        if not jnp.issubdtype(values.dtype, jnp.floating):
            values = values.astype(jnp.result_type(float))
        if self.function is not None:
            values = self.function(values)
        return Signals((jnp.moveaxis(values, -1, 0),), ((),))


def fully_connected(
    sizes: Sequence[int],
    activations: str | Activation | Sequence[str | Activation],
    *,
    bias: bool = True,
    preprocess: Callable[[Array], Array] | None = None,
) -> AdaptiveNetwork:
    """Return a network of one or more layers in which every input feeds every node (thesis 3.1).

    Weights are numbered layer by layer, node by node, the bias last.

    **Arguments**

    - `sizes`: number of inputs, then of each layer's nodes.
    - `activations`: of each layer's nodes, or one for all: `"hard limiter"`,
      `"linear combiner"`, `"logistic"`, `"hyperbolic tangent"`, or an `Activation`.
    - `bias`: whether every layer has a constant input of one.
    - `preprocess`: a function of the inputs, (..., inputs) to (..., processed), that stands
      before the first layer (3.3.4), such as `PolynomialTerms` or `RadialBasis`.

    **Raises** `ValueError` for fewer than two sizes, sizes below one, a wrong number of
    activations, or an unknown one.

    >>> from jaxcslc.training import fully_connected
    >>> fully_connected([25, 10], "hyperbolic tangent").size  # 25 inputs and a bias, to ten nodes
    260
    """
    if len(sizes) < 2 or min(sizes) < 1:
        raise ValueError(f"sizes: expected inputs and nodes, at least [1, 1], got {list(sizes)}")
    if isinstance(activations, str | Activation):
        activations = [activations] * (len(sizes) - 1)
    if len(activations) != len(sizes) - 1:
        raise ValueError(
            f"activations: expected one a layer, {len(sizes) - 1}, got {len(activations)}"
        )
    kinds = [activation_named(activation) for activation in activations]
    processed = sizes[0]
    if preprocess is not None:
        probe = jax.ShapeDtypeStruct((sizes[0],), jnp.result_type(float))
        processed = jax.eval_shape(preprocess, probe).shape[-1]
    counts = [processed, *sizes[1:]]
    layers: list[Layer] = []
    names: list[str] = []
    last = len(counts) - 2
    for number, (inputs, nodes) in enumerate(pairwise(counts)):
        links = Links.full(inputs + bias, nodes, first=len(names))
        layers.append(
            Layer(links, kinds[number], bias) if number < last else Layer(links, bias=bias)
        )
        names += [
            f"layer {number + 1}, node {node + 1}, "
            + ("bias" if source == inputs else f"input {source + 1}")
            for node in range(nodes)
            for source in range(inputs + bias)
        ]
    return AdaptiveNetwork(
        (Subnetwork("network", tuple(layers)),),
        Preprocessed(sizes[0], preprocess),
        kinds[-1],
        tuple(names),
    )


class InverseDynamicsInputs(eqx.Module):
    """The preprocessing of a CSLC: motion to products of sines and cosines, and contexts.

    Takes patterns with `q`, `qd` and `qdd`, (..., n) each, or the three as a tuple.

    **Raises** `ValueError` if they are not of one such shape.
    """

    network: CSLC

    def __call__(self, patterns: Any) -> Signals:
        return _signals(self.network, *_motion(patterns, self.network.joint_count))


def _motion(patterns: Any, count: int) -> tuple[Float[Array, "*batch motion"], ...]:
    """Return q, qd and qdd of patterns, or of a tuple of them: (..., count) each, floats."""
    names = ("q", "qd", "qdd")
    arrays = patterns if isinstance(patterns, tuple) else [getattr(patterns, x) for x in names]
    motion = [jnp.asarray(x) for x in arrays]
    shapes = [x.shape for x in motion]
    if len(motion) != 3 or len(set(shapes)) != 1 or shapes[0][-1:] != (count,):
        raise ValueError(
            f"motion: expected q, qd and qdd of one shape (..., {count}), got"
            f" {', '.join(map(str, shapes))}"
        )
    dtype = jnp.result_type(*motion)
    if not jnp.issubdtype(dtype, jnp.floating):
        dtype = jnp.result_type(float)
    return tuple(x.astype(dtype) for x in motion)


@eqx.filter_jit
def _signals(
    network: CSLC,
    q: Float[Array, "*batch joints"],
    qd: Float[Array, "*batch joints"],
    qdd: Float[Array, "*batch joints"],
) -> Signals:
    """Compute the subnetworks' inputs and contexts for a motion, units first."""
    q, qd, qdd = (jnp.moveaxis(x, -1, 0) for x in (q, qd, qdd))
    algebra = network.algebra
    tables = (algebra.mass, algebra.velocity, algebra.gravity)
    row_of: dict[tuple[int, ...], int] = {}
    for table in tables:
        for monomial in table.inputs:
            row_of.setdefault(monomial, len(row_of))
    values = input_rows(algebra.ring, tuple(row_of), list(q))
    mass, velocity, gravity = (
        values[np.array([row_of[monomial] for monomial in table.inputs], int)] for table in tables
    )
    motion = [list(x) for x in (q, qd, qdd)]
    friction = [jnp.stack(term.inputs(JAX_FUNCTIONS, *motion)) for term in network.input_terms]
    present = [(mass, (qdd,)), (velocity, (qd, qd)), (gravity, ())]
    parts = [part for part, table in zip(present, tables, strict=True) if table.links]
    parts += [(term, ()) for term in friction]
    return Signals(tuple(x for x, _ in parts), tuple(context for _, context in parts))


def inverse_dynamics(network: CSLC) -> AdaptiveNetwork:
    """Return the CSLC as the adaptive network that the thesis draws (5.1, Figs. 5.1-1 to 5.1-6).

    Five subnetworks, superposed: mass, velocity, gravity, viscous and dry friction (and one for
    each other term of the robot's friction model, two where it tells directions apart). The mass
    subnetwork's linear combiners are the elements of M(q), and accelerations weigh them; the
    velocity subnetwork's are the Christoffel symbols, which velocities weigh twice, over the
    velocity matrix C (Eqns. 5.1-5, 5.1-6). Mass and velocity share their coefficients. The
    weights are the coefficients `k`, in their order.

    There is no subnetwork without links, such as the gravity of a robot that lies flat.

    >>> import jax.numpy as jnp, jaxcslc as jc
    >>> from jaxcslc.training import inverse_dynamics
    >>> cslc = jc.derive(jc.puma560())
    >>> network = inverse_dynamics(cslc)
    >>> network.groups
    ('mass', 'velocity', 'gravity', 'viscous', 'dry')
    >>> k, x = jnp.ones(43), jnp.ones((3, 6))
    >>> bool(jnp.allclose(network.outputs(k, (x, x, x)), cslc.torque(k, x, x, x)))
    True
    """
    algebra, n = network.algebra, network.joint_count
    parts: list[Subnetwork] = []
    if algebra.mass.links:
        columns, links = _linked(algebra.mass)
        parts.append(Subnetwork("mass", (Layer(links),), (_mass_context(columns, n),)))
    if algebra.velocity.links:
        columns, links = _linked(algebra.velocity)
        parts.append(Subnetwork("velocity", (Layer(links),), _velocity_contexts(columns, n)))
    if algebra.gravity.links:
        columns, links = _linked(algebra.gravity)
        joints = Links(
            links.inputs,
            n,
            links.source,
            [columns[node][0] for node in links.node],
            links.weight,
            links.multiple,
        )
        parts.append(Subnetwork("gravity", (Layer(joints),)))
    for term in network.input_terms:
        m = len(term.input_joints)
        weights = network.layout.indices(term.kind)[list(term.input_indices)]
        links = Links(m, n, range(m), term.input_joints, weights.tolist())
        parts.append(Subnetwork(term.kind, (Layer(links),)))
    return AdaptiveNetwork(
        tuple(parts), InverseDynamicsInputs(network), LINEAR_COMBINER, network.names
    )


def subnetwork_masks(
    network: AdaptiveNetwork, patterns: Patterns
) -> Bool[np.ndarray, "subnetworks samples joints"]:
    """Return which pairs of sample and joint each subnetwork learns from (thesis 7.2.2).

    Static friction, which viscous and Coulomb friction cannot explain, matters at slow pairs. It
    averages out in the mass, velocity and gravity subnetworks, and does not in those of friction.
    So friction learns from the pairs of `patterns.mask`. The other subnetworks also learn from
    slow pairs. Pairs in possible backlash are excluded from all.

    **Arguments**

    - `network`: from `inverse_dynamics`. Friction is what its robot's friction model names, except
      springs.
    - `patterns`: n joints.

    **Returns**

    True where a pair counts, shape `(subnetworks, samples, n)`: the `counts` of
    `jaxcslc.training.examples`.

    **Raises** `ValueError`: for another network, whose subnetworks are not of inverse dynamics.

    >>> import numpy as np, jaxcslc as jc
    >>> from jaxcslc.training import inverse_dynamics, subnetwork_masks
    >>> network = inverse_dynamics(jc.derive(jc.puma560()))
    >>> motion, slow = np.ones((2, 6)), np.array([[True] * 6, [False] * 6])
    >>> patterns = jc.Patterns(np.arange(2.0), *[motion] * 4, motion > 0, slow)
    >>> masks = subnetwork_masks(network, patterns)
    >>> dict(zip(network.groups, masks[:, 1, 0].tolist()))
    {'mass': True, 'velocity': True, 'gravity': True, 'viscous': False, 'dry': False}
    """
    inputs = network.preprocess
    if not isinstance(inputs, InverseDynamicsInputs):
        raise ValueError(
            "masks by subnetwork: expected a network from `inverse_dynamics`, got one with other"
            f" subnetworks: {', '.join(part.name for part in network.subnetworks)}"
        )
    friction = {
        term.kind
        for term in inputs.network.input_terms
        if not {"friction", LOAD}.isdisjoint(term.parts)
    }
    mask, backlash_mask = np.asarray(patterns.mask), np.asarray(patterns.backlash_mask)
    return np.stack(
        [mask if part.name in friction else backlash_mask for part in network.subnetworks]
    )


def _linked(table: ProductTable) -> tuple[list[tuple[int, ...]], Links]:
    """The nodes of a table that have links, and the links: one for each weight of each link."""
    nodes = sorted({link.column for link in table.links})
    node_of = {column: node for node, column in enumerate(nodes)}
    link_table = [
        (link.input, node_of[link.column], coefficient, float(multiple))
        for link in table.links
        for coefficient, multiple in link.weights
    ]
    source, node, weight, multiple = (list(part) for part in zip(*link_table, strict=True))
    links = Links(len(table.inputs), len(nodes), source, node, weight, multiple)  # pyright: ignore[reportArgumentType]
    return [table.columns[column] for column in nodes], links


def _mass_context(columns: Sequence[tuple[int, ...]], n: int) -> ContextLayer:
    """M_ij to torque i weighed by qdd_j, and to torque j by qdd_i (5.1.1)."""
    link_table = [
        link
        for node, (i, j) in enumerate(columns)
        for link in ([(node, i, j)] if i == j else [(node, i, j), (node, j, i)])
    ]
    return _context(len(columns), n, n, link_table)


def _velocity_contexts(
    columns: Sequence[tuple[int, ...]], n: int
) -> tuple[ContextLayer, ContextLayer]:
    """c_ijk to C_ij weighed by qd_k, and to C_ik by qd_j; C_ij to V_i weighed by qd_j (5.1.2)."""
    elements = sorted({(i, j) for i, *pair in columns for j in pair})
    node_of = {element: node for node, element in enumerate(elements)}
    inner = [
        link
        for node, (i, j, k) in enumerate(columns)
        for link in (
            [(node, node_of[i, j], k)]
            if j == k
            else [(node, node_of[i, j], k), (node, node_of[i, k], j)]
        )
    ]
    outer = [(node, i, j) for node, (i, j) in enumerate(elements)]
    return (
        _context(len(columns), len(elements), n, inner),
        _context(len(elements), n, n, outer),
    )


def _context(
    inputs: int, nodes: int, contexts: int, link_table: Sequence[tuple[int, int, int]]
) -> ContextLayer:
    source, node, context = zip(*link_table, strict=True)
    return ContextLayer(inputs, nodes, contexts, source, node, context)


class RegressorInputs(eqx.Module):
    """The preprocessing of a network that is linear in its coefficients: what multiplies them.

    Takes patterns with `q`, `qd` and `qdd`, (..., m) each, or the three as a tuple.

    **Raises** `ValueError` if they are not of one such shape.
    """

    network: AbstractLinearNetwork

    def __call__(self, patterns: Any) -> Signals:
        count = self.network.motion_count
        q, qd, qdd = (x.astype(float) for x in _motion(patterns, count))
        rows = self.network.columns(*(x.reshape(-1, count).T for x in (q, qd, qdd)))
        inputs = jnp.concatenate(rows)
        return Signals((inputs.reshape(-1, *q.shape[:-1]),), ((),))


def linear_combiner(network: AbstractLinearNetwork) -> AdaptiveNetwork:
    """Make an adaptive network of any network that is linear in its coefficients.

    One layer of linear combiners: an output node for each output, the entries of the regressor as
    inputs, and the coefficients as weights, which outputs share. For the inverse dynamics of a
    robot, `inverse_dynamics` gives the structure that the thesis draws; this is for other systems
    (`jaxcslc.systems`).

    **Returns** an `AdaptiveNetwork` whose weights are `k`, in its order.

    >>> import jax.numpy as jnp, jaxcslc as jc
    >>> from jaxcslc.training import linear_combiner
    >>> cslc = jc.derive(jc.examples.pendulum(), lengths="numeric")
    >>> k, x = jnp.arange(5.0), jnp.ones((3, 1))
    >>> outputs = linear_combiner(cslc).outputs(k, (x, x, x))
    >>> bool(jnp.allclose(outputs, cslc.torque(k, x, x, x)))
    True
    """
    weights = [index for support in network.support for index in support]
    nodes = [output for output, support in enumerate(network.support) for _ in support]
    links = Links(len(weights), network.joint_count, range(len(weights)), nodes, weights)
    parts = (Subnetwork(network.output_quantity, (Layer(links),)),)
    return AdaptiveNetwork(parts, RegressorInputs(network), LINEAR_COMBINER, network.names)
