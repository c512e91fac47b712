"""Shapes of robots' files: meshes of packages, what cannot be read; files of surroundings."""

import struct
from pathlib import Path

import numpy as np
import pytest

import jaxcslc as jc
from jaxcslc.excitation import CollisionBodies, Limits, Surroundings, load_limits


# A cube of 0.2 m: two triangles a face.
CORNERS = 0.1 * np.array([[x, y, z] for x in (-1, 1) for y in (-1, 1) for z in (-1, 1)], float)
FACES = [(0, 1, 3, 2), (4, 6, 7, 5), (0, 4, 5, 1), (2, 3, 7, 6), (0, 2, 6, 4), (1, 5, 7, 3)]
URDF = """<robot name="arm"><link name="base"/>
<joint name="turn" type="revolute"><parent link="base"/><child link="link"/><axis xyz="0 0 1"/>
 <limit lower="-3" upper="3" velocity="2" effort="10"/></joint>
<link name="link"><inertial><mass value="1"/><inertia ixx="1" iyy="1" izz="1" ixy="0" ixz="0"
 iyz="0"/></inertial><visual><geometry><mesh filename="missing.dae"/></geometry></visual>
 <collision><origin xyz="0.5 0 0"/><geometry><mesh filename="{mesh}"/></geometry></collision>
</link></robot>"""


def stl() -> bytes:
    """A binary STL file of the cube."""
    triangles = [(a, b, c) for a, b, c, _ in FACES] + [(a, c, d) for a, _, c, d in FACES]
    facets = [
        struct.pack("<12fH", 0, 0, 0, *CORNERS[list(corners)].ravel(), 0) for corners in triangles
    ]
    return bytes(80) + struct.pack("<I", len(facets)) + b"".join(facets)


def robot_with(folder: Path, mesh: str) -> jc.Manipulator:
    """A link whose shape is a mesh, in a package of ROS."""
    (folder / "arm_description" / "urdf").mkdir(parents=True)
    (folder / "arm_description" / "meshes").mkdir()
    (folder / "arm_description" / "meshes" / "cube.stl").write_bytes(stl())
    (folder / "arm_description" / "meshes" / "cube.dae").write_text("<COLLADA/>")
    path = folder / "arm_description" / "urdf" / "arm.urdf"
    path.write_text(URDF.format(mesh=mesh))
    return jc.load_robot(path)


@pytest.mark.parametrize(
    "mesh", ["package://arm_description/meshes/cube.stl", "../meshes/cube.stl"]
)
def test_meshes_are_looked_for_as_ros_does(tmp_path: Path, mesh: str) -> None:
    surroundings = Surroundings(spheres=(((1.0, 0.0, 0.0), 0.15),), floor=-0.4)
    bodies = CollisionBodies.of(robot_with(tmp_path, mesh), surroundings)
    distance, _ = bodies.distances(np.zeros(1), 2.0)
    # From the cube's face to the sphere, and from its lower face to the floor.
    np.testing.assert_allclose(np.sort(distance), [1.0 - 0.15 - 0.6, 0.4 - 0.1], atol=1e-6)
    turned, _ = bodies.distances(np.array([np.pi / 4]), 2.0)
    corner = np.array([np.cos(np.pi / 4), np.sin(np.pi / 4)])
    nearest = 0.5 * corner + 0.1 * corner + 0.1 * np.array([corner[1], -corner[0]])
    gap = float(np.linalg.norm([1.0, 0.0] - nearest)) - 0.15
    assert turned.max() == pytest.approx(gap, abs=1e-6)


@pytest.mark.parametrize(
    ("mesh", "message"),
    [
        (
            "package://other/meshes/no.stl",
            "were not found in a folder above the URDF: package://other/meshes/no.stl",
        ),
        ("../meshes/cube.dae", "cannot be read (only .stl, .obj, .msh): cube.dae"),
    ],
)
def test_meshes_that_cannot_be_read_are_named_and_replaced(
    tmp_path: Path, mesh: str, message: str
) -> None:
    """The link has its frame and its mass at its joint: a ball of the usual radius of 55 mm."""
    bodies = CollisionBodies.of(robot_with(tmp_path, mesh), Surroundings(floor=-1.0))
    assert any(message in note for note in bodies.notes)
    assert bodies.notes[-1].startswith("capsules of 55 mm radius stand for all links")
    assert bodies.distances(np.zeros(1), 2.0)[0] == pytest.approx([0.945], abs=1e-6)


def standing(folder: Path, base: str, *, up: float = 1.0, tool: str = "") -> CollisionBodies:
    """An upright arm of two links, the upper 0.5 m long with a shape, the fore one without.

    `up` is -1 for an arm that hangs. The fore link's centre of gravity is 0.2 m out.
    """
    mass = (
        f'<inertial><origin xyz="0 0 {0.2 * up}"/><mass value="1"/>'
        '<inertia ixx="1" iyy="1" izz="1" ixy="0" ixz="0" iyz="0"/></inertial>'
    )
    joints = "".join(
        f'<joint name="{child}" type="revolute"><parent link="{parent}"/><child link="{child}"/>'
        f'<origin xyz="0 0 {at * up}"/><axis xyz="0 1 0"/>'
        '<limit lower="-1" upper="1" velocity="2" effort="10"/></joint>'
        for parent, child, at in (("base", "upper", 0.3), ("upper", "fore", 0.5))
    )
    path = folder / "arm.urdf"
    path.write_text(
        f'<robot name="arm"><link name="base">{base}</link><link name="upper">{mass}'
        f'<collision><origin xyz="0 0 {0.25 * up}"/><geometry><box size="0.1 0.1 0.4"/></geometry>'
        f'</collision></link><link name="fore">{mass}</link>{tool}{joints}</robot>'
    )
    return CollisionBodies.of(jc.load_robot(path), Surroundings())


FOOT = (
    '<collision><origin xyz="0 0 {at}"/><geometry><box size="0.1 0.1 0.3"/></geometry></collision>'
)
RADIUS = 0.055 * 0.5  # of capsules, from the shoulder to the elbow
TOOL = (
    '<link name="flange"/><joint name="tool" type="fixed"><parent link="fore"/>'
    '<child link="flange"/><origin xyz="0.3 0 0"/></joint>'
)


def height_of_tip(bodies: CollisionBodies, q: list[float]) -> float:
    """Lowest point of the fore link above the floor: the pair's distance."""
    model = bodies.data.model
    floor, fore = model.geom("obstacle floor").id, model.body("fore").id
    pair = [
        {floor, fore} == {int(a), int(model.geom_bodyid[b])}
        or {floor, fore} == {int(b), int(model.geom_bodyid[a])}
        for a, b in bodies.pairs
    ]
    return float(bodies.distances(np.array(q), 5.0)[0][pair].min())


@pytest.mark.parametrize(("base", "foot"), [("", 0.0), (FOOT.format(at=-0.05), -0.2)])
def test_the_floor_is_at_the_foot_of_the_base(tmp_path: Path, base: str, foot: float) -> None:
    bodies = standing(tmp_path, base)
    assert f"a floor at z = {foot:g} m (the base's foot)" in bodies.notes[0]
    # Lying, the fore link is at the height of the shoulder and 0.5 m up.
    assert height_of_tip(bodies, [0.0, np.pi / 2]) == pytest.approx(0.8 - foot - RADIUS, abs=1e-6)


def test_links_without_shapes_end_at_twice_their_centre_of_gravity(tmp_path: Path) -> None:
    bodies = standing(tmp_path, "")
    assert height_of_tip(bodies, [0.0, np.pi]) == pytest.approx(0.4 - RADIUS, abs=1e-6)
    assert bodies.notes[-1].startswith("capsules of 27.5 mm radius stand for fore, for which")


def test_links_without_shapes_end_at_what_is_fixed_to_them(tmp_path: Path) -> None:
    bodies = standing(tmp_path, "", tool=TOOL)
    assert height_of_tip(bodies, [0.0, np.pi / 2]) == pytest.approx(0.5 - RADIUS, abs=1e-6)


def test_files_that_cannot_be_compiled_have_capsules(tmp_path: Path) -> None:
    path = tmp_path / "arm.xml"
    mesh = '<asset><mesh name="m" file="none.stl"/></asset><worldbody>'
    path.write_text(
        MJCF.replace("<worldbody>", mesh).replace('type="capsule"', 'type="mesh" mesh="m"', 1)
    )
    bodies = CollisionBodies.of(jc.load_robot(path), Surroundings())
    assert any("shapes of the robot's file cannot be read" in note for note in bodies.notes)
    assert bodies.notes[-1].startswith("capsules of 27.5 mm radius stand for all links")


def test_an_arm_that_hangs_has_a_ceiling(tmp_path: Path) -> None:
    bodies = standing(tmp_path, FOOT.format(at=0.05), up=-1.0)
    assert "a ceiling at z = 0.2 m (the base's foot)" in bodies.notes[0]
    assert bodies.distances(np.zeros(2), 5.0)[0].min() > 0.0


def test_without_a_floor_that_is_said(tmp_path: Path) -> None:
    limits = Limits.of(jc.panda(), surroundings="usual").without_floor()
    assert limits.surroundings is not None
    bodies = CollisionBodies.of(jc.panda(), limits.surroundings)
    assert "floor" not in bodies.notes[0]
    assert bodies.notes[1].startswith("collisions were not looked for with a floor;")


LIMITS = """[joints]
velocity = 1.5
[surroundings]
clearance = 0.03
self_collision = false
floor = -0.1
workspace = [[-1, -1, -0.5], [1, 1, 1.5]]
boxes = [[[0.6, 0, 0.2], [0.2, 0.2, 0.4]]]
spheres = [[[0, 0.7, 0.5], [0.1]]]
radius = [0.06, 0.05, 0.05, 0.05, 0.05, 0.05]
ignore = [["link 1", "link 3"]]
"""


def test_all_surroundings_of_a_file_are_read(tmp_path: Path) -> None:
    path = tmp_path / "limits.toml"
    path.write_text(LIMITS)
    limits = load_limits(path, jc.puma560())
    assert limits.velocity.tolist() == [1.5] * 6
    assert limits.surroundings == Surroundings(
        clearance=0.03,
        self_collision=False,
        floor=-0.1,
        workspace=((-1.0, -1.0, -0.5), (1.0, 1.0, 1.5)),
        boxes=(((0.6, 0.0, 0.2), (0.2, 0.2, 0.4)),),
        spheres=(((0.0, 0.7, 0.5), 0.1),),
        radius=(0.06, 0.05, 0.05, 0.05, 0.05, 0.05),
        ignore=(("link 1", "link 3"),),
    )


def test_without_the_table_floor_and_bodies_are_watched(tmp_path: Path) -> None:
    path = tmp_path / "limits.toml"
    path.write_text("[joints]\nvelocity = 1.5\n")
    assert load_limits(path, jc.puma560()).surroundings == Surroundings(floor=-0.6718)
    path.write_text("[surroundings]\nfloor = false\n")
    assert load_limits(path, jc.puma560()).surroundings == Surroundings(floor=None)


def test_lengths_without_values_are_said_to_be_unwatched() -> None:
    arm = jc.Manipulator.from_modified_dh([(0, 0, 0, 0), (0, "a1", 0, 0)])
    limits = Limits.of(arm, {"position": [-1, 1], "velocity": 1, "torque": 9}, "usual")
    assert limits.surroundings is None
    assert "collisions: lengths of 'robot' have no values" in limits.notes


@pytest.mark.parametrize(
    ("text", "message"),
    [
        ("walls = 1", "surroundings: unknown entry 'walls'; expected boxes, clearance"),
        ("floor = 'low'", "surroundings, floor: expected numbers in m, got 'low'"),
        ("clearance = inf", "surroundings, clearance: expected numbers in m, got inf"),
        ("self_collision = {}", "surroundings, self_collision: expected true or false, got {}"),
        ("ignore = 3", "surroundings, ignore: expected pairs of bodies' names, got 3"),
        ("ignore = [['arm']]", "surroundings, ignore: expected pairs of bodies' names"),
        ("boxes = 3", "surroundings, boxes: expected lists, got 3"),
        ("workspace = [[0, 0], [1, 1]]", "surroundings, workspace: expected 3 and 3 numbers in m"),
        ("boxes = [[[0, 0, 0], [1, 1]]]", "surroundings, boxes: expected 3 and 3 numbers in m"),
        ("boxes = [[[0, 0, 'x'], [1, 1, 1]]]", "surroundings, boxes: expected 3 and 3 numbers"),
        (f"boxes = [[[0, 0, 1{'0' * 400}], [1, 1, 1]]]", "surroundings, boxes: expected 3 and 3"),
        ("boxes = [[[0, 0, nan], [1, 1, 1]]]", "surroundings, boxes: expected 3 and 3 numbers"),
        ("spheres = [[[0, 0, 0], [1, 2]]]", "surroundings, spheres: expected 3 and 1 numbers in m"),
    ],
)
def test_wrong_surroundings_are_named_with_their_file(
    tmp_path: Path, text: str, message: str
) -> None:
    path = tmp_path / "limits.toml"
    path.write_text(f"[surroundings]\n{text}\n")
    with pytest.raises(ValueError, match=rf"limits\.toml: {message}"):
        load_limits(path, jc.puma560())


@pytest.mark.parametrize(
    ("text", "message"),
    [
        ("[other]\n", "unknown entry 'other'; expected joints or surroundings"),
        ("joints = 3\n", "joints: expected a table, got 3"),
    ],
)
def test_other_tables_are_named(tmp_path: Path, text: str, message: str) -> None:
    path = tmp_path / "limits.toml"
    path.write_text(text)
    with pytest.raises(ValueError, match=message):
        load_limits(path, jc.puma560())


MJCF = """<mujoco><worldbody><geom type="plane" size="1 1 1"/><body name="upper" pos="0 0 0.3">
<joint name="lift" axis="0 1 0" range="-100 100"/><geom type="capsule" size="0.05"
 fromto="0 0 0 0 0 0.4"/><body name="fore" pos="0 0 0.5"><joint name="bend" axis="0 1 0"
 range="-100 100"/><geom type="capsule" size="0.05" fromto="0 0 0 0 0 0.3"/></body></body>
</worldbody></mujoco>"""


def test_the_floor_of_a_file_is_the_floor(tmp_path: Path) -> None:
    path = tmp_path / "arm.xml"
    path.write_text(MJCF)
    bodies = CollisionBodies.of(jc.load_robot(path), Surroundings())
    assert "the floor of the robot's file" in bodies.notes[0]
    # Upright, the upper arm's end; lying, the fore arm's, whose joint is at the shoulder's height.
    distance, _ = bodies.distances(np.array([np.pi / 2, 0.0]), 5.0)
    assert distance.min() == pytest.approx(0.3 - 0.05, abs=1e-6)


MIMIC = URDF.replace("</robot>", "").format(mesh="none.stl") + (
    '<joint name="follow" type="revolute"><parent link="link"/><child link="hand"/>'
    '<origin xyz="0.5 0 0"/><axis xyz="0 0 1"/><mimic joint="turn" multiplier="-2" offset="0.1"/>'
    '<limit lower="-9" upper="9" velocity="2" effort="10"/></joint><link name="hand"><inertial>'
    '<origin xyz="0.2 0 0"/><mass value="1"/><inertia ixx="1" iyy="1" izz="1" ixy="0" ixz="0"'
    ' iyz="0"/></inertial></link></robot>'
)


def test_joints_that_follow_move_their_shapes(tmp_path: Path) -> None:
    path = tmp_path / "arm.urdf"
    path.write_text(MIMIC)
    robot = jc.load_robot(path, mimic="couple")
    ball = Surroundings(floor=None, radius=0.02, spheres=(((0.75, 0.25, 0.0), 0.1),))
    bodies = CollisionBodies.of(robot, ball)

    def distance(angle: float) -> float:
        """From the hand, 0.4 m long, which turns back twice as far as the link turns."""
        along = np.array(
            [[np.cos(angle), np.sin(angle)], [np.cos(0.1 - angle), np.sin(0.1 - angle)]]
        )
        wrist = 0.5 * along[0]
        part = np.clip((np.array([0.75, 0.25]) - wrist) @ along[1] / 0.4, 0.0, 1.0)
        return float(np.linalg.norm(wrist + 0.4 * part * along[1] - [0.75, 0.25])) - 0.12

    angle, step = 0.6, 1e-6
    contacts = bodies.contacts(np.array([[angle]]))
    nearest = contacts.distance.argmin()
    assert bodies.distances(np.array([angle]), 5.0)[0].min() == pytest.approx(
        distance(angle), abs=1e-6
    )
    slope = (distance(angle + step) - distance(angle - step)) / (2 * step)
    assert contacts.jacobian[nearest, 0] == pytest.approx(slope, abs=1e-4)
