from pathlib import Path
from typing import Annotated

import typer


TrainingArgument = Annotated[
    list[Path],
    typer.Argument(metavar="TRAIN...", help="Recording to fit, or several of one robot."),
]
ValidationOption = Annotated[
    Path | None, typer.Option(help="Recording to judge the fit on; it is not fitted.")
]
EstimatorOption = Annotated[
    str,
    typer.Option(
        metavar="least-squares|maximum-likelihood|instrumental-variables|auto",
        help="Regression on smoothed motion; or positions and coefficients estimated together,"
        " without a smoothing; or instruments from simulated motion, which say whether regression"
        " is biased; or the one of the first two that predicts motion that was not fitted better.",
    ),
]
LikelihoodEveryOption = Annotated[
    int | None,
    typer.Option(
        help="Maximum likelihood: equations of motion over two times so many samples, for arms"
        " whose transmission vibrates. By the noise of estimated positions if omitted.",
    ),
]
OffsetsOption = Annotated[
    bool,
    typer.Option("--offsets", help="Fit a constant torque of each joint in each recording along."),
]
TorqueLagOption = Annotated[
    float | None,
    typer.Option(
        help="How much later than positions torques were measured [s]; that of --settings, or 0, if"
        " omitted."
    ),
]
LossOption = Annotated[
    str | None,
    typer.Option(
        metavar="squared|huber|bisquare",
        help="Loss of the fit; huber and bisquare bound what outliers do to it; that of --settings,"
        " or squared, if omitted.",
    ),
]
FoldsOption = Annotated[
    int | None,
    typer.Option(help="Stretches that settings are chosen by; 8, or fewer if it is short."),
]
ChecksOption = Annotated[
    bool, typer.Option(help="Check the recordings first, as jaxcslc check does.")
]
ReidentifyOption = Annotated[
    str | None,
    typer.Option(
        metavar="GROUPS",
        help="Fit only these coefficients, by group or name as in viscous,dry; all others are"
        " fixed at those of --previous.",
    ),
]
PreviousOption = Annotated[
    Path | None,
    typer.Option(help="The identification.json of a previous run, for --reidentify."),
]
SystematicOption = Annotated[
    bool,
    typer.Option(help="Widen a robot's intervals by errors of smoothing and of missing terms."),
]
PossibleOption = Annotated[
    str,
    typer.Option(
        metavar="auto|always|never",
        help="Fit physically possible bodies along, and use their coefficients where they predict"
        " motion that was left out better than the free fit; or always; or do not.",
    ),
]
PriorOption = Annotated[
    Path | None,
    typer.Option(
        metavar="PRIORS.TOML",
        help="What is known of coefficients and links: fixed, bounded, or with an error"
        " (docs/uncertainty.md).",
    ),
]
HorizonOption = Annotated[
    bool,
    typer.Option(
        "--horizon",
        help="Simulate the identified arm open loop from recorded states, beside that of the"
        " file and one with pre-sliding that was used, and report how far positions are off after"
        " 0.1 to 5 s.",
    ),
]
MemoryOption = Annotated[
    float,
    typer.Option(
        metavar="GB",
        help="Memory to use, about: in a longer recording, settings are chosen and fits judged on a"
        " part that is said; coefficients are fitted to all of it.",
    ),
]
DaskOption = Annotated[
    str | None,
    typer.Option(
        metavar="ADDRESS|local",
        help="Fit many recordings on the workers of a Dask cluster, or of one that is started here."
        " Quoted patterns are expanded, as 'logs/*.parquet'.",
    ),
]
FleetOption = Annotated[
    bool, typer.Option("--fleet", help="With --dask: fit each recording by itself, as of a robot.")
]
