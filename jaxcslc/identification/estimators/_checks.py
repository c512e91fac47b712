from collections.abc import Mapping
from typing import Literal, get_args

from ...motion import Recording
from ...network import CSLC
from ..likelihood import MaximumLikelihood
from ..possible import Choice


EstimatorChoice = Literal["least-squares", "maximum-likelihood", "instrumental-variables", "auto"]
"""An estimator, or whichever of the first two predicts motion that was not fitted better."""

# Matrices of positions times coefficients that a fit keeps at a time.
_MATRICES = 6


def check_estimator(
    estimator: str,
    *,
    previous: bool,
    offsets: bool,
    recordings: int,
    possible: Choice,
    likelihood: MaximumLikelihood | None,
) -> None:
    """**Raises** `ValueError` for an unknown estimator, and what only least squares can do."""
    if estimator not in get_args(EstimatorChoice):
        raise ValueError(
            f"estimator: expected {', '.join(get_args(EstimatorChoice))}, got {estimator!r}"
        )
    if likelihood is not None and likelihood.possible:
        raise ValueError("likelihood: possible bodies are asked for by possible='always'")
    if likelihood is not None and estimator not in ("maximum-likelihood", "auto"):
        raise ValueError(f"estimator {estimator!r}: takes no options of maximum likelihood")
    if estimator != "least-squares" and (previous or offsets):
        option = "previous" if previous else "offsets"
        raise ValueError(f"estimator {estimator!r}: not with {option}, which is of least-squares")
    if estimator == "instrumental-variables":
        if recordings > 1:
            raise ValueError(f"estimator {estimator!r}: is for one recording, got {recordings}")
        if possible == "always":
            raise ValueError(f"estimator {estimator!r}: fits no possible bodies; got 'always'")


def within_memory(network: CSLC, training: Mapping[str, Recording], memory: float) -> bool:
    """Whether the matrices of a fit fit into memory [GB]."""
    return _needed(network, training) <= memory


def check_size(network: CSLC, training: Mapping[str, Recording], memory: float) -> None:
    """**Raises** `ValueError` if the matrices of a fit do not fit into memory [GB]."""
    if not within_memory(network, training, memory):
        samples = sum(recording.samples for recording in training.values())
        needed = _needed(network, training)
        raise ValueError(
            f"maximum likelihood of {samples} samples needs {needed:.2g} GB; expected at most"
            f" {memory:g} GB, about {int(memory / (needed / samples))} samples: thin the recording,"
            " or allow more memory"
        )


def _needed(network: CSLC, training: Mapping[str, Recording]) -> float:
    """Memory of matrices of positions times coefficients [GB]."""
    samples = sum(recording.samples for recording in training.values())
    n = network.joint_count
    return 8e-9 * samples * n * (network.size + 2 * n) * _MATRICES
