from collections.abc import Sequence
from functools import lru_cache

import jax.numpy as jnp
import numpy as np
from jaxtyping import Array, Float

from ..derivation import Coefficient
from ..manipulator import Manipulator


_NAMES = {"viscous": "kv", "dry": "kd", "offset": "ko"}
_UNITS = {"viscous": ("N m s/rad", "N s/m"), "dry": ("N m", "N"), "offset": ("N m", "N")}


@lru_cache(maxsize=64)
def friction_coefficients(robot: Manipulator) -> tuple[Coefficient, ...]:
    """One coefficient a joint for every term of the robot's friction model (thesis 5.1.4)."""
    return tuple(
        Coefficient(
            f"{_NAMES[term]}{i}",
            term,
            f"{term} friction of joint {i}" if term != "offset" else f"torque offset of joint {i}",
            _UNITS[term][joint.kind == "P"],
            positive=term != "offset",  # friction opposes motion
        )
        for term in robot.friction
        for i, joint in enumerate(robot.joints, start=1)
    )


def friction_inputs(
    terms: Sequence[str], qd: Float[Array, "*batch joints"]
) -> list[Float[Array, "*batch joints"]]:
    """What each term's coefficients multiply: qd, sgn(qd), 1 (Eqns. 2.5-1, 2.5-3)."""
    inputs = {
        "viscous": lambda: qd,
        "dry": lambda: jnp.sign(qd),
        "offset": lambda: jnp.ones_like(qd),
    }
    return [inputs[term]() for term in terms]


def friction_regressor(
    terms: Sequence[str], qd: Float[Array, "*batch joints"]
) -> Float[Array, "*batch joints coefficients"]:
    """Diagonal blocks, one a term: friction is decoupled between joints."""
    n = qd.shape[-1]
    eye = jnp.broadcast_to(np.eye(n, dtype=qd.dtype), (*qd.shape, n))
    return jnp.concatenate([x[..., :, None] * eye for x in friction_inputs(terms, qd)], axis=-1)
