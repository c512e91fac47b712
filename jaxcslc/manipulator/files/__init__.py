"""Readers of robot files (TOML, URDF, MJCF), and the robots that are part of the package.

     TOML ------> _toml ------------------------------------+
     URDF, MJCF -> _urdf (checks) -> _mujoco_reader -> _load -+-> Manipulator

- `_load`: `load_robot`, the entry; the robot between base and tips of a file's tree.
- `_toml`: the package's own format, and `puma560`, `panda`, `tx40`.
- `_urdf`: XML, read without trust; checks of URDF files, joint limits, joints that mimic others.
- `_mujoco_reader`: bodies and joints of a file, as MuJoCo's loader understands them.
"""

from ._load import UNUSED_LINKS as UNUSED_LINKS, load_robot as load_robot
from ._mujoco_reader import mujoco_spec as mujoco_spec
from ._toml import panda as panda, puma560 as puma560, tx40 as tx40
from ._urdf import (
    START_TAG as START_TAG,
    Element as Element,
    parse_xml as parse_xml,
    read_xml as read_xml,
)
