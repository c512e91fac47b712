"""Distances of a robot's bodies from each other and from obstacles, by MuJoCo.

Shapes come from `_shapes`. The search takes distances and their slopes on a grid (`contacts`); the
dense check bounds them at all times (`clearance`).
"""

import dataclasses
import functools
from typing import Any

import numpy as np
from jaxtyping import Float

from .._environment import require
from .._text_table import first_of
from ..manipulator import Manipulator
from ..network import JointProjection
from ._families import AbstractFamily, Parameters, sample_times
from ._limits import Surroundings
from ._search import CONTACTS, Contacts, padded_contacts
from ._shapes import LISTED, compiled_geometry, random_poses


# Settings of searches. `scripts/studies/excitation/study.py` judges them by what designs reach.
BESIDE = 0.004  # what a search keeps beside the clearance [m]
_FAR = 0.15  # how far the check looks beyond the clearance [m]
_WATCHED = 0.05  # and the search [m]
_COARSE, _FINE = 0.02, 0.0003125  # first and last interval of the check [s]
_SAME_POINT = 1e-9  # [m]
_SLIDE = 2  # mjtJoint.mjJNT_SLIDE
_ALWAYS = 0.9  # part of random poses; bodies that touch in so many are joined


@functools.cache
def _mujoco() -> Any:
    """The module, which thousands of poses ask for; raises `MissingExtraError` without it."""
    return require("mujoco", "urdf")


@dataclasses.dataclass(frozen=True, eq=False)
class CollisionBodies:
    """The shapes of a robot and of what surrounds it, and their distances.

    Bodies that a joint connects may touch, and those that touch in nearly every pose: their shapes
    overlap by design.

    **Attributes**

    - `data`: MuJoCo's, of a model whose bodies are the robot's and whose world holds the obstacles.
    - `joints`: of each joint, its index in the model.
    - `projection`: of all joints onto the independent ones; None where no joint follows another.
    - `pairs`: (pairs, 2) geometries whose distance counts.
    - `carried`: (pairs, 2, all joints) whether a joint moves either geometry.
    - `levers`: (pairs, n) how far a unit of a joint's motion moves points of one body of a pair
      against those of the other, at most [m/rad or 1].
    - `wanted`: (pairs,) the least distance [m]: the clearance, or half of the distance of bodies
      that are that near in most poses by design.
    - `notes`: sentences on what is looked for, and what is not.
    """

    data: Any
    joints: np.ndarray
    projection: JointProjection | None
    pairs: np.ndarray
    carried: np.ndarray
    levers: Float[np.ndarray, "pairs joints"]
    wanted: Float[np.ndarray, " pairs"]
    notes: tuple[str, ...] = ()

    @classmethod
    def of(cls, robot: Manipulator, surroundings: Surroundings) -> "CollisionBodies":
        """Make the bodies of a robot's file, with capsules for links without shapes.

        **Raises**

        - `ValueError`: a wrong number of radii, shapes that MuJoCo cannot compile.
        - `RobotError`: a length without value.
        - `MissingExtraError`: without MuJoCo.
        """
        model, joints, floor, notes = compiled_geometry(robot, surroundings)
        pairs = _candidate_pairs(model, surroundings)
        projection = JointProjection.of(robot)
        none, data = np.zeros(0), _mujoco().MjData(model)
        everything = cls(data, joints, projection, pairs, none, np.zeros((0, 0)), none)
        poses = random_poses(model, joints)[:, list(robot.independent_joints)]
        usual, apart = everything._usual_distances(poses, 2.0 * surroundings.clearance + 1e-3)
        wanted = np.minimum(surroundings.clearance, usual[apart] / 2)
        touching = [_pair_name(model, pair) for pair in pairs[~apart]]
        pairs = pairs[apart]
        of_geom = np.stack([_levers(model, joints, geom) for geom in range(model.ngeom)])
        carried = of_geom[pairs] > 0.0
        # Joints that carry both bodies move them alike.
        levers = np.where(carried.all(1), 0.0, of_geom[pairs].max(1))
        if projection is not None:
            levers = levers @ np.abs(np.array(projection.matrix))
        notes = (*_looked_for(surroundings, floor, touching, any_pairs=len(pairs) > 0), *notes)
        return cls(data, joints, projection, pairs, carried, levers, wanted, notes)

    def _placed(self, q: Float[np.ndarray, " joints"]) -> None:
        """Set the pose of `data`."""
        data, model = self.data, self.data.model
        positions = q if self.projection is None else self.projection.positions(q)
        data.qpos[model.jnt_qposadr[self.joints]] = positions
        _mujoco().mj_kinematics(model, data)

    @functools.cached_property
    def _reach(self) -> Float[np.ndarray, " pairs"]:
        """Sum of the radii about both geometries of each pair [m]; planes have none."""
        bound = np.where(self.data.model.geom_rbound > 0, self.data.model.geom_rbound, np.inf)
        return bound[self.pairs].sum(1)

    @functools.cached_property
    def _numbers(self) -> list[tuple[int, int]]:
        """Geometries of each pair, as MuJoCo takes them."""
        return [(int(a), int(b)) for a, b in self.pairs]

    def distances(
        self, q: Float[np.ndarray, " joints"], farthest: float
    ) -> tuple[Float[np.ndarray, " pairs"], Float[np.ndarray, "pairs 6"]]:
        """Compute the distances of all pairs in a pose, at most `farthest` [m], and nearest points.

        `data` is then that of the pose.
        """
        data, model = self.data, self.data.model
        self._placed(q)
        place = data.geom_xpos
        apart = place[self.pairs[:, 0]] - place[self.pairs[:, 1]]
        near = np.einsum("pi,pi->p", apart, apart) < (farthest + self._reach) ** 2
        distance, ends = np.full(len(self.pairs), farthest), np.zeros((len(self.pairs), 6))
        measure, numbers = _mujoco().mj_geomDistance, self._numbers
        for i in near.nonzero()[0].tolist():
            distance[i] = measure(model, data, *numbers[i], farthest, ends[i])
        return distance, ends

    def contacts(
        self,
        q: Float[np.ndarray, "samples joints"],
        held: Contacts | None = None,
        *,
        every: int = 1,
        beside: float = BESIDE,
    ) -> Contacts:
        """Return distances with their slopes along a motion on a grid, where they count.

        They count where they are too small, or have a multiplier.

        **Arguments**

        - `q`: positions on the grid.
        - `held`: contacts with multipliers, of an earlier motion.
        - `every`: number of samples from one that is looked at to the next.
        - `beside`: is kept in addition to the clearance [m], at most that once more.
        """
        data, joints = self.data, self.joints
        multiplier = np.zeros((len(q), len(self.pairs)))
        if held is not None:
            kept = held.multiplier > 0.0
            multiplier[held.sample[kept], held.pair[kept]] = held.multiplier[kept]
        parts: list[tuple[np.ndarray, ...]] = []
        wanted = self.wanted + np.minimum(np.abs(self.wanted), beside)
        farthest = float(wanted.max()) + _WATCHED
        for sample in range(0, len(q), every):
            distance, ends = self.distances(q[sample], farthest)
            counts = (distance < wanted) | (multiplier[sample] > 0.0)
            if not counts.any():
                continue
            way = ends[:, 3:] - ends[:, :3]
            length = np.linalg.norm(way, axis=-1)
            pair = np.flatnonzero(counts & (length > _SAME_POINT))
            sign = np.where(distance[pair] < 0.0, -1.0, 1.0)
            direction = (sign / length[pair])[:, None] * way[pair]
            slides = data.model.jnt_type[joints] == _SLIDE
            axis, anchor = data.xaxis[joints], data.xanchor[joints]
            jacobian = np.zeros((len(pair), len(joints)))
            for body, point in enumerate(np.split(ends[pair], 2, axis=1)):
                velocity = np.where(slides[:, None], axis, np.cross(axis, point[:, None] - anchor))
                towards = np.einsum("cja,ca->cj", velocity, direction)
                jacobian += (-1.0, 1.0)[body] * self.carried[pair, body] * towards
            beyond = (distance - wanted)[pair]
            parts.append((np.full(len(pair), sample), pair, beyond, jacobian))
        if not parts:
            return padded_contacts(q.shape[1])
        sample, pair, beyond, jacobian = (np.concatenate(x) for x in zip(*parts, strict=True))
        first = np.argsort(beyond, kind="stable")[:CONTACTS]
        sample, pair, beyond, jacobian = (x[first] for x in (sample, pair, beyond, jacobian))
        if self.projection is not None:
            jacobian = jacobian @ np.array(self.projection.matrix)
        found = Contacts(sample, pair, beyond, jacobian, q[sample], multiplier[sample, pair])
        return padded_contacts(q.shape[1], found)

    def clearance(self, family: AbstractFamily, parameters: Parameters) -> tuple[float, str]:
        """Compute what is left of the clearance along a whole motion [m], and between which bodies.

        Between two instants no distance of a pair is less than the mean of those at both, less half
        of what the joints between its bodies can move any of their points meanwhile. Where that is
        not enough, the interval is halved.
        """
        parameters = np.asarray(parameters, float)
        time = sample_times(family.duration, 1.0 / _COARSE)
        positions = np.asarray(family.derivative(parameters, time))
        if not np.ptp(positions, axis=0).any():  # at rest
            time, positions = time[:1], positions[:1]
        beyond = self._beyond(positions)
        name = _pair_name(self.data.model, self.pairs[int(beyond.min(0).argmin())])
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

    def _usual_distances(
        self, poses: Float[np.ndarray, "poses joints"], farthest: float
    ) -> tuple[np.ndarray, np.ndarray]:
        """Return each pair's median distance over random poses, and which do not touch in most.

        Distances are up to `farthest` [m]. Pairs of the same two bodies are joined together.
        """
        model = self.data.model
        distance = np.stack([self.distances(pose, farthest)[0] for pose in poses])
        always = np.mean(distance <= 0.0, axis=0) >= _ALWAYS

        def key(pair: np.ndarray) -> tuple[int, ...]:
            bodies = model.geom_bodyid[pair]
            return tuple(
                sorted(int(x) if x else -int(g) for x, g in zip(bodies, pair, strict=True))
            )

        joined = {key(pair) for pair in self.pairs[always]}
        apart = np.array([key(pair) not in joined for pair in self.pairs], bool)
        return np.median(distance, axis=0), apart


def _looked_for(
    surroundings: Surroundings, floor: str, touching: list[str], *, any_pairs: bool
) -> tuple[str, ...]:
    """Return sentences on the collisions that are looked for, and on those that are not."""
    others = ["the robot's other bodies"] * surroundings.self_collision + [floor] * bool(floor)
    others += ["the workspace's walls"] * (surroundings.workspace is not None)
    for count, name, plural in (
        (len(surroundings.boxes), "box", "boxes"),
        (len(surroundings.spheres), "sphere", "spheres"),
    ):
        others += [f"{count} {plural if count > 1 else name}"] * bool(count)
    missing = ["a floor"] * (not floor) + ["the robot's bodies among each other"] * (
        not surroundings.self_collision
    )
    missing += ["tables, walls, cables and tools that no file states"]
    pairs = dict.fromkeys(touching)
    missing += [f"bodies that touch in most poses ({first_of([*pairs], LISTED)})"] * bool(pairs)
    looked = f"every body keeps {1e3 * surroundings.clearance:.3g} mm from {', '.join(others)}"
    return (
        f"collisions: {looked if any_pairs else 'there are no bodies to be kept apart'}",
        f"collisions were not looked for with {'; '.join(missing)}",
    )


def _geom_name(model: Any, geom: int) -> str:
    """Return the name of a geometry's body, of those of the world its own."""
    body = int(model.geom_bodyid[geom])
    return (model.geom(geom).name or "base") if body == 0 else model.body(body).name


def _pair_name(model: Any, pair: np.ndarray) -> str:
    return " and ".join(_geom_name(model, int(geom)) for geom in pair)


def _candidate_pairs(model: Any, surroundings: Surroundings) -> np.ndarray:
    """Return pairs of geometries of bodies that no joint connects, and of bodies and obstacles."""
    weld = model.body_weldid[model.geom_bodyid]
    parent = model.body_weldid[model.body_parentid[weld]]
    names = np.array([_geom_name(model, geom) for geom in range(model.ngeom)], object)
    obstacle = np.array(
        [model.geom(geom).name.startswith("obstacle") for geom in range(model.ngeom)]
    )
    a, b = np.triu_indices(model.ngeom, 1)
    apart = (weld[a] != weld[b]) & (parent[a] != weld[b]) & (parent[b] != weld[a])
    counts = (apart & surroundings.self_collision) | (obstacle[a] != obstacle[b]) & (
        weld[a] != weld[b]
    )
    for pair in surroundings.ignore:
        first, second = pair
        counts &= ~((names[a] == first) & (names[b] == second))
        counts &= ~((names[a] == second) & (names[b] == first))
    return np.stack([a, b], axis=1)[counts]


def _levers(model: Any, joints: np.ndarray, geom: int) -> Float[np.ndarray, " joints"]:
    """Bound how far a unit of each joint's motion moves points of a geometry."""
    levers = np.zeros(len(joints))
    body = int(model.geom_bodyid[geom])
    reach = float(np.linalg.norm(model.geom_pos[geom]) + model.geom_rbound[geom])
    while body > 0:
        for joint in range(
            model.body_jntadr[body], model.body_jntadr[body] + model.body_jntnum[body]
        ):
            column = np.flatnonzero(joints == joint)
            slides = int(model.jnt_type[joint]) == _SLIDE
            if column.size:
                anchor = float(np.linalg.norm(model.jnt_pos[joint]))
                levers[column[0]] = 1.0 if slides else reach + anchor
            reach += float(np.abs(model.jnt_range[joint]).max()) if slides else 0.0
        reach += float(np.linalg.norm(model.body_pos[body]))
        body = int(model.body_parentid[body])
    return levers
