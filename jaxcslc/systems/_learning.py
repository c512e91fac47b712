from typing import Any

import equinox as eqx
import jax.numpy as jnp

from ..adaptive import LINEAR_COMBINER, AdaptiveNetwork, Layer, Links, Signals, Subnetwork
from ._network import SystemNetwork


class SystemInputs(eqx.Module):
    """The preprocessing of a system's network: motion to functions of the variables.

    Takes patterns with `q`, `qd` and `qdd`, (..., v) each, or the three as a tuple.

    **Raises** `ValueError` if they are not of one such shape.
    """

    network: SystemNetwork

    def __call__(self, patterns: Any) -> Signals:
        arrays = patterns if isinstance(patterns, tuple) else _motion(patterns)
        shapes = [jnp.shape(x) for x in arrays]
        count = self.network.motion_count
        if len(arrays) != 3 or len(set(shapes)) != 1 or shapes[0][-1:] != (count,):
            raise ValueError(
                f"motion: expected q, qd and qdd of one shape (..., {count}), got"
                f" {', '.join(map(str, shapes))}"
            )
        q, qd, qdd = (list(jnp.moveaxis(jnp.asarray(x, float), -1, 0)) for x in arrays)
        return Signals((jnp.stack(self.network.terms[0].inputs(q, qd, qdd)),), ((),))


def adaptive_network(network: SystemNetwork) -> AdaptiveNetwork:
    """The network of a system as one that every rule of `jaxcslc.training` trains.

    One layer of linear combiners: an output node for each equation, the functions of the variables
    as inputs, and the coefficients as weights, which equations share.

    **Returns** an `AdaptiveNetwork` whose weights are `k`, in its order.

    >>> import jax.numpy as jnp, sympy
    >>> from sympy.physics.mechanics import dynamicsymbols
    >>> from jaxcslc.systems import Constant, System, Variable, adaptive_network
    >>> x, force = dynamicsymbols("x force")
    >>> mass, damping = sympy.symbols("mass damping")
    >>> equation = sympy.Eq(force, mass * x.diff().diff() + damping * x.diff())
    >>> variables, constants = (Variable(x), Variable(force)), (Constant(mass), Constant(damping))
    >>> network = System("cart", {"rail": equation}, variables, constants).network
    >>> k, motion = jnp.array([0.5, 2.0]), (jnp.ones((3, 2)),) * 3
    >>> adaptive_network(network).outputs(k, motion)[:, 0].tolist()
    [2.5, 2.5, 2.5]
    """
    entries = network.terms[0].entries
    links = Links(
        len(entries),
        network.joint_count,
        range(len(entries)),
        [output for output, _ in entries],
        [coefficient for _, coefficient in entries],
    )
    parts = (Subnetwork("system", (Layer(links),)),)
    return AdaptiveNetwork(parts, SystemInputs(network), LINEAR_COMBINER, network.names)


def _motion(patterns: Any) -> tuple[Any, ...]:
    return tuple(getattr(patterns, name) for name in ("q", "qd", "qdd"))
