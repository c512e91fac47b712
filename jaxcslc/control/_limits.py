import jax.numpy as jnp
from jaxtyping import Array, Float


Joints = Float[Array, "*batch joints"]


def limited(torque: Joints, limit: Float[Array, " joints"]) -> Joints:
    """The torque that the drives can give: each joint's cut off at its own limit [N m or N]."""
    limit = jnp.broadcast_to(limit, torque.shape).astype(torque.dtype)
    return jnp.clip(torque, -limit, limit)


def integrated(
    integral: Joints, increment: Joints, asked: Joints, limit: Float[Array, " joints"]
) -> Joints:
    """An integral gone on by a step, but not further into saturation (conditional integration).

    While more is `asked` of a joint than its limit, only increments that lead back count: an
    integral that goes on growing against a limit has to be undone by as much overshoot (Åström and
    Hägglund 1995, 3.5).

    >>> import jax.numpy as jnp
    >>> from jaxcslc.control import integrated
    >>> increment, asked = jnp.array([0.1, 0.1, -0.1]), jnp.array([5.0, 20.0, 20.0])
    >>> integrated(jnp.zeros(3), increment, asked, jnp.full(3, 9.0)).tolist()
    [0.1, 0.0, -0.1]
    """
    limit = jnp.broadcast_to(limit, asked.shape).astype(asked.dtype)
    outward = (jnp.abs(asked) > limit) & (asked * increment > 0)
    return jnp.where(outward, integral, integral + increment)
