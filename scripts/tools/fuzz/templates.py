"""Whole files that the fuzzer's cases are mutations of: robots, recordings, settings, results."""

import json
from pathlib import Path
from typing import Any

import numpy as np
import pyarrow as pa
import pyarrow.parquet as pq
from rosbags import rosbag1, rosbag2
from rosbags.typesys import Stores, get_typestore

import jaxcslc as jc
from scripts.tools.invoke import invoke


TOML = """name = "arm"
gravity = [0, -9.81, 0]
friction = ["viscous", "dry"]
coupled = [[1, 2]]

[lengths]
a1 = 0.25

[links]
inertia = "principal"
motor_inertia = true

[[joint]]
name = "shoulder"
d = 0.4
theta = 0.1
viscous = 1.5
[joint.link]
zero = ["rx", "ry"]
equal = [["Ixx", "Iyy"]]
mass = 2.0
centre_of_gravity = [0, 0, 0.1]
inertia_tensor = [0.2, 0.2, 0.1]
motor_inertia = 0.3

[[joint]]
name = "elbow"
kind = "R"
alpha = "-pi/2"
a = "a1"
viscous = 2.5
friction = ["viscous", "static"]
static_slope = 12
[joint.link]
inertia = "full"
motor = false
mass = 1.0
centre_of_gravity = [0.1, 0, 0]
inertia_tensor = [[0.1, 0.01, 0], [0.01, 0.2, 0], [0, 0, 0.3]]
"""
URDF = """<?xml version="1.0"?>
<robot name="arm">
  <link name="floor"/>
  <link name="upper">
    <inertial><origin xyz="0.1 0 0.2" rpy="0 0.3 0"/><mass value="2"/>
      <inertia ixx="0.1" iyy="0.2" izz="0.15" ixy="0.01" ixz="0" iyz="0"/></inertial>
    <visual><geometry><mesh filename="package://arm/upper.dae"/></geometry></visual>
  </link>
  <link name="lower">
    <inertial><mass value="1"/>
      <inertia ixx="0.1" iyy="0.1" izz="0.1" ixy="0" ixz="0" iyz="0"/></inertial>
  </link>
  <link name="finger"/>
  <joint name="shoulder" type="revolute">
    <parent link="floor"/><child link="upper"/><origin xyz="0 0 0.5" rpy="0 0 0"/>
    <axis xyz="0 1 0"/><limit lower="-2" upper="2" effort="50" velocity="3"/>
    <dynamics damping="0.5" friction="0.2"/>
  </joint>
  <joint name="elbow" type="continuous">
    <parent link="upper"/><child link="lower"/><origin xyz="0.3 0 0.1" rpy="1.5708 0 0"/>
    <axis xyz="0 1 0"/>
  </joint>
  <joint name="grip" type="prismatic">
    <parent link="lower"/><child link="finger"/><axis xyz="0 0 1"/>
    <limit lower="0" upper="0.1" effort="5" velocity="1"/><mimic joint="elbow" multiplier="2"/>
  </joint>
</robot>
"""
MJCF = """<mujoco model="arm">
  <compiler angle="radian"/>
  <option gravity="0 0 -9.81"/>
  <default><joint damping="0.3"/></default>
  <worldbody>
    <body name="upper" pos="0 0 0.5" euler="0.1 0 0">
      <joint name="shoulder" axis="0 1 0" range="-2 2" armature="0.01" frictionloss="0.1"/>
      <geom type="capsule" fromto="0 0 0 0.3 0 0" size="0.05" mass="2"/>
      <body name="lower" pos="0.3 0 0" quat="1 0 0.2 0">
        <joint name="elbow" type="slide" axis="1 0 0" stiffness="3"/>
        <inertial pos="0 0 0.1" mass="1" fullinertia="0.1 0.1 0.1 0.01 0 0"/>
        <replicate count="2" offset="0 0 0.1"><geom size="0.02"/></replicate>
      </body>
    </body>
  </worldbody>
  <equality><joint joint1="elbow" joint2="shoulder" active="false"/></equality>
  <actuator><motor joint="shoulder"/></actuator>
</mujoco>
"""
SYSTEM = """name = "mass on a spring"

[variables]
x = { unit = "m" }
force = { unit = "N" }

[constants]
m = { unit = "kg", sign = "positive" }
b = { unit = "N s/m" }
c = { unit = "N/m", sign = "positive" }

[equations]
motion = "force = m*ddot(x) + b*dot(x) + c*x"
"""
MAPPING = """joints = ["shoulder", "elbow"]

[time]
columns = "time"
unit = "ms"

[position]
columns = ["position_1", "position_2"]
unit = ["deg", "rad"]
sign = [1, -1]

[torque]
columns = "torque_{number}"
unit = "A"
constant = [0.118, 0.106]
gear = 101
"""
SETTINGS: dict[str, Any] = {
    "preparation": {
        "smoothing": {"method": "butterworth", "cutoff": 12.0},
        "trim": 10,
    },
    "solver": {"loss": "squared", "joint_weights": "equal", "cutoff": 8.0, "errors": "correlated"},
}
LIMITS = """[joints]
position = [[-2.0, 2.0], [-1.5, 1.5]]
velocity = [2.0, 3.0]
acceleration = 20.0
jerk = 400.0
torque = [60.0, 30.0]
power = 100
torque_margin = 0.1

[surroundings]
clearance = 0.02
radius = 0.03
floor = -2.0
self_collision = false
workspace = [[-2.0, -2.0, -2.0], [2.0, 2.0, 2.0]]
boxes = [[[2.0, 0.0, 0.0], [0.1, 0.1, 0.1]]]
spheres = [[[0.0, 2.0, 0.0], 0.1]]
ignore = [["shoulder", "elbow"]]
"""
PRIOR = """[coefficients]
kv1 = { value = 2.0, error = 0.1 }
kd1 = 0.5
kM1 = { low = 0.0, high = 100.0 }

[links.shoulder]
mass = { value = 2.4, error = 0.1 }
rx = { low = -0.1, high = 0.1 }
motor_inertia = 0.35
"""
PROJECT = """robot = "arm.toml"
friction = ["viscous", "dry"]
lengths = "numeric"
decimate = 1
despike = false
between = [0.0, 2.5]
torque = "measured"
settings = "settings.json"
columns = "table.toml"

[limits.joints]
velocity = [2.0, 3.0]
torque = 40.0
"""
# An arm of position servos.
SERVO_ARM = """name = "arm"
gravity = [0, -9.81, 0]
[[joint]]
[joint.link]
mass = 1.0
centre_of_gravity = [0.1, 0, 0]
inertia_tensor = [0.01, 0.02, 0.02]
[[joint]]
a = 0.3
[joint.link]
mass = 1.0
centre_of_gravity = [0.1, 0, 0]
inertia_tensor = [0.01, 0.02, 0.02]
"""
# The arm that recordings are of: small, and not the TOML file above, which is all keys.
ARM = 'gravity = [0, -9.81, 0]\n[[joint]]\nname = "shoulder"\n[[joint]]\nname = "elbow"\na = 0.3\n'

SAMPLES, PERIOD = 300, 0.01
ROBOTS = ("every_key.toml", "arm.urdf", "arm.xml", "arm.toml")
TABLES = ("log.csv", "named.csv", "rtde.csv", "franka.csv")
BINARIES = ("log.parquet", "log.npz", "bag.bag", "ros2/ros2.db3", "mcap/mcap.mcap")


def write_templates(folder: Path) -> None:
    """Writes every template, and identifies the arm once, with the command itself.

    **Raises**

    - `RuntimeError`: if the identification fails.
    """
    write_inputs(folder)
    recording = simulated(folder / "arm.toml")
    _write_tables(folder, recording)
    _write_bags(folder, recording)
    write_servos(folder)
    names = ("identify", folder / "arm.toml", folder / "log.csv", "-o", folder / "result")
    settings = ("--settings", folder / "settings.json", "--no-check", "--no-systematic")
    done = invoke(*names, *settings)
    if done.exit_code:
        raise RuntimeError(f"the templates' identification failed: {done.output}")


def write_inputs(folder: Path) -> None:
    """Writes robots, mapping and settings: what needs no computation."""
    texts = {
        "every_key.toml": TOML,
        "arm.urdf": URDF,
        "arm.xml": MJCF,
        "arm.toml": ARM,
        "system.toml": SYSTEM,
        "mapping.toml": MAPPING,
        "limits.toml": LIMITS,
        "prior.toml": PRIOR,
        "jaxcslc.toml": PROJECT.replace('columns = "table.toml"\n', ""),
        "settings.json": json.dumps(SETTINGS, indent=1),
    }
    for name, text in texts.items():
        (folder / name).write_text(text, encoding="utf-8")


def write_servos(folder: Path) -> None:
    """Writes an arm of servos, and commands and positions of two springs under gravity."""
    (folder / "servos.toml").write_text(SERVO_ARM, encoding="utf-8")
    time = PERIOD * np.arange(SAMPLES)
    command = np.sin(np.outer(time, [3.0, 5.0])) + 0.4 * np.sin(np.outer(time, [7.0, 2.0]))
    position, velocity, rows = command[0], np.zeros(2), list[np.ndarray]()
    for wanted in command:
        rows.append(1e-3 * np.round(position / 1e-3))
        pull = 200.0 * (wanted - position) - 25.0 * velocity - 3.0 * np.sin(position)
        velocity = velocity + PERIOD * pull
        position = position + PERIOD * velocity
    table = {"time": time, **_numbered("command", command, 1)}
    table |= _numbered("position", np.array(rows), 1)
    columns, header = np.column_stack(list(table.values())), ",".join(table)
    np.savetxt(folder / "servos.csv", columns, "%.6f", ",", header=header, comments="")


def simulated(robot: Path) -> jc.Recording:
    """A recording of the arm in a robot file, with encoder steps and noise."""
    network = jc.derive(jc.load_robot(robot), lengths="numeric")
    draw = np.random.default_rng(15)
    time = PERIOD * np.arange(SAMPLES)
    rates = np.array([[3.0, 7.0], [5.0, 2.0]])
    phase = time[:, None, None] * rates
    q = np.sum(np.sin(phase) * [1.0, 0.5], axis=-1)
    qd = np.sum(rates * np.cos(phase) * [1.0, 0.5], axis=-1)
    qdd = -np.sum(rates**2 * np.sin(phase) * [1.0, 0.5], axis=-1)
    k = np.linspace(0.5, 1.5, len(network.names))
    torque = np.asarray(network.torque(k, q, qd, qdd)) + 0.01 * draw.normal(size=q.shape)
    return jc.Recording(time, 1e-4 * np.round(q / 1e-4), torque, joint_names=("shoulder", "elbow"))


def _write_tables(folder: Path, recording: jc.Recording) -> None:
    time, q, torque = recording.time, recording.position, recording.torque
    seven = np.arange(7) % 2
    tables: dict[str, dict[str, Any]] = {
        "log.csv": {"time": time, **_numbered("position", q, 1), **_numbered("torque", torque, 1)},
        "named.csv": {
            "t [ms]": 1e3 * time,
            **{f"q_{name} [deg]": np.degrees(q[:, i]) for i, name in enumerate(NAMES)},
            **{f"tau_{name} [N m]": torque[:, i] for i, name in enumerate(NAMES)},
        },
        "rtde.csv": {
            "timestamp": time + 4711.25,
            **_numbered("actual_q", q, 0),
            **_numbered("actual_current_as_torque", torque, 0),
        },
        "franka.csv": {
            "time": 1e3 * time,
            **{f"state.q[{i}]": q[:, j] for i, j in enumerate(seven)},
            **{f"state.tau_J[{i}]": torque[:, j] for i, j in enumerate(seven)},
        },
        "system.csv": {"time": time, "x": q[:, 0], "force": torque[:, 0]},
    }
    for name, columns in tables.items():
        rows = np.column_stack(list(columns.values()))
        header = ",".join(columns)
        np.savetxt(folder / name, rows, delimiter=",", header=header, comments="", fmt="%.9g")
    columns = tables["log.csv"]
    pq.write_table(pa.table(columns), folder / "log.parquet")
    np.savez(folder / "log.npz", time=time, position=q, torque=torque)


NAMES = ("shoulder", "elbow")


def _numbered(stem: str, columns: np.ndarray, first: int) -> dict[str, np.ndarray]:
    return {f"{stem}_{i + first}": columns[:, i] for i in range(columns.shape[1])}


def _write_bags(folder: Path, recording: jc.Recording) -> None:
    """Bags of ROS 1 and 2 and an MCAP file, as rosbags writes them."""
    for name, plugin in (("bag.bag", None), ("ros2", "SQLITE3"), ("mcap", "MCAP")):
        types = get_typestore(Stores.ROS1_NOETIC if plugin is None else Stores.ROS2_HUMBLE)
        state = types.types["sensor_msgs/msg/JointState"]
        header, stamp = (
            types.types["std_msgs/msg/Header"],
            types.types["builtin_interfaces/msg/Time"],
        )
        writer: Any = (
            rosbag1.Writer(folder / name)
            if plugin is None
            else rosbag2.Writer(
                folder / name, version=9, storage_plugin=getattr(rosbag2.StoragePlugin, plugin)
            )
        )
        fields = {"seq": 0} if plugin is None else {}
        with writer:
            connection = writer.add_connection("/joints", state.__msgtype__, typestore=types)
            for row, seconds in enumerate(recording.time):
                nanoseconds = 10**18 + round(1e9 * seconds)
                message = state(
                    header=header(stamp=stamp(*divmod(nanoseconds, 10**9)), frame_id="", **fields),
                    name=list(NAMES),
                    position=recording.position[row],
                    velocity=np.zeros(0),
                    effort=recording.torque[row],
                )
                serialize = types.serialize_ros1 if plugin is None else types.serialize_cdr
                writer.write(connection, nanoseconds, serialize(message, state.__msgtype__))
