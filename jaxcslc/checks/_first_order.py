"""Torque that small faults add, as columns of first order beside the regressor's.

A zero position that is off by a little adds the torque's derivative by that position, times the
error. The scale of a position or a torque, gravity's direction, lengths of the robot's file,
friction that grows and a tool that is taken up add columns as well. `FirstOrder` holds the Gram
matrices of all of them, per block of time and joint: a cause is a choice of columns, its held-out
error a quadratic form.
"""

import contextlib
import dataclasses
import itertools
from collections.abc import Callable, Mapping
from functools import cached_property

import numpy as np
from jaxtyping import Bool, Float

from ..least_squares import columns_of, torque_by
from ..manipulator import Manipulator, link_poses
from ..network import CSLC
from ..recordings import Patterns
from ._evidence import LARGEST_ERROR, SMALLEST_ERROR, TINY, Evidence
from ._geometry import geometry_columns


BLOCKS = 20
"""Blocks of time: each shorter than what happens during a recording, and enough of them for the
standard errors of `FirstOrder.estimate`."""
_FOLDS = 5  # a fold is every fifth block, so that each has all parts of the recording
_STEP = 1e-4  # of finite differences [rad or m, or as a part]: exact to as much, rounding 1e-12
# Part of a column's squares that others leave, below which it says nothing: that of `_STEP`.
_LEAST_LEFT = _STEP**2
_TOLERANCE = 1e-12  # of eigenvalues of scaled normal equations: less may be rounding
# Of scaled normal equations that are solved without eigenvalues, in a fiftieth of the time: all of
# these count then, and rounding, 2e-16 times this, is below a millionth of the solution.
_LARGEST_CONDITION = 1e8


@dataclasses.dataclass(frozen=True)
class Columns:
    """Columns that a cause adds to the regressor.

    - `maps`: (blocks or 1, joints, base columns, added columns); each column as a combination of
      the base columns of `FirstOrder`, per block and joint; of all blocks alike if there is one.
    """

    maps: Float[np.ndarray, "blocks joints base added"]


@dataclasses.dataclass(frozen=True)
class Score:
    """Held-out errors with the columns of a cause.

    - `errors`: (n,) held-out root mean square errors, as part of each joint's torque.
    """

    errors: Float[np.ndarray, " joints"]

    @property
    def mean(self) -> float:
        """Mean logarithm of the errors."""
        return float(np.mean(np.log(np.clip(self.errors, SMALLEST_ERROR, LARGEST_ERROR))))


@dataclasses.dataclass(frozen=True)
class FirstOrder:
    """Gram matrices of a recording's regressor, of columns of first order, and of its torque.

    - `network`: n joints, p coefficients.
    - `gram`: (blocks, n, m, m) of the m base columns: p of the regressor, a constant torque per
      joint, those of `groups`, and the torque as the last.
    - `counts`: (blocks, n) samples.
    - `groups`: slices of the base columns by name.
    - `edges`: (blocks + 1,) times at which blocks begin and end [s].
    """

    network: CSLC
    gram: Float[np.ndarray, "blocks joints base base"]
    counts: Float[np.ndarray, "blocks joints"]
    groups: Mapping[str, slice]
    edges: Float[np.ndarray, " edges"]

    @classmethod
    def of(
        cls,
        evidence: Evidence,
        patterns: Patterns | None = None,
        *,
        only: tuple[str, int] | None = None,
    ) -> "FirstOrder":
        """Compute the columns of patterns: those of the evidence, or others of the recording.

        - `only`: the one group, and its joint, whose columns are needed; all by default.
        """
        patterns = evidence.patterns if patterns is None else patterns
        network, joints = evidence.network, evidence.network.joint_count
        columns = evidence.columns(patterns)
        rigid = np.zeros(network.size)
        inertial = network.layout.inertial
        rigid[inertial] = evidence.coefficients(patterns, columns)[inertial]
        q, qd, qdd = (np.asarray(x) for x in (patterns.q, patterns.qd, patterns.qdd))

        def torque_at(q: np.ndarray, qd: np.ndarray, qdd: np.ndarray) -> np.ndarray:
            moved = dataclasses.replace(patterns, q=q, qd=qd, qdd=qdd)
            return torque_by(network.support, columns_of(network, moved), rigid)

        base = torque_by(network.support, columns, rigid)
        moved: dict[str, Callable[[np.ndarray], np.ndarray]] = {
            "zero": lambda step: torque_at(q + step, qd, qdd),
            "scale": lambda step: torque_at(*((1.0 + step) * x for x in (q, qd, qdd))),
        }
        steps = _STEP * np.eye(joints)
        parts = {
            name: np.stack(
                [torque(step) - base for step in (steps if only is None else steps[[only[1]]])],
                axis=-1,
            )
            / _STEP
            for name, torque in moved.items()
            if only is None or only[0] == name
        }
        if only is None:
            parts["motion"] = (base - torque_at(q, 0.0 * qd, 0.0 * qdd))[..., None]
            parts["payload"] = _payload_columns(network, patterns)
        if only is None or only[0] == "length":
            lengths = geometry_columns(network, (q, qd, qdd), base)
            parts |= {"length": lengths} if lengths.shape[-1] else {}
        if only is None or only[0] == "gravity":
            gravity = gravity_columns(network, q)
            parts |= {} if gravity is None else {"gravity": gravity}
        regressor = np.zeros((len(q), joints, network.size))
        for joint, (support, rows) in enumerate(zip(network.support, columns, strict=True)):
            regressor[:, joint, list(support)] = rows.T
        constant = np.broadcast_to(np.eye(joints), (len(q), joints, joints))
        torque = np.asarray(patterns.torque)
        everything = np.concatenate(
            [regressor, constant, *parts.values(), torque[..., None]], axis=-1
        )
        own = network.size + joints
        ends = np.cumsum([own, *(part.shape[-1] for part in parts.values())])
        slices = {
            name: slice(int(start), int(end))
            for name, start, end in zip(parts, ends[:-1], ends[1:], strict=True)
        }
        mask = np.asarray(patterns.mask)
        bounds = np.linspace(0, len(q), BLOCKS + 1).round().astype(int)
        gram = np.zeros((BLOCKS, joints, everything.shape[-1], everything.shape[-1]))
        counts = np.zeros((BLOCKS, joints))
        for block, (start, end) in enumerate(itertools.pairwise(bounds)):
            for joint in range(joints):
                rows = everything[start:end, joint][mask[start:end, joint]]
                gram[block, joint] = rows.T @ rows
                counts[block, joint] = len(rows)
        time = np.asarray(patterns.time)
        edges = time[np.minimum(bounds, len(time) - 1)]
        return cls(network, gram, counts, slices, edges)

    @property
    def unknowns(self) -> int:
        """Number of columns that every fit has: the regressor's, and a constant per joint."""
        return self.network.size + self.gram.shape[1]

    @property
    def size(self) -> int:
        """Number of base columns."""
        return self.gram.shape[-1]

    def _empty(self, added: int, blocks: int = 1) -> Columns:
        return Columns(np.zeros((blocks, *self.gram.shape[1:3], added)))

    def group(self, name: str, column: int | None = None, blocks: int = 1) -> Columns:
        """Return a group's columns, or one of them."""
        part = self.groups[name]
        indices = np.arange(part.start, part.stop)
        indices = indices if column is None else indices[[column]]
        result = self._empty(len(indices), blocks)
        result.maps[:, :, indices, np.arange(len(indices))] = 1.0
        return result

    def gains(self, *joints: int) -> Columns:
        """Return the rigid-body torque of each of some joints, by the fit."""
        result, inertial = self._empty(len(joints)), self.network.layout.inertial
        for column, joint in enumerate(joints):
            result.maps[:, joint, inertial, column] = self.k[inertial]
        return result

    def growing_friction(self) -> Columns:
        """Return columns of friction and of constants, times the time from -1/2 to 1/2."""
        joints = np.arange(self.network.size, self.unknowns)
        friction = np.append(self.network.layout.friction, joints)
        share = (np.arange(BLOCKS) + 0.5) / BLOCKS - 0.5
        result = self._empty(len(friction), BLOCKS)
        result.maps[:, :, friction, np.arange(len(friction))] = share[:, None, None]
        return result

    def payload_from(self, block: int) -> Columns:
        """Return the columns of a body at the last link, from a block on."""
        result = self.group("payload", blocks=BLOCKS)
        result.maps[:block] = 0.0
        return result

    @cached_property
    def k(self) -> Float[np.ndarray, " coefficients"]:
        """Coefficients of the fit without anything added."""
        return self._solve(self._own.sum(axis=0), self._weights)

    @cached_property
    def _own(self) -> Float[np.ndarray, "folds joints m m"]:
        """Gram matrices of the regressor and the torque, by fold."""
        own = np.r_[0 : self.unknowns, self.size - 1]
        return self._folds[:, :, own[:, None], own]

    @cached_property
    def _folds(self) -> Float[np.ndarray, "folds joints base base"]:
        return np.stack([self.gram[fold::_FOLDS].sum(axis=0) for fold in range(_FOLDS)])

    @cached_property
    def _weights(self) -> Float[np.ndarray, " joints"]:
        """Weights of the joints: inverse variances of the residuals of a fit by size."""
        gram, least = self._own.sum(axis=0), SMALLEST_ERROR**2 * self._squares
        weights = 1.0 / np.maximum(self._squares, TINY)
        for _ in range(2):
            k = np.append(self._solve(gram, weights), -1.0)
            residual = (gram @ k) @ k / np.maximum(self._samples, 1.0)
            weights = 1.0 / np.maximum(np.maximum(residual, least), TINY)
        return weights

    @cached_property
    def _samples(self) -> Float[np.ndarray, " joints"]:
        return self.counts.sum(axis=0)

    @cached_property
    def _squares(self) -> Float[np.ndarray, " joints"]:
        """Mean square of each joint's torque."""
        return self.gram[..., -1, -1].sum(axis=0) / np.maximum(self._samples, 1.0)

    def _projected(self, added: Columns) -> Float[np.ndarray, "folds joints m m"]:
        """Return Gram matrices of the regressor, of added columns and of the torque, by fold."""
        p, maps = self.unknowns, added.maps
        own = np.r_[0:p, self.size - 1]
        new = np.arange(p, p + maps.shape[-1])
        gram = self._folds if len(maps) == 1 else self.gram
        mixed = gram @ maps
        beside, inner = mixed[:, :, own], np.swapaxes(maps, -1, -2) @ mixed
        if len(maps) > 1:
            beside, inner = (
                np.stack([x[fold::_FOLDS].sum(axis=0) for fold in range(_FOLDS)])
                for x in (beside, inner)
            )
        order = np.append(np.arange(p), p + maps.shape[-1])
        whole = np.zeros((*beside.shape[:2], order[-1] + 1, order[-1] + 1))
        whole[:, :, order[:, None], order] = self._own
        whole[:, :, order[:, None], new] = beside
        whole[:, :, new[:, None], order] = np.swapaxes(beside, -1, -2)
        whole[:, :, new[:, None], new] = inner
        return whole

    def _solve(
        self, gram: Float[np.ndarray, "joints m m"], weights: Float[np.ndarray, " joints"]
    ) -> Float[np.ndarray, " unknowns"]:
        normal = np.tensordot(weights, gram, axes=1)
        scale = np.sqrt(np.maximum(np.diag(normal)[:-1], TINY))
        scaled, right = normal[:-1, :-1] / scale[:, None] / scale, normal[:-1, -1] / scale
        with contextlib.suppress(np.linalg.LinAlgError):
            factor = np.linalg.inv(np.linalg.cholesky(scaled))
            if np.sum(factor**2) * np.trace(scaled) < _LARGEST_CONDITION:
                return factor.T @ (factor @ right) / scale
        values, vectors = np.linalg.eigh(scaled)
        counted = values > _TOLERANCE * values[-1]
        projected = vectors.T @ right
        inverse = np.where(counted, projected / np.where(counted, values, 1.0), 0.0)
        return (vectors @ inverse) / scale

    def score(self, added: Columns | None = None) -> Score:
        """Return held-out errors with added columns."""
        gram = self._own if added is None else self._projected(added)
        whole = gram.sum(axis=0)
        squares = np.zeros(gram.shape[1])
        for of_fold in gram:
            k = np.append(self._solve(whole - of_fold, self._weights), -1.0)
            squares += (of_fold @ k) @ k
        error = np.sqrt(np.maximum(squares, 0.0) / np.maximum(self._samples, 1.0))
        return Score(error / np.sqrt(np.maximum(self._squares, TINY)))

    def sizes(self, added: Columns) -> Float[np.ndarray, " added"]:
        """Return the sizes of added columns by a fit to all blocks."""
        gram = self._projected(added).sum(axis=0)
        return self._solve(gram, self._weights)[self.unknowns :]

    def quick(self, added: Columns | None = None) -> float:
        """Return the mean logarithm of the errors of a fit to all blocks."""
        gram = (self._own if added is None else self._projected(added)).sum(axis=0)
        k = np.append(self._solve(gram, self._weights), -1.0)
        squares = np.maximum((gram @ k) @ k, 0.0) / np.maximum(self._samples, 1.0)
        errors = np.sqrt(squares / np.maximum(self._squares, TINY))
        return Score(errors).mean

    def scaled(self, factors: Float[np.ndarray, " joints"]) -> "FirstOrder":
        """Return the same with other torques: factors times those of each joint."""
        gram = self.gram.copy()
        gram[..., -1, :] *= factors[:, None]
        gram[..., :, -1] *= factors[:, None]
        return dataclasses.replace(self, gram=gram)

    def estimate(self, added: Columns) -> tuple[float, float]:
        """Return the size of one added column, of all blocks alike, and its standard error.

        The error is that of the blocks' differences, in which what the model lacks counts as
        noise; infinite for a column that the others make up for.
        """
        column = added.maps[0, :, :, 0]
        own, joints = np.arange(self.unknowns), np.arange(len(column))
        gram = self.gram * self._weights[:, None, None]
        whole = gram.sum(axis=0)
        normal = whole[:, own[:, None], own].sum(axis=0)
        right = np.stack(
            [np.einsum("jom,jm->o", whole[:, own], column), whole[:, own, -1].sum(axis=0)], axis=1
        )
        scale = np.sqrt(np.maximum(np.diag(normal), TINY))
        inverse = np.linalg.pinv(normal / np.outer(scale, scale), _TOLERANCE, hermitian=True)
        of_column, of_torque = (inverse @ (right / scale[:, None]) / scale[:, None]).T
        left, residual = column.copy(), np.zeros_like(column)
        left[:, own] -= of_column
        residual[joints, -1] = 1.0
        residual[:, own] -= of_torque
        size = float(np.einsum("jm,jmq,jq->", column, whole, column))
        information = float(np.einsum("jm,jmq,jq->", left, whole, left))
        if information <= _LEAST_LEFT * size:
            return 0.0, np.inf
        value = float(np.einsum("jm,jmq,jq->", left, whole, residual)) / information
        scores = np.einsum("jm,bjmq,jq->b", left, gram, residual - value * left)
        return value, float(np.sqrt(np.sum(scores**2))) / information

    def without(self, blocks: Bool[np.ndarray, " blocks"]) -> "FirstOrder":
        """Return the same without some blocks, which are not fitted and not judged."""
        kept = ~blocks
        return dataclasses.replace(
            self, gram=self.gram * kept[:, None, None, None], counts=self.counts * kept[:, None]
        )

    def block_errors(self, whole: "FirstOrder") -> Float[np.ndarray, "blocks joints"]:
        """Return the error of each block under the coefficients of all others, of its torque.

        - `whole`: the same with the blocks that are judged and not fitted.
        """
        own = np.r_[0 : self.unknowns, self.size - 1]
        fitted = self._own.sum(axis=0)
        errors = np.zeros(whole.counts.shape)
        for block in range(BLOCKS):
            left_out, judged = (x.gram[block][:, own[:, None], own] for x in (self, whole))
            k = np.append(self._solve(fitted - left_out, self._weights), -1.0)
            squares = np.maximum((judged @ k) @ k, 0.0)
            errors[block] = squares / np.maximum(whole.counts[block], 1.0)
        return np.sqrt(errors / np.maximum(whole._squares, TINY))


def _payload_columns(network: CSLC, patterns: Patterns) -> np.ndarray:
    """Return the columns of a body at the last link (samples, joints, 10)."""
    loaded = network.with_payload()
    payload = np.zeros((patterns.samples, network.joint_count, 10))
    of_joints = zip(loaded.support, columns_of(loaded, patterns), strict=True)
    for joint, (support, rows) in enumerate(of_joints):
        for index, row in zip(support, rows, strict=True):
            if index >= network.size:
                payload[:, joint, index - network.size] = row
    return payload


def _with_carried(
    robot: Manipulator, values: Float[np.ndarray, "*dims links"] | Float[np.ndarray, "_ links 3"]
) -> np.ndarray:
    """Add to the values of each link those of all that it carries; links are the second axis of
    arrays of more than one."""
    sums = np.array(values)
    of_links = sums if sums.ndim == 1 else np.swapaxes(sums, 0, 1)
    for link in reversed(range(len(of_links))):
        if robot.parents[link] >= 0:
            of_links[robot.parents[link]] += of_links[link]
    return sums


def carried_masses(network: CSLC) -> Float[np.ndarray, " joints"]:
    """Return the mass by the robot's file that each joint carries [kg]; 0 where it says none."""
    robot = network.robot
    if robot.links is None or network.joint_count != robot.joint_count:
        return np.zeros(network.joint_count)
    return _with_carried(robot, np.array([float(link.mass) for link in robot.links]))


def gravity_columns(
    network: CSLC, q: Float[np.ndarray, "samples joints"]
) -> Float[np.ndarray, "samples joints 3"] | None:
    """Return the torque of the file's masses per unit of gravity along x, y and z of the base.

    None without masses in the file, and for joints that follow others.
    """
    robot = network.robot
    if robot.links is None or network.joint_count != robot.joint_count:
        return None
    if not any(float(link.mass) for link in robot.links) or not robot.has_all_lengths:
        return None
    poses = np.asarray(link_poses(robot, q))
    turn, place = poses[..., :3, :3], poses[..., :3, 3]
    mass = np.array([float(link.mass) for link in robot.links])
    first = np.stack([np.asarray(link.first_moment) for link in robot.links])
    moment = mass[:, None] * place + np.einsum("slij,lj->sli", turn, first)
    carried, moments = _with_carried(robot, mass), _with_carried(robot, moment)
    axis = turn[..., :, 2]
    lever = moments - carried[:, None] * place
    revolute = np.array([kind == "R" for kind in robot.kinds])[:, None]
    # The force of a unit of gravity along e on what a joint carries: its power per unit of speed.
    return -np.where(revolute[None], np.cross(axis, lever), carried[:, None] * axis)
