"""Description of a report's network: names and units of outputs and coefficients."""

import dataclasses
from collections.abc import Mapping
from functools import cached_property
from textwrap import fill
from typing import Any

from ..derivation import Coefficient
from ..least_squares import Identification
from ..network import CSLC, AbstractLinearNetwork


@dataclasses.dataclass(frozen=True, eq=False)
class ModelDescription:
    """Names and units of a network's outputs and coefficients, as a report's file holds them.

    **Attributes**

    - `name`: of the robot or the system.
    - `output_kind`, `output_quantity`: what an output is called, and what it is.
    - `output_labels`, `output_names`, `output_units`: of each output.
    - `coefficients`: names, groups, expressions, units and signs.
    - `lines`: the network in words.
    - `legend`: what symbols in expressions mean; None of systems that are no robots.
    """

    name: str
    output_kind: str
    output_quantity: str
    output_labels: tuple[str, ...]
    output_names: tuple[str, ...]
    output_units: tuple[str, ...]
    coefficients: tuple[Coefficient, ...]
    lines: tuple[str, ...] = ()
    legend: str | None = None

    @cached_property
    def names(self) -> tuple[str, ...]:
        """Names of the coefficients, in the order of `k`."""
        return tuple(coefficient.name for coefficient in self.coefficients)

    @property
    def size(self) -> int:
        """Number of coefficients, p."""
        return len(self.coefficients)

    @property
    def per_joint(self) -> bool:
        """True if outputs are torques of joints of a robot."""
        return self.output_kind == "joint"

    @classmethod
    def of(cls, network: AbstractLinearNetwork) -> "ModelDescription":
        """Return the description of a network."""
        robot = isinstance(network, CSLC)
        return cls(
            network.name,
            network.output_kind,
            network.output_quantity,
            network.output_labels,
            network.output_names,
            network.output_units,
            network.coefficients,
            (str(network), *(joint_lines(network) if robot else ())),
            expression_legend(network) if robot else None,
        )

    def document(self) -> dict[str, Any]:
        """Return the entries of a report's `identification.json`."""
        return {
            "joints": self.output_names,
            "expressions": [coefficient.expression for coefficient in self.coefficients],
            "units": [coefficient.unit for coefficient in self.coefficients],
            "model": {
                "kind": self.output_kind,
                "quantity": self.output_quantity,
                "labels": self.output_labels,
                "units": self.output_units,
                "groups": [coefficient.group for coefficient in self.coefficients],
                "positive": [some.name for some in self.coefficients if some.positive],
                "lines": self.lines,
                "legend": self.legend,
            },
        }

    @classmethod
    def from_document(cls, document: Mapping[str, Any], fit: Identification) -> "ModelDescription":
        """Return what `document` was made of; of older files, what they hold."""
        count, joints = len(fit.names), len(fit.torque_error)
        entries = document.get("model")
        model: dict[str, Any] = entries if isinstance(entries, dict) else {}

        def texts(entries: Mapping[str, Any], name: str, size: int | None, default: Any) -> Any:
            value: Any = entries.get(name)
            fits = isinstance(value, list) and size in (None, len(value))
            return tuple(map(str, value if fits else default))

        labels = texts(model, "labels", joints, [str(i + 1) for i in range(joints)])
        kind = str(model.get("kind", "joint"))
        name = document.get("robot", document.get("system", ""))
        columns = (
            fit.names,
            texts(model, "groups", count, [""] * count),
            texts(document, "expressions", count, [""] * count),
            texts(document, "units", count, [""] * count),
        )
        positive = texts(model, "positive", None, ())
        return cls(
            str(name),
            kind,
            str(model.get("quantity", "torque")),
            labels,
            texts(document, "joints", joints, [f"{kind} {label}" for label in labels]),
            texts(model, "units", joints, [""] * joints),
            tuple(
                Coefficient(name, group, expression, unit, name in positive)
                for name, group, expression, unit in zip(*columns, strict=True)
            ),
            texts(model, "lines", None, ()),
            None if model.get("legend") is None else str(model["legend"]),
        )


def joint_lines(network: CSLC) -> list[str]:
    """Return the numbers that coefficients' names have, with the joints' names if they have any."""
    robot = network.robot
    if not robot.has_joint_names:
        return []
    mimics = () if robot.source is None else robot.source.mimics
    leaders = {mimic.follower: f" (follows {mimic.leader})" for mimic in mimics}
    joints = ", ".join(
        f"{i} {name}{leaders.get(name, '')}" for i, name in enumerate(robot.joint_names, start=1)
    )
    return [fill(f"joints: {joints}", 96, subsequent_indent="    ", break_on_hyphens=False)]


def expression_legend(network: CSLC) -> str:
    """Return what symbols in the expressions of a robot's coefficients mean, in which frames.

    >>> import jaxcslc as jc
    >>> pendulum = jc.Manipulator.from_modified_dh([(0, 0, 0, 0)], gravity=(0, -9.81, 0))
    >>> expression_legend(jc.derive(pendulum, lengths="numeric"))[:58]
    'kB: base parameters. Of link i: mi mass, rxi ryi rzi centr'
    """
    groups = {
        "mass": "kM: of the mass matrix",
        "gravity": "kG: of gravity",
        "base": "kB: base parameters",
    }
    present = dict.fromkeys(c.group for c in network.coefficients)
    names = "; ".join(text for group, text in groups.items() if group in present)
    forms = {inertia.form for inertia in network.robot.inertia}
    about = "the origin" if forms == {"full"} else "the centre of gravity"
    if len(forms) > 1:
        about = "the origin (principal moments: the centre of gravity)"
    return (
        f"{names}. Of link i: mi mass, rxi ryi rzi centre of gravity, Ixxi to Iyzi moments of"
        f" inertia about {about}, Imi motor inertia, in the link's modified Denavit-Hartenberg"
        " frame: z along the axis of joint i, x along the common normal to the next axis"
    )


def legend_text(legend: str) -> str:
    """Return a legend of expressions in lines to print."""
    return fill(legend, 96, subsequent_indent="    ")
