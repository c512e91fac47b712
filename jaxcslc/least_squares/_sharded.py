"""Patterns that are spread over several devices, and their factors."""

import functools
from collections.abc import Callable, Sequence
from typing import Any

import equinox as eqx
import jax
import jax.numpy as jnp
import numpy as np
from jax.sharding import Mesh, NamedSharding, PartitionSpec
from jaxtyping import Array, Float

from ..network import AbstractLinearNetwork
from ..recordings import Patterns
from ._correction import residual_sums
from ._factors import JointFactors, factorise, joined_factors
from ._preconditioned import (
    Preconditioner,
    packed,
    packed_products,
    refined,
    sample_products,
    unpacked,
)


_AXIS = "patterns"


def shard_patterns(patterns: Patterns, devices: Sequence[Any] | None = None) -> Patterns:
    """Patterns spread over several devices, for `LeastSquares(errors="independent").fit`.

    Each device then factorises its patterns, and their triangles are joined. Under
    `jax.distributed`, every process calls this with the patterns that it has read, as many as
    the others have, and `fit` gives every process the fit of all.

    **Arguments**

    - `patterns`: (samples, n); those of this process. Filled up with patterns outside of the
      mask to a multiple of this process's devices.
    - `devices`: of all processes; all there are if None.

    **Returns** the same patterns, as JAX's arrays, sharded along samples.

    >>> import numpy as np, jaxcslc as jc
    >>> motion, mask = np.ones((5, 6)), np.ones((5, 6), bool)
    >>> patterns = jc.Patterns(np.arange(5.0), motion, motion, motion, motion, mask, mask)
    >>> sharded = jc.least_squares.shard_patterns(patterns)
    >>> sharded.q.sharding.spec[0], int(sharded.mask.sum())
    ('patterns', 30)
    """
    devices = list(jax.devices()) if devices is None else list(devices)
    sharding = NamedSharding(Mesh(np.array(devices), (_AXIS,)), PartitionSpec(_AXIS))
    here = sum(device.process_index == jax.process_index() for device in devices)
    missing = -len(patterns.q) % here

    def spread(x: Array | np.ndarray) -> Array:
        x = np.pad(np.asarray(x), [(0, missing)] + [(0, 0)] * (x.ndim - 1))
        return jax.make_array_from_process_local_data(sharding, x)

    return jax.tree.map(spread, patterns)


def mesh_of(x: Array | np.ndarray) -> Mesh | None:
    """The devices that an array is spread over, None if it is on one, or on the host."""
    if not isinstance(x, jax.Array) or len(x.sharding.device_set) < 2:
        return None
    sharding = x.sharding
    if isinstance(sharding, NamedSharding) and sharding.spec[:1] == (_AXIS,):
        return Mesh(np.asarray(sharding.mesh.devices), (_AXIS,))
    return Mesh(np.array(sorted(sharding.device_set, key=lambda device: device.id)), (_AXIS,))


def factors_of_shards(
    network: AbstractLinearNetwork, motion: tuple[Array, ...], mesh: Mesh
) -> JointFactors:
    """The factors of patterns that are spread over devices: one triangle a device, joined.

    - `motion`: q, qd, qdd (samples, m), torque and weight (samples, n).
    """
    on_gpu = mesh.devices.flat[0].platform != "cpu"
    sample = np.asarray(_sample(network, mesh, on_gpu, *motion))
    preconditioner = Preconditioner.of_products(unpacked(network, sample))

    def products_behind(preconditioner: Preconditioner) -> Sequence[np.ndarray]:
        inverses = packed(preconditioner.inverses)
        return list(np.asarray(_products(network, inverses, mesh, on_gpu, *motion)))

    def reflected() -> JointFactors:
        *triangles, counts = (np.asarray(x) for x in _reflected(network, mesh, *motion))
        return joined_factors(
            [JointFactors(tuple(x[i] for x in triangles), counts[i]) for i in range(mesh.size)]
        )

    return refined(network, preconditioner, products_behind, reflected)[0]


def residual_sums_of_shards(
    network: AbstractLinearNetwork,
    k: Float[np.ndarray, " coefficients"],
    motion: tuple[Array, ...],
    mesh: Mesh,
) -> Float[np.ndarray, "devices 2 entries"]:
    """`residual_sums` of each device's patterns."""
    on_gpu = mesh.devices.flat[0].platform != "cpu"
    return np.asarray(_residual_sums(network, k, mesh, on_gpu, *motion))


@eqx.filter_jit
def _residual_sums(
    network: AbstractLinearNetwork, k: Any, mesh: Mesh, on_gpu: bool, *motion: Array
) -> Float[Array, "devices 2 entries"]:
    return _on_all(functools.partial(residual_sums, network, k, on_gpu=on_gpu), mesh, motion)


@eqx.filter_jit
def _sample(
    network: AbstractLinearNetwork, mesh: Mesh, on_gpu: bool, *motion: Array
) -> Float[Array, " packed"]:
    """The products of rows of some patterns of each device, packed."""

    # On each device by itself: slices across devices would bring all patterns to all of them.
    def of_device(*shard: Array) -> Array:
        return sample_products(network, len(shard[0]) * mesh.size, *shard, on_gpu=on_gpu)

    return jnp.sum(_on_all(of_device, mesh, motion), axis=0)


@eqx.filter_jit
def _products(
    network: AbstractLinearNetwork,
    inverses: Float[Array | np.ndarray, " packed"],
    mesh: Mesh,
    on_gpu: bool,
    *motion: Array,
) -> Float[Array, "devices numbers"]:
    return _on_all(
        functools.partial(packed_products, network, inverses, on_gpu=on_gpu), mesh, motion
    )


@eqx.filter_jit
def _reflected(
    network: AbstractLinearNetwork, mesh: Mesh, *motion: Array
) -> tuple[Float[Array, "devices _ _"], ...]:
    def of_device(*shard: Array) -> tuple[Array, ...]:
        factors = factorise(network, *shard)
        return (*map(jnp.asarray, factors.triangles), jnp.asarray(factors.counts))

    return _on_all(of_device, mesh, motion)


def _on_all(of_device: Callable[..., Any], mesh: Mesh, motion: tuple[Array, ...]) -> Any:
    """Apply a function to each device's patterns and return all results on every device.

    Results have a leading axis of devices.
    """

    def gathered(*shard: Array) -> Any:
        return jax.tree.map(lambda x: jax.lax.all_gather(x, _AXIS), of_device(*shard))

    # Not checked: the checker does not know that what is gathered is the same everywhere.
    return jax.shard_map(
        gathered,
        mesh=mesh,
        in_specs=PartitionSpec(_AXIS),
        out_specs=PartitionSpec(),
        check_vma=False,
    )(*motion)
