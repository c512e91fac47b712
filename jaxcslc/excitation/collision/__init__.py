"""Distances of a robot's bodies from each other and from obstacles.

- `_geometry`: the shapes, as a MuJoCo model.
- `_bodies`: pairs of shapes, distances along a motion, and their slopes.
- `_coal`: distances by Coal instead of MuJoCo.
"""

from ._bodies import CollisionBodies as CollisionBodies
