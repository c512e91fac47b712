"""Summaries of a recording and of its joints, for the page of `check`."""

import dataclasses
from typing import Any

import numpy as np

from .._text_table import text_table
from ..manipulator import JointLimits
from ..network import CSLC
from ..recordings import Recording, encoder_resolution


# A joint is at rest below this part of its greatest speed.
_REST = 0.01


@dataclasses.dataclass(frozen=True)
class JointSummary:
    """Summary of one joint in a recording.

    **Attributes**

    - `name`: of the joint.
    - `low`, `high`: of its position [rad or m].
    - `speed`: that 99.9 % of its samples do not exceed [rad/s or m/s].
    - `torque`: root mean square [N m or N]; `largest`: greatest absolute value.
    - `resolution`: step of its encoder; 0 where readings show no steps [rad or m].
    - `resting_share`: part of the samples at which it hardly moves.
    - `limits`: of the robot's file, or None.
    """

    name: str
    low: float
    high: float
    speed: float
    torque: float
    largest: float
    resolution: float
    resting_share: float
    limits: JointLimits | None

    def row(self) -> dict[str, Any]:
        """The summary as a row of a table."""
        row = {
            field.name: getattr(self, field.name)
            for field in dataclasses.fields(self)
            if field.name != "limits"
        }
        limits = self.limits
        row["speed limit"] = np.nan if limits is None else limits.speed
        row["torque limit"] = np.nan if limits is None else limits.torque
        return row


@dataclasses.dataclass(frozen=True)
class RecordingSummary:
    """Summary of a recording.

    **Attributes**

    - `name`: of the recording.
    - `samples`, `duration`, `rate`: how many there are, and how fast [s, Hz].
    - `joints`: one `JointSummary` each.
    - `prismatic`: whether the robot has prismatic joints.
    - `excitation`: in words; empty where it was not computed.
    """

    name: str
    samples: int
    duration: float
    rate: float
    joints: tuple[JointSummary, ...]
    prismatic: bool = False
    excitation: str = ""

    @classmethod
    def of(cls, network: CSLC, recording: Recording, name: str) -> "RecordingSummary":
        """The summary of a recording of a robot, times in seconds."""
        interval = float(np.median(np.diff(recording.time)))
        speed = _speeds(recording)
        top = np.quantile(speed, 0.999, axis=0)
        resolution = encoder_resolution(recording.position)
        limits = network.joint_limits
        joints = tuple(
            JointSummary(
                joint,
                float(np.min(recording.position[:, j])),
                float(np.max(recording.position[:, j])),
                float(top[j]),
                float(np.sqrt(np.mean(recording.torque[:, j] ** 2))),
                float(np.max(np.abs(recording.torque[:, j]))),
                float(resolution[j]),
                float(np.mean(speed[:, j] <= _REST * top[j])),
                limits[j],
            )
            for j, joint in enumerate(network.output_names)
        )
        duration = float(recording.time[-1] - recording.time[0])
        prismatic = "P" in network.joint_kinds
        return cls(name, recording.samples, duration, 1.0 / interval, joints, prismatic)

    def __str__(self) -> str:
        columns = {
            "joint": lambda joint: joint.name,
            "from": lambda joint: f"{joint.low:.3g}",
            "to": lambda joint: f"{joint.high:.3g}",
            "top speed": lambda joint: f"{joint.speed:.3g}",
            "(limit)": lambda joint: _limit(joint.limits and joint.limits.speed),
            "torque RMS": lambda joint: f"{joint.torque:.3g}",
            "largest": lambda joint: f"{joint.largest:.3g}",
            "limit": lambda joint: _limit(joint.limits and joint.limits.torque),
            "encoder step": lambda joint: f"{joint.resolution:.2g}" if joint.resolution else "none",
            "at rest": lambda joint: f"{100 * joint.resting_share:.0f} %",
        }
        cells = [[shown(joint) for shown in columns.values()] for joint in self.joints]
        title = (
            f"{self.name}: {self.samples} samples in {self.duration:.4g} s,"
            f" {self.rate:.4g} a second; positions in rad, speeds in rad/s, torques in N m"
            + (" (of prismatic joints m, m/s and N)" if self.prismatic else "")
        )
        table = text_table(list(columns), cells, left=["joint"])
        return "\n".join([title, table, *([self.excitation] if self.excitation else [])])


def _limit(value: float | None) -> str:
    return "" if value is None or not np.isfinite(value) else f"{value:.3g}"


def _speeds(recording: Recording) -> np.ndarray:
    """Speeds over some ten milliseconds, in which encoder steps and outliers do not show."""
    interval = float(np.median(np.diff(recording.time)))
    reach = max(1, min(round(0.02 / interval), recording.samples // 4))
    ahead = recording.position[2 * reach :] - recording.position[: -2 * reach]
    passed = recording.time[2 * reach :] - recording.time[: -2 * reach]
    return np.abs(ahead) / passed[:, None]
