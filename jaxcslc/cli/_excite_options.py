"""Options of `jaxcslc excite`: the motion, what it is for, and what is known."""

import dataclasses
from pathlib import Path
from typing import Annotated

import typer


@dataclasses.dataclass(frozen=True)
class MotionOptions:
    """The motion, the coefficients that it is for, and noise of its recording."""

    output: Annotated[
        Path,
        typer.Option(
            "-o",
            "--output",
            help="CSV file of the motion; .yaml, .json, .h and .html go beside it.",
        ),
    ] = Path("motion.csv")
    duration: Annotated[float, typer.Option(help="Length of the motion [s].")] = 10.0
    rate: Annotated[
        float,
        typer.Option(
            help="Rows a second, and of the recording [Hz]; that of --prior or --after if omitted.",
        ),
    ] = 500.0
    family: Annotated[
        str,
        typer.Option(
            metavar="splines|fourier|periodic|moves",
            help="B-splines, a Fourier series, one that ends where it starts, or minimum-jerk"
            " moves.",
        ),
    ] = "splines"
    wanted: Annotated[
        str | None,
        typer.Option(
            "--for",
            metavar="NAMES",
            help="Coefficients that matter, by group or name as in viscous,kd5; all if omitted.",
        ),
    ] = None
    payload: Annotated[
        float | None,
        typer.Option(
            metavar="KG",
            help="Design for a payload of about this mass at the last link, which payload"
            " identifies: its coefficients are those that matter, unless --for names others. What"
            " --prior or --after say of the arm counts as known.",
        ),
    ] = None
    criterion: Annotated[
        str,
        typer.Option(
            metavar="overall|error|worst|torque|bodies|A|D|E|condition|scaled_condition",
            help="What is made small: mean or largest standard error over size, error of torques"
            " on --task, the mean of the first and the third (overall), or what other designs use"
            " (docs/excitation.md).",
        ),
    ] = "overall"
    prior: Annotated[
        Path | None,
        typer.Option(
            "--prior", help="identification.json of earlier recordings: what is known already."
        ),
    ] = None
    after: Annotated[
        list[Path] | None,
        typer.Option(help="Earlier recordings, which are identified first; may be repeated."),
    ] = None
    reach: Annotated[
        float | None,
        typer.Option(
            metavar="PERCENT",
            help="Standard error over size that all coefficients of --for should reach: nothing is"
            " designed where they have.",
        ),
    ] = None
    limits: Annotated[
        Path | None,
        typer.Option(
            metavar="LIMITS.TOML",
            help="Limits of joints, and surroundings to keep away from; those of the robot's file"
            " if omitted.",
        ),
    ] = None
    torque_noise: Annotated[
        str | None,
        typer.Option(
            metavar="NUMBERS",
            help="Standard deviation of torques, one or one a joint [N m]; of --prior or --after,"
            " or 1 % of the torque limits if omitted.",
        ),
    ] = None
    torque_offset: Annotated[
        str | None,
        typer.Option(
            metavar="NUMBERS",
            help="Standard deviation of constant errors of torques, one or one a joint [N m]; as"
            " large as --torque-noise if omitted, 0 after --prior or --after and for joints with"
            " friction of kind offset or asymmetric_dry.",
        ),
    ] = None
    encoder: Annotated[
        str | None,
        typer.Option(
            metavar="NUMBERS",
            help="Step of encoders, one or one a joint [rad]; that of --prior or --after, or 1e-4"
            " if omitted.",
        ),
    ] = None
    estimator: Annotated[
        str,
        typer.Option(
            metavar="likelihood|regression", help="The estimator that the recording is for."
        ),
    ] = "likelihood"
    task: Annotated[
        Path | None,
        typer.Option(
            help="Recording of the motion on which torques matter, for criteria overall and"
            " torque; random motions within the limits if omitted.",
        ),
    ] = None
    start: Annotated[
        str | None,
        typer.Option(
            metavar="NUMBERS",
            help="Pose to start from, one number a joint [rad or m]; searched for if omitted.",
        ),
    ] = None
    seed: Annotated[
        int, typer.Option(help="Seed of random motions; the same gives the same motion.")
    ] = 0
    starts: Annotated[
        int, typer.Option(help="How many random motions the search starts from; the best counts.")
    ] = 3
