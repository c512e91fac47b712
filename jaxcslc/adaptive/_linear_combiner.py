from typing import Any

import equinox as eqx
import jax.numpy as jnp

from ..network import AbstractLinearNetwork
from ._activations import LINEAR_COMBINER
from ._layers import Layer
from ._links import Links
from ._network import AdaptiveNetwork, Signals, Subnetwork


class RegressorInputs(eqx.Module):
    """The preprocessing of a network that is linear in its coefficients: what multiplies them.

    Takes patterns with `q`, `qd` and `qdd`, (..., m) each, or the three as a tuple.

    **Raises** `ValueError` if they are not of one such shape.
    """

    network: AbstractLinearNetwork

    def __call__(self, patterns: Any) -> Signals:
        names = ("q", "qd", "qdd")
        motion = patterns if isinstance(patterns, tuple) else [getattr(patterns, x) for x in names]
        arrays = [jnp.asarray(x, float) for x in motion]
        shapes, count = [x.shape for x in arrays], self.network.motion_count
        if len(arrays) != 3 or len(set(shapes)) != 1 or shapes[0][-1:] != (count,):
            raise ValueError(
                f"motion: expected q, qd and qdd of one shape (..., {count}), got"
                f" {', '.join(map(str, shapes))}"
            )
        rows = self.network.columns(*(x.reshape(-1, count).T for x in arrays))
        inputs = jnp.concatenate(rows)
        return Signals((inputs.reshape(-1, *shapes[0][:-1]),), ((),))


def linear_combiner(network: AbstractLinearNetwork) -> AdaptiveNetwork:
    """Any network that is linear in its coefficients as one that every learning rule trains.

    One layer of linear combiners: an output node for each output, the entries of the regressor as
    inputs, and the coefficients as weights, which outputs share. For the inverse dynamics of a
    robot, `inverse_dynamics` gives the structure that the thesis draws; this is for other systems
    (`jaxcslc.systems`).

    **Returns** an `AdaptiveNetwork` whose weights are `k`, in its order.

    >>> import jax.numpy as jnp, jaxcslc as jc
    >>> from jaxcslc.adaptive import linear_combiner
    >>> pendulum = jc.Manipulator.from_modified_dh([(0, 0, 0, 0)], gravity=(0, -9.81, 0))
    >>> cslc = jc.derive(pendulum, lengths="numeric")
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
