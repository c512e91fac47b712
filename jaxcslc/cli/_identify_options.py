"""Options of `jaxcslc identify` that say what is fitted, and how."""

import dataclasses
from pathlib import Path
from typing import Annotated

import typer

from ..identification import ESTIMATORS
from ._common import LengthsOption, OutputOption, SettingsOption


@dataclasses.dataclass(frozen=True)
class IdentifyOptions:
    """Recordings to fit and to judge on, the estimator, and what is known and asked for."""

    train: Annotated[
        list[Path],
        typer.Argument(metavar="TRAIN...", help="Recording to fit, or several of one robot."),
    ]
    validate: Annotated[
        Path | None, typer.Option(help="Recording to judge the fit on; it is not fitted.")
    ] = None
    output: OutputOption = Path("identified")
    lengths: LengthsOption = "auto"
    settings: SettingsOption = None
    estimator: Annotated[
        str,
        typer.Option(
            metavar="|".join(ESTIMATORS),
            help="Regression on smoothed motion; or positions and coefficients estimated together,"
            " without a smoothing; or instruments from simulated motion, which say whether"
            " regression is biased; or the one of the first two that predicts motion that was not"
            " fitted better.",
        ),
    ] = "least-squares"
    likelihood_every: Annotated[
        int | None,
        typer.Option(
            help="Maximum likelihood: equations of motion over two times so many samples, for arms"
            " whose transmission vibrates. By the noise of estimated positions if omitted.",
        ),
    ] = None
    measured: Annotated[
        bool | None,
        typer.Option(
            "--measured/--demanded",
            help="Torques were measured at the samples, or are demands that drives hold to the"
            " next sample; by default what the file's format says. It counts where the recording"
            " itself does not show which torque belongs to a sample.",
            show_default=False,
        ),
    ] = None
    offsets: Annotated[
        bool,
        typer.Option(
            "--offsets", help="Fit a constant torque of each joint in each recording along."
        ),
    ] = False
    torque_lag: Annotated[
        float | None,
        typer.Option(
            help="How much later than positions torques were measured [s]; that of --settings, or"
            " 0, if omitted.",
        ),
    ] = None
    loss: Annotated[
        str | None,
        typer.Option(
            metavar="squared|huber|bisquare",
            help="Loss of the fit; huber and bisquare bound what outliers do to it; that of"
            " --settings, or squared, if omitted.",
        ),
    ] = None
    folds: Annotated[
        int | None,
        typer.Option(help="Stretches that settings are chosen by; 8, or fewer if it is short."),
    ] = None
    check: Annotated[
        bool, typer.Option(help="Check the recordings first, as jaxcslc check does.")
    ] = True
    reidentify: Annotated[
        str | None,
        typer.Option(
            metavar="GROUPS",
            help="Fit only these coefficients, by group or name as in viscous,dry; all others are"
            " fixed at those of --previous.",
        ),
    ] = None
    previous: Annotated[
        Path | None,
        typer.Option(help="The identification.json of a previous run, for --reidentify."),
    ] = None
    systematic: Annotated[
        bool,
        typer.Option(help="Widen a robot's intervals by errors of smoothing and of missing terms."),
    ] = True
    possible: Annotated[
        str,
        typer.Option(
            metavar="auto|always|never",
            help="Fit physically possible bodies along, and use their coefficients where they"
            " predict motion that was left out better than the free fit; or always; or do not.",
        ),
    ] = "auto"
    prior: Annotated[
        Path | None,
        typer.Option(
            metavar="PRIORS.TOML",
            help="What is known of coefficients and links: fixed, bounded, or with an error"
            " (docs/uncertainty.md).",
        ),
    ] = None
    memory: Annotated[
        float,
        typer.Option(
            metavar="GB",
            help="Memory to use, about: in a longer recording, settings are chosen and fits judged"
            " on a part that is said; coefficients are fitted to all of it.",
        ),
    ] = 2.0
    horizon: Annotated[
        bool,
        typer.Option(
            "--horizon",
            help="Simulate the identified arm open loop from recorded states, beside that of the"
            " file and one with pre-sliding that was used, and report how far positions are off"
            " after 0.1 to 5 s.",
        ),
    ] = False
    dask: Annotated[
        str | None,
        typer.Option(
            metavar="ADDRESS|local",
            help="Fit many recordings on the workers of a Dask cluster, or of one that is started"
            " here. Quoted patterns are expanded, as 'logs/*.parquet'.",
        ),
    ] = None
    fleet: Annotated[
        bool,
        typer.Option("--fleet", help="With --dask: fit each recording by itself, as of a robot."),
    ] = False
