"""Fixtures of the algebra's tests: the robots of the literature, and Pinocchio's regressor."""

from collections.abc import Callable
from importlib.metadata import files
from typing import Any

import numpy as np
import pytest

import jaxcslc
from jaxcslc.manipulator import Manipulator


RIGHT = "pi/2"


@pytest.fixture(scope="session")
def literature() -> dict[str, Manipulator]:
    """Robots with full inertia tensors and motor inertias, by name."""
    ur5 = [
        (0, 0, 0.089159, 0),
        (RIGHT, 0, 0, 0),
        (0, -0.425, 0, 0),
        (0, -0.39225, 0.10915, 0),
        (RIGHT, 0, 0.09465, 0),
        ("-pi/2", 0, 0.0823, 0),
    ]
    stanford = [
        (0, 0, 0.412, 0),
        ("-pi/2", 0, 0.154, 0),
        (RIGHT, 0, 0, 0),
        (0, 0, 0, 0),
        ("-pi/2", 0, 0, 0),
        (RIGHT, 0, 0, 0),
    ]
    return {
        "puma560": jaxcslc.puma560().with_inertia("full"),
        "panda": jaxcslc.panda().with_inertia("full"),
        "ur5": Manipulator.from_modified_dh(ur5, name="UR5"),
        "stanford": Manipulator.from_modified_dh(stanford, kinds="RRPRRR", name="Stanford arm"),
    }


@pytest.fixture(scope="session")
def pinocchio_chain() -> Callable[[Manipulator], Any]:
    """Makes Pinocchio's model of a robot's kinematics; its bodies are all alike."""
    import pinocchio as pin

    def build(robot: Manipulator) -> Any:
        model = pin.Model()
        body = pin.Inertia(1.0, np.zeros(3), np.eye(3))
        parent = 0
        for i, joint in enumerate(robot.joints):
            twist = pin.SE3(pin.utils.rotate("x", joint.alpha), np.array([joint.a.value, 0, 0]))
            turn = pin.SE3(pin.utils.rotate("z", joint.theta), np.array([0, 0, joint.d.value]))
            kind = pin.JointModelRZ() if joint.kind == "R" else pin.JointModelPZ()
            parent = model.addJoint(parent, kind, twist * turn, f"joint_{i}")
            model.appendBodyToJoint(parent, body, pin.SE3.Identity())
        model.gravity.linear = np.array(robot.gravity)
        return model

    return build


@pytest.fixture(scope="session")
def pinocchio_file() -> Callable[[str, int], Any]:
    """Reads the first joints of a published URDF; those behind (a gripper's) are locked."""
    import pinocchio as pin

    def read(name: str, joints: int) -> Any:
        (path,) = [path for path in files("example-robot-data") or [] if path.name == name]
        model = pin.buildModelFromUrdf(str(path.locate()))
        behind = list(range(joints + 1, model.njoints))
        return pin.buildReducedModel(model, behind, pin.neutral(model)) if behind else model

    return read


@pytest.fixture(scope="session")
def regressor_rank() -> Callable[..., int]:
    """Numeric rank of Pinocchio's joint torque regressor at random states."""
    import pinocchio as pin

    def rank(model: Any, rng: np.random.Generator, *, motors: bool) -> int:
        data = model.createData()
        blocks: list[np.ndarray] = []
        for _ in range(40):
            q, qd, qdd = rng.uniform(-3, 3, (3, model.nv))
            block = pin.computeJointTorqueRegressor(model, data, q, qd, qdd)
            blocks.append(np.hstack([block, np.diag(qdd)]) if motors else block.copy())
        regressor = np.vstack(blocks)
        norms = np.linalg.norm(regressor, axis=0)
        # Columns that vanish identically come out as rounding: they would be scaled up to noise.
        kept = norms > 1e-9 * np.max(norms)
        singular = np.linalg.svd(regressor[:, kept] / norms[kept], compute_uv=False)
        tolerance = 1e-9 * singular[0]
        # A count at a tolerance means something only if nothing lies near the tolerance.
        assert not np.any((singular > 1e-3 * tolerance) & (singular < 1e3 * tolerance))
        return int(np.sum(singular > tolerance))

    return rank
