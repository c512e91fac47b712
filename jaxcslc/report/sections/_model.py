"""Section on the network that was identified: its structure, its robot, some of its motion."""

from collections.abc import Iterator, Mapping, Sequence
from types import MappingProxyType
from typing import Any

import numpy as np

from jaxcslc._plain_data import record_document
from jaxcslc.recordings import Patterns

from .._section import AbstractSection, AnyReport


# States of the motion that are stored: enough to compare torques over it later.
_STATES = 100
# Positions and their derivatives in SI units: no robot comes near.
_LARGEST = 1e12


class ModelSection(AbstractSection):
    """Description of the network; `manipulator` is the robot, as its file had it."""

    name = "model"
    entries = MappingProxyType(
        {
            **{"robot": str, "lengths": object, "static_slopes": list, "friction": list},
            **{"joint_friction": list, "coupled": list, "manipulator": dict},
        }
    )

    always = True

    @classmethod
    def document_of(cls, result: None, report: AnyReport) -> Mapping[str, Any]:
        network, robot = report.network, report.network.robot
        slopes = network.static_slopes
        return {
            "robot": robot.name,
            "lengths": network.algebra.lengths,
            **({} if slopes is None else {"static_slopes": np.asarray(slopes, float)}),
            "friction": robot.friction,
            "joint_friction": robot.friction_per_joint,
            "coupled": robot.coupled,
            "manipulator": record_document(robot),
        }

    def text(self, report: AnyReport) -> Iterator[Sequence[str]]:
        yield [*report.model.lines, f"settings: {report.settings}"]


class MotionSection(AbstractSection):
    """States of the training recording, evenly spaced."""

    name = "states"
    results = MappingProxyType({"states": None})
    entries = MappingProxyType({"motion": dict})

    @classmethod
    def of(cls, report: AnyReport) -> AbstractSection:
        return cls(lambda: cls.document_of(None, report))

    @classmethod
    def document_of(cls, result: None, report: AnyReport) -> Mapping[str, Any]:
        patterns = report.patterns["training"]
        every = max(patterns.samples // _STATES, 1)
        names = ("q", "qd", "qdd")
        return {"motion": {name: np.asarray(getattr(patterns, name))[::every] for name in names}}

    def result(self, name: str, report: AnyReport) -> Patterns:
        """Return the states as patterns without torques."""
        motion, joints = self.data["motion"], len(report.model.output_names)
        try:
            q, qd, qdd = (np.asarray(motion[name], float) for name in ("q", "qd", "qdd"))
        except (KeyError, TypeError, ValueError):
            raise ValueError("motion: expected arrays q, qd and qdd") from None
        finite = q.shape == qd.shape == qdd.shape and np.all(np.abs([q, qd, qdd]) <= _LARGEST)
        if not finite or q.shape != (len(q), joints):
            raise ValueError(f"motion: expected finite q, qd and qdd of {joints} joints each")
        mask = np.ones(q.shape, bool)
        return Patterns(np.arange(len(q), dtype=float), q, qd, qdd, 0 * q, mask, mask)
