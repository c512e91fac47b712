"""A robot's joints and links as a pandas table; read with `Manipulator.to_pandas`."""

from typing import TYPE_CHECKING, Any

from .._environment import require


if TYPE_CHECKING:
    from ._manipulator import Manipulator


def joint_table(robot: "Manipulator") -> Any:
    """Return the table of a robot, one row per joint: see `Manipulator.to_pandas`."""
    pandas = require("pandas", "tables")

    rows: list[dict[str, Any]] = []
    for i, joint in enumerate(robot.joints):
        row: dict[str, Any] = {"kind": joint.kind, "parent": robot.parents[i] + 1}
        row |= {name: getattr(joint, name) for name in ("alpha", "theta", "gamma")}
        row |= {letter: length.value for letter, _, length in joint.lengths}
        if robot.source is not None:
            row |= {"joint of file": robot.source.joints[i], "body": robot.source.links[i]}
        if robot.links is not None:
            link = robot.links[i]
            row |= {"mass": float(link.mass), "motor inertia": float(link.motor_inertia)}
            row |= {f"r{axis}": float(link.centre_of_gravity[a]) for a, axis in enumerate("xyz")}
            row |= {
                f"I{'xyz'[a]}{'xyz'[b]}": float(link.inertia[a, b])
                for a in range(3)
                for b in range(a, 3)
            }
        for term in ("viscous", "dry"):
            values = getattr(robot, term)
            row |= {} if values is None else {term: values[i]}
        rows.append(row)
    return pandas.DataFrame(rows, index=range(1, robot.joint_count + 1)).rename_axis("joint")
