import ctypes
from dataclasses import dataclass
from functools import lru_cache
from typing import Any

import numpy as np
from jaxtyping import Float

from ...._chunks import over_chunks
from ....network import CSLC
from ....network.straight_line import c_library
from ..band import JointColumns
from ._friction_code import friction_code
from ._friction_mean import NODES, SLOWEST
from ._linearisation import ANGLE, RATE, Linearisation
from ._motion_source import SOURCE
from ._smooth_code import smooth_code


# Equations at a time, whose numbers stay in a core's cache.
_BLOCK = 128
# And those that a thread computes.
_CHUNK = 4096
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
    - `entries`: joint and column of the derivatives that are not 0, see `JointColumns`.

    Methods have the arguments of `MotionEquations`, and `intervals`, (samples - 1,) [s].
    """

    source: str
    joints: int
    coefficients: int
    entries: tuple[tuple[int, int], ...]

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
        motion = q, intervals, turn, direction, None
        self._call("torques", (k, np.exp(slopes)), motion, (torque, None, None, None))
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
        torque, by_turn = np.empty((2, count, n))
        by_position = np.empty((count, n, 3 * n))
        by_entry = np.empty((count, len(self.entries)))
        motion = q, intervals, turn, direction, None
        outputs = torque, by_position, by_entry, by_turn
        self._call("torques", (k, np.exp(slopes)), motion, outputs)
        joints, columns = np.array(self.entries, int).reshape(-1, 2).T
        shape = n, self.coefficients + n
        of_entries = JointColumns(by_entry, joints, columns, shape)
        return Linearisation(torque, by_position, of_entries, by_turn)

    def smooth(
        self, k: Float[np.ndarray, " coefficients"], q: Rows, velocity: Rows, acceleration: Rows
    ) -> Rows:
        """Torque of all terms but friction, at instants, (equations, n)."""
        torque = np.empty_like(q)
        self._call("smooth", (k,), (q, velocity, acceleration), (torque,))
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
        motion = q, intervals, turn, direction, shift
        self._call("torques", (k, np.exp(slopes)), motion, (torque, None, None, None))
        return torque

    def _call(
        self,
        name: str,
        constants: tuple[np.ndarray, ...],
        motion: tuple[np.ndarray | None, ...],
        outputs: tuple[np.ndarray | None, ...],
    ) -> None:
        """Calls a function of the library: the first rows of `motion` and of `outputs` are those of
        the first equation, and so on."""
        library = c_library(self.source)
        if library is None:
            raise OSError("there is no C compiler: cc, or what the environment's CC names")
        function = getattr(library, name)
        numbers = [np.ascontiguousarray(x, float) for x in constants]
        rows = [None if x is None else np.ascontiguousarray(x, float) for x in motion]
        rows += outputs
        assert outputs[0] is not None

        def compute(first: int, last: int) -> None:
            arrays = (*numbers, *(None if x is None else x[first:] for x in rows))
            addresses = [None if x is None else x.ctypes.data_as(ctypes.c_void_p) for x in arrays]
            function(*addresses, ctypes.c_long(last - first))

        over_chunks(compute, len(outputs[0]), _CHUNK, align=_BLOCK)


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
    laws = [(joint, index) for joint, row in enumerate(friction.indices) for index in row]
    slopes = [(joint, p + joint) for joint in friction.slopes]
    entries = sorted([*smooth.entries, *laws, *slopes])
    targets = {entry: number for number, entry in enumerate(entries)}
    assert len(targets) == len(entries)
    source = SOURCE.format(
        block=_BLOCK,
        joints=n,
        entry_count=len(entries),
        angle=ANGLE,
        rate=RATE,
        slowest=SLOWEST,
        nodes=_listed(NODES.tolist()),
        called=max(smooth.call_count, 1),
        column_count=len(smooth.entries),
        targets=_listed([targets[entry] for entry in smooth.entries] or [0]),
        law_targets=_listed([targets[entry] for entry in laws] or [0]),
        slope_targets=_listed([targets.get((joint, p + joint), -1) for joint in range(n)]),
        laws=_listed([f"law_{joint}" for joint in range(n)]),
        law_counts=_listed([len(indices) for indices in friction.indices]),
        most_laws=max(1, *(len(indices) for indices in friction.indices)),
        law_firsts=_listed(np.cumsum([0, *map(len, friction.indices)])[:-1].tolist()),
        law_indices=_listed([index for _, index in laws] or [0]),
        law_functions=friction.functions,
        calls=smooth.calls,
        torque=smooth.torque,
        columns=smooth.columns,
    )
    return MotionCode(source, n, p, tuple(entries))


def _listed(numbers: list[Any]) -> str:
    return ", ".join(str(x) for x in numbers)
