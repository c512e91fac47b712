from ._link_motion import paths_of as paths_of
from ._rigid_body_recursion import RigidBodyRecursion as RigidBodyRecursion
from ._rigid_body_tables import RigidBodyTables as RigidBodyTables, input_rows as input_rows
