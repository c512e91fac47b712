"""Pairs of shapes whose distance counts, and their distances in poses and along motions."""

import dataclasses
from typing import Any

import numpy as np
from jaxtyping import Float

from jaxcslc._environment import require
from jaxcslc.manipulator import Manipulator

from .._families import AbstractFamily, Parameters, sample_times
from .._limits import Surroundings
from .._search import Contacts, padded_contacts
from ._coal import CoalShapes
from ._geometry import compiled_geometry


# Of the search: what it keeps beside the clearance, and how far it looks [m].
_BESIDE, _FAR = 0.004, 0.15
# Of the check: first and last interval [s].
_COARSE, _FINE = 0.02, 0.00125
_POSES, _ALWAYS = 100, 0.9  # random poses; bodies that touch in most of them are joined


@dataclasses.dataclass(frozen=True, eq=False)
class CollisionBodies:
    """The shapes of a robot and of what surrounds it, and their distances, by MuJoCo or Coal.

    Bodies that a joint connects may touch, and those that touch in nearly every pose: their shapes
    overlap by design.

    **Attributes**

    - `model`: MuJoCo's, whose bodies are the robot's and whose world holds the obstacles.
    - `columns`: of each joint, its index in the model's positions.
    - `pairs`: (pairs, 2) geometries whose distance counts.
    - `levers`: (pairs, n) how far a unit of a joint's motion moves points of one body of a pair
      against those of the other, at most [m/rad or 1].
    - `wanted`: (pairs,) the least distance [m]: the clearance, or half of the distance of bodies
      that are that near in most poses by design.
    - `coal`: the shapes for Coal's distances; None for MuJoCo's.
    """

    model: Any
    columns: np.ndarray
    pairs: np.ndarray
    levers: Float[np.ndarray, "pairs joints"]
    wanted: Float[np.ndarray, " pairs"]
    coal: CoalShapes | None = None

    @classmethod
    def of(cls, robot: Manipulator, surroundings: Surroundings) -> "CollisionBodies":
        """The bodies of a robot's file, or capsules along its links.

        **Raises**

        - `ValueError`: a robot without shapes and without radius, a mesh that cannot be read.
        - `MissingExtraError`: without MuJoCo.
        """
        if len(robot.independent_joints) < robot.joint_count:
            raise ValueError(
                f"surroundings: {robot.name!r} has joints that follow others, whose shapes are not"
                " moved; expected them fixed (--mimic fix), or limits without [surroundings]"
            )
        model, columns = compiled_geometry(robot, surroundings)
        pairs = _candidate_pairs(model, surroundings)
        coal = CoalShapes.of(model) if surroundings.distances == "coal" else None
        everything = cls(model, columns, pairs, np.zeros((0, 0)), np.zeros(0), coal)
        usual, apart = everything._usual_distances(2.0 * surroundings.clearance + 1e-3)
        wanted = np.minimum(surroundings.clearance, usual[apart] / 2)
        pairs = pairs[apart]
        return cls(model, columns, pairs, _levers(model, columns, pairs), wanted, coal)

    def distances(
        self, q: Float[np.ndarray, " joints"], farthest: float
    ) -> tuple[Float[np.ndarray, " pairs"], Float[np.ndarray, "pairs 6"], Any]:
        """Compute the distances of all pairs in a pose, at most `farthest` [m].

        Also returns the nearest points, and MuJoCo's data.
        """
        mujoco: Any = require("mujoco", "urdf")
        data = _data_of(self.model)
        data.qpos[self.columns] = q
        mujoco.mj_kinematics(self.model, data)
        mujoco.mj_comPos(self.model, data)
        first, second = self.pairs.T
        gap = np.linalg.norm(data.geom_xpos[first] - data.geom_xpos[second], axis=1)
        gap -= self.model.geom_rbound[first] + self.model.geom_rbound[second]
        distance, ends = np.full(len(self.pairs), farthest), np.zeros((len(self.pairs), 6))
        for i in np.flatnonzero(gap < farthest):
            a, b = (int(g) for g in self.pairs[i])
            if self.coal is None:
                distance[i] = mujoco.mj_geomDistance(self.model, data, a, b, farthest, ends[i])
            else:
                distance[i] = self.coal.distance(data, a, b, farthest, ends[i])
        return distance, ends, data

    def contacts(self, q: Float[np.ndarray, "samples joints"], beside: float = _BESIDE) -> Contacts:
        """Distances and their slopes along a motion on a grid, those that are small.

        **Arguments**

        - `q`: positions on the grid.
        - `beside`: is kept beside the clearance [m].
        """
        mujoco: Any = require("mujoco", "urdf")
        n = q.shape[1]
        rows: list[tuple[int, float, np.ndarray]] = []
        jacobians = np.zeros((2, 3, self.model.nv))
        dofs = self.model.jnt_dofadr[_joint_ids(self.model, self.columns)]
        for sample in range(len(q)):
            distance, ends, data = self.distances(q[sample], _FAR)
            for i in np.flatnonzero(distance < _FAR):
                for point, geom, jacobian in zip(
                    (ends[i, :3], ends[i, 3:]), self.pairs[i], jacobians, strict=True
                ):
                    body = int(self.model.geom_bodyid[geom])
                    mujoco.mj_jac(self.model, data, jacobian, None, point, body)
                way = ends[i, 3:] - ends[i, :3]
                length = float(np.linalg.norm(way))
                if length < 1e-9:
                    continue
                direction = np.sign(distance[i] or 1.0) * way / length
                slope = direction @ (jacobians[1] - jacobians[0])[:, dofs]
                share = self.wanted[i] / self.wanted.max()
                beyond = float(distance[i]) - self.wanted[i] - share * beside
                rows.append((sample, beyond, slope))
        sample = np.array([row[0] for row in rows], int)
        return padded_contacts(
            Contacts(
                sample,
                np.array([row[1] for row in rows]),
                np.array([row[2] for row in rows]).reshape(-1, n),
                q[sample] if rows else np.zeros((0, n)),
            )
        )

    def clearance(self, family: AbstractFamily, parameters: Parameters) -> tuple[float, str]:
        """Compute what is left of the clearance along a whole motion [m], and between which bodies.

        Between two instants no distance of a pair is less than the mean of those at both, less half
        of what the joints between its bodies can move any of their points meanwhile. Where that is
        not enough, the interval is halved.
        """
        if not len(self.pairs):
            return _FAR, "no bodies"
        parameters = np.asarray(parameters, float)
        time = sample_times(family.duration, 1.0 / _COARSE)
        positions = np.asarray(family.derivative(parameters, time))
        beyond = self._beyond(positions)
        name = self._pair_name(int(beyond.min(0).argmin()))
        lowest = float(beyond.min())
        if lowest < 0.0:
            return lowest, name
        speed = np.abs(np.asarray(family.derivative(parameters, time, 1)))
        acceleration = family.bound(parameters, 2)
        start, end, before, after = time[:-1], time[1:], beyond[:-1], beyond[1:]
        fastest = np.maximum(speed[:-1], speed[1:])
        while len(start):
            span = (end - start)[:, None]
            # No joint is faster meanwhile than at the ends and what acceleration adds.
            travel = span * (fastest + span / 2 * acceleration) @ self.levers.T
            sure = ((before + after - travel) / 2).min(1)
            if span[0, 0] <= _FINE:
                lowest = min(lowest, float(sure.min()))
                break
            open_ = sure < 0.0
            lowest = min(lowest, float(sure[~open_].min(initial=np.inf)))
            start, end, before, after = (x[open_] for x in (start, end, before, after))
            middle = (start + end) / 2
            positions = np.asarray(family.derivative(parameters, middle))
            between = self._beyond(positions)
            fastest = np.concatenate([fastest[open_]] * 2)
            start, end = np.concatenate([start, middle]), np.concatenate([middle, end])
            before, after = np.concatenate([before, between]), np.concatenate([between, after])
        return lowest, name

    def _beyond(
        self, positions: Float[np.ndarray, "poses joints"]
    ) -> Float[np.ndarray, "poses pairs"]:
        """Compute the distances of pairs less what is wanted [m]; those far away are alike."""
        far = _FAR + float(self.wanted.max())
        distances = [self.distances(pose, far)[0] for pose in positions]
        return np.reshape(distances, (len(positions), len(self.pairs))) - self.wanted

    def _pair_name(self, pair: int) -> str:
        names = [self._geom_name(int(geom)) for geom in self.pairs[pair]]
        return f"{names[0]} and {names[1]}"

    def _geom_name(self, geom: int) -> str:
        body = int(self.model.geom_bodyid[geom])
        return self.model.geom(geom).name if body == 0 else self.model.body(body).name

    def _usual_distances(self, farthest: float) -> tuple[np.ndarray, np.ndarray]:
        """The median distance of each pair over random poses, up to `farthest` [m]; and which pairs
        are not of bodies, or of a body and an obstacle, that touch in nearly every pose."""
        model = self.model
        rng = np.random.default_rng(0)
        low, high = model.jnt_range[_joint_ids(model, self.columns)].T
        free = low >= high
        low, high = np.where(free, -np.pi, low), np.where(free, np.pi, high)
        distance = np.stack(
            [self.distances(rng.uniform(low, high), farthest)[0] for _ in range(_POSES)]
        )
        always = np.mean(distance <= 0.0, axis=0) >= _ALWAYS

        def key(pair: np.ndarray) -> tuple[int, ...]:
            bodies = model.geom_bodyid[pair]
            return tuple(
                sorted(int(x) if x else -int(g) for x, g in zip(bodies, pair, strict=True))
            )

        joined = {key(pair) for pair in self.pairs[always]}
        apart = np.array([key(pair) not in joined for pair in self.pairs], bool)
        return np.median(distance, axis=0), apart


def _candidate_pairs(model: Any, surroundings: Surroundings) -> np.ndarray:
    """Pairs of geometries of bodies that no joint connects, and of moving ones and obstacles."""
    weld = model.body_weldid
    parent = weld[model.body_parentid]
    ignored = {frozenset(pair) for pair in surroundings.ignore}
    pairs: list[tuple[int, int]] = []
    for a in range(model.ngeom):
        for b in range(a + 1, model.ngeom):
            first, second = (int(weld[model.geom_bodyid[g]]) for g in (a, b))
            if first == second:
                continue
            names = frozenset(
                model.geom(g).name if model.geom_bodyid[g] == 0 else model.body(x).name
                for g, x in ((a, model.geom_bodyid[a]), (b, model.geom_bodyid[b]))
            )
            obstacle = any(model.geom(g).name.startswith("obstacle") for g in (a, b))
            joined = not obstacle and (parent[first] == second or parent[second] == first)
            if joined or names in ignored or not (obstacle or surroundings.self_collision):
                continue
            pairs.append((a, b))
    return np.array(pairs, int).reshape(-1, 2)


def _levers(
    model: Any, columns: np.ndarray, pairs: np.ndarray
) -> Float[np.ndarray, "pairs joints"]:
    """Bound how far a unit of a joint's motion moves two geometries against each other."""
    of_geom = np.stack([_levers_of(model, columns, geom) for geom in range(model.ngeom)])
    first, second = of_geom[pairs[:, 0]], of_geom[pairs[:, 1]]
    # Joints that carry both move them alike.
    return np.where((first > 0) & (second > 0), 0.0, np.maximum(first, second))


def _levers_of(model: Any, columns: np.ndarray, geom: int) -> Float[np.ndarray, " joints"]:
    """Bound how far a unit of each joint's motion moves points of a geometry."""
    levers = np.zeros(len(columns))
    body = int(model.geom_bodyid[geom])
    reach = float(np.linalg.norm(model.geom_pos[geom]) + model.geom_rbound[geom])
    while body > 0:
        for joint in range(
            model.body_jntadr[body], model.body_jntadr[body] + model.body_jntnum[body]
        ):
            column = np.flatnonzero(columns == model.jnt_qposadr[joint])
            slides = int(model.jnt_type[joint]) == 2
            if column.size:
                anchor = float(np.linalg.norm(model.jnt_pos[joint]))
                levers[column[0]] = 1.0 if slides else reach + anchor
            reach += float(np.abs(model.jnt_range[joint]).max()) if slides else 0.0
        reach += float(np.linalg.norm(model.body_pos[body]))
        body = int(model.body_parentid[body])
    return levers


def _joint_ids(model: Any, columns: np.ndarray) -> np.ndarray:
    return np.array([int(np.flatnonzero(model.jnt_qposadr == c)[0]) for c in columns], int)


_kept: list[tuple[Any, Any]] = []


def _data_of(model: Any) -> Any:
    """MuJoCo's data of a model, made once."""
    mujoco: Any = require("mujoco", "urdf")
    for other, data in _kept:
        if other is model:
            return data
    data = mujoco.MjData(model)
    _kept[:] = [(model, data)]
    return data
