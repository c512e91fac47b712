"""The command `jaxcslc example`."""

from pathlib import Path
from typing import Annotated, Literal

from ._common import Context, Output, OverwriteOption, command
from ._options import argument, option


@command("tutorial", "example", "example ur5 -o trial", "example so101")
def example_command(
    context: Context,
    arm: Annotated[
        Literal["panda", "puma560", "so101", "ur5"],
        argument("ARM", "panda, puma560, so101 (position servos, no torques) or ur5."),
    ] = "panda",
    output: Annotated[
        Path | None,
        option(
            "-o",
            "--output",
            metavar="FOLDER",
            help="New folder for the files. By default named as the arm.",
        ),
    ] = None,
    overwrite: OverwriteOption = False,
) -> Output:
    """Write a robot file and two simulated logs to try the other commands on.

    The logs are in the format of the arm's own software. truth.json holds the true parameters.
    """
    from .._scratch import check_output_folder
    from ..examples import write_example

    del context
    folder = Path(arm) if output is None else output
    check_output_folder(folder)
    example = write_example(arm, folder, overwrite=overwrite)
    files = (example.robot, example.train, example.validation, example.truth)
    commands = next_commands(folder, example.robot.name)
    names = ", ".join(path.name for path in files)
    return Output(
        "\n".join([f"wrote {folder}: {names}", "", "Try:", *(f"  {line}" for line in commands)]),
        lambda: {"files": [str(path) for path in files], "next": commands},
    )


def next_commands(folder: Path, robot: str) -> list[str]:
    """Return the commands to type after `jaxcslc example`."""
    stem, suffix = robot.rsplit(".", 1)
    if stem == "so101":
        identify = f"jaxcslc identify {robot} train.csv --validate validation.csv --drive servo"
        return [
            f"cd {folder}",
            f"{identify} -o results",
            f"{identify} --known gain=10.2,10.6,10.4,10.1,9.8,10 -o known_gains",
            "python -m mujoco.viewer --mjcf=results/servos.xml",
            f"cc -c results/{stem}.c -o {stem}.o",
        ]
    return [
        f"cd {folder}",
        f"jaxcslc check {robot} train.csv",
        f"jaxcslc identify {robot} train.csv --validate validation.csv -o results",
        f"jaxcslc export {robot} results -o {stem}_identified.{suffix}",
        f"jaxcslc export {robot} results --c -o {stem}.c",
        f"jaxcslc excite {robot} --previous results --duration 10 -o next.csv",
    ]
