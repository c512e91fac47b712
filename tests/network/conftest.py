"""Fixtures of the network's tests: MuJoCo as an oracle, and networks to hold against it."""

import math
from collections.abc import Callable, Sequence
from dataclasses import dataclass
from typing import Any

import mujoco
import numpy as np
import pytest

import jaxcslc
from jaxcslc.manipulator import LinkParameters, Manipulator


Rows = Sequence[tuple[float, float, float, float]]


def transform(axis: int, angle: float, step: float) -> np.ndarray:
    """A homogeneous screw: turn about one axis and slide along it."""
    c, s = math.cos(angle), math.sin(angle)
    b, d = (axis + 1) % 3, (axis + 2) % 3
    matrix = np.eye(4)
    matrix[b, b], matrix[b, d], matrix[d, b], matrix[d, d] = c, -s, s, c
    matrix[axis, 3] = step
    return matrix


@pytest.fixture(scope="session")
def mujoco_torque() -> Callable[..., Callable[..., np.ndarray]]:
    """Makes MuJoCo's inverse dynamics of a chain from Denavit-Hartenberg rows and link parameters.

    Shares nothing with the library: nested bodies are placed by matrix products here.
    """

    def build(
        rows: Rows, kinds: str, gravity: Sequence[float], links: Sequence[LinkParameters]
    ) -> Callable[..., np.ndarray]:
        def text(values: Any) -> str:
            return " ".join(repr(float(value)) for value in np.ravel(values))

        body = ""
        for (alpha, a, d, theta), kind, link in reversed(
            list(zip(rows, kinds, links, strict=True))
        ):
            frame = transform(0, alpha, a) @ transform(2, theta, d)
            quaternion = np.empty(4)
            mujoco.mju_mat2Quat(quaternion, np.ravel(frame[:3, :3]))
            tensor = np.asarray(link.inertia)
            entries = [tensor[i, j] for i, j in ((0, 0), (1, 1), (2, 2), (0, 1), (0, 2), (1, 2))]
            body = (
                f'<body pos="{text(frame[:3, 3])}" quat="{text(quaternion)}">'
                f'<inertial pos="{text(link.centre_of_gravity)}" mass="{text(link.mass)}"'
                f' fullinertia="{text(entries)}"/>'
                f'<joint type="{"hinge" if kind == "R" else "slide"}" axis="0 0 1"'
                f' armature="{text(link.motor_inertia)}"/>{body}</body>'
            )
        model = mujoco.MjModel.from_xml_string(
            f'<mujoco><compiler angle="radian"/><option gravity="{text(gravity)}"/>'
            f"<worldbody>{body}</worldbody></mujoco>"
        )
        data = mujoco.MjData(model)

        def torque(q: np.ndarray, qd: np.ndarray, qdd: np.ndarray) -> np.ndarray:
            torques: list[np.ndarray] = []
            for data.qpos[:], data.qvel[:], data.qacc[:] in zip(q, qd, qdd, strict=True):
                mujoco.mj_inverse(model, data)
                torques.append(data.qfrc_inverse.copy())
            return np.array(torques)

        return torque

    return build


@dataclass(frozen=True)
class Case:
    """A network with coefficients that a robot can have, friction included."""

    network: jaxcslc.CSLC
    k: np.ndarray
    links: tuple[LinkParameters, ...]

    def states(
        self, rng: np.random.Generator, shape: tuple[int, ...] = (16,)
    ) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
        """Random q, qd and qdd of (*shape, joints)."""
        q, qd, qdd = rng.uniform(-3, 3, (3, *shape, self.network.joint_count))
        return q, qd, qdd


ELBOW = [(0.0, 0.0, 0.3, 0.0), ("pi/2", 0.1, 0.0, 0.2), (0.0, 0.4, -0.1, 0.0)]
STANFORD = [
    (0, 0, 0.412, 0),
    ("-pi/2", 0, 0.154, 0),
    ("pi/2", 0, 0, 0),
    (0, 0, 0, 0),
    ("-pi/2", 0, 0, 0),
    ("pi/2", 0, 0, 0),
]
SKEW = [(0.4, 0.1, 0.2, 0.5), (-1.1, 0.3, -0.2, 1.0), (2.0, -0.2, 0.3, -0.7)]
TILTED = (1.5, -3.0, -9.0)
SLIDE = Manipulator.from_modified_dh(
    SKEW[:2], kinds="PR", gravity=TILTED, friction=("viscous", "dry", "offset")
)

# Name: robot, treatment of lengths, evaluator.
NETWORKS: dict[str, tuple[Callable[[], Manipulator], Any, Any]] = {
    "puma560": (jaxcslc.puma560, "symbolic", "tables"),
    "puma560-base": (lambda: jaxcslc.puma560().with_inertia("full"), "numeric", "recursive"),
    "elbow": (lambda: Manipulator.from_modified_dh(ELBOW), "symbolic", "tables"),
    "stanford": (
        lambda: Manipulator.from_modified_dh(STANFORD, kinds="RRPRRR", gravity=TILTED),
        "numeric",
        "tables",
    ),
    "prismatic-first": (
        lambda: Manipulator.from_modified_dh(SKEW, kinds="PRP", gravity=TILTED),
        "numeric",
        "tables",
    ),
    # Two joints: the recursion has operations of its own shape for every link.
    "prismatic-first-recursive": (lambda: SLIDE, "numeric", "recursive"),
    "prismatic-first-unrolled": (lambda: SLIDE, "numeric", "unrolled"),
    "panda": (jaxcslc.panda, "numeric", "recursive"),
    "prismatic-first-tables": (lambda: SLIDE, "symbolic", "tables"),
}


@pytest.fixture(scope="session")
def cases(
    random_links: Callable[..., tuple[LinkParameters, ...]],
) -> Callable[[str], Case]:
    """Makes, once, the network of that name and coefficients of a random possible robot."""
    built: dict[str, Case] = {}

    def case(name: str) -> Case:
        if name not in built:
            make, lengths, evaluator = NETWORKS[name]
            robot = make()
            rng = np.random.default_rng(list(NETWORKS).index(name))
            n = robot.joint_count
            network = jaxcslc.derive(robot, lengths=lengths, evaluator=evaluator)
            principal = robot.inertia[0].form == "principal"
            if robot.links is None:
                links = random_links(rng, n, motors=robot.inertia[0].motor, principal=principal)
            else:
                links = robot.links
            friction = {term: rng.uniform(0.2, 2.0, n).tolist() for term in robot.friction}
            built[name] = Case(
                network, np.asarray(network.coefficients_from(links, **friction)), links
            )
        return built[name]

    return case


@pytest.fixture(params=list(NETWORKS))
def case(request: pytest.FixtureRequest, cases: Callable[[str], Case]) -> Case:
    """Each network in turn."""
    return cases(request.param)
