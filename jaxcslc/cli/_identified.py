import json
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np

from ..identification.solver import Identification
from ..manipulator import Manipulator, RobotError
from ..network import CSLC
from ._common import network_of


# SI units. No robot comes near; and squares, in covariances, are far from overflow.
LARGEST = 1e12


@dataclass(frozen=True)
class Identified:
    """An earlier run's `identification.json`: the network that it is of, the fit, all else."""

    path: Path
    network: CSLC
    fit: Identification
    document: dict[str, Any]


def identified(robot: Manipulator, path: Path, named: str) -> Identified:
    """What a file says of a robot; `named` is what the user called it.

    **Raises** `ValueError`, naming the file, for what is no identification or another robot's.
    """
    document = _document(path)
    network = network_of(_with_drives(robot, document, path), _lengths(document))
    network = _with_slopes(network, document, path)
    fit = _fit(path)
    if difference := _difference(network, document, fit.names, named):
        raise ValueError(f"{path}: {difference}; expected an identification of this robot")
    return Identified(path, network, fit, document)


def _document(path: Path) -> dict[str, Any]:
    try:
        document = json.loads(path.read_text(encoding="utf-8"))
    except FileNotFoundError:
        raise ValueError(f"{path}: no such identification") from None
    except (json.JSONDecodeError, UnicodeDecodeError, RecursionError) as error:
        raise ValueError(f"{path}: not valid JSON: {error}") from None
    if not isinstance(document, dict):
        raise ValueError(f"{path}: expected an identification as a JSON object")
    return document


def _lengths(document: dict[str, Any]) -> str:
    lengths = document.get("lengths", "auto")
    return ",".join(lengths) if isinstance(lengths, list) else str(lengths)


def _with_drives(robot: Manipulator, document: dict[str, Any], path: Path) -> Manipulator:
    """With the friction and couplings of the identification, where the file says nothing of them.

    What a file says of single joints, and its own couplings, are for `_difference` to compare.
    """
    words, pairs = document.get("friction"), document.get("coupled")
    for name, value in (("friction", words), ("coupled", pairs)):
        if value is not None and not isinstance(value, list):
            raise ValueError(f"{path}: {name}: expected a list")
    if robot.own_friction is not None:
        return robot
    try:
        if words is not None and tuple(words) != robot.friction:
            robot = robot.with_friction(*words)
        if pairs and not robot.coupled:
            robot = robot.with_coupling(*pairs)
    except (RobotError, TypeError) as error:
        raise ValueError(f"{path}: {error}") from None
    return robot


def _difference(
    network: CSLC, document: dict[str, Any], names: tuple[str, ...], robot: str
) -> str | None:
    """In what the identification is another robot's; None if in nothing that can be told."""
    if names != network.names:
        return f"has coefficients {_few(names)}; {robot} has {_few(network.names)}"
    expressions = document.get("expressions")
    if expressions is None:
        named = document.get("robot", network.robot.name)
        if named != network.robot.name:  # nothing else to tell robots of one structure apart by
            return f"is of robot {named!r}; {robot} is {network.robot.name!r}"
    elif not isinstance(expressions, list) or len(expressions) != len(names):
        return f"expressions: is no list of {len(names)}"
    else:
        for coefficient, theirs in zip(network.coefficients, expressions, strict=True):
            if theirs != coefficient.expression:
                return f"{coefficient.name} is {theirs}; of {robot} it is {coefficient.expression}"
    own = [list(pair) for pair in network.robot.coupled]
    if document.get("coupled", own) != own:
        return f"has coupled joints {document['coupled']}; {robot} has {own}"
    return None


def _fit(path: Path) -> Identification:
    """**Raises** `ValueError` for numbers that are no robot's, and would overflow on the way."""
    try:
        fit = Identification.load(path)
    except OverflowError as error:
        raise ValueError(f"{path}: {error}") from None
    for name, value in zip(fit.names, np.asarray(fit.k), strict=True):
        if not abs(value) <= LARGEST:
            raise ValueError(
                f"{path}: {name} is {value:.3g}; expected finite coefficients below {LARGEST:g}"
            )
    for name in ("covariance", "independent_covariance"):
        if np.any(np.abs(np.asarray(getattr(fit, name))) > LARGEST**2):
            raise ValueError(f"{path}: {name}: expected variances below {LARGEST**2:g}")
    return fit


def _with_slopes(network: CSLC, document: dict[str, Any], path: Path) -> CSLC:
    """With the slopes of static friction that were found."""
    if network.static_slopes is None or "static_slopes" not in document:
        return network
    try:
        return network.with_static_slopes(np.asarray(document["static_slopes"], float))
    except (TypeError, ValueError) as error:
        raise ValueError(f"{path}: static_slopes: {error}") from None


def _few(names: tuple[str, ...]) -> str:
    return f"{names[0]} to {names[-1]} ({len(names)})" if names else "none"
