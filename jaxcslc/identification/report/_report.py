from collections.abc import Mapping
from pathlib import Path
from typing import Any

import numpy as np

from ...motion import Patterns
from ...network import CSLC
from ...plotting import save_picture, torque_picture
from .. import HeldOut, Settings, settings_document
from ..solver import Identification
from ._coefficient_table import coefficient_rows
from ._errors import ErrorTable, predicted_torque
from ._excitation import Excitation
from ._output import write_csv, write_json


_STATES = 100  # of the motion that is kept beside the coefficients


def identification_report(
    folder: Path,
    network: CSLC,
    fit: Identification,
    patterns: Mapping[str, Patterns],
    errors: Mapping[str, ErrorTable],
    settings: Settings,
    *,
    excitation: Excitation | None = None,
    held_out: HeldOut | None = None,
) -> list[Path]:
    """Everything that an identification found, as files.

    **Arguments**

    - `folder`: exists.
    - `patterns`, `errors`: by the name of the recording: `"training"`, `"validation"`.
    - `excitation`: of the training recording; adds variance inflation and the combination of
      coefficients that is told least.
    - `held_out`: adds how the fit does where it was not fitted.

    **Returns** the files: `coefficients.csv`, `identification.json`, and for every recording
    `errors_NAME.csv`, `torque_NAME.csv` and `torque_NAME.png`.
    """
    write_csv(folder / "coefficients.csv", coefficient_rows(network, fit, excitation=excitation))
    write_json(
        folder / "identification.json",
        {
            "robot": network.robot.name,
            "lengths": network.algebra.lengths,
            "settings": settings_document(settings),
            **_slopes(network),
            "friction": list(network.robot.friction),
            "coupled": [list(pair) for pair in network.robot.coupled],
            "expressions": [coefficient.expression for coefficient in network.coefficients],
            "units": [coefficient.unit for coefficient in network.coefficients],
            "unidentifiable": fit.unidentifiable,
            **fit.document(),  # so that `Identification.load` reads this file too
            **({} if excitation is None else {"told_least": excitation.worst_combination}),
            **({} if held_out is None else {"held_out": _held_out(held_out)}),
            "torque_error_rms": {name: table.rms[0] for name, table in errors.items()},
            "motion": _some_motion(patterns["training"]),
        },
    )
    written = [folder / "coefficients.csv", folder / "identification.json"]
    for name, pattern in patterns.items():
        predicted = np.asarray(predicted_torque(network, pattern, fit.k))
        written += _recording_files(folder, name, network, pattern, predicted, errors[name])
    return written


def _slopes(network: CSLC) -> dict[str, Any]:
    if network.static_slopes is None:
        return {}
    return {"static_slopes": np.asarray(network.static_slopes, float)}


def _some_motion(patterns: Patterns) -> dict[str, np.ndarray]:
    """States of the recording, evenly spaced: enough to compare torques over it later."""
    every = max(len(np.asarray(patterns.time)) // _STATES, 1)
    return {name: np.asarray(getattr(patterns, name))[::every] for name in ("q", "qd", "qdd")}


def _held_out(held_out: HeldOut) -> dict[str, Any]:
    return {
        "training_rms": held_out.training,
        "held_out_rms": held_out.held_out,
        "limit": held_out.limit,
        "beyond_chance": held_out.beyond_chance,
    }


def _recording_files(
    folder: Path,
    name: str,
    network: CSLC,
    patterns: Patterns,
    predicted: np.ndarray,
    errors: ErrorTable,
) -> list[Path]:
    paths = [
        folder / f"errors_{name}.csv",
        folder / f"torque_{name}.csv",
        folder / f"torque_{name}.png",
    ]
    n = network.joint_count
    write_csv(
        paths[0],
        [
            {
                "joint": joint + 1,
                "rms": float(errors.rms[0, joint]),
                "mean_modulus": float(errors.mean_modulus[0, joint]),
                "pairs": int(np.sum(np.asarray(patterns.mask)[:, joint])),
            }
            for joint in range(n)
        ],
    )
    measured, counts = np.asarray(patterns.torque), np.asarray(patterns.mask)
    header = ["time"] + [
        f"{kind}_{joint + 1}" for kind in ("measured", "predicted", "counts") for joint in range(n)
    ]
    table = np.concatenate(
        [np.asarray(patterns.time)[:, None], measured, predicted, counts.astype(float)], axis=1
    )
    np.savetxt(paths[1], table, delimiter=",", header=",".join(header), comments="", fmt="%.10g")
    figure = torque_picture(
        np.asarray(patterns.time),
        measured,
        {"predicted": predicted},
        title=f"{network.robot.name}: torque of the {name} recording",
        units=tuple("N m" if kind == "R" else "N" for kind in network.robot.kinds),
        counts=counts,
    )
    save_picture(figure, paths[2])
    return paths


def derivation_document(network: CSLC) -> dict[str, Any]:
    """The tables of inputs and links as plain data; indices count from 1, as in Appendix B."""

    def table(name: str) -> dict[str, Any]:
        source = getattr(network.algebra, name)
        return {
            "inputs": source.labels,
            "nodes": [[index + 1 for index in column] for column in source.columns],
            "links": [
                {
                    "input": link.input + 1,
                    "node": link.column + 1,
                    "weight": {network.names[i]: float(value) for i, value in link.weights},
                }
                for link in source.links
            ],
        }

    return {
        "robot": network.robot.name,
        "lengths": network.algebra.lengths,
        "coefficients": coefficient_rows(network),
        "order": network.order,
        "order_per_joint": network.order_per_joint,
        **{name: table(name) for name in ("mass", "velocity", "gravity")},
    }
