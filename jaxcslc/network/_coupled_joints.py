from typing import Any

import equinox as eqx
import numpy as np
from jaxtyping import Array, Float

from .._environment import array_namespace
from ..manipulator import Manipulator, RobotError
from ._cslc import CSLC
from ._linear_network import AbstractLinearNetwork, Columns, Motion, MotionRows, Vector
from .terms import AbstractManipulatorTerm


class CoupledJoints(AbstractLinearNetwork):
    """The inverse dynamics of a robot some of whose joints follow others, as fingers do.

    Positions of all joints are q = S u + s, with u those of the independent joints. Virtual work
    gives the torques of these,

        tau = S' (Y(S u + s, S u', S u'') k),

    which are linear in the same coefficients `k`. Motion and torque have a column an independent
    joint; coefficients that they do not determine are those that only motion of a follower by
    itself would show. Build one with `of`, and fit it as any network:

    >>> import tempfile
    >>> from pathlib import Path
    >>> import jaxcslc as jc
    >>> from jaxcslc.network import CoupledJoints
    >>> link = '''<link name="{0}"> <inertial> <mass value="1"/> <origin xyz="0 0 {1}"/>
    ...   <inertia ixx="0.1" iyy="0.1" izz="0.1" ixy="0" ixz="0" iyz="0"/> </inertial> </link>'''
    >>> joint = '''<joint name="{0}" type="continuous"> <parent link="palm"/> <child link="{1}"/>
    ...   <axis xyz="1 0 0"/> {2} </joint>'''
    >>> hand = ['<robot name="hand"> <link name="palm"/>', link.format("a", 0.1)]
    >>> hand += [link.format("b", -0.1), joint.format("left", "a", "")]
    >>> hand += [joint.format("right", "b", '<mimic joint="left" multiplier="-1"/>'), "</robot>"]
    >>> with tempfile.TemporaryDirectory() as folder:
    ...     path = Path(folder) / "hand.urdf"
    ...     _ = path.write_text("".join(hand))
    ...     robot = jc.load_robot(path, keep_mimics=True)
    >>> network = CoupledJoints.of(jc.derive(robot, lengths="numeric"))
    >>> network.output_names, network.motion_count, network.network.joint_count
    (('left',), 1, 2)

    **Attributes**

    - `network`: of all joints; `terms`: its terms.
    - `matrix`: S, (n, m).
    - `offset`: s, (n,) [rad or m].
    - `independent`: indices of the joints that follow none.
    """

    network: CSLC
    terms: tuple[AbstractManipulatorTerm, ...]
    matrix: tuple[tuple[float, ...], ...] = eqx.field(static=True)
    offset: tuple[float, ...] = eqx.field(static=True)
    independent: tuple[int, ...] = eqx.field(static=True)

    @classmethod
    def of(cls, network: CSLC) -> "CoupledJoints":
        """Of a robot that was read with `load_robot(keep_mimics=True)`.

        **Raises** `RobotError` if no joint of it follows another.
        """
        robot = network.robot
        mimics = robot.source.mimics if robot.source is not None else ()
        if not mimics:
            raise RobotError(
                f"{robot.name!r} has no joints that mimic others; expected load_robot(...,"
                " keep_mimics=True) of a file that has such"
            )
        names = robot.joint_names
        followers = {mimic.follower for mimic in mimics}
        independent = tuple(i for i, name in enumerate(names) if name not in followers)
        matrix, offset = np.zeros((len(names), len(independent))), np.zeros(len(names))
        matrix[independent, range(len(independent))] = 1.0
        for mimic in mimics:
            follower = names.index(mimic.follower)
            matrix[follower] = mimic.multiplier * matrix[names.index(mimic.leader)]
            offset[follower] = mimic.offset
        rows = tuple(tuple(row) for row in matrix.tolist())
        return cls(
            network=network,
            terms=network.terms,
            matrix=rows,
            offset=tuple(offset.tolist()),
            independent=independent,
        )

    @property
    def robot(self) -> Manipulator:
        """With all of its joints."""
        return self.network.robot

    @property
    def name(self) -> str:
        return self.network.name

    @property
    def output_kind(self) -> str:
        return "joint"

    @property
    def output_quantity(self) -> str:
        return "torque"

    @property
    def output_labels(self) -> tuple[str, ...]:
        return self._independent(self.network.output_labels)

    @property
    def output_names(self) -> tuple[str, ...]:
        return self._independent(self.network.output_names)

    @property
    def output_units(self) -> tuple[str, ...]:
        return self._independent(self.network.output_units)

    @property
    def motion_count(self) -> int:
        """One column an independent joint."""
        return len(self.independent)

    def of_all_joints(self, q: Any, qd: Any, qdd: Any) -> tuple[Any, Any, Any]:
        """Motion of all joints, (..., n), from that of the independent ones, (..., m)."""
        matrix = np.array(self.matrix, q.dtype).T
        offset = np.array(self.offset, q.dtype).reshape((1,) * (q.ndim - 1) + (-1,))
        return q @ matrix + offset, qd @ matrix, qdd @ matrix

    def torque(self, k: Vector, q: Motion, qd: Motion, qdd: Motion) -> Float[Array, "..."]:
        k, q, qd, qdd = self._checked(k, q, qd, qdd)
        whole = self.network.torque(k, *self.of_all_joints(q, qd, qdd))
        return whole @ np.array(self.matrix, whole.dtype)

    def regressor(self, q: Motion, qd: Motion, qdd: Motion) -> Float[Array, "..."]:
        _, q, qd, qdd = self._checked(None, q, qd, qdd)
        whole = self.network.regressor(*self.of_all_joints(q, qd, qdd))
        return (whole.mT @ np.array(self.matrix, whole.dtype)).mT

    @property
    def support(self) -> tuple[tuple[int, ...], ...]:
        supports = self.network.support
        return tuple(
            tuple(sorted({i for joint, _ in joints for i in supports[joint]}))
            for joints in self._shares
        )

    @property
    def has_host_columns(self) -> bool:
        return self.network.has_host_columns

    def columns(self, q: MotionRows, qd: MotionRows, qdd: MotionRows) -> Columns:
        matrix, offset = (np.array(x, q.dtype) for x in (self.matrix, self.offset))
        whole = self.network.columns(matrix @ q + offset[:, None], matrix @ qd, matrix @ qdd)
        xp = array_namespace(*whole)
        supports = self.network.support
        rows: list[Any] = []
        for joints, support in zip(self._shares, self.support, strict=True):
            total = xp.zeros((len(support), q.shape[1]), whole[0].dtype)
            for joint, share in joints:
                # Entries of this joint's columns among those of the sum.
                at = np.searchsorted(support, supports[joint])
                spread = np.zeros((len(support), len(supports[joint])), whole[0].dtype)
                spread[at, range(len(at))] = share
                total = total + spread @ whole[joint]
            rows.append(total)
        return tuple(rows)

    @property
    def _shares(self) -> tuple[tuple[tuple[int, float], ...], ...]:
        """Of each independent joint the joints that move with it, and by how much."""
        return tuple(
            tuple((joint, row[column]) for joint, row in enumerate(self.matrix) if row[column])
            for column in range(self.motion_count)
        )

    def _independent(self, entries: tuple[str, ...]) -> tuple[str, ...]:
        return tuple(entries[i] for i in self.independent)
