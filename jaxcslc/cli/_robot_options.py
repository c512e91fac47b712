"""Options of commands that say which robot they are about, and what its network has."""

import dataclasses
from typing import Annotated, Any, cast, get_args

import typer

from ..manipulator import Manipulator, Mimics, RobotError, load_robot
from ..network import CSLC, derive
from ._common import BUNDLED, choice_of, names_in


@dataclasses.dataclass(frozen=True)
class RobotPart:
    """The part of a robot file that a command is about; the whole robot if nothing is said."""

    base: Annotated[
        str | None,
        typer.Option(
            help="Body of a URDF or MJCF file that the robot stands on; the file's first if"
            " omitted.",
        ),
    ] = None
    tip: Annotated[
        list[str] | None,
        typer.Option(
            help="Body of a URDF or MJCF file that the robot ends with; may be repeated, for"
            " several arms; everything on --base if omitted.",
        ),
    ] = None
    fix: Annotated[
        list[str] | None,
        typer.Option(
            metavar="NAMES",
            help="Joints of a URDF or MJCF file to fix at zero, or bodies, with all joints on them"
            " and beyond, as in gripper or 'left_*'; may be repeated.",
        ),
    ] = None
    mimic: Annotated[
        str | None,
        typer.Option(
            metavar="fix|couple",
            help="Joints of a URDF or MJCF file that mimic others: fixed at zero with what they"
            " follow, or moved with it; an error if omitted and a file has some (docs/robots.md).",
        ),
    ] = None

    def read(self, name: str) -> Manipulator:
        """Read a bundled robot, or the part of a robot file."""
        if self.mimic is not None:
            choice_of("--mimic", self.mimic, get_args(Mimics))
        fixed = [part for names in self.fix or () for part in names_in(names)]
        if name not in BUNDLED:
            mimic = cast(Any, self.mimic)
            return load_robot(name, base=self.base, tip=self.tip or (), fix=fixed, mimic=mimic)
        if self.base is not None or self.tip or fixed or self.mimic:
            raise RobotError(
                f"{name}: base, tip, fix and mimic choose a part of a file; {name} is one robot"
            )
        return BUNDLED[name]()


@dataclasses.dataclass(frozen=True)
class Drives:
    """Friction and couplings that a robot's file does not say, or says otherwise.

    - `friction`: `"auto"` leaves what the file says.
    """

    friction: Annotated[
        str | None,
        typer.Option(
            metavar="TERMS",
            help="Friction terms of every joint in place of the file's, as in viscous,dry,static"
            " (docs/friction.md); identify also takes auto, which chooses them joint by joint.",
        ),
    ] = None
    coupled: Annotated[
        list[str] | None,
        typer.Option(
            metavar="I,J",
            help="Two joints that share a motor's inertia and friction, as in 5,6 or 5,6,-1; may"
            " be repeated.",
        ),
    ] = None

    def network(self, robot: Manipulator, lengths: str) -> CSLC:
        """Derive the network of a robot; `lengths`: as `LengthsOption` describes them."""
        if self.friction not in (None, "auto"):
            robot = robot.with_friction(*names_in(self.friction))
        pairs = [_pair(text) for text in self.coupled or ()]
        robot = robot.with_coupling(*pairs) if pairs else robot
        if lengths == "auto" or lengths == "symbolic" or lengths == "numeric":
            return derive(robot, lengths=lengths)
        return derive(robot, lengths=names_in(lengths))


def _pair(text: str) -> tuple[int | float, ...]:
    """Two joints that share a motor's inertia and friction, and their ratio if it is said."""
    try:
        first, second, *ratio = text.split(",")
        return (int(first), int(second), *map(float, ratio))
    except ValueError:
        raise RobotError(
            f"--coupled: expected two joints, as in 5,6, or 5,6,-1, got {text!r}"
        ) from None
