from collections.abc import Sequence
from typing import Any

import numpy as np
from jax.core import Tracer
from jaxtyping import Array, Float

from ...manipulator import STATIC_SLOPE, Manipulator
from ._input_term import AbstractFunctions
from ._joint_term import AbstractJointLaw, LawProperties


class StaticFriction(AbstractJointLaw):
    """Static friction beyond dry friction: sign(qd) exp(-slope |qd|) (Eqn. 2.5-4, Fig. 8.2-1).

    **Attributes**

    - `slopes`: (n,) of each joint that has a torque [s/rad or s/m], a leaf; those of joints
      without static friction are not used.
    """

    slopes: Float[Array | np.ndarray, "*batch joints"]

    @property
    def properties(self) -> LawProperties:
        return LawProperties(
            kind="static",
            symbols=("ks",),
            description="static friction of joint {} beyond dry",
            units=("N m", "N"),
            positive=False,  # what is left of static friction beyond dry friction
        )

    @classmethod
    def from_robot(cls, robot: Manipulator) -> "StaticFriction":
        """With the robot's slopes, or a guess."""
        slopes = np.array(robot.static_slopes or (STATIC_SLOPE,) * robot.joint_count, float)
        return cls(slopes[list(robot.independent_joints)])

    def with_slopes(
        self, slopes: Sequence[float] | Float[Array | np.ndarray, " joints"]
    ) -> "StaticFriction":
        """With others, (n,); numbers become a NumPy array.

        **Raises** `ValueError` for a wrong number of slopes, and for numbers not above 0.
        """
        values = slopes if isinstance(slopes, Array) else np.array(slopes, float)
        if isinstance(values, np.ndarray) and not np.all((values > 0) & (values < np.inf)):
            raise ValueError(f"static slopes: expected numbers above 0, got {values.tolist()}")
        shape = self.slopes.shape
        if values.shape != shape:
            raise ValueError(
                f"static slopes: expected {shape[-1]}, one a joint, got {values.shape}"
            )
        return StaticFriction(values)

    def inputs(self, functions: AbstractFunctions, q: Any, qd: Any) -> tuple[Any, ...]:
        del q
        decay = functions.exp(-(functions.absolute(qd) * self.slopes))
        return (functions.sign(qd) * decay,)

    # `jax.jit(network.torque)` looks the method up by its hash, and arrays have none.
    def __hash__(self) -> int:
        if isinstance(self.slopes, Tracer):
            return id(self.slopes)
        values = np.asarray(self.slopes)
        return hash((values.shape, values.tobytes()))
