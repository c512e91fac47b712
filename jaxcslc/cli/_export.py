"""The command `jaxcslc export`."""

from collections.abc import Sequence
from importlib.resources import files
from pathlib import Path
from typing import Annotated, Any

from ..export import CCode, c_code, export_robot, motor_file, write_c
from ..report import Report, load_report
from ._common import Context, Output, OverwriteOption, command
from ._inputs import BUNDLED, RobotArgument, RobotPart, with_notes
from ._options import UsageError, argument, option


@command(
    "export",
    "export arm.urdf results -o arm_identified.urdf",
    "export arm.urdf results --c -o arm.c",
)
def export_command(
    context: Context,
    robot: RobotArgument,
    identification: Annotated[
        Path,
        argument("RESULT", "Folder that identify wrote, or the identification.json in it."),
    ],
    part: RobotPart,
    output: Annotated[
        Path | None,
        option(
            "-o",
            "--output",
            help="File to write. By default the robot's with _identified in its name, or with --c"
            " NAME.c and NAME.h.",
        ),
    ] = None,
    c: Annotated[
        bool, option(help="Write C code for a controller instead of a robot file.")
    ] = False,
    motors: Annotated[
        bool,
        option(
            help="Absorb motor inertias into the link inertias. By default they stay apart: as"
            " motor_inertia in TOML, armature in MJCF, in NAME.motors.toml next to a URDF.",
        ),
    ] = True,
    overwrite: OverwriteOption = False,
    force: Annotated[
        bool, option(help="Export a result whose verdict is not to rely on it.")
    ] = False,
) -> Output:
    """Write identified parameters into the robot's own file, or as C code for a controller.

    Masses, centres of gravity and inertia tensors are the physically consistent ones nearest to
    the identified coefficients. Nothing else in the file changes. It is read again to prove that
    it predicts the same torques. A result whose verdict is not to rely on it is refused.

    C code has the identified coefficients as they are, and the states of pre-sliding friction where
    identify used them.
    """
    del overwrite
    with context.progress("reading") as step:
        file, path = _files(context, robot, output, c)
        saved = load_report(identification, part.read(str(file)))
        if not force:
            _check_verdict(saved, identification)
        if c:
            step("writing C")
            text, data, paths = _write_c(context, saved, output)
        else:
            exported = export_robot(
                saved.network,
                saved.fit,
                path,
                motion=saved.motion,
                motors=motors,
                systematic=saved.systematic,
                bodies=saved.bodies,
                file_weight=saved.file_prior,
                progress=step,
            )
            text = str(exported) + _pre_sliding(saved, "is omitted: Coulomb friction is a step")
            paths, data = (), {"files": [str(path)], "warnings": exported.warnings}
    return Output(with_notes(text, saved.network.robot), lambda: data, paths)


def _files(context: Context, robot: str, output: Path | None, c: bool) -> tuple[Path, Path]:
    """Return the file of a robot, bundled or not, and the one to write, which is checked."""
    bundled = files("jaxcslc.manipulator") / "robots" / f"{robot}.toml"
    file = Path(str(bundled)) if robot in BUNDLED else Path(robot)
    path = Path(f"{file.stem}_identified{file.suffix}") if output is None else output
    suffix = ".c" if c else file.suffix.lower()
    if output is not None and output.suffix.lower() != suffix:
        raise UsageError(f"{output}: expected a name ending in {suffix}")
    if not c or output is not None:
        beside = path.with_suffix(".h") if c else motor_file(path)
        context.check_output([path, beside], read=[file])
    return file, path


def _check_verdict(saved: Report, identification: Path) -> None:
    """**Raises** `ValueError` for a result that is not to be relied on, or has no verdict."""
    try:
        objections = saved.objections
    except (LookupError, TypeError, AttributeError) as error:  # of entries that were changed
        raise ValueError(
            f"{identification}: holds no verdict ({type(error).__name__}: {error}); expected what"
            " identify wrote, or --force"
        ) from None
    if objections:
        raise ValueError(
            f"{identification}: its verdict is not to rely on it: {objections[0]} Follow the remedy"
            " in its report and identify again, or export it as it is with --force"
        )


def _write_c(
    context: Context, saved: Report, output: Path | None
) -> tuple[str, dict[str, Any], Sequence[Path]]:
    code, note = _c_code(saved)
    if output is None:
        context.check_output([Path(f"{code.name}{suffix}") for suffix in (".c", ".h")])
    paths = write_c(code, output)
    counts = ", ".join(f"{name} {count}" for name, count in code.operations.items())
    return f"operations: {counts}{note}", {"operations": code.operations}, paths


def _c_code(saved: Report) -> tuple[CCode, str]:
    """Return C code, and what is printed about its pre-sliding friction."""
    if (states := saved.pre_sliding) is None:
        return c_code(saved.network, saved.fit.k), ""
    code = c_code(states.network, states.fit.k, presliding_distance=states.presliding_distance)
    return code, _pre_sliding(
        saved,
        f"has a state, which {code.name}_pre_sliding updates; coefficients are of the fit with it",
    )


def _pre_sliding(saved: Report, what: str) -> str:
    """Return a line of what becomes of joints that yield before they slide, if any do."""
    if saved.pre_sliding is None:
        return ""
    return f"\nnote: pre-sliding of {', '.join(saved.pre_sliding.joint_names)} {what}"
