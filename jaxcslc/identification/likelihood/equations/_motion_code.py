from dataclasses import dataclass
from functools import cached_property, lru_cache
from typing import Any

import numpy as np
from jaxtyping import Float

from ...._chunks import over_chunks
from ....codegen import LONG, CArray, CFunction
from ....network import CSLC
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
# A compiler takes a second for a thousand operations, and longer than in proportion; from so many
# on less of it: for a Panda with symbolic lengths (20,000) a minute and 0.4 GB.
_QUICKLY = 5000
# XLA needs more than 30 GB for that, and did not end in five minutes.
_MOST_OPERATIONS, _MOST_WITHOUT_COMPILER = 25_000, 5000

_ROWS = "equations joints"
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
    - `operations`: of torque.

    Methods have the arguments of `MotionEquations`, and `intervals`, (samples - 1,) [s].
    """

    source: str
    joints: int
    coefficients: int
    entries: tuple[tuple[int, int], ...]
    operations: int

    @cached_property
    def torques(self) -> CFunction:
        """The function of positions at all samples."""
        samples = CArray("samples joints"), CArray("intervals"), CArray(_ROWS), CArray(_ROWS)
        outputs = "equations joints positions", "equations entries", _ROWS
        kinds = (
            *(CArray("coefficients"), CArray("joints"), *samples, CArray(_ROWS, optional=True)),
            CArray(_ROWS, written=True),
            *(CArray(axes, written=True, optional=True) for axes in outputs),
            LONG,
        )
        return CFunction(self.source, "torques", kinds, self._options)

    @cached_property
    def smooth_torques(self) -> CFunction:
        """The function of motion at instants."""
        motion = (CArray(_ROWS),) * 3
        kinds = (CArray("coefficients"), *motion, CArray(_ROWS, written=True), LONG)
        return CFunction(self.source, "smooth", kinds, self._options)

    @property
    def _options(self) -> tuple[str, ...]:
        return ("-O1",) if self.operations > _QUICKLY else ()

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
        self._call(self.torques, (k, np.exp(slopes)), motion, (torque, None, None, None))
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
        self._call(self.torques, (k, np.exp(slopes)), motion, outputs)
        joints, columns = np.array(self.entries, int).reshape(-1, 2).T
        shape = n, self.coefficients + n
        of_entries = JointColumns(by_entry, joints, columns, shape)
        return Linearisation(torque, by_position, of_entries, by_turn)

    def smooth(
        self, k: Float[np.ndarray, " coefficients"], q: Rows, velocity: Rows, acceleration: Rows
    ) -> Rows:
        """Torque of all terms but friction, at instants, (equations, n)."""
        torque = np.empty_like(q)
        self._call(self.smooth_torques, (k,), (q, velocity, acceleration), (torque,))
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
        self._call(self.torques, (k, np.exp(slopes)), motion, (torque, None, None, None))
        return torque

    def _call(
        self,
        function: CFunction,
        constants: tuple[np.ndarray, ...],
        motion: tuple[np.ndarray | None, ...],
        outputs: tuple[np.ndarray | None, ...],
    ) -> None:
        """Calls a function of the library: the first rows of `motion` and of `outputs` are those of
        the first equation, and so on."""
        bound = function.bound(*constants)
        rows = [None if x is None else np.ascontiguousarray(x, float) for x in motion]
        rows += outputs
        assert outputs[0] is not None

        def compute(first: int, last: int) -> None:
            bound(*(None if x is None else x[first:] for x in rows), last - first)

        over_chunks(compute, len(outputs[0]), _CHUNK, align=_BLOCK)


def motion_code(network: CSLC) -> MotionCode | None:
    """The code of a network's equations of motion.

    None where there is no C compiler, and for networks that cannot be written as expressions.

    **Raises** `ValueError` for networks of so many operations that they cannot be compiled in a
    reasonable time or memory.
    """
    if network.static_slopes is not None:  # arguments of the code
        network = network.with_static_slopes(np.ones(network.joint_count))
    # Its layout is kept once it was asked for, and networks with and without it are not equal.
    code = _of_network(network, network.layout.size)
    if code is None:
        return None
    # Not compiled at all if it is too much.
    without = code.operations > _MOST_OPERATIONS or not code.torques.is_available
    if without and code.operations > _MOST_WITHOUT_COMPILER:
        raise ValueError(
            f"{network.name!r}: equations of motion of {code.operations:,} operations are too many"
            " to compile for maximum likelihood; expected numeric lengths,"
            " as of derive(robot, lengths='numeric')"
        )
    return None if without else code


@lru_cache(maxsize=16)
def _of_network(network: CSLC, p: int) -> MotionCode | None:
    if not network.has_column_entries:
        return None
    smooth = smooth_code(network, _BLOCK)
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
    return MotionCode(source, n, p, tuple(entries), smooth.operations)


def _listed(numbers: list[Any]) -> str:
    return ", ".join(str(x) for x in numbers)
