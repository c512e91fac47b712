"""Fixtures of the simulator's tests: an independent oracle, arms of one joint, two recordings."""

import dataclasses
from collections.abc import Callable, Sequence
from typing import Any

import numpy as np
import pytest

import sim
from jaxcslc.manipulator import LinkParameters, Manipulator


InverseDynamics = Callable[..., np.ndarray]


@pytest.fixture(scope="session")
def pinocchio_model() -> Callable[..., Any]:
    """Makes a Pinocchio model of a manipulator from the same numbers, by other code."""
    import pinocchio as pin

    def build(robot: Manipulator, links: Sequence[LinkParameters] | None = None) -> Any:
        model = pin.Model()
        links = robot.links if links is None else links
        assert links is not None
        parent = 0
        for i, (joint, link) in enumerate(zip(robot.joints, links, strict=True)):
            twist = pin.SE3(pin.utils.rotate("x", joint.alpha), np.array([joint.a.value, 0, 0]))
            turn = pin.SE3(pin.utils.rotate("z", joint.theta), np.array([0, 0, joint.d.value]))
            kind = pin.JointModelRZ() if joint.kind == "R" else pin.JointModelPZ()
            parent = model.addJoint(parent, kind, twist * turn, f"joint_{i}")
            inertia = pin.Inertia(
                float(link.mass), np.array(link.centre_of_gravity), np.array(link.inertia)
            )
            model.appendBodyToJoint(parent, inertia, pin.SE3.Identity())
        model.gravity.linear = np.array(robot.gravity)
        model.armature = np.array([float(link.motor_inertia) for link in links])
        return model

    return build


@pytest.fixture(scope="session")
def inverse_dynamics(pinocchio_model: Callable[..., Any]) -> Callable[..., InverseDynamics]:
    """Makes the function (q, qd, qdd) -> torque of a manipulator without friction."""
    import pinocchio as pin

    def build(robot: Manipulator, links: Sequence[LinkParameters] | None = None) -> InverseDynamics:
        model = pinocchio_model(robot, links)
        data = model.createData()

        def torque(q: np.ndarray, qd: np.ndarray, qdd: np.ndarray) -> np.ndarray:
            return np.array(
                [pin.rnea(model, data, *row) for row in zip(q, qd, qdd, strict=True)]
            ).reshape(q.shape)

        return torque

    return build


@pytest.fixture(scope="session")
def one_joint() -> Callable[..., sim.Machine]:
    """Makes a machine of one revolute joint; all disturbances are off by default."""

    def build(
        *,
        mass: float = 0.0,
        length: float = 0.0,
        inertia: float = 0.0,
        gravity: tuple[float, float, float] = (0.0, 0.0, 0.0),
        **changes: Any,
    ) -> sim.Machine:
        link = LinkParameters(
            mass, np.array([length, 0.0, 0.0]), np.diag([0.0, inertia, inertia]), 0.0
        )
        robot = Manipulator.from_modified_dh([(0.0, 0.0, 0.0, 0.0)], gravity=gravity)
        off: dict[str, Any] = {
            "viscous": (0.0,),
            "dry": (0.0,),
            "static": (0.0,),
            "static_velocity": (1.0,),
            "encoder_resolution": (0.0,),
            "maximum_torque": (float("inf"),),
            "position_range": ((-float("inf"), float("inf")),),
            "start_spread": 0.0,
        }
        return sim.Machine(robot=dataclasses.replace(robot, links=(link,)), **(off | changes))

    return build


@pytest.fixture(scope="session")
def performed() -> dict[str, sim.SimulatedRecording]:
    """The PUMA 560's two trajectories, performed once: recording and truth by name."""
    machine = sim.puma560()
    return {
        trajectory.name: sim.simulate(machine, trajectory, seed=3)
        for trajectory in (sim.training(), sim.comparison())
    }
