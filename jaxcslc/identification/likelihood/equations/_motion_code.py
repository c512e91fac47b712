import ctypes
from dataclasses import dataclass
from functools import lru_cache
from typing import Any

import numpy as np
from jaxtyping import Float

from ....network import CSLC
from ....network.straight_line import c_library
from ._friction_code import friction_code
from ._friction_mean import NODES, SLOWEST
from ._linearisation import ANGLE, RATE, Linearisation
from ._motion_source import SOURCE
from ._smooth_code import smooth_code


# Equations at a time, whose numbers stay in a core's cache.
_BLOCK = 128
# A compiler takes a second for a thousand operations, and longer than in proportion.
_MOST_OPERATIONS = 5000

Samples = Float[np.ndarray, "samples joints"]
Rows = Float[np.ndarray, "equations joints"]


@dataclass(frozen=True)
class MotionCode:
    """Equations of motion of one network as compiled C code: what `MotionEquations` are in JAX.

    On a core it takes a tenth of the time of what XLA makes of the same expressions, and nothing is
    traced in every process.

    **Attributes**

    - `source`: of the library.
    - `joints`, `coefficients`: n and p.

    Methods have the arguments of `MotionEquations`, and `intervals`, (samples - 1,) [s].
    """

    source: str
    joints: int
    coefficients: int

    def torque(
        self,
        intervals: Float[np.ndarray, " intervals"],
        k: Float[np.ndarray, " coefficients"],
        slopes: Float[np.ndarray, " joints"],
        q: Samples,
        turn: Rows,
        direction: Rows,
    ) -> Rows:
        """(equations, n)."""
        torque = np.empty((len(q) - 2, self.joints))
        motion = q, intervals, k, np.exp(slopes), turn, direction, None
        self._call("torques", motion, (torque, None, None, None))
        return torque

    def linearised(
        self,
        intervals: Float[np.ndarray, " intervals"],
        k: Float[np.ndarray, " coefficients"],
        slopes: Float[np.ndarray, " joints"],
        q: Samples,
        turn: Rows,
        direction: Rows,
    ) -> Linearisation:
        """The same with derivatives."""
        count, n = len(q) - 2, self.joints
        result = Linearisation(
            np.empty((count, n)),
            np.empty((count, n, 3 * n)),
            np.zeros((count, n, self.coefficients + n)),
            np.empty((count, n)),
        )
        motion = q, intervals, k, np.exp(slopes), turn, direction, None
        self._call("torques", motion, result)
        return result

    def smooth(
        self, k: Float[np.ndarray, " coefficients"], q: Rows, velocity: Rows, acceleration: Rows
    ) -> Rows:
        """Torque of all terms but friction, at instants, (equations, n)."""
        torque = np.empty_like(q)
        self._call("smooth", (q, velocity, acceleration, k), (torque,))
        return torque

    def friction(
        self,
        intervals: Float[np.ndarray, " intervals"],
        k: Float[np.ndarray, " coefficients"],
        slopes: Float[np.ndarray, " joints"],
        q: Samples,
        turn: Rows,
        direction: Rows,
        shift: Rows,
    ) -> Rows:
        """Torque of friction alone, for velocities that are larger by `shift`."""
        torque = np.empty_like(turn)
        motion = q, intervals, k, np.exp(slopes), turn, direction, shift
        self._call("torques", motion, (torque, None, None, None))
        return torque

    def _call(self, name: str, inputs: tuple[Any, ...], outputs: tuple[Any, ...]) -> None:
        library = c_library(self.source)
        if library is None:
            raise OSError("there is no C compiler: cc, or what the environment's CC names")
        arrays = [None if x is None else np.ascontiguousarray(x, float) for x in inputs]
        addresses = [
            None if x is None else x.ctypes.data_as(ctypes.c_void_p) for x in (*arrays, *outputs)
        ]
        getattr(library, name)(*addresses, ctypes.c_long(len(outputs[0])))


def motion_code(network: CSLC) -> MotionCode | None:
    """The code of a network's equations of motion.

    None where there is no C compiler, for networks that cannot be written as expressions, and for
    those of so many operations that compiling them would take longer than a fit.
    """
    if network.static_slopes is not None:  # arguments of the code
        network = network.with_static_slopes(np.ones(network.joint_count))
    # Its layout is kept once it was asked for, and networks with and without it are not equal.
    code = _of_network(network, network.layout.size)
    return None if code is None or c_library(code.source) is None else code


@lru_cache(maxsize=16)
def _of_network(network: CSLC, p: int) -> MotionCode | None:
    if not network.has_column_entries:
        return None
    smooth = smooth_code(network, _BLOCK)
    if smooth.operations > _MOST_OPERATIONS:
        return None
    friction = friction_code(network)
    n = network.joint_count
    columns = [(p + n) * joint + index for joint, index in smooth.entries]
    source = SOURCE.format(
        block=_BLOCK,
        joints=n,
        width=p + n,
        size=p,
        angle=ANGLE,
        rate=RATE,
        slowest=SLOWEST,
        nodes=_listed(NODES.tolist()),
        called=max(smooth.call_count, 1),
        column_count=len(columns),
        targets=_listed(columns or [0]),
        laws=_listed([f"law_{joint}" for joint in range(n)]),
        law_counts=_listed([len(indices) for indices in friction.indices]),
        most_laws=max(1, *(len(indices) for indices in friction.indices)),
        law_firsts=_listed(np.cumsum([0, *map(len, friction.indices)])[:-1].tolist()),
        law_indices=_listed([index for row in friction.indices for index in row] or [0]),
        law_functions=friction.functions,
        calls=smooth.calls,
        torque=smooth.torque,
        columns=smooth.columns,
    )
    return MotionCode(source, n, p)


def _listed(numbers: list[Any]) -> str:
    return ", ".join(str(x) for x in numbers)
