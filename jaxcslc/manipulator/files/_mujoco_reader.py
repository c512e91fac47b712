"""Bodies and joints of a URDF or MJCF file, as MuJoCo's own loader understands them.

Everything but bodies and joints is removed before the file is compiled, so that no mesh is read.
"""

import math
import warnings
from collections.abc import Generator, Iterator, Mapping, Sequence
from contextlib import contextmanager
from pathlib import Path
from threading import RLock
from typing import Any, NamedTuple
from xml.sax.saxutils import quoteattr

import numpy as np
from jaxtyping import Float

from jaxcslc._environment import require
from jaxcslc._processes import computed_in_bounds

from .._joint import LARGEST, JointKind, RobotError
from .._link_parameters import LinkParameters
from .._manipulator import JointLimits, Manipulator, Mimic
from ._urdf import Edit, simplified


# By which a file's numbers may miss being an inertia, relatively, and absolutely [kg m²]: inertias
# of links of next to no mass are rounding.
_ROUNDING, _SMALLEST = 1e-9, 1e-15

# Arms take a tenth of a second and less than 100 MB, most of it MuJoCo itself; the largest of files
# that are not refused before take 5 s. A bound is for what was made to take more [s], [bytes].
_LONGEST, _MOST_MEMORY = 20.0, 2 << 30

WORLD = "world"  # what MuJoCo calls the body that carries all others

Pose = Float[np.ndarray, "4 4"]


class FileJoint(NamedTuple):
    """A joint of a file, its axis in the frame of the body that it moves."""

    name: str
    kind: JointKind | None  # None: of a kind that is not represented
    type: str
    axis: Float[np.ndarray, "3"]
    anchor: Float[np.ndarray, "3"]
    zero: float  # what the joint reads at the file's zero position
    armature: float
    damping: float
    friction_loss: float
    stiffness: float
    limits: JointLimits  # of range and torque, as MJCF states them
    fault: str | None  # why it is not represented, though of a kind that is


class Body(NamedTuple):
    """A body of a file: its pose in its parent, its inertia, its joints."""

    name: str
    parent: int  # index of the body that carries it; -1 for the world itself
    pose: Pose  # of its frame in the parent's
    inertia: LinkParameters | None  # in the body's frame; None: a mesh's, or none at all
    joints: tuple[FileJoint, ...]
    fault: str | None  # why the inertia stated is none that a body can have


Loops = tuple[tuple[str, tuple[str, str]], ...]


class BodyTree(NamedTuple):
    """Bodies of a file, parents first; the first is the world."""

    bodies: tuple[Body, ...]
    gravity: tuple[float, float, float]
    leaders: Mapping[str, str]  # of joints that follow others, or are held by the world
    loops: Loops  # other constraints: kind, what they connect
    mimics: Sequence[Mimic] = ()  # joints that follow others by a linear law

    @property
    def joints(self) -> list[FileJoint]:
        return [joint for body in self.bodies for joint in body.joints]

    def carried_by(self, body: int) -> set[int]:
        """Return a body and all that it carries."""
        return {i for i in range(len(self.bodies)) if body in self.path(i)}

    def path(self, body: int) -> Iterator[int]:
        """Yield the indices of the bodies from a body to the world, both included."""
        while body >= 0:
            yield body
            body = self.bodies[body].parent


def read_bodies(path: Path, *, urdf: bool, edits: Sequence[Edit] = ()) -> BodyTree:
    """The bodies and joints of a URDF or MJCF file, as MuJoCo's own loader understands them.

    Meshes, sensors, actuators and the like are removed before the file is compiled, so that no mesh
    is read. Bodies without an inertial element have no mass in URDF, and that of their geometry
    in MJCF; where that is a mesh, `inertia` is None. Numbers that no body can have are a `fault` of
    the body: it matters only to a robot that the body is part of. `edits` are made in a URDF before
    MuJoCo sees it.

    **Raises**

    - `RobotError`: in one line, from MuJoCo.
    - `MissingExtraError`: without MuJoCo.
    """

    def read() -> BodyTree:
        with _without_warnings():
            return _read(path, urdf, edits)

    try:
        return computed_in_bounds(read, seconds=_LONGEST, memory=_MOST_MEMORY)
    except (ChildProcessError, MemoryError) as error:
        why = " ".join(str(error).split()) or "too little memory"
        raise RobotError(f"{path}: MuJoCo cannot read it: {why}") from None


def mujoco_spec(robot: Manipulator) -> Any:
    """Return the file of a robot as a `mujoco.MjSpec`, without meshes, sensors and actuators.

    Joints of the file that are none of the robot's are removed: bodies are fixed where they are.

    - `robot`: read from a URDF or MJCF file.

    **Raises**

    - `RobotError`: another robot, or a file that MuJoCo cannot read.
    - `MissingExtraError`: without MuJoCo.
    """
    source = robot.source
    if source is None or source.format == "toml":
        raise RobotError(
            f"robot {robot.name!r}: expected one that was read from a URDF or MJCF file"
        )
    path = Path(source.path)
    with _without_warnings():
        try:
            spec = _parsed(path, source.format == "urdf", ())
        except (ValueError, OSError) as error:
            raise RobotError(f"{path}: {' '.join(str(error).split())}") from None
    _name(spec)
    _without_geometry(spec, source.format == "urdf")
    _delete([joint for joint in spec.joints if joint.name not in source.joints], spec)
    moving = {joint.name for joint in spec.joints}
    _delete([e for e in spec.equalities if not {e.name1, e.name2 or e.name1} <= moving], spec)
    return spec


def _read(path: Path, urdf: bool, edits: Sequence[Edit]) -> BodyTree:
    try:
        spec = _parsed(path, urdf, edits)
    except ValueError as error:
        raise _mujoco_error(path, error) from None
    _name(spec)
    inertials = {body.name: _inertial(body) for body in spec.bodies if body.explicitinertial}
    faults = {name: _fault(*numbers) for name, numbers in inertials.items()}
    strongest = _actuator_torques(spec)
    unknown = _without_geometry(spec, urdf)
    massless = {b.name for b in spec.bodies if not (b.explicitinertial or b.geoms)} - unknown
    stated = _replaced_inertias(spec, {*inertials, *unknown, *massless})
    leaders, loops, laws = _constraints(spec)
    _delete(spec.equalities, spec)
    spec.compiler.fusestatic = False
    try:
        model: Any = spec.compile()
    except ValueError as error:
        raise _mujoco_error(path, error) from None
    bodies: list[Body] = []
    for i in range(model.nbody):
        name = model.body(i).name
        rotation = _rotation(model.body_iquat[i])
        if name in unknown or faults.get(name):
            inertia = None
        elif name in massless:
            inertia = LinkParameters(0.0, np.zeros(3), np.zeros((3, 3)))
        elif name in inertials:
            mass, _, tensor = inertials[name]
            inertia = LinkParameters(mass, stated[name], rotation @ tensor @ rotation.T)
        else:
            tensor = rotation @ np.diag(model.body_inertia[i]) @ rotation.T
            inertia = LinkParameters(float(model.body_mass[i]), model.body_ipos[i].copy(), tensor)
        pose = np.eye(4)
        pose[:3, :3], pose[:3, 3] = _rotation(model.body_quat[i]), model.body_pos[i]
        parent = int(model.body_parentid[i]) if i else -1
        joints = tuple(_joints(model, i, strongest))
        bodies.append(Body(name, parent, pose, inertia, joints, faults.get(name)))
    x, y, z = (float(g) for g in spec.option.gravity)
    zero = {joint.name: joint.zero for body in bodies for joint in body.joints}
    mimics = (
        # MuJoCo's law is one of differences from the file's zero position.
        Mimic(y, x, slope, zero[y] + constant - slope * zero[x])
        for y, x, constant, slope in laws
        if y in zero and x in zero
    )
    return BodyTree(tuple(bodies), (x, y, z), leaders, loops, tuple(mimics))


def _parsed(path: Path, urdf: bool, edits: Sequence[Edit]) -> Any:
    mujoco: Any = require("mujoco", "urdf")
    # MuJoCo chooses its reader by the suffix, and has none for ".URDF" and ".mjcf".
    if urdf:
        return mujoco.MjSpec.from_string(simplified(path.read_bytes(), edits).decode())
    if path.suffix == ".xml":
        return mujoco.MjSpec.from_file(str(path))
    # Read as an included file, it finds its own includes beside it.
    whole = f"<mujoco><include file={quoteattr(str(path.resolve()))}/></mujoco>"
    return mujoco.MjSpec.from_string(whole)


_handler = RLock()  # MuJoCo has one for all threads


@contextmanager
def _without_warnings() -> Generator[None]:
    """Keep MuJoCo from printing warnings, and from noting them in a file of the current folder.

    They are about limits, geometry and the like, which are not read.
    """
    mujoco: Any = require("mujoco", "urdf")

    def ignore(_: str) -> None:
        pass

    with _handler:
        before: Any = mujoco.get_mju_user_warning()
        mujoco.set_mju_user_warning(ignore)
        try:
            with warnings.catch_warnings():
                warnings.simplefilter("ignore")  # MuJoCo warns by Python's means too
                yield
        finally:
            mujoco.set_mju_user_warning(before)


Stated = tuple[float, Float[np.ndarray, "3"], Float[np.ndarray, "3 3"]]


def _inertial(body: Any) -> Stated:
    """Mass, centre and tensor that an inertial element states, the tensor in the element's axes."""
    full = np.asarray(body.fullinertia)
    if np.isnan(full[0]):
        tensor = np.diag(np.asarray(body.inertia, dtype=float))
    else:
        xx, yy, zz, xy, xz, yz = full
        tensor = np.array([[xx, xy, xz], [xy, yy, yz], [xz, yz, zz]])
    return float(body.mass), np.array(body.ipos, dtype=float), tensor


def _fault(
    mass: float, centre: Float[np.ndarray, "3"], tensor: Float[np.ndarray, "3 3"]
) -> str | None:
    """Return the reason why no body has such an inertia, or None if a body can have it."""
    if not np.isfinite([mass, *centre, *tensor.ravel()]).all():
        return "expected finite numbers in its inertial element"
    if mass < 0:
        return f"expected a mass of zero or more in kg, got {mass}"
    moments = np.linalg.eigvalsh(tensor)
    listed = ", ".join(f"{moment:.6g}" for moment in moments)
    rounding = _ROUNDING * abs(moments[2]) + _SMALLEST
    if moments[0] < -rounding:
        return (
            f"expected moments of inertia of zero or more in kg m², got principal moments {listed}"
        )
    if moments[0] + moments[1] < moments[2] - rounding:
        return (
            f"no body has principal moments of inertia {listed} kg m²: the largest must not"
            " exceed the sum of the others (triangle inequality)"
        )
    return None


def _without_geometry(spec: Any, urdf: bool) -> set[str]:
    """Remove all but bodies and joints. Returns names of bodies whose inertia would be a mesh's."""
    mujoco: Any = require("mujoco", "urdf")

    unknown: set[str] = set()
    primitive = {
        mujoco.mjtGeom.mjGEOM_PLANE,
        mujoco.mjtGeom.mjGEOM_SPHERE,
        mujoco.mjtGeom.mjGEOM_CAPSULE,
        mujoco.mjtGeom.mjGEOM_ELLIPSOID,
        mujoco.mjtGeom.mjGEOM_CYLINDER,
        mujoco.mjtGeom.mjGEOM_BOX,
    }
    for body in spec.bodies:
        for geom in list(body.geoms):
            has_mass = not (geom.mass == 0 or geom.density == 0)
            if geom.type not in primitive and has_mass and not body.explicitinertial and not urdf:
                unknown.add(body.name)
            if urdf or geom.type not in primitive or body.explicitinertial:
                spec.delete(geom)
            else:
                geom.material = ""  # of what remains: it is removed below
    spec.memory = spec.nstack = -1  # what a file allots may not do for tensors of its own
    for kind in (
        *("keys", "sensors", "actuators", "tendons", "excludes", "pairs", "tuples", "skins"),
        *("flexes", "cameras", "lights", "sites", "meshes", "hfields", "materials", "textures"),
        *("numerics", "texts", "plugins"),
    ):
        _delete(getattr(spec, kind, ()), spec)
    return unknown


def _name(spec: Any) -> None:
    """Name the bodies and joints that have no name."""
    for i, element in enumerate([*spec.bodies, *spec.joints]):
        element.name = element.name or f"unnamed {i}"


def _delete(elements: Any, spec: Any) -> None:
    for element in list(elements):
        spec.delete(element)


def _replaced_inertias(spec: Any, names: set[str]) -> dict[str, Float[np.ndarray, "3"]]:
    """Replace inertias by a unit ball's. Returns the centres of gravity that the file states.

    MuJoCo compiles no moving body without mass, and rotates tensors to principal axes. It still
    computes orientations, which files state in five ways.
    """
    centres: dict[str, Float[np.ndarray, 3]] = {}
    for body in spec.bodies:
        if body.name in names or not (body.geoms or body.explicitinertial):
            centre = np.array(body.ipos, dtype=float)
            centres[body.name] = np.where(np.isfinite(centre), centre, 0.0)
            body.ipos = centres[body.name]
            body.mass, body.inertia, body.explicitinertial = 1.0, np.ones(3), True
            body.fullinertia = [np.nan, 0, 0, 0, 0, 0]
    return centres


Law = tuple[str, str, float, float]  # follower, leader, constant, slope


def _constraints(spec: Any) -> tuple[dict[str, str], Loops, list[Law]]:
    """Return the joints that follow others, with these; other constraints; and linear laws."""
    leaders: dict[str, str] = {}
    loops: list[tuple[str, tuple[str, str]]] = []
    laws: list[Law] = []
    for equality in spec.equalities:
        if not (equality.active and equality.name1):
            continue
        kind = equality.type.name.removeprefix("mjEQ_").lower()
        first, second = equality.name1, equality.name2 or WORLD
        if kind != "joint":
            loops.append((f"equality of kind {kind!r}", (first, second)))
            continue
        leaders[first] = second
        constant, slope, *powers = (float(x) for x in equality.data[:5])
        if equality.name2 and not any(powers):
            laws.append((first, second, constant, slope))
    return leaders, tuple(loops), laws


def _joints(model: Any, body: int, strongest: Mapping[str, float]) -> Iterator[FileJoint]:
    kinds: dict[int, tuple[JointKind | None, str]] = {
        0: (None, "free"),
        1: (None, "ball"),
        2: ("P", "slide"),
        3: ("R", "hinge"),
    }
    for j in range(model.body_jntadr[body], model.body_jntadr[body] + model.body_jntnum[body]):
        name, dof = model.jnt(j).name, int(model.jnt_dofadr[j])
        kind, type_name = kinds[int(model.jnt_type[j])]
        fault = None
        for what, poly, at in (
            ("damping", getattr(model, "dof_dampingpoly", None), dof),
            ("stiffness", getattr(model, "jnt_stiffnesspoly", None), j),
        ):
            if kind and poly is not None and np.any(poly[at]):  # coefficients of higher powers
                fault = f"{what} that is not linear is not modelled"
        for what, value in (
            ("armature", model.dof_armature[dof]),
            ("damping", model.dof_damping[dof]),
            ("friction loss", model.dof_frictionloss[dof]),
        ):
            if kind and not 0.0 <= value <= LARGEST:
                fault = f"{what} is {value:g}; expected 0 to {LARGEST:g}"
        yield FileJoint(
            name,
            kind,
            type_name,
            model.jnt_axis[j].copy(),
            model.jnt_pos[j].copy(),
            float(model.qpos0[model.jnt_qposadr[j]]) if kind else 0.0,
            float(model.dof_armature[dof]),
            float(model.dof_damping[dof]),
            float(model.dof_frictionloss[dof]),
            float(model.jnt_stiffness[j]),
            _limits(model, j, strongest.get(name, math.inf)),
            fault,
        )


def _limits(model: Any, joint: int, strongest: float) -> JointLimits:
    """Return a joint's limits of range and actuator torque; MJCF has none of speed."""
    low, high = -math.inf, math.inf
    if model.jnt_limited[joint]:
        low, high = (float(x) for x in model.jnt_range[joint])
    if model.jnt_actfrclimited[joint]:
        strongest = min(strongest, _both_ways(*model.jnt_actfrcrange[joint]))
    return JointLimits(low, high, torque=strongest)


def _actuator_torques(spec: Any) -> dict[str, float]:
    """Return the largest torque of joint actuators that state one, by the joint's name."""
    mujoco: Any = require("mujoco", "urdf")
    torques: dict[str, float] = {}
    for actuator in spec.actuators:
        on_joint = actuator.trntype == mujoco.mjtTrn.mjTRN_JOINT
        low, high = (float(x) for x in actuator.forcerange)
        limited = actuator.forcelimited != mujoco.mjtLimited.mjLIMITED_FALSE and low < high
        torque = abs(float(actuator.gear[0])) * _both_ways(low, high) if limited else math.inf
        if on_joint:  # of several on one joint, the torques add
            torques[actuator.target] = torques.get(actuator.target, 0.0) + torque
    return torques


def _both_ways(low: float, high: float) -> float:
    """The torque that an actuator has in both directions; infinite where it has only one."""
    return float(min(-low, high)) if low < 0.0 < high else math.inf


def _rotation(quaternion: Float[np.ndarray, "4"]) -> Float[np.ndarray, "3 3"]:
    w, x, y, z = np.asarray(quaternion) / np.linalg.norm(quaternion)
    return np.array(
        [
            [1 - 2 * (y * y + z * z), 2 * (x * y - w * z), 2 * (x * z + w * y)],
            [2 * (x * y + w * z), 1 - 2 * (x * x + z * z), 2 * (y * z - w * x)],
            [2 * (x * z - w * y), 2 * (y * z + w * x), 1 - 2 * (x * x + y * y)],
        ]
    )


def _mujoco_error(path: Path, error: ValueError) -> RobotError:
    """MuJoCo's message in one line."""
    return RobotError(f"{path}: {' '.join(str(error).split()).removeprefix('Error: ')}")
