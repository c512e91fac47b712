"""Straight-line code of rigid bodies by JAX, and when it is quicker than the scan."""

import math
from functools import partial
from typing import Any

import jax
import jax.numpy as jnp
from jaxtyping import Array, Float

from ...._environment import platform_of
from ....codegen import StraightLine, in_blocks, motion_outputs


# Straight-line code of so many joints compiles within seconds; its operations grow with the square
# of the joints for the torque, with the third power for the regressor.
MOST_JOINTS = 12
# On a processor it compiles for 2 to 4 s longer than the loop, and gains that in so many samples.
MANY_SAMPLES = 1 << 20


@partial(jax.jit, static_argnames=("code",))
def unrolled(
    code: StraightLine,
    k: Float[Array, " coefficients"] | None,
    *motion: Float[Array, "samples joints"],
) -> Float[Array, "outputs samples"]:
    """The outputs of straight-line code for many samples of q, qd and qdd, as many as it needs.

    One array a quantity and joint, so that a compiler can keep all of a sample in registers.
    """

    def of_block(*rows: Array) -> Array:
        return jnp.stack(motion_outputs(code, k, *map(list, rows)))

    return in_blocks(of_block, tuple(x.T for x in motion))


def is_quicker_unrolled(q: Any, shape: tuple[int, ...]) -> bool:
    """Whether straight-line code is the quicker form, its compilation counted.

    - `q`: the joints' positions, for the device that they are on.
    - `shape`: (..., joints), theirs with joints last.
    """
    *batch, joints = shape
    if joints > MOST_JOINTS:
        return False
    return platform_of(q) != "cpu" or math.prod(batch) >= MANY_SAMPLES
