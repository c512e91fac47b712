"""Readers of robot files (TOML, URDF, MJCF), and the robots that are part of the package.

     TOML ------> _toml ----------------------------------------------------+
     URDF, MJCF -> _xml, _urdf (checks) -> _mujoco_reader -> _part -> _load -+-> Manipulator

- `_load`: `load_robot`, the entry; builds a robot of a file's bodies and joints.
- `_toml`: the package's own format, and `puma560`, `panda`, `tx40`.
- `_xml`: XML, read without trust.
- `_urdf`: checks of URDF files, joint limits, joints that mimic others.
- `_mujoco_reader`: bodies and joints of a file, as MuJoCo's loader understands them.
- `_part`: choice of the joints between base and tips.
"""

from ._load import load_robot as load_robot
from ._toml import panda as panda, puma560 as puma560, tx40 as tx40
from ._xml import Element as Element, parse_xml as parse_xml, read_xml as read_xml
